"""Certificates from residuals and a richer space: near the true error without another factorisation."""

from __future__ import annotations

import numpy as np
import pytest

from forearm_fem.fem.linear.direct import make_solver, watched
from forearm_fem.fem.reduction.affine import AffineReduced, with_last_columns
from forearm_fem.fem.reduction.certificate import DOUBTFUL, DualEstimate, ResidualBound, dual_estimate, error_at
from forearm_fem.fem.reduction.expansion import Expander, expansion_rate
from forearm_fem.fem.reduction.rate_space import RateSpace
from forearm_fem.fem.reduction.sweep import direct_sweep, reduced_sweep
from forearm_fem.scenario.sweep import ReducedSolve
from forearm_fem.store.shelf import Shelf
from forearm_fem.transfer import relative_error
from forearm_fem.verification.scenes import flesh, held_block

BAND = np.arange(10.0, 401.0, 10.0)
BINS = np.array([20.0, 80.0, 150.0, 260.0, 400.0])
OPTIONS = ReducedSolve()


def spaces(model, solver, counts):
    """Reduced models of so many derivatives about the band's rate, with the space that goes on to solve at it."""
    space, reduced, out = RateSpace(solver, model.functionals, expansion_rate(BAND)), AffineReduced.of(model), {}
    for count in counts:
        reduced = with_last_columns(reduced, model, space.more(count - space.derivatives).columns)
        out[count] = reduced
    return space, out


@pytest.fixture(scope="module", params=[{}, {"ends": "free"}], ids=["held", "free ends"])
def model(request):
    return held_block(2, tissue=flesh(bulk=2.2e9), **request.param)


def test_the_estimate_is_near_the_true_error_from_rough_models_to_good_ones(model):
    """0.7 to 2.3 times was seen on blocks, slabs and forearms; so twice of it is no less than the truth.

    Below 1e-5 single precision's rounding of solutions is as large as what the space lacks.
    """
    solver = make_solver(model, OPTIONS, float(BAND[-1]))
    bound, truth = ResidualBound(solver, expansion_rate(BAND)), direct_sweep(model, BINS, OPTIONS).values
    space, made = spaces(model, solver, (11, 13, 15, 17, 20, 25))
    ratios = []
    for reduced in made.values():
        for f, exact in zip(BINS, truth, strict=True):
            found, true = (
                dual_estimate(bound, reduced, float(f), space.solved),
                error_at(reduced, model, float(f), exact),
            )
            if true > 1e-5 and found.bound < DOUBTFUL:
                ratios.append(found.error / true)
                assert true <= found.bound
            elif true > DOUBTFUL:
                assert found.bound > DOUBTFUL  # a model that is no approximation does not pass
    assert len(ratios) >= 5
    assert min(ratios) > 0.5
    assert max(ratios) < 4.0


def test_a_sweep_is_certified_without_a_second_factorisation(model, monkeypatch):
    """And its G is that of a sweep with one, to the bit: only the judge differs."""
    result = reduced_sweep(model, BAND, OPTIONS, tolerance=1e-3)
    (stated,) = result.certificates
    assert stated.by == "residual"
    exact = direct_sweep(model, np.array([stated.frequency]), OPTIONS).values[0]
    true = error_at(result.reduced, model, stated.frequency, exact)
    assert true <= stated.error <= stated.bound <= 1e-3
    monkeypatch.setattr(Expander, "foreseen", lambda *_: None)
    other = reduced_sweep(model, BAND, OPTIONS, tolerance=1e-3)
    assert other.certificates[0].by != "residual"
    assert (other.values == result.values).all()


def test_what_solves_leave_in_the_space_is_seen(model):
    """A column of the space that is off by a thousandth: the residual has it, whatever the small matrices say."""
    solver = make_solver(model, OPTIONS, float(BAND[-1]))
    bound = ResidualBound(solver, expansion_rate(BAND))
    space, made = spaces(model, solver, (30,))
    good = made[30]
    wrong = good.matrices.copy()
    wrong[[name.startswith("mass") for name in good.names]] *= 1.001
    bad = type(good)(**{**vars(good), "matrices": wrong})
    exact = direct_sweep(model, np.array([150.0]), OPTIONS).values[0]
    true = error_at(bad, model, 150.0, exact)
    assert true > 1e-4
    assert dual_estimate(bound, bad, 150.0, space.solved).error == pytest.approx(true, rel=0.3)


