"""The same quarter slab in other programs, side by side: peers.csv and assembly.csv, on the page of `speed.py`.

    python3 -m venv v && v/bin/pip install ngsolve mkl
    apt-get install python3-dolfinx-complex libopenblas0-pthread  # PETSc and MUMPS are 3.5 times slower without
    python benchmarks/peers.py --ngsolve v/bin/python --fenicsx /usr/bin/python3 [--scale 2.0] [--frequencies 400 100]
    python benchmarks/peers.py --ngsolve v/bin/python --fenicsx /usr/bin/python3 --assembly --scale 0.48

Each program runs in its own interpreter (the paths given), one after the other, with the same threads, mesh, element
pair (P2/P1) and frequencies. A program whose path is not given is left out; what fails or does not finish in
``--patience`` seconds is stated. With one thread seconds are of the processor, with more of the wall. Rows of earlier
runs stay, and are not run again without ``--again``.

The programs that have no reduction pay one factorisation per bin: their full G of 981 bins is the first frequency, and
980 times what each later one cost here, without assembly (a user would sum matrices) and, where their interface
allows it, without analysis.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bench.isolated import threads
from bench.scene import exact, quarter
from bench.tables import read_rows, record_machine, write_csv
from bench.text import write_page
from forearm_fem.fem.space.numbering import mixed_space
from forearm_fem.geometry.build import build_mesh
from forearm_fem.scenario.model import resolve_tissues

HERE = Path(__file__).parent
BINS = 981
POINT = 2  # output at 10 mm
KEY = ("scale", "program", "solver")
SOLVERS = {
    "ours": ("double", "single"),
    "ngsolve": ("pardiso", "sparsecholesky"),  # umfpack: "Numeric factorization failed" on the mesh tried
    "fenicsx": ("mumps", "mumps-jumps"),
}
NAMES = {"ours": "forearm_fem", "ngsolve": "NGSolve", "fenicsx": "FEniCSx"}
COLUMNS = (
    *KEY, "version", "threads", "unknowns", "seconds_assembly", "seconds_factorisation", "seconds_solve",
    "seconds_single", "seconds_full", "seconds_full_direct", "solves", "peak_bytes", "error_exact", "error_reduction",
    "difference", "single_ratio", "full_ratio", "runs", "compliances", "note",
)  # fmt: skip
Row = dict[str, Any]


def scene_file(path: Path, scale: float, count: int, frequency: Sequence[float]) -> None:
    """Mesh, tissues and loads of the scene for the peers."""
    scenario = quarter()
    space = mixed_space(build_mesh(scenario, scale=scale), "P2")
    mesh, tissues, omega = space.mesh, resolve_tissues(scenario), 2 * np.pi * np.array(frequency)
    chosen = [tissues[n] for n in mesh.region_names]
    names = {"contact A1": "contact", "symmetry x": "symmetryx", "symmetry y": "symmetryy"}
    parts = {f"facets {new}": mesh.facets[old] for old, new in names.items()}
    behind = mesh.region[space.owners(mesh.facets["end"])[0]]
    parts |= {f"facets end_{n}": mesh.facets["end"][behind == k] for k, n in enumerate(mesh.region_names)}
    free = _rest(mesh.facets["skin"], mesh.facets["contact A1"])
    np.savez(
        path, points=mesh.points, tetrahedra=mesh.tetrahedra, region=mesh.region,
        region_names=np.array(mesh.region_names),
        boundary_names=np.array([*(n.removeprefix("facets ") for n in parts), "skin"]), **parts,
        **{"facets skin": free},
        mu=np.array([t.modulus.at(omega) for t in chosen]), density=np.array([t.density for t in chosen]),
        bulk=np.array([t.bulk for t in chosen]), frequency=np.array(frequency), threads=count, scale=scale,
        impedance=np.array([np.sqrt(t.density * abs(t.modulus.at(np.array([0.0]))[0])) for t in chosen]),
        pressure_scale=1e6,
        disc_area=_area(mesh.points[mesh.facets["contact A1"]]), point=np.array([0.010, 0.0, 0.0]),
    )  # fmt: skip


def _rest(skin: np.ndarray, contact: np.ndarray) -> np.ndarray:
    taken = {tuple(f) for f in np.sort(contact, axis=1).tolist()}
    return np.array([f for f in skin.tolist() if tuple(sorted(f)) not in taken])


def _area(corners: np.ndarray) -> float:
    a, b, c = corners.transpose(1, 0, 2)
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def one_run(python: str, script: str, scene: Path, solver: str, patience: float) -> Row | str:
    """What a program printed, or why it printed nothing."""
    command = [python, str(HERE / script), str(scene), solver]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=patience, check=False)
    except subprocess.TimeoutExpired:
        return f"not done in {patience:g} s"
    except OSError as problem:
        return f"not run: {problem.strerror}"
    lines = [line for line in done.stdout.splitlines() if line.startswith("{")]
    if done.returncode or not lines:
        last = (done.stderr or done.stdout).strip().splitlines()[-1:] or ["killed, most likely for memory"]
        return f"failed: {last[0][:120]}"
    return dict(json.loads(lines[-1]))


def timed(program: str, solver: str, python: str, scene: Path, asked: argparse.Namespace) -> Row:
    """Median of the repeats of a program and solver as a row of peers.csv."""
    head = {"scale": f"{asked.scale:g}", "program": NAMES[program], "solver": solver, "threads": asked.threads}
    runs = []
    for _ in range(asked.repeats):
        found = one_run(python, f"peers_{program}.py", scene, solver, asked.patience)
        if isinstance(found, str):
            return {**head, "note": found}
        runs.append(found)
    steps = np.median([r["steps"] for r in runs], axis=0)  # (frequency, assembly | factorisation | solve)
    single, later = float(steps[0].sum()), steps[1:] if len(steps) > 1 else steps
    extrapolated = single + (BINS - 1) * float(later[:, 1:].sum(axis=1).mean())
    full = statistics.median(r.get("seconds_full", extrapolated) for r in runs)
    values, reduced = (_complex(runs[0].get(k, runs[0]["compliances"])) for k in ("compliances", "reduced"))
    order = np.argsort(asked.frequencies)
    truth = exact(np.array(asked.frequencies)[order])[np.argsort(order), :, 0]
    off = np.abs(values - truth[:, POINT]) / np.abs(truth).max(axis=1)
    return {
        **head, "version": runs[0]["version"], "unknowns": runs[0]["unknowns"],
        **dict(zip(("seconds_assembly", "seconds_factorisation", "seconds_solve"), steps[0].tolist(), strict=True)),
        "seconds_single": single, "seconds_full": full, "seconds_full_direct": extrapolated, "solves": len(steps),
        "peak_bytes": max(r["peak_bytes"] for r in runs), "error_reduction": _apart(reduced, values),
        "error_exact": float(off.max()), "runs": len(runs),
        "compliances": " ".join(f"{v.real:.8g}{v.imag:+.8g}j" for v in values),
    }  # fmt: skip


def _complex(pairs: Sequence[Sequence[float]]) -> np.ndarray:
    return np.array(pairs) @ np.array([1, 1j])


def _apart(values: np.ndarray, truth: np.ndarray) -> float:
    """Worst relative difference over the frequencies at the point."""
    return float(np.max(np.abs(values - truth) / np.abs(truth)))


def compared(rows: Sequence[Row]) -> list[Row]:
    """Every row with all columns: ratios to our default's row of its scale, difference of compliances."""
    ours = {r["scale"]: r for r in rows if (r["program"], r["solver"]) == (NAMES["ours"], "single")}
    done = []
    for row in rows:
        extra = {}
        if not row.get("note") and (mine := ours.get(row["scale"])) is not None:
            theirs, here = (np.array(r["compliances"].split(), dtype=complex) for r in (row, mine))
            extra["difference"] = _apart(theirs, here) if len(theirs) == len(here) else ""
            for name in ("single", "full"):
                extra[f"{name}_ratio"] = float(row[f"seconds_{name}"]) / float(mine[f"seconds_{name}"])
        done.append({**dict.fromkeys(COLUMNS, ""), **row, **extra})
    return done


