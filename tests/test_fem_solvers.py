"""Direct solvers: agreement, single precision with refinement, named failures."""

from __future__ import annotations

import alternatives as slow
import numpy as np
import pytest
from scipy.sparse import csr_array, diags_array
from threadpoolctl import threadpool_limits

from forearm_fem.errors import SolverError
from forearm_fem.fem.assembly.coefficients import Polynomial
from forearm_fem.fem.assembly.operator import affine_operator
from forearm_fem.fem.kernels.compiled import thread_count
from forearm_fem.fem.kernels.matrices import SymmetricMatrix
from forearm_fem.fem.linear import factor as factors
from forearm_fem.fem.linear.direct import make_solver
from forearm_fem.fem.linear.factor import SuperLUFactor, make_factor, refined_solve
from forearm_fem.fem.linear.pardiso import PardisoFactor
from forearm_fem.fem.reduction.sweep import direct_sweep
from forearm_fem.scenario.sweep import ReducedSolve
from forearm_fem.transfer import relative_error
from forearm_fem.verification.scenes import flesh, held_block

OMEGA = 2 * np.pi * 150.0


@pytest.fixture(scope="module")
def model():
    return held_block(2)


@pytest.fixture(scope="module")
def loads(model):
    rng = np.random.default_rng(5)
    return rng.normal(size=(model.operator.n, 3)) + 1j * rng.normal(size=(model.operator.n, 3))


def test_operator_is_complex_symmetric_and_affine(model):
    """A(omega) from one pattern equals the sum of its terms; A = A^T, not A^H."""
    operator = model.operator
    a = slow.dense(operator, OMEGA)
    terms = [operator.term_matrix(t).toarray() * complex(t.coefficient.at(OMEGA)) for t in operator.terms]
    upper = np.sum(terms, axis=0)
    assert np.abs(a - (upper + upper.T - np.diag(np.diag(upper)))).max() < 1e-14 * np.abs(a).max()
    assert np.array_equal(a, a.T)
    assert np.abs(a.imag).max() > 1e-3 * np.abs(a).max()


def test_taylor_coefficients_continue_the_solution(model):
    """The series about one frequency, summed beside it, is the direct solution there; columns of lower order too."""
    solver = make_solver(model, ReducedSolve(precision="double"), 150.0)
    start = solver.at(150.0).values
    orders = np.arange(len(model.ports)) % 3 + 6
    series = solver.taylor(150.0, start, orders)
    step = 0.01
    summed = np.array(start)
    for k, coefficient in enumerate(series[1:], start=1):
        summed[:, orders >= k] += step**k * coefficient
    direct = solver.at(150.0 * (1 + step)).values
    gap = np.linalg.norm(summed - direct, axis=0) / np.linalg.norm(direct, axis=0)
    assert gap.max() < 1e-9  # the next term: 0.01^7 times (distance to the nearest pole over 150 Hz)^-7, about 5


def test_diagonal_stands_first_in_each_row(model):
    operator = model.operator
    assert np.array_equal(operator.indices[operator.diagonal_positions], np.arange(operator.n))


def symmetric(upper):
    """The symmetric matrix with this upper triangle, diagonal included."""
    return SymmetricMatrix(csr_array(upper - diags_array(upper.diagonal() / 2)))


@pytest.mark.parametrize("kind", [float, complex])
def test_symmetric_product_with_vectors_and_columns(kind):
    """Small integers: exact."""
    upper = np.array([[1, 2, 0, 1], [0, 3, 4, 0], [0, 0, 0, 6], [0, 0, 0, 5]], dtype=kind) * (
        1 if kind is float else 1j
    )
    matrix = symmetric(csr_array(upper))
    full = upper + upper.T - np.diag(np.diag(upper))
    x = np.array([[1.0, 2], [3, 4], [5, 6], [7, 8]])
    for columns in (x, x[:, 0], x + 1j * x[::-1], x[:, ::-1]):
        assert np.array_equal(matrix.product(columns), full @ columns)


@pytest.mark.needs_mkl
def test_pardiso_superlu_and_dense_agree(model, loads):
    data = model.operator.data(OMEGA)
    exact = np.linalg.solve(slow.dense(model.operator, OMEGA), loads)
    for backend in ("pardiso", "superlu"):
        solver = make_factor(model.operator, OMEGA, backend, single=False)
        solver.factorise(data)
        found = refined_solve(solver, model.operator.matrix(data), loads).values
        assert np.abs(found - exact).max() < 1e-8 * np.abs(exact).max(), backend  # condition 1e6 times rounding
        solver.release()


def test_compliance_equals_dense(model):
    found = direct_sweep(model, np.array([5.0, 150.0]), ReducedSolve()).values
    for value, f in zip(found, (5.0, 150.0), strict=True):
        exact = slow.dense_compliance(model, f)
        assert np.abs(value - exact).max() < 1e-10 * np.abs(exact).max()


