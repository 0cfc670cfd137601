"""Whether G is still the same: one scenario solved by the package of a revision and by the working tree's.

``python benchmarks/same_g.py REVISION [SCENARIO] [--set KEY=VALUE ...]`` prints the largest difference of G over its
largest entry, and exits with 1 above 1e-12. Each side has a cache of its own, so that both solve.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from forearm_fem.io import read_transfer
from forearm_fem.user_cache import default_cache_dir

ROOT = Path(__file__).parents[1]
MOST = 1e-12  # a rearranged program rounds the same way, or very nearly


def solved(package: Path, scenario: Path, overrides: list[str], out: Path) -> np.ndarray:
    """G (n_frequency, n_out, n_in) of ``scenario`` by the package in the folder ``package``."""
    caches = {"FOREARM_FEM_CACHE": str(out / "cache"), "NUMBA_CACHE_DIR": str(default_cache_dir() / "kernels")}
    where = {**os.environ, "PYTHONPATH": str(package), "PYTHONSAFEPATH": "1", **caches}
    options = [part for pair in overrides for part in ("--set", pair)]
    command = [sys.executable, "-m", "forearm_fem", "solve", str(scenario), "--out", str(out), *options]
    subprocess.run(command, env=where, cwd=out.parent, check=True, stdout=subprocess.DEVNULL)
    return np.asarray(read_transfer(out / "transfer.nc").values)


def main() -> None:
    """Solve twice and compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("revision")
    parser.add_argument("scenario", type=Path, nargs="?", default=ROOT / "scenarios" / "quick.toml")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", dest="overrides")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as home:
        before, folder = Path(home) / "before", Path(home)
        subprocess.run(["git", "worktree", "add", "--detach", "-q", str(before), asked.revision], cwd=ROOT, check=True)
        try:
            scenario = asked.scenario.resolve()
            a = solved(before, scenario, asked.overrides, folder / "a")
            b = solved(ROOT, scenario, asked.overrides, folder / "b")
        finally:
            subprocess.run(["git", "worktree", "remove", "--force", str(before)], cwd=ROOT, check=True)
    difference = float(np.nanmax(np.abs(a - b)) / np.nanmax(np.abs(a)))
    print(f"{asked.scenario.name}: largest |dG| over largest |G| = {difference:.1e} ({a.shape[0]} frequencies)")
    sys.exit(difference > MOST)


if __name__ == "__main__":
    main()
