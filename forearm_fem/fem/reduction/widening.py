"""Directions that a reduced model lacks for other moduli, from what its residuals there leave."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from ...typing import ComplexArray, FloatArray
from ..assembly.model import ForearmModel
from ..assembly.operator import AffineOperator, WeightedSum
from ..kernels.compiled import in_threads
from ..linear.direct import watched
from .affine import AffineReduced, combined, with_last_columns
from .basis import rough_extension

# What one term after the other is multiplied with, storage and loss: of shear, of masses and sheets.
_SHEAR, _OTHER = ((3.0, 1.0), (1 / 3, 1.0), (1.0, 0.25)), ((1.5, 1.5),)
_PLACES = (0.15, 0.55)  # parts of the band
_KEPT = 0.5  # of the residuals, the strongest: the others cost as much and tell little
_AT_ONCE = 16  # columns that are worked with together
_DROP = 3e-2  # of a direction's length: weaker ones are known


def lacking_directions(
    model: ForearmModel, reduced: AffineReduced, frequency: FloatArray, solve: Callable[[FloatArray], FloatArray]
) -> NDArray[np.float32]:
    """Columns (n, k) that ``reduced`` lacks for other moduli, as its residuals r there tell: P^-1 r.

    ``solve`` gives P^-1 b for real b (n, k), P the stiffness at a real rate. Forces on contacts alone are looked at: an
    error is that of two states multiplied.
    """
    rest = _residuals(model, reduced, frequency)
    values, vectors = np.linalg.eigh((rest.T @ rest).astype(float))
    count = min(int(np.ceil(_KEPT * rest.shape[1])), int(np.sum(values > 0)))
    found = rest @ vectors[:, len(values) - count :].astype(np.float32)
    del rest  # a third of the basis, and solves need room of their own
    for some in (slice(k, k + _AT_ONCE) for k in range(0, count, _AT_ONCE)):
        found[:, some] = solve(found[:, some].astype(float))
    return found


def widened(model: ForearmModel, reduced: AffineReduced, lacking: NDArray[np.float32]) -> AffineReduced:
    """``reduced``, and behind its columns the ``lacking`` ones.

    For other moduli the wider model errs a half to a tenth as much as the first, and the change between the two is the
    measure of that.
    """
    added = rough_extension(reduced.basis, [lacking], model.operator.n_displacements, drop=_DROP)
    return with_last_columns(reduced, model, np.hstack(added))


def _residuals(model: ForearmModel, reduced: AffineReduced, frequency: FloatArray) -> NDArray[np.float32]:
    """Residuals (n, 2 n_force n_modulus), real parts, then imaginary ones, of forces that make displacements of unit
    length."""
    operator, loaded = model.operator, watched(model)[1]
    moduli = list(_other_moduli(operator, frequency))
    rest, width = np.empty((operator.n, 2 * len(loaded) * len(moduli)), np.float32), 2 * len(loaded)
    together = max(1, _AT_ONCE // width)  # moduli whose solutions are combined in one pass over the basis
    for k in range(0, len(moduli), together):
        some = moduli[k : k + together]
        states = in_threads(lambda theta: _states(reduced, theta, loaded), some)
        columns = reduced.basis.combination(np.hstack([part for x in states for part in (x.real, x.imag)]))
        for t, (theta, parts) in enumerate(zip(some, np.split(columns, len(some), axis=1), strict=True), start=k):
            real, imaginary = np.hsplit(parts, 2)
            x = real + 1j * imaginary
            left = model.functionals[:, loaded] - WeightedSum(operator.matrices, theta).product(x)
            left /= np.linalg.norm(x[: operator.n_displacements], axis=0)
            rest[:, t * width : (t + 1) * width] = np.hstack([left.real, left.imag])
    return rest


def _states(reduced: AffineReduced, theta: ComplexArray, loaded: Sequence[int]) -> ComplexArray:
    """Reduced solutions (r, n_force) where the terms have the coefficients ``theta``."""
    forces = reduced.functionals[:, loaded].astype(complex)
    matrix = combined(theta, reduced.matrices.reshape(len(theta), -1)).reshape((reduced.size,) * 2)
    return np.asarray(np.linalg.solve(matrix, forces))


def _other_moduli(operator: AffineOperator, frequency: FloatArray) -> Iterator[ComplexArray]:
    """Coefficients (n_term,) with one term after the other changed, at each place of the band; a tissue's fibres with
    its shear."""
    for place in _PLACES:
        omega = 2 * np.pi * frequency[int(place * (len(frequency) - 1))]
        own = np.array([complex(t.coefficient.at(np.array(omega))) for t in operator.terms])
        for k, term in enumerate(operator.terms):
            for kept, lost in _factors(term.name) if own[k] else ():
                theta = own.copy()
                alike = [k, *(j for j, t in enumerate(operator.terms) if t.name == _fibres_beside(term.name))]
                theta[alike] = kept * own[alike].real + 1j * lost * own[alike].imag
                yield theta


def _fibres_beside(name: str) -> str:
    """Name of the term that follows the same modulus as one of shear; empty for others."""
    return name.replace("shear ", "fibres ", 1) if name.startswith("shear ") else ""


def _factors(name: str) -> tuple[tuple[float, float], ...]:
    kind = name.partition(" ")[0]
    return _SHEAR if kind == "shear" else _OTHER if kind in ("mass", "skin", "patch") else ()
