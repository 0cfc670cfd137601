"""Sharp resonances: what is stated is a bound at every bin, whichever modes the reduced model lacks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg

from forearm_fem.engines.forecast import model_notes
from forearm_fem.errors import SolverError
from forearm_fem.fem.assembly.coefficients import Polynomial
from forearm_fem.fem.linear.direct import make_solver
from forearm_fem.fem.reduction.affine import AffineReduced, condensed, with_last_columns
from forearm_fem.fem.reduction.certificate import ResidualBound, sharp_modes
from forearm_fem.fem.reduction.expansion import expansion_rate
from forearm_fem.fem.reduction.sweep import direct_sweep, reduced_sweep
from forearm_fem.results.run import SolutionRecord
from forearm_fem.scenario.sweep import ReducedSolve
from forearm_fem.transfer import relative_error
from forearm_fem.verification.scenes import flesh, held_block

BAND = np.arange(10.0, 221.0, 3.0)  # a dozen peaks of this block; the bins are about as wide as the upper ones
DOUBLE = ReducedSolve(precision="double")


@pytest.fixture(scope="module")
def model():
    """Loss factor 0.007 at 220 Hz."""
    return held_block(2, tissue=flesh(eta=0.04, bulk=2.2e9))


@pytest.fixture(scope="module")
def truth(model):
    return direct_sweep(model, BAND, DOUBLE).values[:, 1:, :1]


@pytest.fixture(scope="module")
def sweep(model):
    return reduced_sweep(model, BAND, ReducedSolve(), tolerance=1e-4)


@pytest.fixture(scope="module")
def bound(model):
    return ResidualBound(make_solver(model, DOUBLE, BAND[-1]), expansion_rate(BAND))


def test_sharp_resonances_are_stated_by_a_bound_that_holds(sweep, truth):
    """One frequency had stated 3e-8 for 3e-3, and the change by one derivative 2.1e-3 for 3.6e-3 on another machine."""
    last = sweep.certificates[-1]
    error = relative_error(sweep.values[:, 1:, :1], truth).max()
    assert last.wary
    assert last.error <= last.change <= 1e-4
    assert error <= sweep.reduction_error <= 1e-4


def test_bounds_hold_at_every_bin_of_a_model_that_lacks_modes(model, sweep, truth, bound):
    """Each of the three modes nearest to the middle left out in turn: 1 to 12.2 times the error at the worst bin.

    1e-6: below, the model with all modes is wrong by as much. 16: a third more than was seen.
    """
    reduced = sweep.reduced
    weights = bound._weights(reduced)
    mass = np.tensordot([t.coefficient.taylor(0.0, 2)[2].real for t in model.operator.terms], -reduced.matrices, 1)
    squares, shapes = scipy.linalg.eigh(np.tensordot(weights, reduced.matrices, 1), mass)
    resonance = np.sqrt(np.maximum(squares - expansion_rate(BAND) ** 2, 0.0)) / (2 * np.pi)
    for left_out in np.argsort(np.abs(resonance - 120.0))[:3]:
        directions = np.linalg.qr(np.delete(shapes, left_out, axis=1))[0]
        poorer = reduced.projected(directions)
        error = relative_error(poorer.compliance(BAND)[:, 1:, :1], truth)
        stated = bound.errors(poorer, BAND, None)
        assert (stated >= error)[error > 1e-6].all()
        worst = int(np.argmax(error))
        assert 1.0 <= stated[worst] / error[worst] < 16.0
        assert stated.max() > 1e-4  # so that such a model does not pass


def test_too_few_expansions_are_refused(model):
    with pytest.raises(SolverError, match="does not resolve the resonances"):
        reduced_sweep(model, BAND, ReducedSolve(start="frequencies", expansions=2, derivatives=2, max_expansions=2))


def test_damped_tissue_takes_no_bounds():
    """Zhang's skin loses 0.04 to 2 of what it keeps: the usual certificate, and no double precision."""
    damped = held_block(2, tissue=flesh(bulk=2.2e9))
    swept = reduced_sweep(damped, BAND[::4], ReducedSolve(), tolerance=1e-4)
    assert not swept.certificates[-1].wary
    assert sharp_modes(swept.reduced, BAND, 0.03) == 0


@pytest.mark.parametrize("eta", [0.0, 1e-6])
def test_lossless_scenes_are_refused_at_once(eta):
    """Peaks narrower than any bin: before, a bare LinAlgError, or an overflow on the way to an error."""
    with pytest.raises(SolverError, match="takes up energy"):
        reduced_sweep(held_block(1, tissue=flesh(eta=eta, bulk=2.2e9), ends="free"), BAND, ReducedSolve())


def test_default_model_is_stable_and_passive_whatever_solves_leave():
    """Single-precision noise in the pressures of weak directions had made nine to eleven poles of this block unstable.

    At all frequencies, of which only 10-500 Hz are in the band: the stiffness is a sum of energies now.
    """
    nearly = held_block(2, tissue=flesh(bulk=2.2e9))
    swept = reduced_sweep(nearly, np.linspace(10.0, 500.0, 60), ReducedSolve(), tolerance=1e-4)
    assert swept.unstable_poles == 0
    assert swept.poles is not None
    assert swept.poles.poles.real.max() < 0
    for c in swept.reduced.compliance(np.array([0.1, 3.0, 700.0, 5e3, 5e4])):
        assert np.linalg.eigvalsh(-(c - c.conj().T) / 2j).min() > -1e-9 * np.abs(c).max()  # rounding


