"""Renderers on a synthetic G: damped cylindrical waves between the device's ports."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import hankel2

from forearm_fem.errors import AccuracyWarning, DataError, GeometryError, ScenarioError
from forearm_fem.metrics import signal_strength, signal_strength_table
from forearm_fem.ports import Port, distances
from forearm_fem.rendering import (
    Combination,
    Funneling,
    InverseFilter,
    Limits,
    Record,
    SearchedZeros,
    Wavelet,
    displacements,
    drives,
    funneling_weights,
    on_record_bins,
    render_all,
    ricker,
    strengths,
)
from forearm_fem.rendering.drives import precomputed_for_targets
from forearm_fem.rendering.job import RenderJob
from forearm_fem.transfer import TransferMatrix

BAND = np.arange(20, 1001) * 0.5  # the 981 bins of the thesis' record between 10 and 500 Hz


def actuators(side=0.045, shift=(0.0, 0.0), angle=0.0):
    corners = [(-1, -1), (-1, 1), (1, -1), (1, 1)]
    return tuple(
        Port(f"A{i + 1}", "contact", (*turned(x * side / 2, y * side / 2, shift, angle), 0.0))
        for i, (x, y) in enumerate(corners)
    )


def grid(pitch=0.0133, shift=(0.0, 0.0), angle=0.0):
    return tuple(
        Port(str(3 * r + c + 1), "point", (*turned((r - 1) * pitch, (c - 1) * pitch, shift, angle), 0.0))
        for r in range(3)
        for c in range(3)
    )


def turned(x, y, shift, angle):
    c, s = np.cos(angle), np.sin(angle)
    return c * x - s * y + shift[0], s * x + c * y + shift[1]


def waves(frequency=BAND, inputs=None, outputs=None, gains=(1.0, 0.8, 1.2, 0.9)):
    """Outgoing damped cylindrical waves H0^(2)(k r), a forearm's speed and decay, about 1 um per volt."""
    inputs, outputs = inputs or actuators(), outputs or grid()
    f = np.asarray(frequency, dtype=float)[:, None, None]
    k = 2 * np.pi * f / (4 + np.maximum(f - 150, 0) / 100) - 1j * (20 + 0.3 * f)
    values = 1e-6 * np.asarray(gains)[: len(inputs)] * hankel2(0, k * distances(outputs, inputs))
    return TransferMatrix(np.asarray(frequency, dtype=float), values, outputs, inputs)


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


# ---------------------------------------------------------------- inverse filter


def test_as_many_control_points_as_actuators_are_met_exactly(coarse, short):
    sent = drives(InverseFilter(zeros=("1", "3", "7"), peak=2e-6), coarse, "6", short)
    reached = displacements(coarse, sent)
    placed = on_record_bins(coarse, short.record)
    kept = np.zeros(len(short.spectrum), dtype=complex)
    kept[placed.bins.index] = short.spectrum[placed.bins.index]
    asked = 2e-6 * np.roll(np.fft.irfft(kept * short.record.sample_rate, short.record.n), short.record.centre)
    worst = sent.inversion.condition.max()
    rounding = 100 * np.finfo(float).eps * worst  # SVD solve: eps times the condition number, and two FFTs
    assert rounding < 1e-9
    assert np.abs(reached.values[5] - asked).max() < rounding * np.abs(asked).max()
    assert np.abs(reached.values[[0, 2, 6]]).max() < rounding * np.abs(asked).max()
    assert sent.inversion.misfit.max() < rounding


def test_drives_equal_numpy_least_squares_at_every_frequency(g):
    wavelet = ricker()
    sent = drives(InverseFilter(), g, "5", wavelet)
    wanted = np.zeros(5, dtype=complex)
    for i in range(0, len(BAND), 97):
        wanted[0] = 1e-6 * wavelet.spectrum[20 + i]
        oracle = np.linalg.lstsq(g.values[i, [4, 0, 2, 6, 8]], wanted, rcond=None)[0]
        assert np.allclose(sent.spectrum[i], oracle, rtol=1e-11, atol=0)  # both SVD, condition below 10


