"""The user's own tetrahedral mesh: regions named or numbered in the file become tissues."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..errors import MeshError
from ..scenario.limb import MeshLimb
from ..typing import IntArray
from .boundary import with_boundaries, without_bone
from .extent import check_extent
from .files import read_quietly
from .mesh import TissueMesh
from .prisms import oriented

_NUMBERED = ("gmsh:physical", "region", "medit:ref", "cell_tags", "gmsh:geometrical", "material", "subdomain")


def user_mesh(limb: MeshLimb, base: Path, *, keep_bone: bool) -> TissueMesh:
    """Mesh of ``limb.file``: tissues by ``limb.regions``, metres, positive tetrahedra, named boundaries."""
    file = base / limb.file
    if not file.is_file():
        raise MeshError(f"{file}: no such mesh file; limb.file is relative to the scenario's folder")
    read = read_quietly(file)
    tetrahedra = _tetrahedra(file, read)
    label = _labels(file, read, len(tetrahedra))
    names = tuple(dict.fromkeys(limb.regions.values()))
    region = _tissues(file, limb, label, names)
    points = np.asarray(read.points, dtype=float)[:, :3] * limb.unit
    if points.shape[1] != 3:
        raise MeshError(f"{file}: points have {points.shape[1]} coordinates, need 3; give a volume mesh")
    used, renumbered = np.unique(tetrahedra, return_inverse=True)
    points = points[used]
    check_extent(file, points)
    mesh = TissueMesh(points, oriented(points, renumbered.reshape(-1, 4)), region, names, {})
    mesh = mesh if keep_bone else without_bone(mesh)
    return with_boundaries(mesh, 1e-6 * float(np.ptp(points[:, 0])))


def _tetrahedra(file: Path, read: Any) -> IntArray:
    """Corner nodes of all tetrahedra; midside nodes of quadratic ones are dropped."""
    blocks = [c.data[:, :4] for c in read.cells if c.type in ("tetra", "tetra10")]
    others = {c.type for c in read.cells} & {"hexahedron", "wedge", "pyramid", "hexahedron20", "wedge15"}
    if others:
        raise MeshError(
            f"{file}: contains {', '.join(sorted(others))} cells, but only tetrahedra can be used; split them"
        )
    if not blocks:
        kinds = ", ".join(sorted({c.type for c in read.cells})) or "nothing"
        raise MeshError(f"{file}: contains no tetrahedra (only {kinds}); mesh the volume, not the surface")
    return np.vstack(blocks).astype(np.int64)


def _labels(file: Path, read: Any, count: int) -> list[str]:
    """Region name or number of every tetrahedron, as text; names of groups win over numbers."""
    chosen = [i for i, c in enumerate(read.cells) if c.type in ("tetra", "tetra10")]
    key = next((k for k in _NUMBERED if k in read.cell_data), None)
    if key is not None:
        numbers = np.concatenate([np.asarray(read.cell_data[key][i]).ravel() for i in chosen]).astype(np.int64)
        named = {int(tag[0]): name for name, tag in read.field_data.items() if int(tag[1]) == 3}
        return [named.get(int(k), str(k)) for k in numbers]
    return _from_sets(file, read, chosen, count)


def _from_sets(file: Path, read: Any, chosen: list[int], count: int) -> list[str]:
    labels = [""] * count
    start = 0
    for i in chosen:
        for name, members in read.cell_sets.items():
            for k in np.asarray(members[i] if members[i] is not None else [], dtype=np.int64):
                labels[start + int(k)] = name
        start += len(read.cells[i].data)
    if "" in labels:
        raise MeshError(
            f"{file}: {labels.count('')} tetrahedra carry no region; expected cell data such as "
            f"{', '.join(_NUMBERED[:3])} or named cell sets"
        )
    return labels


def _tissues(file: Path, limb: MeshLimb, label: list[str], names: tuple[str, ...]) -> IntArray:
    unknown = sorted(set(label) - set(limb.regions))
    if unknown:
        raise MeshError(
            f"{file}: regions {', '.join(unknown)} have no tissue; add them to limb.regions "
            f"(it maps {', '.join(limb.regions) or 'nothing'})"
        )
    absent = sorted(set(limb.regions) - set(label))
    if absent:
        raise MeshError(
            f"{file}: limb.regions names {', '.join(absent)}, but the file holds "
            f"{', '.join(sorted(set(label)))}; "
            "correct the name or number"
        )
    number = {key: names.index(tissue) for key, tissue in limb.regions.items()}
    return np.array([number[k] for k in label], dtype=np.int64)
