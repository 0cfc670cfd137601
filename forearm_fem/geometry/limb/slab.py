"""A flat layered block: a graded footprint extruded into prisms, cut into tetrahedra."""

from __future__ import annotations

import numpy as np

from ...errors import GeometryError
from ...scenario.limb import SlabLimb
from ...typing import FloatArray
from ..device.layout import Layout
from ..device.sizing import SizeField
from ..mesh.tissue_mesh import TissueMesh, boundary_faces
from .filling import oriented, stack_prisms
from .planar import Rectangle, triangulate

_TALLEST = 13.5  # columns under a disc stay as narrow all the way down: core layers are so many times as thick at most
_CORE_GROWTH = 2.0  # thickness of core layers grows by 1 + 2 * grading from one to the next


def slab_mesh(limb: SlabLimb, layout: Layout, size: SizeField) -> TissueMesh:
    """Tetrahedra of ``limb``: skin at z = 0, exact layer thicknesses, contacts followed by edges."""
    check_slab(limb, layout)
    box = _footprint(limb)
    xy, triangles = triangulate(box, size, layout.contacts, layout.radius, layout.points)
    depths, layer = _levels(limb, size)
    columns = np.arange(len(xy))
    levels = columns + len(xy) * np.arange(len(depths))[:, None]
    points = np.column_stack([np.tile(xy, (len(depths), 1)), -np.repeat(depths, len(xy))])
    tetrahedra, under = stack_prisms(triangles, levels)
    tetrahedra = oriented(points, tetrahedra)
    names = tuple(dict.fromkeys([*(each.tissue for each in limb.layers), limb.core]))
    region = np.array([names.index(t) for t in layer])[under]
    faces, _ = boundary_faces(tetrahedra)
    corner = points[faces]
    skin = (corner[:, :, 2] == 0).all(axis=1)
    facets, rest = {"skin": faces[skin]}, ~skin
    for axis, name in enumerate("xy"):
        if name in limb.symmetry:
            plane = (corner[:, :, axis] == box.low[axis]).all(axis=1)
            facets[f"symmetry {name}"] = faces[plane]
            rest &= ~plane
    return TissueMesh(points, tetrahedra, region, names, {**facets, "end": faces[rest]})


def check_slab(limb: SlabLimb, layout: Layout) -> None:
    """Raise when layers do not fit or a contact or point is not on the modelled top."""
    total = sum(each.thickness for each in limb.layers)
    if total >= limb.depth:
        raise GeometryError(
            f"the slab's layers are {total * 1e3:.3g} mm thick together, but limb.depth is "
            f"{limb.depth * 1e3:.3g} mm; increase limb.depth or thin limb.layers"
        )
    box = _footprint(limb)
    for name, centre in zip(layout.names, layout.contacts, strict=True):
        _check_on(box, limb, f"contact {name}", centre, layout.radius)
    for i, point in enumerate(layout.points):
        _check_on(box, limb, f"grid point {i + 1}", point, 0.0)


def _check_on(box: Rectangle, limb: SlabLimb, what: str, at: FloatArray, radius: float) -> None:
    for axis, name in enumerate("xy"):
        centred = name in limb.symmetry and at[axis] == 0
        if name in limb.symmetry and radius and not centred:
            raise GeometryError(
                f"{what} at ({at[0] * 1e3:.4g}, {at[1] * 1e3:.4g}) mm lies beside the symmetry plane {name} = 0, which "
                f"would drive its mirror image too; put its centre on the plane or leave '{name}' out of limb.symmetry"
            )
        low = box.low[axis] - (radius if centred else 0)
        if not low <= at[axis] - radius <= at[axis] + radius <= box.high[axis]:
            keys = ("device.contacts or device.spacing", "grid.points or grid.pitch")[radius == 0]
            cut = f", or leave '{name}' out of limb.symmetry" if name in limb.symmetry else ""
            raise GeometryError(
                f"{what} at ({at[0] * 1e3:.4g}, {at[1] * 1e3:.4g}) mm does not lie on the modelled slab, "
                f"{name} from {box.low[axis] * 1e3:.4g} to {box.high[axis] * 1e3:.4g} mm; move it ({keys}), "
                f"enlarge {('limb.length', 'limb.width')[axis]}{cut}"
            )


def _footprint(limb: SlabLimb) -> Rectangle:
    half = (limb.length / 2, limb.width / 2)
    low = tuple(0.0 if name in limb.symmetry else -h for name, h in zip("xy", half, strict=True))
    return Rectangle((low[0], low[1]), half)


def _levels(limb: SlabLimb, size: SizeField) -> tuple[FloatArray, list[str]]:
    """Depths (k + 1,) of the levels from the skin down, and the tissue between each pair of them."""
    depths, tissues = [0.0], []
    for layer, count in zip(limb.layers, size.sizes.sublayers, strict=True):
        top = depths[-1]
        depths += [top + layer.thickness * (i + 1) / count for i in range(count)]
        tissues += [layer.tissue] * count
    thickest = min(size.sizes.far, _TALLEST * size.sizes.contact)
    core = _growing(limb.depth - depths[-1], size.sizes.grid, 1 + _CORE_GROWTH * size.grading, thickest)
    depths += list(depths[-1] + np.cumsum(core))
    depths[-1] = limb.depth
    return np.array(depths), tissues + [limb.core] * len(core)


def _growing(total: float, first: float, ratio: float, largest: float) -> FloatArray:
    """Thicknesses that grow from about ``first`` by ``ratio`` up to ``largest`` and sum to ``total``."""
    steps: list[float] = []
    while sum(steps) < total:
        steps.append(min(first * ratio ** len(steps), largest))
    if len(steps) > 1 and sum(steps) - total > total - sum(steps[:-1]):
        steps = steps[:-1]
    return np.array(steps) * (total / sum(steps))
