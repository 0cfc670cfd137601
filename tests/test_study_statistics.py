"""The analysis of variance and what follows it, against R's afex, car and lme4 (tests/data/study/make_anova.R)."""

from __future__ import annotations

import csv
import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from forearm_fem.errors import DataError
from forearm_fem.study.anova import repeated_measures
from forearm_fem.study.comparisons import corrected_p, friedman, mixed_model, pairwise, residual_normality

DATA = Path(__file__).parent / "data" / "study"
SIX_DIGITS = 1e-6  # what the reference file is written to, and more than the two programs' rounding


def reference():
    return tomllib.loads((DATA / "anova.toml").read_text())


def cells(name, leave_out=()):
    """Values (n_subject, 9 locations, 3 methods) of a reference data set."""
    with (DATA / f"{name}.csv").open() as stream:
        rows = [r for r in csv.DictReader(stream) if int(r["subject"]) not in leave_out]
    subjects = sorted({int(r["subject"]) for r in rows})
    values = np.full((len(subjects), 9, 3), np.nan)
    for r in rows:
        values[subjects.index(int(r["subject"])), int(r["location"]) - 1, "abc".index(r["method"])] = float(r["error"])
    return values


@pytest.mark.parametrize(("name", "leave_out"), [("balanced", ()), ("rough", ()), ("few", ()), ("missing", (3, 7))])
def test_nine_by_three_agrees_with_r(name, leave_out):
    """F, corrections, Mauchly and effect sizes of all three effects; `rough` is far from spherical (epsilon 0.39)."""
    expected = reference()[name]
    for effect in repeated_measures(cells(name, leave_out), ("location", "method")):
        theirs = expected[effect.name.replace(" x ", "_")]
        mauchly_p = theirs.pop("mauchly_p")
        for key, value in theirs.items():
            assert getattr(effect, key) == pytest.approx(value, rel=SIX_DIGITS, abs=0), (effect.name, key)
        # R's car has the number of cells for that of contrasts in one term of third order (Anderson 2003, 10.7.4)
        assert effect.mauchly_p == pytest.approx(mauchly_p, abs=1e-3)


@pytest.mark.parametrize("name", ["balanced", "rough", "few"])
def test_pairs_of_methods_agree_with_r(name):
    expected, means = reference()[name], cells(name).mean(axis=1)
    for how in ("bonferroni", "holm"):
        found = pairwise(means, ("a", "b", "c"), how)
        assert [p.t for p in found] == pytest.approx(expected["pair_t"], rel=SIX_DIGITS)
        assert [p.p for p in found] == pytest.approx(expected[f"pair_{how}"], rel=SIX_DIGITS)
    ranks = friedman(means)
    assert [ranks.statistic, ranks.p] == pytest.approx(expected["friedman"], rel=SIX_DIGITS)


def test_mixed_model_agrees_with_lme4():
    """All trials, two cells missing; REML optima of two programs agree to 1e-4 of a standard error or so."""
    pd = pytest.importorskip("pandas")
    pytest.importorskip("statsmodels")
    expected = reference()["missing"]
    fit = mixed_model(pd.read_csv(DATA / "missing.csv"), "error", ("location", "method"), "subject")
    terms = {name: value for name, value, *_ in fit.terms}
    assert fit.converged
    assert terms["C(method)[T.b]"] == pytest.approx(expected["mixed_method_b"], rel=1e-4)
    assert fit.residual_sd == pytest.approx(expected["mixed_sigma"], rel=1e-4)
    assert fit.subject_sd == pytest.approx(expected["mixed_subject_sd"], rel=1e-3)