def test_pressures_that_are_noise_make_no_stiffness_negative(model, sweep):
    """Each pressure with as much noise as there is of it: what counts is the best in the span, so little changes."""
    reduced = sweep.reduced
    t, s = (reduced.names.index(name) for name in ("incompressibility", "compression"))
    n_u, noise = model.operator.n_displacements, np.random.default_rng(0)
    noisy = np.hstack(reduced.basis.blocks)
    noisy[n_u:, -20:] *= 1 + 300 * noise.normal(size=noisy[n_u:, -20:].shape)
    worse = with_last_columns(AffineReduced.of(model), model, noisy)
    pairs = np.array([m.copy() for m in worse.matrices])
    pairs[t] = worse.coupling + worse.coupling.T
    assert replace(worse, matrices=pairs).negative_directions() > 0  # so that the noise is seen to matter
    assert worse.negative_directions() == 0
    held = np.linalg.eigvalsh(worse.matrices[t] + worse.matrices[s])
    assert held[0] > -1e-12 * held[-1]


def test_condensed_pressures_equal_pairs_where_these_are_exact():
    """For G = S, pressures that are known exactly, G + G^T and the best in the span are the same; S may be singular."""
    half = np.random.default_rng(0).normal(size=(8, 5))
    storage = half @ half.T
    assert condensed(storage, storage) == pytest.approx(2 * storage, rel=1e-9)


def test_incompressible_tissue_keeps_each_displacements_own_pressure():
    """Its pressures have no energy by which the best could be told; without any, errors of solves enter unsquared."""
    nothing_gives = held_block(1, tissue=flesh())
    columns = np.random.default_rng(0).normal(size=(nothing_gives.operator.n, 3))
    reduced = with_last_columns(AffineReduced.of(nothing_gives), nothing_gives, columns)
    found = reduced.matrices[reduced.names.index("incompressibility")]
    operator = nothing_gives.operator
    weights = np.array([float(t.name == "incompressibility") for t in operator.terms])
    whole = columns.T @ operator.multiply(operator.combine(weights.tolist()), columns)
    assert found == pytest.approx(whole, rel=1e-12, abs=1e-12 * np.abs(whole).max())


@pytest.mark.parametrize("stiffness", [(1.0, 2.0, 3.0, 4.0), (1.0, -2.0, 3.0, -1e-3), (-1.0, -1.0, -1.0, 0.0)])
def test_unstable_poles_are_counted_as_they_are(stiffness):
    """As many as directions of negative stiffness; a direction without any, as of a free body, is none."""
    parts = (np.diag(stiffness), 0.1 * np.eye(4), np.eye(4))
    kinds = (Polynomial(1.0), Polynomial(rate=1.0), Polynomial(inertia=1.0))
    reduced = AffineReduced(("a", "b", "c"), np.array(parts), np.eye(4), np.ones(4), coefficients=kinds)
    poles = reduced.modes().poles
    assert reduced.negative_directions() == np.sum(poles.real > 1e-9) == np.sum(np.array(stiffness) < 0)


def test_a_note_says_so():
    assert model_notes(SolutionRecord(solver="multifrontal", unstable_poles=0)) == ()
    (note,) = model_notes(SolutionRecord(solver="multifrontal", unstable_poles=9))
    assert "9 unstable poles" in note
    assert "band only" in note


@pytest.mark.parametrize("precision", ["auto", "double"])
def test_incompressible_tissue_states_its_largest_error(precision):
    """One true error, at 328 or 500 Hz, stated a third of the largest in single precision and a thirtieth in double."""
    model, band = held_block(2, tissue=flesh()), np.arange(10.0, 501.0, 2.0)
    swept = reduced_sweep(model, band, ReducedSolve(precision=precision), tolerance=1e-4)
    some = band[::35]
    exact = direct_sweep(model, some, ReducedSolve(precision="double")).values
    error = relative_error(swept.values[::35, 1:, :1], exact[:, 1:, :1]).max()
    assert error <= swept.reduction_error
    assert swept.reduction_error <= 2e-4  # no more than twice what was asked for


@pytest.mark.parametrize("precision", ["auto", "double"])
@pytest.mark.parametrize("tolerance", [1e-4, 1e-6])
def test_weak_directions_of_incompressible_tissue_do_not_spoil_the_model(precision, tolerance):
    """Their pressures were 1e12 of a displacement's: in double precision 0.76 was the error at 20 Hz and 0.21 stated,
    whatever was asked for; a finer block erred by 3e-4 where 1e-4 was stated."""
    model, band = held_block(2, tissue=flesh()), np.linspace(20.0, 300.0, 57)
    swept = reduced_sweep(model, band, ReducedSolve(precision=precision), tolerance=tolerance)
    exact = direct_sweep(model, band[::8], ReducedSolve(precision="double")).values
    assert relative_error(swept.values[::8], exact).max() <= swept.reduction_error <= tolerance
    assert swept.derivatives <= 30  # eighty did not do
    assert not swept.expansions
