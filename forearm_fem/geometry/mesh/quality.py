"""Quality of a mesh: shape, closure, conformity, and nodes per wavelength."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ...errors import MeshError, MeshTooLarge
from ...ports import Port, positions
from ...typing import FloatArray
from ..device.sizing import tetrahedron_orders
from .tissue_mesh import (
    EDGES,
    FACES,
    SIDES,
    TissueMesh,
    edge_lengths,
    edges_of,
    is_member,
    keys,
    mean_ratios,
    pieces,
    true_volumes,
)


@dataclass(frozen=True)
class Quality:
    """Shape and volume of a mesh; ``least`` and ``median`` are mean ratios (1 = regular tetrahedron).

    ``volume`` [m^3] is the mesh's, ``expected_volume`` the analytic limb's where there is one; ``volumes`` per tissue
    [m^3]; ``p2_displacements`` counts the degrees of freedom of a P2 displacement field.
    """

    tetrahedra: int
    vertices: int
    p2_displacements: int
    least: float
    median: float
    volume: float
    volumes: Mapping[str, float]
    expected_volume: float | None = None


def mean_ratio(mesh: TissueMesh) -> FloatArray:
    """Mean-ratio quality (n_tet,) of a mesh's tetrahedra, see :func:`.topology.mean_ratios`."""
    return mean_ratios(mesh.points, mesh.tetrahedra)


def mesh_quality(mesh: TissueMesh, *, expected_volume: float | None = None) -> Quality:
    """Figures of ``mesh``; ``expected_volume`` [m^3] is the analytic limb's (see
    :func:`.build.limb_volume`)."""
    ratio = mean_ratio(mesh)
    edges = edges_of(mesh.tetrahedra, EDGES)
    volumes = true_volumes(mesh)
    per_tissue = np.bincount(mesh.region, weights=volumes, minlength=len(mesh.region_names))
    return Quality(
        tetrahedra=len(mesh.tetrahedra),
        vertices=len(mesh.points),
        p2_displacements=3 * (len(mesh.points) + len(edges)),
        least=float(ratio.min()),
        median=float(np.median(ratio)),
        volume=float(volumes.sum()),
        volumes={name: float(v) for name, v in zip(mesh.region_names, per_tissue, strict=True)},
        expected_volume=expected_volume,
    )


def check_mesh(mesh: TissueMesh, min_quality: float = 0.0) -> None:
    """Raise :class:`MeshError` for the first thing wrong with ``mesh``; return quietly when it is sound."""
    _check_arrays(mesh)
    check_shape(mesh, min_quality)
    _check_duplicates(mesh)
    _check_faces(mesh)
    _check_hanging(mesh)
    _check_one_piece(mesh)


def check_count(mesh: TissueMesh, most: float) -> None:
    """Raise :class:`MeshTooLarge` where ``mesh`` has more tetrahedra than ``most``."""
    if len(mesh.tetrahedra) > most:
        raise MeshTooLarge(
            f"the mesh has {len(mesh.tetrahedra)} tetrahedra, mesh.max_elements allows {most:g}; "
            "raise it, or enlarge mesh.size_grid and mesh.size_contact"
        )


def _check_arrays(mesh: TissueMesh) -> None:
    if not len(mesh.tetrahedra) or mesh.tetrahedra.shape[1] != 4:
        raise MeshError("the mesh has no tetrahedra; give a volume mesh of 4-node tetrahedra, not a surface")
    if not np.isfinite(mesh.points).all():
        raise MeshError(f"{int((~np.isfinite(mesh.points)).any(axis=1).sum())} points are not finite; repair the file")
    if mesh.tetrahedra.min() < 0 or mesh.tetrahedra.max() >= len(mesh.points):
        raise MeshError(
            f"tetrahedra refer to point {int(mesh.tetrahedra.max())}, but there are {len(mesh.points)}; repair the file"
        )
    if len(mesh.region) != len(mesh.tetrahedra):
        raise MeshError(f"{len(mesh.region)} region numbers for {len(mesh.tetrahedra)} tetrahedra; need one for each")
    if mesh.region.min() < 0 or mesh.region.max() >= len(mesh.region_names):
        raise MeshError(
            f"region numbers reach from {mesh.region.min()} to {mesh.region.max()}, but only "
            f"{len(mesh.region_names)} tissues are named ({', '.join(mesh.region_names)}); name every region"
        )
    count = np.bincount(mesh.region, minlength=len(mesh.region_names))
    if (count == 0).any():
        empty = mesh.region_names[int(np.argmin(count))]
        raise MeshError(f"region '{empty}' contains no tetrahedron; remove it or use smaller elements")


def check_shape(mesh: TissueMesh, min_quality: float) -> None:
    """Raise :class:`MeshError` where a tetrahedron is inverted, flat, or of less mean ratio than ``min_quality``."""
    inverted = int((mesh.volumes <= 0).sum())
    if inverted:
        raise MeshError(
            f"{inverted} of {len(mesh.volumes)} tetrahedra are inverted or flat; rebuild or repair the mesh"
        )
    ratio = mean_ratio(mesh)
    if ratio.min() < min_quality:
        worst = int(ratio.argmin())
        x, y, z = mesh.points[mesh.tetrahedra[worst]].mean(axis=0) * 1e3
        raise MeshError(
            f"the worst tetrahedron, in {mesh.region_names[mesh.region[worst]]} at ({x:.1f}, {y:.1f}, {z:.1f}) mm, has "
            f"quality {ratio.min():.3g}, need {min_quality:g}; change mesh sizes or lower mesh.min_quality"
        )


