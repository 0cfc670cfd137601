"""Signal strength, its table and interval, the thesis' wave estimator, conditioning and spots."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from forearm_fem.accuracy.estimates import perturbed
from forearm_fem.errors import AccuracyWarning, DataError
from forearm_fem.metrics import (
    area,
    condition_number,
    fit_waves,
    relative_error_at,
    signal_strength,
    signal_strength_table,
    singular_values,
    smooth_noise,
    thesis_table,
)
from forearm_fem.ports import Port
from forearm_fem.transfer import (
    ErrorEstimate,
    TransferMatrix,
    band_error,
    entry_band_errors,
    entry_errors,
    error_of_pairs,
    relative_error,
)

# ---------------------------------------------------------------- S


def test_strength_of_known_areas():
    t = np.linspace(0, 1, 1001)
    u = np.array([2.0, 1.0, 3.0, -2.0])[:, None] * np.sin(2 * np.pi * 5 * t)
    assert signal_strength(u, 2) == pytest.approx(3 / ((2 + 1 + 2) / 3), rel=1e-12)


@given(st.floats(1e-9, 1e9), st.permutations([0, 1, 2, 3]))
def test_strength_ignores_scale_sign_and_the_order_of_the_others(scale, order):
    u = np.random.default_rng(0).normal(size=(5, 50))
    shuffled = np.vstack([-u[:1], u[1:][list(order)]])
    assert signal_strength(scale * shuffled, 0) == pytest.approx(signal_strength(u, 0), rel=1e-12)


def test_equal_displacements_have_strength_one_and_a_silent_rest_infinite():
    assert signal_strength(np.ones((9, 10)), 4) == 1
    assert signal_strength(np.eye(3), 0) == 1
    assert signal_strength(np.array([[1.0, 1.0], [0.0, 0.0]]), 0) == np.inf
    assert np.isnan(signal_strength(np.zeros((2, 2)), 0))


def test_strength_over_a_window_counts_only_its_samples():
    t = np.arange(10) / 10
    u = np.ones((2, 10))
    u[0, 5:] = 3
    assert signal_strength(u, 0, time=t, window=(0.5, 0.9)) == 3
    assert signal_strength(u, 0) == 2
    assert np.allclose(area(u, time=t, window=(0.5, 1.0)), [3, 1])
    with pytest.raises(DataError, match="no sample lies in"):
        signal_strength(u, 0, time=t, window=(2, 3))
    with pytest.raises(DataError, match="needs the time"):
        signal_strength(u, 0, window=(0, 1))


def test_unknown_outputs_are_left_out_aloud():
    u = np.array([[2.0, 2.0], [1.0, 1.0], [np.nan, np.nan]])
    with pytest.warns(AccuracyWarning, match="leaves out 1 of 2"):
        assert signal_strength(u, 0) == 2
    assert np.isnan(signal_strength(u, 2))
    assert np.isnan(signal_strength(u[[0, 2]], 0))


@pytest.mark.parametrize(("shape", "target"), [((1, 5), 0), ((3, 5), 3), ((3, 5), -1), ((5,), 0)])
def test_strength_of_no_grid_is_refused(shape, target):
    with pytest.raises(DataError, match="at least two outputs"):
        signal_strength(np.ones(shape), target)


def test_table_has_means_and_the_deviation_of_matlab():
    s = np.arange(1.0, 10.0)[None] ** 2
    table = signal_strength_table(["m"], [str(i) for i in range(1, 10)], s)
    edges, corners = np.array([4, 16, 36, 64.0]), np.array([1, 9, 49, 81.0])
    assert np.allclose(table.mean[:, 0], [25, edges.mean(), corners.mean()])
    by_hand = [np.sqrt(np.sum((x - x.mean()) ** 2) / 3) for x in (edges, corners)]
    assert np.allclose(table.std[1:, 0], by_hand)
    assert np.isnan(table.std[0, 0])


def test_table_refuses_other_grids_and_shapes():
    with pytest.raises(DataError, match="got also 10"):
        signal_strength_table(["m"], ["1", "10"], np.ones((1, 2)))
    with pytest.raises(DataError, match="expected"):
        signal_strength_table(["m"], ["1"], np.ones((1, 2)))


def test_thesis_table_reads_as_printed():
    lines = thesis_table().as_text().splitlines()
    assert lines[0].split() == ["inverse", "filter", "funneling", "combination"]
    assert lines[1].split() == ["Middle", "(5)", "1.31", "0.63", "1.72"]
    assert "1.34 ± 0.09" in lines[2]
    assert "0.67 ± 0.32" in lines[2]
    assert "1.69 ± 0.19" in lines[2]
    assert "2.25 ± 0.56" in lines[3]
    assert "2.42 ± 0.79" in lines[3]
    assert "2.60 ± 0.92" in lines[3]


# ---------------------------------------------------------------- interval of S


def small_transfer():
    f = np.arange(10.0, 500.0, 10.0)
    rng = np.random.default_rng(5)
    values = (rng.normal(size=(len(f), 3, 2)) + 1j * rng.normal(size=(len(f), 3, 2))) / (1 + f[:, None, None] / 100)
    outputs = tuple(Port(str(i), "point", (0.01 * i, 0, 0)) for i in range(3))
    return TransferMatrix(f, values, outputs, outputs[:2])


def ratio(g):
    """A stand-in for S: size of one entry over another's."""
    return np.array([np.abs(g.values[:, 0, 0]).mean() / np.abs(g.values[:, 1, 0]).mean()])


