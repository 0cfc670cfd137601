"""Pictures in space: mesh, device, points and bones; the mesh cut open; motion of the skin over time or phase."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import pyvista as pv
import xarray as xr
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties, findfont
from matplotlib.patches import Patch
from vtkmodules.vtkCommonCore import vtkLogger
from vtkmodules.vtkRenderingCore import vtkCoordinate

from ..errors import DataError, ForearmError, NotApplicable
from ..geometry.mesh.tissue_mesh import TissueMesh, true_volumes
from ..ports import Port, positions
from ..rendering import to_spectrum
from ..results.files import Signals, Wavefield
from ..typing import ComplexArray, FloatArray, IntArray
from .data import Results, record_of
from .style import ACTUATORS, COLUMN, GREY, INK, PAGE, TISSUES, sheet, styled

__all__ = ["Motion", "View", "motion"]

MM = 1e3
NAMED = 25  # points that have room for their names
_MARGIN = 8  # pixels left around a picture
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


def trimmed(picture: Any) -> tuple[Any, FloatArray]:
    """``picture`` without its white border, and where (column, row) its corner was."""
    ink = np.any(np.asarray(picture) < 250, axis=2)
    if not ink.any():
        return picture, np.zeros(2)
    rows, columns = np.flatnonzero(ink.any(axis=1)), np.flatnonzero(ink.any(axis=0))
    top, left = max(rows[0] - _MARGIN, 0), max(columns[0] - _MARGIN, 0)
    return picture[top : rows[-1] + _MARGIN, left : columns[-1] + _MARGIN], np.array([left, top], dtype=float)


def tissue_colours(names: Sequence[str]) -> list[str]:
    """One colour per tissue; unknown ones take the actuators' cycle."""
    return [TISSUES.get(n) or ACTUATORS[k % len(ACTUATORS)] for k, n in enumerate(names)]


def cutaway(results: Results, size: tuple[int, int] = (1500, 1000)) -> xr.Dataset:
    """``volume`` [m^3] and ``tetrahedra`` of each tissue, and a ``picture`` of the run's mesh with everything
    wristwards of an actuator row and to one side taken away."""
    mesh, ports = results.mesh, (*results.transfer.inputs, *results.transfer.outputs)
    n = len(mesh.region_names)
    return xr.Dataset(
        {"volume": ("tissue", np.bincount(mesh.region, weights=true_volumes(mesh), minlength=n), {"units": "m3"}),
         "tetrahedra": ("tissue", np.bincount(mesh.region, minlength=n)),
         "picture": (("row", "column", "rgb"), cutaway_picture(mesh, ports, size), {"table": "no"})},
        {"tissue": list(mesh.region_names)}, {"vertices": len(mesh.points)},
    )  # fmt: skip


def cutaway_picture(mesh: TissueMesh, ports: Sequence[Port], size: tuple[int, int]) -> Any:
    """Off-screen picture of ``size`` [pixels]; a box on the camera's side is cut away down to the bones, past the first
    actuator."""
    grid, low = volume_grid(mesh), MM * mesh.points.min(axis=0)
    coil = MM * np.array(ports[0].position)
    box = (low[0] - 1, coil[0] + 1, low[1] - 1, coil[1] + 14, low[2] - 1, 1e3)
    with plotter_for(size) as plotter:
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
    axes.imshow(picture)
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

_AROUND = 0.014  # m: a patch beyond the ports
_STEEPEST = 0.35  # least n_z of a facet that still counts as volar


