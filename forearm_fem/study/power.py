"""Number of participants that an effect needs, and what a pilot tells of it.

An effect is a set of d contrasts of participants' cell means. Its size is phi^2 = |mean contrast|^2 / (trace of their
covariance / d): F has then the noncentrality n phi^2. A pilot's F tells an interval of phi^2 (its distribution
inverted), and so of the power; a least effect that would matter needs the scatter alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import optimize, special, stats

from ..errors import DataError
from ..typing import FloatArray
from .analysis import FACTORS, repeated_measures

Sought = Literal["location", "method", "location x method"]


@dataclass(frozen=True)
class Size:
    """Size of an effect of ``d`` contrasts with sphericity ``epsilon``: phi^2 with the ends of its 95 % interval."""

    d: int
    epsilon: float
    phi2: float
    low: float
    high: float


@dataclass(frozen=True)
class Power:
    """Share of studies of so many participants that find the effect, and the ends of its 95 % interval."""

    participants: int
    share: float
    low: float
    high: float


def size_of_pilot(values: FloatArray, sought: Sought) -> Size:
    """The effect that a pilot's cells (n_participant, n_target, n_method) suggest, by the median of what fits its F.

    Participants without all cells are left out; DataError for fewer than three with all.
    """
    d, n, epsilon, f, _ = _effect(values, sought)
    phi2 = [_noncentrality(f, epsilon * d, epsilon * d * (n - 1), share) / (n * epsilon)
            for share in (0.5, 0.975, 0.025)]  # fmt: skip
    return Size(d, epsilon, *phi2)


def size_of_least(values: FloatArray, sought: Sought, least: float) -> Size:
    """A least effect ``least`` [unit of the measure] over a pilot's scatter, with the interval of that (chi-square).

    ``least`` is the difference between two methods (or targets), the others half way between; of the interaction, how
    much larger a difference of methods is at one target than at another.
    """
    d, n, epsilon, _, square = _effect(values, sought)
    a, b = values.shape[1:]
    phi2 = {"method": a / 2, "location": b / 2, "location x method": 1 / 4}[sought] * least**2 / square
    df = epsilon * d * (n - 1)
    low, high = (phi2 * stats.chi2.ppf(share, df) / df for share in (0.025, 0.975))
    return Size(d, epsilon, float(phi2), float(low), float(high))


def power_curve(
    size: Size, participants: Sequence[int], *, alpha: float = 0.05, studies: int = 4000
) -> tuple[Power, ...]:
    """Power of the Greenhouse-Geisser test for each number of participants.

    Contrasts of ``studies`` studies are drawn with eigenvalues of that epsilon, the effect in a random direction; the
    three sizes are tried on the same draws.
    """
    return tuple(
        Power(count, *(_share(size, phi2, count, alpha, studies) for phi2 in (size.phi2, size.low, size.high)))
        for count in participants
    )


def _share(size: Size, phi2: float, count: int, alpha: float, studies: int) -> float:
    rng, d = np.random.default_rng([size.d, count]), size.d
    spread = _eigenvalues(d, size.epsilon)
    way = rng.standard_normal((studies, d))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    mean = way * np.sqrt(phi2) + rng.standard_normal((studies, d)) * np.sqrt(spread / count)
    apart = rng.standard_normal((studies, count, d)) * np.sqrt(spread)
    apart -= apart.mean(axis=1, keepdims=True)
    square = np.einsum("snd,sne->sde", apart, apart) / (count - 1)
    trace = np.trace(square, axis1=1, axis2=2)
    epsilon = trace**2 / (d * np.sum(square**2, axis=(1, 2)))
    f = count * np.sum(mean**2, axis=1) / trace
    return float(np.mean(stats.f.sf(f, epsilon * d, epsilon * d * (count - 1)) < alpha))


def _eigenvalues(d: int, epsilon: float) -> FloatArray:
    """Geometric eigenvalues (d,) of mean 1 whose sphericity tr^2 / (d tr of squares) is ``epsilon``."""
    if d == 1 or epsilon > 1 - 1e-6:
        return np.ones(d)

    def lacks(log_ratio: float) -> float:
        """Sphericity less the one wanted."""
        values = np.exp(log_ratio * np.arange(d))
        return float(np.sum(values) ** 2 / (d * np.sum(values**2))) - epsilon

    found = np.exp(optimize.brentq(lacks, -50.0, 0.0) * np.arange(d)) if epsilon > 1 / d + 1e-6 else np.eye(d)[0]
    return np.asarray(found * d / found.sum())


def _noncentrality(f: float, df: float, error: float, share: float) -> float:
    """The noncentrality by which F is below ``f`` in that ``share`` of studies; 0 where none is so small."""
    if stats.f.cdf(f, df, error) <= share:
        return 0.0

    def beyond(nc: float) -> float:
        """Share of studies below ``f``, less the one wanted; of noncentralities too large for the series none are."""
        found = float(special.ncfdtr(df, error, nc, f))
        return (found if np.isfinite(found) else 0.0) - share

    high = 1.0 + df * f
    while beyond(high) > 0:
        high *= 2
    return float(optimize.brentq(beyond, 0.0, high, xtol=1e-8))


def _effect(values: FloatArray, sought: Sought) -> tuple[int, int, float, float, float]:
    """Contrasts d, complete participants, epsilon, F, and mean square of the scatter of a normalised contrast."""
    whole = values[np.isfinite(values).all(axis=(1, 2))]
    n, a, b = whole.shape
    if n < 3 or min(a, b) < 2:
        raise DataError(f"a pilot needs three participants who answered every cell of two methods or more at two "
                        f"targets or more, got {whole.shape}")  # fmt: skip
    row = repeated_measures(whole, FACTORS, "Huynh-Feldt").set_index("effect").loc[sought]
    f, epsilon = float(row["F"]), float(row["epsilon_hf"])
    d = {"location": a - 1, "method": b - 1, "location x method": (a - 1) * (b - 1)}[sought]
    if not np.isfinite(f):
        raise DataError("this pilot's effect has no scatter to compare it with; more participants are needed")
    own = whole - whole.mean(axis=0) - whole.mean(axis=(1, 2), keepdims=True) + whole.mean()
    by_target, by_method = own.mean(axis=2, keepdims=True), own.mean(axis=1, keepdims=True)
    square = {"location": b * by_target**2, "method": a * by_method**2,
              "location x method": (own - by_target - by_method) ** 2}[sought]  # fmt: skip
    return d, n, epsilon, f, float(np.sum(square)) / ((n - 1) * d)
