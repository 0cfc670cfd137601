"""One long run per arm: mesh, one factorisation, a space for all loads on the patch, and the flat twin's tables."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import csr_array

from ..errors import ForearmError, ScenarioError, SolverError
from ..fem.assembly.coefficients import Polynomial, is_polynomial
from ..fem.assembly.model import ForearmModel
from ..fem.linear.direct import make_solver
from ..fem.reduction.expansion import expansion_rate
from ..fem.reduction.many_loads import LoadSpace
from ..fem.reduction.poles import pole_residue
from ..fem.reduction.reduced_model import ReducedModel, empty_model, with_columns
from ..geometry.cache import cached_mesh
from ..layered.integrals import Medium
from ..pipeline.fem_engine import fem_model
from ..pipeline.frequencies import frequencies
from ..pipeline.layered_engine import flat_layers, flat_surface
from ..pipeline.malloc import freed_memory_kept
from ..progress import Progress, tell, within
from ..scenario import Scenario, parse_scenario
from ..tissue import KelvinVoigt, limb_tissue_keys, resolve_tissues
from ..typing import FloatArray
from .arm import WIDTH, ArmLibrary, Bell, library_band, library_skin, pair_distances
from .bands import Bands
from .loads import Bells, bell_functionals
from .skin import FlatSkin
from .twin import bell_table, twin_table

COARSER = 2.0  # size ratio of the second mesh
_DROP, _ORDERS = 1e-2, 30  # of directions of the space, and derivatives at most (docs/decisions/0037-library.md)
_FASTER = 2.5  # than the sweep's rate: high frequencies are what a space cut at _DROP leaves out
_AT_ONCE = 48  # loads
_WITNESSES = 24  # loads of the direct solve that the reduced model is compared with
_CHECKED = (0.0, 0.5, 1.0)  # of the band: far fields fall with frequency, so that its end is the hardest
_APART = 4  # widths between bells from which their compliance counts there
_DISC = 8e-3  # [m] radius of the one contact that the mesh is made around
_BIN = 5e-3  # [m] of distance in which what is interpolated is taken as equally uncertain


@dataclass(frozen=True, eq=False)
class Side:
    """One mesh's part: the limb through the bells, with free ends where it has absorbing ones, the error of the reduced
    model, and facts."""

    limb: Bell
    freed: Bell | None
    reduction: float
    facts: dict[str, Any]


def make_library(scenario: Scenario, *, base: str | Path = ".", progress: Progress | None = None) -> ArmLibrary:
    """Solve for the patch ``scenario.library`` of the limb, over the band of its sweep, for its cone.

    Takes what several runs of the same accuracy take. Raises ScenarioError for limbs and tissues that no library is
    made for: user's surfaces and meshes, symmetry planes, moduli that are not Kelvin-Voigt.
    """
    began = time.monotonic()
    _check_tissues(scenario)
    skin, bells = library_skin(scenario), lattice_bells(scenario)
    with freed_memory_kept():
        fine = _solved_side(scenario, skin, bells, Path(base), 1.0, progress)
        coarse = _second_side(scenario, skin, bells, Path(base), progress)
    medium = Medium(tuple(flat_layers(scenario)), "halfspace", flat_surface(scenario.tissues))
    bands = Bands.of(*library_band(scenario))
    nodes = bands.nodes.ravel()
    _, distances = pair_distances(bells.centres)
    flat = bell_table(medium, nodes, bells.width, distances).reshape(*bands.nodes.shape, -1)
    cone = scenario.device.cone
    twin = twin_table(
        medium, nodes, cone.radius, cone.contact, float(distances[-1]) + cone.radius,
        progress=progress,
    )  # fmt: skip
    library = ArmLibrary(
        scenario, bells.centres, bells.width, fine.limb, coarse.limb if coarse else None, fine.freed, COARSER,
        distances, flat, twin, np.zeros(0), np.zeros((0, 0)), fine.reduction,
        {**fine.facts, "seconds": time.monotonic() - began},
    )  # fmt: skip
    bins, spread = _spread(library)
    return replace(library, bins=bins, spread=spread)


def lattice_bells(scenario: Scenario) -> Bells:
    """Bells over the patch, edges included, as nearly ``library.step`` apart as fits."""
    patch = scenario.library
    sides = [np.linspace(-0.5, 0.5, max(3, round(a / patch.step) + 1)) * a for a in (patch.length, patch.width)]
    centres = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 2)
    return Bells(centres, library_skin(scenario).places(centres)[1], WIDTH * patch.step)


def _check_tissues(scenario: Scenario) -> None:
    tissues = resolve_tissues(scenario)
    for key, name in limb_tissue_keys(scenario.limb).items():
        if not isinstance(tissues[name].modulus, KelvinVoigt):
            raise ScenarioError(
                f"{key}: a library starts from one real rate and needs Kelvin-Voigt tissue, but {name} is not; set "
                f"tissues.override.{name}.model = 'kelvin-voigt'"
            )


def meshed_scenario(scenario: Scenario, skin: FlatSkin) -> Scenario:
    """The scenario whose mesh is even over the patch: one wide pressed disc, points all around."""
    patch = scenario.library
    sides = np.array([[a, b] for a in (-1, -0.5, 0, 0.5, 1) for b in (-1, 0, 1) if abs(a) == 1 or b])
    places = skin.places(0.499 * sides * np.array([patch.length, patch.width]))[0][:, :2]
    data = scenario.model_dump(mode="json")
    radius = min(_DISC, 0.2 * patch.length, 0.2 * patch.width)
    device = {"contacts": [[0.0, 0.0]], "cone": {"radius": radius, "contact": "pressure"}}
    rendering: dict[str, Any] = {"methods": []}
    return parse_scenario({**data, "device": device, "grid": {"points": places.tolist()}, "rendering": rendering})


def _solved_side(
    scenario: Scenario, skin: FlatSkin, bells: Bells, base: Path, scale: float, progress: Progress | None
) -> Side:
    meshed = meshed_scenario(scenario, skin)
    mesh = cached_mesh(meshed, base=base, scale=scale, progress=within(progress, "mesh"))
    tell(progress, "assembly", 0, 1)
    model = fem_model(meshed, mesh)
    seen = bell_functionals(model, skin, bells)
    tell(progress, "assembly", 1, 1)
    frequency = frequencies(scenario.sweep)
    reduced, facts = _reduced(meshed, model, seen, frequency, progress)
    reduction = _reduction_error(meshed, model, seen, reduced, bells, frequency) if scale == 1 else np.nan
    names = [n for n in reduced.names if n.startswith("dashpots")]
    freed = None
    if names and scale == 1:
        freed = _bell(reduced.changed(dict.fromkeys(names, Polynomial())), frequency)
    return Side(_bell(reduced, frequency), freed, reduction, {**facts, "unknowns": model.operator.n})


def _second_side(
    scenario: Scenario, skin: FlatSkin, bells: Bells, base: Path, progress: Progress | None
) -> Side | None:
    """The second mesh's part; None where none was asked for or could be made."""
    if not scenario.solver.discretisation_estimate:
        return None
    try:
        return _solved_side(scenario, skin, bells, base, COARSER, within(progress, "coarser mesh"))
    except ForearmError:
        return None