def test_interval_has_the_error_asked_for_at_every_frequency():
    g, e = small_transfer(), ErrorEstimate("truncation", 0.1, "test", (10.0, 500.0), (0.01, 0.2))
    drawn = perturbed(g, [e], np.random.default_rng(0), 50.0).values
    change = np.abs(drawn - g.values).max(axis=(1, 2)) / np.abs(g.values).max(axis=(1, 2))
    assert np.allclose(change, np.interp(g.frequency, [10, 500], [0.01, 0.2]), rtol=1e-10)  # cancellation of G


@pytest.mark.parametrize("share", [0.0, 0.01j])
def test_an_actuator_that_moves_what_another_moves_does_so_in_every_draw(share):
    """One out of contact, with the housing held or not."""
    g = small_transfer()
    lifted = replace(g, values=g.values[:, :, :1] * [1, share])
    drawn = perturbed(lifted, [ErrorEstimate("truncation", 0.1, "test")], np.random.default_rng(0), 50.0).values
    assert np.abs(drawn[:, :, 1] - share * drawn[:, :, 0]).max() < 1e-12
    assert np.all(np.abs(drawn[:, :, 0] - g.values[:, :, 0]) > 1e-6)


def test_draws_of_pairs_that_are_told_apart_are_as_large_as_each_pair_s_error():
    """In the root mean square: 400 draws of complex normal numbers know it to 1 / sqrt(400) / 2 = 2.5 %, four times."""
    g, rng = small_transfer(), np.random.default_rng(2)
    pairs = np.array([0.02, 0.1])[:, None, None] * np.array([[1.0, 0.2], [0.5, 0.1], [0.01, 0.03]])
    e = ErrorEstimate("discretisation", 0.05, "test", (10.0, 500.0), (0.02, 0.1), pairs)
    square = sum(np.abs(perturbed(g, [e], rng, 50.0).values - g.values) ** 2 for _ in range(400)) / 400
    largest = np.abs(g.values).max(axis=(1, 2))[:, None, None]
    between = np.array([[np.interp(g.frequency, [10, 500], p) for p in row] for row in pairs.transpose(1, 2, 0)])
    assert np.abs(np.sqrt(square) / largest / between.transpose(2, 0, 1) - 1).max() < 0.2
    assert np.allclose(error_of_pairs(e, g.frequency), between.transpose(2, 0, 1))


def test_what_a_pair_does_apart_is_drawn_beside_what_all_do_together():
    """Three twentieths of its error: 400 draws know it to 2.5 %, eight times for the worst of 300 entries."""
    g, rng = small_transfer(), np.random.default_rng(3)
    pairs = np.full((2, 3, 2), 0.05)
    e = ErrorEstimate("discretisation", 0.05, "test", (10.0, 500.0), (0.05, 0.05), pairs, 0j * pairs)
    square = sum(np.abs(perturbed(g, [e], rng, 50.0).values - g.values) ** 2 for _ in range(400)) / 400
    largest = np.abs(g.values).max(axis=(1, 2))[:, None, None]
    assert np.abs(np.sqrt(square) / largest / (0.15 * 0.05) - 1).max() < 0.2


