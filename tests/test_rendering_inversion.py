"""Regularised pseudo-inverse: against numpy, and where G is singular."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_rendering import waves

from forearm_fem.errors import ScenarioError
from forearm_fem.rendering import Combination, Funneling, InverseFilter, Regularisation, drives, ricker
from forearm_fem.rendering.renderers import decomposed, least_squares


@pytest.fixture(scope="module")
def coarse():
    """Every 5 Hz on the bins of a record of 0.2 s, for tests that render often."""
    return waves(np.arange(10.0, 500.1, 5.0))


@pytest.fixture(scope="module")
def short():
    return ricker(duration=0.2)


METHODS = (InverseFilter(), Funneling(), Combination())


# ---------------------------------------------------------------- regularisation


def invert(matrix, wanted, regularisation, frequency):
    return least_squares(decomposed(matrix), wanted, regularisation, frequency)


def random_problem(rng, shape=(6, 5, 4)):
    matrix = rng.normal(size=shape) + 1j * rng.normal(size=shape)
    wanted = rng.normal(size=shape[:2]) + 1j * rng.normal(size=shape[:2])
    return matrix, wanted, np.arange(1.0, shape[0] + 1)


def test_tikhonov_solves_the_augmented_least_squares_problem():
    matrix, wanted, f = random_problem(np.random.default_rng(0))
    drive, report = invert(matrix, wanted, Regularisation("tikhonov", 0.3), f)
    for h, u, s, lam in zip(matrix, wanted, drive, report.parameter, strict=True):
        stacked = np.vstack([h, lam * np.eye(4)])
        oracle = np.linalg.lstsq(stacked, np.concatenate([u, np.zeros(4)]), rcond=None)[0]
        assert np.allclose(s, oracle, rtol=1e-12, atol=1e-14)  # well conditioned: rounding
        assert lam == pytest.approx(0.3 * np.linalg.norm(h, 2), rel=1e-12)


def test_truncation_equals_numpy_pinv_and_counts_the_rank():
    matrix, wanted, f = random_problem(np.random.default_rng(1))
    drive, report = invert(matrix, wanted, Regularisation("rcond", 0.5), f)
    ratios = report.singular_values / report.singular_values[:, :1]
    assert np.array_equal(report.rank, (ratios > 0.5).sum(axis=1))
    assert report.rank.min() < 4  # the cut does something
    for h, u, s in zip(matrix, wanted, drive, strict=True):
        assert np.allclose(s, np.linalg.pinv(h, rcond=0.5) @ u, rtol=1e-12, atol=1e-14)


def test_discrepancy_reaches_the_misfit_asked_for():
    matrix, wanted, f = random_problem(np.random.default_rng(2))
    drive, _ = invert(matrix, wanted, Regularisation("discrepancy", 0.1), f)
    least, _ = invert(matrix, wanted, Regularisation(), f)
    extra = np.linalg.norm((matrix @ (drive - least)[:, :, None])[:, :, 0], axis=1)
    assert np.allclose(extra, 0.1 * np.linalg.norm(wanted, axis=1), rtol=1e-9)  # bisection to 2^-60 of 48 e-folds


def test_discrepancy_leaves_what_lies_below_the_error_undriven():
    matrix = np.zeros((1, 2, 1), dtype=complex)
    matrix[0, 0, 0] = 1
    wanted = np.array([[0.1, 1.0]], dtype=complex)  # only a tenth of U can be reached at all
    drive, _ = invert(matrix, wanted, Regularisation("discrepancy", 0.5), np.ones(1))
    assert abs(drive[0, 0]) < 1e-10  # lambda at its bound 1e6 s: 1e-12 of the full drive 0.1


def test_lcurve_lets_the_signal_through_and_stops_the_noise():
    """Singular values over six decades, smooth truth, noise of 1e-3: damp the noise, not the signal."""
    rng = np.random.default_rng(3)
    u, _ = np.linalg.qr(rng.normal(size=(12, 12)))
    v, _ = np.linalg.qr(rng.normal(size=(8, 8)))
    s = np.geomspace(1, 1e-6, 8)
    matrix = (u[:, :8] * s) @ v.T
    truth = v @ s**0.5
    noise = 1e-3 * rng.normal(size=12)
    wanted = (matrix @ truth + noise)[None].astype(complex)
    damped, report = invert(matrix[None].astype(complex), wanted, Regularisation("lcurve", 1e-10), np.ones(1))
    plain, _ = invert(matrix[None].astype(complex), wanted, Regularisation(), np.ones(1))
    error = [np.linalg.norm(x[0] - truth) / np.linalg.norm(truth) for x in (damped, plain)]
    assert error[0] < 0.2  # ideal damping leaves about 0.1 here; the L-curve is a heuristic, within a factor 2
    assert error[1] > 10  # without damping the noise divided by 1e-6 wins
    assert 1e-5 < report.parameter[0] < 1e-1  # near the noise, far from both ends of the search


@pytest.mark.parametrize("kind", ["rcond", "tikhonov", "discrepancy", "lcurve"])
def test_drive_does_not_grow_with_regularisation_and_scales_with_the_wavelet(coarse, short, kind):
    weak = drives(InverseFilter(regularisation=Regularisation(kind, 1e-6)), coarse, "5", short)
    strong = drives(InverseFilter(regularisation=Regularisation(kind, 0.5)), coarse, "5", short)
    louder = drives(InverseFilter(regularisation=Regularisation(kind, 0.5), peak=3e-6), coarse, "5", short)
    assert np.linalg.norm(strong.spectrum) <= np.linalg.norm(weak.spectrum) * (1 + 1e-12)
    assert np.allclose(louder.spectrum, 3 * strong.spectrum, rtol=1e-9)  # lambda depends on no amplitude


@pytest.mark.parametrize("kind", ["rcond", "tikhonov", "discrepancy", "lcurve"])
@pytest.mark.parametrize("case", ["dead", "twin", "all dead at one bin"])
def test_singular_matrices_give_finite_shared_drives(coarse, short, kind, case):
    values = coarse.values.copy()
    if case == "dead":
        values[:, :, 1] = 0
    elif case == "twin":
        values[:, :, 1] = values[:, :, 0]
    else:
        values[7] = 0
    sent = drives(InverseFilter(regularisation=Regularisation(kind, 1e-3)), replace(coarse, values=values), "5", short)
    assert np.all(np.isfinite(sent.signals))
    if case == "dead":
        assert np.all(sent.signals[1] == 0)
        assert np.all(np.isinf(sent.inversion.condition))
        assert sent.inversion.rank.max() <= 3 + 1e-12
    elif case == "twin":
        assert np.abs(sent.signals[0]).max() > 0
        size = np.abs(sent.signals).max()
        assert np.allclose(sent.signals[0], sent.signals[1], atol=1e-9 * size)  # minimum norm shares evenly
        assert sent.inversion.condition.min() > 1e14
    else:
        assert np.all(sent.spectrum[7] == 0)


@pytest.mark.parametrize(("kind", "value"), [("ridge", 0.1), ("rcond", -0.1), ("rcond", 1.0), ("rcond", np.nan)])
def test_bad_regularisation_is_refused(kind, value):
    with pytest.raises(ScenarioError, match="regularisation"):
        Regularisation(kind, value)
