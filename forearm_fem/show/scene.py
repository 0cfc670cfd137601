"""Building blocks for pictures in space: pyvista grids of the mesh, device, grid and bones, and a safe plotter."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyvista as pv
from matplotlib.font_manager import FontProperties, findfont
from vtkmodules.vtkCommonCore import vtkLogger  # of `import vtk`, which takes seconds to load everything
from vtkmodules.vtkRenderingCore import vtkCoordinate

from ..errors import ForearmError
from ..geometry.mesh.tissue_mesh import TissueMesh
from ..ports import Port
from ..typing import FloatArray, IntArray
from .style import INK, TISSUES

MM = 1e3
NAMED = 25  # points that have room for their names
_TETRA = 10  # VTK's number of the cell
_ACTUATOR_HEIGHT, _ACTUATOR_RADIUS = 9.85e-3, 7e-3  # TEAX14C02-8, physics_data.md 4
_CONE_HEIGHT = 6e-3  # for the drawing only


def volume_grid(mesh: TissueMesh) -> Any:
    """All tetrahedra as a pyvista grid in mm, with the cell data "region"."""
    cells = np.column_stack([np.full(len(mesh.tetrahedra), 4), mesh.tetrahedra]).ravel()
    grid = pv.UnstructuredGrid(cells, np.full(len(mesh.tetrahedra), _TETRA, np.uint8), MM * mesh.points)
    grid.cell_data["region"] = mesh.region
    return grid


def surface_grid(mesh: TissueMesh, facets: IntArray) -> Any:
    """Facets as pyvista polygons in mm; point data "vertex" are the mesh's own numbers."""
    used, local = np.unique(facets, return_inverse=True)
    faces = np.column_stack([np.full(len(facets), 3), local.reshape(facets.shape)])
    surface = pv.PolyData(MM * mesh.points[used], faces.ravel())
    surface.point_data["vertex"] = used
    return surface


@dataclass(frozen=True, eq=False)
class Cones:
    """Cones and coils as closed surfaces standing on the skin."""

    bodies: tuple[Any, ...]
    names: tuple[str, ...]
    tops: FloatArray


def cones_of(ports: Sequence[Port]) -> Cones:
    """One per contact, on the skin."""
    bodies, tops = [], []
    for port in ports:
        foot, axis = MM * np.array(port.position), np.array(port.axis)
        cone = _tapered(port.radius, _ACTUATOR_RADIUS, _CONE_HEIGHT, foot, axis)
        top = foot + MM * _CONE_HEIGHT * axis
        coil = pv.Cylinder(
            center=top + MM * _ACTUATOR_HEIGHT / 2 * axis,
            direction=axis,
            radius=MM * _ACTUATOR_RADIUS,
            height=MM * _ACTUATOR_HEIGHT,
            resolution=40,
        )
        bodies += [cone, coil]
        tops.append(top + MM * _ACTUATOR_HEIGHT * axis)
    return Cones(tuple(bodies), tuple(p.name for p in ports), np.array(tops).reshape(-1, 3))


def _tapered(low: float, high: float, height: float, foot: FloatArray, axis: FloatArray) -> Any:
    """A truncated cone of radii ``low`` and ``high`` [m], its small end at ``foot`` [mm]."""
    profile = MM * np.array([[0, 0, 0], [low, 0, 0], [high, 0, height], [0, 0, height]])
    body = pv.lines_from_points(profile).extrude_rotate(resolution=40, capping=False)
    across = np.cross([0.0, 0.0, 1.0], axis)
    size = float(np.linalg.norm(across))
    about = across / size if size >= 1e-9 else np.array([1.0, 0.0, 0.0])
    angle = float(np.degrees(np.arctan2(size, axis[2]))) if size >= 1e-9 else 0.0  # turns z into ``axis``
    return body.rotate_vector(about, angle, point=(0, 0, 0)).translate(foot)


def add_device(plotter: Any, ports: Sequence[Port], *, opacity: float, named: bool = True) -> None:
    """Cones and coils, seen through."""
    cones = cones_of([p for p in ports if p.kind == "contact"])
    for body in cones.bodies:
        plotter.add_mesh(body, color="#6F7C8C", opacity=opacity, smooth_shading=True, split_sharp_edges=True)
    if len(cones.names) and named:
        add_labels(plotter, cones.tops + np.array([0, 0, 1.5]), cones.names, size=22)


