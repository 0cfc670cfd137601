"""The space about a real rate: what it holds, when it ends, and the reduced sweep that starts from it."""

from dataclasses import replace

import numpy as np
import pytest

from forearm_fem.errors import SolverError
from forearm_fem.fem.assembly.coefficients import rate_weights
from forearm_fem.fem.assembly.model import ForearmModel
from forearm_fem.fem.linear.direct import ENOUGH, DirectSolver, make_solver, watched
from forearm_fem.fem.reduction.affine import AffineReduced, with_last_columns
from forearm_fem.fem.reduction.expansion import ROUNDED, expansion_rate
from forearm_fem.fem.reduction.rate_space import Chunk, LoadSpace, RateSpace
from forearm_fem.fem.reduction.sweep import direct_sweep, reduced_sweep
from forearm_fem.scenario.sweep import ReducedSolve
from forearm_fem.tissue import Hysteretic, KelvinVoigt, Tissue
from forearm_fem.transfer import relative_error
from forearm_fem.verification.scenes import flesh, held_block

BAND = np.linspace(10.0, 500.0, 197)
CHECK = BAND[[0, 9, 28, 52, 80, 129, 184, 196]]
RATE = 2 * np.pi * 100.0
DOUBLE, AUTO = ReducedSolve(precision="double"), ReducedSolve()


@pytest.fixture(scope="module")
def model() -> ForearmModel:
    return held_block(3, tissue=flesh(bulk=2.2e9))


@pytest.fixture(scope="module")
def truth(model):
    return of_contacts(model, direct_sweep(model, CHECK, DOUBLE).values)


def of_contacts(model, values):
    """What is watched of a compliance: points' motion for forces on contacts."""
    return values[np.ix_(range(len(values)), *watched(model))]


def space_of(model, options=AUTO, forces=None, chunks=()) -> RateSpace:
    solver = make_solver(model, options, 100.0)
    forces = model.functionals if forces is None else forces
    return RateSpace(solver, np.ascontiguousarray(forces), RATE, chunks)


def whole(chunk: Chunk, model: ForearmModel):
    """The columns' displacements."""
    return chunk.columns[: model.operator.n_displacements]


def test_the_first_weights_are_the_operator_at_the_rate(model):
    """A(s) = A_0 + A_1 d + A_2 d^2 with s = rate (1 + d), against the coefficients at omega = -i s."""
    terms, d = model.operator.terms, 0.3
    found = np.array([1.0, d, d**2]) @ rate_weights([t.coefficient for t in terms], RATE)
    series = np.array([t.coefficient.taylor(0.0, 2) for t in terms])
    exact = series @ (-1j * RATE * (1 + d)) ** np.arange(3)
    assert found == pytest.approx(exact.real, rel=1e-12)
    assert np.abs(exact.imag).max() < 1e-12 * np.abs(exact).max()


def derivatives(solver, weights, forces, highest):
    """Solutions for ``forces`` and their derivatives about the rate, by the plain recursion."""
    operator, series = solver.model.operator, [solver.about_rate(weights[0], forces).values]
    for _ in range(highest):
        right = [
            operator.multiply(operator.combine(w.tolist()), x) for w, x in zip(weights[1:], series[::-1], strict=False)
        ]
        series.append(solver.factor.solve(-sum(right)))
    return series


def test_the_space_holds_the_derivatives(model):
    """The first five derivatives by the plain recursion, in double precision: what the space lacks of each."""
    solver, operator = make_solver(model, DOUBLE, 100.0), model.operator
    weights = rate_weights([t.coefficient for t in operator.terms], RATE)
    forces = np.ascontiguousarray(model.functionals[:, :1])
    series = derivatives(solver, weights, forces, 5)
    chunk = space_of(model, DOUBLE, forces).more(6)
    basis, n_u = whole(chunk, model), operator.n_displacements
    assert chunk.columns.shape[1] == chunk.derivatives == 6
    for x in series:
        rest = x[:n_u] - basis @ (basis.T @ x[:n_u])
        assert np.linalg.norm(rest) < 1e-9 * np.linalg.norm(x[:n_u])


