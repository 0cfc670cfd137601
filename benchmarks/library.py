"""How good an arm's library is: arrangements that it has not seen against full runs of the same accuracy.

    python benchmarks/library.py SCENARIO FOLDER [--count 20] [--set KEY=VALUE ...]

Makes ``FOLDER/arm.library.nc`` where it is not there, then solves one arrangement after another (2x2, 2x3, 3x3, free,
in turn) and writes a line each to ``FOLDER/library.csv``: e_band of G and its estimate, how far S is off (both sides
driven alike), what its interval states and how many S lie in it, seconds of one processor for all that is stated and S.
Full runs are kept in ``FOLDER/raw`` and not made again, nor are lines that the table has.
"""

from __future__ import annotations

import argparse
import csv
import json
import time
import warnings
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from forearm_fem.engines.library import ArmLibrary, load_library, make_library, save_library
from forearm_fem.engines.library.arm import library_skin
from forearm_fem.engines.simulation import render_transfer, simulate
from forearm_fem.ports import positions
from forearm_fem.scenario import Scenario, load_scenario, parse_scenario
from forearm_fem.transfer import band_error, relative_error, total_error

_KINDS = ("2x2", "2x3", "3x3", "free")
_CLEAR = 5e-4  # [m] between a rim and a grid point, either way: the field of a rigid disc has a root there
_LOW, _HIGH = 100.0, 250.0  # [Hz]: the table gives the error below, between and above
_SOURCES = ("interpolation", "quadrature", "contact", "reduction", "discretisation", "truncation")
_COLUMNS = (
    "number", "kind", "e_band", "stated", "effectivity", "e_below", "e_middle", "e_above", *_SOURCES,
    "worst", *(f"s_{of}_{m}" for m in ("inverse", "funneling", "combination") for of in ("worst", "median")),
    "s_within", "s_stated", "s_inside", "library_cpu", "full_cpu", "edge",
)  # fmt: skip


def arrangement(scenario: Scenario, number: int) -> tuple[str, Scenario]:
    """The ``number``-th arrangement on the patch whose rims keep off grid points: its kind and its scenario."""
    points, skin, radius = np.array(scenario.grid.places), library_skin(scenario), scenario.device.cone.radius
    half = 0.5 * np.array([scenario.library.length, scenario.library.width])
    for attempt in range(100):
        kind, contacts = drawn(scenario, number, attempt)
        gap = np.linalg.norm(points[:, None] - contacts, axis=2) - radius
        on_patch = np.abs(skin.flat(skin.skin(contacts)[0])) + radius <= half
        if on_patch.all() and not ((gap > -_CLEAR) & (gap < _CLEAR)).any():
            break
    data = scenario.model_dump(mode="json")
    return kind, parse_scenario({**data, "device": {**data["device"], "contacts": contacts.round(6).tolist()}})


