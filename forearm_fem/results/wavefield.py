"""Displacement of the whole limb from the reduced basis: any drive, frequency or instant, no new solve."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from ..store.record import dims
from ..typing import ComplexArray, FloatArray


@dataclass(frozen=True, eq=False)
class Wavefield:
    """Modes at the mesh vertices and in the middles of the skin's edges, and their amplitudes per drive.

    ``modes`` (n_point, 3, r) [-]; ``amplitudes`` (n_frequency, r, n_input) [m per unit drive], device included;
    ``frequency`` (n_frequency,) [Hz]. Between these points nothing is kept. In its file ``wavefield.nc`` the
    last two are in single precision: 1e-7, far below the model's own error.
    """

    kind: ClassVar[str] = "wavefield"
    version: ClassVar[int] = 1

    frequency: FloatArray = field(metadata=dims("frequency", units="Hz"))
    modes: FloatArray = field(metadata=dims("point xyz mode", single=True))
    amplitudes: ComplexArray = field(metadata=dims("frequency mode input", single=True))

    def in_time(self, spectrum: ComplexArray, times: FloatArray) -> FloatArray:
        """Displacement (n_time, n_point, 3) [m] at ``times`` [s].

        ``spectrum`` (n_input, n_frequency) holds Fourier-series amplitudes of the drives on this object's bins: the
        drive is Re sum_f 2 spectrum_f exp(2 pi i f t), as irfft(spectrum * n) gives.
        """
        states = np.einsum("fri,if->fr", self.amplitudes, spectrum)
        phases = np.exp(2j * np.pi * np.outer(times, self.frequency))
        return np.asarray(np.einsum("pcr,tr->tpc", self.modes, 2 * (phases @ states).real, optimize=True))
