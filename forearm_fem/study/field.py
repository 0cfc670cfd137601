"""The skin around the device as a participant feels it: everywhere with a simulated field, else at the grid points."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.fft import rfft

from ..errors import DataError
from ..geometry.mesh.topology import vertex_areas
from ..rendering.spectrum import place_on_bins
from ..show.data import Results
from ..show.patch import volar_patch
from ..transfer import TransferMatrix
from ..typing import ComplexArray, FloatArray


@dataclass(frozen=True, eq=False)
class SkinField:
    """Normal displacement of the skin per volt on each actuator.

    At ``places`` (n, 2) [m], each standing for ``area`` (n,) [m2], it is ``modes`` (n, r) times ``amplitudes``
    (n_frequency, r, n_input) [m/V] at ``frequency`` (n_frequency,) [Hz]. ``whole`` tells whether the skin between the
    grid points and under the actuators is among the places. Tangential motion is left out.
    """

    places: FloatArray
    area: FloatArray
    frequency: FloatArray
    modes: FloatArray
    amplitudes: ComplexArray
    whole: bool

    def energy(
        self, signals: FloatArray, sample_rate: float, duration: float, channels: Callable[[FloatArray], FloatArray]
    ) -> FloatArray:
        """Integral over time of the squared weighted displacement (n_channel, n) [m2 s] while ``signals`` (n_input, m)
        [V] play.

        ``channels`` weights frequencies (n_bin,) [Hz], giving (n_channel, n_bin). By Parseval on a record of
        ``duration`` [s], which must be long enough for the skin to come to rest.
        """
        bins = place_on_bins(self.frequency, self.amplitudes, sample_rate, duration)
        spectrum = rfft(signals, bins.record.n, axis=1)[:, bins.index] / sample_rate
        states = np.einsum("fri,if->fr", bins.values, spectrum)
        found = []
        for weight in channels(bins.frequency):
            part = weight[:, None] * states
            together = part.real.T @ part.real + part.imag.T @ part.imag  # (r, r)
            found.append(2 * bins.record.df * np.einsum("pr,pr->p", self.modes @ together, self.modes))
        return np.maximum(found, 0.0)


def grid_field(transfer: TransferMatrix) -> SkinField:
    """Only what G tells: the grid points; what G does not know does not move."""
    places = np.array([p.position[:2] for p in transfer.outputs])
    known = np.isfinite(transfer.values) if transfer.valid is None else transfer.valid & np.isfinite(transfer.values)
    values = np.where(known, transfer.values, 0.0)
    n = len(places)
    return SkinField(places, np.ones(n), transfer.frequency, np.eye(n), values, whole=False)


def field_for(source: str | Path) -> SkinField | None:
    """The simulated field of a results folder that keeps one; None for files and other folders."""
    kept = Path(source).is_dir() and Results.open(source).has_field
    return simulated_field(source) if kept else None


def simulated_field(folder: str | Path) -> SkinField:
    """The skin around the device in a results folder of the finite elements, 8 mm beyond its ports.

    Raises DataError where the folder keeps no wavefield (the layered twin, measured G, direct sweeps).
    """
    results = Results.open(folder)
    if not results.has_field:
        raise DataError(f"{folder}: keeps no wavefield, so the skin between the grid points is unknown; solve with fem")
    transfer = results.transfer
    patch = volar_patch(results.field_mesh, [*transfer.outputs, *transfer.inputs], margin=8e-3)
    field = patch.normal_field(results.wavefield)
    area = vertex_areas(patch.points, patch.triangles)
    kept = area > 0
    return SkinField(
        patch.points[kept, :2], area[kept], field.frequency, field.modes[kept], field.amplitudes, whole=True
    )
