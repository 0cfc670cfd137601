"""No silent key: each key of the schema, changed, changes the result, or is refused, or is named in a note."""

from __future__ import annotations

import hashlib
import json
import warnings
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from hostile import leaves
from pydantic.fields import FieldInfo

from forearm_fem.engines import solved
from forearm_fem.engines.forecast import forecast, refuse_if_signals_too_large
from forearm_fem.errors import AccuracyWarning, ForearmError
from forearm_fem.geometry.build import build_mesh
from forearm_fem.geometry.cache import mesh_key
from forearm_fem.geometry.mesh.quality import mesh_quality
from forearm_fem.geometry.mesh.tissue_mesh import TissueMesh
from forearm_fem.pipeline.folder import accuracy_verdict
from forearm_fem.pipeline.simulation import render_transfer, simulate
from forearm_fem.pipeline.unread import changed_keys, unread_notes
from forearm_fem.scenario import Scenario, load_scenario, parse_scenario
from forearm_fem.scenario.base import Within
from forearm_fem.scenario.frequencies import frequencies

pytestmark = pytest.mark.usefixtures("same_integrals_once")
SWEEP = {"f_min": 100.0, "f_max": 140.0, "duration": 0.1, "sample_rate": 2000.0}
RENDERING = {"targets": ["5"], "wavelet": {"peak": 120.0}}
LAYERED: dict[str, Any] = {"engine": "layered", "sweep": SWEEP, "rendering": RENDERING}
FEM: dict[str, Any] = {"limb": {"shape": "forearm"}, "sweep": {"frequencies": [100.0]}}
COARSE = {"size_contact": 0.005, "size_grid": 0.008, "size_far": 0.015}
LABELS = ("name", "description")  # of the folder and the report
ONE_VALUE = ("schema_version", "limb.shape")  # the other shapes have keys of their own
ELSEWHERE = ("measurement",)  # calibrate and play read it
VALUES: Mapping[str, Any] = {
    "accuracy": 0.02,
    "device.contact_springs": {"A1": 50.0},
    "device.gains": {"A1": 0.9},
    "device.contacts": [[-0.02, 0.0], [0.02, 0.0]],
    "device.out_of_contact": ["A2"],
    "grid.points": [[0.0, 0.0], [0.01, 0.0], [0.0, 0.01], [0.01, 0.01], [0.004, 0.004]],
    "limb.bones": [],
    "limb.circumference": [[0.0, 0.22]],
    "limb.core": "fat",
    "limb.layers": [{"tissue": "skin", "thickness": 0.002}],
    "mesh.element": "P3",
    "mesh.max_elements": 1.0,
    "mesh.min_quality": 0.999,
    "mesh.sublayers": {"skin": 3},
    "rendering.methods": ["funneling"],
    "rendering.regularisation": "lcurve",
    "rendering.regularisation_value": 0.95,
    "rendering.targets": ["6"],
    "rendering.wavelet.file": "nowhere.csv",
    "rendering.window": [-0.002, 0.004],
    "rendering.zeros": ["1", "2", "3", "4"],
    "solver.memory_limit": 1e6,
    "sweep.frequencies": [100.0, 110.0],
    "tissues.membrane.tension": 30.0,
    "tissues.override.skin.model": "springpot",
    "tissues.override.skin.exponent": 0.3,
    "tissues.override.skin.mu_infinity": 1e5,
    "tissues.override.skin.bulk": 1e6,
}
KEYS = {
    ".".join(path): field
    for path, field in leaves()
    if path[:3] not in (("tissues", "override", "gel"), ("tissues", "override", "muscle"))
    and ".".join(path) not in (*LABELS, *ONE_VALUE, "tissues.override")
    and path[0] not in ELSEWHERE
    and (path[0] != "limb" or path[1] in type(Scenario().limb).model_fields)
}


