"""The reduced sweep from expansion frequencies against direct solves; what projection must keep; poles and residues."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import sampled
from scipy.sparse import csr_array

from forearm_fem.errors import SolverError
from forearm_fem.fem.linear import factor as factors
from forearm_fem.fem.linear.direct import DirectSolver, make_solver
from forearm_fem.fem.reduction import basis as bases
from forearm_fem.fem.reduction.affine import AffineReduced, extend, with_last_columns
from forearm_fem.fem.reduction.basis import Basis, orthonormal_extension, real_columns
from forearm_fem.fem.reduction.certificate import doubt, probe_frequencies
from forearm_fem.fem.reduction.expansion import Expander, expansion_frequencies
from forearm_fem.fem.reduction.sweep import direct_sweep, reduced_sweep
from forearm_fem.scenario.sweep import ReducedSolve
from forearm_fem.tissue import Hysteretic, KelvinVoigt, SpringPot, Tissue, Zener
from forearm_fem.transfer import relative_error
from forearm_fem.verification.scenes import flesh, held_block

needs_multifrontal = pytest.mark.skipif(not factors._compiles(), reason="numba or pymetis is not installed")
BAND = np.linspace(10.0, 500.0, 197)
CHECK = np.array([10.0, 33.0, 80.0, 140.0, 210.0, 333.0, 470.0, 500.0])
OPTIONS = ReducedSolve(start="frequencies")
ALL = np.ones(4, dtype=int)  # contact and three points of held_block


@pytest.fixture(scope="module")
def model():
    return held_block(3, tissue=flesh(bulk=2.2e9))


@pytest.fixture(scope="module")
def small():
    """The same in fewer elements, for slow solvers and dense matrices."""
    return held_block(2, tissue=flesh(bulk=2.2e9))


@pytest.fixture(scope="module")
def sweep(model):
    return reduced_sweep(model, BAND, OPTIONS, tolerance=1e-6)


@pytest.fixture(scope="module")
def truth(model):
    return direct_sweep(model, CHECK, OPTIONS).values


@pytest.fixture(scope="module")
def one_expansion(model):
    """Uncompressed space of one frequency with five derivatives, solved in double precision."""
    solver = make_solver(model, ReducedSolve(precision="double"), 100.0)
    return extend(AffineReduced.of(model), model, solver.taylor(100.0, solver.at(100.0).values, ALL * 5))


def test_reduced_sweep_equals_direct_solves(sweep, truth):
    error = relative_error(sweep.reduced.compliance(CHECK), truth)
    assert error.max() < 1e-5  # asked for 1e-6 at the most uncertain frequency; a factor 10 of room elsewhere
    assert sweep.certificates[-1].error < 1e-6


def test_solves_are_refined_to_a_thousandth_of_what_is_asked(model, sweep, truth):
    """1e-3 of the tolerance, between 1e-9 and 1e-7: what is left above would be taken for a factor gone bad."""
    rough, careless = (reduced_sweep(model, BAND, OPTIONS, tolerance=t) for t in (1e-4, 0.1))
    assert sweep.residual <= 1e-9
    assert max(rough.residual, careless.residual) <= 1e-7
    assert careless.solver == rough.solver
    assert sweep.solve_error <= 1e-7
    assert rough.solve_error <= 1e-4  # where it is certified by an elimination in single precision
    block = np.ix_(range(len(CHECK)), [1, 2, 3], [0])
    error = relative_error(rough.reduced.compliance(CHECK)[block], truth[block])
    assert error.max() < 2 * rough.reduction_error  # one certificate speaks for the band


def test_values_of_the_sweep_are_those_of_its_model(sweep):
    assert relative_error(sweep.values, sweep.reduced.compliance(BAND)).max() < 1e-8  # pole-residue's own limit


def test_certificate_is_a_true_error(model):
    """Certified on a solve that the model had not used: repeat it by hand."""
    few = ReducedSolve(start="frequencies", expansions=2, derivatives=2, max_expansions=2)
    result = reduced_sweep(model, BAND, few, tolerance=1e-12)
    stated = result.certificates[-1]
    exact = direct_sweep(model, np.array([stated.frequency]), OPTIONS).values
    points, contacts = [1, 2, 3], [0]
    block = np.ix_([0], points, contacts)
    found = result.reduced.compliance(np.array([stated.frequency]))
    assert relative_error(found[block], exact[block])[0] == pytest.approx(stated.error, rel=1e-2)
    assert stated.error > 1e-4  # and it says so, rather than stopping silently
    assert len(result.expansions) == 2


def test_what_a_model_does_not_reproduce_is_stated(model, monkeypatch):
    """Extended by a solution that never reaches it, as pressures of incompressible tissue did not: it is no better
    there, and another certificate elsewhere must not hide that."""
    few = ReducedSolve(start="frequencies", expansions=3, derivatives=3, max_expansions=8)
    extended = Expander.extended

    def lost(self, made, frequency, start=None):
        better = extended(self, made, frequency, start)
        return better if start is None else replace(better, reduced=made.reduced)

    whole = reduced_sweep(model, BAND, few, tolerance=2e-5)
    assert len(whole.certificates) > 1
    assert whole.certificates[-1].elsewhere < 1e-6  # a projection has its own; columns are single
    monkeypatch.setattr(Expander, "extended", lost)
    broken = reduced_sweep(model, BAND, few, tolerance=2e-5)
    first, second = broken.certificates  # more expansions would not mend it
    assert second.elsewhere == pytest.approx(first.error, rel=1e-9)  # the same model and truth
    assert second.error < first.error <= broken.reduction_error


@needs_multifrontal
@pytest.mark.parametrize("start", sampled(["rate", "frequencies"], 2))
def test_elimination_alone_certifies_as_refined_solves_do(model, start, monkeypatch):
    """What it sees is the true error within what it says of rounding, and that holds against refined solves."""
    options = ReducedSolve(start=start, expansions=3, derivatives=3)
    monkeypatch.setattr(Expander, "foreseen", lambda *_: None)
    result = reduced_sweep(model, BAND, options, tolerance=1e-3)
    (stated,) = result.certificates
    assert 0 < stated.rounding < 1e-4
    exact = direct_sweep(model, np.array([stated.frequency]), options).values
    block = np.ix_([0], [1, 2, 3], [0])
    found = result.reduced.compliance(np.array([stated.frequency]))
    true = relative_error(found[block], exact[block])[0]
    assert abs(stated.error - true) < stated.rounding  # a fifth of it here; single precision leaves 1e-6 or so
    assert true < stated.bound <= result.reduction_error
    monkeypatch.setattr(Expander, "compared", lambda *_: None)
    refined = reduced_sweep(model, BAND, options, tolerance=1e-3)
    assert refined.certificates[0].rounding == 0
    assert (refined.values == result.values).all()  # the model is the same: only its judge differs


@needs_multifrontal
def test_what_an_elimination_would_not_pass_is_solved_and_refined(model, monkeypatch):
    """Its bound is above the tolerance: the solution is needed to extend the space, and its error is refined."""
    asked, by_elimination = [], DirectSolver.by_elimination
    monkeypatch.setattr(
        DirectSolver, "by_elimination", lambda self, f, z: (asked.append(f), by_elimination(self, f, z))[1]
    )
    monkeypatch.setattr("forearm_fem.fem.reduction.expansion.ROUNDED", 0.0)
    few = ReducedSolve(start="frequencies", expansions=3, derivatives=3, max_expansions=8)
    result = reduced_sweep(model, BAND, few, tolerance=2e-5)
    assert asked[0] == result.certificates[0].frequency
    assert result.certificates[0].error > 2e-5
    assert result.certificates[0].rounding == 0
    assert len(result.expansions) > 3


@needs_multifrontal
@pytest.mark.parametrize(
    "options",
    [ReducedSolve(precision="double"), ReducedSolve(backend="superlu")],
)
def test_solvers_that_keep_factors_certify_by_them(small, options, monkeypatch):
    monkeypatch.setattr(Expander, "foreseen", lambda *_: None)
    result = reduced_sweep(small, BAND, options, tolerance=1e-3)
    assert [c.rounding for c in result.certificates] == [0] * len(result.certificates)
    assert result.solve_error <= 1e-7


def test_rounding_of_an_elimination_is_seen_on_known_solutions(small):
    """A factor that is off by a hundredth is seen: what it makes of known solutions is, too."""

    class Rough:
        name, single = "rough", True

        def products(self, data, right):
            solved = np.linalg.solve(whole(small, data), right)
            return 1.01 * right.T @ solved

    known = make_solver(small, ReducedSolve(precision="double"), 100.0).at(100.0).values.real[:, :2]
    found = DirectSolver(small, Rough()).by_elimination(120.0, known)
    assert found is not None
    assert found[1] == pytest.approx(0.08, rel=1e-3)  # eight times what is seen


def whole(model, data):
    """The matrix with these upper-triangle values, dense."""
    return model.operator.matrix(data).product(np.eye(model.operator.n))


def test_a_model_that_tells_nothing_is_refused(model):
    with pytest.raises(SolverError, match="max_expansions"):
        reduced_sweep(
            model,
            BAND,
            ReducedSolve(start="frequencies", expansions=1, derivatives=2, max_expansions=1),
            tolerance=1e-4,
        )


def test_more_expansions_are_taken_until_certified(model):
    few = ReducedSolve(start="frequencies", expansions=1, derivatives=2, max_expansions=8)
    result = reduced_sweep(model, BAND, few, tolerance=1e-5)
    assert 1 < len(result.expansions) <= 8
    assert result.certificates[-1].error < 1e-5
    assert result.certificates[0].error > 1e-5


def test_reduced_model_keeps_reciprocity_and_passivity(one_expansion):
    """Also far from the expansion, where it is inaccurate."""
    for c in one_expansion.compliance(np.array([10.0, 100.0, 500.0, 2000.0])):
        assert np.abs(c - c.T).max() < 1e-9 * np.abs(c).max()
        assert np.linalg.eigvalsh(-(c - c.conj().T) / 2j).min() > -1e-9 * np.abs(c).max()


def test_compressed_model_keeps_structure_and_values(sweep, one_expansion):
    small = one_expansion.compressed(BAND)
    assert small.size <= one_expansion.size
    assert relative_error(small.compliance(BAND), one_expansion.compliance(BAND)).max() < 1e-7
    for matrix in sweep.reduced.matrices:
        assert np.abs(matrix - matrix.T).max() <= 1e-12 * np.abs(matrix).max()


def test_basis_is_orthonormal_and_divergence_free(model, one_expansion):
    """Displacements orthonormal; B u + S p = 0 holds on the span, which is why pressure drops out."""
    n_u = model.operator.n_displacements
    (basis,) = one_expansion.basis.blocks
    assert basis[:n_u].T @ basis[:n_u] == pytest.approx(np.eye(one_expansion.size), abs=1e-10)
    rest = model.operator.multiply(model.operator.data(0.0), basis)[n_u:]
    coupling = next(t for t in model.operator.terms if t.name == "incompressibility")
    size = np.abs(model.operator.term_matrix(coupling)).max()
    assert np.abs(rest).max() < 1e-8 * size


def test_blocks_of_the_basis_are_orthonormal_to_each_other(model, one_expansion):
    """Weak directions of a near expansion are magnified 1e5 times, with what rounding left in them of the first."""
    solver = make_solver(model, ReducedSolve(precision="double"), 110.0)
    both = extend(one_expansion, model, solver.taylor(110.0, solver.at(110.0).values, ALL * 5))
    first, second = (block[: model.operator.n_displacements] for block in both.basis.blocks)
    assert np.abs(first.T @ second).max() < 1e-13
    assert np.abs(second.T @ second - np.eye(second.shape[1])).max() < 1e-13


def test_expansion_is_exact_at_its_frequency(model, one_expansion):
    exact = direct_sweep(model, np.array([100.0]), OPTIONS).values
    assert relative_error(one_expansion.compliance(np.array([100.0])), exact).max() < 1e-8


def test_derivatives_raise_the_order_of_contact(model):
    """Two-sided by symmetry: with derivatives 0..q the error grows like d^(2q+2) or better away from the expansion."""
    solver = make_solver(model, OPTIONS, 100.0)
    series = solver.taylor(100.0, solver.at(100.0).values, ALL * 2)
    exact = direct_sweep(model, np.array([104.0, 108.0]), OPTIONS).values
    for q in (0, 1):
        space = extend(AffineReduced.of(model), model, series[: q + 1])
        error = relative_error(space.compliance(np.array([104.0, 108.0])), exact)
        assert np.log2(error[1] / error[0]) > 2 * q + 1.5


def test_derivatives_in_single_precision_are_refined(model):
    """Each is corrected together with the next one, which must see the correction; refined 5e-7, else 1e-4."""
    series = []
    for precision in ("single", "double"):
        solver = make_solver(model, ReducedSolve(precision=precision), 100.0)
        series.append(solver.taylor(100.0, solver.at(100.0).values, np.array([5, 3, 3, 2])))
    for single, double in zip(*series, strict=True):
        assert np.linalg.norm(single - double) < 5e-6 * np.linalg.norm(double)


def test_contacts_may_keep_more_derivatives_than_points(model):
    """The error of a point's receptance falls with the sum of both counts: 4 + 0 is at least as good as 2 + 2 - 1."""
    solver, near = make_solver(model, ReducedSolve(precision="double"), 100.0), np.array([120.0])
    exact = direct_sweep(model, near, OPTIONS).values[:, 1:, :1]
    error = {}
    for orders in ((2, 1, 1, 1), (4, 0, 0, 0), (2, 2, 2, 2)):
        series = solver.taylor(100.0, solver.at(100.0).values, np.array(orders))
        assert [x.shape[1] for x in series] == [sum(o >= k for o in orders) for k in range(len(series))]
        space = extend(AffineReduced.of(model), model, series, np.array(orders))
        error[orders] = float(relative_error(space.compliance(near)[:, 1:, :1], exact).max())
    assert error[2, 2, 2, 2] < error[2, 1, 1, 1]
    assert error[4, 0, 0, 0] < error[2, 1, 1, 1]


