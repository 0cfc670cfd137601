"""Renderers: from a transfer matrix and a target to drives, and from drives to displacements.

::

    wavelet = ricker()
    sent = drives(InverseFilter(), transfer, "5", wavelet)
    reached = displacements(transfer, sent)
    everything = render_all(transfer)
"""

from .drives import Displacements, Drives, displacements, drives, strengths, thesis_renderers
from .interval import Rendered, Rendering
from .job import from_samples_file, render_all
from .limits import DriveReport, Limits, beyond_limits, check
from .renderers import (
    Aim,
    AutoZeros,
    Combination,
    FixedZeros,
    Funneling,
    InverseFilter,
    Inversion,
    Regularisation,
    Renderer,
    ThesisZeros,
    funneling_weights,
)
from .search import SearchedZeros
from .signals import (
    BinnedTransfer,
    BinValues,
    Bridged,
    Record,
    Wavelet,
    Window,
    bridged,
    on_record_bins,
    place_on_bins,
    respond,
    ricker,
    to_spectrum,
    to_time,
    window_of,
)

__all__ = [
    "Aim",
    "AutoZeros",
    "BinValues",
    "BinnedTransfer",
    "Bridged",
    "Combination",
    "Displacements",
    "DriveReport",
    "Drives",
    "FixedZeros",
    "Funneling",
    "InverseFilter",
    "Inversion",
    "Limits",
    "Record",
    "Regularisation",
    "Rendered",
    "Renderer",
    "Rendering",
    "SearchedZeros",
    "ThesisZeros",
    "Wavelet",
    "Window",
    "beyond_limits",
    "bridged",
    "check",
    "displacements",
    "drives",
    "from_samples_file",
    "funneling_weights",
    "on_record_bins",
    "place_on_bins",
    "render_all",
    "respond",
    "ricker",
    "strengths",
    "thesis_renderers",
    "to_spectrum",
    "to_time",
    "window_of",
]
