"""Marking the skin under each cone as a named boundary."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...errors import MeshError
from ...ports import Port
from ...typing import BoolArray, FloatArray, IntArray
from ..mesh.refinement import rim_edges
from ..mesh.tissue_mesh import TissueMesh
from ..mesh.topology import edge_lengths, triangle_normals

_LEAST_AREA = 0.9
_ON_RIM = 1e-7  # relative to the radius


def from_axis(points: FloatArray, port: Port) -> FloatArray:
    """Distance (n,) [m] of points (n, 3) from the contact's axis."""
    away = points - np.asarray(port.position)
    axis = np.asarray(port.axis)
    return np.asarray(np.linalg.norm(away - np.outer(away @ axis, axis), axis=1))


def near(points: FloatArray, port: Port) -> BoolArray:
    """Points within two radii of the contact: the axis meets a limb a second time on its underside."""
    return np.asarray(np.linalg.norm(points - np.asarray(port.position), axis=1) < 2 * port.radius)


def check_contact_areas(mesh: TissueMesh, ports: tuple[Port, ...]) -> None:
    """Raise :class:`MeshError` when a contact's facets do not fill its disc (cut in half by symmetry planes)."""
    for port in (p for p in ports if p.kind == "contact"):
        part = facet_area(mesh.points, mesh.facets[f"contact {port.name}"]) / _disc_area(mesh, port)
        if not _LEAST_AREA < part < 1.1:
            raise MeshError(
                f"the facets of contact {port.name} cover {100 * part:.0f} % of its disc, need {100 * _LEAST_AREA:g} % "
                "or more; set mesh.size_contact smaller"
            )


def with_true_rims(mesh: TissueMesh, ports: tuple[Port, ...], lead: float) -> TissueMesh:
    """The mesh with each rim moved until its polygon acts as the disc does.

    Seen along the axis the polygon gets the disc's area: on the circle it lacks 1 % of it at 25 edges, and the contact
    half of that in stiffness. A rigid disc is stiffer still by what elements cannot follow of the r^(-1/2) stress at
    its rim, as if its radius were larger by ``lead`` rim edges: it is drawn in by as much. Contacts that
    :func:`check_contact_areas` would refuse are left as they are.
    """
    points = mesh.points.copy()
    for port in (p for p in ports if p.kind == "contact"):
        centre, axis = np.asarray(port.position), np.asarray(port.axis)
        normals = triangle_normals(mesh.points, mesh.facets[f"contact {port.name}"])
        part = float(np.abs(normals @ axis).sum() / 2) / _disc_area(mesh, port)
        if part > _LEAST_AREA:
            edges = rim_edges(mesh, port.name)
            wanted = 1 - lead * float(edge_lengths(mesh.points, edges).mean()) / port.radius
            rim = np.unique(edges)
            away = mesh.points[rim] - centre
            across = away - np.outer(away @ axis, axis)
            points[rim] += (wanted * part**-0.5 - 1) * across
    return replace(mesh, points=points)


def _disc_area(mesh: TissueMesh, port: Port) -> float:
    """Area [m^2] of the part of the disc that is modelled."""
    planes = [name for name in mesh.facets if name.startswith("symmetry")]
    cuts = sum(abs(port.position["xy".index(name[-1])]) < 1e-12 for name in planes)
    return float(np.pi * port.radius**2 / 2**cuts)


def facet_area(points: FloatArray, facets: IntArray) -> float:
    """Total area [m^2] of triangles (k, 3)."""
    return float(np.linalg.norm(triangle_normals(points, facets), axis=1).sum() / 2)


def with_contacts(mesh: TissueMesh, ports: tuple[Port, ...]) -> TissueMesh:
    """The mesh with a boundary "contact <name>" for each contact among ``ports``."""
    skin = mesh.facets["skin"]
    named = {}
    for port in (p for p in ports if p.kind == "contact"):
        inside = near(mesh.points, port) & (from_axis(mesh.points, port) <= port.radius * (1 + _ON_RIM))
        chosen = skin[inside[skin].all(axis=1)]
        if not len(chosen):
            raise MeshError(
                f"no skin triangle lies under contact {port.name} of radius {port.radius * 1e3:.3g} mm; "
                "set mesh.size_contact well below it"
            )
        named[f"contact {port.name}"] = chosen
    return TissueMesh(mesh.points, mesh.tetrahedra, mesh.region, mesh.region_names, {**mesh.facets, **named})