def test_lower_model_lacks_the_highest_derivative_of_each_port(model):
    solver, f = make_solver(model, ReducedSolve(precision="double"), 100.0), np.array([110.0])
    spaces = []
    for orders in ((3, 1, 1, 1), (2, 0, 0, 0)):
        series = solver.taylor(100.0, solver.at(100.0).values, np.array(orders))
        spaces.append(extend(AffineReduced.of(model), model, series, np.array(orders)))
    assert relative_error(spaces[0].lower().compliance(f), spaces[1].compliance(f)).max() < 1e-6


def test_taylor_series_reproduces_the_neighbourhood(model):
    """Sum of scaled Taylor coefficients at 2 % of detuning; the remainder is (0.02 / radius)^6."""
    solver = make_solver(model, ReducedSolve(precision="double"), 100.0)
    series = solver.taylor(100.0, solver.at(100.0).values, ALL * 5)
    near = sum(x * 0.02**k for k, x in enumerate(series))
    exact = solver.at(102.0).values
    assert np.abs(near - exact).max() < 1e-6 * np.abs(exact).max()


def test_repeated_expansion_adds_nothing(model, one_expansion):
    solver = make_solver(model, ReducedSolve(precision="double"), 100.0)
    again = extend(one_expansion, model, solver.taylor(100.0, solver.at(100.0).values, ALL * 5))
    added = again.size - one_expansion.size
    assert added <= 0.15 * one_expansion.size  # directions that the drop tolerance of 1e-7 had left out
    assert np.isfinite(again.compliance(BAND[:3])).all()
    assert relative_error(again.compliance(BAND), one_expansion.compliance(BAND)).max() < 1.0