def other_value(key: str, field: FieldInfo) -> Any:
    """A legal value that is not the default."""
    if key in VALUES:
        return VALUES[key]
    default = field.get_default(call_default_factory=True)
    if isinstance(default, bool):
        return not default
    if isinstance(default, str):
        return next(v for v in get_args(field.annotation) if isinstance(v, str) and v != default)
    if isinstance(default, int):
        return default + 1
    if isinstance(default, float) and default:
        return default * 0.8
    within = next(m for m in [*field.metadata, *_inner(field.annotation)] if isinstance(m, Within))
    return min(within.high, max(within.low, 0.003)) if default is None or within.zero else within.low


def _inner(annotation: Any) -> list[Any]:
    return [m for a in get_args(annotation) for m in getattr(a, "__metadata__", ())]


def with_key(base: Mapping[str, Any], key: str, value: Any) -> dict[str, Any]:
    """A copy of ``base`` with one key set."""
    data: dict[str, Any] = json.loads(json.dumps(base))
    place = data
    for name in key.split(".")[:-1]:
        place = place.setdefault(name, {})
    place[key.split(".")[-1]] = value
    return data


def layered_answer(data: Mapping[str, Any]) -> tuple[str, str]:
    """Digest of all numbers of a run and its verdict, and its notes; a refusal is an answer too."""
    try:
        scenario = parse_scenario(data)
        refuse_if_signals_too_large(scenario)
        simulation = simulate(scenario)
        notes = [*simulation.notes, *unread_notes(scenario)]
        numbers = hashlib.sha256(simulation.transfer.values.tobytes())
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", AccuracyWarning)  # a narrow band, so that it is quick
            rendering = render_transfer(scenario, simulation.transfer) if scenario.rendering.methods else {}
    except ForearmError as problem:
        return str(problem), ""
    for key, made in rendering.items():
        report = (made.report.exceeded, np.round(made.strength, 9))
        numbers.update(
            repr((key, report)).encode() + made.drives.signals.tobytes() + made.displacements.values.tobytes()
        )
    return numbers.hexdigest() + accuracy_verdict(scenario, simulation.transfer.errors), "; ".join(notes)


@cache
def reference() -> tuple[str, str]:
    return layered_answer(LAYERED)


# limits that no drive here comes near are tested below, the engine by every other test
_TOLD = ("engine", "device.max_voltage", "device.max_power", "solver.memory_limit")


@pytest.mark.parametrize("key", [k for k in KEYS if k not in _TOLD])
def test_no_key_is_silent_in_the_layered_engine(key: str) -> None:
    told, notes = layered_answer(with_key(LAYERED, key, other_value(key, KEYS[key])))
    assert told != reference()[0] or notes != reference()[1]


@pytest.mark.parametrize(("key", "value"), [("device.max_voltage", 1e-6), ("device.max_power", 1e-12)])
def test_a_limit_is_told_when_it_is_passed(key: str, value: float) -> None:
    assert layered_answer(with_key(LAYERED, key, value))[0] != reference()[0]


def test_the_memory_limit_holds_for_signals_too() -> None:
    long = with_key(with_key(LAYERED, "solver.memory_limit", 1e6), "sweep.duration", 10.0)
    assert "solver.memory_limit" in layered_answer(long)[0]


# the device's circuit and the renderers come after the compliance, the same for both engines: tested above
_COMMON = ("device", "grid.", "rendering", "tissues", "engine", "sweep.duration", "sweep.sample_rate")


@pytest.fixture(scope="module")
def block() -> TissueMesh:
    """Any mesh that every changed device fits on."""
    scenario = parse_scenario({"limb": {"shape": "slab"}, "mesh": COARSE, "device": {"cone": {"contact": "pressure"}}})
    return build_mesh(scenario)


@pytest.fixture(scope="module")
def before(block: TissueMesh) -> tuple[object, ...]:
    return fem_answer(FEM, block)


