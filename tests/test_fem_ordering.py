"""Order of elimination: a permutation by nodes, no more fill than PARDISO's own, the same solutions."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest
from scipy.sparse import csc_array, csr_array

from forearm_fem.fem.kernels.compiled import compiled
from forearm_fem.fem.linear import factor as ordering
from forearm_fem.fem.linear.factor import alike, nested_dissection
from forearm_fem.fem.linear.pardiso import PardisoFactor
from forearm_fem.verification.scenes import flesh, held_block

pytestmark = pytest.mark.skipif(importlib.util.find_spec("pymetis") is None, reason="pymetis is not installed")
OMEGA = 2 * np.pi * 150.0


@pytest.fixture(scope="module", params=["P2", pytest.param("P3", marks=pytest.mark.slow)])
def model(request):
    return held_block(3, element=request.param, tissue=flesh(bulk=2.2e9))


@pytest.fixture(scope="module")
def upper(model):
    return model.operator.upper(model.operator.data(OMEGA))


def test_unknowns_of_one_node_are_those_with_the_same_neighbours(upper):
    """Against sets of neighbours."""
    ones = csr_array((np.ones(upper.nnz), upper.indices, upper.indptr), shape=upper.shape)  # sums would drop zeros
    node, full = alike(upper), (ones + ones.T).tocsr()
    full.sort_indices()
    names = {}
    for row in range(0, upper.shape[0], 7):
        neighbours = full.indices[full.indptr[row] : full.indptr[row + 1]].tobytes()
        assert names.setdefault(neighbours, node[row]) == node[row]
    assert len(set(names.values())) == len(names)
    assert node.max() + 1 < 0.7 * len(node)


@pytest.mark.skipif(compiled("kernels.scatter") is None, reason="numba is not installed, and scipy drops zeros")
def test_zeros_do_not_part_the_unknowns_of_a_node(model, upper):
    """On a regular block many entries are exactly zero; without them METIS would have twice as many nodes to order."""
    columns = csc_array(model.constraints.transform)
    node = columns.indices[columns.indptr[:-1]] // 3
    pairs = np.column_stack([node, alike(upper)[: len(node)]])
    assert len(np.unique(pairs, axis=0)) == len(np.unique(node))


def test_every_unknown_once_and_nodes_together(model, upper):
    n = model.operator.n_displacements
    order, node = nested_dissection(upper, n), alike(upper)
    assert np.array_equal(np.sort(order), np.arange(model.operator.n))
    displacements = order[order < n]
    assert np.count_nonzero(np.diff(node[displacements])) + 1 == len(np.unique(node[:n]))  # each node is one run


def test_pressures_wait_for_a_quarter_of_their_displacements(model, upper):
    n = model.operator.n_displacements
    place = np.argsort(nested_dissection(upper, n))
    coupling = upper[:n, n:].tocsc()
    for p in range(0, coupling.shape[1], 5):
        coupled = place[coupling.indices[coupling.indptr[p] : coupling.indptr[p + 1]]]
        assert np.mean(coupled < place[n + p]) > 0.25 - 1 / len(coupled)


@pytest.mark.needs_mkl
def test_single_precision_keeps_four_digits(model, upper):
    """Residual 1e-2 where pressures were left where nested dissection puts them (third-order forearm)."""
    load = model.functionals.astype(complex)
    factor = PardisoFactor(upper, nested_dissection(upper, model.operator.n_displacements), single=True, matching=False)
    factor.factorise(upper.data)
    rest = model.operator.matrix(upper.data).product(factor.solve(load)) - load
    assert (np.linalg.norm(rest, axis=0) < 3e-4 * np.linalg.norm(load, axis=0)).all()


def test_the_same_order_each_time(model, upper):
    first, second = (nested_dissection(upper, model.operator.n_displacements) for _ in range(2))
    assert np.array_equal(first, second)


@pytest.mark.needs_mkl
def test_no_more_fill_than_the_solvers_own_and_the_same_solutions(model, upper, monkeypatch):
    """Both in double precision, without matching: they differ by rounding alone. On small blocks METIS gains nothing
    over PARDISO's, and pressures that wait cost 4 %; on a forearm entries are 3 % fewer (decision 0008)."""
    ours = PardisoFactor(upper, nested_dissection(upper, model.operator.n_displacements), matching=False)
    monkeypatch.setattr(ordering, "_SMALL", 10**9)
    own = PardisoFactor(upper, nested_dissection(upper, model.operator.n_displacements), matching=False)
    solutions = []
    for factor in (ours, own):
        factor.factorise(upper.data)
        solutions.append(factor.solve(model.functionals.astype(complex)))
    assert ours.entries < 1.05 * own.entries
    assert np.abs(solutions[0] - solutions[1]).max() < 1e-8 * np.abs(solutions[1]).max()


@pytest.mark.needs_mkl
def test_hardening_gives_the_order_up_for_matching(model, upper):
    factor = PardisoFactor(upper, nested_dissection(upper, model.operator.n_displacements), single=True, matching=False)
    load = model.functionals.astype(complex)
    factor.factorise(upper.data)
    first = factor.solve(load)
    assert factor.harden(upper.data)
    assert factor.harden(upper.data)
    assert not factor.single
    # single precision against double
    assert np.abs(factor.solve(load) - first).max() < 1e-3 * np.abs(first).max()


@pytest.mark.needs_mkl
def test_without_metis_the_solver_orders_itself(model, upper, monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert nested_dissection(upper, model.operator.n_displacements) is None
    factor = PardisoFactor(upper, nested_dissection(upper, model.operator.n_displacements), matching=False)
    factor.factorise(upper.data)
    x = factor.solve(model.functionals.astype(complex))
    assert np.abs(model.operator.matrix(upper.data).product(x) - model.functionals).max() < 1e-6
