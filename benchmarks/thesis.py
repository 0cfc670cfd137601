"""The reduced sweep of a finished run against direct solves at bins that it did not use.

    forearm-fem run scenarios/thesis.toml
    python3 benchmarks/thesis.py scenarios/thesis.toml results/thesis --count 40

Writes benchmarks/results/thesis.csv (error, seconds of each direct solve) and prints: worst e(f) of grid points and of
contacts, seconds of one double-precision factorisation, of a direct frequency, of the direct sweep (extrapolated), and
the run's own seconds in those. Resumable: solves in the CSV are not repeated, unless
another version or mesh made them.
"""

from __future__ import annotations

import argparse
import csv
import json
import time
from pathlib import Path

import numpy as np

from forearm_fem.engines.fem import fem_model
from forearm_fem.fem.assembly.model import ForearmModel
from forearm_fem.fem.linear.direct import DirectSolver, make_solver
from forearm_fem.geometry.build import cached_mesh
from forearm_fem.results.files import read_compliance
from forearm_fem.scenario import Scenario, load_scenario
from forearm_fem.scenario.sweep import ReducedSolve
from forearm_fem.transfer import Compliance

COLUMNS = ("frequency", "error_points", "error_contacts", "seconds")


def held_out(compliance: Compliance, used: set[float], count: int) -> list[float]:
    """``count`` bins spread over the band in sqrt(f), none of them used."""
    free = np.array([f for f in compliance.frequency if float(f) not in used])
    wanted = np.linspace(np.sqrt(free[0]), np.sqrt(free[-1]), count) ** 2
    return sorted({float(free[np.argmin(np.abs(free - f))]) for f in wanted})


def compare(solver: DirectSolver, compliance: Compliance, frequency: float) -> dict[str, float]:
    """One direct solve beside the reduced model's compliance at that bin."""
    start = time.perf_counter()
    truth = solver.compliance(solver.at(frequency))
    seconds = time.perf_counter() - start
    found = compliance.values[int(np.argmin(np.abs(compliance.frequency - frequency)))]
    contacts, points = compliance.indices("contact"), compliance.indices("point")
    errors = [_error(found, truth, np.ix_(rows, contacts)) for rows in (points, contacts)]
    return dict(zip(COLUMNS, (frequency, *errors, seconds), strict=True))


def _error(found: np.ndarray, truth: np.ndarray, block: tuple[np.ndarray, ...]) -> float:
    return float(np.abs(found[block] - truth[block]).max() / np.abs(truth[block]).max())


def factorisation_seconds(model: ForearmModel, frequency: float) -> float:
    """Wall time of one double-precision factorisation, the analysis left out."""
    solver = make_solver(model, ReducedSolve(precision="double"), frequency)
    data = model.operator.data(2 * np.pi * frequency)
    start = time.perf_counter()
    solver.factor.factorise(data)
    seconds = time.perf_counter() - start
    solver.factor.release()
    return seconds


def measure(scenario: Scenario, base: Path, run: Path, count: int, out: Path) -> list[dict[str, float]]:
    """All comparisons, kept in ``out`` as they come."""
    compliance = read_compliance(run / "transfer.nc")
    facts = json.loads((run / "solution.json").read_text())["facts"]
    used = {*facts["expansion_frequencies"], *(c["frequency"] for c in facts["certificates"])}
    model = fem_model(scenario, cached_mesh(scenario, base=base))
    print(f"one double-precision factorisation: {factorisation_seconds(model, 300.0):.1f} s", flush=True)
    rows = read_rows(out, made_by(run))
    solver = make_solver(model, ReducedSolve(), 300.0)
    for f in held_out(compliance, used, count):
        if all(row["frequency"] != f for row in rows):
            rows.append(compare(solver, compliance, f))
            print(rows[-1], flush=True)
            write_rows(out, rows, made_by(run))
    return rows


def made_by(run: Path) -> str:
    """Program and mesh of a run, in one word each."""
    account = json.loads((run / "run.json").read_text())
    return f"{account['program']} {account['mesh']['sha256'][:10]}"


def read_rows(path: Path, maker: str) -> list[dict[str, float]]:
    """What an interrupted run had measured of results of the same ``maker``."""
    if not path.exists():
        return []
    with path.open(newline="") as stream:
        rows = [row for row in csv.DictReader(stream) if row.get("maker") == maker]
    return [{k: float(row[k]) for k in COLUMNS} for row in rows]


def write_rows(path: Path, rows: list[dict[str, float]], maker: str) -> None:
    """All rows so far."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="") as stream:
        table = csv.DictWriter(stream, (*COLUMNS, "maker"), lineterminator="\n")
        table.writeheader()
        table.writerows({**{k: f"{v:.6g}" for k, v in row.items()}, "maker": maker} for row in rows)


def main() -> None:
    """Measure and say what came out."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenario", type=Path)
    parser.add_argument("run", type=Path)
    parser.add_argument("--count", type=int, default=40)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results" / "thesis.csv")
    asked = parser.parse_args()
    rows = measure(load_scenario(asked.scenario), asked.scenario.parent, asked.run, asked.count, asked.out)
    stage = json.loads((asked.run / "run.json").read_text())["stages"]["solve"]["seconds"]
    each = float(np.median([row["seconds"] for row in rows]))
    worst = [max(row[k] for row in rows) for k in COLUMNS[1:3]]
    print(f"{len(rows)} bins: worst e(f) {worst[0]:.1e} at points, {worst[1]:.1e} at contacts")
    print(f"one direct frequency {each:.1f} s, 981 of them {981 * each:.0f} s; the run's solve stage {stage:.0f} s")


if __name__ == "__main__":
    main()
