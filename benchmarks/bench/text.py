"""The page beside the plots: what each shows, and a sentence on what to choose, computed from the CSV files."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from pathlib import Path

from forearm_fem.store.folder import write_text

from .plots import CURVES
from .tables import Row, read_rows

ASKED = (0.2, 0.1, 0.05, 0.02)


def write_page(folder: Path) -> Path:
    """``README.md`` in the results folder, from the CSV files that are there."""
    parts = [
        "# Benchmark results",
        "",
        "Written by `python benchmarks/speed.py`; every figure is drawn from the CSV beside it. What each part was",
        "timed on and with is in [machine.csv](machine.csv).",
        "",
    ]
    machines = {row.get("part", ""): row for row in read_rows(folder / "machine.csv")}
    for name, make in (
        ("error", _error),
        ("size", _size),
        ("asked", _asked),
        ("reduced", _reduced),
        ("peers", _peers),
        ("assembly", _assembly),
    ):
        if rows := read_rows(folder / f"{name}.csv"):
            title, *rest = make(rows)
            parts += [title, "", *_machine(machines.get(name)), *rest[1:]]
    write_text(folder / "README.md", "\n".join(parts) + "\n")
    return folder / "README.md"


def _machine(row: Row | None) -> list[str]:
    """The part's own machine; parts are run one by one, and machines differ."""
    if row is None:
        return []
    threads, load = f"Threads: {row['threads']} of {row['cores']}", str(row["load_at_start"])
    beside = ", beside other work" if load != "unknown" and float(load) > 1.5 else ""
    return [f"*forearm_fem {row['forearm_fem']}, {row['processor']}. {threads}{beside}.*", ""]


def cheapest(rows: Sequence[Row], error: float, *, method: str | None = None) -> Row | None:
    """Least processor time at a true error of at most ``error``; the twin, which has no limb, left out."""
    good = [r for r in rows if float(r["error_worst"]) <= error and r["method"] != "twin"]
    good = [r for r in good if method is None or r["method"] == method]
    return min(good, key=lambda r: float(r["seconds_cpu"]), default=None)


def _error(rows: Sequence[Row]) -> list[str]:
    lines = ["## Speed against error", "", "![speed against error](error.png)", ""]
    lines += [
        "From scenario to G at 161 bins on a quarter slab (skin, fat, muscle) against the exact layered solution.",
        "Error e is the worst max|dG|/max|G| over 80-400 Hz; direct sweeps are solved at 11 frequencies, their time",
        "extrapolated.",
        "Seconds are of processors; with one thread that is the wall time on an idle machine",
        f"(the wall time of this run was {_stretch(rows):.2f} times that, median).", "",
        "| asked e | cheapest | unknowns | seconds | peak GB | direct sweep, s | ratio |",
        "|---|---|---|---|---|---|---|",
    ]  # fmt: skip
    for error in ASKED:
        if (best := cheapest(rows, error)) is None:
            lines.append(f"| {error:g} | none of these meshes | | | | | |")
            continue
        direct = cheapest(rows, error, method="direct")
        slow = float(direct["seconds_cpu"]) if direct else None
        beside = "not run | " if slow is None else f"{slow:.3g} | {slow / float(best['seconds_cpu']):.3g}"
        lines.append(
            f"| {error:g} | {_label(best)} | {best['unknowns']} | {float(best['seconds_cpu']):.3g} | "
            f"{float(best['peak_bytes']) / 1e9:.2g} | {beside} |"
        )
    return [*lines, "", _choice(rows), ""]


def _stretch(rows: Sequence[Row]) -> float:
    return statistics.median(float(r["seconds"]) / max(float(r["seconds_cpu"]), 1e-9) for r in rows)


def _choice(rows: Sequence[Row]) -> str:
    if all(cheapest(rows, e) is None for e in ASKED):
        return "None of the meshes reached 20 %; run `python benchmarks/speed.py --full`."
    return "**Choose** the second column. The twin costs next to nothing where a flat, endless limb will do."


def _label(row: Row) -> str:
    return CURVES[row["method"], row["element"], row["precision"]][0]


def _asked(rows: Sequence[Row]) -> list[str]:
    head = "| asked | size, mm | unknowns | seconds | peak GB | true e_band | at the points | estimated |"
    lines = ["## Asked for", "", "![asked for](asked.png)", "", head, "|---|---|---|---|---|---|---|---|"]
    for r in rows:
        f = {k: float(v) for k, v in r.items()}
        errors = " | ".join(f"{f[k]:.2g}" for k in ("error_band", "error_points", "estimated_band"))
        lines.append(
            f"| {f['accuracy']:g} | {1e3 * f['size']:.2f} | {r['unknowns']} | {f['seconds_cpu']:.3g} | "
            f"{f['peak_bytes'] / 1e9:.2g} | {errors} |"
        )
    return [
        *lines,
        "",
        "`accuracy` alone chose mesh and elements. All are of the quarter slab at",
        "161 bins, 80-400 Hz. Errors are against the exact",
        "solution, of all outputs and of the points at 10 and 20 mm alone. Seconds leave out the coarser mesh",
        f"that the estimate needs. {_met(rows)}",
        "**Choose** the accuracy that the question needs, then read the estimate.",
        "",
    ]


def _met(rows: Sequence[Row]) -> str:
    said = []
    for key, what in (("error_band", "with all outputs"), ("error_points", "with the points alone")):
        missed = [f"{float(r['accuracy']):g}" for r in rows if float(r[key]) > float(r["accuracy"])]
        said.append(f"{what} missed at {', '.join(missed)}" if missed else f"{what} met")
    return f"What was asked is {', '.join(said)}."


