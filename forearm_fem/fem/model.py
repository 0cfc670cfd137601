"""From a mesh, tissues and supports to the operator and the port vectors: all that the solvers need."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import block_array, csr_array

from ..geometry.mesh import TissueMesh
from ..ports import Port
from ..scenario.supports import Supports
from ..scenario.tissues import Membrane
from ..tissue import Tissue
from ..typing import FloatArray, IntArray
from .assembly import ReferenceTensors, TissueMatrices, reference_tensors, tissue_matrices
from .boundary import facet_gradients, facet_mass, facet_membrane
from .coefficients import Coefficient, Polynomial
from .constraints import Constraints, RigidDisc, constraints
from .loads import force_share, port_functional
from .operator import AffineOperator, affine_operator
from .space import MixedSpace, mixed_space
from .sponge import SPONGE, sponge_matrix


@dataclass(frozen=True)
class ForearmModel:
    """Operator A(omega), port functionals and shares of force.

    ``functionals`` (n, n_port): displacement of port i is f_i . x; a unit force on port j loads the system with
    ``shares[j]`` f_j (shares differ from 1 on symmetry planes only).
    """

    space: MixedSpace
    constraints: Constraints
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


Matrices = list[tuple[str, csr_array, Coefficient]]


def build_model(
    mesh: TissueMesh,
    ports: tuple[Port, ...],
    tissues: Mapping[str, Tissue],
    supports: Supports,
    membrane: Membrane,
    *,
    element: str = "P2",
) -> ForearmModel:
    """Assemble everything; raises GeometryError for contacts that the mesh cannot carry."""
    space = mixed_space(mesh, element)
    rules = _constraints(space, ports, supports)
    names, reference = mesh.region_names, reference_tensors(space)
    parts = [tissue_matrices(space, region, reference) for region in range(len(names))]
    displacement = _shear_and_mass(names, parts, tissues, rules.transform)
    displacement += _boundaries(space, tissues, supports, membrane, rules.transform)
    displacement += _sponge(space, tissues, supports, rules.transform, reference)
    operator = _with_pressure(names, parts, tissues, rules.transform, displacement)
    functionals = np.zeros((operator.n, len(ports)))
    for i, port in enumerate(ports):
        functionals[: operator.n_displacements, i] = _functional(space, port, rules)
    shares = np.array([force_share(space, p) for p in ports])
    return ForearmModel(space, rules, operator, ports, functionals, shares)


def _functional(space: MixedSpace, port: Port, rules: Constraints) -> FloatArray:
    if port.name in rules.masters and port.kind == "contact":
        return np.asarray(np.eye(1, rules.transform.shape[1], rules.masters[port.name])[0])
    return np.asarray(rules.transform.T @ port_functional(space, port))


def _constraints(space: MixedSpace, ports: tuple[Port, ...], supports: Supports) -> Constraints:
    facets = space.mesh.facets
    held = [facets[name] for name in _held(supports) if name in facets and len(facets[name])]
    nodes = [space.facet_nodes(f) for f in held]
    planes = {
        axis: space.facet_nodes(facets[name]) for name, axis in (("symmetry x", 0), ("symmetry y", 1)) if name in facets
    }
    return constraints(space.n_nodes, _unique(nodes), planes, tuple(_disc(space, p) for p in ports if _is_rigid(p)))


def _held(supports: Supports) -> list[str]:
    names = ["bone"] if supports.bone == "rigid" else []
    names += ["end"] if supports.ends == "fixed" else []
    return names + (["underside"] if supports.underside == "fixed" else [])


def _unique(parts: list[IntArray]) -> IntArray:
    return np.unique(np.concatenate(parts)) if parts else np.zeros(0, dtype=np.int64)


def _is_rigid(port: Port) -> bool:
    return port.kind == "contact" and port.contact != "pressure"


def _disc(space: MixedSpace, port: Port) -> RigidDisc:
    facets = space.mesh.facets.get(f"contact {port.name}", np.zeros((0, 3), dtype=np.int64))
    nodes = space.facet_nodes(facets) if len(facets) else np.zeros(0, dtype=np.int64)
    return RigidDisc(port.name, nodes, np.array(port.axis), port.contact == "bonded")


def _reduced(transform: csr_array, matrix: csr_array) -> csr_array:
    return csr_array(transform.T @ matrix @ transform)


def _shear_and_mass(
    names: tuple[str, ...], parts: list[TissueMatrices], tissues: Mapping[str, Tissue], transform: csr_array
) -> Matrices:
    result: Matrices = []
    for name, part in zip(names, parts, strict=True):
        tissue = tissues[name]
        result.append((f"shear {name}", _reduced(transform, part.shear), tissue.modulus))
        result.append((f"mass {name}", _reduced(transform, part.mass), Polynomial(inertia=tissue.density)))
    return result


def _boundaries(
    space: MixedSpace, tissues: Mapping[str, Tissue], supports: Supports, membrane: Membrane, transform: csr_array
) -> Matrices:
    facets = space.mesh.facets
    result: Matrices = []
    if supports.ends == "absorb" and len(facets.get("end", ())):
        result += _dashpots(space, tissues, facets["end"])
    if supports.underside == "foam" and len(facets.get("underside", ())):
        foam = Polynomial(supports.foam_stiffness, supports.foam_damping)
        result.append(("foam", facet_mass(space, facets["underside"]), foam))
    skin = facets["skin"]
    if membrane.mass:
        result.append(("skin mass", facet_mass(space, skin), Polynomial(inertia=membrane.mass)))
    if membrane.tension:
        result.append(("skin tension", facet_gradients(space, skin), Polynomial(membrane.tension)))
    if membrane.stiffness or membrane.viscosity:
        sheet = Polynomial(membrane.stiffness, membrane.viscosity)
        result.append(("skin membrane", facet_membrane(space, skin), sheet))
    reduced: Matrices = [(name, _reduced(transform, matrix), coefficient) for name, matrix, coefficient in result]
    return reduced


def _sponge(
    space: MixedSpace,
    tissues: Mapping[str, Tissue],
    supports: Supports,
    transform: csr_array,
    reference: ReferenceTensors,
) -> Matrices:
    ends = space.mesh.facets.get("end", np.zeros((0, 3), dtype=np.int64))
    if supports.ends != "absorb" or not supports.sponge or not len(ends):
        return []
    matrix = sponge_matrix(space, tissues, ends, supports.sponge, reference)
    return [("sponge", _reduced(transform, matrix), SPONGE)]


def _dashpots(space: MixedSpace, tissues: Mapping[str, Tissue], facets: IntArray) -> Matrices:
    """Viscous dashpots rho c_s in all directions on the cut ends, per tissue (Lysmer and Kuhlemeyer 1969).

    The shear impedance is taken for the normal direction too: rho c_p would be a wall at 10-500 Hz.
    """
    tets, _ = space.owners(facets)
    regions = space.mesh.region[tets]
    result: Matrices = []
    for region, name in enumerate(space.mesh.region_names):
        mine, tissue = facets[regions == region], tissues[name]
        if len(mine):
            impedance = float(np.sqrt(tissue.density * np.abs(tissue.modulus.at(np.array([0.0]))[0])))
            result.append((f"dashpots {name}", facet_mass(space, mine), Polynomial(rate=impedance)))
    return result


def _with_pressure(
    names: tuple[str, ...],
    parts: list[TissueMatrices],
    tissues: Mapping[str, Tissue],
    transform: csr_array,
    displacement: Matrices,
) -> AffineOperator:
    """Saddle system [[K, -B^T], [-B, -M_p/bulk]] with pressures scaled to the size of the stiffness."""
    divergence = csr_array(sum(part.divergence for part in parts) @ transform)
    storage = csr_array(sum(part.pressure_mass / tissues[name].bulk for name, part in zip(names, parts, strict=True)))
    n_u, n_p = transform.shape[1], divergence.shape[0]
    scale = _pressure_scale(displacement, divergence)
    zero = csr_array((n_p, n_p))
    whole: Matrices = [(name, csr_array(block_array([[m, None], [None, zero]])), c) for name, m, c in displacement]
    coupling = csr_array(block_array([[None, -scale * divergence.T], [-scale * divergence, None]]))
    whole.append(("incompressibility", coupling, Polynomial(1.0)))
    compressed = csr_array(block_array([[csr_array((n_u, n_u)), None], [None, -(scale**2) * storage]]))
    whole.append(("compression", compressed, Polynomial(1.0)))
    return affine_operator(whole, n_u, scale)


def _pressure_scale(displacement: Matrices, divergence: csr_array) -> float:
    """Pascals per pressure unknown that make the coupling as large as a typical stiffness."""
    stiffness = sum(np.abs(complex(c.at(np.array(0.0)))) * m.diagonal() for _, m, c in displacement)
    return float(np.median(stiffness) / np.median(np.abs(divergence.data)))
