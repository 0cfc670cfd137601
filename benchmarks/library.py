"""How good an arm's library is: arrangements that it has not seen against full runs of the same accuracy.

    python benchmarks/library.py SCENARIO FOLDER [--count 20] [--set KEY=VALUE ...]

Makes ``FOLDER/arm.library.nc`` where it is not there, then solves one arrangement after another (2x2, 2x3, 3x3, free,
in turn) and writes a line each to ``FOLDER/library.csv``: e_band of G and its estimate, the largest relative difference
of S, what its interval states and how many S lie in it, seconds. Full runs are kept in ``FOLDER/raw`` and not made
again.
"""

from __future__ import annotations

import argparse
import csv
import json
import time
import warnings
from pathlib import Path

import numpy as np

from forearm_fem.library import ArmLibrary, load_library, make_library, save_library
from forearm_fem.pipeline import simulate
from forearm_fem.pipeline.simulation import account_of, render_transfer
from forearm_fem.scenario import Scenario, load_scenario, parse_scenario
from forearm_fem.transfer import band_error, relative_error, total_error

_KINDS = ("2x2", "2x3", "3x3", "free")
_CLEAR = 5e-4  # [m] between a rim and a grid point, either way: the field of a rigid disc has a root there
_LOW = 100.0  # [Hz]: the table gives the error below and above
_SOURCES = ("interpolation", "quadrature", "contact", "reduction", "discretisation", "truncation")
_COLUMNS = (
    "number", "kind", "e_band", "stated", "effectivity", "e_below", "e_above", *_SOURCES,
    "worst", "s_worst", "s_median", "s_stated", "s_inside", "library_s", "full_s",
)  # fmt: skip


def arrangement(scenario: Scenario, number: int) -> tuple[str, Scenario]:
    """The ``number``-th arrangement on the patch whose rims keep off grid points: its kind and its scenario."""
    points = np.array(scenario.grid.places)
    for attempt in range(100):
        kind, contacts = drawn(scenario, number, attempt)
        gap = np.linalg.norm(points[:, None] - contacts, axis=2) - scenario.device.cone.radius
        if not ((gap > -_CLEAR) & (gap < _CLEAR)).any():
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
    """G, S and seconds of a full run, from ``raw`` where it is there."""
    if not raw.is_file():
        began = time.monotonic()
        transfer = simulate(scenario).transfer
        strengths = np.array(render_transfer(scenario, transfer).strengths)
        raw.parent.mkdir(exist_ok=True)
        np.savez(raw, frequency=transfer.frequency, full=transfer.values, s_full=strengths,
                 seconds=time.monotonic() - began, contacts=np.array(scenario.device.centres))  # fmt: skip
    with np.load(raw) as kept:
        return {name: kept[name] for name in kept.files}


def compared(library: ArmLibrary, scenario: Scenario, raw: Path) -> dict[str, float]:
    """One arrangement by the library and by a full run, which is kept in ``raw``."""
    full = full_run(scenario, raw)
    began = time.monotonic()
    ours = simulate(scenario, library=library).transfer
    rendering = render_transfer(scenario, ours)
    s = np.array(rendering.strengths)
    took = time.monotonic() - began
    account, truth = account_of(scenario, ours, rendering), full["s_full"]
    off, named = np.abs(s / full["s_full"] - 1), {e.source: e.band for e in ours.errors}
    true, stated = band_error(ours.values, full["full"]), total_error(ours.errors)
    low = full["frequency"] < _LOW
    return {
        "e_band": true,
        "stated": stated,
        "effectivity": stated / true,
        "e_below": band_error(ours.values[low], full["full"][low]),
        "e_above": band_error(ours.values[~low], full["full"][~low]),
        **{source: named.get(source, float("nan")) for source in _SOURCES},
        "worst": float(relative_error(ours.values, full["full"]).max()),
        "s_worst": float(np.nanmax(off)),
        "s_median": float(np.nanmedian(off)),
        "s_stated": float(np.nanmedian(account.high / account.value - 1)),
        "s_inside": float(((account.low <= truth) & (truth <= account.high)).sum() / np.isfinite(truth).sum()),
        "library_s": took,
        "full_s": float(full["seconds"]),
    }


def main() -> None:
    """See the module's heading."""
    parser = argparse.ArgumentParser()
    parser.add_argument("scenario", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--set", nargs="*", default=[])
    asked = parser.parse_args()
    asked.folder.mkdir(parents=True, exist_ok=True)
    scenario = load_scenario(asked.scenario, overrides=asked.set)
    file, table = asked.folder / "arm.library.nc", asked.folder / "library.csv"
    if not file.is_file():
        made = make_library(scenario, base=asked.scenario.parent)
        save_library(file, made)
        (asked.folder / "library.json").write_text(json.dumps({**made.facts, "bytes": file.stat().st_size}))
    library = load_library(file)
    with table.open("w", newline="") as stream:
        writer = csv.DictWriter(stream, _COLUMNS)
        writer.writeheader()
        for number in range(asked.count):
            kind, one = arrangement(scenario, number)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                row = compared(library, one, asked.folder / "raw" / f"{number:02d}.npz")
            writer.writerow({"number": number, "kind": kind, **{k: f"{v:.4g}" for k, v in row.items()}})
            stream.flush()


if __name__ == "__main__":
    main()
