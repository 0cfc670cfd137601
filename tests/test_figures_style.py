"""Widths of a journal, legends, and what the pictures of a target must show."""

import numpy as np
import pytest
from matplotlib.figure import Figure

from forearm_fem.show.style import _behind, clear_legends
from forearm_fem.show.targets import moments

pytestmark = pytest.mark.drawn


def test_a_legend_hides_no_curve():
    """Room is made above the curves, on both kinds of scale."""
    figure = Figure(figsize=(3, 2), layout="constrained")
    for ax, scale in zip(figure.subplots(1, 2), ("linear", "log"), strict=True):
        ax.plot([0, 1, 2], [1, 9, 10], label="rises")
        ax.plot([0, 1, 2], [10, 9, 10], label="stays")
        ax.set_yscale(scale)
        ax.legend(loc="upper right")
    assert all(_behind(ax) for ax in _drawn(figure))
    clear_legends(figure)
    assert not any(_behind(ax) for ax in _drawn(figure))


def _drawn(figure):
    figure.draw_without_rendering()
    return figure.axes


@pytest.mark.parametrize("gap", [-9.0, -3.7, -0.4, 0.0, 1.1, 5.2])
def test_the_largest_motion_of_the_grid_is_among_the_instants(gap):
    """The target's own peak at 0, another point moving more ``gap`` ms from it."""
    time = np.arange(-500, 500) * 1e-4
    values = np.exp(-((time - [[0.0], [gap * 1e-3]]) ** 2) / (2 * 0.2e-3**2)) * [[1.0], [2.0]]
    instants = moments(time, values, 0)
    assert np.abs(instants).min() < 1e-9
    assert np.abs(instants - gap * 1e-3).min() <= 1.01e-4 * 1.5  # one sample and a half: steps are whole samples
    assert np.allclose(np.diff(instants), instants[1] - instants[0])
