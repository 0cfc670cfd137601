"""No silent key: each key of the schema, changed, changes the result, or is refused, or is named in a note."""

from __future__ import annotations

import functools
import hashlib
import json
import re
import warnings
from collections.abc import Mapping
from functools import cache
from typing import Any, get_args

import numpy as np
import pytest
from hostile import leaves
from pydantic.fields import FieldInfo
from scenes import sampled

from forearm_fem.engines import fem
from forearm_fem.engines.forecast import forecast, refuse_if_signals_too_large, scene_notes
from forearm_fem.engines.simulation import render_transfer, simulate
from forearm_fem.errors import AccuracyWarning, ForearmError, ScenarioError
from forearm_fem.geometry.build import build_mesh, mesh_key
from forearm_fem.geometry.mesh.quality import mesh_quality
from forearm_fem.geometry.mesh.tissue_mesh import TissueMesh
from forearm_fem.questions.run import accuracy_verdict
from forearm_fem.scenario import Scenario, load_scenario, parse_scenario
from forearm_fem.scenario.base import Within
from forearm_fem.scenario.sweep import frequencies

SWEEP = {"f_min": 100.0, "f_max": 140.0, "duration": 0.1, "sample_rate": 2000.0}
RENDERING = {"targets": ["5"], "wavelet": {"peak": 120.0}}
LAYERED: dict[str, Any] = {"engine": "layered", "sweep": SWEEP, "rendering": RENDERING}
FEM: dict[str, Any] = {"limb": {"shape": "forearm"}, "sweep": {"frequencies": [100.0]}}
COARSE = {"size_contact": 0.005, "size_grid": 0.008, "size_far": 0.015}
LABELS = ("name", "description")  # of the folder and the report
ONE_VALUE = ("schema_version", "limb.shape")  # the other shapes have keys of their own
ELSEWHERE = ("measurement", "library")  # commands of their own read them
VALUES: Mapping[str, Any] = {
    "accuracy": 0.02,
    "device.contact_springs": {"A1": 50.0},
    "device.gains": {"A1": 0.9},
    "device.contacts": [[-0.02, 0.0], [0.02, 0.0]],
    "device.drive": "force",
    "device.housing.fixed": True,
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
    "grid.direction": "vertical",
    "rendering.clearance": 0.02,  # to the outer points
    "rendering.funneling_distance": "diagonal",
    "rendering.methods": ["funneling"],
    "rendering.regularisation": "lcurve",
    "rendering.regularisation_value": 0.95,
    "rendering.targets": ["6"],
    "rendering.wavelet.file": "nowhere.csv",
    "rendering.window": [-0.002, 0.004],
    "rendering.zeros": ["1", "2", "3", "4"],
    "solver.memory_limit": 1e6,
    "solver.sweep": "direct",
    "supports.underside": "foam",
    "sweep.frequencies": [100.0, 110.0],
    "tissues.membrane.tension": 30.0,
    "tissues.override.skin.law": "springpot",
    "tissues.override.skin.parameters": {"loss": 1.0},
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
        notes = [*simulation.notes, *scene_notes(scenario)]
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


@pytest.mark.parametrize("key", sampled((k for k in KEYS if k not in _TOLD), 3))
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


@pytest.mark.parametrize("key", sampled((k for k in KEYS if not k.startswith(_COMMON)), 3))
def test_no_key_is_silent_in_finite_elements(key: str, block: TissueMesh, before: tuple[object, ...]) -> None:
    assert before != fem_answer(with_key(FEM, key, other_value(key, KEYS[key])), block)


def fem_answer(data: Mapping[str, Any], mesh: TissueMesh) -> tuple[object, ...]:
    """Keys of mesh and solve, estimates asked for, limits and notes; a refusal is an answer too."""
    try:
        scenario = parse_scenario(data)
        band = frequencies(scenario.sweep)
        made = mesh_key(scenario), fem.solve_key(scenario, mesh, band), scenario.solver.discretisation_estimate
        refused = forecast(scenario, mesh=mesh).memory_bytes > scenario.solver.memory_limit
    except ForearmError as problem:
        return (str(problem),)
    passing = len(mesh.tetrahedra) <= scenario.mesh.max_elements, mesh_quality(mesh).least >= scenario.mesh.min_quality
    return *made, refused, *passing, scene_notes(scenario)


SLAB = {"shape": "slab", "length": 0.1, "width": 0.1, "depth": 0.03}
IDLE = [
    ({"device.contacts": [[0.0, 0.0]], "device.spacing": 0.03}, "device.spacing"),
    ({"device.columns": 1, "device.spacing_y": 0.03}, "device.spacing_y"),
    ({"device.drive": "force", "device.coil.quality": 4.0}, "device.coil"),
    ({"device.drive": "displacement", "device.housing.mass": 0.1}, "device.housing"),
    ({"device.drive": "force", "device.max_power": 2.0}, "device.max_power"),
    ({"device.drive": "force", "device.cone.mass": 1e-3}, "device.cone.mass"),
    ({"device.housing.fixed": True, "device.housing.mass": 0.2}, "device.housing.mass"),
    ({"device.housing.fixed": True, "device.housing.skin_share": 0.03}, "device.housing.skin_share"),
    ({"device.out_of_contact": ["A1"], "device.contact_springs": {"A1": 50.0}}, "device.contact_springs.A1"),
    ({"grid.points": [[0.0, 0.0]], "grid.rows": 4}, "grid.rows"),
    ({"grid.columns": 1, "grid.pitch_y": 0.02}, "grid.pitch_y"),
    ({"sweep.frequencies": [100.0], "sweep.f_min": 20.0}, "sweep.f_min"),
    ({"supports.foam_damping": 10.0}, "supports.foam_damping"),
    ({"limb": SLAB, "supports.underside": "fixed"}, "supports.underside"),
    ({"limb.bones": [], "supports.bone": "elastic"}, "supports.bone"),
    ({"solver.sweep": "direct", "solver.start": "rate"}, "solver.start"),
    ({"solver.start": "frequencies", "solver.rate_derivatives": 90}, "solver.rate_derivatives"),
    ({"rendering.methods": ["funneling"], "rendering.regularisation": "lcurve"}, "rendering.regularisation"),
    ({"rendering.wavelet.file": "a.csv", "rendering.wavelet.peak": 200.0}, "rendering.wavelet.peak"),
    ({"tissues.override.gel": {"mu": 1e3, "eta": 1.0, "density": 1e3, "bulk": 1e9}}, "tissues.override.gel"),
    ({"tissues.override.bone": {"density": 1900.0}}, "tissues.override.bone"),
    ({"tissues.patch.length": 0.03}, "tissues.patch.length"),
    ({"mesh.sublayers": {"gristle": 2}}, "mesh.sublayers.gristle"),
]


@pytest.mark.parametrize(("changes", "names"), IDLE)
def test_a_key_without_effect_cannot_be_written(changes: Mapping[str, Any], names: str) -> None:
    data: dict[str, Any] = {}
    for key, value in changes.items():
        data = with_key(data, key, value)
    with pytest.raises(ScenarioError, match=rf"(^|\W){re.escape(names)}\b.*no effect: .*; \w+"):  # and a cure
        parse_scenario(data)
    with pytest.raises(ScenarioError, match="no effect"):
        Scenario().changed(changes)


@pytest.mark.parametrize(("changes", "names"), [case for case in IDLE if len(case[0]) == 2])
def test_a_change_drops_what_it_leaves_without_effect(changes: Mapping[str, Any], names: str) -> None:
    (other, value), (key, before) = changes.items()
    base = Scenario().changed({key: before}) if other != "supports.bone" else Scenario()
    made = base.changed({other: value})
    assert not any(f"{k}.".startswith(f"{names}.") for k in made.changed_keys())
    assert made == Scenario().changed({other: value})


def test_no_copy_escapes_the_checks() -> None:
    scenario = Scenario()
    for change in (
        lambda: scenario.changed({"device.cone.radius": -1}),
        lambda: scenario.device.cone.changed({"radius": -1}),
        lambda: scenario.model_copy(update={"accuracy": -1}),
        lambda: scenario.device.cone.model_copy(update={"radius": -1}),
        lambda: scenario.device.cone.copy(update={"radius": -1}),
    ):
        with pytest.raises(ScenarioError, match="expected"):
            change()


def test_a_change_is_as_if_the_file_had_said_so() -> None:
    scenario = load_scenario("thesis")
    changes = {"accuracy": 0.2, "device.actuator": "TEAX09C005-8", "limb.layers.0.thickness": 1e-3}
    made = scenario.changed(changes)
    assert made.limb.length == 0.12  # follows the accuracy, as it was left out
    assert made.device.coil.moving_mass == 0.13e-3  # follows the actuator
    assert [layer.thickness for layer in made.limb.layers] == [1e-3, 3e-3]
    assert made.changed({"device.actuator": None}).device == scenario.device
    assert scenario.changed({}) == scenario


def test_the_digest_is_of_what_counts() -> None:
    scenario = load_scenario("quick")
    assert scenario.changed({"name": "other", "description": "words"}).digest == scenario.digest
    assert scenario.changed({"device.spacing": 0.04}).digest != scenario.digest
    assert scenario.changed({"device.spacing": 0.045}).digest == scenario.digest  # said or left out


@pytest.mark.parametrize(
    ("said", "key", "si"),
    [
        ("device.spacing=40mm", "device.spacing", 0.04),
        ("sweep.f_max=0.25 kHz", "sweep.f_max", 250.0),
        ("tissues.override.skin.mu=12kPa", "tissues.override.skin.mu", 12e3),
        ("device.cone.mass=0.3g", "device.cone.mass", 0.3e-3),
        ("device.rotation=90deg", "device.rotation", np.pi / 2),
        ("sweep.duration=500ms", "sweep.duration", 0.5),
        ("device.spacing=0.04", "device.spacing", 0.04),
    ],
)
def test_an_override_takes_units(said: str, key: str, si: float) -> None:
    value = functools.reduce(
        lambda part, name: part[name] if isinstance(part, dict) else getattr(part, name),
        key.split("."), load_scenario("thesis", overrides=[said]),
    )  # fmt: skip
    assert value == pytest.approx(si, rel=1e-15)


def test_a_unit_of_another_kind_is_refused() -> None:
    with pytest.raises(ScenarioError, match=r"device.spacing: expected a number in m.*got '40Hz'"):
        load_scenario("thesis", overrides=["device.spacing=40Hz"])


def test_a_scenario_of_schema_1_is_told_what_to_change() -> None:
    with pytest.raises(ScenarioError, match=r"schema_version: 1 .*write 2"):
        parse_scenario({"schema_version": 1, "tissues": {"override": {"skin": {"mu": 1e4}}}})
    old = {"tissues": {"override": {"skin": {"model": "springpot"}}}}
    with pytest.raises(ScenarioError, match=r"tissues\.override\.skin\.model is called tissues\.override\.skin\.law"):
        parse_scenario({"schema_version": 1, **old})
    with pytest.raises(ScenarioError, match=r"skin\.model: unknown key; did you mean tissues\.override\.skin\.law"):
        parse_scenario(old)


def test_defaults_are_no_changes() -> None:
    assert Scenario().changed_keys() == ()
