"""What errs alike in each repeat: hum, a drifting offset, clocks that run apart, a sensor that hears the drive.

Recordings are made here with numpy from a resonance that is known in closed form; nothing of them is the package's.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from forearm_fem.measurement.entry import Entry, entry
from forearm_fem.measurement.estimators import ExponentialSweep
from forearm_fem.measurement.recording import Recording
from forearm_fem.scenario.measurement import MeasurementOptions

RATE, BAND = 10000.0, (10.0, 500.0)
SENT = ExponentialSweep().samples()
N = len(SENT)
T = np.arange(4 * N) / RATE


def truth(f: Any) -> Any:
    """A resonance at 80 Hz, 4 ms away [m/V]."""
    return 8e-6 / (1 - (f / 80) ** 2 + 0.8j * f / 80) * np.exp(-2j * np.pi * f * 4e-3)


def measured(change: Callable[[Any, float], Any], repeats: int = 4, noise: float = 1e-4) -> Entry:
    """The entry of a velocity at 100 V s/m in 80 dB of noise, of whose volts and peak ``change`` makes others."""
    f = np.fft.rfftfreq(N, 1 / RATE)
    volts = np.tile(np.fft.irfft(np.fft.rfft(SENT) * truth(f) * 2j * np.pi * f * 100, N), 4)
    peak = float(np.abs(volts).max())
    noisy = volts + noise * peak * np.random.default_rng(3).standard_normal(len(volts))
    rows = np.asarray(change(noisy, peak)).reshape(4, N)[:repeats]
    sensor = {"quantity": "velocity", "sensitivity": 100.0}
    return entry(Recording("1", "A1", RATE, SENT, rows), BAND, MeasurementOptions(sensor=sensor, repeats=repeats))


def plus(extra: Any, volts: Any, peak: float) -> Any:
    """Something ``extra``, in parts of the response's ``peak``."""
    return volts + peak * extra


def kinds(found: Entry) -> list[str]:
    return [f.kind for f in found.findings]


def pulls(found: Entry) -> Any:
    """Error over stated deviation where the entry may be used."""
    return (np.abs(found.value - truth(found.frequency)) / found.deviation)[found.valid]


def test_a_clean_recording_is_said_nothing_of():
    found = measured(lambda y, a: y)
    assert kinds(found) == []
    assert np.sqrt(np.mean(pulls(found) ** 2)) == pytest.approx(1.0, abs=0.15)  # 981 bins


ON, OFF = (50.0, 60.0), (49.97, 60.02, 49.8)


@pytest.mark.parametrize(("frequency", "repeats"), [*((f, r) for f in ON for r in (1, 2, 4)), *((f, 4) for f in OFF)])
def test_hum_is_in_the_deviation_of_its_bin(frequency: float, repeats: int):
    """A line of 1 % of the response's peak is 30 % of the entry in its bin. Off the bin by more than a tenth of one it
    differs between repeats, of which a single one has none."""
    found = measured(lambda y, a: y + 0.01 * a * np.sin(2 * np.pi * frequency * T + 1), repeats)
    off = np.abs(found.value - truth(found.frequency))
    assert off.max() > 0.04 * np.abs(truth(found.frequency[off.argmax()]))
    assert np.where(found.valid, off / found.deviation, 0)[off.argmax()] < 2
    assert np.sqrt(np.mean(pulls(found) ** 2)) < 2
    assert "hum" in kinds(found) or abs(frequency * 2 - round(frequency * 2)) > 0.1


def test_hum_in_the_bands_first_bins_is_in_their_deviation():
    for frequency in (10.0, 10.5, 499.5, 500.0):
        line = 0.01 * np.sin(2 * np.pi * frequency * T)
        found = measured(partial(plus, line))
        assert pulls(found).max() < 4, frequency


def test_the_ramp_of_a_drifting_offset_is_in_the_deviation_and_said():
    found = measured(lambda y, a: y + 0.1 * a * T)
    off = np.abs(found.value - truth(found.frequency))
    assert off[0] > 0.4 * np.abs(truth(found.frequency[0]))
    assert kinds(found) == ["drifting offset"]
    assert np.sqrt(np.mean(pulls(found) ** 2)) == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize(("parts", "usable"), [(1e-6, True), (1e-5, True), (5e-5, False), (2e-4, False)])
def test_clocks_that_run_apart_are_named(parts: float, usable: bool):
    """One part in a hundred thousand turns the phase at 500 Hz by .16 after four periods: no arm moved."""

    def slower(y: Any, a: float) -> Any:
        return CubicSpline(np.arange(len(y) + 99), np.append(y, y[:99]))(np.arange(len(y)) * (1 + parts))

    found = measured(slower)
    assert kinds(found) == ["clocks"]
    said = float(found.findings[0].sentence.split(" parts per million")[0].split()[-1])
    assert said == pytest.approx(parts * 1e6, rel=0.1)
    assert found.valid.any() == usable
    assert not usable or pulls(found).max() < 4


def test_a_sensor_that_hears_the_drive_alone_is_named():
    noise = 1e-5 * np.random.default_rng(1).standard_normal(4 * N)
    assert kinds(measured(lambda y, a: 0.3 * np.tile(np.roll(SENT, 7), 4) + noise)) == ["drive itself"]
    assert kinds(measured(lambda y, a: 1e-3 * np.tile(SENT, 4) + noise)) == ["drive itself"]


@pytest.mark.parametrize("still", ["hum", "drift"])
def test_a_dead_sensor_with_hum_or_drift_is_no_response(still: str):
    noise = 1e-5 * np.random.default_rng(1).standard_normal(4 * N)
    found = measured(lambda y, a: noise + (0.01 * np.sin(2 * np.pi * 50 * T) if still == "hum" else 0.01 * T))
    assert "no response" in kinds(found)
    assert not found.valid.any()


def test_an_offset_that_wanders_is_no_loss_of_samples():
    found = measured(lambda y, a: y + 0.2 * a * np.sin(2 * np.pi * 1.3 * T))
    assert "dropped samples" not in kinds(found)
    assert pulls(found).max() < 2


def test_hum_out_of_step_with_the_repeats_spoils_no_other_bins():
    """Some 0.4 bins off, it scatters in its own two bins; seven to either side were blamed, too."""
    clean, hummed = (measured(partial(plus, h * np.sin(2 * np.pi * 49.8 * T))) for h in (0.0, 3e-4))
    beside = np.isin(clean.frequency, (47.5, 52.0))
    assert beside.any()
    assert (hummed.deviation / clean.deviation)[beside].max() < 20  # 13 are its own tails; 69 when smoothed