def test_the_mixed_model_where_nothing_varies_between_subjects_is_plain_least_squares():
    """Half of 40 studies without differences between people end there; statsmodels told an intercept of 0 for 20 and no
    error, or failed."""
    pd = pytest.importorskip("pandas")
    ols = pytest.importorskip("statsmodels.formula.api").ols
    rows = [(s, t, m) for s in "abc" for t in "1234" for m in "xy" for _ in range(2)]
    table, alike = pd.DataFrame(rows, columns=["subject", "location", "method"]), 0
    for seed in range(40):
        table["error"] = 20 + np.random.default_rng(seed).normal(size=len(table))
        fit = mixed_model(table, "error", ("location", "method"), "subject")
        plain = ols("error ~ C(location) * C(method)", table).fit()
        terms = {name: (estimate, error) for name, estimate, error, *_ in fit.terms}
        assert fit.converged
        # every subject has every cell as often: estimates do not depend on the variances
        assert {n: e for n, (e, _) in terms.items()} == pytest.approx(dict(plain.params), abs=1e-9)
        if fit.subject_sd == 0:
            alike += 1
            assert {n: e for n, (_, e) in terms.items()} == pytest.approx(dict(plain.bse), rel=1e-9)
    assert 10 < alike < 35


def test_a_mixed_model_is_that_of_statsmodels_where_subjects_differ():
    pd = pytest.importorskip("pandas")
    mixedlm = pytest.importorskip("statsmodels.formula.api").mixedlm
    rng = np.random.default_rng(8)
    rows = [(s, t, m, k) for k, s in enumerate("abcdef") for t in "123" for m in "xy" for _ in range(3)]
    table = pd.DataFrame(rows, columns=["subject", "location", "method", "number"])
    table["error"] = 20 + rng.normal(size=len(table)) + 3 * rng.normal(size=6)[table["number"]]
    table = table.drop(index=[0, 7, 8, 9, 40])
    fit = mixed_model(table, "error", ("location", "method"), "subject")
    theirs = mixedlm("error ~ C(location) * C(method)", table, groups=table["subject"]).fit(reml=True)
    for name, estimate, error, *_ in fit.terms:
        assert estimate == pytest.approx(theirs.fe_params[name], rel=1e-4)
        assert error == pytest.approx(theirs.bse_fe[name], rel=1e-3)
    assert fit.subject_sd**2 == pytest.approx(float(theirs.cov_re.iloc[0, 0]), rel=1e-3)
    gone = table[~((table["location"] == "2") & (table["method"] == "x"))]
    with pytest.raises(DataError, match="some of its cells have no answer at all"):
        mixed_model(gone, "error", ("location", "method"), "subject")


def test_a_factor_of_two_levels_is_a_paired_t_test():
    """F = t^2 exactly, and epsilon 1, as there is one contrast."""
    values = np.random.default_rng(1).normal(size=(12, 2))
    (effect,) = repeated_measures(values, ("side",))
    t = stats.ttest_rel(values[:, 0], values[:, 1])
    assert effect.f == pytest.approx(t.statistic**2, rel=1e-10)
    assert effect.p == pytest.approx(t.pvalue, rel=1e-10)
    assert effect.gg == pytest.approx(1.0, rel=1e-12)


def test_effects_do_not_depend_on_subjects_offsets():
    values = np.random.default_rng(2).normal(size=(8, 3, 4))
    moved = values + 100.0 * np.arange(8)[:, None, None]
    for one, other in zip(repeated_measures(values, "ab"), repeated_measures(moved, "ab"), strict=True):
        assert one.f == pytest.approx(other.f, rel=1e-8)  # 100 / 1 of cancellation costs four of sixteen digits


@pytest.mark.parametrize("seed", range(4))
def test_two_participants_tell_nothing_of_sphericity(seed):
    """Their covariance has rank one, so that Greenhouse and Geisser's epsilon is 1 / d whatever they answer, and Huynh
    and Feldt's (n d gg - 2) / (d (n - 1 - d gg)) is 0 / 0: rounding made it -1, 1 or anything. One contrast needs none.
    """
    values = np.random.default_rng(seed).normal(size=(2, 4, 3, 2)).mean(axis=1)
    levels, sides, both = repeated_measures(values, ("level", "side"))
    for effect in (levels, both):
        assert effect.gg == pytest.approx(0.5, rel=1e-9)
        assert np.isnan(effect.hf)
        assert np.isnan(effect.p_hf)
    assert (sides.gg, sides.hf) == (1.0, 1.0)
    assert sides.p_hf == sides.p