def test_sharp_resonances_take_another_certificate():
    """Loss factor 0.007 at 220 Hz: what the richer space does not know may resonate, and the bound says so."""
    model, band = held_block(2, tissue=flesh(eta=0.04, bulk=2.2e9)), np.arange(10.0, 221.0, 3.0)
    solver = make_solver(model, OPTIONS, 220.0)
    rate = expansion_rate(band)
    space, reduced = RateSpace(solver, model.functionals, rate), AffineReduced.of(model)
    reduced = with_last_columns(reduced, model, space.more(20).columns)
    assert dual_estimate(ResidualBound(solver, rate), reduced, 220.0, space.solved).bound > DOUBTFUL
    swept = reduced_sweep(model, band, OPTIONS, tolerance=1e-4)
    assert "residual" not in {c.by for c in swept.certificates}


def test_one_frequency_s_true_error_does_not_speak_for_all():
    """Extended by direct solves, the model errs at 144 Hz by up to twice what it errs by where it was compared last."""
    tissue = flesh(2030.372123181738, 0.23191562190784834, bulk=2.2e9, density=967.9372858825791)
    model, band = held_block(2, tissue=tissue, ends="absorb", contact="bonded"), np.geomspace(1, 250, 21)
    swept = reduced_sweep(model, band, OPTIONS, tolerance=5e-4)
    assert swept.certificates[-1].by != "residual"  # a true error, by a direct solve or elimination, as solvers can
    assert swept.reduction_error == 5e-4  # what was asked, not what was found at that frequency
    block = np.ix_(range(21), *watched(model))
    true = relative_error(swept.values[block], direct_sweep(model, band, OPTIONS).values[block])
    assert true.max() <= swept.reduction_error


def test_an_unknown_resonance_that_could_do_much_is_not_passed_over(model, monkeypatch):
    """The richer space finds nothing, but the energy of what is left would allow a tenth of G: solved as before."""
    found = DualEstimate(1e-6, 0.0, 1.1 * DOUBTFUL)
    monkeypatch.setattr("forearm_fem.fem.reduction.expansion.dual_estimate", lambda *_: found)
    result = reduced_sweep(model, BAND, OPTIONS, tolerance=1e-3)
    assert "residual" not in {c.by for c in result.certificates}


def test_beside_a_mode_without_loss_the_bound_is_infinite(model, monkeypatch):
    monkeypatch.setattr(ResidualBound, "stability", lambda self, reduced, frequency: np.zeros(len(frequency)))
    result = reduced_sweep(model, BAND, OPTIONS, tolerance=1e-3)
    assert "residual" not in {c.by for c in result.certificates}


def test_a_richer_space_that_is_none_leaves_the_model_to_a_solve(model, monkeypatch):
    """Directions that are alike to the last digit say nothing of the model: it was refused for them."""

    def alike(*_):
        raise np.linalg.LinAlgError("Singular matrix")

    monkeypatch.setattr("forearm_fem.fem.reduction.expansion.dual_estimate", alike)
    result = reduced_sweep(model, BAND, OPTIONS, tolerance=1e-3)
    assert result.certificates[-1].bound <= 1e-3
    assert "residual" not in {c.by for c in result.certificates}


def test_a_sweep_that_goes_on_from_its_store_is_certified_alike(model, tmp_path):
    """Its factors are made again for it, as no derivative asks for them."""
    kept = Shelf(tmp_path / "parts.sqlite")
    first, again = (reduced_sweep(model, BAND, OPTIONS, tolerance=1e-3, kept=kept) for _ in range(2))
    assert again.certificates[0].by == "residual"
    assert again.certificates[0].error == pytest.approx(first.certificates[0].error, rel=1e-3)