@dataclass(frozen=True, eq=False)
class VolarPatch:
    """Skin facets around the device that face upwards, so that (x, y) names one point of them.

    ``vertices`` (n,) are indices into the mesh, ``points`` (n, 3) [m], ``triangles`` (m, 3) index these, ``normals``
    (n, 3) point outwards.
    """

    vertices: IntArray
    points: FloatArray
    triangles: IntArray
    normals: FloatArray

    def weights(self, places: FloatArray) -> tuple[IntArray, FloatArray]:
        """Corners (k, 3), indices into the patch, and weights (k, 3) of points (k, 2) [m] seen from above.

        Raises DataError for a point off the patch.
        """
        flat = self.points[self.triangles][:, :, :2]
        edges = (flat[:, 1:] - flat[:, :1]).swapaxes(1, 2)
        inner = np.einsum("mab,kmb->kma", np.linalg.inv(edges), places[:, None] - flat[None, :, 0])
        shares = np.concatenate([1 - inner.sum(axis=2, keepdims=True), inner], axis=2)
        best = np.argmax(shares.min(axis=2), axis=1)
        weights = shares[np.arange(len(places)), best]
        if np.any(weights < -1e-6):
            x, y = places[(weights < -1e-6).any(axis=1)][0]
            raise DataError(f"the point ({x:g}, {y:g}) m is not on the volar skin of the mesh near the device")
        return self.triangles[best], weights

    def lift(self, places: FloatArray) -> FloatArray:
        """Points (k, 3) [m] of the skin under (x, y) (k, 2) [m]."""
        corners, weights = self.weights(places)
        return np.asarray(np.einsum("kcx,kc->kx", self.points[corners], weights))

    def normal_field(self, field: Wavefield) -> NormalField:
        """The field's modes on the patch, outward component only."""
        modes = np.einsum("pcr,pc->pr", field.modes[self.vertices], self.normals)
        return NormalField(field.frequency, modes, field.amplitudes)


@dataclass(frozen=True, eq=False)
class NormalField:
    """One scalar component of a wavefield: ``modes`` (n_point, r), ``amplitudes`` (n_frequency, r, n_input)."""

    frequency: FloatArray
    modes: FloatArray
    amplitudes: ComplexArray

    def response(self, source: int) -> ComplexArray:
        """Displacement per unit drive (n_frequency, n_point) of one input."""
        return np.asarray(self.amplitudes[:, :, source] @ self.modes.T)

    def in_time(self, spectrum: ComplexArray, times: FloatArray) -> FloatArray:
        """Normal motion over time (n_time, n_point) [m], as :meth:`Wavefield.in_time` has it."""
        as_field = Wavefield(self.frequency, self.modes[:, None, :], self.amplitudes)
        return as_field.in_time(spectrum, times)[:, :, 0]

    def between(self, corners: IntArray, weights: FloatArray) -> NormalField:
        """At points inside facets, interpolated from their corners."""
        return replace(self, modes=np.einsum("kcr,kc->kr", self.modes[corners], weights))


def volar_patch(mesh: TissueMesh, ports: Sequence[Port]) -> VolarPatch:
    """The patch that reaches 14 mm beyond ``ports``; DataError if there are no facets."""
    facets = mesh.facets["skin"]
    corner = mesh.points[facets]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    away = mesh.points[facets].mean(axis=1) - mesh.points.mean(axis=0)
    away[:, 0] = 0
    normal *= np.sign(np.einsum("ij,ij->i", normal, away))[:, None]
    up = normal[:, 2] > _STEEPEST * np.linalg.norm(normal, axis=1)
    places = positions(tuple(ports))[:, :2]
    low, high = places.min(axis=0) - _AROUND, places.max(axis=0) + _AROUND
    middle = corner.mean(axis=1)[:, :2]
    chosen = up & np.all((middle > low) & (middle < high), axis=1)
    if not chosen.any():
        raise DataError("the mesh has no skin facing upwards near the ports; are its axes x along, z out of the skin?")
    vertices, flat = np.unique(facets[chosen], return_inverse=True)
    triangles = flat.reshape(facets[chosen].shape)
    normals = np.zeros((len(vertices), 3))
    for k in range(3):  # area-weighted mean of the facets that meet
        np.add.at(normals, triangles[:, k], normal[chosen])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return VolarPatch(vertices, mesh.points[vertices], triangles, normals)


