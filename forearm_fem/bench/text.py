"""The page beside the plots: what each shows, and a sentence on what to choose, computed from the CSV files."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from pathlib import Path

from ..io.atomic import write_text
from .plots import CURVES, Row, read_rows

ASKED = (0.2, 0.1, 0.05, 0.02)


def write_page(folder: Path) -> Path:
    """``README.md`` in the results folder, from the CSV files that are there."""
    parts = [
        "# Benchmark results",
        "",
        "Written by `forearm-fem bench`; every figure is drawn from the CSV beside it.",
        "",
    ]
    parts += _machine(read_rows(folder / "machine.csv"))
    for name, make in (("error", _error), ("size", _size), ("reduced", _reduced), ("peers", _peers)):
        if rows := read_rows(folder / f"{name}.csv"):
            parts += make(rows)
    write_text(folder / "README.md", "\n".join(parts) + "\n")
    return folder / "README.md"


def _machine(rows: Sequence[Row]) -> list[str]:
    return [", ".join(f"{k} {v}" for k, v in rows[0].items()) + ".", ""] if rows else []


def cheapest(rows: Sequence[Row], error: float, *, method: str | None = None) -> Row | None:
    """Least processor time at a true error of at most ``error``; the twin, which has no limb, left out."""
    good = [r for r in rows if float(r["error_worst"]) <= error and r["method"] != "twin"]
    good = [r for r in good if method is None or r["method"] == method]
    return min(good, key=lambda r: float(r["seconds_cpu"]), default=None)


def _error(rows: Sequence[Row]) -> list[str]:
    lines = ["## Speed against error", "", "![speed against error](error.png)", ""]
    lines += [
        "From scenario to G at 161 bins on a quarter slab (skin, fat, muscle) against the exact layered solution; e is",
        "the worst max|dG|/max|G| over 80-400 Hz (direct sweep: over the 11 frequencies solved, time extrapolated).",
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
    found = [(e, r) for e in ASKED if (r := cheapest(rows, e)) is not None]
    if not found:
        return "None of the meshes reached 20 %; run `forearm-fem bench --full`."
    says = "; ".join(f"{_label(r)} for {100 * e:g} %" for e, r in found)
    return f"**Choose** {says}. The twin costs next to nothing where a flat, endless limb will do."


def _label(row: Row) -> str:
    return CURVES[row["method"], row["element"], row["precision"]][0]


def _size(rows: Sequence[Row]) -> list[str]:
    largest = {
        p: max((r for r in rows if r["precision"] == p), key=lambda r: int(r["unknowns"])) for p in ("double", "single")
    }
    two, one = largest["double"], largest["single"]
    steps = {s: float(two[f"seconds_{s}"]) for s in ("assembly", "analysis", "factorisation", "solve")}
    shares = ", ".join(f"{s} {v:.2g} s" for s, v in steps.items())
    ratio = float(two["seconds_factorisation"]) / float(one["seconds_factorisation"])
    return [
        "## Cost against size", "", "![cost against size](size.png)", "",
        f"At {two['unknowns']} unknowns: {shares}, {float(two['peak_bytes']) / 1e9:.2g} GB. Exponents: see the legend.",
        f"**Choose** single precision where memory ends: its factorisation takes 1/{ratio:.2g} of the time here, and",
        f"{float(one['peak_bytes']) / float(two['peak_bytes']):.2g} of the peak memory; solves are refined to double "
        f"(residual {float(one['residual']):.0e}).",
        "",
    ]  # fmt: skip


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
        f = {k: float(v) for k, v in r.items()}
        lines.append(
            f"| {r['unknowns']} | {f['seconds_factorisation']:.2g} | {f['seconds_reduced_sweep']:.3g} | "
            f"{f['in_factorisations']:.3g} | {f['seconds_direct_sweep']:.3g} | {f['speed_ratio']:.3g} x | "
            f"{f['error_worst']:.1e} | {f['seconds_many_evaluations']:.2g} |"
        )
    end = "**Choose** the reduced sweep (the default); a direct one only to check it."
    return [*lines, "", f"Four discs, nine points, 981 bins; direct sweep from ten solves. {end}", ""]


def _peers(rows: Sequence[Row]) -> list[str]:
    head = "| program | solver | unknowns | assembly, s | factorisation, s | solve, s | compliance at 10 mm, m/N |"
    lines = ["## Beside other programs", "", head, "|---|---|---|---|---|---|---|"]
    lines += [
        f"| {r['program']} {r['version']} | {r['solver']} | {r['unknowns']} | {r['seconds_assembly']} | "
        f"{r['seconds_factorisation']} | {r['seconds_solve']} | {r['compliance']} |"
        for r in rows
    ]
    return [*lines, "", "One frequency (400 Hz) of the quarter slab; made by `benchmarks/peers_*.py`.", ""]
