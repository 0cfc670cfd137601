"""The mesh with its layers cut open."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pyvista as pv
import xarray as xr
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from ..geometry.mesh.tissue_mesh import TissueMesh, true_volumes
from ..ports import Port
from .data import Results
from .scene import MM, add_bones, add_device, add_grid, add_labels, plotter_for, trimmed, volume_grid
from .style import ACTUATORS, COLUMN, GREY, INK, PAGE, TISSUES, sheet, styled


def tissue_colours(names: Sequence[str]) -> list[str]:
    """One colour per tissue; unknown ones take the actuators' cycle."""
    return [TISSUES.get(n) or ACTUATORS[k % len(ACTUATORS)] for k, n in enumerate(names)]


def cutaway(results: Results) -> xr.Dataset:
    """``volume`` [m^3] and ``tetrahedra`` of each tissue, and a ``picture`` of the run's mesh with everything
    wristwards of an actuator row and to one side taken away."""
    mesh, ports = results.mesh, (*results.transfer.inputs, *results.transfer.outputs)
    n = len(mesh.region_names)
    return xr.Dataset(
        {"volume": ("tissue", np.bincount(mesh.region, weights=true_volumes(mesh), minlength=n), {"units": "m3"}),
         "tetrahedra": ("tissue", np.bincount(mesh.region, minlength=n)),
         "picture": (("row", "column", "rgb"), cutaway_picture(mesh, ports), {"table": "no"})},
        {"tissue": list(mesh.region_names)}, {"vertices": len(mesh.points)},
    )  # fmt: skip


def cutaway_picture(mesh: TissueMesh, ports: Sequence[Port]) -> Any:
    """Off-screen picture; a box on the camera's side is cut away down to the bones, past the first actuator."""
    grid, low = volume_grid(mesh), MM * mesh.points.min(axis=0)
    coil = MM * np.array(ports[0].position)
    box = (low[0] - 1, coil[0] + 1, low[1] - 1, coil[1] + 14, low[2] - 1, 1e3)
    with plotter_for((1500, 1000)) as plotter:
        part = grid.clip_box(box, invert=True)
        for i, colour in enumerate(tissue_colours(mesh.region_names)):
            cells = np.flatnonzero(part.cell_data["region"] == i)
            if len(cells):
                plotter.add_mesh(part.extract_cells(cells), color=colour, show_edges=True, edge_color="#4A3A34",
                                 line_width=0.6, ambient=0.4)  # fmt: skip
        add_bones(plotter, mesh)
        add_device(plotter, ports, opacity=0.5)
        add_grid(plotter, ports)
        corner = low - 3  # at the lower front: arrows along the axes
        for direction, name in (((1, 0, 0), "x, elbow"), ((0, 1, 0), "y"), ((0, 0, 1), "z")):
            arrow = pv.Arrow(start=corner, direction=direction, scale=14, shaft_radius=0.03, tip_radius=0.08)
            plotter.add_mesh(arrow, color=GREY)
            add_labels(plotter, np.array([corner + 16 * np.array(direction)]), [name], size=18)
        whole = np.array(grid.bounds).reshape(3, 2)
        plotter.camera_position = [(-1.0, -1.15, 0.85), (0, 0, 0), (0, 0, 1)]
        plotter.reset_camera(bounds=(whole + np.array([[-16, 6], [-16, 6], [-2, 12]])).ravel())
        plotter.camera.zoom(1.1)
        return np.array(plotter.screenshot(None, return_img=True))


@styled
def plot_cutaway(data: xr.Dataset, *, width: int = PAGE) -> Figure:
    """The cut mesh with its tissues named."""
    picture, _ = trimmed(data.picture.values)
    columns = data.sizes["tissue"] if width > COLUMN else 1
    figure = sheet(width, 16 + 4 * data.sizes["tissue"] // columns + width * picture.shape[0] / picture.shape[1])
    axes = figure.add_subplot()
    axes.imshow(picture, interpolation="lanczos")
    axes.axis("off")
    counts = data.tetrahedra.values
    labels = [
        f"{n}: {1e6 * v:.0f} cm³, {c:,} tetrahedra"
        for n, v, c in zip(data.tissue.values, data.volume.values, counts, strict=True)
    ]
    colours = tissue_colours([str(n) for n in data.tissue.values])
    handles = [Patch(fc=c, ec=INK, lw=0.4, label=t) for c, t in zip(colours, labels, strict=True)]
    axes.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, 0.0), ncols=columns)
    axes.set_title(f"{data.vertices:,} vertices, {counts.sum():,} tetrahedra")
    return figure
