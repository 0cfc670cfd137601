"""Renderers: from a transfer matrix and a target to drives, and from drives to displacements.

::

    wavelet = ricker()
    sent = drives(InverseFilter(), transfer, "5", wavelet)
    reached = displacements(transfer, sent)
    everything = render_all(transfer)
"""

from .bridging import Bridged, bridged
from .drives import (
    Aim,
    Displacements,
    DriveReport,
    Drives,
    Limits,
    Renderer,
    beyond_limits,
    check,
    displacements,
    drives,
)
from .funneling import Funneling, funneling_weights
from .inverse_filter import (
    AutoZeros,
    Combination,
    FixedZeros,
    InverseFilter,
    Inversion,
    Regularisation,
    SearchedZeros,
    ThesisZeros,
)
from .rendered import Rendered, Rendering, render_all, strengths, thesis_renderers
from .signals import (
    BinnedTransfer,
    BinValues,
    Record,
    Wavelet,
    Window,
    from_samples_file,
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
