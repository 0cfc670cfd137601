"""What an answer of a library states of its own errors: interpolation, the twin, contacts, the reduced model."""

from __future__ import annotations

from types import MappingProxyType

import numpy as np

from ..transfer import Compliance, ErrorEstimate, ErrorSource
from ..typing import ComplexArray, FloatArray

_CONTACT = MappingProxyType({
    "bonded": "a quarter of the disc's squared curvature; and what discs held against tilt take from the limb's "
    "difference from its flat twin, by its slope",
    "frictionless": "what discs held against tilt take from the limb's own motion is not known; make the library with "
    "device.cone.contact = 'bonded' or 'pressure'",
    "pressure": "a quarter of the disc's squared curvature",
})  # fmt: skip


def stated_errors(
    found: Compliance, deviation: FloatArray, missed: FloatArray, flat: FloatArray, held: FloatArray, contact: str
) -> tuple[ErrorEstimate, ...]:
    """Estimates from the standard ``deviation`` (n_frequency, p, p) [m/N] of what is interpolated and what the reduced
    model has ``missed`` (likewise), and from e(f) (n_frequency,) of the ``flat`` twin and of what its discs of this
    ``contact`` leave out.

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
        _weighed("contact", held, size, frequency, _CONTACT[contact]),
        by_entry("reduction", missed, "largest against direct solves for some of the library's loads, of those as far "
                 "apart or farther, at up to five frequencies; and between these"),
    )  # fmt: skip


def tilt_error(
    found: Compliance, flat: ComplexArray, slope: ComplexArray, waves: FloatArray, radius: float
) -> FloatArray:
    """e(f) (n_frequency,) of bonded discs that are held against tilt, which the limb's difference from its twin moves.

    A moment that holds a disc takes C_zr C_rz/C_rr, with the tilt C_rr of a disc for a moment, 3/16 mu a^3, that is 3/2
    of its twin's T along the normal over a^2 (incompressible; Mindlin 1949). Of C_rz = T_rz + D_rz the twin has
    T_rz T_zr already; T_rz is taken as T times the shortest wave's number, ``waves`` (n_frequency,) [1/m], and D_zr is
    ``slope`` (n_frequency, p, 2 c) [1/N] of the difference at the c discs, along u, then along v. ``flat``
    (n_frequency, p, p) is T; what is left of all discs and both directions is added up.
    """
    rows, discs = found.indices("point") or found.indices("contact"), found.indices("contact")
    own, twin = np.abs(flat[:, discs, discs]), np.abs(flat[:, :, discs]) * waves[:, None, None]
    twin[:, discs, np.arange(len(discs))] = 0.0  # a disc pushed does not tilt itself
    grip = np.tile(radius**2 / (1.5 * own), 2)[:, None]
    ours, twins = np.abs(slope), np.tile(twin, 2)
    taken = ((ours + twins) * grip)[:, rows] @ ours[:, discs].swapaxes(1, 2)
    taken += (ours * grip)[:, rows] @ twins[:, discs].swapaxes(1, 2)
    return np.asarray(taken.max(axis=(1, 2)) / np.abs(found.values[:, rows][:, :, discs]).max(axis=(1, 2)))


def _weighed(
    source: ErrorSource, error: FloatArray, size: FloatArray, frequency: tuple[float, ...], method: str
) -> ErrorEstimate:
    """An estimate with e(f) ``error`` (n,) of compliances of ``size`` (n,) [m/N]."""
    band = float(np.linalg.norm(error * size) / np.linalg.norm(size))
    return ErrorEstimate(source, band, method, frequency, tuple(error.tolist()))
