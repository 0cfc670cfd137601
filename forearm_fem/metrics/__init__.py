"""Numbers that judge a rendering or a transfer matrix; nothing here knows how either was made."""

from ..accuracy.estimates import perturbed, smooth_noise
from ..transfer import relative_error_at
from .matrix import ConditionSummary, condition_number, condition_summary, singular_values
from .strength import StrengthTable, area, signal_strength, signal_strength_table, thesis_table
from .waves import WaveFit, fit_waves

__all__ = [
    "ConditionSummary",
    "StrengthTable",
    "WaveFit",
    "area",
    "condition_number",
    "condition_summary",
    "fit_waves",
    "perturbed",
    "relative_error_at",
    "signal_strength",
    "signal_strength_table",
    "singular_values",
    "smooth_noise",
    "thesis_table",
]
