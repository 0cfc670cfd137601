"""Products of the operator's matrices with columns in compiled code, against scipy and dense sums."""

from itertools import pairwise

import alternatives as slow
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csr_array, random_array, triu

from forearm_fem.fem.assembly import operator as operators
from forearm_fem.fem.assembly import tissues as assembly
from forearm_fem.fem.assembly.coefficients import Polynomial
from forearm_fem.fem.assembly.operator import affine_operator
from forearm_fem.fem.kernels import matrices as kept
from forearm_fem.fem.kernels import matrices as sparse
from forearm_fem.fem.kernels.matrices import SymmetricMatrices
from forearm_fem.fem.linear import factor as factors
from forearm_fem.fem.reduction import basis as bases
from forearm_fem.fem.reduction.sweep import reduced_sweep
from forearm_fem.scenario.sweep import ReducedSolve
from forearm_fem.verification.scenes import flesh, held_block

COMPILED = kept.compiled("kernels.products") is not None
needs_numba = pytest.mark.skipif(not COMPILED, reason="numba is not installed")


def uppers(n: int, count: int, density: float, seed: int = 0) -> list[csr_array]:
    """Upper triangles in CSR, columns ascending; the last is empty but for one entry."""
    random = np.random.default_rng(seed)
    parts = [csr_array(triu(random_array((n, n), density=density, rng=random))) for _ in range(count)]
    parts.append(csr_array(([2.0], ([n // 3], [n // 2])), shape=(n, n)))
    for part in parts:
        part.sort_indices()
    return parts


def whole(upper: csr_array) -> np.ndarray:
    dense = upper.toarray()
    return dense + dense.T - np.diag(np.diag(dense))


def random_columns(n: int, k: int) -> np.ndarray:
    random = np.random.default_rng(k)
    return random.normal(size=(n, k)) + 1j * random.normal(size=(n, k))


@needs_numba
@settings(max_examples=60, deadline=None)
@given(n=st.integers(1, 40), k=st.integers(1, 40), density=st.floats(0, 0.4), outputs=st.integers(1, 3))
def test_weighted_sums_are_those_of_dense_matrices(n, k, density, outputs):
    """Any width: four vectors of eight doubles at a time, single ones, and a last one that overlaps them."""
    given_, x = uppers(n, 2, density), random_columns(n, k)
    weights = random_columns(outputs, len(given_))
    weights[0, 1] = 0
    totals = [random_columns(n, k) for _ in range(outputs)]
    exact = [
        total + np.tensordot(row, [whole(u) @ x for u in given_], 1) for total, row in zip(totals, weights, strict=True)
    ]
    SymmetricMatrices.from_uppers(given_).add_products_in_place(totals, weights, x)
    for found, right in zip(totals, exact, strict=True):
        assert np.abs(found - right).max() < 1e-13 * max(np.abs(right).max(), 1)  # rounding of 40 terms


@needs_numba
@settings(max_examples=60, deadline=None)
@given(
    n=st.integers(1, 40), k=st.integers(1, 70), density=st.floats(0, 0.4), number=st.sampled_from([np.float32, float])
)
def test_real_products_are_those_of_dense_matrices(n, k, density, number):
    """Any rows, of any width; columns in single precision are multiplied in double."""
    given_, x = uppers(n, 1, density), random_columns(n, k).real.astype(number)
    matrices = SymmetricMatrices.from_uppers(given_)
    product = matrices.products(x)
    for rows in (slice(0, n), slice(n // 3, n // 2 + 1)):
        exact = [(whole(upper) @ x.astype(float))[rows] for upper in given_]
        assert matrices.touching(rows) == [t for t, upper in enumerate(given_) if whole(upper)[rows].any()]
        for t, right in enumerate(exact):
            assert np.abs(product(t, rows) - right).max(initial=0) < 1e-13 * np.abs(x).max() * 40


@settings(max_examples=60, deadline=None)
@given(
    n=st.integers(1, 40), k=st.integers(1, 40), density=st.floats(0, 0.4), count=st.integers(1, 3), fast=st.booleans(),
    number=st.sampled_from([np.float32, np.float64]), together=st.booleans()
)  # fmt: skip
def test_real_sums_are_those_of_dense_matrices(n, k, density, count, fast, number, together):
    """Of columns wherever they lie, side by side or apart; those in single precision are multiplied in double."""
    given_, columns = uppers(n, 2, density), [random_columns(n, k + 2 * j).real[:, :k] for j in range(count)]
    columns = [x.astype(number) for x in columns]
    columns = np.hsplit(np.hstack(columns), count) if together else columns
    weights = random_columns(count, len(given_)).real
    weights[0, 1] = 0
    exact = sum(
        w * whole(u) @ x.astype(float)
        for x, row in zip(columns, weights, strict=True)
        for u, w in zip(given_, row, strict=True)
    )
    with pytest.MonkeyPatch.context() as patch:
        if not fast:
            patch.setattr(kept, "compiled", lambda _: None)
        found = SymmetricMatrices.from_uppers(given_).real_sum(weights, columns)
    assert found.shape == (n, k)
    assert np.abs(found - exact).max() < 1e-13 * max(np.abs(exact).max(), 1)


@pytest.mark.parametrize("width", [1, 5, 13])
def test_threads_and_scipy_give_the_same(width, monkeypatch):
    """More than 100 000 entries are shared by threads; without numba scipy serves."""
    given_ = uppers(20_000, 2, 5e-4)
    weights, x = random_columns(2, 3), random_columns(20_000, width)

    def found():
        matrices, totals = SymmetricMatrices.from_uppers(given_), [np.zeros((20_000, width), complex) for _ in range(2)]
        matrices.add_products_in_place(totals, weights, x)
        return (
            np.array(totals),
            matrices.products(x.real)(0, slice(7, 19_990)),
            matrices.real_sum(weights.real, [x.real, x.imag]),
        )

    threaded, *real = found()
    monkeypatch.setattr(kept, "_LARGE", 10**9)
    alone, *real_alone = found()
    assert np.array_equal(threaded, alone)
    for one, other in zip(real, real_alone, strict=True):
        assert np.array_equal(one, other)
    monkeypatch.setattr(kept, "compiled", lambda _: None)
    by_scipy, *real_by_scipy = found()
    assert np.abs(by_scipy - alone).max() < 1e-13 * np.abs(alone).max()
    for one, other in zip(real_by_scipy, real, strict=True):
        assert np.abs(one - other).max() < 1e-13 * np.abs(other).max()


def test_terms_add_up_to_the_operator():
    operator = held_block(2).operator
    x = random_columns(operator.n, 3)
    for omega in (0.3, 300.0, 20_000.0):
        exact = slow.dense(operator, omega) @ x
        assert np.abs(operator.at(omega).product(x) - exact).max() < 1e-13 * np.abs(exact).max()


def test_a_sweep_without_compiled_code_is_the_same(monkeypatch):
    """Assembly, derivatives, projections and factors by scipy and MKL or SuperLU; solves are refined to 1e-9."""

    def sweep():
        return reduced_sweep(held_block(2, tissue=flesh(bulk=2.2e9)), np.linspace(50, 150, 11), ReducedSolve()).values

    fast = sweep()
    for module in (kept, bases, operators, assembly, sparse):
        monkeypatch.setattr(module, "compiled", lambda _: None)
    monkeypatch.setattr(factors, "_compiles", lambda: False)
    plain = sweep()
    assert np.nanmax(np.abs(plain - fast)) < 1e-7 * np.nanmax(np.abs(fast))


def test_matrices_are_given_back_to_scipy_as_they_came():
    given_ = uppers(30, 2, 0.2)
    matrices = SymmetricMatrices.from_uppers(given_)
    for t, upper in enumerate(given_):
        assert np.array_equal(matrices.one(t).toarray(), whole(upper))
        assert matrices.one(t).has_sorted_indices


@needs_numba
@settings(max_examples=40, deadline=None)
@given(n=st.integers(1, 30), count=st.integers(1, 4), density=st.floats(0, 0.5), seed=st.integers(0, 99))
def test_operators_are_put_together_as_by_scipy(n, count, density, seed):
    """Columns in any order, stored zeros, empty rows: pattern, matrices and sums are the same."""
    random = np.random.default_rng(seed)
    given_ = []
    for part in uppers(n, count, density, seed):
        full = csr_array(part + part.T)
        full.data[random.random(full.nnz) < 0.1] = 0
        given_.append(("term", shuffled(full, random), Polynomial(constant=2.0, rate=0.1)))
    fast = affine_operator(given_, n, 1.0)
    with pytest.MonkeyPatch.context() as patch:
        for module in (operators, kept):
            patch.setattr(module, "compiled", lambda _: None)
        plain = affine_operator(given_, n, 1.0)
        values = plain.data(3.0)
    assert np.array_equal(fast.indptr, plain.indptr)
    assert np.array_equal(fast.indices, plain.indices)
    assert np.abs(fast.data(3.0) - values).max() < 1e-15 * max(np.abs(values).max(), 1)  # a fused multiply-add
    for one, other in zip(fast.terms, plain.terms, strict=True):
        assert np.array_equal(fast.term_matrix(one).toarray(), plain.term_matrix(other).toarray())


def shuffled(matrix: csr_array, random: np.random.Generator) -> csr_array:
    """The same matrix with the entries of each row in another order."""
    order = np.concatenate(
        [np.empty(0, int), *(random.permutation(np.arange(a, b)) for a, b in pairwise(matrix.indptr))]
    )
    return csr_array((matrix.data[order], matrix.indices[order], matrix.indptr), shape=matrix.shape)


def test_other_shapes_are_refused():
    matrices = SymmetricMatrices.from_uppers(uppers(30, 1, 0.2))
    with pytest.raises(ValueError, match="30 columns were given arrays of \\(29, 2\\)"):
        matrices.products(np.zeros((29, 2)))
    with pytest.raises(ValueError, match="arrays of \\(30, 2\\) and \\(30, 1\\)"):
        matrices.add_products_in_place([np.zeros((30, 1), complex)], np.ones((1, 2)), np.zeros((30, 2), complex))
    with pytest.raises(ValueError, match="arrays of \\(30, 2\\) and \\(30, 1\\)"):
        matrices.real_sum(np.ones((2, 2)), [np.zeros((30, 2)), np.zeros((30, 1))])