def assembled(program: str, python: str, scene: Path, asked: argparse.Namespace) -> Row:
    """Median seconds of assembly as a row of assembly.csv: peers one complex matrix, ours K, C, M and B."""
    head = {"scale": f"{asked.scale:g}", "program": NAMES[program], "threads": asked.threads,
            "tetrahedra": len(np.load(scene)["tetrahedra"])}  # fmt: skip
    runs = [one_run(python, f"peers_{program}.py", scene, "assembly", asked.patience) for _ in range(asked.repeats)]
    if bad := [r for r in runs if isinstance(r, str)]:
        return {**head, "unknowns": "", "what": bad[0], "seconds": "", "seconds_operator": "", "runs": 0}
    what = "K, C, M and B of each tissue" if program == "ours" else "one complex matrix"
    seconds = {k: statistics.median(r[k] for r in runs) if k in runs[0] else ""
               for k in ("seconds_assembly", "seconds_operator")}  # fmt: skip
    return {**head, "unknowns": runs[0]["unknowns"], "what": what, "seconds": seconds["seconds_assembly"],
            "seconds_operator": seconds["seconds_operator"], "runs": len(runs)}  # fmt: skip


def merged(rows: Sequence[Row], fresh: Row, keys: Sequence[str]) -> list[Row]:
    """``rows`` with ``fresh`` instead of the one with the same keys."""
    return [*(r for r in rows if any(r[k] != fresh[k] for k in keys)), fresh]