def test_misfit_is_the_share_of_the_target_out_of_reach(g):
    """Least squares projects: the target reaches 1 - m^2 of what was asked."""
    sent = drives(InverseFilter(), g, "5", ricker())
    got = np.einsum("fq,fq->f", g.values[:, 4], sent.spectrum)
    asked = 1e-6 * ricker().spectrum[20:1001]
    assert np.allclose(got / asked, 1 - sent.inversion.misfit**2, rtol=1e-9)  # rounding of a condition < 10
    assert 0.1 < sent.inversion.misfit.min() < sent.inversion.misfit.max() < 1


def test_thesis_zeros_are_the_corners_or_three_of_them_and_the_centre(coarse, short):
    expected = {"5": "1379", "2": "1379", "6": "1379", "1": "3795", "9": "1375"}
    for target, zeros in expected.items():
        assert drives(InverseFilter(), coarse, target, short).zeros == tuple(zeros)


def test_zero_rule_follows_a_turned_device(short):
    at = {"shift": (0.01, -0.02), "angle": 0.7}
    turned_g = waves(np.arange(10.0, 500.1, 5.0), actuators(**at), grid(**at))
    assert drives(InverseFilter(), turned_g, "7", short).zeros == ("1", "3", "9", "5")


@pytest.mark.parametrize("renderer", [InverseFilter(), Combination()])
def test_searched_zeros_beat_every_set_tried_by_hand(coarse, short, renderer):
    found = drives(renderer.with_zeros(SearchedZeros(4, short.window)), coarse, "6", short).zeros
    best, *others = (
        strengths(coarse, ["6"], [renderer.with_zeros(zeros)], short)[0, 0]
        for zeros in (found, ("1", "3", "7", "9"), ("2", "4", "5", "8"), ("3", "5", "8", "9"))
    )
    assert max(others) <= best


def test_a_search_for_more_points_than_there_are_is_refused(coarse, short):
    for size in (-1, 9):
        with pytest.raises(ScenarioError, match="cannot be searched among 8 outputs"):
            drives(InverseFilter(zeros=SearchedZeros(size)), coarse, "6", short)


# ---------------------------------------------------------------- funneling and combination


@given(x=st.floats(-0.0225, 0.0225), y=st.floats(-0.0225, 0.0225), angle=st.floats(-3, 3))
def test_weights_sum_to_one_and_are_eq_6_in_a_turned_frame(x, y, angle):
    at = {"shift": (0.3, -0.1), "angle": angle}
    target = Port("t", "point", (*turned(x, y, **at), 0.01))
    weights = funneling_weights(actuators(**at), target)
    eq6 = [(1 - abs(x - a) / 0.045) * (1 - abs(y - b) / 0.045) for a in (-0.0225, 0.0225) for b in (-0.0225, 0.0225)]
    assert np.allclose(weights, eq6, atol=1e-9)  # rounding of the turn, relative to 45 mm
    assert weights.sum() == pytest.approx(1, abs=1e-12)


def test_weight_is_one_at_an_actuator_and_a_quarter_at_the_centre():
    assert np.allclose(funneling_weights(actuators(), actuators()[2]), [0, 0, 1, 0], atol=1e-15)
    assert np.allclose(funneling_weights(actuators(), grid()[4]), 0.25, atol=1e-15)


def test_larger_array_funnels_within_the_cell_and_need_not_be_square():
    x, y = np.array([0.0, 0.03, 0.07]), np.array([0.0, 0.05])
    inputs = tuple(Port(f"{r}{c}", "contact", (a, b, 0)) for r, a in enumerate(x) for c, b in enumerate(y))
    weights = funneling_weights(inputs, Port("t", "point", (0.04, 0.01, 0)))
    assert np.allclose(weights, [0, 0, 0.75 * 0.8, 0.75 * 0.2, 0.25 * 0.8, 0.25 * 0.2], atol=1e-12)


