"""Limits, unknown entries of G and impossible wishes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_rendering import waves

from forearm_fem.device import close_loop
from forearm_fem.engines.layered import solve_layered
from forearm_fem.errors import AccuracyWarning, DataError, ScenarioError
from forearm_fem.metrics import signal_strength
from forearm_fem.rendering import (
    Combination,
    Funneling,
    InverseFilter,
    Limits,
    Record,
    ThesisZeros,
    Wavelet,
    check,
    displacements,
    drives,
    render_all,
    ricker,
)
from forearm_fem.rendering.renderers import Regularisation
from forearm_fem.scenario import parse_scenario


@pytest.fixture(scope="module")
def g():
    return waves()


@pytest.fixture(scope="module")
def coarse():
    """Every 5 Hz on the bins of a record of 0.2 s, for tests that render often."""
    return waves(np.arange(10.0, 500.1, 5.0))


@pytest.fixture(scope="module")
def short():
    return ricker(duration=0.2)


METHODS = (InverseFilter(), Funneling(), Combination())


# ---------------------------------------------------------------- limits


def test_limits_name_every_actuator_that_exceeds_them(coarse, short):
    sent = drives(Funneling(amplitude=20.0), coarse, "1", short)
    report = check(sent, Limits(voltage=5.0, power=0.05, resistance=8.0))
    assert report.checked
    assert np.allclose(report.power, np.mean(sent.signals**2, axis=1) / 8, rtol=1e-12)
    assert np.allclose(report.rms**2 / 8, report.power, rtol=1e-12)
    over = [p.name for p, v, w in zip(sent.inputs, report.peak, report.power, strict=True) if v > 5 or w > 0.1]
    assert over == ["A1"]  # nearest to point 1
    assert [line.split(":")[0] for line in report.exceeded] == ["A1", "A1"]
    assert check(drives(Funneling(amplitude=0.2), coarse, "1", short)).exceeded == ()


def test_power_over_a_window_is_the_loudest_one(coarse, short):
    sent = drives(Funneling(), coarse, "1", short)
    loud = check(sent, Limits(window=0.004)).power
    whole = check(sent, Limits()).power
    assert np.all(loud > 10 * whole)  # a burst of 4 ms in a record of 200 ms
    assert np.allclose(check(sent, Limits(window=0.2)).power, whole, rtol=1e-9)
    with pytest.raises(ScenarioError, match="window"):
        check(sent, Limits(window=1.0))


def test_forces_are_not_judged_as_voltages(coarse, short):
    report = check(drives(Funneling(amplitude=100.0), replace(coarse, unit="m/N"), "1", short))
    assert not report.checked
    assert report.exceeded == ()
    assert np.all(np.isnan(report.power))


# ---------------------------------------------------------------- unknown entries


def test_masked_bins_are_not_driven_and_are_reported(g):
    wavelet = ricker()
    valid = np.ones(g.values.shape, dtype=bool)
    out = (g.frequency >= 200) & (g.frequency < 300)
    valid[out, 4, 2] = False
    values = np.where(valid, g.values, np.nan)
    masked = replace(g, values=values, valid=valid)
    energy = np.abs(wavelet.spectrum[20:1001]) ** 2
    share = energy[out].sum() / np.sum(np.abs(wavelet.spectrum) ** 2)
    for method in METHODS:
        sent, full = drives(method, masked, "5", wavelet), drives(method, g, "5", wavelet)
        assert np.all(sent.spectrum[out] == 0)
        assert np.array_equal(sent.spectrum[~out], full.spectrum[~out])
        assert sent.lost - full.lost == pytest.approx(share, rel=1e-9)
        assert np.all(np.isfinite(displacements(masked, sent).values))
    valid[g.frequency > 300] = False  # beyond the last known bin nothing is bridged
    with pytest.warns(AccuracyWarning, match="of the wavelet's energy"):
        render_all(replace(masked, valid=valid), ["5"])


@pytest.mark.parametrize("n", [2000, 2001])
def test_what_is_lost_is_the_energy_missing_from_the_signal(n):
    """By Parseval, for a click, whose energy lies at 0 Hz and Nyquist as much as anywhere."""
    record = Record(10000.0 * n / 2000, n)
    click = Wavelet(np.eye(1, n, record.centre)[0], record)
    sent = drives(Funneling(), waves(np.arange(10.0, 500.1, 5.0)), "5", click)
    kept = np.sum(sent.signals.sum(axis=0) ** 2) / np.sum(click.samples**2)
    assert sent.lost == pytest.approx(1 - kept, abs=1e-12)  # rounding


def test_an_unknown_zero_point_costs_only_its_own_row(coarse, short):
    valid = np.ones(coarse.values.shape, dtype=bool)
    valid[:, 1] = False  # output "2" was never measured, and is no control point of target 5
    masked = replace(coarse, valid=valid)
    sent = drives(InverseFilter(), masked, "5", short)
    assert np.array_equal(sent.spectrum, drives(InverseFilter(), coarse, "5", short).spectrum)
    reached = displacements(masked, sent)
    assert np.all(np.isnan(reached.values[1]))
    assert np.allclose(reached.lost, np.arange(9) == 1, atol=1e-12)  # a sum of energies over itself
    with pytest.warns(AccuracyWarning, match="leaves out 1 of 8"):
        assert np.isfinite(signal_strength(reached.values, 4))
    with pytest.raises(DataError, match="invalid on every bin"):
        drives(InverseFilter(), masked, "2", short)


def test_an_actuator_that_was_never_measured_stays_silent(coarse, short):
    valid = np.ones(coarse.values.shape, dtype=bool)
    valid[:, :, 3] = False
    masked = replace(coarse, valid=valid)
    for method in METHODS:
        sent = drives(method, masked, "5", short)
        assert np.all(sent.signals[3] == 0)
        assert np.abs(sent.signals[0]).max() > 0
        assert np.all(displacements(masked, sent).lost == 0)


def test_nan_that_is_not_masked_is_an_error(coarse, short):
    values = coarse.values.copy()
    values[3, 2, 1] = np.nan
    with pytest.raises(DataError, match=r"1 entries that are not finite, the first at 25 Hz"):
        drives(Funneling(), replace(coarse, values=values), "5", short)


def test_replaying_drives_on_a_narrower_g_counts_the_missing_bins(coarse, short):
    sent = drives(Funneling(), coarse, "5", short)
    half = replace(coarse, frequency=coarse.frequency[40:], values=coarse.values[40:])
    reached = displacements(half, sent)
    energy = np.sum(np.abs(sent.spectrum) ** 2, axis=1)
    assert np.allclose(reached.lost, energy[:40].sum() / energy.sum(), rtol=1e-9)
    with pytest.raises(ScenarioError, match="inputs"):
        displacements(replace(half, inputs=half.inputs[:3], values=half.values[:, :, :3]), sent)


# ---------------------------------------------------------------- wrong wishes


@pytest.mark.parametrize(
    ("zeros", "target", "message"),
    [
        (("1", "5"), "5", "output '5' is both the target and a zero point"),
        (("1", "12"), "5", "'12' is no output"),
        (("1", "1"), "5", "name an output twice"),
        (ThesisZeros(), "0", "'0' is no output of G; its outputs are 1, 2"),
    ],
)
def test_impossible_control_points_are_named(coarse, short, zeros, target, message):
    for method in (InverseFilter(zeros=zeros), Combination(zeros=zeros)):
        with pytest.raises(ScenarioError, match=message):
            drives(method, coarse, target, short)


def test_a_shape_that_does_not_fit_the_ports_is_an_error(coarse, short):
    """Said where G is made, before any renderer; a list, another unit and a name given twice are as little a G."""
    with pytest.raises(DataError, match=r"G's values: expected \(99, 9, 4\)"):
        replace(coarse, values=coarse.values.swapaxes(1, 2))
    with pytest.raises(DataError, match=r"a numpy array.*got list"):
        replace(coarse, values=coarse.values.tolist())
    for unit in ("mm/V", "m/s/V"):
        with pytest.raises(DataError, match=f"got {unit}; convert the values"):
            replace(coarse, unit=unit)
    with pytest.raises(DataError, match="two of G's outputs have the same name"):
        replace(coarse, outputs=(coarse.outputs[0], *coarse.outputs[:-1]))


# ---------------------------------------------------------------- degenerate and noisy matrices


def reached(g, renderer):
    return displacements(g, drives(renderer, g, "5", ricker(duration=0.2))).values


CORNERS = ("1", "3", "7", "9")


def test_two_identical_actuators_reach_what_three_reach(coarse):
    """A4 a copy of A3: rank 3 of 4; rounding of the inversion is left."""
    twice = replace(coarse, values=coarse.values[:, :, [0, 1, 2, 2]], contacts=None)
    three = replace(coarse, values=coarse.values[:, :, :3], inputs=coarse.inputs[:3], contacts=None)
    a, b = (reached(g, InverseFilter(CORNERS, Regularisation(value=1e-9))) for g in (twice, three))
    assert np.abs(a - b).max() < 1e-6 * np.abs(b).max()


@pytest.mark.parametrize("decibel", [60, 40, 20, 0])
def test_loss_follows_the_noise_of_g(decibel):
    """Drives from a noisy G, judged on the true one of layered skin; with Tikhonov at the noise's own size the
    amplification by the condition number is about 1 to 2.5."""
    scenario = parse_scenario({"engine": "layered", "device": {"drive": "force"}})
    g = close_loop(solve_layered(scenario, np.arange(10.0, 500.1, 5.0)), scenario.device)
    rng, size = np.random.default_rng(1), 10 ** (-decibel / 20)
    rms = np.sqrt(np.mean(np.abs(g.values) ** 2, axis=(1, 2), keepdims=True) / 2)
    noise = size * rms * (rng.normal(size=g.values.shape) + 1j * rng.normal(size=g.values.shape))
    renderer = InverseFilter(CORNERS, Regularisation("tikhonov", max(1e-3, min(size, 0.9))))
    wavelet = ricker(duration=0.2)
    noisy = replace(g, values=g.values + noise, contacts=None)
    clean, real = (displacements(g, drives(renderer, x, "5", wavelet)).values for x in (g, noisy))
    assert np.abs(clean - real).max() < 3 * size * np.abs(clean).max()
