"""Commands that are killed and go on: nothing is lost, and results are those of one go to the bit.

``python benchmarks/kills.py [--only COMMAND,...] [--kills 3] [--seed 0] [--out FOLDER]`` runs each command once to its
end, then kills it (kill -9) so often at random moments of that time and lets it end. Arrays of netCDF and lines of CSV
must be equal, but for seconds. Caches and folders are fresh on both sides; numbers of threads are one.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import h5py
import numpy as np

from forearm_fem.user_cache import default_cache_dir

SLAB = """accuracy = 0.3
name = "slab"
limb = { shape = "slab", length = 0.06, width = 0.05, depth = 0.02 }
mesh = { element = "P2" }
device = { contacts = [[-0.006, 0.0], [0.005, 0.002]], drive = "force", cone = { radius = 0.002 } }
grid = { points = [[0.0, 0.0], [0.001, -0.005]] }
library = { length = 0.022, width = 0.016, step = 0.005 }
sweep = { f_min = 60, f_max = 100, duration = 0.1, sample_rate = 1000 }
solver = { discretisation_estimate = false }
rendering = { methods = [] }
"""
TWIN = """name = "twin"
engine = "layered"
sweep = { duration = 0.1 }
device = { cone = { contact = "pressure" } }
"""
DESIGN = """name = "d"
scenario = "twin.toml"
[[variables]]
key = "device.spacing"
low = 0.03
high = 0.05
[search]
candidates = 24
population = 8
local = 8
"""
CAMPAIGN = """name = "c"
scenario = "twin.toml"
[grid]
"device.spacing" = [0.03, 0.035, 0.04, 0.045, 0.05, 0.055]
"""
FILES = {"slab.toml": SLAB, "twin.toml": TWIN, "design.toml": DESIGN, "campaign.toml": CAMPAIGN}
COMMANDS = {
    "run": ("run", "quick", "--out", "out"),
    "predict": ("predict", "twin.toml", "--draws", "30", "--workers", "1", "--out", "out"),
    "design": ("design", "design.toml", "--no-confirm", "--out", "out"),
    "campaign": ("campaign", "campaign.toml", "--workers", "1", "--out", "out"),
    "library": ("library", "slab.toml", "--out", "out/arm.nc"),
    "calibrate": ("calibrate", "twin.toml", "--yes", "--seed", "1", "--out", "out"),
}
TIMES = ("seconds",)  # names of what differs between two runs of the same
LEFT_OUT = ("work.sqlite",)


def started(command: tuple[str, ...], home: Path) -> subprocess.Popen[bytes]:
    """The command in ``home``, with a cache of its own."""
    caches = {"FOREARM_FEM_CACHE": str(home / "cache"), "NUMBA_CACHE_DIR": str(default_cache_dir() / "kernels")}
    threads = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
    where = {**os.environ, **threads, **caches}
    line = [sys.executable, "-m", "forearm_fem", *command]
    with (home / "said").open("ab") as said:
        return subprocess.Popen(
            line, cwd=home, env=where, stdout=said, stderr=said, stdin=subprocess.DEVNULL, start_new_session=True
        )


def contents(folder: Path) -> dict[str, object]:
    """Every number of the results, by file and name."""
    found: dict[str, object] = {}
    for file in sorted(folder.rglob("*")):
        name = str(file.relative_to(folder))
        if file.suffix == ".nc":
            with h5py.File(file) as content:
                for key in content:
                    if isinstance(content[key], h5py.Dataset) and not key.endswith(TIMES):
                        found[f"{name}: {key}"] = content[key][()]
        elif file.suffix == ".csv":
            with file.open(newline="") as stream:
                rows = [{k: v for k, v in row.items() if k not in TIMES} for row in csv.DictReader(stream)]
            found[name] = rows
    return found


def same(a: object, b: object) -> bool:
    """Equal to the bit."""
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
    return type(a) is type(b) and (a == b or (isinstance(a, np.generic) and a.tobytes() == b.tobytes()))


def tried(name: str, folder: Path, kills: int, rng: np.random.Generator) -> list[str]:
    """What differs after ``kills`` from one go; prints a line."""
    homes = [folder / name / side for side in ("whole", "killed")]
    for home in homes:
        home.mkdir(parents=True)
        for file, text in FILES.items():
            (home / file).write_text(text)
    whole, killed = homes
    began = time.monotonic()
    if started(COMMANDS[name], whole).wait() != 0:
        return [f"{name}: the whole run failed; see {whole / 'said'}"]
    seconds, moments = time.monotonic() - began, []
    for _ in range(kills):
        process, after = started(COMMANDS[name], killed), float(rng.uniform(0.1, 0.9)) * seconds
        try:
            process.wait(after)
        except subprocess.TimeoutExpired:
            moments.append(after)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    began = time.monotonic()
    if started(COMMANDS[name], killed).wait() != 0:
        return [f"{name}: the resumed run failed; see {killed / 'said'}"]
    rest = time.monotonic() - began
    one, other = (contents(home / "out") for home in homes)
    differs = [key for key in one.keys() | other.keys() if not same(one.get(key), other.get(key))]
    left = [str(p) for p in killed.rglob(".*") if p.is_file()]
    told = ", ".join(f"{m:.1f}" for m in moments)
    print(
        f"{name}: {seconds:.1f} s in one go; killed after {told} s, then {rest:.1f} s; {len(one)} arrays and tables, "
        f"{len(differs)} differ{': ' + ', '.join(sorted(differs)[:5]) if differs else ''}"
        f"{'; left behind: ' + ', '.join(left) if left else ''}",
        flush=True,
    )
    return [f"{name}: {key}" for key in differs]


def main() -> None:
    """All commands, or those of --only; exits with 1 where something differs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default=",".join(COMMANDS))
    parser.add_argument("--kills", type=int, default=3)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path)
    asked = parser.parse_args()
    folder, rng = asked.out or Path(tempfile.mkdtemp()), np.random.default_rng(asked.seed)
    wrong = [w for name in asked.only.split(",") for w in tried(name, folder, asked.kills, rng)]
    if asked.out is None and not wrong:
        shutil.rmtree(folder)
    print(*wrong, sep="\n")
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