@pytest.mark.parametrize(
    "places",
    [
        [(0, 0)],
        [(0, 0), (1, 0), (0, 0.2)],
        [(0, 0), (1, 0), (2, 0), (3, 0)],
        [(0, 0), (1, 0), (0, 1), (0, 0)],
        [(0, 0), (0, 0), (0, 0), (0, 0)],
    ],
)
def test_actuators_that_do_not_surround_the_target_are_refused(places):
    inputs = tuple(Port(f"A{i}", "contact", (x, y, 0)) for i, (x, y) in enumerate(places))
    with pytest.raises(GeometryError, match=r"outside|one place|two or more"):
        funneling_weights(inputs, Port("t", "point", (0.5, 0.5, 0)))


def test_target_outside_the_rectangle_is_refused():
    with pytest.raises(GeometryError, match=r"'t' lies 0\.01 m outside"):
        funneling_weights(actuators(), Port("t", "point", (0.0325, 0, 0)))


def test_funneling_sends_the_wavelet_in_the_same_phase(g):
    wavelet = ricker()
    sent = drives(Funneling(amplitude=2.0), g, "6", wavelet)
    weights = funneling_weights(g.inputs, g.outputs[5])
    one = sent.signals.sum(axis=0)
    assert np.allclose(sent.signals, weights[:, None] * one, atol=1e-13)  # rounding at a size of 2 V
    # cut at 500 Hz = 2 f_p the peak loses int_2^inf x^2 e^{-x^2} dx / (sqrt(pi) / 4) = 4.61 %
    assert one[wavelet.record.centre] == pytest.approx(2 * (1 - 0.0461), abs=2e-3)  # 10 Hz below, bins of 0.5 Hz
    assert np.abs(one - 2 * wavelet.samples).max() < 0.0465 * 2


def test_combination_moves_the_target_as_funneling_does_where_that_is_feasible(coarse, short):
    combined = Combination(zeros=("1", "3", "7"))
    two = [displacements(coarse, drives(r, coarse, "6", short)) for r in (combined, Funneling())]
    size = np.abs(two[1].values[5]).max()
    assert size > 1e-8
    assert np.abs(two[0].values[5] - two[1].values[5]).max() < 1e-11 * size  # condition below 1e3, rounding
    assert np.abs(two[0].values[[0, 2, 6]]).max() < 1e-11 * size
    assert np.abs(two[1].values[[0, 2, 6]]).max() > 0.1 * size


def test_combination_is_the_inverse_filter_on_another_target_signal(coarse, short):
    sent = drives(Combination(), coarse, "5", short)
    plain = drives(InverseFilter(peak=1.0), coarse, "5", short)
    funnel = np.einsum("fq,fq->f", coarse.values[:, 4], drives(Funneling(), coarse, "5", short).spectrum)
    index = np.rint(coarse.frequency * 0.2).astype(int)
    assert np.allclose(sent.spectrum, plain.spectrum * (funnel / short.spectrum[index])[:, None], rtol=1e-10)


# ---------------------------------------------------------------- linearity, records


@settings(max_examples=15, deadline=None)
@given(factor=st.floats(1e-3, 1e3), method=st.sampled_from(METHODS), target=st.sampled_from("123456789"))
def test_response_is_linear_and_strength_ignores_scale(factor, method, target):
    transfer, wavelet = waves(np.arange(10.0, 500.1, 5.0)), ricker(duration=0.2)
    sent = drives(method, transfer, target, wavelet)
    one, other = displacements(transfer, sent), displacements(transfer, replace(sent, spectrum=factor * sent.spectrum))
    size = np.abs(one.values).max()
    assert np.allclose(other.values, factor * one.values, atol=1e-12 * factor * size)  # rounding
    rows = one.target_index
    assert signal_strength(other.values, rows) == pytest.approx(signal_strength(one.values, rows), rel=1e-10)


def test_displacement_is_the_circular_convolution_with_the_impulse_response(coarse, short):
    """Independent of our FFT: build u by sums of cosines over the bins."""
    sent = drives(Combination(), coarse, "6", short)
    reached = displacements(coarse, sent)
    t = short.time[::50]
    u = np.einsum("foi,fi->fo", coarse.values, sent.spectrum)
    wave = np.exp(2j * np.pi * np.outer(t, sent.frequency))
    direct = 2 * short.record.df * (wave @ u).real.T
    assert np.allclose(reached.values[:, ::50], direct, atol=1e-12 * np.abs(direct).max())  # rounding


