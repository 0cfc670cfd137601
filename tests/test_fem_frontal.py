"""The multifrontal solver: its symbolic part against dense elimination, its numbers against NumPy and PARDISO."""

import weakref
from functools import cache

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba.extending import get_cython_function_address
from scipy.sparse import csr_array, triu

from forearm_fem.errors import SolverError
from forearm_fem.fem.assembly.coefficients import rate_weights
from forearm_fem.fem.assembly.operator import WeightedSum
from forearm_fem.fem.linear import factor as factors
from forearm_fem.fem.linear.direct import make_solver
from forearm_fem.fem.linear.factor import FallbackFactor, make_factor, nested_dissection, refined_solve
from forearm_fem.fem.linear.multifrontal import blas, panels
from forearm_fem.fem.linear.multifrontal.factor import MultifrontalFactor, passing_store, scales
from forearm_fem.fem.linear.multifrontal.fronts import divided
from forearm_fem.fem.linear.multifrontal.symbolic import symbolic_factor
from forearm_fem.fem.linear.pardiso import PardisoFactor, mkl_library
from forearm_fem.scenario.sweep import ReducedSolve
from forearm_fem.verification.scenes import flesh, held_block

FACTOR = "forearm_fem.fem.linear.multifrontal.factor"

OMEGA = 2 * np.pi * 100
pytestmark = pytest.mark.skipif(not factors._compiles(), reason="numba or pymetis is not installed")


def upper_of(full: np.ndarray) -> csr_array:
    """Upper triangle in CSR with its whole diagonal."""
    half = csr_array(triu(csr_array(full)))
    half.sort_indices()
    return half


def random_pattern(n: int, per_row: float, seed: int) -> np.ndarray:
    """A symmetric complex matrix (n, n) with a dominant diagonal, whose real part is dominant too."""
    random = np.random.default_rng(seed)
    there = random.random((n, n)) < per_row / n
    values = np.where(there, random.normal(size=(n, n)) + 1j * random.normal(size=(n, n)), 0)
    full = values + values.T
    return full + np.diag(1 + np.abs(full).sum(axis=0)) * (1 + 0.2j)


def eliminated(full: np.ndarray, order: np.ndarray) -> list[set[int]]:
    """Rows of each column of the factor, by elimination of a dense pattern: the oracle."""
    there = full[np.ix_(order, order)] != 0
    for j in range(len(order)):
        rows = np.flatnonzero(there[:, j])
        rows = rows[rows > j]
        there[np.ix_(rows, rows)] = True
    return [set(np.flatnonzero(there[:, j])[np.flatnonzero(there[:, j]) > j]) for j in range(len(order))]


@settings(max_examples=40, deadline=None)
@given(n=st.integers(1, 60), per_row=st.floats(0, 4), seed=st.integers(0, 1000))
def test_fronts_hold_the_factors_pattern(n, per_row, seed):
    """Each column's rows are in its front, and a front's last column has just the rows below it (merging adds zeros to
    first columns only)."""
    full = random_pattern(n, per_row, seed)
    found = symbolic_factor(upper_of(full), np.random.default_rng(seed).permutation(n))
    exact, fronts = eliminated(full, found.order), found.fronts
    assert sorted(found.order) == list(range(n))
    for s in range(len(found.parent)):
        rows = fronts.rows[fronts.below[s] : fronts.below[s + 1]]
        columns = range(fronts.first[s], fronts.first[s + 1])
        assert list(rows) == sorted(exact[columns[-1]])
        assert all(exact[j] <= {*columns, *rows} for j in columns)
        if len(rows):
            p = found.parent[s]
            assert p > s
            assert fronts.first[p] <= rows[0] < fronts.first[p + 1]
            assert set(rows) <= {*range(fronts.first[p], fronts.first[p + 1]), *eliminated_rows(fronts, p)}


def eliminated_rows(fronts, s):
    """Rows below supernode ``s``."""
    return fronts.rows[fronts.below[s] : fronts.below[s + 1]]


