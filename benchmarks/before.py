"""Speed against stated and against true error, before and now: before-SCENE.csv and before-SCENE.png.

    git worktree add OLD VERSION
    python benchmarks/before.py OLD [--scene thesis quick slab] [--accuracies 0.1 0.05 0.025] [--out FOLDER]

Each version runs ``forearm-fem run`` as a process of its own from an empty cache, with kernels compiled by a run that
is not timed, one version after the other at each accuracy. Wall seconds mean something on an idle machine only,
processor seconds with one thread on any. Sizes follow from the accuracy: that of ``quick`` are left out. The truth of
the ``slab``, a quarter with one bonded cone, is the layered model's; that of the others is this version's run at the
finest accuracy, whose own stated error is added by squares. Memory is what the largest process holds, looked at five
times a second.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import resource
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
from forearm_fem.store.folder import default_cache_dir
from forearm_fem.transfer import band_error

HERE = Path(__file__).parent
_TICKS = 0.005, 0.01, 0.02, 0.05, 0.1, 0.2
_PAUSE = 0.2  # s between two looks at the memory
_SLAB = """name = "slab"
[limb]
shape = "slab"
length = 0.16
width = 0.16
depth = 0.06
symmetry = ["x", "y"]
layers = [{ tissue = "skin", thickness = 0.0015 }, { tissue = "fat", thickness = 0.004 }]
[device]
contacts = [[0.0, 0.0]]
[device.cone]
contact = "bonded"
radius = 0.004
[grid]
points = [[0.01, 0.0], [0.014, 0.004], [0.02, 0.0], [0.0318, 0.0]]
[rendering]
methods = []
[sweep]
frequencies = [150.0, 157.0, 164.5, 172.0, 180.0, 188.5, 197.0, 206.5, 216.0, 226.0, 236.5, 247.5, 259.0, 271.0, 283.5,
               297.0, 311.0, 325.5, 340.5, 356.5, 373.0, 390.5, 408.5, 427.5, 447.5, 468.5, 490.0, 500.0]
"""
_READ = """
import sys, numpy
try:
    from forearm_fem.results.files import read_transfer
except ImportError:
    from forearm_fem.io.netcdf import read_transfer
numpy.save(sys.argv[2], read_transfer(sys.argv[1]).values)
"""
_LAYERED, _FINE = ("engine=layered", "limb.symmetry=[]"), ("solver.discretisation_estimate=false",)


def main() -> None:
    """Run, compare, write and draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("old", type=Path, help="a checkout of the earlier version")
    parser.add_argument("--scene", choices=("thesis", "quick", "slab"), nargs="+", default=["slab", "quick"])
    parser.add_argument("--accuracies", type=float, nargs="+", default=[0.1, 0.05, 0.025])
    parser.add_argument("--out", type=Path, default=HERE / "results")
    asked = parser.parse_args()
    record_machine(asked.out, "before")
    homes = HERE.parent, asked.old.resolve()
    with tempfile.TemporaryDirectory() as folder:
        for home in homes:
            timed(home, written(asked.scene[0], Path(folder)), max(asked.accuracies), Path(folder))
        for name in asked.scene:
            scene, rows, found = written(name, Path(folder)), list[dict[str, Any]](), list[np.ndarray[Any, Any]]()
            for accuracy in sorted(asked.accuracies, reverse=True):
                for home in homes:
                    row, values = timed(home, scene, accuracy, Path(folder))
                    rows.append(row)
                    found.append(values)
                    print(name, row, flush=True)
            truth = timed(homes[0], scene, 0.007, Path(folder), *(_FINE if name == "thesis" else _LAYERED))[1]
            for row, values in zip(rows, found, strict=True):
                row["true"] = f"{band_error(values, truth):.3g}"
            write_csv(asked.out / f"before-{name}.csv", rows)
            drawn(rows).savefig(asked.out / f"before-{name}.png", dpi=110)


