"""Commands that are killed and go on: nothing is lost, and results are those of one go to the bit.

``python benchmarks/kills.py [--only COMMAND,...] [--kills 3] [--seed 0] [--out FOLDER]`` runs each command once to its
end, then kills it (kill -9) so often at random moments of that time and lets it end. Arrays of netCDF and lines of CSV
must be equal, but for seconds. Caches and folders are fresh on both sides; numbers of threads are one. A study's
participant is a program that answers by the page's own requests.

``--kind`` other than ``kills``: ``damaged`` halves every store and cache of a finished command, which must then give
the same again; ``full`` lets no file grow beyond what a quarter of its largest needs, which must end in a sentence;
``together`` starts two of a command at once, on one cache (both must be right) and in one folder (one may refuse).
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import urllib.error
import urllib.request
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from forearm_fem.store.folder import default_cache_dir

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
STUDY = """name = "s"
scenario = "twin.toml"
transfer = "g/transfer.nc"
participants = 1
[[tasks]]
name = "places"
answer = "one point"
repetitions = 1
blocks = 1
training = 0
"""
FILES = {"slab.toml": SLAB, "twin.toml": TWIN, "design.toml": DESIGN, "campaign.toml": CAMPAIGN, "study.toml": STUDY}
COMMANDS = {
    "run": ("run", "quick", "--out", "out"),
    "predict": ("predict", "twin.toml", "--draws", "30", "--workers", "1", "--out", "out"),
    "design": ("design", "design.toml", "--no-confirm", "--out", "out"),
    "campaign": ("campaign", "campaign.toml", "--workers", "1", "--out", "out"),
    "library": ("library", "slab.toml", "--out", "out/arm.nc"),
    "calibrate": ("calibrate", "twin.toml", "--yes", "--seed", "1", "--out", "out"),
    "study": ("study", "run", "study.toml", "--participant", "01", "--consent", "2026-01-01", "--data", "out"),
}
TIMES = ("seconds", "onset", "duration", "response_time", "date", "session", "played", "time")  # of a run


def started(command: tuple[str, ...], home: Path, cache: Path | None = None, most: int = 0) -> subprocess.Popen[bytes]:
    """The command in ``home``, with a cache of its own unless one is given; no file grows beyond ``most`` bytes."""
    kernels = default_cache_dir() / "kernels"
    caches = {"FOREARM_FEM_CACHE": str(cache or home / "cache"), "NUMBA_CACHE_DIR": str(kernels)}
    threads = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
    where = {**os.environ, **threads, **caches}
    line = [sys.executable, "-u", "-m", "forearm_fem", *command]
    if most:
        line = ["bash", "-c", f'ulimit -f {max(most // 1024, 1)}; exec "$@"', "bash", *line]
    with (home / "said").open("ab") as said:
        return subprocess.Popen(
            line, cwd=home, env=where, stdout=said, stderr=said, stdin=subprocess.DEVNULL, start_new_session=True
        )


def prepared(folder: Path, name: str) -> Path:
    """A folder with the scenes, and for a study the G that it plays."""
    folder.mkdir(parents=True)
    for file, text in FILES.items():
        (folder / file).write_text(text)
    if name == "study":
        started(("run", "twin.toml", "--until", "solve", "--out", "g"), folder).wait()
    return folder


def ended(name: str, home: Path, **how: Any) -> int:
    """Exit code of the command, run to its end; a study's participant answers all trials."""
    process = started(COMMANDS[name], home, **how)
    if name == "study" and participant(process, home):
        os.killpg(process.pid, signal.SIGTERM)
        process.wait()
        return 0
    return process.wait()


def at_once(name: str, *homes: Path, **how: Any) -> list[int]:
    """Exit codes of the command, started in all ``homes`` at the same time."""
    with ThreadPoolExecutor(len(homes)) as pool:
        return list(pool.map(lambda home: ended(name, home, **how), homes))


def participant(process: subprocess.Popen[bytes], home: Path) -> bool:
    """Answers trial after trial, kept in ``given`` once taken; True once the task is done, False if it ends before."""
    said = home / "said"
    before = addresses = re.findall(pattern := r"participant:\s+(\S+)", said.read_text())
    while process.poll() is None and addresses == before:
        time.sleep(0.05)
        addresses = re.findall(pattern, said.read_text())
    api = "" if addresses == before else addresses[-1].replace("/p/", "/api/")

    def asked(what: str, body: dict[str, Any] | None = None) -> dict[str, Any]:
        """Answer of the page's own request."""
        data = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(f"{api}/{what}", data, {"Content-Type": "application/json"})
        return dict(json.loads(urllib.request.urlopen(request, timeout=20).read()))

    while process.poll() is None:
        try:
            state = asked("state")
            if state["waiting"] in ("start", "pause", "break"):
                asked("start", {})
            elif state["waiting"] == "stimulus":
                asked("present", {})
            elif state["waiting"] == "answer":
                n = int(state["answered"])
                taken = asked("answer", {"points": [str(n * 5 % 9 + 1)], "answered": n})
                if int(taken["answered"]) == n + 1:
                    (home / "given").open("a").write(f"{n * 5 % 9 + 1}\n")
            elif state["waiting"] == "done":
                return True
            time.sleep(0.02)
        except urllib.error.HTTPError as refused:
            if "cannot be written" in (why := str(json.loads(refused.read()).get("problem"))):
                (home / "said").open("a").write(f"{why}\n")
                os.killpg(process.pid, signal.SIGTERM)
                return False
        except OSError:
            time.sleep(0.05)
    return False


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
        elif file.suffix in (".csv", ".tsv"):
            with file.open(newline="") as stream:
                table = csv.DictReader(stream, delimiter="\t" if file.suffix == ".tsv" else ",")
                rows = [{k: v for k, v in row.items() if k not in TIMES} for row in table]
            found[name] = rows
    return found