@settings(max_examples=30, deadline=None)
@given(
    n=st.integers(1, 300), per_row=st.floats(0, 5), seed=st.integers(0, 1000), columns=st.integers(1, 5),
    real=st.booleans(),
)  # fmt: skip
def test_solves_like_numpy(n, per_row, seed, columns, real):
    """Diagonally dominant: errors are a few roundings of single precision (6e-8) in a hundred sums."""
    full = random_pattern(n, per_row, seed)
    full = full.real.copy() if real else full
    factor = MultifrontalFactor(upper_of(full), n, np.random.default_rng(seed).permutation(n))
    factor.factorise(upper_of(full).data)
    right = np.random.default_rng(seed).normal(size=(n, columns)) * (1 if real else 1 + 1j)
    exact, found = np.linalg.solve(full, right), factor.solve(right)
    assert found.dtype == exact.dtype
    assert np.abs(found - exact).max() < 1e-5 * np.abs(exact).max()


@settings(max_examples=30, deadline=None)
@given(
    n=st.integers(1, 300), per_row=st.floats(0, 5), seed=st.integers(0, 1000), columns=st.integers(1, 17),
    real=st.booleans(),
)  # fmt: skip
def test_products_by_elimination_alone_are_those_of_numpy(n, per_row, seed, columns, real):
    """B^T A^-1 B without factors; a few roundings of single precision (6e-8) in a hundred sums."""
    full = random_pattern(n, per_row, seed)
    full = full.real.copy() if real else full
    factor = MultifrontalFactor(upper_of(full), n, np.random.default_rng(seed).permutation(n))
    right = np.random.default_rng(seed).normal(size=(n, columns)) * (1 if real else 1 + 1j)
    exact, found = right.T @ np.linalg.solve(full, right), factor.products(upper_of(full).data, right)
    assert np.abs(found - exact).max() < 1e-5 * np.abs(exact).max()
    with pytest.raises(SolverError, match="no factors"):
        factor.solve(right)


@pytest.mark.parametrize("real", [False, True])
@pytest.mark.parametrize("n", [64, 65, 700, 1400])
def test_one_large_front(n, real):
    """Blocks of 64, outer blocks of 512, strips of 256 columns, and what does not fill them."""
    full = random_pattern(n, n, 3)
    full = full.real.copy() if real else full
    factor = MultifrontalFactor(upper_of(full), n, np.arange(n))
    assert len(factor.symbolic.parent) == 1
    factor.factorise(upper_of(full).data)
    right = np.eye(n, 3) + (0 if real else 0j)
    exact = np.linalg.solve(full, right)
    assert np.abs(factor.solve(right) - exact).max() < 1e-5 * np.abs(exact).max()


@pytest.fixture(scope="module")
def model():
    return held_block(4, tissue=flesh(bulk=2.2e9))


@pytest.fixture(scope="module")
def upper(model):
    return model.operator.upper(model.operator.data(OMEGA))


@pytest.fixture(scope="module")
def factor(model, upper):
    order = nested_dissection(upper, model.operator.n_displacements)
    factor = MultifrontalFactor(upper, model.operator.n_displacements, order)
    factor.factorise(upper.data)
    return factor


def left(model, upper, solution, right):
    """What a solution leaves of each right-hand side, relative to it."""
    rest = model.operator.matrix(upper.data).product(solution) - right
    return np.linalg.norm(rest, axis=0) / np.linalg.norm(right, axis=0)


@pytest.mark.needs_mkl
def test_saddle_systems_are_solved_as_well_as_by_pardiso(model, upper, factor):
    """Residuals of point forces on nearly incompressible tissue, both in single precision; scaling is what they need:
    unscaled they are 0.04 on a forearm (decision 0009)."""
    right = model.functionals.astype(complex)
    order = nested_dissection(upper, model.operator.n_displacements)
    theirs = PardisoFactor(upper, order, single=True, matching=False)
    theirs.factorise(upper.data)
    ours = left(model, upper, factor.solve(right), right).max()
    assert ours < 3e-4
    assert ours < 5 * left(model, upper, theirs.solve(right), right).max()


def test_refinement_brings_double_precision(model, upper, factor):
    right = model.functionals.astype(complex)
    assert refined_solve(factor, model.operator.matrix(upper.data), right).residual < 1e-12


def test_new_values_on_the_same_pattern(model, factor):
    right = model.functionals.astype(complex)
    for omega in (2 * OMEGA, OMEGA):
        data = model.operator.data(omega)
        factor.factorise(data)
        assert refined_solve(factor, model.operator.matrix(data), right).residual < 1e-12
    one = right[:, 0]
    whole = factor.solve(right)[:, 0]
    assert np.abs(factor.solve(one) - whole).max() < 1e-5 * np.abs(whole).max()  # sums in another order


