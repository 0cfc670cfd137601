"""The same quarter slab in other programs, side by side: writes results/peers.csv (part of the page `bench` writes).

    python benchmarks/peers.py --ngsolve /tmp/ngs/bin/python --fenicsx /usr/bin/python3 [--scale 2.0] [--repeats 3]

Each program runs in its own interpreter (the paths given) with the same threads, mesh, element pair (P2/P1) and
frequency; what is not installed is skipped and said so. Medians of the repeats, one after the other.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from forearm_fem import __version__
from forearm_fem.bench.isolated import repeated, threads
from forearm_fem.bench.plots import read_rows
from forearm_fem.bench.run import write_csv
from forearm_fem.bench.scene import quarter
from forearm_fem.bench.size import FREQUENCY, sized
from forearm_fem.bench.text import write_page
from forearm_fem.fem.sweep import direct_sweep
from forearm_fem.tissue import resolve_tissues
from forearm_fem.verification.scenes import DIRECT, slab_model

HERE = Path(__file__).parent
PATIENCE = 60  # s per run of a peer


def scene_file(path: Path, scale: float, count: int) -> str:
    """Mesh, tissues and loads of the scene for the peers; our compliance at 10 mm."""
    scenario = quarter()
    model = slab_model(scenario, scale=scale)
    mesh, tissues = model.space.mesh, resolve_tissues(scenario)
    omega = np.array([2 * np.pi * FREQUENCY])
    chosen = [tissues[n] for n in mesh.region_names]
    names = {"contact A1": "contact", "symmetry x": "symmetryx", "symmetry y": "symmetryy"}
    parts = {f"facets {new}": mesh.facets[old] for old, new in names.items()}
    behind = mesh.region[model.space.owners(mesh.facets["end"])[0]]
    parts |= {f"facets end_{n}": mesh.facets["end"][behind == k] for k, n in enumerate(mesh.region_names)}
    free = _rest(mesh.facets["skin"], mesh.facets["contact A1"])
    np.savez(
        path, points=mesh.points, tetrahedra=mesh.tetrahedra, region=mesh.region,
        region_names=np.array(mesh.region_names),
        boundary_names=np.array([*(n.removeprefix("facets ") for n in parts), "skin"]), **parts,
        **{"facets skin": free},
        mu=np.array([t.modulus.at(omega)[0] for t in chosen]), density=np.array([t.density for t in chosen]),
        bulk=np.array([t.bulk for t in chosen]), frequency=FREQUENCY, threads=count,
        impedance=np.array([np.sqrt(t.density * abs(t.modulus.at(np.array([0.0]))[0])) for t in chosen]),
        pressure_scale=1e6,
        disc_area=_area(mesh.points[mesh.facets["contact A1"]]), point=np.array([0.010, 0.0, 0.0]),
    )  # fmt: skip
    value = direct_sweep(model, np.array([FREQUENCY]), DIRECT).values[0, 2, 0]
    return f"{value.real:.6g}{value.imag:+.6g}j"


def _rest(skin: np.ndarray, contact: np.ndarray) -> np.ndarray:
    taken = {tuple(f) for f in np.sort(contact, axis=1).tolist()}
    return np.array([f for f in skin.tolist() if tuple(sorted(f)) not in taken])


def _area(corners: np.ndarray) -> float:
    a, b, c = corners.transpose(1, 0, 2)
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def peer(python: str, script: str, scene: Path, solver: str, repeats: int, count: int) -> dict[str, Any] | None:
    """Median of the runs of a peer, or None where it is not there or does not finish."""
    names = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")
    environment = {**os.environ, **dict.fromkeys(names, str(count))}
    runs = []
    for _ in range(repeats):
        try:
            done = subprocess.run([python, str(HERE / script), str(scene), solver], capture_output=True, text=True,
                                  timeout=PATIENCE, env=environment, check=False)  # fmt: skip
        except (OSError, subprocess.TimeoutExpired) as problem:
            print(f"{script} {solver}: {type(problem).__name__}, left out")
            return None
        lines = [line for line in done.stdout.splitlines() if line.startswith("{")]
        if done.returncode or not lines:
            print(f"{script} {solver}: left out: {(done.stderr or done.stdout).strip().splitlines()[-1:]}")
            return None
        runs.append(json.loads(lines[-1]))
    steps = ("seconds_assembly", "seconds_factorisation", "seconds_solve")
    return {**runs[0], **{s: statistics.median(r[s] for r in runs) for s in steps}, "runs": len(runs)}


def ours(precision: str, scale: float, value: str) -> dict[str, Any]:
    """Our own figures in the peers' columns."""
    runs = repeated(sized, (precision, scale))
    middle = {s: round(statistics.median(getattr(r, s) for r in runs), 3)
              for s in ("seconds_assembly", "seconds_analysis", "seconds_factorisation", "seconds_solve")}  # fmt: skip
    return {
        "program": "forearm_fem", "version": __version__, "solver": f"PARDISO, {precision}",
        "unknowns": runs[0].unknowns,
        "seconds_assembly": middle["seconds_assembly"],
        "seconds_factorisation": round(middle["seconds_analysis"] + middle["seconds_factorisation"], 3),
        "seconds_solve": middle["seconds_solve"], "compliance": value, "runs": len(runs),
    }  # fmt: skip


def main() -> None:
    """Run all programs found and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--ngsolve", help="python that has NGSolve")
    parser.add_argument("--fenicsx", help="python that has complex DOLFINx")
    parser.add_argument("--scale", type=float, default=2.0)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--threads", type=int, default=1)
    asked = parser.parse_args()
    out = HERE / "results"
    with tempfile.TemporaryDirectory() as folder, threads(asked.threads):
        scene = Path(folder) / "scene.npz"
        value = scene_file(scene, asked.scale, asked.threads)
        rows = [ours(p, asked.scale, value) for p in ("double", "single")]
        solvers = ("sparsecholesky", "umfpack", "pardiso") if asked.ngsolve else ()
        wanted = [(asked.ngsolve, "peers_ngsolve.py", s) for s in solvers]
        wanted += [(asked.fenicsx, "peers_fenicsx.py", "mumps")] if asked.fenicsx else []
        for python, script, solver in wanted:
            if (row := peer(python, script, scene, solver, asked.repeats, asked.threads)) is not None:
                rows.append(row)
    write_csv(out / "peers.csv", rows)
    write_page(out)
    for row in read_rows(out / "peers.csv"):
        print(dict(row))


if __name__ == "__main__":
    main()