def test_what_does_not_vary_has_no_f():
    """Participants who differ from each other alone: sums of squares of 1e-32 over 1e-32 are no F of 3."""
    own = np.broadcast_to(np.array([0.1, 0.7, 1.3])[:, None, None], (3, 3, 3))
    for effect in repeated_measures(own, ("location", "method")):
        assert np.isnan([effect.f, effect.p, effect.p_gg, effect.p_hf, effect.mauchly_p, effect.partial_eta2]).all()
        assert effect.generalised_eta2 == 0
    everyone = np.broadcast_to(np.array([0.1, 0.7, 1.3])[None, :, None], (3, 3, 3))
    location, method, _ = repeated_measures(everyone, ("location", "method"))
    assert (location.f, location.p_gg) == (np.inf, 0.0)
    assert np.isnan(method.f)


def test_the_same_answers_in_another_order_are_ties():
    """Method b has a's answers at other targets: sums of thirds in another order differ in the last digit, and ranks of
    that are chance. Ranks of whole numbers are exact."""
    rng = np.random.default_rng(0)
    cells = rng.integers(1, 4, (8, 9, 3, 3))
    cells[:, :, 1] = cells[:, rng.permutation(9), 0]
    means, whole = cells.mean(axis=-1).mean(axis=1), cells.sum(axis=(1, 3)).astype(float)
    assert (means[:, 0] != means[:, 1]).any()  # what makes this a test
    assert friedman(means).statistic == pytest.approx(stats.friedmanchisquare(*whole.T).statistic, rel=1e-9)
    same, other, _ = pairwise(means, ("a", "b", "c"))
    assert same.difference == 0
    assert np.isnan([same.t, same.p, same.d_z]).all()
    assert np.isfinite([other.t, other.p]).all()


def test_missing_cells_and_single_subjects_are_refused():
    values = np.zeros((4, 3))
    values[1, 2] = np.nan
    with pytest.raises(DataError, match="1 of 12 cells are missing"):
        repeated_measures(values, ("method",))
    with pytest.raises(DataError, match="two or more subjects"):
        repeated_measures(np.ones((1, 3)), ("method",))
    with pytest.raises(DataError, match="all values are equal"):
        repeated_measures(np.ones((4, 3)), ("method",))


def test_holm_never_exceeds_bonferroni_and_keeps_order():
    p = np.array([0.04, 0.001, 0.03, 0.5])
    assert np.all(corrected_p(p, "holm") <= corrected_p(p, "bonferroni"))
    assert np.all(np.diff(corrected_p(p, "holm")[np.argsort(p)]) >= 0)


def test_corrected_test_keeps_its_level_where_the_plain_one_does_not():
    """1,000 studies without any effect, far from spherical: 5 % of them may be found significant.

    The uncorrected test finds about twice as many. 3.2 to 7 % is 5 % with 2.6 standard deviations of 1,000 draws.
    """
    rng = np.random.default_rng(5)
    scale = np.array([0.4, 0.5, 0.6, 2.0, 2.5, 3.0, 0.5, 0.4, 3.0])
    plain, right = 0, 0
    for _ in range(1000):
        effect = repeated_measures(rng.normal(size=(20, 9)) * scale + rng.normal(size=(20, 1)), ("location",))[0]
        plain, right = plain + (effect.p < 0.05), right + (effect.p_gg < 0.05)
    assert 32 <= right <= 70
    assert plain > 80


def test_normality_sees_skewed_residuals():
    rng = np.random.default_rng(3)
    assert residual_normality(rng.normal(size=(20, 9, 3))).p > 1e-3
    assert residual_normality(rng.exponential(size=(20, 9, 3)) ** 2).p < 1e-6