def run_peers(asked: argparse.Namespace, pythons: dict[str, str], scene: Path, out: Path) -> None:
    """All programs and solvers at one scale, each row written as soon as it is there."""
    record_machine(out, "peers")
    rows: list[Row] = [dict(r) for r in read_rows(out / "peers.csv")]
    for program, python in pythons.items():
        for solver in SOLVERS[program]:
            key = (f"{asked.scale:g}", NAMES[program], solver)
            if asked.only and solver not in asked.only:
                continue
            if not asked.again and key in {tuple(r[k] for k in KEY) for r in rows}:
                continue
            rows = compared(merged(rows, timed(program, solver, python, scene, asked), KEY))
            write_csv(out / "peers.csv", rows)
            print(_told(rows[-1]), flush=True)


def _told(row: Row) -> str:
    name = f"{row['program']} {row['solver']}"
    if row["note"]:
        return f"{name}: {row['note']}"
    ratios = "".join(f", {n} {row[f'{n}_ratio']:.3g} x ours" for n in ("single", "full") if row[f"{n}_ratio"] != "")
    return (
        f"{name}: {row['unknowns']} unknowns, one frequency {row['seconds_single']:.3g} s, "
        f"full G {row['seconds_full']:.4g} s{ratios}, true error {row['error_exact']:.2g}"
    )


def run_assembly(asked: argparse.Namespace, pythons: dict[str, str], scene: Path, out: Path) -> None:
    """One assembly per program."""
    record_machine(out, "assembly")
    rows: list[Row] = [dict(r) for r in read_rows(out / "assembly.csv")]
    for program, python in pythons.items():
        rows = merged(rows, assembled(program, python, scene, asked), ("scale", "program"))
        write_csv(out / "assembly.csv", rows)
        print(rows[-1], flush=True)


def _asked() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--ngsolve", help="python that has NGSolve")
    parser.add_argument("--fenicsx", help="python that has complex DOLFINx")
    parser.add_argument("--scale", type=float, default=2.0, help="of all element sizes")
    parser.add_argument("--frequencies", type=float, nargs="+", default=[400.0, 100.0, 250.0], help="[Hz]")
    parser.add_argument("--only", nargs="+", help="solvers, e.g. double mumps-jumps")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--patience", type=float, default=600, help="seconds a run may take")
    parser.add_argument("--assembly", action="store_true", help="time one assembly only")
    parser.add_argument("--again", action="store_true", help="also what peers.csv has already")
    parser.add_argument("--out", type=Path, default=HERE / "results")
    return parser.parse_args()


def main() -> None:
    """Run all programs found and write the tables and the page."""
    asked = _asked()
    pythons = {"ours": sys.executable, "ngsolve": asked.ngsolve, "fenicsx": asked.fenicsx}
    found = {name: python for name, python in pythons.items() if python}
    with tempfile.TemporaryDirectory() as folder, threads(asked.threads):
        scene = Path(folder) / "scene.npz"
        scene_file(scene, asked.scale, asked.threads, asked.frequencies)
        (run_assembly if asked.assembly else run_peers)(asked, found, scene, asked.out)
    write_page(asked.out)


if __name__ == "__main__":
    main()
