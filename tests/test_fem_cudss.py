"""cuDSS: its back end with a stand-in for the library, and on a device where there is one."""

from __future__ import annotations

import sys
from types import SimpleNamespace

import alternatives as slow
import numpy as np
import pytest
import stand_in_nvmath
from scenes import sampled

from forearm_fem.errors import SolverError
from forearm_fem.fem.linear import cudss
from forearm_fem.fem.linear import factor as factors
from forearm_fem.fem.linear.cudss import CudssFactor
from forearm_fem.fem.linear.factor import make_factor, refined_solve
from forearm_fem.fem.reduction.sweep import direct_sweep, reduced_sweep
from forearm_fem.scenario.sweep import DirectSolve, ReducedSolve
from forearm_fem.transfer import relative_error
from forearm_fem.verification.scenes import held_block

OMEGA = 2 * np.pi * 150.0


@pytest.fixture(scope="module")
def model():
    return held_block(2)


@pytest.fixture(params=["stand-in", "device"])
def library(request, monkeypatch):
    """The stand-in, and the library itself where it can run."""
    if request.param == "device":
        if not cudss.available():
            pytest.skip("no CUDA device; where there is one, `python3 -m pip install '.[cudss]'`")
        return
    for name, module in stand_in_nvmath.modules().items():
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.setattr(cudss, "device_count", lambda: 1)


def columns(model, count, kind=complex):
    rng = np.random.default_rng(count)
    real = rng.normal(size=(model.operator.n, count))
    return real if kind is float else real + 1j * rng.normal(size=real.shape)


@pytest.mark.usefixtures("library")
@pytest.mark.parametrize("single", [False, True])
@pytest.mark.parametrize("count", sampled([37, 1, 16], 3))
def test_as_dense_solutions(model, single, count):
    """More right-hand sides than were planned for go in pieces; single precision is refined."""
    data, right = model.operator.data(OMEGA), columns(model, count)
    solver = make_factor(model.operator, OMEGA, "cudss", single=single, matching=not single)
    assert (solver.name, solver.single) == ("cudss", single)
    solver.factorise(data)
    found = refined_solve(solver, model.operator.matrix(data), right).values
    exact = np.linalg.solve(slow.dense(model.operator, OMEGA), right)
    assert np.abs(found - exact).max() < 1e-8 * np.abs(exact).max()  # condition 1e6 times rounding
    solver.release()


@pytest.mark.usefixtures("library")
def test_real_matrices_have_real_solutions(model):
    """At a real rate s = i omega the operator is real."""
    data, right = model.operator.data(OMEGA).real, columns(model, 5, float)
    solver = CudssFactor(model.operator.upper(data + 0j))
    solver.factorise(data)
    found = solver.solve(right)
    full = slow.dense(model.operator, OMEGA).real
    assert found.dtype == float
    assert np.abs(full @ found - right).max() < 1e-8 * np.abs(right).max()


@pytest.mark.usefixtures("library")
def test_hardened_to_double_precision_once(model):
    data, right = model.operator.data(OMEGA), columns(model, 3)
    solver = CudssFactor(model.operator.upper(data), single=True)
    solver.factorise(data)

    def residual():
        return np.abs(right - model.operator.multiply(data, solver.solve(right))).max()

    before = residual()
    assert solver.harden(data)
    assert residual() < 1e-4 * before
    assert not solver.harden(data)


@pytest.mark.usefixtures("library")
def test_sweeps_on_it_equal_others(model):
    band = np.linspace(50.0, 400.0, 36)
    exact = direct_sweep(model, band[::7], ReducedSolve()).values
    for how in ("direct", "reduced"):
        options = (DirectSolve if how == "direct" else ReducedSolve)(backend="cudss")
        sweep = direct_sweep if how == "direct" else reduced_sweep
        found = sweep(model, band, options)
        assert found.solver == "cudss"
        assert relative_error(found.values[::7], exact).max() < (1e-8 if how == "direct" else 1e-4)  # 1e-4 is asked


def test_what_the_library_raises_is_a_named_error(model, monkeypatch):
    for name, module in stand_in_nvmath.modules().items():
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.setattr(cudss, "device_count", lambda: 1)
    solver = CudssFactor(model.operator.upper(model.operator.data(OMEGA)))
    with pytest.raises(SolverError, match=r"^cuDSS: not before factorize; set solver\.backend = 'auto'"):
        solver.solve(columns(model, 1))
    solver.release()
    with pytest.raises(SolverError, match="cuDSS: not before new"):
        solver.factorise(model.operator.data(OMEGA))


def test_what_is_missing_is_named(monkeypatch):
    monkeypatch.setattr(cudss, "device_count", lambda: 0)
    for name in ("nvmath", "nvmath.sparse", "nvmath.sparse.advanced"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.setattr(cudss.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(SolverError, match=r"forearm-fem\[cudss\]"):
        factors.choose_backend("cudss", 100)
    monkeypatch.setattr(cudss.importlib.util, "find_spec", lambda name: object())
    with pytest.raises(SolverError, match="no CUDA device was found"):
        factors.choose_backend("cudss", 100)
    assert "cudss" not in factors.available_backends()


def test_plans_in_threads_where_the_wheel_brings_them(tmp_path, monkeypatch):
    """Without the file the library plans with one thread, and says so."""
    wheel = SimpleNamespace(submodule_search_locations=[str(tmp_path)])
    monkeypatch.setattr(cudss.importlib.util, "find_spec", lambda name: wheel if name == "nvidia" else None)
    assert cudss._threading_layer() is None
    layer = tmp_path / "cu13" / "lib" / "libcudss_mtlayer_gomp.so.0"
    layer.parent.mkdir(parents=True)
    layer.touch()
    assert cudss._threading_layer() == str(layer)
    monkeypatch.setattr(cudss.importlib.util, "find_spec", lambda name: None)
    assert cudss._threading_layer() is None


@pytest.mark.usefixtures("library")
def test_only_where_it_is_asked_for():
    assert "cudss" in factors.available_backends()
    assert factors.choose_backend("auto", 100) != "cudss"
    assert factors.choose_backend("cudss", 10**6) == "cudss"