# ---------------------------------------------------------------- everything


def test_render_all_files_each_result_and_reports_progress(coarse, short):
    seen = []
    everything = render_all(coarse, ["5", "6"], METHODS, short, progress=lambda *step: seen.append(step))
    assert list(everything) == [(m.name, t) for m in METHODS for t in ("5", "6")]
    assert len(everything) == 6
    assert seen[-1] == ("render", 6, 6)
    one = everything["combination", "6"]
    assert np.array_equal(one.drives.signals, drives(Combination(), coarse, "6", short).signals)
    moved = one.displacements
    assert one.strength == signal_strength(moved.values, 5, time=moved.time, window=short.window)
    assert np.array_equal(everything.strengths, strengths(coarse, ["5", "6"], METHODS, short))
    assert everything.table().groups == ("Middle (5)", "Edges (2/4/6/8)")


def test_render_all_refuses_two_results_of_one_name(coarse, short):
    with pytest.raises(ScenarioError, match="method is given twice"):
        render_all(coarse, ["5"], [Funneling(), Funneling(2.0)], short)
    with pytest.raises(ScenarioError, match="target is given twice"):
        render_all(coarse, ["5", "5"], None, short)


def test_one_target_and_one_renderer_are_taken_for_a_list_of_it(coarse, short):
    """The digits of "12" were two targets."""
    names = tuple(replace(p, name=f"1{p.name}") for p in coarse.outputs)
    found = render_all(replace(coarse, outputs=names), "12", Funneling(), short)
    assert list(found) == [("funneling", "12")]
    for strange in ("funneling", ["funneling"]):
        with pytest.raises(ScenarioError, match=r"expected renderers such as Funneling\(\), got 'funneling'"):
            render_all(coarse, "5", strange, short)


def test_symmetric_arm_gives_equal_strengths_at_symmetric_targets():
    """Equal actuators on a homogeneous medium: the square's symmetry must reach S."""
    table = render_all(waves(gains=(1, 1, 1, 1))).table()
    assert np.all(table.std[1:] < 1e-9 * table.mean[1:])  # rounding, condition below 10
    assert len(table.groups) == 3


def test_drives_made_for_one_g_play_on_another(coarse, short):
    job = RenderJob(METHODS, short, ("5",))
    other = waves(coarse.frequency, gains=(1.0, 0.3, 1.2, 0.9))
    same, replayed = job.strengths(coarse, coarse, other)[0]
    anew = strengths(other, ["5"], METHODS, short)
    assert np.allclose(same, strengths(coarse, ["5"], METHODS, short), rtol=1e-12)
    assert np.abs(replayed[0] - anew[0]) > 1e-3  # a wrong calibration shows


# ---------------------------------------------------------------- what aims share


def wide_array(n):
    """Six or nine actuators around the grid, none on one of its points, where waves are infinite."""
    across = (-1, 0, 1) if n == 9 else (-1, 1)
    places = [(x * 0.0225 + 0.001, y * 0.0225 + 0.002) for x in across for y in (-1, 0, 1)]
    return tuple(Port(f"A{i + 1}", "contact", (x, y, 0.0)) for i, (x, y) in enumerate(places))


@pytest.mark.parametrize(
    ("actuators_", "sets"),
    [(actuators(), 5), (wide_array(6), 1), (wide_array(9), 1)],
    ids=["four", "six", "nine"],
)
def test_control_points_are_decomposed_once_for_all_targets_and_methods(short, monkeypatch, actuators_, sets):
    """Corners have the middle's control points, edges their own; beyond four actuators all points are."""
    g = waves(np.arange(10.0, 500.1, 5.0), actuators_, gains=np.linspace(0.8, 1.2, len(actuators_)))
    done, svd = [], np.linalg.svd
    monkeypatch.setattr(np.linalg, "svd", lambda matrix, **options: done.append(1) or svd(matrix, **options))
    found = strengths(g, "123456789", METHODS, short)
    assert len(done) == sets
    alone = [
        [signal_strength(displacements(g, drives(m, g, t, short)).values, i, time=short.time, window=short.window)
         for i, t in enumerate("123456789")] for m in METHODS
    ]  # fmt: skip
    assert len(done) == sets + 18  # each aim of its own decomposes anew
    assert np.array_equal(found, alone)


