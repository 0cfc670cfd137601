"""Presets of actuators: what they set, what is said of them, and the rotating mass."""

from __future__ import annotations

from typing import Any, get_args

import numpy as np
import pytest

from forearm_fem.device import RotatingMass
from forearm_fem.engines.forecast import actuator_notes, covered_notes, lifted_notes, scene_notes
from forearm_fem.errors import DataError, ScenarioError
from forearm_fem.ports import Port
from forearm_fem.questions.run import Run
from forearm_fem.scenario import Scenario, parse_scenario
from forearm_fem.scenario.actuators import ACTUATORS, ActuatorName
from forearm_fem.transfer import TransferMatrix

POINT = Port("1", "point", (0.0, 0.0, 0.0))
CONTACT = Port("A1", "contact", (0.02, 0.0, 0.0), radius=0.0035)


def test_every_preset_has_a_source_and_makes_a_device():
    assert tuple(ACTUATORS) == get_args(ActuatorName)
    for name, known in ACTUATORS.items():
        device = parse_scenario({"device": {"actuator": name}}).device
        assert known.source
        assert known.use
        assert device.drive == known.drive


def test_the_thesis_coil_is_the_default_and_changes_nothing():
    assert parse_scenario({"device": {"actuator": "TEAX14C02-8"}}) == Scenario()
    assert actuator_notes(Scenario()) == ()


def test_keys_given_count_over_the_preset():
    device = parse_scenario({"device": {"actuator": "TEAX09C005-8", "coil": {"resonance": 600.0}}}).device
    assert (device.coil.force_factor, device.coil.moving_mass, device.coil.resonance) == (1.1, 0.13e-3, 600.0)
    assert device.coil.resistance == Scenario().device.coil.resistance  # not seen, so kept
    again = parse_scenario(parse_scenario({"device": device.model_dump()}).model_dump()).device
    assert again == device


def test_the_notes_say_what_it_is_for_and_when_it_cannot_play_the_band():
    use, band = actuator_notes(parse_scenario({"device": {"actuator": "ERM"}}))
    assert "neither wavelets" in use
    assert "10 to 500 Hz reaches beyond the 102.3 to 241.2 Hz" in band
    within: dict[str, Any] = {"device": {"actuator": "ERM"}, "sweep": {"f_min": 110.0, "f_max": 240.0}}
    assert len(actuator_notes(parse_scenario(within))) == 1


def test_an_unknown_preset_is_one_sentence():
    with pytest.raises(ScenarioError, match=r"device\.actuator.*TEAX14C02-8"):
        parse_scenario({"device": {"actuator": "TEAX1"}})


def test_shahs_motor_is_one_rotating_mass():
    """Its accelerations follow the square of its frequency; they are stated to 0.05 g, 4 % of their middle."""
    motor = RotatingMass.shah()
    unbalance, spread = motor.unbalance(0.1)
    assert spread < 0.05
    slope = np.polyfit(np.log(motor.frequency), np.log(motor.acceleration), 1)[0]
    assert slope == pytest.approx(2, abs=0.15)  # the lowest step is stated to 5.5 %, its frequency is 2.4 times less
    force = unbalance * (2 * np.pi * motor.frequency) ** 2
    assert np.allclose(force, motor.force(0.1), rtol=0.12)  # 0.05 g of the lowest step, 0.45 g


def test_steady_tones_are_g_times_the_force():
    f = np.linspace(50.0, 300.0, 251)
    g = TransferMatrix(f, (2e-4 / f)[:, None, None] + 0j, (POINT,), (CONTACT,), "m/N")
    motor = RotatingMass.shah()
    assert np.allclose(motor.steady(g, 0.1, "A1")[:, 0], 2e-4 / motor.frequency * motor.force(0.1), rtol=1e-4)
    with pytest.raises(DataError, match="needs G in m/N"):
        motor.steady(TransferMatrix(f, g.values, (POINT,), (CONTACT,), "m/V"), 0.1, "A1")
    with pytest.raises(DataError, match="give the moving body's mass"):
        motor.steady(g, -0.1, "A1")  # a peak below nothing
    with pytest.raises(DataError, match="solve a wider band"):
        motor.steady(TransferMatrix(f[:50], g.values[:50], (POINT,), (CONTACT,), "m/N"), 0.1, "A1")
    valid = np.ones(g.values.shape, dtype=bool)
    valid[120:130] = False  # 170 to 179 Hz: the motor's fifth step
    masked = motor.steady(TransferMatrix(f, g.values, (POINT,), (CONTACT,), "m/N", valid=valid), 0.1, "A1")[:, 0]
    assert np.flatnonzero(np.isnan(masked)).tolist() == [4]  # what may not be used moves nothing that is known


def test_a_run_says_that_funneling_drives_what_does_not_touch(tmp_path):
    lifted = {"device": {"out_of_contact": ["A2"]}}
    (note,) = lifted_notes(parse_scenario(lifted))
    assert "no skin moves under A2, but shares of funneling and combination follow from places alone" in note
    assert note in Run.start(parse_scenario(lifted), tmp_path, tmp_path).notes
    assert not lifted_notes(parse_scenario({**lifted, "rendering": {"methods": ["inverse filter"]}}))
    assert not lifted_notes(Scenario())


def test_points_under_a_cone_are_named():
    """Six around one: the seventh stands on the middle target, whose S was told without a word."""
    six = {"rows": 3, "columns": [2, 3, 2], "spacing": 0.0217, "spacing_y": 0.025}
    (note,) = covered_notes(parse_scenario({"device": six}))
    assert note in scene_notes(parse_scenario({"device": six}))
    assert note.startswith("grid: points 1, 3, 4, 5, 6, 7, ... lie under a cone or within 9 mm of its rim")
    bare = {"rendering": {"clearance": 0.0}}
    (note,) = covered_notes(parse_scenario({"device": six, **bare}))
    assert note.startswith("grid: point 5 lies under a cone")
    assert not covered_notes(parse_scenario({"device": {**six, "out_of_contact": ["A4"]}, **bare}))
    assert not covered_notes(Scenario())
    assert not covered_notes(parse_scenario({"device": six, "rendering": {"methods": []}}))