@pytest.mark.parametrize("frequency", [0.5, 150.0, 2000.0])
def test_single_precision_is_refined_to_double(model, frequency):
    f = np.array([frequency])
    single, double = (direct_sweep(model, f, ReducedSolve(precision=p)) for p in ("single", "double"))
    assert single.residual < 1e-9
    assert np.abs(single.values - double.values).max() < 1e-7 * np.abs(double.values).max()


@pytest.mark.needs_mkl
def test_single_precision_alone_is_not_enough(model, loads):
    """What refinement is for: the bare single-precision solve leaves more than 1e-9."""
    data = model.operator.data(OMEGA)
    solver = PardisoFactor(model.operator.upper(data), single=True)
    solver.factorise(data)
    bare = loads - model.operator.multiply(data, solver.solve(loads))
    assert 1e-9 < np.linalg.norm(bare) / np.linalg.norm(loads) < 1e-1
    assert refined_solve(solver, model.operator.matrix(data), loads).residual < 1e-11


@pytest.mark.needs_mkl
def test_saddle_systems_need_no_perturbed_pivots(model):
    solver = PardisoFactor(model.operator.upper(model.operator.data(OMEGA)))
    solver.factorise(model.operator.data(OMEGA))
    assert solver.perturbed_pivots == 0
    assert solver.factor_bytes > 1e5


def singular(kind):
    """A 3 x 3 operator without an inverse: a zero row, or a null vector hidden in ones."""
    matrix = np.array([[2.0, 1, 0], [1, 1, 0], [0, 0, 0]]) if kind == "zero row" else np.ones((3, 3))
    return affine_operator([("a", csr_array(matrix), Polynomial(1.0))], 3, 1.0)


@pytest.mark.parametrize("kind", ["zero row", "null vector"])
@pytest.mark.parametrize("backend", ["superlu", pytest.param("pardiso", marks=pytest.mark.needs_mkl)])
def test_singular_system_is_a_named_error(kind, backend):
    operator = singular(kind)
    data, right = operator.data(0.0), np.array([[1.0], [2.0], [3.0]], dtype=complex)

    def solve():
        solver = make_factor(operator, 0.0, backend, single=False)
        solver.factorise(data)
        return refined_solve(solver, operator.matrix(data), right)

    with pytest.raises(SolverError):
        solve()


class Sloppy:
    """A solver that returns a fixed multiple of the right answer to A = diagonal."""

    def __init__(self, diagonal, gain):
        self.diagonal, self.gain = diagonal, gain

    def solve(self, right):
        return self.gain * right / self.diagonal[:, None]


def diagonal(values):
    return symmetric(csr_array(np.diag(values).astype(complex)))


@pytest.mark.parametrize(("gain", "fine"), [(0.9, True), (1.0, True), (0.2, False), (2.5, False)])
def test_refinement_converges_or_raises(gain, fine):
    """Gain g leaves (1 - g)^7 after six rounds: 0.9 is rescued, 0.2 gains too little per round, 2.5 diverges."""
    d = np.array([1.0, 4.0, 9.0])
    right = np.ones((3, 2), dtype=complex)
    matrix = diagonal(d)
    if fine:
        solution = refined_solve(Sloppy(d, gain), matrix, right, tolerance=1e-6)
        assert solution.values == pytest.approx(right / d[:, None], rel=2e-6)
        assert solution.residual <= 1e-6
    else:
        with pytest.raises(SolverError, match="relative residual"):
            refined_solve(Sloppy(d, gain), matrix, right)


def test_refinement_of_a_zero_column():
    d = np.array([2.0, 3.0])
    right = np.array([[1.0, 0.0], [1.0, 0.0]], dtype=complex)
    solution = refined_solve(Sloppy(d, 1.0), diagonal(d), right)
    assert np.array_equal(solution.values[:, 1], [0, 0])


def test_not_a_number_never_comes_out():
    right = np.array([[np.nan], [1.0]], dtype=complex)
    with pytest.raises(SolverError):
        refined_solve(Sloppy(np.ones(2), 1.0), diagonal(np.ones(2)), right)


def test_superlu_refuses_what_it_would_not_finish():
    with pytest.raises(SolverError, match="install MKL"):
        factors.choose_backend("superlu", 100_000)


@pytest.mark.parametrize(
    ("machine", "system", "single", "compiles", "said", "not_said"),
    [
        ("x86_64", "linux", True, True, "pip install mkl", "there is no MKL"),
        ("AMD64", "win32", False, False, "pip install mkl", "there is no MKL"),
        ("arm64", "darwin", True, False, "pymetis and numba", "install mkl"),
        ("aarch64", "linux", False, True, "solver.precision = 'auto'", "install mkl"),
        ("x86_64", "darwin", True, True, "coarsen the mesh", "MKL"),
    ],
)
def test_the_solver_advised_is_one_that_this_machine_can_have(
    monkeypatch, machine, system, single, compiles, said, not_said
):
    monkeypatch.setattr(factors.platform, "machine", lambda: machine)
    monkeypatch.setattr(factors.sys, "platform", system)
    monkeypatch.setattr(factors, "_compiles", lambda: compiles)
    with pytest.raises(SolverError) as caught:
        factors.choose_backend("superlu", 100_000, single=single)
    assert said in str(caught.value)
    assert not_said not in str(caught.value)


