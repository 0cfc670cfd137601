"""Waves in the limb as pictures and films: surface or cut planes, at a frequency or through time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from io import BytesIO
from pathlib import Path
from textwrap import wrap
from types import MappingProxyType
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from PIL import Image

from ..device.loop import carries_points
from ..errors import DataError, optional
from ..ports import Port
from ..progress import Progress, tell
from ..store.folder import atomic_path
from ..typing import FloatArray, IntArray
from .data import Results
from .motion import (
    MM,
    NAMED,
    Motion,
    View,
    add_bones,
    add_device,
    add_grid,
    add_scale_bar,
    cones_of,
    default_times,
    focus_time,
    font_file,
    motion,
    on_picture,
    plotter_for,
    shown_values,
    surface_grid,
    trimmed,
    volume_grid,
)
from .style import COLUMN, INK, PAGE, SIGNED, SIZE, minus, panels, round_down_125, sheet, styled

__all__ = ["Look", "animate", "plot_wavefield", "wavefield"]

CAMERAS: Mapping[str, tuple[float, float, float]] = MappingProxyType(
    {"oblique": (-0.75, -1.0, 0.95), "top": (0.0, -0.001, 1.0), "side": (0.0, -1.0, 0.25), "wrist": (-1.0, -0.12, 0.3)}
)
_BULGE = 5.0  # mm: the largest displacement as drawn
_PLATE, _BAR = (0.868, 0.2, 0.125, 0.6), (0.885, 0.25, 0.02, 0.48)  # of a film's frame: left, bottom, width, height
_MAPS = {"normal": SIGNED, "magnitude": SIZE, "phase": "twilight"}


@dataclass(frozen=True)
class Look:
    """Options of the picture.

    ``camera``: of :data:`CAMERAS`.
    ``cut``: "", "x", "y" or "xy" opens the limb in front of planes through the target normal to these axes.
    ``amplification`` [-]: None draws the largest displacement as about 5 mm.
    ``limit`` [m]: of the colours; None takes what the grid points reach.
    ``bare``: without words and bar of colours.
    """

    camera: str = "oblique"
    cut: str = ""
    amplification: float | None = None
    limit: float | None = None
    size: tuple[int, int] = (1200, 900)
    bare: bool = False

    def __post_init__(self) -> None:
        """Refuse cameras and cuts that do not exist."""
        if self.camera not in CAMERAS:
            raise DataError(f"no camera is called '{self.camera}'; known are {', '.join(CAMERAS)}")
        if self.cut not in ("", "x", "y", "xy"):
            raise DataError(f"cut is '', 'x', 'y' or 'xy', got '{self.cut}'")


@dataclass(frozen=True, eq=False)
class Body:
    """Deformed body: a pyvista ``dataset`` whose points are combinations of mesh vertices.

    ``rest`` (n, 3) [mm]; ``modes`` (n, 3, r) of its points; ``normals`` (n, 3) the direction "normal" refers to.
    """

    dataset: Any
    rest: FloatArray
    modes: FloatArray
    normals: FloatArray


def body_of(results: Results, cut: str, target: str) -> Body:
    """The skin, or the limb behind the cut planes."""
    if not cut:
        surface = surface_grid(results.field_mesh, results.field_mesh.facets["skin"])
        vertices: IntArray = np.asarray(surface.point_data["vertex"])
        return _body(surface, results.wavefield.modes[vertices], None)
    mesh, grid = results.mesh, volume_grid(results.mesh)
    modes = results.wavefield.modes[: len(mesh.points)]
    place = MM * np.array(_port(results.transfer.outputs, target).position)
    # cut once: the modes travel through the clip as point data, so that each step is one product
    grid.point_data["modes"] = modes.reshape(len(modes), -1).astype(np.float32)
    if cut in ("x", "y"):
        behind = grid.clip(normal=cut, origin=place, invert=False)
    else:  # seen from the wrist and from negative y
        front = grid.clip(normal="x", origin=place, invert=True).clip(normal="y", origin=place, invert=False)
        behind = grid.clip(normal="x", origin=place, invert=False).merge(front, merge_points=True)
    part = behind.extract_surface(algorithm="dataset_surface").triangulate()
    part = part.compute_normals(cell_normals=False, split_vertices=True, feature_angle=40.0)  # sharp edges stay sharp
    taken = np.asarray(part.point_data["modes"], dtype=float).reshape(part.n_points, 3, -1)
    part.clear_data()
    return _body(part, taken, np.tile([0.0, 0.0, 1.0], (part.n_points, 1)))


def _body(surface: Any, modes: FloatArray, normals: FloatArray | None) -> Body:
    """Normals that point outwards, the way the volar skin's do; they shade the body and define "normal"."""
    surface.compute_normals(cell_normals=False, split_vertices=False, auto_orient_normals=True, inplace=True)
    found = np.array(surface.point_data["Normals"], dtype=float)
    if found[int(np.argmax(surface.points[:, 2])), 2] < 0:
        surface.flip_faces(inplace=True)
        found = -found
    surface.point_data["Normals"] = found  # flipped faces keep their normals
    return Body(surface, np.array(surface.points, dtype=float), modes, found if normals is None else normals)