def test_all_targets_at_once_aim_as_least_squares_does_one_by_one(short):
    """numpy's least squares with the damping as rows of its own, target by target: nothing is shared there."""
    g = waves(np.arange(10.0, 500.1, 5.0), wide_array(6), gains=np.ones(6))
    everything = render_all(g, "123456789", METHODS, short)
    for t, target in enumerate("123456789"):
        sent = everything["inverse filter", target].drives
        for i, f in list(enumerate(g.frequency))[::9]:
            h = g.values[i]
            damping = 0.02 * np.abs(h).max() * np.sqrt(9)
            stacked = np.vstack([h, damping * np.eye(6)])
            wanted = np.zeros(15, dtype=complex)
            wanted[t] = 1e-6 * short.spectrum[round(f * 0.2)]
            oracle = np.linalg.lstsq(stacked, wanted, rcond=None)[0]
            # rounding: the damping keeps the condition below sqrt(6) / 0.02, |H| being sqrt(54) max|H| at most
            assert np.linalg.norm(sent.spectrum[i] - oracle) < 1e-13 * np.linalg.norm(oracle)


@pytest.mark.parametrize("zeros", [None, ("2", "8"), SearchedZeros(2)])
def test_settled_renderers_aim_as_they_did(short, zeros):
    """At another G of the same ports, too: places alone were asked."""
    g, other = (waves(np.arange(10.0, 500.1, 5.0), gains=gains) for gains in ((1, 1, 1, 1), (1, 0.5, 1.2, 0.9)))
    methods = METHODS if zeros is None else tuple(m.with_zeros(zeros) for m in (METHODS[0], METHODS[2]))
    for before, after in zip(
        methods, precomputed_for_targets(methods, on_record_bins(g, short.record), "51"), strict=True
    ):
        for target in "51":  # a corner has zero points of its own
            one, two = (drives(m, other, target, short) for m in (before, after))
            assert one.zeros == two.zeros
            assert np.array_equal(one.spectrum, two.spectrum)


def test_the_thesis_groups_are_of_its_grid_only():
    """Two points were called edges and corners, and S without a bound was printed with all digits."""
    g = waves()
    two = replace(g, values=g.values[:, :2], outputs=g.outputs[:2])
    with pytest.warns(AccuracyWarning, match="has no bound"):
        rendering = render_all(two)
    with pytest.raises(DataError, match="3 x 3 grid only"):
        rendering.table()
    assert signal_strength_table(["inverse filter"], ["5"], np.array([[6.2e14]])).as_text().endswith("6.2e+14")


@pytest.mark.parametrize(
    ("make", "problem"),
    [
        (lambda: Limits(voltage=float("nan")), ScenarioError),
        (lambda: Limits(resistance=0.0), ScenarioError),
        (lambda: Limits(window=float("inf")), ScenarioError),
        (lambda: Wavelet(np.ones(10), Record(1000.0, 20)), DataError),
        (lambda: Wavelet(np.full(20, np.nan), Record(1000.0, 20)), DataError),
        (lambda: Wavelet(np.zeros(20), Record(1000.0, 20)).window, DataError),
    ],
)
def test_limits_and_wavelets_that_cannot_be_are_refused(make, problem):
    """A limit of NaN was never exceeded; samples of another length ended in an IndexError."""
    with pytest.raises(problem, match=r"expected|zero"):
        make()


def test_wavelets_of_a_list_are_arrays():
    assert Wavelet([1.0] * 20, Record(1000.0, 20)).samples.shape == (20,)
