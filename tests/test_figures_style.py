"""Widths of a journal, legends, and what the pictures of a target must show."""

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties, findfont

from forearm_fem.errors import DataError
from forearm_fem.show.device import moments
from forearm_fem.show.registry import save_drawn
from forearm_fem.show.style import METHODS, _behind, clear_legends, lettering, method_look, panels

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


def test_every_format_of_a_figure_is_laid_out_once(tmp_path):
    """The second was laid out anew, without room for the footer."""
    figure = panels((3, 2))
    ax = figure.add_subplot(xlabel="time")
    save_drawn(figure, tmp_path / "one", ("svg",), "made here")
    first = ax.get_position().bounds
    save_drawn(figure, tmp_path / "two", ("png", "svg"))
    assert ax.get_position().bounds == first
    assert figure.texts[0].get_window_extent().y1 < ax.get_tightbbox().y0


def test_letters_are_of_the_font_asked_for_or_it_is_refused():
    default = findfont(FontProperties())
    with lettering("DejaVu Serif"):
        assert findfont(FontProperties()).endswith("DejaVuSerif.ttf")
    assert findfont(FontProperties()) == default
    with pytest.raises(DataError, match="no font is called 'Nothing Sans' on this machine"), lettering("Nothing Sans"):
        pass


def test_methods_are_known_without_their_colours():
    names = [*METHODS, "one's own", "another"]
    looks = [method_look(n, names) for n in names]
    assert len({look.marker for look in looks}) == len(names)
    assert len({look.hatch for look in looks[:3]}) == 3
