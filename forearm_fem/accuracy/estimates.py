"""Error estimates of G: quadrature of the layered model, library answers, spread over pairs, perturbed answers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..errors import DataError
from ..ports import Port
from ..scenario import Scenario
from ..transfer import (
    Compliance,
    ErrorEstimate,
    ErrorSource,
    TransferMatrix,
    between,
    error_of_pairs,
    percent,
    relative_error_at,
    total_error,
)
from ..typing import ComplexArray, FloatArray

# Error estimates: made of e(f), and held against the accuracy asked for.


def quadrature_estimate(frequency: FloatArray, error: FloatArray, method: str) -> ErrorEstimate:
    """Error of the layered model's integrals and series: e(f) ``error`` (n,) at ``frequency`` (n,) [Hz].

    Its band value is the largest, as these errors are alike over the band.
    """
    return ErrorEstimate("quadrature", float(error.max()), method, tuple(frequency.tolist()), tuple(error.tolist()))


def accuracy_verdict(scenario: Scenario, errors: tuple[ErrorEstimate, ...]) -> str:
    """One sentence: was the accuracy asked for met, by the estimates? Unknown where one of them could not be made, and
    for a measured G, which states its scatter alone."""
    if not errors:
        return "no error estimate was made, so the accuracy asked for cannot be confirmed"
    asked, total = f"error of G, {100 * scenario.accuracy:g} % asked", total_error(errors)
    if math.isnan(total):
        missing = [e for e in errors if not e.known]
        names = ", ".join(e.source for e in missing)
        return f"{asked}: UNKNOWN, as {names} could not be estimated ({missing[0].method})"
    if all(e.source == "measurement" for e in errors):
        return f"{asked}: UNKNOWN, as a measured G states its scatter ({percent(total)}) and no systematic error"
    met = "met" if total <= scenario.accuracy else "NOT met"
    return f"{asked}, {percent(total)} estimated over all sources: {met}"


def short_verdict(sentence: str) -> str:
    """The verdict in a :func:`accuracy_verdict`, for a table: met, NOT met, or UNKNOWN, also where there is none."""
    return next((word for word in ("UNKNOWN", "NOT met", "met") if word in sentence), "UNKNOWN")


# Errors of a compliance at each pair of ports: far points, which move little, are known better than near ones.


def raised_to_row_column_mean(change: FloatArray) -> FloatArray:
    """``change`` (n, n_out, n_in), each entry raised to (row rms x column rms / total rms).

    A reduced model errs by the product of what the states of two ports lack (:mod:`..fem.reduction.certificate`),
    so a pair that changes less than that does so by chance. Nothing is raised beyond the largest of all.
    """
    square = change**2
    rows, columns, all_of_it = (square.mean(axis=axes, keepdims=True) for axes in (2, 1, (1, 2)))
    product = np.sqrt(np.divide(rows * columns, all_of_it, out=np.zeros_like(square), where=all_of_it > 0))
    return np.asarray(np.maximum(change, np.minimum(product, change.max(axis=(1, 2), keepdims=True))))


@dataclass(frozen=True, eq=False)
class PairErrors:
    """Errors ``shares`` (n_probe, n_port, n_port) of the largest entry of points under contacts, at rising ``probes``
    (n_probe,) [Hz]; their largest of such a pair is e(f)."""

    probes: FloatArray
    shares: FloatArray

    def of(self, found: Compliance) -> FloatArray:
        """Error of ``found`` (n, n_port, n_port) [m/N]: shares are linear between probes and constant beyond."""
        between = np.array([np.interp(found.frequency, self.probes, e) for e in np.eye(len(self.probes))])
        points, contacts = found.indices("point"), found.indices("contact")
        block = found.values[:, points or contacts][:, :, contacts or points]
        size = np.abs(block).max(axis=(1, 2))
        return np.asarray(np.tensordot(between.T, self.shares, 1) * size[:, None, None])


# Effect of an error of G on S.

APART = 0.15  # of a pair's error by the mesh: what other pairs do not share
_NULL = 1e-10  # of the largest singular value: rounding
_WAVES = 64  # random cosines that make up one perturbation


def perturbed(
    transfer: TransferMatrix, sources: Sequence[ErrorEstimate], rng: np.random.Generator, correlation: float
) -> TransferMatrix:
    """G plus one draw of its errors: complex noise per source, smooth over ``correlation`` [Hz].

    Where a source tells what entries do ``together``, one complex factor of unit variance moves them all over the
    band, and :data:`APART` of a pair's error is its own; an exact error is added as it is. Noise of other sources is
    independent over entries, of the root mean square that they state for each pair, or with e(f) of the largest of G
    as its largest entry.

    An actuator out of contact moves the skin through the housing as the others do, or not at all. So it does in every
    draw: noise would make it one that can be driven.
    """
    usable = np.isfinite(transfer.values) if transfer.valid is None else transfer.valid & np.isfinite(transfer.values)
    scale = np.max(np.abs(transfer.values), axis=(1, 2), where=usable, initial=0)
    change = np.zeros(transfer.values.shape, dtype=complex)
    for source in sources:
        if source.exact and source.together is not None:
            change += scale[:, None, None] * between(source, source.together, transfer.frequency)
            continue
        noise = smooth_noise(transfer.frequency, transfer.values.shape[1:], rng, correlation)
        size = error_of_pairs(source, transfer.frequency)
        if source.together is not None:
            apart = 0.0 if size is None else APART
            one = complex(*rng.normal(size=2)) * np.sqrt((1 - apart**2) / 2)
            size = np.zeros(noise.shape) if size is None else apart * size
            change += scale[:, None, None] * one * between(source, source.together, transfer.frequency)
        if size is None:
            noise /= np.abs(noise).max(axis=(1, 2), keepdims=True)
            size = relative_error_at(source, transfer.frequency)[:, None, None]
        change += scale[:, None, None] * size * noise
    return replace(transfer, values=transfer.values + _off_null_space(transfer.values, change))


def _off_null_space(values: ComplexArray, change: ComplexArray) -> ComplexArray:
    """``change`` (n, n_out, n_in), projected off the null space of G ``values``: inputs that move nothing together."""
    known = np.nan_to_num(values)
    some = np.linalg.svd(known[len(known) // 2], compute_uv=False)
    if some[-1] > _NULL * some[0]:  # it is the device's doing, alike at all frequencies
        return change
    _, size, rows = np.linalg.svd(known, full_matrices=False)
    null = rows * (size <= _NULL * size[:, :1])[:, :, None]
    return np.asarray(change - (change @ null.conj().swapaxes(1, 2)) @ null)


def smooth_noise(
    frequency: FloatArray, shape: tuple[int, ...], rng: np.random.Generator, correlation: float
) -> ComplexArray:
    """Complex noise (n, *shape) [-] of unit variance with correlation exp(-(df / correlation)^2 / 2), df in
    [Hz].

    Sum of 64 exponentials exp(i tau f) with random amplitudes and tau normal of width 1 / correlation.
    """
    whole = isinstance(shape, list | tuple) and all(isinstance(n, int | np.integer) and n >= 0 for n in shape)
    if frequency.ndim != 1 or not whole or not 0 < correlation < np.inf:
        raise DataError(
            "noise needs frequencies (n,), a shape of whole numbers and a positive correlation in Hz, got "
            f"{frequency.shape}, {shape!r} and {correlation:g}"
        )
    tau = rng.normal(0, 1 / correlation, _WAVES)
    amplitude = rng.normal(size=(_WAVES, *shape)) + 1j * rng.normal(size=(_WAVES, *shape))
    return np.asarray(np.tensordot(np.exp(1j * np.outer(frequency, tau)), amplitude / np.sqrt(2 * _WAVES), axes=1))


# Errors of a library's answer by its own estimates: interpolation, layered model, contacts, reduced model.


def stated_errors(
    found: Compliance, deviation: FloatArray, missed: FloatArray, flat: FloatArray, bent: float, moved: FloatArray
) -> tuple[ErrorEstimate, ...]:
    """Estimates from the standard ``deviation`` (n_frequency, p, p) [m/N] of what is interpolated and what the reduced
    model has ``missed`` (likewise), from e(f) (n_frequency,) of the ``flat`` layered model, from that of its flat
    discs, ``bent``, and from the share of each entry by which it is ``moved`` (p, p) as skin is stretched
    (:func:`moved_by_stretch`).

    Entries from discs to points count, between discs where there are none.
    """
    rows, columns = found.indices("point") or found.indices("contact"), found.indices("contact")
    values = found.values[:, rows][:, :, columns]
    size = np.abs(values).max(axis=(1, 2))
    stretched = (np.abs(values) * moved[np.ix_(rows, columns)]).max(axis=(1, 2)) / size
    frequency = tuple(found.frequency.tolist())

    def by_entry(source: ErrorSource, off: FloatArray, method: str) -> ErrorEstimate:
        """Estimate from the error ``off`` of each entry: relative to the largest at each frequency, and over the
        band."""
        off = off[:, rows][:, :, columns]
        each = tuple((off.max(axis=(1, 2)) / size).tolist())
        return ErrorEstimate(source, float(np.linalg.norm(off) / np.linalg.norm(values)), method, frequency, each)

    return (
        by_entry("interpolation", deviation, "spread of what lies between the library's loads, by leaving each of them "
                 "out"),
        _weighed("quadrature", flat, size, frequency, "the layered model's tables, and last terms and orders of the "
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
