"""What a rig adds to G: what is said of it in a formula, and what a virtual device and the estimator make of it."""

from __future__ import annotations

import numpy as np
import pytest
from test_measurement_scene import DURATION, RATE, device_for, plan_for, wave_matrix

from forearm_fem.measurement.calibrate import calibrate
from forearm_fem.measurement.chain import reported
from forearm_fem.measurement.virtual import VirtualSensor
from forearm_fem.scenario import Scenario, parse_scenario
from forearm_fem.scenario.measurement import RigOptions, SensorOptions

TRUTH = wave_matrix()


def scene(quantity: str, **rig: float) -> Scenario:
    """The tests' sweep with a rig."""
    how = {"repeats": 2, "sensor": {"quantity": quantity, "sensitivity": 200.0}, "rig": rig}
    return parse_scenario({"sweep": {"duration": DURATION, "sample_rate": RATE}, "measurement": how})


def missed(values) -> np.ndarray:
    """rms error over entries at each frequency (n,) [m/V]."""
    return np.sqrt(np.mean(np.abs(values - TRUTH.values) ** 2, axis=(1, 2)))


@pytest.mark.parametrize(
    ("quantity", "rig"),
    [("displacement", {"motion": 1e-5}), pytest.param("velocity", {"motion": 1e-5}, marks=pytest.mark.slow),
     ("velocity", {"noise": 1e-6}), pytest.param("displacement", {"noise": 1e-6}, marks=pytest.mark.slow)],
)  # fmt: skip
def test_the_formula_is_what_the_estimator_makes_of_the_signal(tmp_path, quantity, rig):
    """36 entries of a virtual rig, and the mean of 20 rigs by the formula."""
    sensor = VirtualSensor(quantity, 200.0)
    daq = device_for(TRUTH, sensor=sensor, rig=RigOptions(**rig), bits=0, seed=3)
    plan = plan_for(TRUTH, repeats=2, max_drift=1e6)
    how = plan.options.changed({"sensor": SensorOptions(quantity=quantity, sensitivity=200.0).model_dump()})
    found = calibrate(type(plan)(plan.outputs, plan.inputs, plan.sweep, how), daq, tmp_path).transfer
    asked = scene(quantity, **rig)
    rigs = (reported(TRUTH, asked, np.random.default_rng(k)) for k in range(20))
    said = np.sqrt(np.mean([missed(rig.values) ** 2 for rig in rigs], axis=0))
    f = TRUTH.frequency
    for band in ((20, 60), (60, 150), (150, 300)):  # above, samples of 2 kHz sum a way too coarsely
        here = (f >= band[0]) & (f < band[1])
        ratio = np.sqrt(np.mean(missed(found.values)[here] ** 2) / np.mean(said[here] ** 2))
        # a leak has one random number an entry and repeat: 72 know their rms to 1/sqrt(144) = 8 %; three of these
        assert ratio == pytest.approx(1.0, abs=0.25), band


def test_recorded_displacement_leaks_and_velocity_does_not():
    """10 um between the ends of a record: h/omega over the sweep where displacement is recorded, 3 Hz/f of that less
    where velocity is."""
    both = [missed(reported(TRUTH, scene(q, motion=1e-5), np.random.default_rng(0)).values)
            for q in ("displacement", "velocity")]  # fmt: skip
    at = TRUTH.frequency == 200.0
    assert (both[1] / both[0])[at] == pytest.approx(3 / 200, rel=0.5)


def test_nothing_is_added_by_default_and_entries_keep_their_own_gain():
    assert np.array_equal(reported(TRUTH, scene("velocity"), np.random.default_rng(0)).values, TRUTH.values)
    found = reported(TRUTH, scene("velocity", gain=0.1, phase=0.1), np.random.default_rng(0)).values / TRUTH.values
    assert np.ptp(np.abs(found), axis=0).max() < 1e-12  # the same at all frequencies
    spread = np.std(np.log(np.abs(found[0]))), np.std(np.angle(found[0]))
    assert spread == pytest.approx((0.1, 0.1), rel=0.4)  # 36 entries know it to 12 %; three of these
