"""Report of a scene that renders nothing: how waves travel and decay from one contact, and the twin beside it."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from html import escape
from pathlib import Path

import numpy as np

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
from ..store.text import markdown_table
from ..transfer import TransferMatrix, relative_error, size_words
from ..typing import FloatArray

_SAME = 1e-6  # m: between the distances of two points of a line


def write_wave_report(
    scenario: Scenario, transfer: TransferMatrix, out: Path, *, notes: Sequence[str] = ()
) -> tuple[Path, Path]:
    """``report.md``, ``report.html`` and, where a line of points allows it, ``waves.csv`` with attenuation and speed.

    Verdict on the accuracy first, ``notes`` of the run last.
    """
    errors = ((e.source, size_words(e.band), size_words(e.worst), e.method) for e in transfer.errors)
    parts = [
        f"# Run of scene {scenario.name}\n",
        scenario.description + "\n",
        "## Estimated errors of G\n",
        markdown_table(("source", "e_band", "worst e(f)", "how"), errors).rstrip("\n"),
        f"\nAccuracy: {accuracy_verdict(scenario, transfer.errors)}.",
    ]
    if (fit := thesis_fit(transfer, scenario.device.first_in_contact)) is not None:
        write_text(out / "waves.csv", waves_csv(fit))
        some = np.unique(np.linspace(0, len(fit.frequency) - 1, min(10, len(fit.frequency))).astype(int))
        rows = ((f"{fit.frequency[k]:g}", f"{fit.attenuation[k]:.0f}", f"{fit.speed[k]:.2f}") for k in some)
        parts.append("\n## Attenuation and speed by the thesis' estimator (waves.csv)\n")
        parts.append(markdown_table(("Hz", "attenuation 1/m", "speed m/s"), rows).rstrip("\n"))
    if isinstance(scenario.limb, SlabLimb) and scenario.device.drive == "force":
        parts += ["\n## Beside the semi-analytic half-space\n", *_twin(scenario, transfer)]
    parts += ["\n## Warnings\n", *(f"- {note}" for note in dict.fromkeys(notes))] if notes else []
    body = "\n".join(parts) + "\n"
    page, plain = out / "report.html", out / "report.md"
    write_text(plain, body)
    head = f'<head><meta charset="utf-8"><title>Run of scene {escape(scenario.name)}</title></head>'
    shown = f'<body><pre style="white-space: pre-wrap">{escape(body)}</pre></body>'  # the same text, as it stands
    write_text(page, f'<!doctype html><html lang="en">{head}{shown}</html>\n')
    return plain, page


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


def _twin(scenario: Scenario, transfer: TransferMatrix) -> list[str]:
    """Table of errors against the twin: each point relative to itself, and e(f) over all but the first."""
    try:
        truth = close_loop(solve_layered(scenario, transfer.frequency), scenario.device).values
    except ForearmError as problem:
        return [f"The twin cannot do this scene: {problem}"]
    k = scenario.device.first_in_contact
    own: FloatArray = np.abs(transfer.values - truth)[:, :, k] / np.abs(truth[:, :, k])
    names = [f"{d * 1e3:.1f} mm" for d in distances(transfer.outputs, transfer.inputs)[:, k]]
    overall = relative_error(transfer.values[:, 1:], truth[:, 1:]) if len(names) > 1 else np.zeros(len(own))
    rows = (
        [f"{f:g}", *(f"{v:.4f}" for v in row), f"{e:.4f}"]
        for f, row, e in zip(transfer.frequency, own, overall, strict=True)
    )
    table = markdown_table(("Hz", *names, "e(f) beyond the first"), rows).splitlines()
    return ["Error of each point relative to itself; e(f) relative to the largest of them.\n", *table]