# --- poles and residues ----------------------------------------------------------------------------------------------


def test_pole_residue_equals_dense_solves(sweep):
    fast = sweep.reduced.modes()
    assert fast is not None
    assert relative_error(fast.compliance(BAND), sweep.reduced.compliance(BAND)).max() < 1e-8


def test_poles_are_summed_alike_for_one_frequency_and_for_many(sweep):
    fast, frequency = sweep.reduced.modes(), np.linspace(20.0, 200.0, 60)
    assert len(frequency) > len(fast.left) > 1  # all at once; one is summed by itself
    together = fast.compliance(frequency)
    single = np.concatenate([fast.compliance(frequency[k : k + 1]) for k in range(0, 60, 7)])
    # Both sum the same terms: rounding alone, of terms that outweigh their sum by far less than the factor left here.
    np.testing.assert_allclose(single, together[::7], rtol=0, atol=1e-9 * np.abs(together).max())


def test_states_from_poles_are_the_dense_ones(sweep):
    """Fields come from these; each state against its own largest entry, as compliances above."""
    fast, ports = sweep.reduced.modes(), [0, sweep.reduced.functionals.shape[1] - 1]
    exact = sweep.reduced.states(BAND)[:, :, ports] * sweep.reduced.shares[ports]
    found = fast.states(BAND, ports)
    assert np.abs(found - exact).max() < 1e-8 * np.abs(exact).max()


