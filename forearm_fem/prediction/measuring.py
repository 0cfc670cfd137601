"""What an experimenter gets to see of a draw's G: noise, and places believed rather than true."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..ports import Port
from ..scenario import Scenario
from ..transfer import TransferMatrix
from .draws import Draw

NOISE = "signal to noise"


def believed(transfer: TransferMatrix, outputs: tuple[Port, ...], inputs: tuple[Port, ...]) -> TransferMatrix:
    """The same G with the ports where the experimenter thinks they are: renderers aim by these places."""
    return replace(transfer, outputs=outputs, inputs=inputs)


def noisy(transfer: TransferMatrix, draw: Draw, scenario: Scenario) -> TransferMatrix:
    """G as calibrated: white complex noise on every entry, alike over band and matrix.

    Its rms is that of G over band and matrix, less the draw's signal to noise [dB] of one period, less 10 log10 of the
    scenario's ``measurement.repeats``. A draw without noise (held) gives G itself. Not covered: noise that grows with
    the distance of the laser, hum, drift.
    """
    if NOISE not in draw.values:
        return transfer
    size = float(np.sqrt(np.mean(np.abs(transfer.values) ** 2)))
    rms = size * 10 ** (-draw.values[NOISE] / 20) / np.sqrt(scenario.measurement.repeats)
    normals = draw.generator("noise").standard_normal((2, *transfer.values.shape)) / np.sqrt(2)
    return replace(transfer, values=transfer.values + rms * (normals[0] + 1j * normals[1]))