def test_without_mkl_and_numba_superlu_serves(monkeypatch):
    monkeypatch.setattr(factors.pardiso, "mkl_library", lambda: None)
    monkeypatch.setattr(factors, "_compiles", lambda: False)
    assert factors.available_backends() == ("superlu",)
    assert factors.choose_backend("auto", 1000) == "superlu"
    with pytest.raises(SolverError, match="not installed"):
        PardisoFactor(csr_array(np.eye(2)))


def test_superlu_factor_can_be_reused(model, loads):
    data = model.operator.data(OMEGA)
    solver = SuperLUFactor(model.operator.upper(data))
    for omega in (OMEGA, 2 * OMEGA):
        data = model.operator.data(omega)
        solver.factorise(data)
        rest = loads - model.operator.multiply(data, solver.solve(loads))
        assert np.linalg.norm(rest) < 1e-6 * np.linalg.norm(loads)
    solver.release()


def test_superlu_keeps_to_the_diagonal_until_it_is_hardened(model, loads):
    """Largest pivots fill more by half; both leave a residual of rounding, and what was hardened stays so."""
    data = model.operator.data(OMEGA)
    solver, size = SuperLUFactor(model.operator.upper(data)), np.linalg.norm(loads)
    solver.factorise(data)
    filled = solver._lu.nnz
    assert np.linalg.norm(loads - model.operator.multiply(data, solver.solve(loads))) < 1e-9 * size
    assert solver.harden(data)
    assert solver._lu.nnz > 1.3 * filled
    assert np.linalg.norm(loads - model.operator.multiply(data, solver.solve(loads))) < 1e-9 * size
    assert not solver.harden(data)
    solver.factorise(model.operator.data(2 * OMEGA))
    assert solver._lu.nnz > 1.3 * filled


def test_superlu_pivots_off_a_diagonal_of_zeros():
    """Exactly incompressible tissue has no pressure of its own: [[0, 1], [1, 0]] within the rest."""
    matrix = np.array([[2.0, 1, 1], [1, 0, 3], [1, 3, 0]])
    upper = csr_array(np.triu(matrix))
    solver = SuperLUFactor(upper)
    solver.factorise(upper.data)
    assert solver.solve(np.eye(3)) == pytest.approx(np.linalg.inv(matrix), abs=1e-14)


def test_superlus_blas_has_one_thread(monkeypatch):
    """With two its small blocks took eight times as long beside other work."""
    seen: list[int] = []

    class Solved:
        def solve(self, right):
            seen.append(thread_count())
            return right

    monkeypatch.setattr(factors, "splu", lambda *_, **__: (seen.append(thread_count()), Solved())[1])
    solver, upper = SuperLUFactor(csr_array(np.eye(2))), csr_array(np.eye(2))
    with threadpool_limits(2, user_api="blas"):
        if thread_count() < 2:
            pytest.skip("this BLAS has one thread at most")
        solver.factorise(upper.data)
        solver.solve(np.eye(2))
        assert thread_count() == 2
    assert seen == [1, 1]


@pytest.mark.needs_mkl
def test_pardiso_factor_can_be_reused_and_released_twice(model, loads):
    solver = PardisoFactor(model.operator.upper(model.operator.data(OMEGA)))
    for omega in (OMEGA, 2 * OMEGA, OMEGA):
        data = model.operator.data(omega)
        solver.factorise(data)
        assert refined_solve(solver, model.operator.matrix(data), loads).residual < 1e-11
    one = loads[:, 0]
    assert solver.solve(one) == pytest.approx(solver.solve(loads)[:, 0], rel=1e-6, abs=1e-9 * np.abs(one).max())
    solver.release()
    solver.release()


def test_incompressible_and_stiff_bulk_meet():
    """1e14 Pa and infinity differ by mu / kappa; neither loses digits."""
    stiff, infinite = (
        direct_sweep(held_block(2, tissue=flesh(bulk=b)), np.array([100.0]), ReducedSolve()).values
        for b in (1e14, np.inf)
    )
    assert np.abs(stiff - infinite).max() < 1e-8 * np.abs(infinite).max()


@pytest.mark.needs_mkl
def test_auto_hardens_to_double_where_single_precision_is_not_enough(model, monkeypatch, caplog):
    """A solver that loses the first factors' accuracy: the same solution, in double precision, and a warning."""
    right = PardisoFactor.solve
    monkeypatch.setattr(PardisoFactor, "solve", lambda self, b: right(self, b) * (0.5 if self.single else 1.0))
    f = np.array([60.0])
    hardened = direct_sweep(model, f, ReducedSolve(precision="auto"))
    assert hardened.residual < 1e-11
    assert "double precision from here on" in caplog.text
    monkeypatch.undo()
    plain = direct_sweep(model, f, ReducedSolve(precision="double"))
    assert relative_error(hardened.values, plain.values).max() < 1e-9
