"""Orders of convergence for manufactured complex solutions, for every element and bulk modulus."""

from __future__ import annotations

import math

import numpy as np
import pytest
from manufactured import OMEGA, manufactured_errors, orders, waves

from forearm_fem.tissue import KelvinVoigt, Tissue

MESHES = {"P1": [8, 12], "P2": [5, 8], "P3": [3, 5]}
THEORY = {"P1": (2, 1, 1), "P2": (3, 2, 2), "P3": (4, 3, 3)}  # u in L2, u in H1, p in L2


EVERY = [(e, b) for e in ("P1", "P2", "P3") for b in (1e4, 2.2e9, math.inf)]
QUICK = {("P1", 2.2e9), ("P2", 1e4), ("P2", math.inf), ("P3", math.inf)}


@pytest.mark.parametrize(
    ("element", "bulk"), [c if c in QUICK else pytest.param(*c, marks=pytest.mark.slow) for c in EVERY]
)
def test_orders_are_those_of_theory(element, bulk):
    errors = [manufactured_errors(element, n, bulk) for n in MESHES[element]]
    l2, h1, pressure = orders(errors, MESHES[element])
    expected = THEORY[element]
    assert l2 == pytest.approx(expected[0], abs=0.15)
    assert h1 == pytest.approx(expected[1], abs=0.15)
    if element == "P1":
        assert pressure > 1 - 0.15  # MINI: at least one, up to 3/2 on such meshes
    else:
        assert pressure == pytest.approx(expected[2], abs=0.15)


@pytest.mark.parametrize("element", ["P2", "P3"])
def test_error_constant_does_not_depend_on_the_bulk_modulus(element):
    """No locking: 1e6 Pa to infinity within 2 %; the solution itself moves by mu/kappa, 1e4 Pa is not compared."""
    n = MESHES[element][0]
    errors = [manufactured_errors(element, n, bulk) for bulk in (1e6, 1e8, 1e10, 1e12, math.inf)]
    for name in ("l2", "h1", "pressure"):
        values = np.array([getattr(e, name) for e in errors])
        assert np.ptp(values) < 0.02 * values.max()


@pytest.mark.parametrize("element", ["P2", pytest.param("P3", marks=pytest.mark.slow)])
def test_orders_with_a_modulus_jump_of_twenty(element):
    """Two tissues: the pressure is torn at the interface, so the rates survive."""
    counts = [4, 8] if element == "P2" else [4, 6]
    errors = [manufactured_errors(element, n, 2.2e9, jump=20.0) for n in counts]
    l2, h1, pressure = orders(errors, counts)
    expected = THEORY[element]
    assert h1 == pytest.approx(expected[1], abs=0.15)
    assert l2 > expected[0] - 0.2  # the stiff half pulls the soft half's error along: not yet asymptotic
    assert pressure > expected[2] - 0.2


def test_manufactured_force_balances_stress_and_inertia():
    """The closed-form body force against central differences of the stress (step 1e-6 m, error h^2)."""
    tissue, exact, h = Tissue("t", 1050.0, KelvinVoigt(6e3, 4.0), 1e5), waves(), 1e-6
    x = np.array([[0.011], [0.004], [0.017]])
    force = -tissue.density * OMEGA**2 * exact.displacement(x, tissue.bulk)
    for j in range(3):
        step = h * np.eye(3)[j][:, None]
        force -= (exact.stress(x + step, tissue)[:, j] - exact.stress(x - step, tissue)[:, j]) / (2 * h)
    assert force == pytest.approx(exact.body_force(x, tissue), rel=1e-6)


def test_manufactured_pressure_is_the_constitutive_one():
    exact, x = waves(), np.array([[0.011], [0.004], [0.017]])
    squeeze = -1e5 * np.trace(exact.gradient(x, 1e5))
    assert squeeze == pytest.approx(exact.pressure(x), rel=1e-10)


def test_manufactured_solution_is_held_on_the_face():
    exact, y = waves(), np.linspace(0, 0.02, 7)
    assert np.abs(exact.displacement(np.array([0 * y, y, y[::-1]]), 1e4)).max() < 1e-12
