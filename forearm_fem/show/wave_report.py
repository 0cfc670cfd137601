"""Report of a scene that renders nothing: how waves travel and decay from one contact, and the twin beside it."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from .. import __version__
from ..accuracy.estimates import accuracy_verdict
from ..device import close_loop
from ..engines.layered import solve_layered
from ..errors import ForearmError
from ..metrics import fit_waves
from ..metrics.waves import WaveFit, beside
from ..ports import distances
from ..scenario import Scenario
from ..scenario.limb import SlabLimb
from ..store.folder import write_text
from ..transfer import TransferMatrix, relative_error, size_words
from ..typing import FloatArray
from .page import Block, Page, Section

_SAME = 1e-6  # m: between the distances of two points of a line


def write_wave_report(
    scenario: Scenario, transfer: TransferMatrix, out: Path, *, notes: Sequence[str] = ()
) -> tuple[Path, Path]:
    """``report.md``, ``report.html`` and, where a line of points allows it, ``waves.csv`` with attenuation and speed.

    Verdict on the accuracy first, ``notes`` of the run last.
    """
    blocks = []
    if (fit := thesis_fit(transfer, scenario.device.first_in_contact)) is not None:
        write_text(out / "waves.csv", waves_csv(fit))
        some = np.unique(np.linspace(0, len(fit.frequency) - 1, min(10, len(fit.frequency))).astype(int))
        rows = [[f"{fit.frequency[k]:g}", f"{fit.attenuation[k]:.0f}", f"{fit.speed[k]:.2f}"] for k in some]
        waves = Block(["Hz", "attenuation 1/m", "speed m/s"], rows)
        blocks.append(Section("waves", "Attenuation and speed by the thesis' estimator (waves.csv)", waves))
    if isinstance(scenario.limb, SlabLimb) and scenario.device.drive == "force":
        blocks.append(Section("layered", "Beside the layered model", _twin(scenario, transfer)))
    errors = [[e.source, size_words(e.band), size_words(e.worst), e.method] for e in transfer.errors]
    sections = [
        *blocks,
        Section("warnings", "Warnings", bullets=list(dict.fromkeys(notes)), warn=True),
        Section("errors", "Estimated errors of G", Block(["source", "e_band", "worst e(f)", "how"], errors)),
    ]
    answer = [f"Accuracy: {accuracy_verdict(scenario, transfer.errors)}."]
    page = Page(f"Run of scene {scenario.name}", answer, sections, f"forearm_fem {__version__}", scenario.description)
    html, plain = page.save(out)
    return plain, html


def thesis_fit(transfer: TransferMatrix, source: int = 0) -> WaveFit | None:
    """Appendix A's estimator over the points beside the contact ``source``; None for fewer than four, or no line."""
    distance = distances(transfer.outputs, transfer.inputs)[:, source]
    outside = np.flatnonzero(beside(distance, transfer.inputs[source].radius))
    order = outside[np.argsort(distance[outside])]
    if len(order) < 4 or np.diff(distance[order]).min() < _SAME:  # points abreast of each other are no line
        return None
    return fit_waves(transfer.frequency, distance[order], transfer.values[:, order, source])


def waves_csv(fit: WaveFit) -> str:
    """Lines ``frequency_hz,attenuation_per_m,speed_m_per_s``."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["frequency_hz", "attenuation_per_m", "speed_m_per_s"])
    writer.writerows(zip(fit.frequency.tolist(), fit.attenuation.tolist(), fit.speed.tolist(), strict=True))
    return stream.getvalue()


def _twin(scenario: Scenario, transfer: TransferMatrix) -> Block:
    """Table of errors against the layered model: each point relative to itself, and e(f) over all but the first."""
    try:
        truth = close_loop(solve_layered(scenario, transfer.frequency), scenario.device).values
    except ForearmError as problem:
        return Block([], [], f"The layered model cannot do this scene: {problem}")
    k = scenario.device.first_in_contact
    own: FloatArray = np.abs(transfer.values - truth)[:, :, k] / np.abs(truth[:, :, k])
    names = [f"{d * 1e3:.1f} mm" for d in distances(transfer.outputs, transfer.inputs)[:, k]]
    overall = relative_error(transfer.values[:, 1:], truth[:, 1:]) if len(names) > 1 else np.zeros(len(own))
    rows = [
        [f"{f:g}", *(f"{v:.4f}" for v in row), f"{e:.4f}"]
        for f, row, e in zip(transfer.frequency, own, overall, strict=True)
    ]
    note = "Error of each point relative to itself; e(f) relative to the largest of them."
    return Block(["Hz", *names, "e(f) beyond the first"], rows, note)