def test_a_space_of_many_loads_holds_the_derivatives_of_each(model):
    """Two batches of loads far apart in size, at a rate where masses matter: what the space lacks of three derivatives.

    Nothing is dropped, so that is what columns in single precision leave: thirty of its roundings are allowed. Pairs
    without their lower halves, or with halves scaled apart, leave twenty times as much and more.
    """
    rate, n_u = 15 * RATE, model.operator.n_displacements
    solver = make_solver(model, DOUBLE, rate / (2 * np.pi))
    loads = model.functionals * np.geomspace(1.0, 1e3, model.functionals.shape[1])
    space = LoadSpace(solver, rate, derivatives=3)
    for batch in (loads[:, :1], loads[:, 1:]):
        space.add(np.ascontiguousarray(batch), 1e-4)
    assert space.size == 4 * loads.shape[1]
    basis = np.hstack(space.basis.blocks)[:n_u].astype(float)
    assert np.abs(basis.T @ basis - np.eye(space.size)).max() < 1e-3  # 1e-7 over the share that is dropped
    weights = rate_weights([t.coefficient for t in model.operator.terms], rate)
    for x in derivatives(solver, weights, np.ascontiguousarray(loads), 3):
        rest = x[:n_u] - basis @ np.linalg.lstsq(basis, x[:n_u], rcond=None)[0]
        assert (np.linalg.norm(rest, axis=0) < 2e-6 * np.linalg.norm(x[:n_u], axis=0)).all()


@pytest.mark.parametrize("options", [AUTO, DOUBLE])
def test_columns_are_orthonormal_and_divergence_free(model, options):
    """B u + S p = 0 holds on the span to what solves leave, which is why pressure drops out."""
    columns, n_u = space_of(model, options).more(30).columns, model.operator.n_displacements
    assert np.abs(columns[:n_u].T @ columns[:n_u] - np.eye(columns.shape[1])).max() < 1e-4
    rest = model.operator.multiply(model.operator.data(0.0), columns.astype(complex))[n_u:]
    coupling = next(t for t in model.operator.terms if t.name == "incompressibility")
    assert np.abs(rest).max() < 1e-4 * np.abs(model.operator.term_matrix(coupling)).max()


@pytest.mark.slow  # 1 s
def test_in_pieces_as_at_once(model):
    """Ten derivatives at a time, from what was kept of the first ten, or all: the same space."""
    at_once = space_of(model, DOUBLE).more(20)
    pieces = space_of(model, DOUBLE)
    first = pieces.more(10)
    resumed = space_of(model, DOUBLE, chunks=(first,)).more(10)
    columns = whole(at_once, model)
    for second in (pieces.more(10), resumed):
        assert second.derivatives == at_once.derivatives == 20
        both = np.hstack([whole(first, model), whole(second, model)])
        # weak remainders are magnified, and rounding with them
        assert np.abs(columns - both @ (both.T @ columns)).max() < 1e-7


def single_space(model, chunks=()) -> RateSpace:
    """A space for a sweep that is asked for 1e-4: its solves are refined to 1e-7."""
    solver = replace(make_solver(model, AUTO, 100.0), tolerance=ENOUGH)
    return RateSpace(solver, np.ascontiguousarray(model.functionals), RATE, chunks)


def test_single_precision_solves_keep_columns_in_single_precision(model, truth, monkeypatch):
    """Half the memory where no more is asked for than such solves give: errors are those of columns in double."""
    assert space_of(model, DOUBLE).more(1).columns.dtype == np.float64
    assert space_of(model, AUTO).more(1).columns.dtype == np.float64  # refined to 1e-9: more is asked for
    chunks = [single_space(model).more(20)]
    assert chunks[0].columns.dtype == np.float32
    columns = whole(chunks[0], model).astype(float)
    assert np.abs(columns.T @ columns - np.eye(columns.shape[1])).max() < 1e-6
    monkeypatch.setattr(RateSpace, "_number", np.float64)
    chunks.append(single_space(model).more(20))
    models = [with_last_columns(AffineReduced.of(model), model, chunk.columns) for chunk in chunks]
    errors = [relative_error(of_contacts(model, reduced.compliance(CHECK)), truth).max() for reduced in models]
    assert errors[0] < 2 * errors[1]  # either is what solves leave, to a factor that chance decides


