"""Curves of others over a figure, journal widths, and what the pictures of a target must show."""

import numpy as np
import pytest
from matplotlib.figure import Figure

from forearm_fem.errors import DataError
from forearm_fem.show.overlay import fit_width, lay_over, read_curves
from forearm_fem.show.targets import moments


def two_panels() -> Figure:
    """Two panels, 0 to 10 by 0 to 1."""
    figure = Figure(figsize=(3.5, 3.5))
    for axes in figure.subplots(2, 1):
        axes.set(xlim=(0, 10), ylim=(0, 1))
    return figure


def test_curves_are_drawn_where_their_header_says_and_move_no_axis(tmp_path):
    (tmp_path / "c.csv").write_text("f,Jones 2019,own@2\n1,0.5,\n2,0.7,0.2\n20,9,0.3\n")
    figure, curves = two_panels(), read_curves(tmp_path / "c.csv")
    lay_over(figure, curves)
    first, second = (axes.lines[0] for axes in figure.axes)
    beyond = "points beyond the axes"
    labels = f"Jones 2019 (1 of 3 {beyond})", f"own (1 of 2 {beyond})"
    assert (first.get_label(), second.get_label()) == labels
    np.testing.assert_array_equal(first.get_xydata(), [[1, 0.5], [2, 0.7], [20, 9]])
    np.testing.assert_array_equal(second.get_xydata(), [[2, 0.2], [20, 0.3]])
    assert figure.axes[0].get_xlim() == (0, 10)
    assert figure.axes[0].get_ylim() == (0, 1)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("f,a\n1000,0.5\n", "are the units right"),
        ("f,a@3\n1,0.5\n", "2 panels, not a panel 3"),
        ("f,a\n1,high\n", "no table of curves"),
        ("f\n1\n", "a curve in each other one"),
        ("f,a\n1\n", "a curve in each other one"),
        ("", "a curve in each other one"),
        ("<p>" + 200_000 * "x", "no table of curves"),  # a page, in lines longer than the reader takes
    ],
)
def test_what_is_no_curve_of_the_figure_is_refused_in_a_sentence(text, told, tmp_path):
    (tmp_path / "c.csv").write_text(text)
    with pytest.raises(DataError, match=told):
        lay_over(two_panels(), read_curves(tmp_path / "c.csv"))


def test_a_curve_in_other_units_is_told_the_axes_names_and_no_empty_one(tmp_path):
    """Panels that share an axis name it once, at the lowest."""
    (tmp_path / "c.csv").write_text("f,a\n1000,0.5\n")
    figure = Figure()
    upper, lower = figure.subplots(2, 1, sharex=True)
    lower.set(xlabel="frequency [Hz]", xlim=(0, 10))
    with pytest.raises(DataError, match=r"of panel 1 \(frequency \[Hz\]\); are"):
        lay_over(figure, read_curves(tmp_path / "c.csv"))
    upper.set(ylabel="S")
    with pytest.raises(DataError, match=r"of panel 1 \(frequency \[Hz\]; S\); are"):
        lay_over(figure, read_curves(tmp_path / "c.csv"))


@pytest.mark.parametrize(
    ("inches", "asked", "made"), [(3.5, 88, 88), (10.2, 88, 181), (10.2, 181, 181), (3.5, 181, 181)]
)
def test_a_figure_is_as_wide_as_a_column_or_a_page(inches, asked, made):
    figure = Figure(figsize=(inches, 3.0))
    fit_width(figure, asked)
    assert figure.get_figwidth() * 25.4 == pytest.approx(made)


@pytest.mark.parametrize("gap", [-9.0, -3.7, -0.4, 0.0, 1.1, 5.2])
def test_the_largest_motion_of_the_grid_is_among_the_instants(gap):
    """The target's own peak at 0, another point moving more ``gap`` ms from it."""
    time = np.arange(-500, 500) * 1e-4
    values = np.exp(-((time - [[0.0], [gap * 1e-3]]) ** 2) / (2 * 0.2e-3**2)) * [[1.0], [2.0]]
    instants = moments(time, values, 0)
    assert np.abs(instants).min() < 1e-9
    assert np.abs(instants - gap * 1e-3).min() <= 1.01e-4 * 1.5  # one sample and a half: steps are whole samples
    assert np.allclose(np.diff(instants), instants[1] - instants[0])