def test_real_and_complex_matrices_in_turn_hold_one_set_of_factors(model, factor):
    """At a real rate, at a frequency, and at the rate again: each right, and the real ones in real numbers."""
    weights = rate_weights([t.coefficient for t in model.operator.terms], OMEGA)[0]
    right = model.functionals
    for _ in range(2):
        factor.factorise(model.operator.combine(weights.tolist()))
        matrix = WeightedSum(model.operator.matrices, weights)
        solution = refined_solve(factor, matrix, right)
        assert solution.values.dtype == float
        assert solution.residual < 1e-12
        real = weakref.ref(factor._store.panels)
        half = real().nbytes
        data = model.operator.data(OMEGA)
        factor.factorise(data)
        assert refined_solve(factor, model.operator.matrix(data), right.astype(complex)).residual < 1e-12
        assert real() is None
        assert factor._store.panels.nbytes == 2 * half


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_parts_hold_every_front_once(factor, threads):
    parts = divided(factor.symbolic, threads)
    every = np.concatenate([p.supernodes for p in (*parts.subtrees, parts.top)])
    assert sorted(every) == list(range(len(factor.symbolic.parent)))
    for part in parts.subtrees:  # parents are in the same part or in the top
        above = factor.symbolic.parent[part.supernodes]
        assert np.isin(above, np.concatenate([part.supernodes, parts.top.supernodes, [-1]])).all()
        assert part.end <= parts.top.begin
    work = factor.symbolic.arithmetic
    loads = [work[p.supernodes].sum() for p in parts.subtrees]
    assert max(loads) - min(loads) < 0.05 * work.sum()


@pytest.mark.parametrize("threads", [1, 3])
def test_any_number_of_threads_gives_the_same(model, upper, factor, threads, monkeypatch):
    monkeypatch.setattr(FACTOR + ".divided", lambda symbolic, _: divided(symbolic, threads))
    monkeypatch.setattr(FACTOR + "._MANY_ROWS", 0)
    monkeypatch.setattr(FACTOR + ".thread_count", lambda: threads)
    order = nested_dissection(upper, model.operator.n_displacements)
    other = MultifrontalFactor(upper, model.operator.n_displacements, order)
    other.factorise(upper.data)
    factor.factorise(upper.data)
    right = model.functionals.astype(complex)
    one, two = factor.solve(right), other.solve(right)
    assert np.abs(one - two).max() < 1e-3 * np.abs(two).max()  # residuals of 1e-4
    products = other.products(upper.data, right)
    assert np.abs(products - right.T @ one).max() < 1e-3 * np.abs(products).max()
    room = passing_store(other.symbolic, other._parts, np.complex64)
    assert room.panels.size < 0.5 * other.symbolic.panel_entries.sum()


def test_scales_leave_a_diagonal_of_one_and_couplings_of_a_third(model, upper):
    n_displacements = model.operator.n_displacements
    scale = scales(upper.indptr, upper.indices, upper.data, n_displacements)
    full = abs(model.operator.matrix(upper.data).half)
    scaled = csr_array(full.multiply(scale[:, None]).multiply(scale[None, :]))
    assert scaled.diagonal()[:n_displacements] == pytest.approx(0.5, rel=1e-12)  # half of the diagonal is stored
    coupling = scaled[:n_displacements, n_displacements:].max(axis=0).toarray()
    assert coupling == pytest.approx(0.3, rel=1e-12)


def test_unknowns_without_entries_keep_their_scale():
    upper = upper_of(np.diag([0.0, 4.0, 2.0]) + 0j)
    upper = csr_array((np.array([0, 4, 2]) + 0j, [0, 1, 2], [0, 1, 2, 3]), shape=(3, 3))
    assert list(scales(upper.indptr, upper.indices, upper.data, 2)) == [1.0, 0.5, 1.0]


def test_singular_blocks_are_a_named_error():
    upper = csr_array((np.array([0, 4]) + 0j, [0, 1], [0, 1, 2]), shape=(2, 2))
    factor = MultifrontalFactor(upper, 2, np.arange(2))
    factor.factorise(upper.data)
    with pytest.raises(SolverError, match="singular"):
        factor.solve(np.ones((2, 1)) + 0j)
    factor.factorise(np.array([1, 4]) + 0j)
    assert factor.solve(np.ones((2, 1)) + 0j)[:, 0] == pytest.approx([1, 0.25])


