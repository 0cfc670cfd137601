"""What an answer of a library states of its own errors: interpolation, the twin, contacts, the reduced model."""

from __future__ import annotations

import numpy as np

from ..transfer import Compliance, ErrorEstimate, ErrorSource
from ..typing import FloatArray


def stated_errors(
    found: Compliance, deviation: FloatArray, missed: FloatArray, flat: FloatArray, bent: float
) -> tuple[ErrorEstimate, ...]:
    """Estimates from the standard ``deviation`` (n_frequency, p, p) [m/N] of what is interpolated and what the reduced
    model has ``missed`` (likewise), from e(f) (n_frequency,) of the ``flat`` twin, and from that of its flat discs,
    ``bent``.

    Entries from discs to points count, between discs where there are none.
    """
    rows, columns = found.indices("point") or found.indices("contact"), found.indices("contact")
    values = found.values[:, rows][:, :, columns]
    size = np.abs(values).max(axis=(1, 2))
    frequency = tuple(found.frequency.tolist())

    def by_entry(source: ErrorSource, off: FloatArray, method: str) -> ErrorEstimate:
        off = off[:, rows][:, :, columns]
        each = tuple((off.max(axis=(1, 2)) / size).tolist())
        return ErrorEstimate(source, float(np.linalg.norm(off) / np.linalg.norm(values)), method, frequency, each)

    return (
        by_entry("interpolation", deviation, "spread of what lies between the library's loads, by leaving each of them "
                 "out"),
        _weighed("quadrature", flat, size, frequency, "the flat twin's tables, and last terms and orders of the "
                 "tractions under its discs"),
        _weighed("contact", np.full(len(size), bent), size, frequency, "a quarter of the disc's squared curvature"),
        by_entry("reduction", missed, "largest against direct solves for some of the library's loads, of those as far "
                 "apart or farther, at up to five frequencies; and between these"),
    )  # fmt: skip


def _weighed(
    source: ErrorSource, error: FloatArray, size: FloatArray, frequency: tuple[float, ...], method: str
) -> ErrorEstimate:
    """An estimate with e(f) ``error`` (n,) of compliances of ``size`` (n,) [m/N]."""
    band = float(np.linalg.norm(error * size) / np.linalg.norm(size))
    return ErrorEstimate(source, band, method, frequency, tuple(error.tolist()))
