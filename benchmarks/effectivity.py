"""Estimated against true error over scenes and meshes: benchmarks/results/effectivity.csv and .png.

Run from the repository: python3 benchmarks/effectivity.py [folder]
"""

from __future__ import annotations

import csv
import sys
from dataclasses import fields
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from forearm_fem.verification.slabs import SCENES, Effectivity, effectivities, scene_name


def write_csv(points: list[Effectivity], file: Path) -> None:
    """Fields of each point, and its effectivities."""
    with file.open("w", newline="") as stream:
        table = csv.writer(stream)
        names = [f.name for f in fields(Effectivity)]
        table.writerow([*names, "effectivity_band", "effectivity_single"])
        table.writerows([*(getattr(p, n) for n in names), p.band, p.single] for p in points)


def draw(points: list[Effectivity], file: Path) -> None:
    """Estimated over true errors, a colour for each scene."""
    figure, axes = plt.subplots(figsize=(7.5, 5), layout="constrained")
    axes.set_prop_cycle(color=plt.colormaps["tab20"](np.linspace(0, 1, 20)))  # more scenes than the ten usual colours
    for scene in dict.fromkeys(p.scene for p in points):
        mine = [p for p in points if p.scene == scene]
        (line,) = axes.loglog([p.true_band for p in mine], [p.estimated_band for p in mine], "o-", label=scene, ms=5)
        axes.loglog(
            [p.true_single for p in mine], [p.estimated_single for p in mine], "x", color=line.get_color(), ms=5
        )
    true = [t for p in points for t in (p.true_band, p.true_single)]
    ends = np.array([min(true) / 2, max(true) * 2])
    axes.loglog(ends, ends, "k-", lw=0.8)
    axes.fill_between(ends, 0.5 * ends, 5 * ends, color="0.9", zorder=0, label="effectivity 0.5 ... 5")
    axes.set(xlabel="true error against the layered twin", ylabel="estimated (o band, x one frequency)", xlim=ends)
    axes.legend(fontsize=7, loc="upper left", bbox_to_anchor=(1.01, 1))
    figure.savefig(file, dpi=150)
    plt.close(figure)


def read_csv(file: Path) -> list[Effectivity]:
    """Points of an earlier run that was interrupted."""
    if not file.exists():
        return []
    kinds = {"scene": str, "unknowns": int}
    with file.open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    return [Effectivity(**{f.name: kinds.get(f.name, float)(r[f.name]) for f in fields(Effectivity)}) for r in rows]


def told(point: Effectivity) -> str:
    """One line of progress."""
    band = f"band {point.estimated_band:.4f} {point.true_band:.4f} {point.band:.2f}"
    single = f"single {point.estimated_single:.4f} {point.true_single:.4f} {point.single:.2f}"
    return f"{point.scene:24s} x{point.scale:<4g}{point.unknowns:7d}  {band}  {single}"


def main(folder: Path) -> None:
    """Scenes that the table in ``folder`` lacks, then the table and its picture."""
    folder.mkdir(parents=True, exist_ok=True)
    points = read_csv(folder / "effectivity.csv")
    done = {p.scene for p in points}
    for slab in (s for s in SCENES if scene_name(s) not in done):
        fresh = list(effectivities([slab]))
        print("\n".join(map(told, fresh)), flush=True)
        points += fresh
        write_csv(points, folder / "effectivity.csv")
    draw(points, folder / "effectivity.png")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "benchmarks/results"))
