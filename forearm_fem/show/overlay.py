"""A measured or published curve laid over a figure, and figures as wide as a journal's columns."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib import style
from matplotlib.figure import Figure

from ..errors import DataError
from ..typing import FloatArray
from .style import INK, SHEET

WIDTHS = (88, 181)  # mm: one column, and the page
_ONE_COLUMN = 5.0  # inch: figures that are drawn wider have panels that one column cannot hold
_MARKS = "osD^v"


@dataclass(frozen=True, eq=False)
class Curve:
    """Points ``x`` and ``y`` (n,) in the units of a figure's ``panel``-th axes, the first being 1."""

    label: str
    panel: int
    x: FloatArray
    y: FloatArray


def read_curves(path: str | Path) -> tuple[Curve, ...]:
    """Curves of a CSV: x in the first column, a curve in each other one, named by the header.

    A name that ends in ``@2`` is for the second panel. Empty cells are gaps. DataError in a sentence for anything else.
    """
    file = Path(path)
    try:
        lines = [line for line in csv.reader(file.read_text(encoding="utf-8-sig").splitlines()) if line]
        table = np.array([[float(cell) if cell.strip() else np.nan for cell in line] for line in lines[1:]])
    except (OSError, ValueError, csv.Error) as problem:
        raise DataError(
            f"{file}: is no table of curves ({problem}); expected a header and then numbers"[:300]
        ) from None
    if len(lines) < 2 or len(lines[0]) < 2 or table.ndim != 2 or table.shape[1] != len(lines[0]):
        raise DataError(f"{file}: expected a header, x in the first column and a curve in each other one")
    curves, x = [], table[:, 0]
    for name, y in zip(lines[0][1:], table[:, 1:].T, strict=True):
        label, _, panel = name.partition("@")
        known = np.isfinite(x) & np.isfinite(y)
        curves.append(Curve(label.strip(), int(panel) if panel.strip().isdigit() else 1, x[known], y[known]))
    return tuple(curves)


def lay_over(figure: Figure, curves: tuple[Curve, ...]) -> None:
    """Draw ``curves`` as open marks over what ``figure`` shows; its axes keep their ranges, and the legend
    says how many points lie beyond them.

    DataError for a panel that the figure does not have, and where a curve lies wholly outside its panel, as one in
    other units would.
    """
    axes = [a for a in figure.axes if a.get_label() != "<colorbar>"]
    for k, curve in enumerate(curves):
        if not 1 <= curve.panel <= len(axes):
            raise DataError(f"'{curve.label}': the figure has {len(axes)} panels, not a panel {curve.panel}")
        panel = axes[curve.panel - 1]
        (left, right), (low, high) = sorted(panel.get_xlim()), sorted(panel.get_ylim())
        seen = (left <= curve.x) & (curve.x <= right) & (low <= curve.y) & (curve.y <= high)
        if not seen.any():
            along = next((a.get_xlabel() for a in panel.get_shared_x_axes().get_siblings(panel) if a.get_xlabel()), "")
            names = "; ".join(name for name in (along, panel.get_ylabel()) if name)
            raise DataError(
                f"'{curve.label}': none of its points lies within {left:.3g} to {right:.3g} and {low:.3g} to "
                f"{high:.3g} of panel {curve.panel} ({names}); are the units right?"
            )
        hidden = f" ({np.sum(~seen)} of {len(seen)} points beyond the axes)" if not seen.all() else ""
        with style.context(SHEET):
            panel.plot(curve.x, curve.y, _MARKS[k % len(_MARKS)], ms=3.5, mfc="none", mec=INK, mew=0.8,
                       label=curve.label + hidden, scalex=False, scaley=False)  # fmt: skip
            panel.legend()


def fit_width(figure: Figure, width: int) -> None:
    """Make ``figure`` ``width`` [mm] wide, letters as large as before; what one column cannot hold takes the page.

    Heights follow, less where a figure is widened. Call it before anything is arranged.
    """
    wide, high = figure.get_size_inches()
    across = (WIDTHS[-1] if wide > _ONE_COLUMN else width) / 25.4
    factor = across / wide
    figure.set_size_inches(across, high * min(factor, np.sqrt(factor)))