def standing(ports: Sequence[Port], cut: str, place: Sequence[float]) -> tuple[Port, ...]:
    """Ports that stand on what a ``cut`` through ``place`` [m] leaves; the others would float."""
    planes = [("x", "y").index(axis) for axis in cut]
    return tuple(p for p in ports if not cut or any(p.position[k] > place[k] - 1e-9 for k in planes))


def _port(ports: tuple[Port, ...], name: str) -> Port:
    return next((p for p in ports if p.name == name), ports[len(ports) // 2])


def amplification(moved: Motion, body: Body, look: Look) -> float:
    """Amplification of the motion drawn: as asked, or 1, 2 or 5 times a power of ten."""
    if look.amplification is not None:
        return look.amplification
    sizes = [np.linalg.norm(moved.displacement(body.modes, k), axis=1).max() for k in range(len(moved.steps))]
    most = float(max(sizes))
    return round_down_125(_BULGE / (MM * most)) if most > 0 else 1.0


def colour_limit(results: Results, moved: Motion, look: Look) -> float:
    """End of the colours [m]: as asked, or the most that the grid points' nearest vertices show."""
    if look.limit is not None:
        return look.limit
    places = np.array([p.position for p in results.transfer.outputs])
    near = [int(np.argmin(np.linalg.norm(results.field_mesh.points - p, axis=1))) for p in places]
    modes = results.wavefield.modes[near]
    axes, quantity = np.array([p.axis for p in results.transfer.outputs]), moved.view.quantity
    most = max(
        float(np.abs(shown_values(moved.displacement(modes, k), axes, quantity)).max()) for k in range(len(moved.steps))
    )
    return most or 1e-9


@dataclass(frozen=True, eq=False)
class Stage:
    """A plotter with everything in place; :meth:`show` sets one step of the motion; ``without`` says what it lacks."""

    plotter: Any
    body: Body
    moved: Motion
    factor: float
    limit: float
    without: tuple[str, ...] = ()
    silent: bool = False

    def show(self, step: int) -> None:
        """Deform and colour the body as at ``step``, and say which it is."""
        u = self.moved.displacement(self.body.modes, step)
        self.body.dataset.points = self.body.rest + MM * self.factor * u
        if self.moved.view.quantity == "phase":
            assert self.moved.phasor is not None
            normal = np.einsum("pcr,pc,r->p", self.body.modes, self.body.normals, self.moved.phasor, optimize=True)
            shown = np.asarray(np.angle(normal, deg=True))
        else:
            shown = 1e6 * shown_values(u, self.body.normals, self.moved.view.quantity)
        self.body.dataset.point_data["shown"] = shown
        del self.body.dataset.point_data["Normals"]  # VTK leaves those it finds
        self.body.dataset.compute_normals(
            cell_normals=False, split_vertices=False, consistent_normals=False, inplace=True
        )
        if not self.silent:
            self.plotter.add_text(
                minus("\n".join(self.words(step))), position="upper_left", font_size=10, color="black", name="words",
                font_file=font_file(),
            )  # fmt: skip

    def beyond(self, step: int) -> bool:
        """True if some of the body moves more than the colours tell."""
        u = self.moved.displacement(self.body.modes, step)
        return bool(np.abs(shown_values(u, self.body.normals, self.moved.view.quantity)).max() > 1.001 * self.limit)

    def words(self, step: int) -> list[str]:
        """View, instant, magnification, and what is left out."""
        return [self.moved.view.words, self.moved.label(step), drawn_words(self.factor), *self.without]


def drawn_words(factor: float) -> str:
    """Sentence on a motion that was multiplied by ``factor``."""
    if factor in (0, 1):
        return "drawn true to scale" if factor else "motion not drawn, only coloured"
    return f"motion drawn {max(factor, 1 / factor):,.6g} times {'larger' if factor > 1 else 'smaller'}"


def staged(results: Results, plotter: Any, moved: Motion, look: Look, whole: Motion | None = None) -> Stage:
    """Body, device, grid, bones, scale bar, colours and camera in ``plotter``.

    Magnification and colours are of the ``whole`` motion that ``moved`` is a part of. So a picture and a film of one
    view are drawn alike.
    """
    view = moved.view
    body = body_of(results, look.cut, view.target)
    without = ("without what the skin follows of the housing",) if carries_points(results.scenario.device) else ()
    scales = amplification(whole or moved, body, look), colour_limit(results, whole or moved, look)
    stage = Stage(plotter, body, moved, *scales, without, look.bare)
    stage.show(0)
    ports = (*results.transfer.inputs, *results.transfer.outputs)
    _, ends = _scale(view.quantity, stage.limit, look)
    plotter.add_mesh(body.dataset, scalars="shown", cmap=_MAPS[view.quantity], clim=ends, smooth_shading=True,
                     ambient=0.3, diffuse=0.62, specular=0.05, show_scalar_bar=False,
                     interpolate_before_map=view.quantity != "phase")  # fmt: skip
    left = standing(ports, look.cut, _port(results.transfer.outputs, view.target).position)
    named = not look.bare
    add_device(plotter, left, opacity=0.25, named=named)
    add_grid(plotter, left, view.target if view.actuator is None else None, lift=0.6, named=named)
    if look.cut:  # the whole skin hides them
        add_bones(plotter, results.mesh)
    add_scale_bar(plotter, _scale_bar(ports), named=named)
    if named:
        plotter.add_text(results.stamp, position="upper_right", font_size=6, color="gray", font_file=font_file())
    _aim(plotter, results, look)
    return stage


def _scale_bar(ports: Sequence[Port]) -> FloatArray:
    """Start of the bar of 10 mm [mm]."""
    return np.asarray(MM * np.array([p.position for p in ports]).min(axis=0) + np.array([-8, -16, 0]))


@styled
def colour_bar(stage: Stage, look: Look, saturated: bool) -> FloatArray:
    """The colour bar on a white plate, (row, column, rgba) from 0 to 1 of a whole frame, in the figures' font."""
    wide, tall = look.size
    figure, points = panels((wide / 100, tall / 100)), 10.5 * tall / 900
    figure.set(dpi=100, layout_engine="none")
    figure.patch.set_alpha(0.0)
    figure.add_axes(_PLATE, facecolor=(1, 1, 1, 0.85), xticks=[], yticks=[]).spines[:].set_visible(False)
    unit, ends = _scale(stage.moved.view.quantity, stage.limit, look)
    colours = ScalarMappable(Normalize(*ends), _MAPS[stage.moved.view.quantity])
    bar = figure.colorbar(colours, cax=figure.add_axes(_BAR), extend="both" if saturated else "neither")
    bar.ax.tick_params(labelsize=points, labelcolor=INK, width=0.6 * tall / 900)
    bar.ax.set_title(unit, fontsize=1.1 * points, pad=1.2 * points, loc="left")
    drawn = BytesIO()
    figure.savefig(drawn, format="rgba", dpi=100)
    return np.frombuffer(drawn.getvalue(), np.uint8).reshape(tall, wide, 4) / 255.0


def _with_bar(picture: Any, bar: FloatArray) -> Any:
    """A frame with the colour bar over it."""
    share = bar[:, :, 3:]
    return np.round((1 - share) * picture + 255 * share * bar[:, :, :3]).astype(np.uint8)


def _scale(quantity: str, limit: float, look: Look) -> tuple[str, tuple[float, float]]:
    """Title of the colours, and their ends."""
    most = 1e6 * limit
    return {
        "normal": ("u_z [µm]" if look.cut else "u outward [µm]", (-most, most)),
        "magnitude": ("|u| [µm]", (0.0, most)), "phase": ("phase [°]", (-180.0, 180.0)),
    }[quantity]  # fmt: skip


def _aim(plotter: Any, results: Results, look: Look) -> None:
    """The set camera, looking at the device; wide enough for it and 25 mm more."""
    places = MM * np.array([p.position for p in (*results.transfer.inputs, *results.transfer.outputs)])
    plotter.camera_position = [CAMERAS[look.camera], (0, 0, 0), (0, 1, 0) if look.camera == "top" else (0, 0, 1)]
    low, high = places.min(axis=0) - [25, 22, 14], places.max(axis=0) + np.array([25, 22, 18])
    plotter.reset_camera(bounds=np.stack([low, high]).T.ravel())
    plotter.camera.zoom(1.2)


def wavefield(
    results: Results | str | Path, *, view: View | None = None, look: Look | None = None, at: float | None = None
) -> xr.Dataset:
    """The skin at the moment of focus: a ``picture`` (row, column, rgb), and where names stand ``at`` on it [pixels].

    Attributes: the ``words`` that belong to it, the ``limit`` of its colours, whether some skin moves more. ``at`` is
    another instant [s] than that at which the target moves most, or at a frequency the phase [rad] (default 0).
    Off-screen; raises DataError for what the results do not hold and ForearmError where VTK cannot draw.
    """
    found, view, look = _given(results, view, look or Look(size=(2400, 1500)))
    moved = motion(found, view, np.array([focus_time(found, view) if at is None else at]))
    with plotter_for(look.size) as plotter:
        stage = staged(found, plotter, moved, replace(look, bare=True), motion(found, view))
        picture, corner = trimmed(np.array(plotter.screenshot(None, return_img=True)))
        names = _names(found, view, look)
        stands = on_picture(plotter, np.array(list(names.values()))) - corner
        unit, ends = _scale(view.quantity, stage.limit, look)
        said = {"words": "; ".join(stage.words(0)), "unit": unit, "ends": ends, "colours": _MAPS[view.quantity],
                "saturated": int(view.quantity != "phase" and stage.beyond(0))}  # fmt: skip
    return xr.Dataset(
        {"picture": (("row", "column", "rgb"), picture, {"table": "no"}), "at": (("name", "pixel"), stands)},
        {"name": list(names)}, said,
    )  # fmt: skip


def _names(results: Results, view: View, look: Look) -> dict[str, FloatArray]:
    """Places [mm] of the names of actuators and points, and of the bar's."""
    ports = (*results.transfer.inputs, *results.transfer.outputs)
    left = standing(ports, look.cut, _port(results.transfer.outputs, view.target).position)
    cones, points = cones_of([p for p in left if p.kind == "contact"]), [p for p in left if p.kind == "point"]
    names = dict(zip(cones.names, cones.tops, strict=True))
    if len(points) <= NAMED:
        names |= {p.name: MM * np.array(p.position) + np.array([0, 0, 1.8]) for p in points}
    return {**names, "10 mm": _scale_bar(ports) + np.array([5.0, -7.0, 0.0])}


@styled
def plot_wavefield(data: xr.Dataset, *, width: int = PAGE) -> Figure:
    """The skin at the moment of focus, with its colours in micrometres."""
    tall, wide, _ = data.picture.shape
    upright = width > COLUMN
    figure = sheet(width, (width - (20 if upright else 0)) * tall / wide + (10 if upright else 24))
    axes = figure.add_subplot()
    axes.imshow(data.picture.values)
    axes.axis("off")
    for name, place in zip(data.name.values, data["at"].values, strict=True):
        words = axes.annotate(name, place, (0, 1), textcoords="offset points", ha="center", va="bottom", fontsize=6)
        words.set_path_effects([withStroke(linewidth=1.5, foreground="w", alpha=0.7)])  # on any colour
    axes.set_title("\n".join(wrap(minus(data.words), 110 if upright else 56)))
    colours = ScalarMappable(Normalize(*data.ends), data.colours)
    bar = figure.colorbar(colours, ax=axes, fraction=0.03, pad=0.01, shrink=0.8,
                          extend="both" if data.saturated else "neither",
                          location="right" if upright else "bottom")  # fmt: skip
    bar.set_label(data.unit)
    return figure


def animate(
    results: Results | str | Path,
    path: str | Path,
    *,
    view: View | None = None,
    look: Look | None = None,
    steps: FloatArray | None = None,
    frames_per_second: float = 12.0,
    progress: Progress | None = None,
) -> Path:
    """A film (.gif, or .mp4 with the extra ``movie``) of the motion at ``steps`` [s], or phases [rad].

    By default 60 instants around the wavelet's centre, or 24 phases. No new solve. Raises as :func:`wavefield`,
    and MissingExtra for an .mp4 without imageio.
    """
    target = Path(path)
    kind = target.suffix.lower()
    if kind == ".mp4":
        for package in ("imageio", "imageio_ffmpeg"):
            optional(package, "movie", "an .mp4 film")
    elif kind != ".gif":
        raise DataError(f"{target}: films are .gif or .mp4, not '{target.suffix}'")
    found, view, look = _given(results, view, look)
    moved = motion(found, view, steps)
    with plotter_for(look.size) as plotter:
        stage = staged(found, plotter, moved, look)
        stage = replace(stage, without=(slow_words(moved, frames_per_second), *stage.without))
        pictures = []
        beyond = view.quantity != "phase" and any(stage.beyond(k) for k in range(len(moved.steps)))
        bar = np.zeros((1, 1, 4)) if look.bare else colour_bar(stage, look, beyond)
        for k in range(len(moved.steps)):
            stage.show(k)
            tell(progress, "frames", k + 1, len(moved.steps))
            pictures.append(_with_bar(plotter.screenshot(None, return_img=True), bar))
    with atomic_path(target) as beside:
        if kind == ".gif":  # one palette for all frames, so that colours do not flicker
            sample = Image.fromarray(np.concatenate([p[::2, ::2] for p in pictures[:: max(1, len(pictures) // 12)]]))
            palette = sample.quantize(256, method=Image.Quantize.MAXCOVERAGE)
            frames = [Image.fromarray(p).quantize(palette=palette, dither=Image.Dither.NONE) for p in pictures]
            lasts = 10 * max(round(100 / frames_per_second), 1)  # GIF counts hundredths of a second
            frames[0].save(beside, save_all=True, append_images=frames[1:], duration=lasts, loop=0, optimize=False)
        else:
            writer = import_module("imageio").get_writer(beside, fps=frames_per_second, macro_block_size=2, quality=8)
            with writer as film:
                for picture in pictures:
                    film.append_data(picture[: picture.shape[0] // 2 * 2, : picture.shape[1] // 2 * 2])
    return target


def slow_words(moved: Motion, frames_per_second: float) -> str:
    """Factor by which a film of evenly spaced steps plays slower than the motion."""
    step = float(moved.steps[1] - moved.steps[0]) if len(moved.steps) > 1 else 0.0
    if moved.view.frequency is not None:
        step /= 2 * np.pi * moved.view.frequency  # a phase's share of a period
    return f"{1 / (step * frames_per_second):.3g} times slower than real" if step > 0 else "one instant"


def _given(results: Results | str | Path, view: View | None, look: Look | None) -> tuple[Results, View, Look]:
    found = results if isinstance(results, Results) else Results.open(results)
    return found, view or default_view(found), look or Look()


def frames_at(speed: float) -> float:
    """Frames a second that play the film's instants, 0.5 ms apart, at ``speed`` of real time."""
    times = default_times()
    return speed / float(times[1] - times[0])


def default_view(results: Results) -> View:
    """The inverse filter at target 5, or the first there is of each."""
    drives = results.drives
    first = View()
    method = first.method if first.method in drives.methods else drives.methods[0]
    return View(method, first.target if first.target in drives.targets else drives.targets[0])
