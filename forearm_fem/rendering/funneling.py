"""Funneling: all actuators send the same signal, the nearer ones more of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import DataError, GeometryError
from ..ports import Port
from ..typing import BoolArray, ComplexArray, FloatArray
from .drives import Aim
from .lattice import lattice
from .spectrum import Placed


def funneling_weights(inputs: tuple[Port, ...], target: Port) -> FloatArray:
    """A_q / A (n_in,) [-] = (1 - d_x / D_x)(1 - d_y / D_y), eq. 6 of de Vlam 2022.

    ``inputs`` form a rectangle of N x M actuators; the four around the target share its weight and the others
    are silent, so that eq. 6 holds within each cell. The weights sum to 1. Raises GeometryError if the inputs
    are no rectangle or the target lies outside. The logarithmic law is not covered (the thesis took the
    linear one).
    """
    grid = lattice(inputs, "funneling, actuators")
    shares = [
        _shares(at, lines, grid.slack, target.name)
        for at, lines in zip(grid.coordinates(target), (grid.rows, grid.columns), strict=True)
    ]
    return np.asarray(shares[0][grid.place[:, 0]] * shares[1][grid.place[:, 1]])


def _shares(at: float, lines: FloatArray, slack: float, name: str) -> FloatArray:
    """Linear share of each line: 1 on it, 0 on its neighbours."""
    if not lines[0] - slack <= at <= lines[-1] + slack:
        outside = max(lines[0] - at, at - lines[-1])
        raise GeometryError(f"funneling: target '{name}' lies {outside:.3g} m outside the actuators' rectangle")
    return np.array([np.interp(at, lines, unit) for unit in np.eye(len(lines))])


@dataclass(frozen=True)
class Funneling:
    """Funneling renderer, eq. 5, 6 and 8 of de Vlam 2022: s_q(t) = A_q w(t).

    ``amplitude`` [V, or G's drive unit] is A. The drive is cut to the bins where the target's row of G is
    known, as in the other renderers, so that their displacements compare; an actuator never measured there
    stays silent.
    """

    amplitude: float = 1.0
    name: str = "funneling"

    def aim(self, placed: Placed, target: str, wavelet: ComplexArray) -> Aim:
        """Drive spectra towards output ``target``; ``wavelet`` (n_bins,) [1/Hz]."""
        row = placed.row(target)
        weights = funneling_weights(placed.inputs, placed.outputs[row])
        used = known_bins(placed, [row])
        weights = np.where(absent_inputs(placed, [row]), 0, weights)
        spectrum = self.amplitude * weights * np.where(used, wavelet, 0)[:, None]
        return Aim(np.asarray(spectrum, dtype=complex), used)


def known_bins(placed: Placed, rows: list[int]) -> BoolArray:
    """Bins (n_bins,) on which G is valid between ``rows`` and every input that is known there at all.

    Raises DataError if there is none.
    """
    valid = placed.bins.valid[:, rows]
    used = valid[:, :, ~absent_inputs(placed, rows)].all(axis=(1, 2))
    if not used.any() or absent_inputs(placed, rows).all():
        names = ", ".join(placed.outputs[r].name for r in rows)
        raise DataError(f"G is marked invalid on every bin for output(s) {names}; choose others or measure again")
    return np.asarray(used)


def absent_inputs(placed: Placed, rows: list[int]) -> BoolArray:
    """Inputs (n_in,) whose column of G is never valid in ``rows``: they cannot be aimed and stay silent."""
    return np.asarray(~placed.bins.valid[:, rows].any(axis=(0, 1)))
