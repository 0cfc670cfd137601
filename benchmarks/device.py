"""cuDSS on an NVIDIA device beside the processor's solvers: analysis, factorisation, solves, residuals, whole sweeps.

    python3 benchmarks/device.py scenarios/thesis.toml --threads 2 16 --backend multifrontal pardiso cudss

Each line is a process of its own on one system, at 300 Hz. Solutions are those of all ports, once as the factors
give them and once refined; residuals are measured in double precision on the processor, whoever solved. Writes
benchmarks/results/device.csv (solvers) and device-sweep.csv (sweeps) as lines come, and prints them.
"""

from __future__ import annotations

import argparse
import csv
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields, replace
from itertools import product
from pathlib import Path

import numpy as np
import psutil

from bench.isolated import isolated, threads
from forearm_fem.engines.fem import fem_model
from forearm_fem.errors import ForearmError
from forearm_fem.fem.kernels.compiled import freed_memory_kept
from forearm_fem.fem.linear.factor import make_factor, refined_solve
from forearm_fem.fem.reduction.sweep import reduced_sweep
from forearm_fem.geometry.build import cached_mesh
from forearm_fem.scenario import load_scenario
from forearm_fem.scenario.sweep import frequencies

PRECISIONS = ["single", "double"]
RESULTS = Path(__file__).parent / "results"
FREQUENCY = 300.0  # Hz: the middle of the band in sqrt(f)
REPEATS, PATIENCE = 3, 20.0  # times; s, after which no other is begun


@dataclass(frozen=True)
class Asked:
    """What one process measures."""

    scenario: Path
    backend: str
    single: bool
    threads: int


@dataclass(frozen=True)
class Solver:
    """Seconds (medians of up to three but for the analysis), residuals relative to the right-hand side, and memory."""

    scenario: str
    backend: str
    precision: str
    threads: int
    unknowns: int
    columns: int
    seconds_analysis: float
    seconds_factorisation: float
    seconds_solve: float
    residual: float
    residual_refined: float
    device_gb: float
    process_gb: float


@dataclass(frozen=True)
class Sweep:
    """Wall seconds of the reduced sweep, the error that it states, and G's largest difference from the first line's."""

    scenario: str
    backend: str
    threads: int
    unknowns: int
    seconds: float
    factorisations: int
    stated: float
    difference: float


def device_gigabytes() -> float:
    """Memory in use on the first device, 0 where there is none."""
    if shutil.which("nvidia-smi") is None:
        return 0.0
    ask = ["nvidia-smi", "--query-gpu=memory.used", "--format=csv,noheader,nounits", "--id=0"]
    return float(subprocess.run(ask, capture_output=True, text=True, check=True).stdout) / 1e3


def solver(asked: Asked) -> Solver:
    """One line of device.csv."""
    scenario = load_scenario(asked.scenario)
    model = fem_model(scenario, cached_mesh(scenario, base=asked.scenario.parent))
    omega, right = 2 * np.pi * FREQUENCY, model.functionals.astype(complex)
    data, before = model.operator.data(omega), device_gigabytes()
    start = time.perf_counter()
    factor = make_factor(model.operator, omega, asked.backend, single=asked.single, matching=not asked.single)  # type: ignore[arg-type]
    analysis, factorise, solve = time.perf_counter() - start, [], []
    factor.factorise(data)  # compiles what no run has compiled yet, and is not counted
    factor.solve(right)
    while len(factorise) < REPEATS and sum(factorise) + sum(solve) < PATIENCE:
        start = time.perf_counter()
        factor.factorise(data)
        factorise.append(time.perf_counter() - start)
        start = time.perf_counter()
        x = factor.solve(right)
        solve.append(time.perf_counter() - start)
    matrix, used = model.operator.at(omega), device_gigabytes() - before
    rest = np.linalg.norm(right - matrix.product(x), axis=0) / np.linalg.norm(right, axis=0)
    return Solver(
        asked.scenario.stem, asked.backend, "single" if factor.single else "double", asked.threads, model.operator.n,
        right.shape[1], analysis, float(np.median(factorise)), float(np.median(solve)), float(rest.max()),
        refined_solve(factor, matrix, right).residual, used, psutil.Process().memory_info().rss / 1e9,
    )  # fmt: skip


def sweep(asked: Asked) -> tuple[Sweep, np.ndarray]:
    """One line of device-sweep.csv, and compliances (n, n_port, n_port) [m/N]."""
    scenario = load_scenario(asked.scenario)
    model = fem_model(scenario, cached_mesh(scenario, base=asked.scenario.parent))
    options = scenario.solver.model_copy(update={"backend": asked.backend})
    start = time.perf_counter()
    with freed_memory_kept():
        found = reduced_sweep(model, frequencies(scenario.sweep), options, tolerance=scenario.reduction_tolerance)
    seconds = time.perf_counter() - start
    return Sweep(
        asked.scenario.stem, found.solver, asked.threads, model.operator.n, seconds, found.factorisations,
        found.reduction_error, 0.0,
    ), found.values  # fmt: skip


def keep(path: Path, row: Solver | Sweep) -> None:
    """Add a line to a table, and print it."""
    new = not path.exists()
    with path.open("a", newline="") as stream:
        table = csv.DictWriter(stream, [f.name for f in fields(row)], lineterminator="\n")
        if new:
            table.writeheader()
        plain = {k: f"{v:.4g}" if isinstance(v, float) else v for k, v in asdict(row).items()}
        table.writerow(plain)
    print(plain, flush=True)


@contextmanager
def passed_over(what: str) -> Iterator[None]:
    """Say what a solver that is not there, or refuses, says; the others go on."""
    try:
        yield
    except ForearmError as problem:
        print(f"{what}: {problem}", flush=True)


def main() -> None:
    """Measure, keep, and say what came out; a solver that is not there or refuses is said and passed over."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenario", type=Path)
    parser.add_argument("--backend", nargs="+", default=["multifrontal", "pardiso", "cudss"])
    parser.add_argument("--threads", type=int, nargs="+", default=[2])
    parser.add_argument("--sweep", action="store_true", help="whole reduced sweeps, too")
    parser.add_argument("--precision", nargs="*", choices=PRECISIONS, default=PRECISIONS, help="none: sweeps alone")
    parser.add_argument("--out", type=Path, default=RESULTS)
    told = parser.parse_args()
    told.out.mkdir(parents=True, exist_ok=True)
    first: np.ndarray | None = None
    for count, backend in product(told.threads, told.backend):
        with threads(count):
            for precision in told.precision:
                with passed_over(f"{backend}, {precision}, {count} threads"):
                    asked = Asked(told.scenario, backend, precision == "single", count)
                    keep(told.out / "device.csv", isolated(solver, asked))
            if told.sweep:
                with passed_over(f"{backend}, sweep, {count} threads"):
                    row, values = isolated(sweep, Asked(told.scenario, backend, True, count))
                    first = values if first is None else first
                    off = np.abs(values - first).max() / np.abs(first).max()
                    keep(told.out / "device-sweep.csv", replace(row, difference=float(off)))


if __name__ == "__main__":
    main()
