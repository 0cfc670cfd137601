"""Displacement of the whole limb from the reduced basis: any drive, frequency or instant, no new solve."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import DataError
from ..store.folder import write_bytes
from ..typing import ComplexArray, FloatArray


@dataclass(frozen=True)
class Wavefield:
    """Modes at the mesh vertices and in the middles of the skin's edges, and their amplitudes per drive.

    ``modes`` (n_point, 3, r) [-]; ``amplitudes`` (n_frequency, r, n_input) [m per unit drive], device included;
    ``frequency`` (n_frequency,) [Hz]. Between these points nothing is kept.
    """

    frequency: FloatArray
    modes: FloatArray
    amplitudes: ComplexArray

    def in_time(self, spectrum: ComplexArray, times: FloatArray) -> FloatArray:
        """Displacement (n_time, n_point, 3) [m] at ``times`` [s].

        ``spectrum`` (n_input, n_frequency) holds Fourier-series amplitudes of the drives on this object's bins: the
        drive is Re sum_f 2 spectrum_f exp(2 pi i f t), as irfft(spectrum * n) gives.
        """
        states = np.einsum("fri,if->fr", self.amplitudes, spectrum)
        phases = np.exp(2j * np.pi * np.outer(times, self.frequency))
        return np.asarray(np.einsum("pcr,tr->tpc", self.modes, 2 * (phases @ states).real, optimize=True))


def save_wavefield(field: Wavefield, path: Path) -> None:
    """Write atomically in single precision (relative error 1e-7, far below the model's own)."""
    memory = io.BytesIO()
    np.savez(
        memory,
        frequency=field.frequency,
        modes=field.modes.astype(np.float32),
        amplitudes=field.amplitudes.astype(np.complex64),
    )
    write_bytes(path, memory.getvalue())


def load_wavefield(path: Path) -> Wavefield:
    """Read what :func:`save_wavefield` wrote; raises DataError for a missing or damaged file."""
    try:
        with np.load(io.BytesIO(path.read_bytes())) as store:
            return Wavefield(
                store["frequency"], store["modes"].astype(float), store["amplitudes"].astype(np.complex128)
            )
    except FileNotFoundError:
        raise DataError(f"{path}: no such file; `forearm-fem run` makes it") from None
    except Exception as problem:  # zip, npy and zlib each fail in their own way
        said = str(problem)[:120]
        raise DataError(f"{path}: not a readable wavefield ({said}); `forearm-fem run` makes it") from None
