"""Style of figures: fonts, sizes, colours, root scales."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from functools import wraps
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import numpy as np
from matplotlib import colormaps, style
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

# The look of every figure: style sheet, colours, canvases and the line that says where it came from.

P = ParamSpec("P")
R = TypeVar("R")
Drawn = Axes | Figure

SHEET = Path(__file__).with_name("forearm.mplstyle")
INK, GREY, FAINT = "#222222", "#777777", "#B8B8B8"
ACTUATORS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00")
LINES: tuple[Any, ...] = ("-", (0, (4, 2)), (2, (2, 2)), (0, (1, 1.5)))  # equal lines stay visible
METHODS = {"inverse filter": "#0072B2", "funneling": "#D55E00", "combination": "#009E73"}
TISSUES = {"skin": "#E8B4A0", "fat": "#F2DE9B", "muscle": "#A84B4B", "bone": "#DAD7CB"}
SIGNED, SIZE = "RdBu_r", "cividis"
NEARNESS = LinearSegmentedColormap.from_list("nearness", colormaps["viridis_r"](np.linspace(0.18, 1, 256)))  # no yellow
_NO_LAYOUT = {"figure.autolayout": False, "figure.constrained_layout.use": False}  # what no engine means
MICRO = 1e6  # what displacements are drawn times: in micrometres, their unit by :func:`micro`


def micro(unit: str) -> str:
    """The unit of :data:`MICRO` times values in ``unit``."""
    return "µ" + unit


def minus(words: str) -> str:
    """``words`` with true minus signs before numbers."""
    return re.sub(r"(?<![\w.])-(?=\d)", "\N{MINUS SIGN}", words)


def styled(draw: Callable[P, R]) -> Callable[P, R]:
    """``draw`` under our style sheet; the user's own settings are back when it returns."""

    @wraps(draw)
    def inside(*args: P.args, **kwargs: P.kwargs) -> R:
        """``draw`` within the style sheet."""
        with style.context(SHEET):
            return draw(*args, **kwargs)

    return inside


def single(ax: Axes | None, size: tuple[float, float] = (3.5, 2.6)) -> Axes:
    """``ax``, or new axes in a figure of ``size`` [inch] that belongs to no window."""
    return ax if ax is not None else Figure(figsize=size, layout="constrained").add_subplot()


def figure_of(drawn: Drawn) -> Figure:
    """The whole figure that ``drawn`` is part of."""
    whole = drawn if isinstance(drawn, Figure) else drawn.get_figure(root=True)
    assert isinstance(whole, Figure)
    return whole


def arrange(figure: Figure) -> None:
    """Lay ``figure`` out once and for all; saving it does so, and draws it, twice for each file otherwise."""
    if (layout := figure.get_layout_engine()) is not None:
        with style.context((SHEET, _NO_LAYOUT)):
            layout.execute(figure)
            figure.set_layout_engine(None)


def sign(figure: Figure, source: str) -> None:
    """``source`` in small grey letters at the foot of ``figure``, below everything else."""
    height = 0.16 / figure.get_figheight()
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.set(rect=(0, height, 1, 1 - height))  # type: ignore[call-arg]
    figure.text(0.005, 0.25 * height, source, fontsize=5.5, color=GREY, ha="left", va="bottom")


def method_colour(name: str, all_names: Sequence[str]) -> str:
    """The method's own colour; unknown methods take the next ones of the actuators' cycle."""
    spare = [c for c in ACTUATORS if c not in METHODS.values()]
    return METHODS.get(name) or spare[list(all_names).index(name) % len(spare)]


def widen(ax: Axes, least: float = 0.35) -> None:
    """Limits of a map seen from above, no narrower than ``least`` of its length: a line of places has no width."""
    (left, right), (low, high) = ax.get_xlim(), ax.get_ylim()
    most = max(right - left, high - low)
    aside = [max(0.0, least * most - span) / 2 for span in (right - left, high - low)]
    ax.set(xlim=(left - aside[0], right + aside[0]), ylim=(low - aside[1], high + aside[1]))


WIDTHS = (88, 181)  # mm: one column of a journal, and its page
COLUMN, PAGE = WIDTHS


def panels(size: tuple[float, float]) -> Figure:
    """A new figure of ``size`` [inch] that belongs to no window."""
    return Figure(figsize=size, layout="constrained")


def sheet(width: int, height: float) -> Figure:
    """A new figure of exactly ``width`` by ``height`` [mm] that belongs to no window."""
    return panels((width / 25.4, height / 25.4))


def clear_legends(figure: Figure) -> None:
    """Give each legend room above the curves: axes grow upwards until no point of a curve lies behind it."""
    boxed = [ax for ax in figure.findobj(Axes) if ax.get_legend() is not None]
    if boxed:
        figure.draw_without_rendering()
    for _ in range(8 if boxed else 0):  # a legend keeps its place while the limits change
        hidden = [ax for ax in boxed if _behind(ax)]
        if not hidden:
            return
        for ax in hidden:
            low, high = ax.get_ylim()
            if ax.get_yscale() == "log" and low > 0:
                ax.set_ylim(low, high * (high / low) ** 0.12)
            elif ax.get_yscale() == "linear":
                ax.set_ylim(low, high + 0.12 * (high - low))


def _behind(ax: Axes) -> bool:
    """True if a curve of ``ax`` passes behind its legend, which lies in its upper part."""
    legend = ax.get_legend()
    assert legend is not None
    box, frame = legend.get_window_extent(), ax.get_window_extent()
    if (box.y0 + box.y1) / 2 < (frame.y0 + frame.y1) / 2 or box.y0 > frame.y1:
        return False
    for line in ax.lines:
        at = line.get_transform().transform(line.get_xydata())
        if len(at) > 1:  # between points, too
            at = np.concatenate([at + s * (np.roll(at, -1, axis=0) - at) for s in (0.0, 0.5)])[: 2 * len(at) - 1]
        inside = (at[:, 0] > box.x0) & (at[:, 0] < box.x1) & (at[:, 1] > box.y0) & (at[:, 1] < frame.y1)
        if inside.any():
            return True
    return False


def letter(ax: Axes, text: str) -> None:
    """A panel's bold letter outside its upper left corner."""
    ax.set_title(text, loc="left", fontweight="bold")


def decimal(axis: Axis) -> None:
    """Plain numbers on a logarithmic axis, also between the decades where it spans few of them."""
    low, high = sorted(axis.get_view_interval())
    decades = float(np.log10(high / low)) if low > 0 else 0.0
    subs = (1.0, 2.0, 5.0) if decades < 2.2 else (1.0,)
    axis.set_major_locator(LogLocator(10, subs))
    axis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}".replace("-", "\N{MINUS SIGN}")))
    axis.set_minor_formatter(NullFormatter())
