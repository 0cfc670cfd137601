"""Directions that a reduced model lacks for other moduli, from what its residuals there leave."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from ...typing import ComplexArray, FloatArray
from ..assembly.model import ForearmModel
from ..assembly.operator import WeightedSum
from ..linear.direct import watched
from .affine import AffineReduced, with_last_columns
from .basis import rough_extension

# What one term after the other is multiplied with, storage and loss: of shear, of masses and sheets.
_SHEAR, _OTHER = ((3.0, 1.0), (1 / 3, 1.0), (1.0, 0.25)), ((1.5, 1.5),)
_PLACES = (0.15, 0.55)  # parts of the band
_KEPT = 0.5  # of the residuals, the strongest: the others cost as much and tell little
_DROP = 3e-2  # of a direction's length: weaker ones are known


def widened(
    model: ForearmModel, reduced: AffineReduced, frequency: FloatArray, solve: Callable[[FloatArray], FloatArray]
) -> AffineReduced:
    """``reduced``, and behind its columns what its residuals r for other moduli ask for: P^-1 r.

    ``solve`` gives P^-1 b for real b (n, k), P the stiffness at a real rate. For other moduli the wider model errs a
    half to a tenth as much as the first, and the change between the two is the measure of that. Forces on contacts
    alone are looked at: an error is that of two states multiplied.
    """
    rest = np.hstack(list(_residuals(model, reduced, frequency)))
    values, vectors = np.linalg.eigh(rest.T @ rest)
    count = min(int(np.ceil(_KEPT * rest.shape[1])), int(np.sum(values > 0)))
    found = solve(rest @ vectors[:, len(values) - count :])
    columns = np.hstack(rough_extension(reduced.basis, [found], model.operator.n_displacements, drop=_DROP))
    return with_last_columns(reduced, model, columns.astype(float))


def _residuals(model: ForearmModel, reduced: AffineReduced, frequency: FloatArray) -> Iterator[FloatArray]:
    """Residuals (n, 2 n_force), real parts, then imaginary ones, of forces that make displacements of unit length."""
    operator, loaded = model.operator, watched(model)[1]
    for place in _PLACES:
        omega = 2 * np.pi * frequency[int(place * (len(frequency) - 1))]
        own = np.array([complex(t.coefficient.at(np.array(omega))) for t in operator.terms])
        for k, term in enumerate(operator.terms):
            for kept, lost in _factors(term.name) if own[k] else ():
                theta = own.copy()
                theta[k] = kept * own[k].real + 1j * lost * own[k].imag
                states = np.linalg.solve(
                    np.tensordot(theta, reduced.matrices, 1), reduced.functionals[:, loaded].astype(complex)
                )
                x = _combined(reduced, states)
                rest = model.functionals[:, loaded] - WeightedSum(operator.matrices, theta).product(x)
                rest = rest / np.linalg.norm(x[: operator.n_displacements], axis=0)
                yield np.hstack([rest.real, rest.imag])


def _combined(reduced: AffineReduced, states: ComplexArray) -> ComplexArray:
    """Solutions (n, k) of reduced ``states`` (r, k)."""
    real, imaginary = np.hsplit(reduced.basis.combination(np.hstack([states.real, states.imag])), 2)
    return np.asarray(real + 1j * imaginary)


def _factors(name: str) -> tuple[tuple[float, float], ...]:
    kind = name.partition(" ")[0]
    return _SHEAR if kind == "shear" else _OTHER if kind in ("mass", "skin", "patch") else ()