def add_grid(
    plotter: Any, ports: Sequence[Port], target: str | None = None, *, lift: float = 0.4, named: bool = True
) -> None:
    """Grid points as dots with numbers, the target larger and in another colour."""
    points = [p for p in ports if p.kind == "point"]
    at = np.array([MM * np.array(p.position) + lift * np.array(p.axis) for p in points]).reshape(-1, 3)
    for port, place in zip(points, at, strict=True):
        chosen = port.name == target
        ball = pv.Sphere(radius=1.1 if chosen else 0.6, center=place)
        plotter.add_mesh(ball, color="#E69F00" if chosen else INK, lighting=not chosen)
    if named and 0 < len(points) <= NAMED:
        add_labels(plotter, at + np.array([0, 0, 1.2]), [p.name for p in points], size=17)


def font_file() -> str:
    """The figures' font, for VTK."""
    return str(findfont(FontProperties()))


def add_labels(plotter: Any, places: FloatArray, names: Sequence[str], *, size: int) -> None:
    """Names that are never hidden behind what they name."""
    plotter.add_point_labels(
        np.asarray(places, dtype=float), list(names), font_size=size, text_color="black", shape=None,
        show_points=False, always_visible=True, bold=False, font_file=font_file(),
    )  # fmt: skip


def add_bones(plotter: Any, mesh: TissueMesh) -> None:
    """The surfaces of bones left out of the mesh, or the bones themselves."""
    if "bone" in mesh.facets and len(mesh.facets["bone"]):
        bone = plotter.add_mesh(surface_grid(mesh, mesh.facets["bone"]), color=TISSUES["bone"], smooth_shading=True)
        bone.mapper.SetResolveCoincidentTopologyToPolygonOffset()  # the flesh has the same surface
        bone.mapper.SetRelativeCoincidentTopologyPolygonOffsetParameters(0.0, -4.0)  # by slope, edges show through
    elif "bone" in mesh.region_names:
        grid = volume_grid(mesh).extract_cells(mesh.region == mesh.region_names.index("bone"))
        plotter.add_mesh(grid.extract_surface(algorithm="dataset_surface"), color=TISSUES["bone"])


def on_picture(plotter: Any, places: FloatArray) -> FloatArray:
    """Pixels (n, 2), from the upper left, at which ``places`` (n, 3) [mm] are seen."""
    found, seen = [], vtkCoordinate()
    seen.SetCoordinateSystemToWorld()
    for place in places:
        seen.SetValue(*(float(x) for x in place))
        across, up = seen.GetComputedDisplayValue(plotter.renderer)
        found.append((across, plotter.window_size[1] - 1 - up))
    return np.array(found, dtype=float).reshape(-1, 2)


def add_scale_bar(plotter: Any, at: FloatArray, *, named: bool = True) -> None:
    """A bar of 10 mm along x that starts at ``at`` [mm], with its length beside it."""
    end = at + np.array([10.0, 0, 0])
    plotter.add_mesh(pv.Tube(pointa=at, pointb=end, radius=0.35), color=INK, lighting=False)
    if named:
        add_labels(plotter, np.array([(at + end) / 2 - np.array([0, 2.2, 0])]), ["10 mm"], size=15)


@contextmanager
def plotter_for(size: tuple[int, int]) -> Iterator[Any]:
    """A white plotter, closed at the end; ForearmError with a remedy where VTK can draw nothing.

    VTK's note that there is no X server is kept off the terminal: it then draws with EGL or OSMesa.
    """
    before = vtkLogger.GetCurrentVerbosityCutoff()
    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)
    try:
        try:
            plotter: Any = pv.Plotter(off_screen=True, window_size=list(size))
        except (RuntimeError, OSError, ImportError) as problem:
            raise ForearmError(
                f"VTK cannot draw here ({problem}); on Debian install the packages libegl1, libgl1 and libxrender1"
            ) from problem
        plotter.set_background("white")
        plotter.enable_anti_aliasing("ssaa")
        with closing(plotter):
            yield plotter
    finally:
        vtkLogger.SetStderrVerbosity(before)


def trimmed(picture: Any, margin: int = 8) -> tuple[Any, FloatArray]:
    """``picture`` without its white border, and where (column, row) its corner was."""
    ink = np.any(np.asarray(picture) < 250, axis=2)
    if not ink.any():
        return picture, np.zeros(2)
    rows, columns = np.flatnonzero(ink.any(axis=1)), np.flatnonzero(ink.any(axis=0))
    top, left = max(rows[0] - margin, 0), max(columns[0] - margin, 0)
    return picture[top : rows[-1] + margin, left : columns[-1] + margin], np.array([left, top], dtype=float)
