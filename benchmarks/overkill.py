"""What runs' G and S err by, held against a much finer mesh of the same scene, beside what each run states of itself.

    forearm-fem run thesis --out results/thesis
    forearm-fem run thesis --until solve --out results/finer \
        --set accuracy=0.007 --set solver.discretisation_estimate=false
    python3 benchmarks/overkill.py results/thesis [another run ...] results/finer

Writes benchmarks/results/overkill.csv and prints it. What is stated is of all sources together. The finer mesh errs,
too: its share is unknown and is not taken off. Where the limb is cut is in the truth only as far as the run's accuracy
cuts it shorter than the finer one.
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from forearm_fem.engines.simulation import render_transfer
from forearm_fem.results.files import read_transfer
from forearm_fem.scenario import parse_scenario
from forearm_fem.store.text import read_json
from forearm_fem.transfer import (
    TransferMatrix,
    band_error,
    entry_band_errors,
    relative_error,
    relative_error_at,
    total_error,
)

SHOWN = (20.0, 60.0, 100.0, 250.0, 400.0, 500.0)  # Hz
COLUMNS = ("what", "true", "stated", "run", "finer")


def rows(run: Path, finer: Path) -> Iterator[tuple[str, float, float]]:
    """What, true error, stated error; each relative (e_band, e(f), S)."""
    coarse, fine = (read_transfer(folder / "transfer.nc") for folder in (run, finer))
    yield "G over the band", band_error(coarse.values, fine.values), total_error(coarse.errors)
    true = relative_error(coarse.values, fine.values)
    stated = np.sqrt(sum(relative_error_at(e, coarse.frequency) ** 2 for e in coarse.errors))
    for f in SHOWN:
        at = int(np.argmin(np.abs(coarse.frequency - f)))
        yield f"G at {f:g} Hz", float(true[at]), float(stated[at])
    yield "frequencies stated below half of the truth", float(np.mean(stated < true / 2)), 0.0
    own, off = entry_band_errors(coarse), np.linalg.norm(coarse.values - fine.values, axis=0)
    entries = off / np.linalg.norm(coarse.values, axis=0)
    yield "entries of G, median", float(np.median(entries)), float(np.median(own))
    yield "entries of G, worst", float(entries.max()), float(own.max())
    yield "entry of G, least stated over true", 1.0, float((own / entries).min())
    yield from _strengths(run, coarse, fine)


def _strengths(run: Path, coarse: TransferMatrix, fine: TransferMatrix) -> Iterator[tuple[str, float, float]]:
    scenario = parse_scenario(read_json(run / "scenario.json"))
    s, exact = (render_transfer(scenario, g).strengths for g in (coarse, fine))
    account = read_json(run / "signal_strength.json")["methods"]
    low, high = (np.array([[t[end] for t in m.values()] for m in account.values()]) for end in ("low", "high"))
    off, width = np.abs(s / exact - 1), np.maximum(high / s, s / low) - 1
    yield "S, worst", float(off.max()), float(width.max())
    yield "S, median", float(np.median(off)), float(np.median(width))
    yield "S outside its interval", float(np.mean((exact < low) | (exact > high))), 0.0


def _maker(folder: Path) -> str:
    account = read_json(folder / "run.json")
    return f"{account['program']}, {account['mesh']['quality']['tetrahedra']} tetrahedra"


def main() -> None:
    """Compare, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", type=Path, nargs="+")
    parser.add_argument("finer", type=Path)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results" / "overkill.csv")
    asked = parser.parse_args()
    finer = _maker(asked.finer)
    with asked.out.open("w", newline="") as stream:
        table = csv.writer(stream, lineterminator="\n")
        table.writerow(COLUMNS)
        for run in asked.runs:
            maker = _maker(run)
            print(maker)
            for what, true, stated in rows(run, asked.finer):
                table.writerow((what, f"{true:.3g}", f"{stated:.3g}", maker, finer))
                print(f"  {what:45s} true {true:.2g}  stated {stated:.2g}")


if __name__ == "__main__":
    main()
