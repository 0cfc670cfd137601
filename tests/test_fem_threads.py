"""Work in threads: results, and BLAS' libraries searched for once."""

from __future__ import annotations

import sys
from types import ModuleType

import pytest
import scipy.linalg  # noqa: F401  (it brings a BLAS, as NumPy does)
from threadpoolctl import ThreadpoolController, threadpool_info, threadpool_limits

from forearm_fem.fem.kernels import compiled as threads


def blas_threads() -> list[int]:
    """Of NumPy's and SciPy's libraries; MKL, loaded for PARDISO by other tests, is not called in threads."""
    return [pool["num_threads"] for pool in threadpool_info() if pool["internal_api"] == "openblas"]


def test_as_many_threads_as_blas_may_use() -> None:
    for count in (1, 2):
        with threadpool_limits(count, user_api="blas"):
            assert threads.thread_count() == max(blas_threads())


def test_results_come_in_order_and_blas_has_one_thread_meanwhile() -> None:
    with threadpool_limits(2, user_api="blas"):
        before = blas_threads()
        found = threads.in_threads(lambda k: (k, max(blas_threads())), range(5))
        assert [k for k, _ in found] == [0, 1, 2, 3, 4]
        assert {during for _, during in found} == {1}
        assert blas_threads() == before


def test_libraries_are_searched_for_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each search reads the process' table of memory; half of a small scene's time went there, and where pictures are
    loaded beside a solve, each module was another reason to search."""
    searches = []

    def searched() -> ThreadpoolController:
        searches.append(1)
        return ThreadpoolController()

    monkeypatch.setattr(threads, "ThreadpoolController", searched)
    threads._blas.cache_clear()
    for k in range(3):
        monkeypatch.setitem(sys.modules, f"module {k}", ModuleType("one"))
        assert threads.in_threads(abs, [1, -2, 3]) == [1, 2, 3]
    assert len(searches) == 1
