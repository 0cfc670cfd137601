"""Style of figures: fonts, sizes, colours, root scales."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from difflib import get_close_matches
from functools import wraps
from pathlib import Path
from typing import Any, NamedTuple, ParamSpec, TypeVar

import numpy as np
from matplotlib import colormaps, rc_context, style
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.font_manager import findSystemFonts, fontManager
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from ..errors import DataError

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
        with style.context(SHEET):
            layout.execute(figure)
            figure.set_layout_engine(None)


def sign(figure: Figure, source: str) -> None:
    """``source`` in small grey letters at the foot of ``figure``, below everything else."""
    height = 0.16 / figure.get_figheight()
    engine = figure.get_layout_engine()
    if isinstance(engine, ConstrainedLayoutEngine):
        engine.set(rect=(0, height, 1, 1 - height))
    figure.text(0.005, 0.25 * height, source, fontsize=5.5, color=GREY, ha="left", va="bottom")


class MethodLook(NamedTuple):
    """Colour, marker and hatch of a method: known on paper without colours, too."""

    colour: str
    marker: str
    hatch: str


def method_look(name: str, all_names: Sequence[str]) -> MethodLook:
    """The method's own look; unknown methods take the next ones, their colours of the actuators' cycle."""
    order = [*METHODS, *(n for n in all_names if n not in METHODS)]
    colours = [*METHODS.values(), *(c for c in ACTUATORS if c not in METHODS.values())]
    place = order.index(name)
    return MethodLook(colours[place % len(colours)], "os^Dv"[place % 5], ("", "////", "....", "xx")[place % 4])


@contextmanager
def lettering(font: str = "") -> Iterator[None]:
    """Letters of ``font`` within, default the style sheet's; DataError unless the machine has it.

    Signs that it lacks come from the default.
    """
    if not font:
        yield
        return
    if font not in fontManager.get_font_names():  # matplotlib lists fonts once, and some come later
        for path in findSystemFonts():
            with suppress(Exception):  # of a kind that matplotlib cannot read
                fontManager.addfont(path)
    if font not in (known := fontManager.get_font_names()):
        raise DataError(
            f"no font is called '{font}' on this machine; install it, or name one that is, e.g. "
            f"{', '.join(get_close_matches(font, known, 3, 0.3) or known[:3])}"
        )
    with rc_context({"font.family": [font, "DejaVu Sans"], "mathtext.fontset": "custom", "mathtext.rm": font,
                     "mathtext.it": f"{font}:italic", "mathtext.bf": f"{font}:bold",
                     "mathtext.cal": font}):  # fmt: skip
        yield


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


def round_down_125(value: float) -> float:
    """The largest of 1, 2, 5 times a power of ten that does not exceed ``value``."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(p for p in (1, 2, 5) if p * power <= value * (1 + 1e-9)) * power)