def _reduced(
    scenario: Scenario, model: ForearmModel, seen: csr_array, frequency: FloatArray, progress: Progress | None
) -> tuple[ReducedModel, dict[str, Any]]:
    """The limb in the space of all loads; every load is an output, too."""
    assert all(is_polynomial(t.coefficient) for t in model.operator.terms)
    bare = replace(model, ports=(), functionals=np.zeros((model.operator.n, 0)), shares=np.zeros(0))
    solver = make_solver(bare, scenario.solver, float(frequency[-1]))
    space = LoadSpace(solver, _FASTER * expansion_rate(frequency), drop=_DROP, derivatives=_ORDERS)
    reduced, functionals, total = empty_model(bare), [], seen.shape[1]
    order = np.argsort((np.arange(total) * 0.6180339887498949) % 1.0)  # batches spread over the patch
    for start in range(0, total, _AT_ONCE):
        chosen = order[start : start + _AT_ONCE]
        columns = list(space.add(seen[:, chosen].toarray()))
        if columns:
            block = np.hstack(columns)
            reduced = with_columns(reduced, bare, block, np.zeros((reduced.size + block.shape[1], 0)))
            functionals.append(np.asarray(seen.T @ block).T)
        tell(progress, "loads on the patch", min(start + _AT_ONCE, total), total)
    solver.factor.release()
    facts = {"loads": total, "size": space.size, "solves": space.solves, "solver": solver.factor.name}
    return replace(reduced, functionals=np.vstack(functionals).astype(float), shares=np.ones(total)), facts


def _bell(reduced: ReducedModel, frequency: FloatArray) -> Bell:
    found = pole_residue(reduced, frequency)
    if found is None:
        raise SolverError(
            "the poles of the library's reduced model are inaccurate; choose a larger library.step, or another band"
        )
    return Bell(found.poles, found.left, found.right)


def _reduction_error(
    scenario: Scenario, model: ForearmModel, seen: csr_array, reduced: ReducedModel, bells: Bells, frequency: FloatArray
) -> float:
    """Largest error over the largest compliance between bells some widths apart, at the worst of ``_CHECKED``."""
    some = np.unique(np.linspace(0, len(bells.centres) - 1, _WITNESSES).astype(int))
    chosen = np.asarray(seen[:, some].toarray())
    witness = replace(model, functionals=chosen, shares=np.ones(len(some)))
    own = replace(reduced, functionals=reduced.functionals[:, some], shares=np.ones(len(some)))
    away = np.linalg.norm(bells.centres[some][:, None] - bells.centres[some][None], axis=2)
    far, worst = away > _APART * bells.width, 0.0
    solver = make_solver(model, scenario.solver, float(frequency[-1]))
    for share in _CHECKED:
        at = frequency[round(share * (len(frequency) - 1))]
        truth = chosen.T @ replace(solver, model=witness).at(float(at)).values
        found = own.compliance(np.array([at]))[0]
        worst = max(worst, float(np.abs(found - truth)[far].max() / np.abs(truth)[far].max()))
    solver.factor.release()
    return worst


def _spread(library: ArmLibrary) -> tuple[FloatArray, FloatArray]:
    """``bins`` and ``spread`` of the library: each bell left out in turn, in the middle of each part of the band."""
    away = np.linalg.norm(library.centres[:, None] - library.centres[None], axis=2)
    bins = np.arange(0.0, away.max() + _BIN, _BIN)
    number, rows = np.rint(away / _BIN).astype(int), []
    pairs, _ = pair_distances(library.centres)
    for part, one in enumerate(library.lattices):
        node = library.bands.nodes.shape[1] // 2
        at = library.bands.nodes[part, node : node + 1]
        limb = library.fine.between(at, np.eye(len(library.centres)))[0]
        off = np.abs(one.left_out(limb - library.flat[part, node][pairs])) ** 2
        own = one.prior.covariance(one.shape, one.shape, np.zeros(1))[0]
        total = np.bincount(number.ravel(), weights=off.ravel(), minlength=len(bins))
        count = np.bincount(number.ravel(), minlength=len(bins))
        mean = np.where(count > 0, total / np.maximum(count, 1), 0.0)
        rows.append(np.sqrt(mean / own))
    return bins, np.array(rows)[:, : len(bins)]


