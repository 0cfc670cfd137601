"""Simulated participants: from the skin's displacement to an answer, to rehearse a study; not a prediction of people.

Four steps, few parameters, each with its source or named as assumed:

1. *Channels.* Displacement of the skin counts by the reciprocal of the detection threshold of hairy skin, in two
   channels: the Pacinian one is U-shaped in frequency, -12 dB per octave below and +9 dB per octave above 220 Hz
   (Verrillo 1966, volar forearm, abstract); the other is flat (Verrillo and Gescheider, duplex model, abstract). They
   cross at ``crossing``: on the forearm contact area mattered at 250 Hz and not from 8 to 125 Hz (Morioka, Whitehouse
   and Griffin 2008, abstract). Hairy skin has two channels below the Pacinian one (Bolanowski 1994); both
   are in the flat one here. Absolute thresholds were not seen, so levels are relative.
2. *Summation.* A stimulus counts by its energy. The Pacinian channel adds it up over a Gaussian of ``pooling`` [m]:
   3 dB per doubling of area (Verrillo 1966), up to the 2.9 cm2 that were tried; the other channel does not (Gescheider
   and others 2004, abstract). Energies of the channels add.
3. *Place.* Felt is the centroid of that energy to the power ``sharpness`` over the skin, seen with normal noise of
   ``blur`` [m] each way, and shifted by the participant's own ``bias`` [m]; with probability ``lapse`` it is anywhere.
   Fewer than half of seven places 25 to 50 mm apart on the forearm are named rightly (Cholewiak and others, summary),
   which a blur of 10 to 20 mm gives.
4. *Extent.* Where several points may be named, the energy is smeared by ``blur``, and points within ``doubt`` of its
   largest value are named (0.6: a touch on a point of a 13.3 mm grid names that point alone).

Nothing here was fitted to the thesis. Adaptation, masking, attention, hair, landmarks and the strap's pressure are left
out, and so is the skin's tangential motion.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..ports import Port
from ..typing import FloatArray
from .field import SkinField
from .stimuli import Stimulus

_BEST = 220.0  # [Hz] of the Pacinian channel; Verrillo 1966
_BELOW, _ABOVE = 12.0, 9.0  # [dB per octave]
_WINDOW = 0.2  # [s] over which a level counts; assumed, only sets the scale of ``threshold``
_SLOPE = 3.5  # Weibull, as QUEST+ assumes


@dataclass(frozen=True)
class Percept:
    """Parameters of a simulated participant; see the module for what they mean and where they come from.

    ``threshold`` [m] is the weighted rms displacement over 0.2 s that is felt in 63 % of trials; ``weber`` the scatter
    of the logarithm of felt strength (natural units).
    """

    crossing: float = 150.0
    pooling: float = 7e-3
    sharpness: float = 1.0
    blur: float = 12e-3
    bias: tuple[float, float] = (0.0, 0.0)
    doubt: float = 0.6
    lapse: float = 0.02
    threshold: float = 1e-7
    weber: float = 0.2

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


def sensitivity(frequency: FloatArray, crossing: float) -> FloatArray:
    """Reciprocal detection thresholds (2, n) [-] of the Pacinian channel, 1 at 220 Hz, and of the flat one, equal to it
    at ``crossing`` [Hz]; 0 at 0 Hz."""
    f = np.asarray(frequency, dtype=float)
    flat = np.where(f > 0, _pacinian(np.asarray(crossing, dtype=float)), 0.0)
    return np.array([np.where(f > 0, _pacinian(f), 0.0), flat])


def _pacinian(frequency: FloatArray) -> FloatArray:
    octaves = np.log2(np.maximum(frequency, 1e-3) / _BEST)
    return np.asarray(10 ** (np.where(octaves < 0, _BELOW * octaves, -_ABOVE * octaves) / 20))


@dataclass(frozen=True, eq=False)
class Felt:
    """Weighted energy (2, n) [m2 s] of each stimulus, by (method, target), at ``places`` (n, 2) [m] of ``area``."""

    places: FloatArray
    area: FloatArray
    energy: Mapping[tuple[str, str], FloatArray]

    @classmethod
    def of(
        cls, field: SkinField, stimuli: Mapping[tuple[str, str], Stimulus], sample_rate: float, duration: float,
        crossing: float = Percept.crossing,
    ) -> Felt:  # fmt: skip
        """What ``stimuli`` do to ``field``, on records of ``duration`` [s]; the same for every participant of one G."""
        energy = {
            k: field.energy(s.signals, sample_rate, duration, lambda f: sensitivity(f, crossing))
            for k, s in stimuli.items()
        }
        return cls(field.places, field.area, energy)


def pooled(energy: FloatArray, places: FloatArray, area: FloatArray, pooling: float) -> FloatArray:
    """``energy`` (..., n) at ``places`` (n, 2) [m] of ``area`` (n,), averaged over the skin with a Gaussian."""
    kernel = _gaussian(places, places, pooling) * area
    return np.asarray(energy @ (kernel / kernel.sum(axis=1, keepdims=True)).T)


def _gaussian(a: FloatArray, b: FloatArray, width: float) -> FloatArray:
    """exp(-d^2 / 2 width^2) (n_a, n_b) of the distances between points (n, 2)."""
    apart2 = np.sum(a**2, axis=1)[:, None] + np.sum(b**2, axis=1) - 2 * a @ b.T
    return np.asarray(np.exp(-np.maximum(apart2, 0.0) / (2 * width**2)))


class SimulatedParticipant:
    """Answers stimuli by a :class:`Percept`; each answer draws its own noise from ``rng``."""

    def __init__(self, percept: Percept, felt: Felt, grid: Sequence[Port], rng: np.random.Generator) -> None:
        self.percept, self._rng = percept, rng
        self._names = [p.name for p in grid]
        self._grid = np.array([p.position[:2] for p in grid])
        self._places = felt.places
        both = np.array(list(felt.energy.values()))
        summed = pooled(both[:, 0], felt.places, felt.area, percept.pooling)
        total = dict(zip(felt.energy, summed + both[:, 1], strict=True))
        self._weights = {k: felt.area * q**percept.sharpness for k, q in total.items()}
        self._strongest = {
            k: float(max(p.max(), other.max())) for k, p, other in zip(felt.energy, summed, both[:, 1], strict=True)
        }

    def place(self, method: str, target: str) -> FloatArray:
        """Where a stimulus is felt in one trial (2,) [m]."""
        reach = np.ptp(self._grid, axis=0)
        if self._rng.random() < self.percept.lapse:
            return np.asarray(self._grid.min(axis=0) + self._rng.random(2) * reach)
        return self._centroid(method, target) + self._shift()

    def one_point(self, method: str, target: str) -> str:
        """The grid point nearest to where a stimulus is felt."""
        away = np.linalg.norm(self._grid - self.place(method, target), axis=1)
        return self._names[int(np.argmin(away))]

    def several_points(self, method: str, target: str) -> tuple[str, ...]:
        """Points where the smeared and shifted energy is within ``doubt`` of its largest; any one after a lapse."""
        if self._rng.random() < self.percept.lapse:
            return (self._names[int(self._rng.integers(len(self._names)))],)
        seen = _gaussian(self._grid - self._shift(), self._places, self.percept.blur) @ self._weights[method, target]
        return tuple(n for n, v in zip(self._names, seen, strict=True) if v >= self.percept.doubt * seen.max())

    def outline(self, method: str, target: str) -> FloatArray:
        """What is drawn (24, 2) [m]: a circle about the place felt, as wide as the energy's spread and half a blur."""
        weights = self._weights[method, target]
        spread2 = weights @ np.sum((self._places - self._centroid(method, target)) ** 2, axis=1) / weights.sum() / 2
        angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
        radius = float(np.hypot(0.5 * self.percept.blur, np.sqrt(spread2)))
        return np.asarray(self.place(method, target) + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1))

    def detects(self, method: str, target: str, level: float) -> bool:
        """Whether a stimulus at ``level`` [dB] is felt: Weibull of slope 3.5 of its stronger channel's best place."""
        amplitude = self._amplitude(method, target) * 10 ** (level / 20)
        chance = 1 - np.exp(-((amplitude / self.percept.threshold) ** _SLOPE))
        return bool(self._rng.random() < self.percept.lapse / 2 + (1 - self.percept.lapse) * chance)

    def stronger(self, method: str, target: str, level: float, reference: str) -> bool:
        """Whether a stimulus at ``level`` [dB] feels stronger than ``reference`` at its own level: strengths of equal
        logarithmic scatter, ``weber`` each."""
        if self._rng.random() < self.percept.lapse:
            return bool(self._rng.random() < 0.5)
        ratio = np.log(self._amplitude(method, target) / self._amplitude(reference, target)) + np.log(10) * level / 20
        return bool(ratio + self._rng.normal(scale=np.sqrt(2) * self.percept.weber) > 0)

    def _amplitude(self, method: str, target: str) -> float:
        """Weighted rms over 0.2 s [m] at the best place."""
        return float(np.sqrt(self._strongest[method, target] / _WINDOW))

    def _centroid(self, method: str, target: str) -> FloatArray:
        weights = self._weights[method, target]
        return np.asarray(weights @ self._places / weights.sum())

    def _shift(self) -> FloatArray:
        return np.asarray(self.percept.bias) + self._rng.normal(scale=self.percept.blur, size=2)
