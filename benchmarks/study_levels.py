"""Weighted levels of three methods at nine targets, as rendered and equal: results/study_levels.md and .csv.

``python benchmarks/study_levels.py STUDY.toml G [--like RESULTS]``. G is a file or a results folder. With ``--like``, a
folder of a run of the same scenario, its drives are held against a WAV at 48 kHz of the same stimulus as rendered.
"""

from __future__ import annotations

import argparse
import csv
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.io import wavfile

from forearm_fem.cli.common import transfer_file
from forearm_fem.files.read import read
from forearm_fem.show.data import Results
from forearm_fem.study.handover import at_rate, export
from forearm_fem.study.run import Made, Prepared
from forearm_fem.study.stimuli import apart, stimuli_for


def main() -> None:
    """Both tables."""
    options = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    options.add_argument("study", type=Path)
    options.add_argument("transfer", type=Path)
    options.add_argument("--like", type=Path)
    chosen = options.parse_args()
    prepared, g = Prepared.of(chosen.study), read(transfer_file(chosen.transfer))
    made = {}
    for levels in ("as rendered", "equal at target"):
        how = prepared.study.stimuli.model_copy(update={"levels": levels})
        made[levels] = stimuli_for(g, prepared.scenario, how, prepared.wavelet)
    targets, methods = prepared.study.stimuli.targets, prepared.study.stimuli.methods
    lines = ["| levels | method | " + " | ".join(targets) + " |", "|---" * (2 + len(targets)) + "|"]
    for levels, stimuli in made.items():
        for method in methods:
            row = " | ".join(f"{stimuli[method, t].moved.weighted:.1f}" for t in targets)
            lines.append(f"| {levels} | {method} | {row} |")
        worst = apart({k: s.moved for k, s in stimuli.items()})
        lines.append(f"| {levels} | methods differ by | " + " | ".join(f"{worst[t]:.1f}" for t in targets) + " |")
    name = prepared.scenario.name
    head = f"Weighted level at targets {targets[0]} to {targets[-1]} [dB re 1 um], scenario `{name}`:\n"
    out = Path(__file__).parent / "results" / "study_levels.md"
    out.write_text("\n".join([head, *lines]) + "\n", encoding="utf-8")
    print(out.read_text())
    if chosen.like is not None:
        like(chosen.like, prepared, g)


def like(folder: Path, prepared: Prepared, g) -> None:  # type: ignore[no-untyped-def]
    """Exported WAVs at 48 kHz, their gains taken off and back at the run's rate, against ``drives.nc``."""
    drives, record = Results.open(folder).drives, prepared.wavelet.record
    how, daq = prepared.study.stimuli, prepared.scenario.measurement.daq
    kept = (record.time >= -how.lead) & (record.time <= how.tail)
    inside = slice(round(daq.fade * record.sample_rate), -round(daq.fade * record.sample_rate))
    with tempfile.TemporaryDirectory() as there:
        elsewhere = replace(prepared, folder=Path(there))
        stimuli = stimuli_for(g, prepared.scenario, how, prepared.wavelet)
        out = export(elsewhere, "01", Made(g, stimuli, {}), rate=48e3, full_scale=daq.output_range)
        worst, lost = 0.0, 0.0
        with (out / "trials.csv").open() as stream:
            rows = {(r["method"], r["target"]): r for r in csv.DictReader(stream)}
        for (method, target), row in rows.items():
            _, samples = wavfile.read(out / row["wav"])
            volts = samples.T.astype(float) * daq.output_range * daq.amplifier_gain / 10 ** (float(row["gain"]) / 20)
            back = at_rate(volts, 48e3, record.sample_rate)[:, round(0.02 * record.sample_rate) :]
            whole = drives.values[drives.methods.index(method), drives.targets.index(target)]
            theirs = whole[:, kept]
            apart = np.abs(back[:, : theirs.shape[1]] - theirs)[:, inside].max() / np.abs(theirs).max()
            worst, lost = max(worst, apart), max(lost, 1 - np.sum(theirs**2) / np.sum(whole**2))
    said = f"WAV against drives.nc, {len(rows)} stimuli: {worst:.1e} of the largest drive; "
    print(said + f"the cut leaves out {lost:.1e} of a drive's energy at most")


if __name__ == "__main__":
    main()