@pytest.mark.parametrize("key", [k for k in KEYS if not k.startswith(_COMMON)])
def test_no_key_is_silent_in_finite_elements(key: str, block: TissueMesh, before: tuple[object, ...]) -> None:
    assert before != fem_answer(with_key(FEM, key, other_value(key, KEYS[key])), block)


def fem_answer(data: Mapping[str, Any], mesh: TissueMesh) -> tuple[object, ...]:
    """Keys of mesh and solve, estimates asked for, limits and notes; a refusal is an answer too."""
    try:
        scenario = parse_scenario(data)
        band = frequencies(scenario.sweep)
        made = mesh_key(scenario), solved.solve_key(scenario, mesh, band), scenario.solver.discretisation_estimate
        refused = forecast(scenario, mesh=mesh).memory_bytes > scenario.solver.memory_limit
    except ForearmError as problem:
        return (str(problem),)
    passing = len(mesh.tetrahedra) <= scenario.mesh.max_elements, mesh_quality(mesh).least >= scenario.mesh.min_quality
    return *made, refused, *passing, unread_notes(scenario)


@pytest.mark.parametrize(
    ("changes", "names"),
    [
        ({"engine": "layered", "mesh.size_grid": 0.003}, "mesh.size_grid"),
        ({"engine": "layered", "supports.ends": "free"}, "supports.ends"),
        ({"device.contacts": [[0.0, 0.0]], "device.spacing": 0.03}, "device.spacing"),
        ({"device.drive": "force", "device.coil.quality": 4.0}, "device.coil.quality"),
        ({"device.drive": "force", "device.max_power": 2.0}, "device.max_power"),
        ({"device.housing.fixed": True, "device.housing.mass": 0.2}, "device.housing.mass"),
        ({"grid.points": [[0.0, 0.0]], "grid.rows": 4}, "grid.rows"),
        ({"sweep.frequencies": [100.0], "sweep.f_min": 20.0}, "sweep.f_min"),
        ({"sweep.frequencies": [100.0], "rendering.methods": [], "sweep.duration": 1.0}, "sweep.duration"),
        ({"supports.foam_damping": 10.0}, "supports.foam_damping"),
        ({"limb.bones": [], "supports.bone": "elastic"}, "supports.bone"),
        ({"solver.sweep": "direct", "solver.start": "rate"}, "solver.start"),
        ({"solver.expansions": 7}, "solver.expansions"),
        ({"solver.start": "frequencies", "solver.rate_derivatives": 90}, "solver.rate_derivatives"),
        ({"rendering.methods": [], "rendering.amplitude": 2.0}, "rendering.amplitude"),
        ({"rendering.methods": ["funneling"], "rendering.zeros": ["1"]}, "rendering.zeros"),
        ({"rendering.wavelet.file": "a.csv", "rendering.wavelet.peak": 200.0}, "rendering.wavelet.peak"),
        ({"tissues.override.gel": {"mu": 1e3, "eta": 1.0, "density": 1e3, "bulk": 1e9}}, "tissues.override.gel"),
        ({"mesh.sublayers": {"gristle": 2}}, "mesh.sublayers.gristle"),
        ({"tissues.patch.length": 0.03}, "tissues.patch.length"),
        ({"device.housing.fixed": True, "device.housing.skin_share": 0.03}, "device.housing.skin_share"),
        ({"device.out_of_contact": ["A1"], "device.contact_springs": {"A1": 50.0}}, "device.contact_springs"),
    ],
)
def test_a_key_without_effect_is_named(changes: Mapping[str, Any], names: str) -> None:
    data: dict[str, Any] = {}
    for key, value in changes.items():
        data = with_key(data, key, value)
    told = [note for note in unread_notes(parse_scenario(data)) if names in note]
    assert len(told) == 1
    assert "no effect" in told[0]


def test_defaults_and_shipped_scenarios_leave_no_such_note() -> None:
    assert changed_keys(Scenario()) == ()
    for file in sorted((Path(__file__).parents[1] / "scenarios").glob("*.toml")):
        assert unread_notes(load_scenario(file)) == ()