def test_poles_of_a_passive_model_are_stable(sweep):
    assert sweep.reduced.modes().poles.real.max() < 0


@pytest.mark.parametrize("modulus", [SpringPot(2680.0, 0.253), Zener(6e3, 12e3, 5.0), Hysteretic(8e3, 0.2)])
def test_operator_as_a_sum_of_its_parts(modulus):
    """The hysteretic modulus' imaginary part was once left out: its Taylor coefficients were refined to a wrong A."""
    operator = held_block(2, tissue=Tissue("block", 1050.0, modulus, 2.2e9)).operator
    x = np.random.default_rng(0).normal(size=(operator.n, 2)) + 1j
    exact = operator.multiply(operator.data(300.0), x)
    assert np.abs(operator.at(300.0).product(x) - exact).max() < 1e-13 * np.abs(exact).max()  # sums in another order


@pytest.mark.parametrize("modulus", [SpringPot(2680.0, 0.253), Zener(6e3, 12e3, 5.0), Hysteretic(8e3, 0.2)])
def test_other_moduli_fall_back_to_dense_reduced_solves(modulus):
    """None of them is a real polynomial in i omega: no poles and residues, and values all right."""
    model = held_block(2, tissue=Tissue("block", 1050.0, modulus, 2.2e9))
    band = np.linspace(50.0, 500.0, 61)
    result = reduced_sweep(model, band, OPTIONS, tolerance=1e-5)
    exact = direct_sweep(model, band[[0, 20, 60]], OPTIONS).values
    assert relative_error(result.values[[0, 20, 60]], exact).max() < 1e-4
    assert result.reduced.modes() is None


