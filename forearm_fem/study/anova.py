"""Repeated-measures analysis of variance with one or two within-subject factors, corrected for sphericity.

Each effect is a set of orthonormal contrasts of the cell means; its error is the scatter of the subjects about the mean
contrast (Maxwell, Delaney and Kelley, Designing Experiments and Analyzing Data, ch. 13). Corrections are those of R's
car and afex; epsilon of an interaction comes from the covariance of the interaction's own contrasts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy import linalg, stats

from ..errors import DataError
from ..typing import FloatArray

ROUNDING = 1e-12  # of the answers' size: smaller differences are none


@dataclass(frozen=True)
class Effect:
    """One line of the table of an analysis of variance.

    ``df`` and ``df_error`` are uncorrected; ``p`` is the uncorrected probability, ``p_gg`` and ``p_hf`` those with both
    degrees of freedom multiplied with ``gg`` (Greenhouse and Geisser) and ``hf`` (Huynh and Feldt, at most 1).
    ``partial_eta2`` and ``generalised_eta2`` (Olejnik and Algina 2003, all factors manipulated) are effect sizes.

    Two subjects tell nothing of sphericity: of several contrasts ``gg`` is then its least value whatever they answer,
    and ``hf``, which takes that for an estimate, is 0 / 0: NaN. Where neither effect nor error vary, ``f``, all p and
    ``partial_eta2`` are NaN.
    """

    name: str
    df: float
    df_error: float
    f: float
    p: float
    gg: float
    p_gg: float
    hf: float
    p_hf: float
    partial_eta2: float
    generalised_eta2: float

    def corrected(self, sphericity: str) -> tuple[float, float, float]:
        """Degrees of freedom of effect and error, and the probability, by "Greenhouse-Geisser" or "Huynh-Feldt"."""
        epsilon, p = (self.gg, self.p_gg) if sphericity == "Greenhouse-Geisser" else (min(self.hf, 1.0), self.p_hf)
        return epsilon * self.df, epsilon * self.df_error, p


def repeated_measures(values: FloatArray, factors: Sequence[str]) -> tuple[Effect, ...]:
    """Effects of within-subject factors: ``values`` (n_subject, levels of the first factor[, of the second ...]).

    One value per subject and cell (average repetitions before: they are no further subjects). Raises DataError for
    missing values, fewer than two subjects, a factor with one level, or no variation at all.
    """
    cells = np.asarray(values, dtype=float)
    if cells.ndim != len(factors) + 1 or min(cells.shape[1:], default=0) < 2 or len(cells) < 2:
        raise DataError(
            f"an analysis of variance over {', '.join(factors)} needs two or more subjects and levels of each factor, "
            f"got values of shape {cells.shape}"
        )
    if missing := int(np.count_nonzero(~np.isfinite(cells))):
        raise DataError(f"{missing} of {cells.size} cells are missing; leave their subjects out")
    if np.ptp(cells) == 0:
        raise DataError("all values are equal, so there is nothing to analyse")
    flat = cells.reshape(len(cells), -1)
    subsets = [some for size in range(1, len(factors) + 1) for some in combinations(range(len(factors)), size)]
    found = [_parts(flat, _contrasts(cells.shape[1:], some)) for some in subsets]
    names = [" x ".join(factors[i] for i in some) for some in subsets]
    between = flat.shape[1] * float(np.sum((flat.mean(axis=1) - flat.mean()) ** 2))
    errors = between + sum(part.error for part in found)
    return tuple(_effect(name, part, errors) for name, part in zip(names, found, strict=True))


@dataclass(frozen=True)
class _Parts:
    """Sums of squares of an effect and of its error, and the covariance (d, d) of its contrasts over n subjects."""

    effect: float
    error: float
    covariance: FloatArray
    subjects: int


def _contrasts(levels: tuple[int, ...], chosen: tuple[int, ...]) -> FloatArray:
    """Orthonormal contrasts (cells, d) of the ``chosen`` factors, averaged over the others."""
    result = np.ones((1, 1))
    for factor, count in enumerate(levels):
        part = linalg.null_space(np.ones((1, count))) if factor in chosen else np.full((count, 1), count**-0.5)
        result = np.kron(result, part)
    return result


def _parts(flat: FloatArray, contrasts: FloatArray) -> _Parts:
    """Sums of squares of the scores on ``contrasts``; those that only rounding has made are zero."""
    scores = flat @ contrasts
    mean = scores.mean(axis=0)
    apart = scores - mean
    effect, error, least = len(flat) * float(mean @ mean), float(np.sum(apart**2)), ROUNDING**2 * float(np.sum(flat**2))
    if error <= least:
        apart, error = np.zeros_like(apart), 0.0
    return _Parts(effect if effect > least else 0.0, error, apart.T @ apart / (len(flat) - 1), len(flat))


def _effect(name: str, part: _Parts, errors: float) -> Effect:
    d, n = len(part.covariance), part.subjects
    df, df_error = float(d), float(d * (n - 1))
    f = _ratio(part.effect / df, part.error / df_error)
    gg, hf = _epsilons(part)

    def p(epsilon: float) -> float:
        """Probability of F with degrees of freedom times ``epsilon``."""
        return float(stats.f.sf(f, epsilon * df, epsilon * df_error))

    return Effect(
        name, df, df_error, f, p(1.0), gg, p(gg), hf, p(min(hf, 1.0)),
        _ratio(part.effect, part.effect + part.error), _ratio(part.effect, part.effect + errors),
    )  # fmt: skip


def _ratio(above: float, below: float) -> float:
    """``above`` / ``below``, both zero or more: infinite over zero, NaN for zero over zero."""
    return above / below if below > 0 else float("inf") if above > 0 else float("nan")


def _epsilons(part: _Parts) -> tuple[float, float]:
    """Greenhouse and Geisser's epsilon tr(S)^2 / (d tr(S^2)), and Huynh and Feldt's from it.

    The latter grows without bound as d gg nears n - 1, its most: 1 there. With two subjects d gg is 1 whatever they
    answer, and it is 0 / 0: NaN, but for a single contrast, which needs no correction.
    """
    d, n, s = len(part.covariance), part.subjects, part.covariance
    square = float(np.sum(s * s))
    gg = float(np.trace(s)) ** 2 / (d * square) if square > 0 else 1.0
    if d == 1:
        return 1.0, 1.0
    if n == 2:
        return gg, float("nan")
    room = n - 1 - d * gg
    return gg, (n * d * gg - 2) / (d * room) if room > 0 else 1.0
