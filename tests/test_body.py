"""Forearms from a tape measure: the presets stand, fat follows the fold, mistakes are one sentence."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from cli_runner import cli

from forearm_fem.errors import GeometryError, ScenarioError
from forearm_fem.geometry.device.place import parametric_skin, ports_on
from forearm_fem.scenario import BODIES, Tape, load_scenario, parse_scenario


@pytest.mark.parametrize(("name", "spacing"), [("small", 0.038), ("median", 0.045), ("large", 0.045)])
def test_the_device_sits_on_each_measured_arm(name: str, spacing: float) -> None:
    """Geometry takes every arm: bones inside the muscle, all four contacts on the volar skin."""
    scenario = parse_scenario({"limb": BODIES[name].limb(), "device": {"spacing": spacing}})
    skin = parametric_skin(scenario)
    assert skin is not None
    assert len(ports_on(scenario, skin)) == 13


def test_the_thesis_device_is_too_wide_for_the_thinnest_arm() -> None:
    """It was made for 22 cm; this arm has 17.3 cm under it, and the outer contacts hang over its side."""
    scenario = parse_scenario({"limb": BODIES["small"].limb()})
    skin = parametric_skin(scenario)
    assert skin is not None
    with pytest.raises(GeometryError, match="reaches beyond the limb"):
        ports_on(scenario, skin)


def test_girths_are_those_of_shahs_arms() -> None:
    at_device = {name: dict(body.limb()["circumference"])[0.0] for name, body in BODIES.items()}
    assert at_device == {"small": 0.173, "median": 0.2255, "large": 0.266}
    large = BODIES["large"].limb()["circumference"]
    assert large[0] == (-0.08, 0.203)  # x grows towards the elbow, so the wrist comes first
    assert large[-1] == (0.08, 0.279)


def test_a_tape_measure_puts_the_device_in_the_middle_and_bones_to_scale() -> None:
    tape = Tape(((0.0, 0.25), (0.2, 0.15)), 0.2, skinfold=0.0124)
    limb = tape.limb()
    assert limb["circumference"] == [(-0.1, 0.15), (0.1, 0.25)]
    assert limb["layers"][1] == {"tissue": "fat", "thickness": pytest.approx(0.0062 - 0.0012)}
    scale = (0.20 / (2 * math.pi) - 0.0062) / (0.227 / (2 * math.pi) - 0.0042)  # radii of the muscle
    assert limb["bones"][0]["diameter"] == pytest.approx(0.014 * scale, abs=1e-6)
    assert Tape(tape.circumference, 0.2, skinfold=1e-3).limb()["layers"][1]["thickness"] == 0.5e-3
    assert math.isclose(Tape(tape.circumference, 0.2).limb()["layers"][1]["thickness"], 3e-3)


def test_mistakes_with_the_tape_are_one_sentence() -> None:
    with pytest.raises(ScenarioError, match="two or more distances"):
        Tape(((0.1, 0.2), (0.0, 0.2)), 0.2).limb()
    with pytest.raises(ScenarioError, match=r"0\.15 m from the elbow, but circumferences are known from 0 to 0\.1"):
        Tape(((0.0, 0.2), (0.1, 0.2)), 0.3).limb()


def test_new_writes_the_arm_into_the_scenario(tmp_path: Path) -> None:
    assert cli("new", "mine", "--arm", "small", cwd=tmp_path).code == 0
    assert load_scenario(tmp_path / "mine.toml").limb == parse_scenario({"limb": BODIES["small"].limb()}).limb
    tape = "0:0.25,0.08:0.23,0.16:0.17,0.24:0.16"
    answer = cli("new", "own", "--tape", tape, "--length", 0.24, "--skinfold", 0.01, cwd=tmp_path)
    assert answer.code == 0, answer.err
    limb = load_scenario(tmp_path / "own.toml").limb
    assert dict(limb.circumference)[0.04] == 0.23
    assert limb.layers[1].thickness == pytest.approx(0.0038)
    for options, message in (
        (("--arm", "huge"), "no forearm is called 'huge'; known are small, median, large"),
        (("--arm", "small", "--tape", tape), "give one of them"),
        (("--tape", tape), "--tape needs --length"),
        (("--tape", "0.2,0.3", "--length", 0.2), "expected DISTANCE:CIRCUMFERENCE pairs"),
        (("--skinfold", 0.01), "go with --tape or --arm"),
        (("--arm", "small", "--skinfold=-0.01"), "skinfold: expected a caliper's reading above 0 m, got -0.01"),
        (("--arm", "small", "--skinfold", 0), "skinfold: expected a caliper's reading above 0 m, got 0"),
        (("--arm", "small", "--skinfold", "nan"), "skinfold: expected a caliper's reading above 0 m, got nan"),
    ):
        answer = cli("new", "bad", *options, cwd=tmp_path)
        assert answer.code == 2
        assert message in answer.sentence
    assert not (tmp_path / "bad.toml").exists()