# --- parts -----------------------------------------------------------------------------------------------------------


def test_orthonormal_extension_drops_what_is_known():
    rng = np.random.default_rng(0)
    basis, _ = np.linalg.qr(rng.normal(size=(40, 4)))
    known = basis @ rng.normal(size=(4, 2))
    fresh = rng.normal(size=(40, 1))
    columns = np.hstack([known, fresh])
    added, coordinates = orthonormal_extension(Basis((basis,)), columns.copy(), [2, 1], 40, drop=1e-5)
    whole = np.hstack([basis, added]) @ coordinates
    assert np.abs(whole - columns / np.linalg.norm(columns, axis=0)).max() < 1e-12
    assert added.shape == (40, 1)
    assert np.abs(basis.T @ added).max() < 1e-12


def test_negligible_columns_are_no_directions():
    """Imaginary part of the first and real part of the second column are rounding: not scaled up to unit length."""
    block = np.array([[1 + 0j, 1e-16 + 2j], [0, 1j], [1e-16j, 0]])
    columns = real_columns([block])
    assert columns == pytest.approx(np.array([[1, 1e-16, 0, 2], [0, 0, 0, 1], [0, 0, 1e-16, 0]]), abs=0)
    added, _ = orthonormal_extension(Basis(), columns, [4], 3, drop=1e-5)
    assert np.abs(added @ added.T - np.diag([1, 1, 0])).max() < 1e-14


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("width", [3, 16, 26, 40])
def test_basis_works_in_pieces_as_if_it_were_whole(width, compiled, monkeypatch):
    """Blocks in single and in double precision, few columns and many, with compiled code and by BLAS."""
    if not compiled:
        monkeypatch.setattr(bases, "compiled", lambda _: None)
    rng = np.random.default_rng(1)
    whole, columns = rng.normal(size=(5000, 70)), rng.normal(size=(5000, width))
    whole[:, :5] = whole[:, :5].astype(np.float32)
    basis = Basis((whole[:, :5].astype(np.float32), whole[:, 5:].copy()))
    assert agrees(basis.inner(columns[:4501]), whole[:4501].T @ columns[:4501], rel=1e-12, abs_=1e-9)
    known, directions = rng.normal(size=(70, width)), rng.normal(size=(70, 2))
    less = columns.copy()
    basis.subtract_in_place(less, known)
    assert agrees(less, columns - whole @ known, abs_=1e-12)
    assert agrees(basis.combination(known), whole @ known, abs_=1e-12)
    matrix, again = csr_array(rng.normal(size=(2, 4900))), rng.normal(size=(2, 2))
    seen = basis.combined(directions).combined(again).seen_by(matrix)
    assert agrees(seen, matrix @ whole[:4900] @ directions @ again, rel=1e-12, abs_=1e-9)


