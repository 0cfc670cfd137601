"""The mesh: its layers cut open, and how well it resolves the waves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyvista as pv
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import BoundaryNorm
from matplotlib.figure import FigureBase
from matplotlib.patches import Patch

from ..geometry.device.sizing import tetrahedron_orders
from ..geometry.mesh.tissue_mesh import TissueMesh, true_volumes
from ..ports import Port, positions
from ..tissue import resolve_tissues
from ..typing import FloatArray
from .data import Results
from .page import Table
from .scene import MM, add_bones, add_device, add_grid, add_labels, plotter_for, volume_grid
from .style import ACTUATORS, GREY, INK, TISSUES, letter, panels, single, styled

_EDGES = ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))


def tissue_colours(names: Sequence[str]) -> list[str]:
    """One colour per tissue; unknown ones take the actuators' cycle."""
    return [TISSUES.get(n) or ACTUATORS[k % len(ACTUATORS)] for k, n in enumerate(names)]


@dataclass(frozen=True, eq=False)
class Cutaway:
    """A picture (height, width, 3) of the mesh cut open, and volume [m^3] and tetrahedra of each tissue."""

    picture: Any
    names: tuple[str, ...]
    volume: FloatArray
    count: FloatArray
    total: int


def cutaway(results: Results) -> Cutaway:
    """The run's mesh with everything wristwards of an actuator row and to one side taken away."""
    mesh, ports = results.mesh, (*results.transfer.inputs, *results.transfer.outputs)
    n = len(mesh.region_names)
    volume = np.bincount(mesh.region, weights=true_volumes(mesh), minlength=n)
    count = np.asarray(np.bincount(mesh.region, minlength=n), float)
    return Cutaway(cutaway_picture(mesh, ports), mesh.region_names, np.asarray(volume, float), count, len(mesh.points))


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


def cutaway_table(data: Cutaway) -> Table:
    """Volume and tetrahedra by tissue."""
    return Table({"tissue": data.names, "volume_m3": data.volume, "tetrahedra": data.count.astype(int)})


@styled
def plot_cutaway(data: Cutaway, *, ax: Axes | None = None) -> Axes:
    """The cut mesh with its tissues named."""
    axes = single(ax, (6.0, 4.3))
    axes.imshow(trimmed(data.picture), interpolation="lanczos")
    axes.axis("off")
    colours = tissue_colours(data.names)
    labels = [
        f"{n}: {1e6 * v:.0f} cm³, {c:,.0f} tetrahedra"
        for n, v, c in zip(data.names, data.volume, data.count, strict=True)
    ]
    handles = [Patch(fc=c, ec=INK, lw=0.4, label=t) for c, t in zip(colours, labels, strict=True)]
    axes.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, 0.0), ncols=len(handles), fontsize=6.5)
    axes.set_title(f"{data.total:,} vertices, {data.count.sum():,.0f} tetrahedra")
    return axes


def trimmed(picture: Any) -> Any:
    """``picture`` without its white border."""
    ink = np.any(np.asarray(picture) < 250, axis=2)
    if not ink.any():
        return picture
    rows, columns, margin = np.flatnonzero(ink.any(axis=1)), np.flatnonzero(ink.any(axis=0)), 8
    return picture[max(rows[0] - margin, 0) : rows[-1] + margin, max(columns[0] - margin, 0) : columns[-1] + margin]


@dataclass(frozen=True, eq=False)
class Map:
    """Polygons (k corners, 2) [mm] with a value each."""

    polygons: list[FloatArray]
    values: FloatArray


@dataclass(frozen=True, eq=False)
class ResolutionMap:
    """Nodes per shear wavelength at ``frequency`` [Hz]: on the volar skin from above, on a section, by tissue.

    ``section_y`` [m] is where the section is cut; ``quantiles`` (n_tissue, 3) are the least, 5 % and median.
    """

    frequency: float
    above: Map
    section: Map
    section_y: float
    ports: tuple[Port, ...]
    names: tuple[str, ...]
    quantiles: FloatArray


def resolution(results: Results) -> ResolutionMap:
    """Of a run's mesh at the highest frequency of its sweep."""
    mesh, f = results.mesh, float(results.transfer.frequency[-1])
    ports = (*results.transfer.inputs, *results.transfer.outputs)
    value = nodes_per_wave(results, f)
    y = results.transfer.inputs[0].position[1]
    quantiles = [np.quantile(value[mesh.region == i], (0, 0.05, 0.5)) for i in range(len(mesh.region_names))]
    return ResolutionMap(f, _from_above(mesh, value), _section(mesh, value, y), y, ports, mesh.region_names,
                         np.array(quantiles))  # fmt: skip