def test_resumed_from_single_precision_it_is_the_same(model):
    """What an interrupted sweep kept are the columns themselves then, whichever precision they come back in."""
    first = single_space(model).more(10)
    again = replace(first, columns=first.columns.astype(float))
    one, other = (single_space(model, (chunk,)).more(5) for chunk in (first, again))
    assert np.array_equal(one.columns, other.columns)
    assert np.array_equal(one.pairs.upper, other.pairs.upper)


def test_equal_forces_give_one_column(model):
    """Images of a contact on a symmetric quarter load it alike; a port without a force adds nothing."""
    force = model.functionals[:, :1]
    chunk = space_of(model, DOUBLE, np.hstack([force, 2 * force, 0 * force])).more(5)
    assert chunk.columns.shape[1] == 5
    one = space_of(model, DOUBLE, force).more(5)
    assert np.abs(np.abs((whole(chunk, model) * whole(one, model)).sum(axis=0)) - 1).max() < 1e-6


def test_it_ends_where_forces_reach_nothing_more():
    """A block of very few unknowns: no more columns than there are displacements, and the model is the system."""
    small = held_block(1, tissue=flesh(bulk=2.2e9))
    space, reduced = space_of(small, DOUBLE), AffineReduced.of(small)
    while (chunk := space.more(40)).columns.shape[1]:
        reduced = with_last_columns(reduced, small, chunk.columns)
    assert reduced.size <= small.operator.n_displacements
    assert space.more(10).columns.shape[1] == 0
    exact = direct_sweep(small, CHECK, DOUBLE).values
    found = reduced.compliance(CHECK)
    assert relative_error(of_contacts(small, found), of_contacts(small, exact)).max() < 1e-6


@pytest.mark.slow  # 1 s
def test_more_derivatives_leave_less(model, truth):
    """The error falls by orders of magnitude, not to a floor above 1e-9: the sum of plain derivatives stops at 1e-4."""
    space, reduced, errors = space_of(model, DOUBLE), AffineReduced.of(model), []
    for _ in range(4):
        reduced = with_last_columns(reduced, model, space.more(15).columns)
        errors.append(relative_error(of_contacts(model, reduced.compliance(CHECK)), truth).max())
    assert errors[1] < errors[0] / 10
    assert errors[3] < 1e-8


@pytest.mark.parametrize("tolerance", [1e-3, 1e-4, 1e-6])
def test_the_sweep_is_certified_and_right(model, truth, tolerance):
    """One factorisation, at the rate, another for a certificate of what single precision does not see, and the error
    stated holds over the band."""
    swept = reduced_sweep(model, BAND, AUTO, tolerance=tolerance)
    assert swept.rate == pytest.approx(expansion_rate(BAND))
    assert swept.expansions == ()
    assert swept.factorisations == (1 if tolerance >= ROUNDED else 2)
    assert swept.certificates[-1].bound < tolerance
    assert swept.reduction_error <= tolerance
    error = relative_error(of_contacts(model, swept.values[np.searchsorted(BAND, CHECK)]), truth)
    assert error.max() < swept.reduction_error
    assert swept.residual <= 1e-7


def test_as_many_derivatives_as_the_accuracy_needs(model):
    """And no more: a tolerance of 1e-2 takes fewer than 1e-6, and the most that are allowed are not exceeded."""
    rough, fine = (reduced_sweep(model, BAND, AUTO, tolerance=t) for t in (1e-2, 1e-6))
    assert rough.derivatives < fine.derivatives < AUTO.rate_derivatives
    short = reduced_sweep(model, BAND, ReducedSolve(rate_derivatives=12), tolerance=None)
    assert short.derivatives == 12