def same(a: object, b: object) -> bool:
    """Equal to the bit."""
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
    return type(a) is type(b) and (a == b or (isinstance(a, np.generic) and a.tobytes() == b.tobytes()))


def compared(one: Path, other: Path) -> list[str]:
    """Names of what differs between two folders of results."""
    a, b = contents(one), contents(other)
    return sorted(key for key in a.keys() | b.keys() if not same(a.get(key), b.get(key)))


def killed(name: str, folder: Path, kills: int, rng: np.random.Generator) -> list[str]:
    """What differs after ``kills`` from one go; prints a line."""
    whole, home = (prepared(folder / name / side, name) for side in ("whole", "killed"))
    began = time.monotonic()
    if ended(name, whole) != 0:
        return [f"{name}: the whole run failed; see {whole / 'said'}"]
    seconds, moments = time.monotonic() - began, []
    for _ in range(kills):
        process, after = started(COMMANDS[name], home), float(rng.uniform(0.1, 0.9)) * seconds
        if name == "study":
            threading.Thread(target=participant, args=(process, home), daemon=True).start()
        try:
            process.wait(after)
        except subprocess.TimeoutExpired:
            moments.append(after)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        time.sleep(0.3)
    began = time.monotonic()
    if ended(name, home) != 0:
        return [f"{name}: the resumed run failed; see {home / 'said'}"]
    rest = time.monotonic() - began
    differs = compared(whole / "out", home / "out")
    left = [str(p) for p in home.rglob(".*") if p.is_file()]
    told = ", ".join(f"{m:.1f}" for m in moments)
    print(
        f"{name}: {seconds:.1f} s in one go; killed after {told} s, then {rest:.1f} s; "
        f"{len(contents(whole / 'out'))} arrays and tables, "
        f"{len(differs)} differ{': ' + ', '.join(differs[:5]) if differs else ''}"
        f"{'; left behind: ' + ', '.join(left) if left else ''}",
        flush=True,
    )
    return [f"{name}: {key}" for key in differs]


def damaged(name: str, folder: Path, *_: Any) -> list[str]:
    """What differs once every store and cache of a finished command was cut in half, and the results are gone."""
    whole = prepared(folder / name / "whole", name)
    if ended(name, whole) != 0:
        return [f"{name}: the whole run failed; see {whole / 'said'}"]
    shutil.copytree(whole, home := folder / name / "damaged")
    stores = [p for p in (*home.glob("cache/**/*"), *home.glob("out/**/*.sqlite")) if p.is_file()]
    for file in stores:
        content = file.read_bytes()
        file.write_bytes(content[: len(content) // 2])
    for file in (home / "out").rglob("*.nc"):
        file.unlink()
    code = ended(name, home)
    differs = compared(whole / "out", home / "out")
    told = f"{len(stores)} files cut in half, exit code {code}, {len(differs)} arrays and tables differ"
    print(f"{name}: {told}", flush=True)
    return [f"{name}: {key}" for key in differs] + [f"{name}: exit code {code}"] * (code != 0)


def full(name: str, folder: Path, *_: Any) -> list[str]:
    """What is wrong with how the command ends where files may not grow: a traceback, or another code than 2."""
    whole = prepared(folder / name / "whole", name)
    if ended(name, whole) != 0:
        return [f"{name}: the whole run failed; see {whole / 'said'}"]
    largest = max(p.stat().st_size for p in (whole / "out").rglob("*") if p.is_file())
    home = prepared(folder / name / "full", name)
    code = ended(name, home, most=largest // 4)
    said = (home / "said").read_text()
    last = said.strip().splitlines()[-1] if said.strip() else ""
    wrong = (code != 2 and name != "study") or "Traceback" in said  # a study says it on its pages and goes on
    print(f"{name}: no file beyond {largest // 4} bytes: exit code {code}, {last[:150]!r}", flush=True)
    return [f"{name}: see {home / 'said'}"] * wrong


def together(name: str, folder: Path, *_: Any) -> list[str]:
    """What differs of two at once on one cache, and of one or two in one folder, from one alone."""
    whole, a, b, one = (prepared(folder / name / side, name) for side in ("whole", "a", "b", "one"))
    if ended(name, whole) != 0:
        return [f"{name}: the whole run failed; see {whole / 'said'}"]
    cache = folder / name / "cache"
    codes = at_once(name, a, b, cache=cache)
    ends = sorted(at_once(name, one, one))
    differs = [k for home in (a, b, one) for k in compared(whole / "out", home / "out")]
    wrong = codes != [0, 0] or ends not in ([0, 0], [0, 2]) or "Traceback" in (one / "said").read_text()
    told = f"two on one cache end {codes}, two in one folder {ends}, {len(differs)} arrays and tables differ"
    print(f"{name}: {told}", flush=True)
    return [f"{name}: {k}" for k in differs] + [f"{name}: {codes}, {ends}"] * wrong


KINDS = {"kills": killed, "damaged": damaged, "full": full, "together": together}


def main() -> None:
    """All commands, or those of --only; exits with 1 where something differs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default=",".join(COMMANDS))
    parser.add_argument("--kind", choices=KINDS, default="kills")
    parser.add_argument("--kills", type=int, default=3)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path)
    asked = parser.parse_args()
    folder, rng = asked.out or Path(tempfile.mkdtemp()), np.random.default_rng(asked.seed)
    wrong = [w for name in asked.only.split(",") for w in KINDS[asked.kind](name, folder, asked.kills, rng)]
    if asked.out is None and not wrong:
        shutil.rmtree(folder)
    print(*wrong, sep="\n")
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