def _check_duplicates(mesh: TissueMesh) -> None:
    used = np.unique(mesh.tetrahedra)
    size = float(np.ptp(mesh.points[used], axis=0).max())
    pairs = cKDTree(mesh.points[used]).query_pairs(1e-9 * size)
    if pairs:
        raise MeshError(
            f"{len(pairs)} pairs of points coincide, so that neighbours are not joined; merge duplicate points"
        )


def _check_faces(mesh: TissueMesh) -> None:
    n = len(mesh.points)
    faces = mesh.tetrahedra[:, FACES].reshape(-1, 3)
    _, first, count = np.unique(keys(faces, n), return_index=True, return_counts=True)
    if count.max() > 2:
        raise MeshError(f"{int((count > 2).sum())} faces belong to more than two tetrahedra; remove overlapping cells")
    if not len(mesh.facets.get("skin", ())):
        raise MeshError("the mesh has no skin: no boundary facet could be named so; check the surface's classification")
    boundary = faces[first[count == 1]]
    whole = [f for name, f in mesh.facets.items() if name != "underside" and not name.startswith("contact")]
    unnamed = int((~is_member(boundary, np.vstack(whole), n)).sum())
    if unnamed:
        raise MeshError(f"{unnamed} boundary facets are neither skin, bone, end nor symmetry; the mesh is open inside")
    for name, facets in mesh.facets.items():
        if not is_member(facets, boundary, n).all():
            raise MeshError(f"facets '{name}' do not all lie on the boundary of the mesh; rebuild them")
    around = np.unique(keys(boundary[:, SIDES].reshape(-1, 2), n), return_counts=True)[1]
    if (around != 2).any():
        raise MeshError(
            f"the boundary is not a closed surface: {int((around != 2).sum())} of its edges do not join exactly two "
            "facets; repair the mesh where parts touch in an edge or a crack runs"
        )


def _check_hanging(mesh: TissueMesh) -> None:
    """A vertex in the middle of another element's edge means that neighbours do not conform."""
    n = len(mesh.points)
    named = np.vstack(list(mesh.facets.values()))
    edges = edges_of(named, SIDES)
    start, end = mesh.points[edges[:, 0]], mesh.points[edges[:, 1]]
    length = edge_lengths(mesh.points, edges)
    vertices = np.unique(named)
    hits = cKDTree(mesh.points[vertices]).query_ball_point((start + end) / 2, 0.499 * length)
    edge = np.repeat(np.arange(len(edges)), [len(h) for h in hits])
    vertex = vertices[np.concatenate([np.asarray(h, dtype=np.int64) for h in hits])] if len(edge) else edge
    away = np.linalg.norm(np.cross(mesh.points[vertex] - start[edge], end[edge] - start[edge]), axis=1) / length[edge]
    hanging = np.unique(vertex[away < 1e-7 * length[edge]])
    if len(hanging):
        x, y, z = mesh.points[hanging[0]] * 1e3
        raise MeshError(
            f"{len(hanging)} of {n} vertices hang on another facet's edge, the first at ({x:.2f}, {y:.2f}, {z:.2f}) "
            "mm; the mesh does not conform there: split the neighbours too"
        )


def _check_one_piece(mesh: TissueMesh) -> None:
    t = mesh.tetrahedra
    labels = pieces(len(mesh.points), np.column_stack([t[:, :3].ravel(), t[:, 1:].ravel()]))
    parts = len(np.unique(labels[np.unique(t)]))
    if parts > 1:
        raise MeshError(f"the mesh falls into {parts} separate parts; join them or keep one")


@dataclass(frozen=True)
class Resolution:
    """Nodes per shear wavelength and per 1/e decay length of one tissue: the least anywhere, and near the ports."""

    tissue: str
    per_wavelength: float
    per_wavelength_near_ports: float
    per_decay: float
    per_decay_near_ports: float


_NEAREST = 1.5  # of the distance of a deep tissue's nearest element: what of it is called near the ports


def nodes_per_wavelength(
    mesh: TissueMesh,
    element: str,
    speeds: Mapping[str, float],
    decay: Mapping[str, float],
    f_max: float,
    *,
    ports: tuple[Port, ...] = (),
    reach: float = 0.006,
) -> tuple[Resolution, ...]:
    """Resolution of waves of ``f_max`` [Hz], tissue by tissue, by the root-mean-square edge of each element.

    ``speeds`` maps tissues to shear wave speeds [m/s], ``decay`` to 1/e decay lengths [m], both at ``f_max``;
    ``element`` is P1, P2, P2/P3 or P3. "Near" is within ``reach`` [m] of a port, or of a contact where none are given;
    of a tissue that lies deeper, within one and a half times the distance of its nearest element.
    """
    corner = mesh.points[mesh.tetrahedra]
    squared = ((corner[:, EDGES[:, 0]] - corner[:, EDGES[:, 1]]) ** 2).sum(axis=2)
    spacing = np.sqrt(squared.mean(axis=1)) / tetrahedron_orders(mesh, ports, element)
    if ports:
        places = positions(ports)
    else:
        under = [mesh.points[f].reshape(-1, 3) for name, f in mesh.facets.items() if name.startswith("contact")]
        places = np.vstack(under) if under else mesh.points[np.unique(mesh.facets["skin"])]
    gap = cKDTree(places).query(corner.mean(axis=1))[0]
    found = []
    for i, tissue in enumerate(mesh.region_names):
        here = mesh.region == i
        if tissue not in speeds or not here.any():
            continue
        wave, fade = speeds[tissue] / f_max, decay.get(tissue, np.inf)
        near = here & (gap < max(reach, _NEAREST * float(gap[here].min())))
        most, close = float(spacing[here].max()), float(spacing[near].max())
        found.append(Resolution(tissue, wave / most, wave / close, fade / most, fade / close))
    return tuple(found)
