"""Simulated participants: from the skin's displacement to an answer, to rehearse a study; not a prediction of people.

Three steps, few parameters, each with its source or named as assumed:

1. *Frequency weighting.* Displacement counts by the reciprocal of the detection threshold of hairy skin: U-shaped in
   frequency, -12 dB per octave below and +9 dB per octave above 220 Hz (Verrillo 1966, volar forearm, abstract; the
   absolute threshold was not seen, so levels are relative).
2. *Spatial summation.* Energy is pooled over neighbouring places with a Gaussian of ``pooling`` [m] (assumed; the
   threshold's -3 dB per doubling of area says that energy adds up, Verrillo 1966).
3. *Answer.* The place felt is the centroid of pooled energy to the power ``sharpness``, seen with normal noise of
   ``blur`` [m] each way, and shifted by the participant's own ``bias`` [m]; with probability ``lapse`` it is anywhere.
   Fewer than half of seven places 25 to 50 mm apart on the forearm are named rightly (Cholewiak and others, summary),
   which a blur of 10 to 20 mm gives. Points within ``doubt`` of the largest pooled energy are named where several may.

Nothing here was fitted to the thesis. Adaptation, masking, attention, hair and the strap's pressure are left out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import irfft, rfft, rfftfreq

from ..ports import Port
from ..typing import FloatArray
from .stimuli import Stimulus

_CORNER = 220.0  # [Hz] of the most sensitive channel; Verrillo 1966
_BELOW, _ABOVE = 12.0, 9.0  # [dB per octave]


@dataclass(frozen=True)
class Percept:
    """Parameters of a simulated participant; see the module for what they mean and where they come from."""

    pooling: float = 5e-3
    sharpness: float = 1.0
    blur: float = 12e-3
    bias: tuple[float, float] = (0.0, 0.0)
    doubt: float = 0.5
    lapse: float = 0.02
    threshold: float = 1e-7

    def varied(self, rng: np.random.Generator, spread: float = 0.25) -> Percept:
        """Another participant: parameters a factor of about 1 + ``spread`` apart, a bias of a third of the blur."""
        factor = np.exp(spread * rng.standard_normal(3))
        bias = rng.normal(scale=self.blur / 3, size=2)
        return replace(
            self,
            blur=self.blur * float(factor[0]),
            pooling=self.pooling * float(factor[1]),
            threshold=self.threshold * float(factor[2]),
            bias=(float(bias[0]), float(bias[1])),
        )


def sensitivity(frequency: FloatArray) -> FloatArray:
    """Reciprocal detection threshold of displacement (n,) [-], 1 at 220 Hz; 0 at 0 Hz."""
    f = np.asarray(frequency, dtype=float)
    octaves = np.log2(np.maximum(f, 1e-3) / _CORNER)
    level = np.where(octaves < 0, _BELOW * octaves, -_ABOVE * octaves)
    return np.asarray(np.where(f > 0, 10 ** (level / 20), 0.0))


def felt(displacement: FloatArray, sample_rate: float) -> FloatArray:
    """Weighted rms displacement (n_place,) [m] of ``displacement`` (n_place, n) [m]."""
    n = displacement.shape[1]
    weights = sensitivity(rfftfreq(n, 1 / sample_rate))
    heard = irfft(rfft(displacement, axis=1) * weights, n, axis=1)
    return np.asarray(np.sqrt(np.mean(heard**2, axis=1)))


def pooled(amplitude: FloatArray, places: FloatArray, pooling: float) -> FloatArray:
    """Energy (n,) [m2] of ``amplitude`` (n,) [m] at ``places`` (n, 2) [m], averaged over neighbours with a Gaussian."""
    apart = np.linalg.norm(places[:, None] - places[None], axis=2)
    kernel = np.exp(-((apart / pooling) ** 2) / 2)
    return np.asarray((kernel / kernel.sum(axis=1, keepdims=True)) @ amplitude**2)


class SimulatedParticipant:
    """Answers stimuli by a :class:`Percept`; ``places`` (n, 2) [m] are where the stimuli's ``moved`` is known.

    Energies are taken once per stimulus; each answer draws its own noise from ``rng``.
    """

    def __init__(
        self,
        percept: Percept,
        stimuli: Mapping[tuple[str, str], Stimulus],
        sample_rate: float,
        places: FloatArray,
        grid: Sequence[Port],
        rng: np.random.Generator,
    ) -> None:
        self.percept, self._rng = percept, rng
        self._places = np.asarray(places, dtype=float)[:, :2]
        self._names = [p.name for p in grid]
        self._grid = np.array([p.position[:2] for p in grid])
        self._energy = {
            key: pooled(felt(s.moved, sample_rate), self._places, percept.pooling) for key, s in stimuli.items()
        }

    def place(self, method: str, target: str) -> FloatArray:
        """Where a stimulus is felt in one trial (2,) [m]."""
        reach = np.ptp(self._grid, axis=0)
        if self._rng.random() < self.percept.lapse:
            return np.asarray(self._grid.min(axis=0) + self._rng.random(2) * reach)
        weights = self._energy[method, target] ** self.percept.sharpness
        centroid = weights @ self._places / weights.sum()
        return np.asarray(centroid + self.percept.bias + self._rng.normal(scale=self.percept.blur, size=2))

    def one_point(self, method: str, target: str) -> str:
        """The grid point nearest to where a stimulus is felt."""
        away = np.linalg.norm(self._grid - self.place(method, target), axis=1)
        return self._names[int(np.argmin(away))]

    def several_points(self, method: str, target: str) -> tuple[str, ...]:
        """The point felt, and all others whose pooled energy, seen from there, is within ``doubt`` of the largest."""
        centre = self.place(method, target)
        energy = self._energy[method, target]
        at_grid = np.array([energy[np.argmin(np.linalg.norm(self._places - g, axis=1))] for g in self._grid])
        near = np.exp(-(np.linalg.norm(self._grid - centre, axis=1) ** 2) / (2 * self.percept.blur**2))
        vivid = at_grid * near
        chosen = np.flatnonzero(vivid >= self.percept.doubt * vivid.max())
        return tuple(self._names[k] for k in chosen)

    def detects(self, method: str, target: str, level: float) -> bool:
        """Whether a stimulus at ``level`` [dB] is felt: Weibull of slope 3.5 of its strongest amplitude."""
        amplitude = float(np.sqrt(self._energy[method, target].max())) * 10 ** (level / 20)
        chance = 1 - np.exp(-((amplitude / self.percept.threshold) ** 3.5))
        return bool(self._rng.random() < self.percept.lapse / 2 + (1 - self.percept.lapse) * chance)
