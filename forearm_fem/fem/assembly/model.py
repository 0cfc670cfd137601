"""From a mesh, tissues and supports to the operator and the port vectors: all that the solvers need."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import block_array, csc_array, csr_array, vstack

from ...errors import GeometryError
from ...geometry.mesh.tissue_mesh import TissueMesh
from ...ports import Port
from ...scenario.limb import Membrane, Patch, Supports
from ...tissue import Tissue
from ...typing import FloatArray, IntArray
from ..kernels.matrices import added, congruent, sorted_upper
from ..space.constraints import LinearConstraints, RigidDisc, constraints
from ..space.numbering import MixedSpace
from ..space.orders import Orders, element_orders
from .bending import facet_bending
from .boundary import (
    covered_area,
    facet_gradients,
    facet_mass,
    facet_membrane,
    force_share,
    middles_covered,
    port_functional,
    resting_nodes,
    rests,
    under_rectangle,
)
from .coefficients import Coefficient, is_polynomial, term_coefficient
from .operator import AffineOperator, affine_operator
from .thickness import Motion, thickness_terms, unmarked
from .tissues import TissueMatrices, constrained_matrices

_NO_PATCH = Patch()
_AT_A_TIME = 2  # tissues: each needs room for its matrices before constraints


@dataclass(frozen=True)
class ForearmModel:
    """Operator A(omega), port functionals and shares of force.

    ``functionals`` (n, n_port): displacement of port i is f_i . x; a unit force on port j loads the system with
    ``shares[j]`` f_j (shares differ from 1 on symmetry planes only).
    """

    space: MixedSpace
    constraints: LinearConstraints
    operator: AffineOperator
    ports: tuple[Port, ...]
    functionals: FloatArray
    shares: FloatArray

    def displacements(self, x: NDArray[Any]) -> NDArray[Any]:
        """Displacement components (n_nodes, 3, ...) of solutions ``x`` (n, ...), constraints undone."""
        full = self.constraints.transform @ x[: self.operator.n_displacements]
        return np.asarray(full.reshape(self.space.n_nodes, 3, *x.shape[1:]))

    @cached_property
    def degrees_of_freedom(self) -> tuple[int, int]:
        """Displacement and pressure unknowns that are solved for."""
        return self.operator.n_displacements, self.operator.n - self.operator.n_displacements


Matrices = list[tuple[str, csr_array]]


def build_model(
    mesh: TissueMesh,
    ports: tuple[Port, ...],
    tissues: Mapping[str, Tissue],
    supports: Supports,
    membrane: Membrane,
    *,
    element: str = "P2",
    patch: Patch = _NO_PATCH,
    motion: Motion | None = None,
) -> ForearmModel:
    """Assemble everything; with ``motion`` terms of other thicknesses as well.

    Raises GeometryError for contacts that the mesh cannot carry, and a patch beside it.
    """
    orders = element_orders(mesh, ports, element)
    space, kept = orders.high, _constraints(orders, ports, supports)
    rules = LinearConstraints(orders.carried(kept.transform), kept.masters)
    order = _order(space, rules)
    kept, rules = kept.renumbered(order), rules.renumbered(order)
    names, fibrous = mesh.region_names, [tissues[name].fibres != 1 for name in mesh.region_names]

    def assembled(region: int) -> TissueMatrices:
        """Matrices of one tissue."""
        return _halved(constrained_matrices(orders, region, kept.transform, fibres=fibrous[region]))

    with ThreadPoolExecutor(_AT_A_TIME) as pool:  # sparse products and sums run without Python's lock
        parts = list(pool.map(assembled, range(len(names))))
    displacement: Matrices = []
    for name, part in zip(names, parts, strict=True):
        displacement += [(f"shear {name}", part.shear), (f"mass {name}", part.mass)]
        if part.fibres is not None:
            displacement.append((f"fibres {name}", part.fibres))
    displacement += _boundaries(space, supports, membrane, patch, rules.transform)
    more = dict[str, csr_array]()
    if motion is not None:
        ends = {name: matrix for name, matrix in displacement if name.startswith("dashpots ")}
        more = thickness_terms(
            motion,
            {**_by_tissue(names, parts), **ends},
            lambda other: _moved(orders, kept, rules, supports, other, fibrous),
        )
    operator = _with_pressure(
        names, parts, tissues, displacement, lambda name: term_coefficient(name, tissues, supports, membrane, patch),
        more,
    )  # fmt: skip
    functionals = np.zeros((operator.n, len(ports)))
    for i, port in enumerate(ports):
        functionals[: operator.n_displacements, i] = _functional(space, port, rules)
    shares = np.array([force_share(space, p) for p in ports])
    return ForearmModel(space, rules, operator, ports, functionals, shares)


def _by_tissue(names: Sequence[str], parts: Sequence[TissueMatrices]) -> dict[str, csr_array]:
    """Matrices of all tissues by what they are, such as "shear fat" and "divergence fat"."""
    kinds = {"shear": "shear", "mass": "mass", "divergence": "incompressibility", "pressure_mass": "compression",
             "fibres": "fibres"}  # fmt: skip
    return {f"{kind} {name}": matrix for name, part in zip(names, parts, strict=True)
            for of, kind in kinds.items() if (matrix := getattr(part, of)) is not None}  # fmt: skip


def _halved(part: TissueMatrices) -> TissueMatrices:
    """The same without what lies below the diagonals of symmetric matrices, which is half of all that a solve keeps."""
    fibres = None if part.fibres is None else sorted_upper(part.fibres)
    return replace(part, shear=sorted_upper(part.shear), mass=sorted_upper(part.mass), fibres=fibres)


def _moved(
    orders: Orders,
    kept: LinearConstraints,
    rules: LinearConstraints,
    supports: Supports,
    mesh: TissueMesh,
    fibrous: Sequence[bool],
) -> dict[str, csr_array]:
    """The same, and the dashpots of cut ends, on a ``mesh`` whose points have moved."""
    there = replace(orders, low=replace(orders.low, mesh=mesh), high=replace(orders.high, mesh=mesh))
    names = mesh.region_names
    parts = [_halved(constrained_matrices(there, r, kept.transform, fibres=f)) for r, f in enumerate(fibrous)]
    found = _by_tissue(names, parts)
    if supports.ends == "absorb" and "end" in mesh.facets:
        found |= {name: congruent(m, rules.transform) for name, m in _dashpots(there.high, mesh.facets["end"])}
    return found


def readings(model: ForearmModel, ports: Sequence[Port]) -> csr_array:
    """Matrix (k, n_u) that reads the displacements of points that are no ports of the ``model``."""
    rows = [csr_array(_functional(model.space, p, model.constraints)[None]) for p in ports]
    return csr_array(vstack(rows)) if rows else csr_array((0, model.operator.n_displacements))


def _order(space: MixedSpace, rules: LinearConstraints) -> IntArray:
    """Unknowns tissue by tissue, in each along the longest side, interfaces between their tissues.

    Products with a tissue's matrices then find rows together, and more of x in the cache.
    """
    columns = csc_array(rules.transform)
    node = columns.indices[columns.indptr[:-1]] // 3  # one that moves with each unknown
    side = int(np.argmax(np.ptp(space.node_points, axis=0)))
    # of the regions that each node belongs to
    first, last = np.full(space.n_nodes, len(space.mesh.region_names)), np.zeros(space.n_nodes, dtype=np.int64)
    for region in range(len(space.mesh.region_names)):
        mine = space.nodes[space.mesh.region == region].ravel()
        first[mine], last[mine] = np.minimum(first[mine], region), region
    return np.asarray(np.lexsort((space.node_points[node, side], (first + last)[node])))


def _functional(space: MixedSpace, port: Port, rules: LinearConstraints) -> FloatArray:
    if port.name in rules.masters and port.kind == "contact":
        return np.asarray(np.eye(1, rules.transform.shape[1], rules.masters[port.name])[0])
    return np.asarray(rules.transform.T @ port_functional(space, port))


def _constraints(orders: Orders, ports: tuple[Port, ...], supports: Supports) -> LinearConstraints:
    """Rules for the kept nodes; those that no tetrahedron has are held, because nothing else does."""
    facets = orders.high.mesh.facets
    fixed = ("bone", supports.bone == "rigid"), ("end", supports.ends == "fixed")
    held = [facets[name] for name, still in fixed if still and len(facets.get(name, ()))]
    nodes = [orders.unused(), *(orders.kept_on(f) for f in held)]
    if supports.underside == "fixed":
        nodes.append(orders.kept_of(resting_nodes(orders.high, facets["skin"])))
    planes = {
        axis: orders.kept_on(facets[name]) for name, axis in (("symmetry x", 0), ("symmetry y", 1)) if name in facets
    }
    discs = tuple(_disc(orders, p) for p in ports if p.kind == "contact" and p.contact != "pressure")
    return constraints(orders.spread.shape[1], np.unique(np.concatenate(nodes)), planes, discs)


def _disc(orders: Orders, port: Port) -> RigidDisc:
    facets = orders.high.mesh.facets.get(f"contact {port.name}", np.zeros((0, 3), dtype=np.int64))
    nodes = orders.kept_on(facets) if len(facets) else np.zeros(0, dtype=np.int64)
    return RigidDisc(port.name, nodes, np.array(port.axis), port.contact == "bonded")


def _boundaries(
    space: MixedSpace, supports: Supports, membrane: Membrane, patch: Patch, transform: csr_array
) -> Matrices:
    facets = space.mesh.facets
    result: Matrices = []
    if supports.ends == "absorb" and len(facets.get("end", ())):
        result += _dashpots(space, facets["end"])
    skin = facets["skin"]
    if supports.underside == "foam" and covered_area(space, skin, rests):
        # by the normal at each point: far from the device facets are large, and whole ones err by a sixth of the area
        result.append(("foam", facet_mass(space, skin, rests)))
    if membrane.mass:
        result.append(("skin mass", facet_mass(space, skin)))
    if membrane.tension:
        result.append(("skin tension", facet_gradients(space, skin)))
    if membrane.stiffness or membrane.viscosity:
        result.append(("skin membrane", facet_membrane(space, skin)))
    result += _patch(space, patch) if patch.is_on else []
    return [(name, congruent(matrix, transform)) for name, matrix in result]


def _patch(space: MixedSpace, patch: Patch) -> Matrices:
    """Mass, membrane and bending of the ``patch`` on facets of the skin whose middle it covers seen from above.

    Tape so outweighs skin that a facet with a part of it would be as stiff as a whole one: edges follow facets.
    """
    skin = middles_covered(space, space.mesh.facets["skin"], under_rectangle(patch.length, patch.width))
    if not len(skin):
        raise GeometryError("tissues.patch: no skin lies under it; make length and width larger, or leave it out")
    result: Matrices = [("patch mass", facet_mass(space, skin))] if patch.mass else []
    if patch.stiffness or patch.viscosity:
        result.append(("patch membrane", facet_membrane(space, skin)))
    if patch.bending:
        result.append(("patch bending", facet_bending(space, skin, under_rectangle(np.inf, np.inf))))
    return result


def _dashpots(space: MixedSpace, facets: IntArray) -> Matrices:
    """Viscous dashpots in all directions on the cut ends, per tissue.

    The shear impedance is taken for the normal direction too: rho c_p would be a wall at 10-500 Hz.
    """
    tets, _ = space.owners(facets)
    regions = space.mesh.region[tets]
    result: Matrices = []
    for region, name in enumerate(space.mesh.region_names):
        mine = facets[regions == region]
        if len(mine):
            result.append((f"dashpots {name}", facet_mass(space, mine)))
    return result


def _with_pressure(
    names: tuple[str, ...],
    parts: list[TissueMatrices],
    tissues: Mapping[str, Tissue],
    displacement: Matrices,
    coefficient: Callable[[str], Coefficient],
    more: Mapping[str, csr_array],
) -> AffineOperator:
    """Saddle system [[K, -B^T], [-B, -M_p/bulk]] with pressures scaled to the size of the stiffness; ``more`` terms are
    those of other thicknesses."""
    divergence = added([part.divergence for part in parts])
    storage = added([part.pressure_mass / tissues[name].bulk for name, part in zip(names, parts, strict=True)])
    n_p, n_u = divergence.shape
    scale = _pressure_scale([(m, coefficient(name)) for name, m in displacement], divergence)
    whole: Matrices = [(name, _enlarged(m, n_u + n_p)) for name, m in displacement]

    def coupling(part: csr_array) -> csr_array:
        """Of pressures and displacements."""
        return csr_array(block_array([[None, -scale * part.T], [-scale * part, None]]))

    def compressed(part: csr_array) -> csr_array:
        """Of pressures."""
        return csr_array(block_array([[csr_array((n_u, n_u)), None], [None, -(scale**2) * part]]))

    whole += [("incompressibility", coupling(divergence)), ("compression", compressed(storage))]
    for name, m in more.items():
        kind, _, tissue = unmarked(name)[0].partition(" ")
        if kind == "incompressibility":
            whole.append((name, coupling(m)))
        elif kind == "compression":
            whole.append((name, compressed(m / tissues[tissue].bulk)))
        else:
            whole.append((name, _enlarged(m, n_u + n_p)))
    return affine_operator([(name, m, coefficient(name)) for name, m in whole], n_u, scale)


def _enlarged(matrix: csr_array, n: int) -> csr_array:
    """The matrix with empty rows and columns up to ``n``."""
    indptr = np.concatenate([matrix.indptr, np.full(n - matrix.shape[0], matrix.indptr[-1])])
    return csr_array((matrix.data, matrix.indices, indptr), shape=(n, n))


def _pressure_scale(displacement: list[tuple[csr_array, Coefficient]], divergence: csr_array) -> float:
    """Pascals per pressure unknown that make the coupling as large as a typical stiffness.

    That is the static one; at 100 Hz where a modulus is no polynomial, as a springpot has no static stiffness.
    """
    stiffness = sum(
        np.abs(complex(c.at(np.array(0.0 if is_polynomial(c) else 2 * np.pi * 100.0)))) * m.diagonal()
        for m, c in displacement
    )
    return float(np.median(stiffness) / np.median(np.abs(divergence.data)))
