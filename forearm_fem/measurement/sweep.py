"""The exponential sine sweep of the calibration, and which bins of a record carry its energy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.fft import rfft, rfftfreq
from scipy.signal.windows import tukey

from ..errors import ScenarioError
from ..scenario import Scenario
from ..scenario.sweep import Band
from ..typing import BoolArray, FloatArray


@dataclass(frozen=True)
class ExponentialSweep:
    """x(t) = A sin(2 pi f1 T / ln(f2/f1) ((f2/f1)^(t/T) - 1)), t in [0, T) (Farina 2000; de Vlam 2022, III.B).

    ``amplitude`` A [V]; ``taper`` is the part of T faded in and out by half a cosine each, which keeps the
    jump from f2 back to f1 between repeats from clicking. |X|^2 falls like 1/f.
    """

    f_min: float = 10.0
    f_max: float = 500.0
    duration: float = 2.0
    sample_rate: float = 10000.0
    amplitude: float = 1.0
    taper: float = 0.01

    def __post_init__(self) -> None:
        if not 0 < self.f_min < self.f_max <= self.sample_rate / 2:
            raise ScenarioError(
                f"a sweep needs 0 < f_min < f_max <= {self.sample_rate / 2:g} Hz, "
                f"got {self.f_min:g} to {self.f_max:g} Hz"
            )
        if abs(self.n - self.duration * self.sample_rate) > 1e-6 or self.n < 16:
            raise ScenarioError(
                f"a sweep needs a whole number of at least 16 samples, got "
                f"{self.duration:g} s at {self.sample_rate:g} Hz"
            )

    @classmethod
    def of(cls, scenario: Scenario) -> Self:
        """The sweep that a scenario's ``sweep`` and ``measurement`` ask for."""
        band, how = scenario.sweep, scenario.measurement
        if not isinstance(band, Band):
            raise ScenarioError("sweep.frequencies: a calibration sweeps a band; give sweep.f_min and f_max instead")
        return cls(band.f_min, band.f_max, band.duration, band.sample_rate, how.amplitude, how.taper)

    @property
    def n(self) -> int:
        """Number of samples of one period."""
        return round(self.duration * self.sample_rate)

    @property
    def frequency(self) -> FloatArray:
        """One-sided bins of one period (n // 2 + 1,) [Hz]."""
        return np.asarray(rfftfreq(self.n, 1 / self.sample_rate))

    def samples(self) -> FloatArray:
        """One period (n,) [V]."""
        t = np.arange(self.n) / self.sample_rate
        rate = np.log(self.f_max / self.f_min)
        phase = 2 * np.pi * self.f_min * self.duration / rate * np.expm1(rate * t / self.duration)
        return np.asarray(self.amplitude * np.sin(phase) * tukey(self.n, 2 * self.taper, sym=False))

    def train(self, periods: int) -> FloatArray:
        """``periods`` sweeps without a pause (periods * n,) [V]."""
        return np.tile(self.samples(), periods)


def excited(drive: FloatArray, sample_rate: float, band: tuple[float, float], floor: float) -> BoolArray:
    """Bins (n // 2 + 1,) inside ``band`` [Hz] where |X| of one period ``drive`` (n,) exceeds ``floor``
    times its largest inside the band; all the others carried no energy worth dividing by."""
    frequency = rfftfreq(len(drive), 1 / sample_rate)
    inside = (frequency >= band[0] - 1e-9) & (frequency <= band[1] + 1e-9) & (frequency > 0)
    size = np.abs(rfft(drive))
    if not inside.any():
        return np.asarray(inside)
    return np.asarray(inside & (size > floor * size[inside].max()))