def _size(rows: Sequence[Row]) -> list[str]:
    largest = max(rows, key=lambda r: int(r["unknowns"]))
    steps = ("assembly", "analysis", "factorisation", "solve")
    seconds = " | ".join(f"{float(largest[f'seconds_{s}']):.2g}" for s in steps)
    return [
        "## Cost against size", "", "![cost against size](size.png)", "",
        "| unknowns | precision | assembly, s | analysis, s | factorisation, s | solve, s | peak GB |",
        "|---|---|---|---|---|---|---|",
        f"| {largest['unknowns']} | {largest['precision']} | {seconds} | {float(largest['peak_bytes']) / 1e9:.2g} |",
        "",
        "Exponents: see the legend.",
        *_precisions(rows),
        "",
    ]  # fmt: skip


def _precisions(rows: Sequence[Row]) -> list[str]:
    """Single beside double precision at the largest size that both have."""
    double, single = ({int(r["unknowns"]): r for r in rows if r["precision"] == p} for p in ("double", "single"))
    if not (both := double.keys() & single.keys()):
        return []
    two, one = double[max(both)], single[max(both)]
    time, memory = (float(two[k]) / float(one[k]) for k in ("seconds_factorisation", "peak_bytes"))
    return [
        f"**Choose** single precision where memory ends. At {max(both)} unknowns its factorisation takes",
        f"{1 / time:.2g} of the time. Peak memory is {1 / memory:.2g} of double's, and solves are refined to double",
        f"(residual {float(one['residual']):.0e}).",
    ]


def _reduced(rows: Sequence[Row]) -> list[str]:
    head = "| unknowns | one factorisation, s | reduced, s | in those | direct, s | faster | e | 20,000 bins, s |"
    lines = [
        "## Reduced against direct",
        "",
        "![reduced against direct](reduced.png)",
        "",
        head,
        "|---|---|---|---|---|---|---|---|",
    ]
    for r in rows:
        f = {k: float(v) for k, v in r.items() if k != "solver"}
        lines.append(
            f"| {r['unknowns']} | {f['seconds_factorisation']:.2g} | {f['seconds_reduced_sweep']:.3g} | "
            f"{f['in_factorisations']:.3g} | {f['seconds_direct_sweep']:.3g} | {f['speed_ratio']:.3g} x | "
            f"{f['error_worst']:.1e} | {f['seconds_many_evaluations']:.2g} |"
        )
    end = "**Choose** the reduced sweep (the default); a direct one only to check it."
    return [*lines, "", f"Four discs, nine points, 981 bins; direct sweep from ten solves. {end}", ""]


def _peers(rows: Sequence[Row]) -> list[str]:
    lines = ["## Beside other programs", ""]
    for scale in dict.fromkeys(r["scale"] for r in rows):
        lines += [*_peer_table([r for r in rows if r["scale"] == scale]), ""]
    return [
        *lines,
        "The same tetrahedra, P2/P1 and threads; seconds of processors where there is one thread. Ours is `single`,",
        "the default: factors in single precision, solves refined to 1e-9. One frequency is",
        "assembly, factorisation (analysis included) and solve at 400 Hz. The full G of 981 bins is what ours took;",
        "of the others it is extrapolated: the first frequency and 980 times the mean of the later ones, without",
        "assembly. Column e is the worst error at 10 mm over the largest compliance, against the exact solution; apart",
        "is the relative difference to our compliance there. `mumps` has a pressure that is continuous across tissues,",
        "another discretisation; all others have ours. CalculiX is left out. Made by",
        "`benchmarks/peers.py`.",
        "",
        _peer_choice(rows),
        "",
    ]


def _peer_table(rows: Sequence[Row]) -> list[str]:
    lines = [
        "| program | solver | unknowns | one frequency, s | to ours | 981 bins, s | to ours | peak GB | e | apart |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for r in rows:
        head = f"| {r['program']} {r['version']} | {r['solver']} | "
        if r["note"]:
            lines.append(f"{head}| {r['note']} | | | | | | |")
            continue
        f = {k: float(r[k] or "nan") for k in _PEER_NUMBERS}
        lines.append(
            f"{head}{r['unknowns']} | {f['seconds_single']:.3g} | {f['single_ratio']:.2f} | {f['seconds_full']:.3g} | "
            f"{f['full_ratio']:.3g} | {f['peak_bytes'] / 1e9:.2g} | {f['error_exact']:.1e} | {f['difference']:.0e} |"
        )
    return lines


_PEER_NUMBERS = (
    "seconds_single", "single_ratio", "seconds_full", "full_ratio", "peak_bytes", "error_exact", "difference",
)  # fmt: skip


def _peer_choice(rows: Sequence[Row]) -> str:
    others = [r for r in rows if r["program"] != "forearm_fem" and r["full_ratio"]]
    if not others:
        return "No other program finished."
    single, full = ([float(r[f"{n}_ratio"]) for r in others] for n in ("single", "full"))
    return (
        f"**Choose** the reduced sweep for G: the others take {min(full):.3g} to {max(full):.3g} times as long. For "
        f"one frequency they take {min(single):.2f} to {max(single):.2f} times as long."
    )


def _assembly(rows: Sequence[Row]) -> list[str]:
    lines = ["## Assembly", "", "| program | tetrahedra | what | seconds |", "|---|---|---|---|"]
    for r in rows:
        beside = f" (whole operator: {float(r['seconds_operator']):.2g} s)" if r["seconds_operator"] else ""
        seconds = float(r["seconds"] or "nan")
        lines.append(f"| {r['program']} | {r['tetrahedra']} | {r['what']}{beside} | {seconds:.3g} |")
    end = "**Choose** ours: its matrices serve every frequency and modulus, so nothing is assembled again in a sweep."
    return [*lines, "", f"P2/P1, numbering of the unknowns not counted. {end}", ""]
