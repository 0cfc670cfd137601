"""Figures of a run: the thesis' and those it should have had, each a function of a Dataset.

::

    make_figures("results/thesis", formats=("png", "pdf"))
    data = conditioning(Results.open("results/thesis"))
    plot_conditioning(data)
"""

import os

from ..errors import ForearmError

try:
    import matplotlib  # noqa: F401
except ValueError:  # it looks at MPLBACKEND while it is imported, and knows no old names
    raise ForearmError(
        f"matplotlib refuses the back end '{os.environ.get('MPLBACKEND')}' named in MPLBACKEND; "
        "unset it, for figures need none"
    ) from None

from .data import Results
from .device import drive_levels, impedance, method, plot_drives, plot_impedance, plot_method, plot_target, target_waves
from .judge import errors, plot_errors, plot_strength_maps, plot_table_one, strengths, table_one
from .matrix import (
    conditioning,
    conditioning_of,
    dispersion,
    plot_conditioning,
    plot_dispersion,
    plot_transfer,
    plot_travel,
    transfer_of,
    travel,
)
from .registry import FigureKind, applies, kinds, make_figures

__all__ = [
    "FigureKind",
    "Results",
    "applies",
    "conditioning",
    "conditioning_of",
    "dispersion",
    "drive_levels",
    "errors",
    "impedance",
    "kinds",
    "make_figures",
    "method",
    "plot_conditioning",
    "plot_dispersion",
    "plot_drives",
    "plot_errors",
    "plot_impedance",
    "plot_method",
    "plot_strength_maps",
    "plot_table_one",
    "plot_target",
    "plot_transfer",
    "plot_travel",
    "strengths",
    "table_one",
    "target_waves",
    "transfer_of",
    "travel",
]
