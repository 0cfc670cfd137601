"""Estimated against true error over scenes and meshes: benchmarks/results/effectivity.csv and .png.

Run from the repository: python3 benchmarks/effectivity.py [folder]
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from forearm_fem.verification.slabs import Effectivity, effectivities


def write_csv(points: list[Effectivity], file: Path) -> None:
    with file.open("w", newline="") as stream:
        table = csv.writer(stream)
        table.writerow(["scene", "scale", "unknowns", "estimated", "true", "effectivity"])
        table.writerows([p.scene, p.scale, p.unknowns, p.estimated, p.true, p.ratio] for p in points)


def draw(points: list[Effectivity], file: Path) -> None:
    figure, axes = plt.subplots(figsize=(5.5, 5), layout="constrained")
    for scene in dict.fromkeys(p.scene for p in points):
        mine = [p for p in points if p.scene == scene]
        axes.loglog([p.true for p in mine], [p.estimated for p in mine], "o-", label=scene, ms=5)
    ends = np.array([min(p.true for p in points) / 2, max(p.true for p in points) * 2])
    axes.loglog(ends, ends, "k-", lw=0.8)
    axes.fill_between(ends, 0.5 * ends, 5 * ends, color="0.9", zorder=0, label="effectivity 0.5 ... 5")
    axes.set(xlabel="true e(f) against the layered twin", ylabel="estimated from two meshes", xlim=ends)
    axes.legend(fontsize=7)
    figure.savefig(file, dpi=150)
    plt.close(figure)


def main(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    points = []
    for point in effectivities():
        points.append(point)
        print(f"{point.scene:28s} x{point.scale:<5g} {point.unknowns:7d} estimated {point.estimated:.4f} "
              f"true {point.true:.4f} ratio {point.ratio:.2f}", flush=True)  # fmt: skip
    write_csv(points, folder / "effectivity.csv")
    draw(points, folder / "effectivity.png")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "benchmarks/results"))
