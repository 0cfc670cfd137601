"""Forearm and cylinder: prism layers of exact thickness grown outwards from the core."""

from __future__ import annotations

import numpy as np

from ...typing import BoolArray, FloatArray, IntArray
from ..device.layout import Layout
from ..device.sizing import Sizes
from ..mesh.tissue_mesh import DOWN, TissueMesh
from ..mesh.topology import boundary_faces, triangle_normals
from .core import Size3, core_mesh
from .prisms import oriented, stack_prisms
from .tube import Tube

_COARSE = 2.0  # where columns are further apart than this many sizes between the ports, layers are not divided


def limb_mesh(
    tube: Tube, size: Size3, sizes: Sizes, layout: Layout, *, elastic_bones: bool, seed: int = 1
) -> TissueMesh:
    """Core, and on it layers of prisms cut into tetrahedra; contacts are imprinted afterwards.

    Away from the device each tissue layer is one prism thick: there the levels inside a layer fall together.
    """
    core = core_mesh(tube, size, sizes, layout, elastic=elastic_bones, seed=seed)
    depths, tissues = _depths(tube, sizes)
    column = np.unique(core.lateral)
    points = [core.points]
    levels = np.zeros((len(depths), len(core.points)), dtype=np.int64)
    levels[0] = np.arange(len(core.points))
    for k, depth in enumerate(depths[1:], start=1):
        levels[k, column] = len(core.points) + (k - 1) * len(column) + np.arange(len(column))
        points.append(tube.place(core.points[column, 0], core.angle[column], depth))
    coarse = column[size(core.points[column]) > _COARSE * sizes.grid]
    merged = levels.copy()
    for k in range(1, len(tissues)):
        if tissues[k] == tissues[k - 1]:  # the level between two sublayers falls onto the layer's lower face
            merged[k, coarse] = merged[k - 1, coarse]
    stacked, under = stack_prisms(core.lateral, merged)
    inner = ["bone" if b >= 0 else tube.core for b in core.bone]
    names = tuple(dict.fromkeys([*(each.tissue for each in tube.layers), tube.core, *inner]))
    region = np.array([names.index(t) for t in [*inner, *(tissues[u] for u in under)]])
    places = np.vstack(points)
    on_skin, on_bone = np.zeros((2, len(places)), dtype=bool)
    on_skin[levels[-1, column]] = True
    on_bone[: len(core.points)] = core.on_bone
    used, renumbered = np.unique(oriented(places, np.vstack([core.tetrahedra, stacked])), return_inverse=True)
    places, tetrahedra = places[used], renumbered.reshape(-1, 4)
    return TissueMesh(places, tetrahedra, region, names, boundaries(places, tetrahedra, on_skin[used], on_bone[used]))


def _depths(tube: Tube, sizes: Sizes) -> tuple[FloatArray, list[str]]:
    """Depths (k + 1,) from the core's surface up to the skin, and the tissue between each pair of them."""
    depths, tissues, depth = [tube.thickness], [], tube.thickness
    for layer, count in reversed(list(zip(tube.layers, sizes.sublayers, strict=True))):
        depths += [depth - layer.thickness * (i + 1) / count for i in range(count)]
        tissues += [layer.tissue] * count
        depth = depths[-1]
    depths[-1] = 0.0 if tissues else depths[-1]
    return np.array(depths), tissues


def boundaries(points: FloatArray, tetrahedra: IntArray, on_skin: BoolArray, on_bone: BoolArray) -> dict[str, IntArray]:
    """Skin, underside, bone and end from flags per vertex (n_point,); ends are what remains."""
    faces, _ = boundary_faces(tetrahedra)
    skin = on_skin[faces].all(axis=1)
    bone = ~skin & on_bone[faces].all(axis=1) & (np.ptp(points[faces, 0], axis=1) > 0)
    named = {"skin": faces[skin], "bone": faces[bone], "end": faces[~skin & ~bone]}
    named["underside"] = underside(points, named["skin"])
    return {name: each for name, each in named.items() if len(each)}


def underside(points: FloatArray, skin: IntArray) -> IntArray:
    """Skin triangles whose outward normal points down, n_z < :data:`DOWN`: they may be held."""
    normal = triangle_normals(points, skin)
    return np.asarray(skin[normal[:, 2] < DOWN * np.linalg.norm(normal, axis=1)])
