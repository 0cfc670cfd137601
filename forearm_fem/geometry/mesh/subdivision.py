"""The skin with its triangles cut in four: fields of higher order look like their vertices' alone where these are far
apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...typing import IntArray
from .tissue_mesh import Bends, TissueMesh
from .topology import SIDES, edges_of, keys


def skin_edges(mesh: TissueMesh) -> IntArray:
    """Vertices (n, 2) of the skin's edges, each once, in the order of their keys."""
    return edges_of(mesh.facets["skin"], SIDES)


def with_finer_skin(mesh: TissueMesh) -> TissueMesh:
    """The mesh with the middles of :func:`skin_edges`, bent as they are, after its own points, and skin facets cut in
    four.

    For pictures and places on the skin: tetrahedra, and what is bounded by them, stay as they are.
    """
    edges, n = skin_edges(mesh), len(mesh.points)
    known = keys(edges, n)
    skin = mesh.facets["skin"]
    middle = [n + np.searchsorted(known, keys(skin[:, side], n)) for side in SIDES]
    (a, b, c), (ab, bc, ca) = skin.T, middle
    cut = np.stack([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]).transpose(2, 0, 1).reshape(-1, 3)
    middles = mesh.points[edges].mean(axis=1) + mesh.bends.on(edges)
    return replace(mesh, points=np.vstack([mesh.points, middles]), facets={"skin": cut}, bends=Bends())