def agrees(found, exact, *, abs_, rel=0.0):
    """As ``pytest.approx`` decides, which takes seconds to go through a hundred thousand numbers one by one."""
    return found.shape == exact.shape and (np.abs(found - exact) <= np.maximum(rel * np.abs(exact), abs_)).all()


@pytest.mark.parametrize(("n_u", "width"), [(400, 8), (4300, 16), (400, 32)])
def test_columns_are_taken_apart_in_single_precision(n_u, width):
    """In blocks that are orthogonal to 1e-3 only: what is known and what is left are the columns, to 1e-6 a column.

    Eight columns by BLAS, whole vectors of sixteen by compiled code, 4096 rows at a time.
    """
    rng = np.random.default_rng(5)
    whole = np.linalg.qr(rng.normal(size=(n_u, 50)))[0] + 1e-3 / np.sqrt(n_u) * rng.normal(size=(n_u, 50))
    whole = np.vstack([whole, rng.normal(size=(30, 50))]).astype(np.float32)
    basis = Basis((whole[:, :20], whole[:, 20:21], whole[:, 21:]))
    columns = np.vstack([np.linalg.qr(rng.normal(size=(n_u, width)))[0], rng.normal(size=(30, width))])
    left = columns.astype(np.float32)
    known = basis.subtracted_in_place(left, n_u)
    assert np.abs(basis.rough_combination(known) + left - columns).max() < 2e-6  # of single precision's 6e-8, 50 sums
    assert np.abs(whole[:n_u].T @ left[:n_u]).max() < 1e-3  # what the blocks' own products are, times known below 1
    assert Basis().subtracted_in_place(left, n_u).shape == (0, width)


def test_a_basis_asks_for_what_is_not_zero_piece_by_piece():
    """Two sets of columns, of which the first is given where its rows are below 1000, and the second further on."""
    rng = np.random.default_rng(2)
    block, columns = rng.normal(size=(3000, 4)), rng.normal(size=(2, 3000, 6))
    columns[0, 1024:], columns[1, :1024] = 0, 0

    def given(rows):
        t = int(rows.start >= 1024)
        return [(t, columns[t, rows])]

    found = Basis((block[:, :1], block[:, 1:])).inner_of(given, (3000, 2, 6))
    assert found == pytest.approx(block.T @ columns, rel=1e-12, abs=1e-9)


@pytest.mark.parametrize("number", [np.float32, float])
def test_projected_matrices_are_those_of_dense_products(small, number):
    """Of columns as they are kept: what rounding to single precision changes is the same in all terms.

    The coupling of displacements and pressures has these chosen within their span: S + G^T S^-1 G by a dense solve,
    which costs the digits of S's condition, 1e3 for random columns.
    """
    rng = np.random.default_rng(3)
    reduced, whole = AffineReduced.of(small), rng.normal(size=(small.operator.n, 9)).astype(number)
    for part in (whole[:, :5], whole[:, 5:]):
        reduced = with_last_columns(reduced, small, part)
    whole, split = whole.astype(float), small.operator.n_displacements
    dense = {}
    for term in small.operator.terms:
        upper = small.operator.term_matrix(term).toarray()
        dense[term.name] = upper + upper.T - np.diag(np.diag(upper))
    exact = {name: whole.T @ matrix @ whole for name, matrix in dense.items()}
    storage = -exact["compression"]
    coupling = whole[split:].T @ dense["incompressibility"][split:, :split] @ whole[:split]
    exact["incompressibility"] = storage + coupling.T @ np.linalg.solve(storage, coupling)
    for name, matrix in zip(reduced.names, reduced.matrices, strict=True):
        room = 1e-9 if name == "incompressibility" else 1e-12
        assert np.abs(matrix - exact[name]).max() < room * np.abs(exact[name]).max(), name
        assert np.array_equal(matrix, matrix.T)
    assert reduced.functionals == pytest.approx(whole.T @ small.functionals, rel=1e-12, abs=1e-12)


