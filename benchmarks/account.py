"""Where a cold run's seconds and gigabytes go: wall time, use of the cores and memory over time, by stage.

    python3 benchmarks/account.py scenarios/thesis.toml [--warm]

The run is a process of its own, as a user starts it, with an empty cache for meshes (and, unless ``--warm``, for
compiled kernels too); another process samples it ten times a second. A stage is what the run tells as its progress;
what comes before the first is import. Writes benchmarks/results/account.csv and account.png beside it, and prints the
table.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import psutil

from forearm_fem.store.folder import default_cache_dir

RESULTS = Path(__file__).parent / "results"
GIGABYTE = 1e9


@dataclass(frozen=True)
class Sample:
    """The run at one moment: seconds since its start, CPU seconds used so far, resident bytes."""

    at: float
    cpu: float
    memory: float


@dataclass(frozen=True)
class Stage:
    """What one stage took: wall and CPU seconds, and the most memory [GB] while it ran."""

    name: str
    begins: float
    seconds: float
    cores: float
    gigabytes: float


def child(scenario: Path, out: Path, told: Path) -> None:
    """The run itself; each change of stage is appended to ``told`` as one JSON line."""
    with told.open("a", buffering=1) as stream:
        seen: list[str] = []

        def progress(stage: str, done: int, total: int) -> None:
            """Note the time at which each stage begins."""
            if not seen or seen[-1] != stage:
                seen.append(stage)
                stream.write(json.dumps([time.time(), stage]) + "\n")

        progress("import", 0, 1)
        from forearm_fem.fem.kernels.compiled import freed_memory_kept
        from forearm_fem.questions.run import Run, run_all
        from forearm_fem.scenario import load_scenario

        progress("start", 0, 1)
        out.mkdir(parents=True, exist_ok=True)
        with freed_memory_kept():
            run_all(Run.start(load_scenario(scenario), out, scenario.parent, progress))


def watched(command: list[str], environment: dict[str, str]) -> tuple[float, list[Sample]]:
    """Moment of the start (Unix time) and samples of ``command``, its children among them, until it ends."""
    began = time.time()
    running = subprocess.Popen(command, env=environment)
    process, samples = psutil.Process(running.pid), []
    while running.poll() is None:
        try:
            family = [process, *process.children(recursive=True)]
            times = [p.cpu_times() for p in family]
            cpu = sum(t.user + t.system + t.children_user + t.children_system for t in times)
            samples.append(Sample(time.time() - began, cpu, sum(p.memory_info().rss for p in family)))
        except psutil.NoSuchProcess:
            pass
        time.sleep(0.1)
    if running.returncode:
        raise SystemExit(f"the run ended with code {running.returncode}")
    return began, samples


def stages(began: float, told: Path, samples: list[Sample]) -> list[Stage]:
    """Samples by what the run said it was doing."""
    marks = [json.loads(line) for line in told.read_text().splitlines()]
    starts = [0.0, *(moment - began for moment, _ in marks[1:]), samples[-1].at]
    found = []
    for name, start, end in zip([name for _, name in marks], starts, starts[1:], strict=False):
        inside = [s for s in samples if start <= s.at <= end]
        cores = (inside[-1].cpu - inside[0].cpu) / max(end - start, 1e-9) if len(inside) > 1 else float("nan")
        peak = max((s.memory for s in inside), default=float("nan"))
        found.append(Stage(name, start, end - start, cores, peak / GIGABYTE))
    return found


def draw(samples: list[Sample], parts: list[Stage], file: Path) -> None:
    """Memory and cores in use over the run's time, its longest stages named."""
    import matplotlib.pyplot as plt
    import numpy as np

    at, cpu, memory = np.array([(s.at, s.cpu, s.memory / GIGABYTE) for s in samples]).T
    even = np.arange(0.0, at[-1], 1.0)
    fig, (top, low) = plt.subplots(2, 1, sharex=True, figsize=(7.1, 4.2), layout="constrained")
    top.plot(at, memory, lw=1.2)
    top.set_ylabel("memory [GB]")
    low.step(even[1:], np.diff(np.interp(even, at, cpu)), where="pre", lw=0.8)
    low.set(ylabel="cores in use", xlabel="time [s]")
    for ax in (top, low):
        ax.set_ylim(0.0, None)
    for part in sorted(parts, key=lambda p: -p.seconds)[:8]:
        for ax in (top, low):
            ax.axvspan(part.begins, part.begins + part.seconds, alpha=0.08, lw=0)
        top.text(part.begins, top.get_ylim()[1] * 0.97, part.name, rotation=90, va="top", fontsize=6)
    fig.savefig(file, dpi=150)


def main() -> None:
    """Run, watch, keep and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenario", type=Path)
    parser.add_argument("--warm", action="store_true", help="kernels are compiled already, as from the second run on")
    parser.add_argument("--child", nargs=2, type=Path, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.child:
        child(asked.scenario, *asked.child)
        return
    with tempfile.TemporaryDirectory() as folder:
        told = Path(folder) / "told"
        kernels = str(default_cache_dir() / "kernels") if asked.warm else folder
        environment = {**os.environ, "FOREARM_FEM_CACHE": folder, "NUMBA_CACHE_DIR": kernels}
        command = [sys.executable, __file__, str(asked.scenario), "--child", str(Path(folder) / "out"), str(told)]
        began, samples = watched(command, environment)
        parts = stages(began, told, samples)
    RESULTS.mkdir(exist_ok=True)
    with (RESULTS / "account.csv").open("w", newline="") as stream:
        table = csv.writer(stream, lineterminator="\n")
        table.writerow(("stage", "begins s", "seconds", "cores", "peak GB"))
        table.writerows(
            (p.name, f"{p.begins:.1f}", f"{p.seconds:.2f}", f"{p.cores:.2f}", f"{p.gigabytes:.2f}") for p in parts
        )
    draw(samples, parts, RESULTS / "account.png")
    for part in parts:
        print(f"{part.begins:7.1f} {part.seconds:7.2f} s {part.cores:5.2f} cores {part.gigabytes:6.2f} GB  {part.name}")
    print(
        f"{samples[-1].at:.1f} s, {max(s.memory for s in samples) / GIGABYTE:.2f} GB, {samples[-1].cpu:.1f} CPU seconds"
    )


if __name__ == "__main__":
    main()