def test_nothing_is_solved_before_factorising_or_after_release(upper):
    factor = MultifrontalFactor(upper, upper.shape[0], np.arange(upper.shape[0]))
    with pytest.raises(SolverError, match="factorise before"):
        factor.solve(np.ones(upper.shape[0]) + 0j)
    assert not factor.harden(upper.data)


@pytest.mark.needs_mkl
def test_the_sweep_takes_it_and_pardiso_comes_after_it(model, monkeypatch, caplog):
    """Factors that lose half of each solution: first PARDISO with matching, whose solutions are right."""
    solver = make_solver(model, ReducedSolve(), 100.0)
    assert isinstance(solver.factor, FallbackFactor)
    good = solver.compliance(solver.at(100.0))
    assert isinstance(solver.factor.now, MultifrontalFactor)
    right = MultifrontalFactor.solve
    monkeypatch.setattr(MultifrontalFactor, "solve", lambda self, b: 0.5 * right(self, b))
    mended = solver.compliance(solver.at(100.0))
    assert isinstance(solver.factor.now, PardisoFactor)
    assert "matching" in caplog.text
    assert np.abs(mended - good).max() < 1e-8 * np.abs(good).max()  # both refined to 1e-9
    assert solver.factor.harden(model.operator.data(200 * np.pi))
    assert not solver.factor.single


def test_chosen_for_large_systems_in_single_precision(model, monkeypatch):
    def kind(backend="auto", **how):
        return type(make_factor(model.operator, OMEGA, backend, **how)).__name__

    assert kind(single=True, matching=False) == kind("multifrontal", single=True, matching=False) == "FallbackFactor"
    if mkl_library() is not None:
        assert kind(single=True) == kind(single=False) == "PardisoFactor"
        assert kind("pardiso", single=True, matching=False) == "PardisoFactor"
    with pytest.raises(SolverError, match="single precision"):
        kind("multifrontal", single=False)
    monkeypatch.setattr(factors, "_compiles", lambda: False)
    assert "multifrontal" not in factors.available_backends()
    with pytest.raises(SolverError, match="numba"):
        kind("multifrontal", single=True, matching=False)


def test_without_mkl_there_is_nothing_after_it(model, monkeypatch):
    monkeypatch.setattr(factors.pardiso, "mkl_library", lambda: None)
    assert factors.available_backends() == ("multifrontal", "superlu")
    solver = make_factor(model.operator, OMEGA, "auto", single=True, matching=False)
    assert isinstance(solver, FallbackFactor)
    assert not solver.harden(model.operator.data(OMEGA))
    small = make_factor(held_block(1, tissue=flesh(bulk=2.2e9)).operator, OMEGA, "auto", single=True, matching=False)
    assert isinstance(small, FallbackFactor)


@cache
def from_python(inner):
    """A kernel that only kernels may call, with an entry for Python."""
    return numba.njit(lambda *given: inner(*given))


def test_products_are_openblas_own_or_those_of_scipy(monkeypatch):
    """Whichever is taken, C -= A B^T comes out to a few roundings of single precision (6e-8) in 70 sums."""
    random = np.random.default_rng(0)
    a, b = (
        np.asfortranarray(random.normal(size=(s, 70)) + 1j * random.normal(size=(s, 70)), np.complex64)
        for s in (90, 40)
    )
    c = np.zeros((90, 40), np.complex64, order="F")
    from_python(blas.subtract_product)(
        blas.arguments(np.complex64),
        (*c.shape, 70),
        a.ctypes.data,
        90,
        b.ctypes.data,
        40,
        c.ctypes.data,
        90,
        blas.SECOND,
    )
    exact = -a.astype(complex) @ b.T
    assert np.abs(c - exact).max() < 1e-6 * np.abs(exact).max()
    monkeypatch.setattr(blas, "threadpool_info", list)
    assert blas.product_address() == get_cython_function_address("scipy.linalg.cython_blas", "cgemm")


def grid(side: int) -> np.ndarray:
    """A dense matrix with the pattern of five points on a square grid of this side, complex symmetric, dominant."""
    random = np.random.default_rng(side)
    number = np.arange(side**2).reshape(side, side)
    full = np.zeros((side**2, side**2), complex)
    for one, other in ((number[1:], number[:-1]), (number[:, 1:], number[:, :-1])):
        full[one.ravel(), other.ravel()] = random.normal(size=one.size) + 1j * random.normal(size=one.size)
    full += full.T
    return full + np.diag(1 + np.abs(full).sum(axis=0)) * (1 + 0.2j)


