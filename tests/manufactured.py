r"""Manufactured complex solutions: waves that solve the equations for a body force and tractions computed exactly.

:math:`u = \sum_m c_m (i k_m\times b + d/\kappa)\,e^{i k_m\cdot x}` and
:math:`p = -\sum_m c_m\, i k_m\cdot d\, e^{i k_m\cdot x}`, so that :math:`p = -\kappa\nabla\cdot u` for every bulk
modulus, infinity included. The waves are combined so that u vanishes on x = 0, where the block is held; all other
faces carry the exact traction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from skfem.quadrature import get_quadrature
from skfem.refdom import RefTet, RefTri

from forearm_fem.fem.assembly.model import build_model
from forearm_fem.fem.linear.factor import make_factor, refined_solve
from forearm_fem.fem.space.numbering import MixedSpace, facet_points, tabulate
from forearm_fem.geometry.mesh.tissue_mesh import triangle_normals
from forearm_fem.scenario.limb import FreeUnderside, Membrane
from forearm_fem.tissue import KelvinVoigt, Tissue
from forearm_fem.typing import ComplexArray, FloatArray, IntArray
from forearm_fem.verification.scenes import block_mesh

SIDE = 0.02
OMEGA = 2 * np.pi * 120.0
_QUADRATURE = 9


@dataclass(frozen=True)
class ExactWaves:
    """Sum of plane waves: ``vectors`` k, ``solenoidal`` amplitudes i k x b, ``volume`` amplitudes d, all (m, 3).

    d is in Pa m: divided by the bulk modulus it is a displacement.
    """

    vectors: FloatArray
    solenoidal: ComplexArray
    volume: ComplexArray

    def amplitudes(self, bulk: float) -> ComplexArray:
        """Displacement amplitudes (m, 3) [m]."""
        return np.asarray(self.solenoidal + self.volume / bulk)

    def phase(self, x: FloatArray) -> ComplexArray:
        """Waves (m, ...) at points (3, ...)."""
        return np.asarray(np.exp(1j * np.tensordot(self.vectors, x, 1)))

    def displacement(self, x: FloatArray, bulk: float) -> ComplexArray:
        """u (3, ...) at points (3, ...)."""
        return np.tensordot(self.amplitudes(bulk).T, self.phase(x), 1)

    def gradient(self, x: FloatArray, bulk: float) -> ComplexArray:
        """du_i/dx_j (3, 3, ...)."""
        outer = 1j * np.einsum("mi,mj->ijm", self.amplitudes(bulk), self.vectors)
        return np.tensordot(outer, self.phase(x), 1)

    def pressure(self, x: FloatArray) -> ComplexArray:
        """p (...) [Pa], positive in compression."""
        return np.tensordot(-1j * np.sum(self.vectors * self.volume, axis=1), self.phase(x), 1)

    def body_force(self, x: FloatArray, tissue: Tissue) -> ComplexArray:
        """f = -div sigma - rho omega^2 u (3, ...) [N/m^3]."""
        k, a, mu = self.vectors, self.amplitudes(tissue.bulk), complex(tissue.modulus.at(OMEGA))
        along = np.sum(k * a, axis=1)[:, None] * k / 3
        inner = mu * (np.sum(k * k, axis=1)[:, None] * a + along) - tissue.density * OMEGA**2 * a
        squeeze = np.sum(k * self.volume, axis=1)[:, None] * k  # grad p
        return np.tensordot((inner + squeeze).T, self.phase(x), 1)

    def stress(self, x: FloatArray, tissue: Tissue) -> ComplexArray:
        """sigma (3, 3, ...) [Pa]."""
        g, eye = self.gradient(x, tissue.bulk), np.eye(3).reshape(3, 3, *([1] * (x.ndim - 1)))
        deviator = g + np.swapaxes(g, 0, 1) - (2 / 3) * eye * np.trace(g)
        return np.asarray(complex(tissue.modulus.at(OMEGA)) * deviator - eye * self.pressure(x))


def waves() -> ExactWaves:
    """About half a wave across the block, zero with its slope on x = 0."""
    q = np.array([[0.0, 1.7, -1.3], [2.9, 1.7, -1.3], [-2.9, 1.7, -1.3]]) / SIDE
    c = np.array([1.0, -0.5, -0.5])[:, None]
    b = np.array([0.8 - 0.3j, 0.5j, -0.6 + 0.2j]) * SIDE
    d = np.array([0.5 + 0.4j, -0.8, 0.3 - 0.6j]) * 3e5 * SIDE
    return ExactWaves(q, c * 1j * np.cross(q, b), (c * d).astype(complex))


@dataclass(frozen=True)
class MmsErrors:
    """Relative errors of displacement (L2, H1 seminorm) and pressure (L2), with the unknowns spent."""

    l2: float
    h1: float
    pressure: float
    unknowns: int


def manufactured_errors(element: str, n: int, bulk: float, *, jump: float = 1.0) -> MmsErrors:
    """Solve on an n^3 block; ``jump`` is the modulus ratio between its two halves (1 = one tissue)."""
    tissues = {"soft": _tissue("soft", 1.0, bulk), "stiff": _tissue("stiff", jump, bulk)}
    names = ("soft",) if jump == 1.0 else ("soft", "stiff")
    mesh = block_mesh((n, n, n), (SIDE,) * 3, facets={"end": ("x0",), "rest": _LOADED}, regions=names, bend=0.08)
    model = build_model(mesh, (), tissues, FreeUnderside(ends="fixed"), Membrane(), element=element)
    exact, space = waves(), model.space
    parts = [tissues[name] for name in names]
    load = strong_load(space, exact, parts[0]) if jump == 1.0 else weak_load(space, exact, parts)
    right = np.zeros(model.operator.n, dtype=complex)
    right[: model.operator.n_displacements] = model.constraints.transform.T @ load
    factor = make_factor(model.operator, OMEGA, "auto", single=False)
    data = model.operator.data(OMEGA)
    factor.factorise(data)
    x: ComplexArray = refined_solve(factor, model.operator.matrix(data), right[:, None]).values[:, 0]
    factor.release()
    u = model.displacements(x)
    p = x[model.operator.n_displacements :] * model.operator.pressure_scale
    points, weights = get_quadrature(RefTet, _QUADRATURE)
    values, slopes = tabulate(space.pair.displacement, points)
    pressures, _ = tabulate(space.pair.pressure, points)
    places, inverse = _points(space, points), np.linalg.inv(space.jacobians)
    local = u[space.nodes]
    measure = np.abs(np.linalg.det(space.jacobians))[:, None] * weights
    found = np.einsum("ebi,bq->ieq", local, values, optimize=True)
    slope = np.einsum("ebi,ekj,bkq->ijeq", local, inverse, slopes, optimize=True)
    squeeze = np.einsum("eb,bq->eq", p[space.pressures], pressures)
    return MmsErrors(
        _relative(found, exact.displacement(places, bulk), measure),
        _relative(slope, exact.gradient(places, bulk), measure),
        _relative(squeeze, exact.pressure(places), measure),
        u.size + p.size,
    )


_LOADED = ("x1", "y0", "y1", "z0", "z1")


def _tissue(name: str, factor: float, bulk: float) -> Tissue:
    return Tissue(name, 1050.0, KelvinVoigt(6e3 * factor, 4.0 * factor), bulk)


def strong_load(space: MixedSpace, exact: ExactWaves, tissue: Tissue) -> ComplexArray:
    """Load vector (n_u,) of the body force and of the tractions on the facets "rest"."""
    points, weights = get_quadrature(RefTet, _QUADRATURE)
    values, _ = tabulate(space.pair.displacement, points)
    force = exact.body_force(_points(space, points), tissue)
    volume = np.abs(np.linalg.det(space.jacobians))
    part = np.einsum("ieq,bq,q,e->ieb", force, values, weights, volume, optimize=True)
    inside = _scatter_vector(space, space.nodes, part)
    points, weights = get_quadrature(RefTri, _QUADRATURE)
    facets = space.mesh.facets["rest"]
    tets, local = space.owners(facets)
    normals, areas = _facet_normals(space.mesh.points, facets)
    load = np.zeros(space.n_displacements, dtype=complex)
    for f in range(4):
        mine = local == f
        place = facet_points(f, points)
        values, _ = tabulate(space.pair.displacement, place)
        stress = exact.stress(_points(space, place)[:, tets[mine]], tissue)
        traction = np.einsum("ijeq,ej->ieq", stress, normals[mine])
        part = np.einsum("ieq,bq,q,e->ieb", traction, values, weights, 2 * areas[mine], optimize=True)
        load += _scatter_vector(space, space.nodes[tets[mine]], part)
    return inside + load


def _points(space: MixedSpace, reference: FloatArray) -> FloatArray:
    """Places (3, n_tet, q) of reference points (3, q) in every tetrahedron."""
    corner = space.mesh.points[space.vertices[:, 0]]
    return np.asarray(corner.T[:, :, None] + np.einsum("eik,kq->ieq", space.jacobians, reference))


def _scatter_vector(space: MixedSpace, nodes: IntArray, part: ComplexArray) -> ComplexArray:
    """Sum contributions (3, n_tet, nb) into (n_u,)."""
    out = np.zeros((space.n_nodes, 3), dtype=complex)
    for i in range(3):
        np.add.at(out[:, i], nodes, part[i])
    return out.ravel()


def weak_load(space: MixedSpace, exact: ExactWaves, tissues: list[Tissue]) -> ComplexArray:
    """Load vector (n_u,) as the weak form of the exact solution: interface tractions come with it.

    Displacement and pressure are the same field in all tissues, for which their bulk moduli must agree.
    """
    points, weights = get_quadrature(RefTet, _QUADRATURE)
    values, slopes = tabulate(space.pair.displacement, points)
    places, volume = _points(space, points), np.abs(np.linalg.det(space.jacobians))
    inverse = np.linalg.inv(space.jacobians)
    load = np.zeros(space.n_displacements, dtype=complex)
    for region, tissue in enumerate(tissues):
        mine = space.mesh.region == region
        x, v = places[:, mine], volume[mine]
        stress = exact.stress(x, tissue)
        inertia = -tissue.density * OMEGA**2 * exact.displacement(x, tissues[0].bulk)
        gradient = np.einsum("eki,bkq->iebq", inverse[mine], slopes, optimize=True)
        part = np.einsum("ijeq,jebq,q,e->ieb", stress, gradient, weights, v, optimize=True)
        part += np.einsum("ieq,bq,q,e->ieb", inertia, values, weights, v, optimize=True)
        load += _scatter_vector(space, space.nodes[mine], part)
    return load


def _relative(found: ComplexArray, truth: ComplexArray, measure: FloatArray) -> float:
    """Relative L2 error."""
    return float(np.sqrt(np.sum(np.abs(found - truth) ** 2 * measure) / np.sum(np.abs(truth) ** 2 * measure)))


def orders(errors: list[MmsErrors], counts: list[int]) -> tuple[float, float, float]:
    """Observed orders of displacement in L2, in H1, and of pressure, from the last two meshes."""
    ratio = np.log(counts[-1] / counts[-2])
    fine, coarse = errors[-1], errors[-2]
    pairs = ((coarse.l2, fine.l2), (coarse.h1, fine.h1), (coarse.pressure, fine.pressure))
    l2, h1, pressure = (float(np.log(a / b) / ratio) for a, b in pairs)
    return l2, h1, pressure


def _facet_normals(points: FloatArray, facets: IntArray) -> tuple[FloatArray, FloatArray]:
    """Unit normals (k, 3), in the facets' own orientation, and areas (k,) [m^2]."""
    cross = triangle_normals(points, facets)
    length = np.linalg.norm(cross, axis=1)
    return cross / length[:, None], length / 2
