"""Renderers: from a transfer matrix and a target to drives, and from drives to displacements.

::

    wavelet = ricker()
    sent = drives(InverseFilter(), transfer, "5", wavelet)
    reached = displacements(transfer, sent)
    everything = render_all(transfer)
"""

from .bridging import Bridged, Interpolation, bridged
from .drives import Aim, Displacements, Drives, Renderer, displacements, drives
from .funneling import Funneling, funneling_weights
from .inverse_filter import Combination, InverseFilter
from .inversion import Inversion, Regularisation
from .limits import DriveReport, Limits, beyond_limits, check
from .rendered import Rendered, Rendering, render_all, strengths, thesis_renderers
from .spectrum import BinnedTransfer, BinValues, Record, on_record_bins, place_on_bins, respond, to_spectrum, to_time
from .wavelet import Wavelet, Window, from_samples_file, ricker, window_of
from .zeros import AutoZeros, FixedZeros, SearchedZeros, ThesisZeros

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
    "Interpolation",
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
