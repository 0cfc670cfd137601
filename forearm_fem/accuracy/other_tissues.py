"""Errors of a saved reduced model's answer for other tissues: of its space, and of the mesh and ends of the limb."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ..tissue import Tissue
from ..transfer import ErrorEstimate, band_error, error_of_pairs, relative_error_at
from ..typing import ComplexArray, FloatArray, IntArray
from .discretisation import smoothed_relative_change

# What is stated of the change between the narrow and the wide space: direct solves had .2 to .5 of it over the band.
_SHARE = 0.6
_MESH, _ENDS = 4.0, 2.0  # powers of frequency with which errors of mesh and ends grow beyond the band that was solved
_PROBES = 40


def probes(count: int) -> IntArray:
    """Indices of at most 40 of ``count`` frequencies, at which the two spaces are compared."""
    return np.unique(np.linspace(0, count - 1, _PROBES).round().astype(int))


def space_error(frequency: FloatArray, wide: ComplexArray, narrow: ComplexArray) -> ErrorEstimate:
    """Reduction error of values (n, n_out, n_in) of the ``wide`` space, by their change from the ``narrow`` one's.

    Not covered: what neither space holds, as far beyond factors of four in one modulus.
    """
    change = smoothed_relative_change(narrow, wide, frequency)
    size = np.abs(wide).max(axis=(1, 2), keepdims=True)
    pairs = np.abs(narrow - wide) / size
    pairs = pairs * (change / pairs.max(axis=(1, 2)))[:, None, None] if pairs.any() else pairs
    return ErrorEstimate(
        "reduction",
        _SHARE * band_error(narrow, wide),
        f"{_SHARE:g} of the change at {len(change)} frequencies without the directions that other tissues ask for",
        tuple(frequency.tolist()),
        tuple((_SHARE * change).tolist()),
        _SHARE * pairs,
    )


def shortening(
    before: Mapping[str, Tissue], after: Mapping[str, Tissue], frequency: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Ratio (n,) of shear wavenumbers ``after`` a change to those ``before``, most and least of all tissues."""
    omega = 2 * np.pi * frequency
    ratios = [np.ones(len(frequency))]
    for name, tissue in before.items():
        if name in after and after[name] != tissue:
            ratios.append(np.abs(after[name].wavenumber(omega)) / np.abs(tissue.wavenumber(omega)))
    return np.max(ratios, axis=0), np.min(ratios, axis=0)


def carried(estimate: ErrorEstimate, frequency: FloatArray, shorter: FloatArray, size: FloatArray) -> ErrorEstimate:
    """The ``estimate`` by mesh or ends for other tissues, whose waves are ``shorter`` (n,) at ``frequency`` (n,) [Hz].

    It is as large as where waves of the tissues solved for are as short; beyond the band it grows as a power. ``size``
    (n,) of G weighs frequencies for the band value, in which none errs by more than its G: elements that carry no
    waves make several times of a G that is small.
    """
    if not estimate.known or not len(estimate.frequency):
        return estimate
    asked = frequency * shorter
    beyond = np.maximum(asked / estimate.frequency[-1], 1.0) ** _MESH
    below = np.maximum(estimate.frequency[0] / asked, 1.0) ** _ENDS
    error = relative_error_at(estimate, asked) * beyond * below
    pairs = error_of_pairs(estimate, asked)
    own = relative_error_at(estimate, frequency)
    grown = np.linalg.norm(size * np.minimum(error, 1.0)) / np.linalg.norm(size * own) if own.any() else 1.0
    return replace(
        estimate,
        band=float(estimate.band * grown),
        method=f"that of the tissues solved for, where their waves are as short ({estimate.method})",
        frequency=tuple(frequency.tolist()),
        per_frequency=tuple(error.tolist()),
        per_pair=None if pairs is None else pairs * (beyond * below)[:, None, None],
        together=None,
        exact=False,
    )