def nodes_per_wave(results: Results, frequency: float) -> FloatArray:
    """Of each tetrahedron (n_tet,): shear wavelength over the distance of nodes, by its rms edge."""
    mesh, tissues = results.mesh, resolve_tissues(results.scenario)
    corner = mesh.points[mesh.tetrahedra]
    edges = np.array([corner[:, a] - corner[:, b] for a, b in _EDGES])
    ports = (*results.transfer.inputs, *results.transfer.outputs)
    order = tetrahedron_orders(mesh, ports, results.scenario.element)
    spacing = np.sqrt((edges**2).sum(axis=2).mean(axis=0)) / order
    length = [float(tissues[n].wavelength(2 * np.pi * frequency)) for n in mesh.region_names]
    return np.asarray(np.array(length)[mesh.region] / spacing)


def _from_above(mesh: TissueMesh, value: FloatArray) -> Map:
    """Skin facets that face upwards, each with its tetrahedron's value."""
    facets = mesh.facets["skin"]
    faces = np.concatenate(
        [np.sort(mesh.tetrahedra[:, list(c)], axis=1) for c in ((0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3))]
    )
    owner = np.tile(np.arange(len(mesh.tetrahedra)), 4)
    order = np.lexsort(faces.T[::-1])
    n = len(mesh.points)
    key = (faces[order, 0] * n + faces[order, 1]) * n + faces[order, 2]
    wanted = np.sort(facets, axis=1)
    found = owner[order][np.searchsorted(key, (wanted[:, 0] * n + wanted[:, 1]) * n + wanted[:, 2])]
    corner = mesh.points[facets]
    up = corner[:, :, 2].mean(axis=1) > mesh.points[:, 2].mean()
    tilt = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    seen = up & (np.abs(tilt[:, 2]) > 0.1 * np.linalg.norm(tilt, axis=1))
    return Map([MM * c[:, :2] for c in corner[seen]], value[found[seen]])


def _section(mesh: TissueMesh, value: FloatArray, y: float) -> Map:
    """The tetrahedra cut by the plane at ``y`` [m], seen along y."""
    grid = volume_grid(mesh)
    grid.cell_data["value"] = value
    cut = grid.slice(normal="y", origin=(0, MM * y, 0))
    faces, start, polygons = np.asarray(cut.faces), 0, []
    while start < len(faces):
        n = int(faces[start])
        polygons.append(np.asarray(cut.points)[faces[start + 1 : start + 1 + n]][:, [0, 2]])
        start += n + 1
    return Map(polygons, np.asarray(cut.cell_data["value"]))


def resolution_table(data: ResolutionMap) -> Table:
    """Least, 5 % quantile and median of each tissue."""
    least, low, median = data.quantiles.T
    return Table({"tissue": data.names, "least": least, "quantile_5": low, "median": median})


@styled
def plot_resolution(data: ResolutionMap, *, ax: Axes | None = None) -> FigureBase:
    """Nodes per shear wavelength: the skin from above, a section under a row of actuators, and by tissue."""
    figure = panels(ax, (7.2, 5.2))
    grid = figure.add_gridspec(2, 2, height_ratios=(1.5, 1), width_ratios=(2.6, 1))
    above, section = figure.add_subplot(grid[0, :]), figure.add_subplot(grid[1, 0])
    bounds = [2, 4, 6, 8, 10, 15, 20, 30]
    norm = BoundaryNorm(bounds, 256, extend="both")
    for panel, shown in ((above, data.above), (section, data.section)):
        cells = PolyCollection(shown.polygons, array=shown.values, cmap="cividis", norm=norm, edgecolors="w", lw=0.08)
        panel.add_collection(cells)
        panel.set(aspect="equal", xlabel="x [mm]")
        panel.autoscale_view()
        panel.grid(False)
    at = MM * positions(data.ports)
    above.scatter(at[:, 0], at[:, 1], s=[34 if p.kind == "contact" else 6 for p in data.ports], facecolors="none",
                  edgecolors="#D55E00", lw=0.8)  # fmt: skip
    above.set(ylabel="y [mm]", title=f"skin from above, {data.frequency:g} Hz; rings: contacts and grid points")
    section.set(ylabel="z [mm]", title=f"section at y = {MM * data.section_y:.0f} mm")
    bar = figure.colorbar(cells, ax=above, shrink=0.9, pad=0.01, fraction=0.04)
    bar.set_ticks(bounds)
    bar.set_label("nodes per shear wavelength")
    tissues, place = figure.add_subplot(grid[1, 1]), np.arange(len(data.names))
    least, low, median = data.quantiles.T
    tissues.vlines(place, least, median, color=GREY, lw=1)
    for values, mark, label in ((least, "v", "least"), (low, "o", "5 %"), (median, "_", "median")):
        tissues.plot(place, values, mark, color=INK, label=label)
    tissues.axhline(6, color=GREY, ls="--", lw=0.8)
    tissues.set_xticks(place, data.names)
    tissues.set(ylabel="nodes per wavelength", ylim=(0, None), xlim=(-0.6, len(place) - 0.4))
    tissues.legend(fontsize=6)
    for panel, text in zip((above, section, tissues), "abc", strict=True):
        letter(panel, text)
    return figure
