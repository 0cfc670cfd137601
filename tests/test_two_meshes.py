"""The estimate from two meshes: its rule by itself; against true errors it is tested in verification and benchmarks."""

from __future__ import annotations

import numpy as np
import pytest

from forearm_fem.pipeline.two_meshes import COARSER, estimated_errors, remaining_error


def test_order_two_where_resolved_and_three_where_not():
    assert remaining_error(np.array([0.03, 0.15])) == pytest.approx([0.01, 0.05])
    assert remaining_error(np.array([0.5, 2.1])) == pytest.approx([0.5 / 7, 0.3])


def test_a_larger_change_never_states_a_smaller_error():
    """Between the two rules the order rises; the estimate must not fall on the way (to 1e-3 of its size)."""
    stated = remaining_error(np.linspace(0.0, 2.0, 2001))
    assert np.diff(stated).min() > -1e-3 * stated.max()


def test_exact_for_an_error_of_second_order():
    """G_h = G + c h^2 on sizes h and COARSER h."""
    rng = np.random.default_rng(1)
    truth, c = (rng.normal(size=(5, 9, 4)) + 1j * rng.normal(size=(5, 9, 4)) for _ in range(2))
    fine, coarse = truth + 1e-3 * c, truth + 1e-3 * COARSER**2 * c
    band, error = estimated_errors(coarse, fine)
    assert band == pytest.approx(np.linalg.norm(fine - truth) / np.linalg.norm(fine))
    assert error == pytest.approx(np.abs(fine - truth).max((1, 2)) / np.abs(fine).max((1, 2)))
