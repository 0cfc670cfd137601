"""What an answer of a library states of its own errors: interpolation, the twin, contacts, the reduced model."""

from __future__ import annotations

from types import MappingProxyType

import numpy as np

from ..transfer import Compliance, ErrorEstimate, ErrorSource
from ..typing import ComplexArray, FloatArray

_CONTACT = MappingProxyType({
    "bonded": "a quarter of the disc's squared curvature; and what discs held against tilt take from the limb's "
    "difference from its flat twin, were its slope that of the shortest wave",
    "frictionless": "what discs held against tilt take from the limb's own motion is not known; make the library with "
    "device.cone.contact = 'bonded' or 'pressure'",
    "pressure": "a quarter of the disc's squared curvature",
})  # fmt: skip


def stated_errors(
    found: Compliance, deviation: FloatArray, flat: FloatArray, held: FloatArray, reduction: FloatArray, contact: str
) -> tuple[ErrorEstimate, ...]:
    """Estimates from the standard ``deviation`` (n_frequency, p, p) [m/N] of what is interpolated, and from e(f)
    (n_frequency,) of the ``flat`` twin, of what its discs of this ``contact`` leave out, and of the ``reduction``.

    Entries from discs to points count, between discs where there are none.
    """
    rows, columns = found.indices("point") or found.indices("contact"), found.indices("contact")
    values, deviation = found.values[:, rows][:, :, columns], deviation[:, rows][:, :, columns]
    size = np.abs(values).max(axis=(1, 2))
    frequency = tuple(found.frequency.tolist())
    between = tuple((deviation.max(axis=(1, 2)) / size).tolist())
    return (
        ErrorEstimate("interpolation", float(np.linalg.norm(deviation) / np.linalg.norm(values)), "spread of what lies "
                      "between the library's loads, by leaving each of them out", frequency, between),
        _weighed("quadrature", flat, size, frequency, "the flat twin's tables, and last terms and orders of the "
                 "tractions under its discs"),
        _weighed("contact", held, size, frequency, _CONTACT[contact]),
        _weighed("reduction", reduction, size, frequency, "against direct solves for some of the library's loads at "
                 "three frequencies, and between them"),
    )  # fmt: skip


def tilt_error(found: Compliance, flat: ComplexArray, length: FloatArray) -> FloatArray:
    """e(f) (n_frequency,) of bonded discs that are held against tilt, which the limb's difference from its twin moves.

    A disc's tilt for a moment is 3/16 mu a^3, 3/2 of 1/(8 mu a) along its normal over a^2 (incompressible; Mindlin
    1949), and a difference D of waves of ``length`` k a (n_frequency,) tilts it by k D: n discs take x/(1 + x) of D,
    x = n 2/3 (k a)^2 |D|/|T|, with the twin's T, ``flat`` (n_frequency, p, p), of a disc itself.
    """
    rows, discs = found.indices("point") or found.indices("contact"), found.indices("contact")
    apart, own = found.values - flat, np.abs(flat[:, discs, discs]).mean(axis=1)
    grip = len(discs) * 2 / 3 * length**2 * np.abs(apart[:, discs][:, :, discs]).max(axis=(1, 2)) / own
    seen, size = (np.abs(of[:, rows][:, :, discs]).max(axis=(1, 2)) for of in (apart, found.values))
    return np.asarray(grip / (1 + grip) * seen / size)


def _weighed(
    source: ErrorSource, error: FloatArray, size: FloatArray, frequency: tuple[float, ...], method: str
) -> ErrorEstimate:
    """An estimate with e(f) ``error`` (n,) of compliances of ``size`` (n,) [m/N]."""
    band = float(np.linalg.norm(error * size) / np.linalg.norm(size))
    return ErrorEstimate(source, band, method, frequency, tuple(error.tolist()))