def drawn(scenario: Scenario, number: int, attempt: int) -> tuple[str, np.ndarray]:
    """Kind and places (n, 2) [m] of an arrangement, by chance."""
    rng, kind = np.random.default_rng([number, attempt]), _KINDS[number % len(_KINDS)]
    patch, radius = scenario.library, scenario.device.cone.radius
    half = 0.5 * np.array([patch.length, 0.9 * patch.width]) - radius  # arcs are longer than y
    if kind == "free":
        places: list[np.ndarray] = []
        while len(places) < 4:
            place = rng.uniform(-half, half)
            if all(np.linalg.norm(place - p) > 3 * radius for p in places):
                places.append(place)
        contacts = np.array(places)
    else:
        rows, columns = (int(n) for n in kind.split("x"))
        counts = np.array([rows, columns])
        pitch = rng.uniform(3 * radius, 2 * half / (counts - 1))
        grid = np.stack(np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij"), -1).reshape(-1, 2)
        contacts = (grid - (counts - 1) / 2) * pitch
    return kind, contacts


def full_run(scenario: Scenario, raw: Path) -> dict[str, np.ndarray]:
    """G of a full run and its seconds of processors, from ``raw`` where it is there."""
    if not raw.is_file():
        began = time.process_time()
        transfer = simulate(scenario).transfer
        raw.parent.mkdir(exist_ok=True)
        np.savez(raw, frequency=transfer.frequency, full=transfer.values, cpu=time.process_time() - began)
    with np.load(raw) as kept:
        return {name: kept[name] for name in kept.files}


def compared(library: ArmLibrary, scenario: Scenario, raw: Path) -> dict[str, float]:
    """One arrangement by the library and by a full run, which is kept in ``raw``."""
    full = full_run(scenario, raw)
    began = time.process_time()
    ours = simulate(scenario, engine=library).transfer
    rendering = render_transfer(scenario, ours)
    account = rendering.strength
    took = time.process_time() - began
    theirs = replace(ours, values=full["full"], errors=())
    truth = np.array(render_transfer(scenario, theirs).strengths)
    off, named = np.abs(np.array(rendering.strengths) / truth - 1), {e.source: e.band for e in ours.errors}
    true, stated, f = band_error(ours.values, full["full"]), total_error(ours.errors), full["frequency"]
    e_below, e_middle, e_above = (
        band_error(ours.values[of], full["full"][of]) for of in (f < _LOW, (f >= _LOW) & (f < _HIGH), f >= _HIGH)
    )
    methods = {f"s_{of}_{name.split()[0]}": float(pick(row)) for name, row in zip(rendering.methods, off, strict=True)
               for of, pick in (("worst", np.max), ("median", np.median))}  # fmt: skip
    half = 0.5 * np.array([library.scenario.library.length, library.scenario.library.width])
    discs = library.skin.flat(positions([port for port in library.ports(scenario) if port.kind == "contact"]))
    return {
        "e_band": true, "stated": stated, "effectivity": stated / true,
        "e_below": e_below, "e_middle": e_middle, "e_above": e_above,
        **{source: named.get(source, float("nan")) for source in _SOURCES},
        "worst": float(relative_error(ours.values, full["full"]).max()),
        **methods,
        "s_within": float((off < 0.05).mean()),
        "s_stated": float(np.nanmedian(account.high / account.value - 1)),
        "s_inside": float(((account.low <= truth) & (truth <= account.high)).sum() / np.isfinite(truth).sum()),
        "library_cpu": took,
        "full_cpu": float(full.get("cpu", np.nan)),
        "edge": 1e3 * float((half - np.abs(discs)).min()),
    }  # fmt: skip


def rows_of(table: Path) -> dict[int, dict[str, str]]:
    """Lines of the ``table`` by their number; none where there is no table."""
    if not table.is_file():
        return {}
    with table.open(newline="") as stream:
        return {int(row["number"]): row for row in csv.DictReader(stream)}


def write(table: Path, rows: Iterable[dict[str, str]]) -> None:
    """The ``table`` with all ``rows``."""
    with table.open("w", newline="") as stream:
        writer = csv.DictWriter(stream, _COLUMNS, restval="")
        writer.writeheader()
        writer.writerows(rows)


def main() -> None:
    """See the module's heading."""
    parser = argparse.ArgumentParser()
    parser.add_argument("scenario", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--set", action="extend", nargs="*", default=[])
    asked = parser.parse_args()
    asked.folder.mkdir(parents=True, exist_ok=True)
    scenario = load_scenario(asked.scenario, overrides=asked.set)
    file, table = asked.folder / "arm.library.nc", asked.folder / "library.csv"
    if not file.is_file():
        made = make_library(scenario, base=asked.scenario.parent)
        save_library(file, made)
        (asked.folder / "library.json").write_text(json.dumps({**made.facts, "bytes": file.stat().st_size}))
    library = load_library(file)
    rows = rows_of(table)
    for number in range(asked.count):
        if number in rows:
            continue
        kind, one = arrangement(scenario, number)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            row = compared(library, one, asked.folder / "raw" / f"{number:02d}.npz")
        rows[number] = {"number": str(number), "kind": kind, **{k: f"{v:.4g}" for k, v in row.items()}}
        write(table, (rows[k] for k in sorted(rows)))


if __name__ == "__main__":
    main()
