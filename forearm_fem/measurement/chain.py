r"""Errors of a rig in G: vibrometer noise, slow motion of the arm, and gain and phase from one sweep to the next.

The one place that knows these (``[measurement.rig]``). A virtual device adds noise and motion as signals and sends them
through the estimator (:class:`Disturbance`); a prediction adds what the estimator leaves of them to G
(:func:`reported`), which a test holds to be the same. With a sensor of velocity v and a rectangular record of length T
the ratio of spectra errs by :math:`V/(i\omega X)`. Where displacement d is recorded, its jump between the ends of the
record leaks, too:

.. math:: D = \frac{V-(d(T)-d(0))}{i\omega}.

Motion is a random walk smoothed to below 3 Hz, between the pulse (about 1 Hz) and tremor (7 to 13 Hz, which a resting
forearm hardly shows).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import rfft
from scipy.signal import lfilter

from ..scenario import Scenario
from ..scenario.measurement import Quantity, RigOptions
from ..transfer import TransferMatrix
from ..typing import ComplexArray, FloatArray
from .estimators import ExponentialSweep

_MOTION = 1 / (2 * np.pi * 3.0)  # s: time constant of the arm's velocity


@dataclass
class Disturbance:
    """Vibrometer noise and motion of the arm as a signal, block by block, in what the sensor reads [m, m/s, m/s^2].

    ``motion`` of the ``rig`` is the rms way over a record of ``duration`` [s].
    """

    rig: RigOptions
    quantity: Quantity
    sample_rate: float
    duration: float
    rng: np.random.Generator
    _velocity: float = 0.0
    _way: float = 0.0

    def block(self, m: int) -> FloatArray:
        """The next ``m`` samples."""
        dt, decay = 1 / self.sample_rate, np.exp(-1 / (self.sample_rate * _MOTION))
        size = self.rig.motion / np.sqrt(2 * _MOTION * self.duration)
        steps = size * np.sqrt(1 - decay**2) * self.rng.standard_normal(m)
        moving, _ = lfilter([1.0], [1.0, -decay], steps, zi=[decay * self._velocity])
        before, self._velocity = self._velocity, float(moving[-1])
        noise = self.rig.noise * np.sqrt(self.sample_rate / 2) * self.rng.standard_normal(m)
        match self.quantity:
            case "velocity":
                return np.asarray(moving + noise)
            case "displacement":
                way = self._way + np.cumsum(moving + noise) * dt
                self._way = float(way[-1])
                return np.asarray(way)
            case "acceleration":
                return np.asarray(np.diff(moving, prepend=before) / dt + np.gradient(noise, dt))


def reported(transfer: TransferMatrix, scenario: Scenario, rng: np.random.Generator) -> TransferMatrix:
    """The G that a calibration of ``scenario`` reports where ``transfer`` is true; one rig's errors by ``rng``.

    Displacement is taken for recorded where ``measurement.sensor.quantity`` is left out, as de Vlam 2022 writes. Not
    covered: hum, speckle, and what a limited window or regularisation take off a deconvolution.
    """
    how, rig, shape = scenario.measurement, scenario.measurement.rig, transfer.values.shape
    values = with_entry_errors(transfer, rig, rng).values
    if rig.noise or rig.motion:
        omega = 2 * np.pi * transfer.frequency[:, None, None]
        flat = rig.noise**2 * scenario.sweep.duration / 2
        inside = np.sqrt(flat + rig.motion**2 / (1 + (omega * _MOTION) ** 2))
        both = rng.standard_normal((2, *shape)) / np.sqrt(2)
        way = inside * (both[0] + 1j * both[1])
        if (how.sensor.quantity or "displacement") == "displacement":
            way = way - np.sqrt(flat + rig.motion**2) * rng.standard_normal(shape[1:])
        sent = np.sqrt(how.repeats) * sweep_spectrum(scenario, transfer.frequency)
        values = values + way / (1j * omega) / sent[:, None, None]
    return replace(transfer, values=values)


def with_entry_errors(transfer: TransferMatrix, rig: RigOptions, rng: np.random.Generator) -> TransferMatrix:
    """G with the gain and phase that each entry's sweep had of its own, the same at all frequencies."""
    if not (rig.gain or rig.phase):
        return transfer
    normals = rng.standard_normal((2, *transfer.values.shape[1:]))
    return replace(transfer, values=transfer.values * np.exp(rig.gain * normals[0] + 1j * rig.phase * normals[1]))


def sweep_spectrum(scenario: Scenario, frequency: FloatArray) -> ComplexArray:
    """Fourier transform (n,) [V s] of one sweep at the bins nearest to ``frequency`` [Hz], not below
    ``measurement.energy_floor`` of its largest: such bins are masked and no drive goes there."""
    how, (low, high) = scenario.measurement, scenario.sweep.span
    low = low if low < high else 0.9 * high
    record = scenario.sweep
    sweep = ExponentialSweep(low, high, record.duration, record.sample_rate, how.amplitude, how.taper)
    bins = np.rint(frequency * record.duration).astype(int)
    found = (rfft(sweep.samples()) / record.sample_rate)[np.clip(bins, 1, sweep.n // 2)]
    size = np.abs(found)
    return np.asarray(found / size * np.maximum(size, how.energy_floor * size.max()))