def dissected(rows: np.ndarray) -> list[int]:
    """Points of a grid in the order of geometric nested dissection: halves, then what lies between them."""
    if min(rows.shape) <= 2:
        return list(rows.ravel())
    if rows.shape[0] < rows.shape[1]:
        rows = rows.T
    middle = len(rows) // 2
    return [*dissected(rows[:middle]), *dissected(rows[middle + 1 :]), *rows[middle]]


@pytest.mark.parametrize("threads", [1, 2])
def test_a_deep_tree_of_fronts(threads, monkeypatch):
    """Remainders are stacked and moved many times: ten levels, where random patterns have two or three."""
    monkeypatch.setattr(FACTOR + ".divided", lambda symbolic, _: divided(symbolic, threads))
    monkeypatch.setattr(FACTOR + "._MANY_ROWS", 0)
    monkeypatch.setattr(FACTOR + ".thread_count", lambda: threads)
    full, order = grid(48), np.array(dissected(np.arange(48**2).reshape(48, 48)))
    factor = MultifrontalFactor(upper_of(full), len(full), order)
    assert depth(factor.symbolic.parent) >= 8
    factor.factorise(upper_of(full).data)
    right = np.random.default_rng(0).normal(size=(len(full), 3)) + 0j
    exact = np.linalg.solve(full, right)
    assert np.abs(factor.solve(right) - exact).max() < 1e-5 * np.abs(exact).max()


def depth(parent: np.ndarray) -> int:
    """Levels of a forest whose parents come after their children."""
    level = np.ones(len(parent), int)
    for s in range(len(parent) - 1, -1, -1):
        if parent[s] >= 0:
            level[s] = level[parent[s]] + 1
    return int(level.max())


@settings(max_examples=40, deadline=None)
@given(rows=st.integers(0, 1100), columns=st.integers(1, 70), width=st.integers(1, 3), real=st.booleans())
def test_panels_are_multiplied_as_by_numpy(rows, columns, width, real):
    """Tiles of 256 or 512 rows, eight columns at a time and single ones; ``width`` vectors of three."""
    random, number = np.random.default_rng(rows), np.float32 if real else np.complex64
    size, wide = np.dtype(number).itemsize, np.float64 if real else np.complex128

    def values(*shape):
        return (random.normal(size=shape) + (0 if real else 1j * random.normal(size=shape))).astype(number)

    panel, below, own = np.asfortranarray(values(rows + 5, columns)), values(rows + 1, 24), values(columns, 24)
    part, some = panel[:rows].astype(wide), slice(0, 8 * width)
    leading, row, taken = size * (rows + 5), size * 24, size * 8 * width
    exact_below, exact_own = below.astype(wide), own.astype(wide)
    exact_below[:rows, some] -= part @ own[:, some]
    from_python(panels.subtract_panel)(
        size, rows, columns, panel.ctypes.data, leading, own.ctypes.data, below.ctypes.data, row, taken
    )
    assert np.abs(below - exact_below).max() < 1e-5 * np.abs(exact_below).max()  # roundings of 6e-8 in 70 sums
    exact_own[:, some] -= part.T @ below[:rows, some]
    from_python(panels.subtract_panel_transposed)(
        size, rows, columns, panel.ctypes.data, leading, below.ctypes.data, own.ctypes.data, row, taken
    )
    assert np.abs(own - exact_own).max() < 1e-5 * np.abs(exact_own).max()


@pytest.mark.parametrize(("kernel", "columns"), [(panels.gather_eight, 8), (panels.gather_two, 2)])
def test_kernels_of_either_kind_of_processor_gather_as_numpy_does(kernel, columns):
    """Only one of them is taken by the processor that runs this; leading dimensions are longer than what is read."""
    random, rows = np.random.default_rng(columns), 37
    panel, below, own = (
        (random.normal(size=shape) + 1j * random.normal(size=shape)).astype(np.complex64)
        for shape in ((columns, rows + 3), (rows, 8), (columns, 8))
    )
    exact = own - panel[:, :rows].astype(complex) @ below
    kernel(rows, panel.ctypes.data, 8 * (rows + 3), below.ctypes.data, own.ctypes.data, 64)
    assert np.abs(own - exact).max() < 1e-5 * np.abs(exact).max()  # roundings of 6e-8 in 37 sums