def test_too_few_derivatives_are_made_good_by_expansions(model, truth):
    """Ten derivatives do not reach 1e-6: the certificates say so, and expansions about frequencies extend the space."""
    swept = reduced_sweep(model, BAND, ReducedSolve(rate_derivatives=10), tolerance=1e-6)
    assert swept.expansions
    assert swept.certificates[0].error > 1e-6
    assert swept.reduction_error <= 1e-6
    error = relative_error(of_contacts(model, swept.values[np.searchsorted(BAND, CHECK)]), truth)
    assert error.max() < 1e-5


def test_factors_that_lose_too_much_are_made_good(model, truth, monkeypatch):
    """Solutions off by 1e-3: every derivative is refined then, not only the first ones."""
    solves, right = [], DirectSolver.about_rate

    def poor(self, weights, forces):
        inner = type(self.factor.now)
        solve = inner.solve
        monkeypatch.setattr(inner, "solve", lambda this, b: (solves.append(b.shape), solve(this, b) * 1.001)[1])
        return right(self, weights, forces)

    monkeypatch.setattr(DirectSolver, "about_rate", poor)
    space, reduced = space_of(model), AffineReduced.of(model)
    reduced = with_last_columns(reduced, model, space.more(60).columns)
    assert len(solves) > 2 * 59
    assert relative_error(of_contacts(model, reduced.compliance(CHECK)), truth).max() < 1e-6


@pytest.mark.slow  # 2 s
def test_a_fifth_more_of_one_modulus(model):
    """Derivatives about a rate hold for neighbouring moduli; 1e-3 of room for a space made for others."""
    swept = reduced_sweep(model, BAND, AUTO, tolerance=1e-4)
    stiffer = swept.reduced.changed({"shear block": KelvinVoigt(1.2 * 7860.0, 5.03)})
    exact = direct_sweep(held_block(3, tissue=flesh(1.2 * 7860.0, bulk=2.2e9)), CHECK, DOUBLE).values
    found = of_contacts(model, stiffer.compliance(CHECK))
    assert relative_error(found, of_contacts(model, exact)).max() < 1e-3


def test_other_moduli_start_from_frequencies():
    model = held_block(2, tissue=Tissue("block", 1050.0, Hysteretic(8e3, 0.2), 2.2e9))
    swept = reduced_sweep(model, BAND[::4], AUTO, tolerance=1e-4)
    assert swept.rate == 0.0
    assert swept.expansions
    with pytest.raises(SolverError, match="Kelvin-Voigt"):
        reduced_sweep(model, BAND[::4], ReducedSolve(start="rate"), tolerance=1e-4)


def test_pairs_without_loss_do_not_break_down():
    """Where x_k alone were made orthonormal, 27 derivatives were all there was, and all wrong."""
    model = held_block(2, tissue=flesh(eta=0.04, bulk=2.2e9))
    chunk = space_of(model, DOUBLE, model.functionals[:, :1]).more(60)
    assert chunk.columns.shape[1] == chunk.derivatives == 60
    pairs = chunk.pairs
    gram = pairs.upper.T @ pairs.upper + 1e-6 * pairs.lower.T @ pairs.lower  # x_(k-1) counts a thousandth
    assert np.abs(gram - np.eye(60)).max() < 1e-12
    assert np.abs(pairs.lower).max() <= 1e3


def test_rate_of_a_band():
    """126 Hz for 10-500 Hz; about the middle of a narrow band, in proportion."""
    assert expansion_rate(BAND) == pytest.approx(2 * np.pi * 126.0, rel=0.01)
    assert expansion_rate(np.array([200.0, 300.0])) == pytest.approx(2 * np.pi * np.sqrt(200.0 * 300.0), rel=0.05)


def test_the_lower_model_lacks_the_last_columns(model):
    space, f = space_of(model, DOUBLE), np.array([110.0, 400.0])
    first, second = space.more(12), space.more(10)
    lower = with_last_columns(AffineReduced.of(model), model, first.columns)
    both = with_last_columns(lower, model, second.columns)
    assert relative_error(both.lower().compliance(f), lower.compliance(f)).max() < 1e-9
