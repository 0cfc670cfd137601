"""Whether G and S are still the same: one scenario solved by the package of a revision and by the working tree's.

``python benchmarks/same_g.py REVISION [SCENARIO] [--set KEY=VALUE ...]`` prints the largest difference of G over its
largest entry, of S and of its interval, with wall seconds and peak memory of both, and exits with 1 above 1e-12. A
shipped scenario is named, and each side reads its own file of that name, as the format may differ; a file is read by
both. Each side has a cache of its own, so that both solve; kernels are compiled within the first run unless
``--kernels`` keeps them. With ``--one-mesh`` both solve on the mesh that the working tree makes: fTetWild draws random
numbers.
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
import sys, time
from pathlib import Path
import numpy as np
from forearm_fem import load_scenario, render, simulate
from forearm_fem.geometry.mesh.tissue_mesh import Bends, TissueMesh
file, out, shared, *overrides = sys.argv[1:]
scenario, base, mesh = load_scenario(file, overrides=overrides), Path(file).parent, None
if shared and Path(shared).exists():
    kept = dict(np.load(shared, allow_pickle=False))
    facets = {name[7:]: kept[name] for name in kept if name.startswith("facets ")}
    bends = Bends(kept["edges"], kept["offsets"])
    mesh = TissueMesh(kept["points"], kept["tetrahedra"], kept["region"], tuple(kept["names"].tolist()), facets, bends)
began = time.perf_counter()
found = simulate(scenario, base=base, mesh=mesh)
simulated = time.perf_counter() - began
if shared and mesh is None:
    m = found.mesh
    facets = {f"facets {name}": f for name, f in m.facets.items()}
    names = np.array(m.region_names)
    arrays = dict(points=m.points, tetrahedra=m.tetrahedra, region=m.region, names=names, **facets)
    np.savez(shared, edges=m.bends.edges, offsets=m.bends.offsets, **arrays)
s = np.zeros((3, 0))
if scenario.rendering.methods:
    rendering = render(found)
    try:
        from forearm_fem.pipeline.simulation import account_of
        account = account_of(scenario, found.transfer, rendering, base=base)
    except ImportError:
        account = rendering.strength
    s = np.array([account.value, account.low, account.high])
peak = next(int(line.split()[1]) for line in open("/proc/self/status") if line.startswith("VmHWM"))
np.savez(out, g=found.transfer.values, s=s[0], interval=s[1:], stated=[e.band for e in found.transfer.errors],
         cost=[simulated, time.perf_counter() - began, peak / 1e6])
"""


def solved(
    package: Path, scenario: str, overrides: list[str], out: Path, mesh: str, kernels: Path
) -> dict[str, np.ndarray]:
    """G (n_frequency, n_out, n_in), S (method, target), its interval, stated errors and cost by one package."""
    own = package / "scenarios" / f"{scenario}.toml"
    file = own if own.is_file() else Path(scenario).resolve()
    caches = {"FOREARM_FEM_CACHE": str(out / "cache"), "NUMBA_CACHE_DIR": str(kernels / out.name)}
    where = {**os.environ, "PYTHONPATH": str(package), "PYTHONSAFEPATH": "1", **caches}
    made = out.with_suffix(".npz")
    command = [sys.executable, "-c", SOLVE, str(file), str(made), mesh, *overrides]
    subprocess.run(command, env=where, cwd=out.parent, check=True)
    with np.load(made) as found:
        return dict(found)


def main() -> None:
    """Solve twice and compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("revision", help="or a folder that holds the package of one")
    parser.add_argument("scenario", nargs="?", default="quick")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", dest="overrides")
    parser.add_argument("--one-mesh", action="store_true")
    parser.add_argument("--kernels", type=Path, help="folder that keeps compiled kernels from run to run")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as home:
        before, folder = Path(asked.revision).resolve(), Path(home)
        own = not (before / "forearm_fem").is_dir()
        if own:
            before = folder / "before"
            command = ["git", "worktree", "add", "--detach", "-q", str(before), asked.revision]
            subprocess.run(command, cwd=ROOT, check=True)
        mesh = str(folder / "mesh.npz") if asked.one_mesh else ""
        kernels = (asked.kernels or folder / "kernels").resolve()
        try:
            b = solved(ROOT, asked.scenario, asked.overrides, folder / "now", mesh, kernels)
            a = solved(before, asked.scenario, asked.overrides, folder / "was", mesh, kernels)
        finally:
            if own:
                subprocess.run(["git", "worktree", "remove", "--force", str(before)], cwd=ROOT, check=True)
    with np.errstate(invalid="ignore"):
        differ = [
            float(np.nanmax(np.abs(a[k] - b[k])) / np.nanmax(np.abs(a[k]))) if np.size(a[k]) else 0.0
            for k in ("g", "s", "interval", "stated")
        ]
    print(
        f"{asked.scenario} {' '.join(asked.overrides)}: largest |dG| over largest |G| {differ[0]:.1e}, of S "
        f"{differ[1]:.1e}, of its interval {differ[2]:.1e}, of stated errors {differ[3]:.1e} ({a['g'].shape[0]} "
        "frequencies)"
    )
    for name, found in (("before", a), ("now", b)):
        simulated, whole, peak = found["cost"]
        print(f"{name:7} {simulated:.1f} s to G, {whole:.1f} s to S, {peak:.2f} GB")
    sys.exit(max(differ[:2]) > MOST)


if __name__ == "__main__":
    main()