Quantity = Literal["normal", "magnitude", "phase"]


@dataclass(frozen=True)
class View:
    """Choice of the motion to show.

    ``method`` and ``target`` choose the drives; with ``frequency`` [Hz] only the bin nearest to it, scaled so that the
    largest drive is one unit; ``actuator`` replaces them by one unit on that actuator (needs a frequency).
    ``quantity``: the outward "normal" component, the "magnitude", or the "phase" of the normal component (at a
    frequency).
    """

    method: str = "inverse filter"
    target: str = "5"
    frequency: float | None = None
    actuator: str | None = None
    quantity: Quantity = "normal"

    @property
    def words(self) -> str:
        """In a few words, for the picture."""
        if self.actuator is not None:
            return f"{self.actuator} alone, {self.frequency:g} Hz, 1 unit of drive"
        where = f"{self.method}, target {self.target}"
        return where if self.frequency is None else f"{where}, {self.frequency:g} Hz, largest drive 1 unit"


@dataclass(frozen=True, eq=False)
class Motion:
    """Displacements of mesh vertices, at instants [s] or phases [rad]; made once, asked often.

    ``states`` (n_step, r) are real amplitudes of the wavefield's modes at ``steps`` (n_step,); ``phasor`` (r,) is set
    at a frequency.
    """

    view: View
    steps: FloatArray
    states: FloatArray
    phasor: ComplexArray | None

    def displacement(self, modes: FloatArray, step: int) -> FloatArray:
        """(n_point, 3) [m] for modes (n_point, 3, r)."""
        return np.asarray(modes @ self.states[step])

    def label(self, step: int) -> str:
        """The instant or the phase, in words."""
        if self.phasor is None:
            return f"t = {1e3 * self.steps[step]:+.1f} ms".replace("+0.0", "0.0").replace("-0.0 ", "0.0 ")
        return f"phase {np.degrees(self.steps[step]):.0f}°"


def motion(results: Results, view: View, steps: FloatArray | None = None) -> Motion:
    """The motion of a view at ``steps``: instants [s], or phases [rad] where the view has a frequency."""
    check_view(results, view)
    field = results.wavefield
    if view.frequency is not None:
        low, high = field.frequency[0], field.frequency[-1]
        if not low - 1 <= view.frequency <= high + 1:
            raise DataError(f"{view.frequency:g} Hz lies outside the sweep of {low:g} to {high:g} Hz")
        nearest = int(np.argmin(np.abs(field.frequency - view.frequency)))
        view = replace(view, frequency=float(field.frequency[nearest]))
        phasor = np.asarray(field.amplitudes[nearest] @ _unit_drives(results, view, field, nearest))
        at = np.linspace(0, 2 * np.pi, 24, endpoint=False) if steps is None else steps
        return Motion(view, at, (np.exp(1j * at)[:, None] * phasor).real, phasor)
    at = default_times() if steps is None else steps
    spectrum = drive_series(results.drives, view.method, view.target, field)
    amplitudes = np.einsum("fri,if->fr", field.amplitudes, spectrum)
    states = 2 * (np.exp(2j * np.pi * np.outer(at, field.frequency)) @ amplitudes).real
    return Motion(view, at, states, None)


def default_times() -> FloatArray:
    """60 instants from 12 ms before the wavelet's centre to 17.5 ms after it [s]."""
    return np.asarray(np.arange(-24, 36) * 0.5e-3, dtype=np.float64)


def focus_time(results: Results, view: View) -> float:
    """The instant [s] at which the target moves most; 0 for a view at a frequency."""
    if view.frequency is not None or not results.has("displacements.nc"):
        return 0.0
    check_view(results, view)
    moved = results.displacements
    m, t = moved.methods.index(view.method), moved.targets.index(view.target)
    return float(moved.time[np.argmax(np.abs(moved.values[m, t, moved.channels.index(view.target)]))])


