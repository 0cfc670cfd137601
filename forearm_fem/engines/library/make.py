"""Making a library, and its file."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ...accuracy.discretisation import COARSER
from ...errors import ForearmError, ScenarioError
from ...layered.integrals import Medium
from ...progress import Progress, within
from ...scenario import Scenario, parse_scenario
from ...scenario.model import resolve_tissues
from ...store.record import load, said_content, save
from ...tissue import KelvinVoigt
from ...typing import ComplexArray, FloatArray
from ..layered import fibrous, flat_layers, flat_surface, kept_tables, tables_reach
from .arm import WIDTH, ArmLibrary, library_band, library_skin
from .between import Bands, Lattice
from .side import BIN, LoadedSkin, MeshPart, modal_compliance, solved_side
from .skin import FlatSkin, GaussianLoads, between_flat_bells, flat_compliance, pair_distances

# ``library.nc``: an arm's library as one file that can be shared.


def save_library(path: str | Path, library: ArmLibrary) -> None:
    """Write the ``library``; DataError where that cannot be done."""
    save(path, library)


def is_library(path: str | Path) -> bool:
    """True if the file says of itself that it holds an arm's library; of this version or not, whole or not."""
    return said_content(path) == ArmLibrary.kind


def load_library(path: str | Path) -> ArmLibrary:
    """Read what :func:`save_library` wrote; DataError for a missing, damaged or outdated file."""
    return load(path, ArmLibrary)


# One long run per arm: mesh, one factorisation, a space for all loads on the patch, and the layered model's tables.

_DISC = 8e-3  # [m] radius of the one contact that the mesh is made around


def make_library(scenario: Scenario, *, base: str | Path = ".", progress: Progress | None = None) -> ArmLibrary:
    """Solve for the patch ``scenario.library`` of the limb, over the band of its sweep, for its cone.

    Takes what several runs of the same accuracy take; ended, it goes on from the cache. Raises ScenarioError for limbs
    and tissues that no library is made for: user's surfaces and meshes, symmetry planes, moduli that are not
    Kelvin-Voigt.
    """
    began = time.monotonic()
    tissues = resolve_tissues(scenario)
    for key, name in scenario.tissue_keys.items():
        if not isinstance(tissues[name].modulus, KelvinVoigt):
            raise ScenarioError(
                f"{key}: a library starts from one real rate and needs Kelvin-Voigt tissue, but {name} is not; set "
                f"tissues.override.{name}.law = 'kelvin-voigt'"
            )
    if reason := fibrous(scenario):
        needs = "a library needs the layered model beside the mesh, so leave it out"
        raise ScenarioError(f"{reason.partition('; ')[0]}; {needs}")
    loaded = loaded_skin(scenario)
    _check_size(scenario, len(loaded.bells.centres))
    meshed = meshed_scenario(scenario, loaded.skin)
    sides = time.monotonic()
    fine = solved_side(meshed, loaded, Path(base), progress=progress)
    coarse = _second_side(meshed, loaded, Path(base), progress)
    sides = time.monotonic() - sides
    began -= max(0.0, _seconds(fine) + _seconds(coarse) - sides)  # what earlier calls spent on what was kept
    centres, sideways, width = normal_lattice(scenario), sideways_lattice(scenario), loaded.bells.width
    distances, bands = pair_distances(centres), Bands.of(*library_band(scenario))
    medium = Medium(tuple(flat_layers(scenario)), "halfspace", flat_surface(scenario.tissues))
    flat = between_flat_bells(medium, bands.nodes.ravel(), width, distances, sideways=len(sideways) > 0)
    tables = kept_tables(scenario, tables_reach(float(distances[-1])), progress=progress)
    library = ArmLibrary(
        scenario, centres, sideways, width, fine.limb, coarse.limb if coarse else None, fine.freed, COARSER,
        distances, flat.reshape(*bands.nodes.shape, *flat.shape[1:]), tables.arrays(), loaded.bins, np.zeros((0, 3, 0)),
        fine.reduction, fine.missed, {**fine.facts, "seconds": time.monotonic() - began},
    )  # fmt: skip
    return _judged(library)


def _seconds(side: MeshPart | None) -> float:
    """Seconds that a part took, over all calls that made it."""
    return 0.0 if side is None else sum(s for name, s in side.facts.items() if name.startswith("seconds_"))


def normal_lattice(scenario: Scenario) -> FloatArray:
    """Places (n, 2) of loads over the patch, edges included, as nearly ``library.step`` apart as fits."""
    return _grid([np.linspace(-0.5, 0.5, _count(a, scenario.library.step)) * a for a in _sides(scenario)])


