"""How good an arm's library is: arrangements that it has not seen against full runs of the same accuracy.

    python benchmarks/library.py SCENARIO FOLDER [--count 20] [--set KEY=VALUE ...]

Makes ``FOLDER/arm.library.nc`` where it is not there, then solves one arrangement after another (2x2, 2x3, 3x3, free,
in turn) and appends a line to ``FOLDER/library.csv``: e_band of G and its estimate, the largest relative difference of
S, seconds. Lines that are there are not made again.
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
from forearm_fem.pipeline.simulation import render_transfer
from forearm_fem.scenario import Scenario, load_scenario, parse_scenario
from forearm_fem.transfer import band_error, relative_error, total_error

_KINDS = ("2x2", "2x3", "3x3", "free")
_COLUMNS = ("number", "kind", "e_band", "stated", "interpolation", "worst", "s_worst", "library_s", "full_s")


def arrangement(scenario: Scenario, number: int) -> tuple[str, Scenario]:
    """The ``number``-th arrangement on the patch: its kind and its scenario."""
    rng, kind = np.random.default_rng(number), _KINDS[number % len(_KINDS)]
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
    data = scenario.model_dump(mode="json")
    return kind, parse_scenario({**data, "device": {**data["device"], "contacts": contacts.round(6).tolist()}})


def compared(library: ArmLibrary, scenario: Scenario) -> dict[str, float]:
    """One arrangement by the library and by a full run."""
    began = time.monotonic()
    ours = simulate(scenario, library=library)
    drawn = render_transfer(scenario, ours.transfer)
    took = time.monotonic() - began
    began = time.monotonic()
    full = simulate(scenario)
    truth = render_transfer(scenario, full.transfer)
    off = np.abs(np.array(drawn.strengths) / np.array(truth.strengths) - 1)
    named = {e.source: e.band for e in ours.transfer.errors}
    return {
        "e_band": band_error(ours.transfer.values, full.transfer.values),
        "stated": total_error(ours.transfer.errors),
        "interpolation": named.get("interpolation", float("nan")),
        "worst": float(relative_error(ours.transfer.values, full.transfer.values).max()),
        "s_worst": float(np.nanmax(off)),
        "library_s": took,
        "full_s": time.monotonic() - began,
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
    done = len(table.read_text().splitlines()) - 1 if table.is_file() else -1
    with table.open("a", newline="") as stream:
        writer = csv.DictWriter(stream, _COLUMNS)
        if done < 0:
            writer.writeheader()
        for number in range(max(done, 0), asked.count):
            kind, one = arrangement(scenario, number)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                row = compared(library, one)
            writer.writerow({"number": number, "kind": kind, **{k: f"{v:.4g}" for k, v in row.items()}})
            stream.flush()


if __name__ == "__main__":
    main()