def test_an_entry_errs_by_what_its_pair_is_stated_to_of_the_largest():
    """Sources that tell pairs apart count by pair, others by e(f) of the largest entry; unknown ones leave nothing."""
    g = small_transfer()
    largest = np.abs(g.values).max(axis=(1, 2))[:, None, None]
    pairs = np.full((1, 3, 2), 0.01) * [[1.0, 0.5], [0.1, 0.0], [0.2, 0.3]]
    apart = ErrorEstimate("discretisation", 0.01, "test", (100.0,), (0.01,), pairs)
    alike = ErrorEstimate("truncation", 0.02, "test")
    assert entry_errors(replace(g, errors=(apart, alike))) == pytest.approx(np.sqrt(pairs**2 + 0.02**2) * largest)
    assert np.isnan(entry_errors(replace(g, errors=(apart, replace(alike, band=np.nan))))).all()
    assert np.isnan(entry_errors(g)).all()
    valid = np.ones(g.values.shape, dtype=bool)
    valid[:, 1, 1] = False
    left = np.isnan(entry_errors(replace(g, errors=(apart, alike), valid=valid)))
    assert left[:, 1, 1].all()
    assert left.sum() == len(g.frequency)


def test_over_the_band_an_entry_s_error_is_of_its_own_size_and_unknown_where_it_has_none():
    g, e = small_transfer(), ErrorEstimate("truncation", 0.02, "test")
    values = g.values.copy()
    values[:, :, 1] = 0  # an actuator out of contact
    found = entry_band_errors(replace(g, values=values, errors=(e,)))
    largest = np.abs(values).max(axis=(1, 2))
    assert found[:, 0] == pytest.approx(0.02 * np.linalg.norm(largest) / np.linalg.norm(values[:, :, 0], axis=0))
    assert np.isnan(found[:, 1]).all()


def test_errors_of_other_pairs_than_those_of_g_are_refused():
    g = small_transfer()
    e = ErrorEstimate("discretisation", 0.05, "test", (10.0, 500.0), (0.02, 0.1), np.ones((2, 4, 2)))
    with pytest.raises(DataError, match=r"error by discretisation is of pairs \(2, 4, 2\), G's are \(2, 3, 2\)"):
        replace(g, errors=(e,))


def test_errors_white_in_frequency_average_out_and_smooth_ones_do_not():
    g, e = small_transfer(), [ErrorEstimate("discretisation", 0.05, "test")]
    flat = replace(g, values=np.ones_like(g.values))
    rng = np.random.default_rng(0)
    smooth, white = (np.std([ratio(perturbed(flat, e, rng, c)) for _ in range(200)]) for c in (1e4, 1e-3))
    assert smooth > 4 * white  # 49 equal frequencies average to a seventh; 200 draws know that to 5 %


def test_smooth_noise_has_unit_variance_and_the_correlation_stated():
    rng = np.random.default_rng(0)
    f = np.array([100.0, 120.0, 300.0])
    z = np.concatenate([smooth_noise(f, (50,), rng, 20.0) for _ in range(40)], axis=1)
    assert np.mean(np.abs(z) ** 2) == pytest.approx(1, abs=0.1)  # 2000 samples of 64 terms: 3 %, three sigma
    covariance = np.mean(z[1:] * z[0].conj(), axis=1)
    # 64 random tau in each of 40 draws: its characteristic function errs by 1/sqrt(2560) = 2 %
    assert np.allclose(covariance, [np.exp(-0.5), 0], atol=0.1)


def test_masked_entries_do_not_set_the_error_scale():
    g = small_transfer()
    values, valid = g.values.copy(), np.ones(g.values.shape, dtype=bool)
    values[:, 2, 1], valid[:, 2, 1] = np.nan, False
    masked = TransferMatrix(g.frequency, values, g.outputs, g.inputs, valid=valid)
    e = [ErrorEstimate("measurement", 0.05, "test")]
    known = valid & np.isfinite(values)
    size = np.where(known, np.abs(values), 0).max(axis=(1, 2))
    drawn = perturbed(masked, e, np.random.default_rng(0), 50.0).values
    change = np.where(known, np.abs(drawn - values), 0).max(axis=(1, 2))
    assert np.all(change <= 0.05 * size * (1 + 1e-10))
    assert np.all(change > 0)