def test_expansion_frequencies_are_bins_of_the_band():
    for count in (1, 3, 7):
        chosen = expansion_frequencies(BAND, ReducedSolve(expansions=count))
        assert set(chosen) <= set(BAND)
        assert len(chosen) == count
    assert expansion_frequencies(np.array([100.0]), OPTIONS) == (100.0,)


def test_expansions_lie_where_resonances_are():
    """Four in 10-500 Hz, equally far apart in f^-0.2 from 30 Hz on; narrow bands whole."""
    bins = np.arange(10.0, 500.5, 0.5)
    assert expansion_frequencies(bins, ReducedSolve(expansions=4)) == (39.5, 72.5, 143.5, 318.5)
    assert expansion_frequencies(np.arange(10.0, 80.5, 0.5), ReducedSolve(expansions=2))[0] < 20.0


def test_probes_are_bins_that_are_not_known_yet():
    assert len(probe_frequencies(np.array([100.0]), [100.0])) == 0
    band = np.arange(10.0, 501.0)
    probes = probe_frequencies(band, [10.0, 163.0])
    assert set(probes) < set(band) - {10.0, 163.0}
    assert probes[-1] == 500.0


def test_doubt_finds_the_worst_frequency_and_bounds_its_error(model):
    """Two expansions at the low end: the model is worst at the other end."""
    solver, reduced = make_solver(model, OPTIONS, 20.0), AffineReduced.of(model)
    for f in (20.0, 90.0):
        reduced = extend(reduced, model, solver.taylor(f, solver.at(f).values, ALL * 2))
    truth = direct_sweep(model, CHECK, OPTIONS).values
    error = relative_error(reduced.compliance(CHECK), truth)
    assert CHECK[int(np.argmax(error))] == 500.0
    found = doubt(model, reduced, BAND, [20.0, 90.0])
    assert found.frequency == pytest.approx(500.0, abs=40.0)
    assert found.change > error.max()


def test_doubt_of_a_good_model_is_where_it_errs(model):
    """Leaving out weak directions too would point at 10 Hz, where a series reaches far and errs a hundredth as much."""
    solver, reduced = make_solver(model, OPTIONS, 100.0), AffineReduced.of(model)
    for f in (40.0, 140.0, 320.0):
        reduced = extend(reduced, model, solver.taylor(f, solver.at(f).values, ALL * 4))
    error = relative_error(reduced.compliance(CHECK), direct_sweep(model, CHECK, OPTIONS).values)
    found = doubt(model, reduced, BAND, [40.0, 140.0, 320.0])
    assert CHECK[int(np.argmax(error))] == 500.0
    assert found.frequency == pytest.approx(500.0, abs=40.0)


@pytest.mark.slow  # 2 s
def test_single_precision_gives_the_same_model_as_double(model, truth):
    """Kept in saddle form, what single-precision factors leave enters squared; 1e-6 is where directions are dropped."""
    for precision in ("single", "double"):
        swept = reduced_sweep(model, BAND, ReducedSolve(start="frequencies", precision=precision), tolerance=None)
        assert relative_error(swept.reduced.compliance(CHECK), truth).max() < 1e-6


def test_changed_terms_change_the_answer_as_a_new_model_would(model):
    """A fifth more shear modulus in the old space; 1e-2 of room for a space made for the old modulus."""
    swept = reduced_sweep(model, BAND, OPTIONS, tolerance=None)
    stiffer = swept.reduced.changed({"shear block": KelvinVoigt(1.2 * 7860.0, 5.03)})
    exact = direct_sweep(held_block(3, tissue=flesh(1.2 * 7860.0, bulk=2.2e9)), CHECK, OPTIONS).values
    assert relative_error(swept.reduced.compliance(CHECK), exact).max() > 0.1
    assert relative_error(stiffer.compliance(CHECK), exact).max() < 1e-2
    with pytest.raises(KeyError, match="shear bone"):
        swept.reduced.changed({"shear bone": KelvinVoigt(1.0, 1.0)})


def test_single_frequency_sweep(model):
    result = reduced_sweep(model, np.array([120.0]), OPTIONS)
    exact = direct_sweep(model, np.array([120.0]), OPTIONS).values
    assert relative_error(result.values, exact).max() < 1e-8
