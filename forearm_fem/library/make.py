"""One long run per arm: mesh, one factorisation, a space for all loads on the patch, and the flat twin's tables."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import ForearmError, ScenarioError
from ..layered.integrals import Medium
from ..pipeline.layered_engine import flat_layers, flat_surface
from ..pipeline.malloc import freed_memory_kept
from ..pipeline.twin_tables import kept_tables, tables_reach
from ..progress import Progress, within
from ..scenario import Scenario, parse_scenario
from ..tissue import KelvinVoigt, limb_tissue_keys, resolve_tissues
from .arm import WIDTH, ArmLibrary, library_band, library_skin, pair_distances
from .bands import Bands
from .between import Shape
from .flat_bells import between_flat_bells
from .kept import Side
from .loads import Bells
from .side import LoadedSkin, solved_side
from .skin import FlatSkin

COARSER = 2.0  # size ratio of the second mesh
_DISC = 8e-3  # [m] radius of the one contact that the mesh is made around
_BIN = 5e-3  # [m] of distance in which what is interpolated is taken as equally uncertain


def make_library(scenario: Scenario, *, base: str | Path = ".", progress: Progress | None = None) -> ArmLibrary:
    """Solve for the patch ``scenario.library`` of the limb, over the band of its sweep, for its cone.

    Takes what several runs of the same accuracy take; ended, it goes on from the cache. Raises ScenarioError for limbs
    and tissues that no library is made for: user's surfaces and meshes, symmetry planes, moduli that are not
    Kelvin-Voigt.
    """
    began = time.monotonic()
    _check_tissues(scenario)
    skin, bells = library_skin(scenario), lattice_bells(scenario)
    with freed_memory_kept():
        meshed, loaded = meshed_scenario(scenario, skin), LoadedSkin(skin, bells)
        fine = solved_side(meshed, loaded, Path(base), progress=progress)
        coarse = _second_side(meshed, loaded, Path(base), progress)
    medium = Medium(tuple(flat_layers(scenario)), "halfspace", flat_surface(scenario.tissues))
    bands = Bands.of(*library_band(scenario))
    nodes = bands.nodes.ravel()
    _, distances = pair_distances(bells.centres)
    flat = between_flat_bells(medium, nodes, bells.width, distances).reshape(*bands.nodes.shape, -1)
    twin = kept_tables(scenario, tables_reach(float(distances[-1])), progress=progress)
    library = ArmLibrary(
        scenario, bells.centres, bells.width, fine.limb, coarse.limb if coarse else None, fine.freed, COARSER,
        distances, flat, twin, np.zeros(0), np.zeros((0, 0)), fine.reduction,
        {**fine.facts, "seconds": time.monotonic() - began},
    )  # fmt: skip
    return _judged(library)


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


def _second_side(meshed: Scenario, loaded: LoadedSkin, base: Path, progress: Progress | None) -> Side | None:
    """The second mesh's part; None where none was asked for or could be made."""
    if not meshed.solver.discretisation_estimate:
        return None
    try:
        return solved_side(meshed, loaded, base, COARSER, within(progress, "coarser mesh"))
    except ForearmError:
        return None


def _judged(library: ArmLibrary) -> ArmLibrary:
    """The library with ``bins`` and ``spread``: each bell left out in turn, in the middle of each part of the band.

    Those on the patch's edge are not judged: without them what the others see is carried on, not interpolated.
    """
    pairs, _ = pair_distances(library.centres)
    node, shape = library.bands.nodes.shape[1] // 2, Shape("bell", library.width)
    at = library.bands.nodes[:, node]
    every = library.fine.between(at, np.eye(len(library.centres))) - library.flat[:, node][:, pairs]
    inside = (np.abs(library.centres) < np.abs(library.centres).max(axis=0) * (1 - 1e-9)).all(axis=1)
    away = np.linalg.norm(library.centres[:, None] - library.centres[None], axis=2)
    bins = np.arange(0.0, away.max() + _BIN, _BIN)
    number = np.rint(away[inside] / _BIN).astype(int).ravel()
    count, rows = np.maximum(np.bincount(number, minlength=len(bins)), 1), []
    for one, of in zip(library.lattices, every, strict=True):
        off = np.abs(one.left_out(of)[inside]) ** 2 / one.prior.covariance(shape, shape, np.zeros(1))[0]
        rows.append(np.sqrt(np.bincount(number, weights=off.ravel(), minlength=len(bins)) / count))
    return replace(library, bins=bins, spread=np.array(rows)[:, : len(bins)])
