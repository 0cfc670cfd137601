"""Numbers that judge a rendering or a transfer matrix; nothing here knows how either was made."""

from ..transfer import relative_error_at
from .matrix import condition_number, singular_values
from .spot import contrast, fwhm, spot_radius
from .strength import StrengthTable, area, signal_strength, signal_strength_table, thesis_table
from .uncertainty import StrengthInterval, perturbed, signal_strength_uncertainty, smooth_noise
from .waves import WaveFit, fit_waves

__all__ = [
    "StrengthInterval",
    "StrengthTable",
    "WaveFit",
    "area",
    "condition_number",
    "contrast",
    "fit_waves",
    "fwhm",
    "perturbed",
    "relative_error_at",
    "signal_strength",
    "signal_strength_table",
    "signal_strength_uncertainty",
    "singular_values",
    "smooth_noise",
    "spot_radius",
    "thesis_table",
]
