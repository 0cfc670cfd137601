"""Whether G and S are still the same: one scenario solved by the package of a revision and by the working tree's.

``python benchmarks/same_g.py REVISION [SCENARIO] [--set KEY=VALUE ...]`` prints the largest difference of G over its
largest entry, and of S, and exits with 1 above 1e-12. A shipped scenario is named, and each side reads its own file of
that name, as the format may differ; a file is read by both. Each side has a cache of its own, so that both solve.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
MOST = 1e-12  # a rearranged program rounds the same way, or very nearly
SOLVE = """
import sys
from pathlib import Path
import numpy as np
from forearm_fem import load_scenario, render, simulate
file, out, *overrides = sys.argv[1:]
scenario = load_scenario(file, overrides=overrides)
found = simulate(scenario, base=Path(file).parent)
strengths = render(found).strengths if scenario.rendering.methods else np.zeros(0)
np.savez(out, g=found.transfer.values, s=strengths, stated=[e.band for e in found.transfer.errors])
"""


def solved(package: Path, scenario: str, overrides: list[str], out: Path) -> dict[str, np.ndarray]:
    """G (n_frequency, n_out, n_in), S (method, target) and stated errors by the package in the folder ``package``."""
    own = package / "scenarios" / f"{scenario}.toml"
    file = own if own.is_file() else Path(scenario).resolve()
    where = {**os.environ, "PYTHONPATH": str(package), "PYTHONSAFEPATH": "1", "FOREARM_FEM_CACHE": str(out / "cache")}
    made = out.with_suffix(".npz")
    command = [sys.executable, "-c", SOLVE, str(file), str(made), *overrides]
    subprocess.run(command, env=where, cwd=out.parent, check=True)
    with np.load(made) as found:
        return dict(found)


def main() -> None:
    """Solve twice and compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("revision")
    parser.add_argument("scenario", nargs="?", default="quick")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", dest="overrides")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as home:
        before, folder = Path(home) / "before", Path(home)
        subprocess.run(["git", "worktree", "add", "--detach", "-q", str(before), asked.revision], cwd=ROOT, check=True)
        try:
            a = solved(before, asked.scenario, asked.overrides, folder / "a")
            b = solved(ROOT, asked.scenario, asked.overrides, folder / "b")
        finally:
            subprocess.run(["git", "worktree", "remove", "--force", str(before)], cwd=ROOT, check=True)
    differ = [
        float(np.nanmax(np.abs(a[k] - b[k])) / np.nanmax(np.abs(a[k]))) if np.size(a[k]) else 0.0
        for k in ("g", "s", "stated")
    ]
    print(
        f"{asked.scenario} {' '.join(asked.overrides)}: largest |dG| over largest |G| {differ[0]:.1e}, of S "
        f"{differ[1]:.1e}, of stated errors {differ[2]:.1e} ({a['g'].shape[0]} frequencies)"
    )
    sys.exit(max(differ[:2]) > MOST)


if __name__ == "__main__":
    main()
