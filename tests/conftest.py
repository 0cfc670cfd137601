"""Two workers share two cores: each computes with one thread, unless told otherwise. What needs MKL says so."""

import os

import pytest

if "PYTEST_XDIST_WORKER" in os.environ:
    for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
        os.environ.setdefault(name, "1")


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip what is marked ``needs_mkl`` without MKL: SuperLU serves in its place, which is for small systems only."""
    from forearm_fem.fem.linear.pardiso import mkl_library

    if item.get_closest_marker("needs_mkl") and mkl_library() is None:
        pytest.skip("MKL is not installed, or off: SuperLU would take minutes or refuse")
