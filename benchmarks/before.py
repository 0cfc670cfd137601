"""Whole runs of the thesis' scene before and now, against their error: before.csv and before.png.

    git worktree add OLD VERSION
    python benchmarks/before.py OLD [--accuracies 0.1 0.05 0.025] [--out FOLDER]

Each version runs ``forearm-fem run thesis`` as a process of its own from an empty cache, with kernels compiled by a run
of ``quick`` that is not timed, one version after the other in one hour. The machine must be idle, and the packages
installed must serve both. Errors are e_band of G against this version's run at the finest accuracy, whose own error is
in ``overkill.csv``, as the root of the sum of both squares. Memory is what the largest process holds, looked at five
times a second. One run each: machines vary by some per cent.
"""

from __future__ import annotations

import argparse
import csv
import os
import shutil
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from matplotlib.figure import Figure

from bench.tables import record_machine, write_csv
from forearm_fem.results.files import read_transfer
from forearm_fem.store.folder import default_cache_dir
from forearm_fem.transfer import band_error

HERE = Path(__file__).parent
_TICKS = (0.005, 0.01, 0.02)
_PAUSE = 0.2  # s between two looks at the memory


def main() -> None:
    """Run, compare, write and draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("old", type=Path, help="a checkout of the earlier version")
    parser.add_argument("--accuracies", type=float, nargs="+", default=[0.1, 0.05, 0.025])
    parser.add_argument("--out", type=Path, default=HERE / "results")
    asked = parser.parse_args()
    record_machine(asked.out, "before")
    rows, found = list[dict[str, Any]](), dict[tuple[str, float], np.ndarray[Any, Any]]()
    with tempfile.TemporaryDirectory() as folder:
        for home in (HERE.parent, asked.old.resolve()):
            timed(home, "quick", None, Path(folder))
            for accuracy in sorted(asked.accuracies, reverse=True):
                row, values = timed(home, "thesis", accuracy, Path(folder))
                found[row["version"], accuracy] = values
                rows.append(row)
                print(row, flush=True)
    now, finest = rows[0]["version"], min(asked.accuracies)
    for row in rows:
        apart = band_error(found[row["version"], row["accuracy"]], found[now, finest])
        row["error"] = f"{np.hypot(apart, own_error()):.3g}"
    write_csv(asked.out / "before.csv", rows)
    drawn(rows).savefig(asked.out / "before.png", dpi=150)


def timed(home: Path, scene: str, accuracy: float | None, folder: Path) -> tuple[dict[str, Any], Any]:
    """One run of the version at ``home`` in a process of its own: its row, and its G."""
    out, cache = folder / "run", folder / "cache"
    for left in (out, cache):
        shutil.rmtree(left, ignore_errors=True)
    command = [sys.executable, "-m", "forearm_fem", "run", f"scenarios/{scene}.toml", "--out", str(out)]
    command += [] if accuracy is None else ["--set", f"accuracy={accuracy}"]
    environment = {**os.environ, "PYTHONPATH": str(home), "FOREARM_FEM_CACHE": str(cache)}
    environment["NUMBA_CACHE_DIR"] = str(default_cache_dir() / "kernels")  # compiled once, for all runs
    began, most = time.perf_counter(), 0
    running = subprocess.Popen(
        command, cwd=home, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    process = psutil.Process(running.pid)
    while running.poll() is None:
        with suppress(psutil.NoSuchProcess):
            most = max([most, *(p.memory_info().rss for p in (process, *process.children(recursive=True)))])
        time.sleep(_PAUSE)
    if running.returncode:
        raise SystemExit(f"{home}: the run ended with code {running.returncode}")
    row = {
        "version": version_of(home), "accuracy": accuracy, "seconds": f"{time.perf_counter() - began:.1f}",
        "peak_gb": f"{most / 1e9:.2f}",
    }  # fmt: skip
    return row, read_transfer(out / "transfer.nc").values


def version_of(home: Path) -> str:
    """As the package says it."""
    text = (home / "forearm_fem" / "__init__.py").read_text(encoding="utf-8")
    return text.partition('__version__ = "')[2].partition('"')[0]


def own_error() -> float:
    """True e_band of the finest run: the least in ``overkill.csv``."""
    with (HERE / "results" / "overkill.csv").open(encoding="utf-8", newline="") as file:
        return min(float(r["true"]) for r in csv.DictReader(file) if r["what"] == "G over the band")


def drawn(rows: list[dict[str, Any]]) -> Figure:
    """Seconds and memory over the true error, a line for each version."""
    figure = Figure(figsize=(7.1, 3.2), layout="constrained")
    axes = figure.subplots(1, 2)
    for version, colour in zip(dict.fromkeys(r["version"] for r in rows), ("#0072b2", "#d55e00"), strict=True):
        mine = [r for r in rows if r["version"] == version]
        for ax, key in zip(axes, ("seconds", "peak_gb"), strict=True):
            at, size = ([float(r[k]) for r in mine] for k in ("error", key))
            ax.plot(at, size, "o-", color=colour, label=version)
    for ax, label in zip(axes, ("whole run [s]", "peak memory [GB]"), strict=True):
        ax.set(xlabel="true e_band of G", ylabel=label, xscale="log", ylim=(0, None))
        ax.set_xticks(_TICKS, [f"{t:g}" for t in _TICKS])
        ax.minorticks_off()
        ax.grid(color="#dddddd")
    axes[0].legend(frameon=False)
    return figure


if __name__ == "__main__":
    main()
