"""The measurement that would tell most beside those made: which point, in which band, shrinks the widest interval.

At the fitted values the information of data is J^T J, J their whitened derivatives; a candidate adds its own, its noise
as much larger than stated as the misfit of the data was. What it leaves of the widest interval follows without
measuring it, as long as the model is near linear there. What the model errs by stays in the interval as it is.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...typing import ComplexArray, FloatArray
from .fit import FitResult, adjusted, is_calibration

_STEP = 1e-3  # of the allowed range, for central differences
_ROUNDING = 1e-14  # of the largest variance
_WORTH = 0.9  # of the interval's width: a candidate that leaves more is not worth naming


@dataclass(frozen=True, eq=False)
class PossibleMeasurement:
    """A measurement that could be made: ``output`` under all inputs at the ``rows`` of the frequencies asked."""

    output: str
    rows: slice
    band: tuple[float, float]

    @property
    def words(self) -> str:
        """For a sentence."""
        return f"point {self.output} at {self.band[0]:.0f}-{self.band[1]:.0f} Hz"


@dataclass(frozen=True, eq=False)
class NextBest:
    """The ``candidate`` that shrinks the interval of ``parameter``, the widest, to ``share`` of its width [-]."""

    parameter: str
    candidate: PossibleMeasurement
    share: float

    @property
    def sentence(self) -> str:
        """Advice on the next measurement, or that nothing of this kind helps."""
        if self.share > _WORTH:
            return (
                f"next: no point and band asked about shrinks the widest interval, that of {self.parameter}, by a "
                "tenth; repeat what was measured, take a finer model where its error is most, or fix the parameter"
            )
        return (
            f"next best measurement: {self.candidate.words}; the widest interval, that of {self.parameter}, would "
            f"shrink to {100 * self.share:.0f} % of its width"
        )


Answer = Callable[[Mapping[str, float]], ComplexArray]


def candidates_of(frequency: FloatArray, outputs: Sequence[str], bands: int = 3) -> tuple[PossibleMeasurement, ...]:
    """Every output in every one of ``bands`` with equally many of the ``frequency`` (n,) [Hz]."""
    ends = np.linspace(0, len(frequency), min(bands, len(frequency)) + 1).astype(int)
    return tuple(
        PossibleMeasurement(name, slice(a, b), (float(frequency[a]), float(frequency[b - 1])))
        for name in outputs
        for a, b in zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True)
    )


def next_best(
    result: FitResult, answer: Answer, frequency: FloatArray, outputs: Sequence[str], inputs: Sequence[str],
    noise: float, bands: int = 3,
) -> NextBest:  # fmt: skip
    """Best next measurement after a fit.

    ``answer`` gives G (n, n_output, n_input) of all ``outputs`` and ``inputs`` at ``frequency`` (n,) [Hz] for values by
    name, without scale, gains and delay; ``noise`` is the standard deviation of one entry as the data of ``result``
    state theirs, or as the fit took it where they state none, in G's unit. The widest interval is that which is
    largest beside its parameter's allowed range.
    """
    span = np.array([p.span for p in result.parameters])
    before = result.covariance / np.outer(span, span)
    kept = np.zeros_like(before) if result.systematic is None else result.systematic / np.outer(span, span)
    widest = int(np.argmax(np.diag(before)))
    spreads, directions = np.linalg.eigh(before - kept)
    spreads = np.maximum(spreads, _ROUNDING * spreads[-1])
    known = (directions / spreads) @ directions.T
    slopes = _slopes(result, answer, frequency, inputs) * (math.sqrt(2) / (noise * max(result.scatter, _ROUNDING)))
    best: tuple[float, PossibleMeasurement] | None = None
    for candidate in candidates_of(frequency, outputs, bands):
        part = slopes[:, candidate.rows, list(outputs).index(candidate.output)].reshape(len(span), -1)
        told = (part @ part.conj().T).real
        after = np.linalg.inv(known + told) + kept
        share = math.sqrt(float(after[widest, widest] / before[widest, widest]))
        if best is None or share < best[0]:
            best = share, candidate
    assert best is not None
    return NextBest(result.parameters[widest].name, best[1], min(best[0], 1.0))


def _slopes(result: FitResult, answer: Answer, frequency: FloatArray, inputs: Sequence[str]) -> ComplexArray:
    """Derivatives (k, n, n_output, n_input) of G by each parameter over its allowed range."""
    values, omega = dict(result.values), 2 * np.pi * np.asarray(frequency)

    def whole(changed: Mapping[str, float]) -> ComplexArray:
        """G of the model at ``changed`` values, scale and delay included."""
        g = answer({n: v for n, v in changed.items() if not is_calibration(n)})
        return adjusted(g, changed, omega, inputs)

    rows = []
    for p in result.parameters:
        at = p.to_unit(values[p.name])
        both = [whole({**values, p.name: p.from_unit(at + step)}) for step in (_STEP, -_STEP)]
        rows.append((both[0] - both[1]) / (2 * _STEP))
    return np.array(rows)