def written(name: str, folder: Path) -> Path:
    """The scene without mesh sizes, as a file of this name that both versions read."""
    file = folder / f"{name}.toml"
    if name == "slab":
        file.write_text(_SLAB, encoding="utf-8")
        return file
    text = (HERE.parent / "scenarios" / f"{name}.toml").read_text(encoding="utf-8")
    tables = [part for part in text.split("\n\n") if not part.startswith("[mesh]")]
    kept = [line for line in "\n\n".join(tables).splitlines() if not line.startswith("schema_version")]
    file.write_text("\n".join(kept) + "\n", encoding="utf-8")
    return file


def timed(home: Path, scene: Path, accuracy: float, folder: Path, *more: str) -> tuple[dict[str, Any], Any]:
    """One run of the version at ``home`` in a process of its own: its row, and G."""
    out, cache = folder / "run", folder / "cache"
    for left in (out, cache):
        shutil.rmtree(left, ignore_errors=True)
    command = [sys.executable, "-m", "forearm_fem", "run", str(scene), "--out", str(out)]
    command += [part for value in (f"accuracy={accuracy}", *more) for part in ("--set", value)]
    environment = {**os.environ, "PYTHONPATH": str(home), "FOREARM_FEM_CACHE": str(cache)}
    environment["NUMBA_CACHE_DIR"] = str(default_cache_dir() / "kernels")  # compiled once, for all runs
    began, most, spent = time.perf_counter(), 0, processor_seconds()
    running = subprocess.Popen(command, cwd=home, env=environment, stdout=subprocess.DEVNULL)
    process = psutil.Process(running.pid)
    while running.poll() is None:
        with suppress(psutil.NoSuchProcess):
            most = max([most, *(p.memory_info().rss for p in (process, *process.children(recursive=True)))])
        time.sleep(_PAUSE)
    seconds = time.perf_counter() - began
    if running.returncode:
        raise SystemExit(f"{home}: the run ended with code {running.returncode}")
    run = json.loads((out / "run.json").read_text(encoding="utf-8"))
    row = {
        "version": version_of(home), "accuracy": accuracy,
        "unknowns": sum(run["solution"].get(k) or 0 for k in ("displacement_unknowns", "pressure_unknowns")),
        "seconds": f"{seconds:.1f}", "processor_seconds": f"{processor_seconds() - spent:.1f}",
        "peak_gb": f"{most / 1e9:.2f}", "stated": f"{math.hypot(*(e['band'] or math.nan for e in run['errors'])):.3g}",
    }  # fmt: skip
    command = [sys.executable, "-c", _READ, str(out / "transfer.nc"), str(out / "g.npy")]
    subprocess.run(command, cwd=home, env=environment, check=True)
    return row, np.load(out / "g.npy")


def processor_seconds() -> float:
    """Of all processes that were started and have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def version_of(home: Path) -> str:
    """As the package says it."""
    text = (home / "forearm_fem" / "__init__.py").read_text(encoding="utf-8")
    return text.partition('__version__ = "')[2].partition('"')[0]


def drawn(rows: list[dict[str, Any]]) -> Figure:
    """Seconds and memory over the stated and the true error, a line for each version."""
    figure = Figure(figsize=(7.1, 5.0), layout="constrained")
    axes = figure.subplots(2, 2, sharex="col", sharey="row")
    for version, colour in zip(dict.fromkeys(r["version"] for r in rows), ("#0072b2", "#d55e00"), strict=True):
        mine = [r for r in rows if r["version"] == version]
        for line, key in zip(axes, ("seconds", "peak_gb"), strict=True):
            for ax, error in zip(line, ("stated", "true"), strict=True):
                at, size = ([float(r[k]) for r in mine] for k in (error, key))
                ax.plot(at, size, "o-", color=colour, label=version)
    for line, label in zip(axes, ("whole run, wall [s]", "peak memory [GB]"), strict=True):
        line[0].set(ylabel=label, ylim=(0, None))
    for ax, error in zip(axes[1], ("stated", "true"), strict=True):
        ax.set(xlabel=f"{error} e_band of G", xscale="log", xlim=(0.003, 0.25))
        ax.set_xticks(_TICKS, labels=[f"{tick:g}" for tick in _TICKS])
        ax.set_xticks([], minor=True)
    for ax in axes.flat:
        ax.grid(color="#dddddd")
    axes[0, 0].legend(frameon=False)
    return figure


if __name__ == "__main__":
    main()
