"""Slow, obvious versions of what the package does fast: scikit-fem's own forms, dense algebra, a rule of many nodes."""

from __future__ import annotations

import numpy as np
import skfem
from numpy.polynomial import legendre
from scipy import special
from skfem.helpers import ddot, div, dot, grad, sym_grad, trace


def skfem_mesh(space):
    """The mesh of ``space`` with the vertex order that the space was numbered with; of second order where it bends."""
    points, cells = np.ascontiguousarray(space.mesh.points.T), np.ascontiguousarray(space.vertices.T)
    straight = skfem.MeshTet(points, cells, validate=False)
    if not space.is_bent.any():
        return straight
    curved = skfem.MeshTet2.from_mesh(straight)
    n, bends, places = len(space.mesh.points), space.mesh.bends, curved.doflocs.copy()
    number = {tuple(edge): k for k, edge in enumerate(np.sort(curved.edges, axis=0).T.tolist())}
    at = [n + number[tuple(edge)] for edge in np.sort(bends.edges, axis=1).tolist()]
    places[:, at] += bends.offsets.T
    return skfem.MeshTet2(places, curved.t, validate=False)


def bases(space, region):
    """Vector displacement and scalar pressure bases on one tissue's tetrahedra (rule "9" is exact to degree 8)."""
    mesh, cells = skfem_mesh(space), np.flatnonzero(space.mesh.region == region)
    vector = skfem.ElementVector(space.pair.displacement)
    return [skfem.Basis(mesh, e, elements=cells, intorder=9) for e in (vector, space.pair.pressure)]


@skfem.BilinearForm
def shear(u, v, w):
    e, d = sym_grad(u), sym_grad(v)
    return 2 * ddot(e, d) - 2 / 3 * trace(e) * trace(d)


@skfem.BilinearForm
def fibres(u, v, w):
    e, d = sym_grad(u), sym_grad(v)
    return 4 * (e[0, 1] * d[0, 1] + e[0, 2] * d[0, 2])


@skfem.BilinearForm
def mass(u, v, w):
    return dot(u, v)


@skfem.BilinearForm
def divergence(u, q, w):
    return q * div(u)


@skfem.BilinearForm
def pressure_mass(p, q, w):
    return p * q


def tangential(gradient, n):
    """du_i/dx_j with the derivative along the normal taken out."""
    return gradient - np.einsum("ij...,j...,k...->ik...", gradient, n, n)


def in_plane(gradient, n):
    """Strain of the tangential displacement in the facet's plane."""
    flat = tangential(gradient, n)
    flat = flat - np.einsum("i...,k...,kj...->ij...", n, n, flat)
    return 0.5 * (flat + np.swapaxes(flat, 0, 1))


@skfem.BilinearForm
def surface_gradients(u, v, w):
    return ddot(tangential(grad(u), w.n), tangential(grad(v), w.n))


@skfem.BilinearForm
def membrane(u, v, w):
    e, d = in_plane(grad(u), w.n), in_plane(grad(v), w.n)
    return 2 * ddot(e, d) + 2 * trace(e) * trace(d)


def facet_basis(space, facets):
    """Vector displacement basis on boundary facets given by vertex triples."""
    mesh = skfem_mesh(space)
    found = {tuple(f): i for i, f in enumerate(np.sort(mesh.facets, axis=0).T)}
    numbers = np.array([found[tuple(f)] for f in np.sort(facets, axis=1)])
    return skfem.FacetBasis(mesh, skfem.ElementVector(space.pair.displacement), facets=numbers, intorder=9)


def dense(operator, omega):
    """The whole matrix A(omega), both triangles, dense."""
    upper = operator.upper(operator.data(omega)).toarray()
    return upper + upper.T - np.diag(np.diag(upper))


def dense_compliance(model, frequency):
    """Port compliance by numpy's dense solve."""
    x = np.linalg.solve(dense(model.operator, 2 * np.pi * frequency), model.functionals.astype(complex))
    return (model.functionals.T @ x) * model.shares


def transform(radial, k):
    """g(k) of one traction or receiver, by scipy."""
    x = k * radial.radius
    match radial.kind:
        case "ball":
            return special.spherical_jn(radial.degree, x)
        case "ring":
            return special.jv(radial.degree, x)
        case "mean":
            return 2 * special.jv(1, x) / x
        case _:
            return np.ones_like(k)


def product_weights(table, panel, nodes):
    """Integrals (n_node, n_columns) over ``panel`` of what is 1 at one of the ``nodes`` of a polynomial and 0 at the
    others, with each column's g_a g_b J_q(kd)/(2 pi): column by column, a thousand nodes each."""
    x, w = legendre.leggauss(1000)
    lo, hi = panel
    k, scale = 0.5 * (lo + hi) + 0.5 * (hi - lo) * x, 0.5 * (hi - lo)
    within = (nodes - 0.5 * (lo + hi)) / scale
    shapes = np.linalg.solve(legendre.legvander(within, len(nodes) - 1).T, legendre.legvander(x, len(nodes) - 1).T)
    columns = zip(table.a, table.b, table.order, table.distance, strict=True)
    parts = [
        transform(table.radials[a], k) * transform(table.radials[b], k) * special.jv(q, k * d) for a, b, q, d in columns
    ]
    return scale * (shapes * w) @ np.array(parts).T / (2 * np.pi)
