"""What an answer of a library states of its own errors: interpolation, the twin, contacts, the reduced model."""

from __future__ import annotations

import numpy as np

from ..ports import Port
from ..transfer import Compliance, ErrorEstimate, ErrorSource
from ..typing import FloatArray


def stated_errors(
    found: Compliance, deviation: FloatArray, missed: FloatArray, flat: FloatArray, bent: float, moved: FloatArray
) -> tuple[ErrorEstimate, ...]:
    """Estimates from the standard ``deviation`` (n_frequency, p, p) [m/N] of what is interpolated and what the reduced
    model has ``missed`` (likewise), from e(f) (n_frequency,) of the ``flat`` twin, from that of its flat discs,
    ``bent``, and from the share of each entry by which it is ``moved`` (p, p) as skin is stretched
    (:func:`moved_by_stretch`).

    Entries from discs to points count, between discs where there are none.
    """
    rows, columns = found.indices("point") or found.indices("contact"), found.indices("contact")
    values = found.values[:, rows][:, :, columns]
    size = np.abs(values).max(axis=(1, 2))
    stretched = (np.abs(values) * moved[np.ix_(rows, columns)]).max(axis=(1, 2)) / size
    frequency = tuple(found.frequency.tolist())

    def by_entry(source: ErrorSource, off: FloatArray, method: str) -> ErrorEstimate:
        """What each entry is ``off`` by, as an estimate: beside the largest at each frequency, and over the band."""
        off = off[:, rows][:, :, columns]
        each = tuple((off.max(axis=(1, 2)) / size).tolist())
        return ErrorEstimate(source, float(np.linalg.norm(off) / np.linalg.norm(values)), method, frequency, each)

    return (
        by_entry("interpolation", deviation, "spread of what lies between the library's loads, by leaving each of them "
                 "out"),
        _weighed("quadrature", flat, size, frequency, "the flat twin's tables, and last terms and orders of the "
                 "tractions under its discs"),
        _weighed("contact", bent + stretched, size, frequency, "a quarter of the disc's squared curvature, and lengths "
                 "that no plane has between a disc and what lies beside it"),
        by_entry("reduction", missed, "largest against direct solves for some of the library's loads, of those as far "
                 "apart or farther, at up to five frequencies; and between these"),
    )  # fmt: skip


def moved_by_stretch(ports: tuple[Port, ...], distance: FloatArray, stretch: FloatArray, near: float) -> FloatArray:
    """Share (p, p) of each entry by which it changes where ``distance`` (p, p) [m] errs by ``stretch`` (p, p).

    Beside a rigid disc of radius a, skin at rest moves as asin(a/r) (Sneddon 1965). Entries of ports whose rims are
    ``near`` [m] or further apart do not count: what changes so little from place to place is interpolated.
    """
    radius = np.array([port.radius if port.kind == "contact" else 0.0 for port in ports])
    disc = np.maximum(radius[:, None], radius)
    shorter = distance * (1 - np.abs(stretch))
    angles = [np.arcsin(np.divide(disc, r, out=np.ones_like(disc), where=r > disc)) for r in (distance, shorter)]
    beside = (distance > disc) & (distance - radius[:, None] - radius < near)
    change = np.divide(angles[1], angles[0], out=np.ones_like(disc), where=angles[0] > 0) - 1
    return np.asarray(np.where(beside, change, 0.0))


def _weighed(
    source: ErrorSource, error: FloatArray, size: FloatArray, frequency: tuple[float, ...], method: str
) -> ErrorEstimate:
    """An estimate with e(f) ``error`` (n,) of compliances of ``size`` (n,) [m/N]."""
    band = float(np.linalg.norm(error * size) / np.linalg.norm(size))
    return ErrorEstimate(source, band, method, frequency, tuple(error.tolist()))