def test_error_without_frequencies_is_the_band_value():
    assert np.array_equal(relative_error_at(ErrorEstimate("quadrature", 0.03, "t"), np.array([1.0, 9.0])), [0.03, 0.03])


# ---------------------------------------------------------------- waves

LINE = 2.5e-3 * np.arange(1, 11)  # the thesis' ten points


def plane_wave(frequency, c, delta, x=LINE):
    k = 2 * np.pi * frequency / c - 1j * delta
    return (0.3 - 0.7j) * np.exp(-1j * np.outer(k, x))


@pytest.mark.parametrize("decay", ["nonlinear", "log", "normalised"])
def test_damped_plane_wave_is_recovered(decay):
    f = np.linspace(50, 500, 19)
    c, delta = 3 + f / 200, 20 + 0.4 * f
    fit = fit_waves(f, LINE, plane_wave(f, c, delta), decay=decay)
    assert np.allclose(fit.speed, c, rtol=1e-6)  # asked for; rounding gives about 1e-13
    assert np.allclose(fit.attenuation, delta, rtol=1e-6)
    assert np.allclose(fit.wavenumber, 2 * np.pi * f / c, rtol=1e-6)
    assert fit.phase_misfit.max() < 1e-10
    assert fit.decay_misfit.max() < 1e-7
    assert np.allclose(fit.phase_step, fit.wavenumber * 2.5e-3, rtol=1e-9)


@given(st.floats(1, 30), st.floats(-50, 600), st.floats(20, 600))
def test_any_wave_sampled_twice_per_wavelength_is_recovered(c, delta, f):
    if 2 * np.pi * f / c * 2.5e-3 > 3:  # beyond pi per step the phase is ambiguous
        return
    fit = fit_waves(np.array([f]), LINE, plane_wave(np.array([f]), np.array([c]), np.array([delta])))
    assert fit.speed[0] == pytest.approx(c, rel=1e-6)
    assert fit.attenuation[0] == pytest.approx(delta, rel=1e-6, abs=1e-5)


def test_an_ingoing_wave_has_a_negative_speed():
    f = np.array([100.0])
    wave = plane_wave(f, np.array([4.0]), np.array([30.0]))
    assert fit_waves(f, LINE, wave.conj()).speed[0] == pytest.approx(-4, rel=1e-9)


def test_nonlinear_fit_is_least_squares_and_weighs_near_points_more_than_log():
    """A decay that saturates: the fits must differ, and each be the minimum of its own misfit."""
    size = np.exp(-200 * LINE) + 0.05
    fits = {
        d: fit_waves(np.ones(1), LINE, size[None].astype(complex), decay=d).attenuation[0] for d in ("nonlinear", "log")
    }
    assert fits["nonlinear"] > fits["log"] + 10

    def best(delta):  # least squares of A for this delta
        shape = np.exp(-delta * LINE)
        return np.sum((shape @ size / (shape @ shape) * shape - size) ** 2)

    scan = np.linspace(50, 250, 200001)
    assert fits["nonlinear"] == pytest.approx(
        scan[np.argmin([best(d) for d in scan[::10]]) * 10], abs=0.02
    )  # of the scan
    assert fits["log"] == pytest.approx(-np.polyfit(LINE, np.log(size), 1)[0], rel=1e-9)


def test_unknown_or_silent_rows_are_nan_and_leave_the_others_alone():
    f = np.array([100.0, 200.0, 300.0])
    wave = plane_wave(f, 4 + 0 * f, 50 + 0 * f)
    wave[0, 3], wave[2, 5] = np.nan, 0
    fit = fit_waves(f, LINE, wave)
    assert np.array_equal(np.isfinite(fit.speed), [False, True, False])
    assert np.array_equal(np.isfinite(fit.attenuation), [False, True, False])
    assert fit.speed[1] == pytest.approx(4, rel=1e-9)
    assert np.all(np.isnan(fit_waves(f, LINE, 0 * np.nan_to_num(wave)).speed))