def check_view(results: Results, view: View) -> None:
    """Raise DataError for a view that the results cannot give."""
    if not results.has_field:
        missing = "mesh.vtu" if not results.has("mesh.vtu") else "wavefield.nc"
        remedy = results.remedy(missing)
        layered = results.has("scenario.json") and results.scenario.engine == "layered"
        if layered or (results.has("run.json") and results.run.solution.solver == "library"):
            remedy = f"`forearm-fem workbench {results.folder}` shows its G"
        raise DataError(f"{results.folder}: no motion between the points is known, {missing} is missing "
                        f"(the layered model, a library and measured G have none); {remedy}")  # fmt: skip
    if view.actuator is None:
        for name, known in ((view.method, results.drives.methods), (view.target, results.drives.targets)):
            if name not in known:
                raise DataError(f"{results.folder}: nothing was rendered for '{name}'; there are {', '.join(known)}")
    elif view.frequency is None:
        raise DataError("one actuator alone is shown at a frequency; give one in Hz")
    if view.quantity == "phase" and view.frequency is None:
        raise DataError("a phase belongs to a frequency; give one in Hz, or show 'normal' or 'magnitude'")


def _unit_drives(results: Results, view: View, field: Wavefield, nearest: int) -> ComplexArray:
    """Drives (n_input,) of a view at a bin of the field, the largest of them one unit."""
    names = [p.name for p in results.transfer.inputs]
    if view.actuator is not None:
        if view.actuator not in names:
            raise DataError(f"no actuator is called '{view.actuator}'; known are {', '.join(names)}")
        return np.array([n == view.actuator for n in names], dtype=complex)
    drives = drive_series(results.drives, view.method, view.target, field, whole=False)[:, nearest]
    largest = drives[int(np.argmax(np.abs(drives)))]
    if largest == 0:
        raise DataError(f"the drives of {view.words} are zero at this frequency; choose another")
    return np.asarray(drives / largest)


def shown_values(displacement: FloatArray, normals: FloatArray, quantity: Quantity) -> FloatArray:
    """The scalar (n,) [m] in a picture: outward component or magnitude."""
    if quantity == "magnitude":
        return np.asarray(np.linalg.norm(displacement, axis=1))
    return np.asarray(np.einsum("ij,ij->i", displacement, normals))


_MISSED = 1e-6  # of the drives' energy: rounding leaves 1e-14 beside the bins of the field


def signal_of(signals: Signals, method: str, target: str) -> FloatArray:
    """Signals (n_channel, n_t) of a method towards a target."""
    return np.asarray(signals.values[signals.methods.index(method), signals.targets.index(target)])


def drive_series(drives: Signals, method: str, target: str, field: Wavefield, *, whole: bool = True) -> ComplexArray:
    """Fourier-series amplitudes (n_input, n_frequency) of the drives on the wavefield's bins.

    Raises NotApplicable unless these are bins of the drives, with ``whole`` all that they move anything on: the motion
    at some of them alone would be a fraction of it, and come again and again.
    """
    record = record_of(drives)
    index = np.rint(field.frequency / record.df).astype(int)
    spectrum = to_spectrum(signal_of(drives, method, target), record)
    off = np.abs(index * record.df - field.frequency) > 1e-3 * record.df
    inside = index[~off & (index < spectrum.shape[1])]
    left = np.delete(np.abs(spectrum) ** 2, inside, axis=1).sum()
    if off.any() or (whole and left > _MISSED * np.sum(np.abs(spectrum) ** 2)):
        raise NotApplicable(
            f"the field between the points is known at {len(index)} frequencies, and the drives lie on others between "
            "them; leave out sweep.frequencies, or `forearm-fem render` again where they are of another sweep"
        )
    return np.asarray(spectrum[:, index] * record.df)