def sideways_lattice(scenario: Scenario) -> FloatArray:
    """Places (n, 2) among those of the lattice of loads along the skin, two steps apart; none but for bonded discs."""
    if scenario.device.cone.contact != "bonded":
        return np.zeros((0, 2))
    sides = []
    for a in _sides(scenario):
        count = _count(a, scenario.library.step)
        kept = np.linspace(0, count - 1, max(3, (count + 2) // 2)).round().astype(int)
        sides.append(np.linspace(-0.5, 0.5, count)[kept] * a)
    return _grid(sides)


def loaded_skin(scenario: Scenario) -> LoadedSkin:
    """All loads: along the normal, then along u, then along v."""
    skin, centres, sideways = library_skin(scenario), normal_lattice(scenario), sideways_lattice(scenario)
    axes = np.concatenate([skin.places(centres)[1], *skin.tangents(sideways)])
    bells = GaussianLoads(np.vstack([centres, sideways, sideways]), axes, WIDTH * scenario.library.step)
    return LoadedSkin(skin, bells, len(centres))


def _sides(scenario: Scenario) -> tuple[float, float]:
    return scenario.library.length, scenario.library.width


def _count(side: float, step: float) -> int:
    return max(3, round(side / step) + 1)


def _grid(sides: list[FloatArray]) -> FloatArray:
    return np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 2)


def _check_size(scenario: Scenario, loads: int) -> None:
    """Check, before hours of solving, that the answers' layered model fits into memory."""
    need = 16 * Bands.of(*library_band(scenario)).nodes.size * loads**2
    if need > scenario.solver.memory_limit:
        raise ScenarioError(
            f"library: {loads} loads, {1e3 * scenario.library.step:.3g} mm apart, need more than {need / 1e9:.3g} GB, "
            f"and solver.memory_limit = {scenario.solver.memory_limit / 1e9:.3g} GB; enlarge library.step, or reduce "
            "library.length and library.width"
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


def _second_side(meshed: Scenario, loaded: LoadedSkin, base: Path, progress: Progress | None) -> MeshPart | None:
    """The second mesh's part; None where none was asked for or could be made."""
    if not meshed.solver.discretisation_estimate:
        return None
    try:
        return solved_side(meshed, loaded, base, COARSER, within(progress, "coarser mesh"))
    except ForearmError:
        return None


def _judged(library: ArmLibrary) -> ArmLibrary:
    """The library with its ``spread``: each bell left out in turn, in the middle of each part of the band.

    Those on the patch's edge are not judged: without them what the others see is carried on, not interpolated.
    """
    n, node = len(library.centres), library.bands.nodes.shape[1] // 2
    at, loads = library.bands.nodes[:, node], n + 2 * len(library.sideways)
    flat = flat_compliance(library.flat[:, node], library.distances, library.centres, library.sideways)
    every = modal_compliance(library.fine, at, np.eye(loads)) - flat
    bins = library.bins
    spread = np.zeros((len(at), 3, len(bins)))
    for k, of in enumerate(every):
        spread[k, 0] = _left_out(library.lattices[0][k], of[:n, :n], library.centres, bins)
        if len(library.sideways):
            one = library.lattices[1][k]
            u, v = np.split(of[n:], 2)
            both = np.tile(library.sideways, (2, 1))
            spread[k, 1] = _left_out(one, np.hstack([u[:, :n], v[:, :n]]), np.tile(library.centres, (2, 1)), bins)
            spread[k, 2] = _left_out(one, np.hstack([u[:, n:], v[:, n:]]), np.tile(both, (2, 1)), bins)
    return replace(library, spread=spread)


def _left_out(lattice: Lattice, values: ComplexArray, readers: FloatArray, bins: FloatArray) -> FloatArray:
    """Standard deviation (n_bin,) of ``values`` (n, m), read at ``readers`` (m, 2), found from the other loads."""
    centres, shape = lattice.centres, lattice.shape
    inside = (np.abs(centres) < np.abs(centres).max(axis=0) * (1 - 1e-9)).all(axis=1)
    away = np.linalg.norm(centres[inside][:, None] - readers[None], axis=2)
    number = np.minimum(np.rint(away / BIN).astype(int), len(bins) - 1).ravel()
    off = np.abs(lattice.left_out(values)[inside]) ** 2 / lattice.prior.covariance(shape, shape, np.zeros(1))[0]
    count = np.maximum(np.bincount(number, minlength=len(bins)), 1)
    return np.asarray(np.sqrt(np.bincount(number, weights=off.ravel(), minlength=len(bins)) / count))