@pytest.mark.parametrize("x", [[0.0, 0.1], [0.0, 0.2, 0.1], [0.0, 0.1, 0.1]])
def test_lines_that_say_nothing_are_refused(x):
    with pytest.raises(DataError, match="3 increasing distances"):
        fit_waves(np.ones(1), np.array(x), np.ones((1, len(x)), dtype=complex))


def test_responses_of_another_shape_are_refused():
    with pytest.raises(DataError, match="expected"):
        fit_waves(np.ones(2), LINE, np.ones((1, 10), dtype=complex))


# ---------------------------------------------------------------- conditioning


def test_singular_values_and_condition():
    values = np.array([np.diag([3.0, -2.0, 0.5]), np.diag([1.0, 1.0, 0.0]), np.full((3, 3), np.nan)], dtype=complex)
    assert np.allclose(singular_values(values)[:2], [[3, 2, 0.5], [1, 1, 0]])
    assert np.array_equal(condition_number(values), [6, np.inf, np.nan], equal_nan=True)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (lambda: singular_values(np.eye(3)), "add the first axis"),
        (lambda: area(np.ones((2, 9)), time=np.arange(8.0), window=(0.0, 4.0)), "a time for each of the 9 samples"),
    ],
)
def test_arrays_that_do_not_fit_are_said(wrong, said):
    with pytest.raises(DataError, match=said):
        wrong()


# ---------------------------------------------------------------- what is unknown, zero or of another kind


def test_errors_are_those_of_the_entries_that_both_know():
    """A norm of the truth over all entries made e_band of one with NaN a quarter of what it is."""
    truth = np.arange(1.0, 25.0).reshape(4, 3, 2) + 1j
    estimate = 1.1 * truth
    estimate[2:] = np.nan
    assert band_error(estimate, truth) == pytest.approx(0.1)
    assert relative_error(estimate, truth)[:2] == pytest.approx(0.1)
    assert np.isnan(relative_error(estimate, truth)[2:]).all()
    assert np.isnan(band_error(truth, 0 * truth))
    assert np.isnan(band_error(np.nan * truth, truth))


def test_strength_made_of_rounding_is_said():
    moved = 1e-18 * np.ones((3, 8))
    moved[1] = 1
    with pytest.warns(AccuracyWarning, match="what rounding leaves"):
        assert signal_strength(moved, 1) > 1e17


def test_a_table_may_hold_an_s_without_bound():
    table = signal_strength_table(("a",), ("1", "3"), np.array([[np.inf, 1.0]]))
    assert table.mean[0, 0] == np.inf
    assert np.isnan(table.std[0, 0])


@pytest.mark.parametrize(
    "make",
    [
        lambda: condition_number(np.zeros((2, 3, 0))),
        lambda: fit_waves([50.0], [1.0, 2.0, np.nan], np.ones((1, 3))),
        lambda: fit_waves([50.0], [1.0, 2.0, 3.0], np.ones((1, 3)), decay="cubic"),
        lambda: ErrorEstimate("quadrature", 0.1, "t", (20.0, 10.0), (0.1, 0.2)),
        lambda: ErrorEstimate("quadrature", 0.1, "t", (10.0, 20.0), (0.1,)),
        lambda: replace(small_transfer(), values=small_transfer().values.astype(str)),
        lambda: replace(small_transfer(), deviation=-np.ones(small_transfer().values.shape)),
    ],
)
def test_what_cannot_be_meant_is_refused(make):
    """numpy's own error, or a number, came of each."""
    with pytest.raises(DataError):
        make()


def test_an_unknown_error_at_one_frequency_is_the_worst():
    for errors in ((0.1, np.nan, 0.3), (np.nan, 0.1, 0.3)):
        assert np.isnan(ErrorEstimate("quadrature", 0.1, "t", (1.0, 2.0, 3.0), errors).worst)


def test_marks_of_ones_and_zeros_serve():
    g = small_transfer()
    marked = replace(g, valid=np.ones(g.values.shape, dtype=int))
    assert marked.valid.dtype == bool
