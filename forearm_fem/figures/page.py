"""Waves as one self-contained page: a colleague opens it in any browser, nothing is installed or fetched.

The page draws with WebGL from the numbers inside it. It needs no trame: only the skin's outward motion is sent, at
vertices, in 16 bits per value.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment
from matplotlib import colormaps

from ..io.atomic import write_text
from ..typing import FloatArray
from .data import Results
from .motion import Motion, View, check_view, default_times, motion, nice
from .scene import MM, cones_of
from .show import Body, Look, body_of, colour_limit, default_view
from .style import SIGNED

__all__ = ["export_html"]

_BULGE = 4.0  # mm: the largest motion as first drawn
_FREQUENCIES = (50.0, 100.0, 200.0, 300.0, 400.0)


def export_html(
    results: Results | str | Path, path: str | Path, *, views: Sequence[View] | None = None, frames: int = 48
) -> Path:
    """Write the page; ``views`` are what can be chosen in it.

    By default every method at targets 5 and 6 through time, and the first actuator alone at a few frequencies.
    ``frames`` is the number of instants. Raises DataError where no field is known.
    """
    found = results if isinstance(results, Results) else Results.open(results)
    chosen = list(views) if views is not None else _views(found)
    for view in chosen:
        check_view(found, view)
    skin = body_of(found, "", "")
    content = _content(found, skin, [_series(found, skin, v, frames) for v in chosen], frames)
    source = resources.files(__package__).joinpath("page.html.j2").read_text(encoding="utf-8")
    page = Environment(autoescape=True).from_string(source)
    data = {"scene": found.scenario.name, "stamp": found.stamp}
    # the JSON stands in a script: no markup may end it early
    text = json.dumps(content).replace("<", "\\u003c")
    write_text(path, page.render(data=_Marked(data["scene"], data["stamp"], text)))
    return Path(path)


@dataclass(frozen=True)
class _Raw:
    """Text that jinja2 must not escape (its protocol is the method ``__html__``)."""

    text: str

    def __html__(self) -> str:
        return self.text


class _Marked:
    """What the template reads."""

    def __init__(self, scene: str, stamp: str, text: str) -> None:
        self.scene, self.stamp, self.json = scene, stamp, _Raw(text)


def _views(results: Results) -> list[View]:
    check_view(results, default_view(results))
    drives, g = results.drives, results.transfer
    wanted: list[str] = [t for t in ("5", "6") if t in drives.targets] or [drives.targets[0]]
    timed = [View(m, t) for t in wanted for m in drives.methods]
    inside = [f for f in _FREQUENCIES if g.frequency[0] <= f <= g.frequency[-1]]
    return timed + [View(frequency=f, actuator=g.inputs[0].name) for f in inside]


def _series(results: Results, skin: Body, view: View, frames: int) -> dict[str, Any]:
    """One choice: 16-bit outward motion [µm / scale] per instant, or its real and imaginary part."""
    times = default_times() if frames == len(default_times()) else np.linspace(-12e-3, 17.5e-3, frames)
    moved = motion(results, view, times if view.frequency is None else None)
    modes = np.einsum("pcr,pc->pr", skin.modes, skin.normals)
    rows = moved.states @ modes.T if moved.phasor is None else _parts(modes @ moved.phasor)
    rows = 1e6 * rows
    scale = float(np.abs(rows).max()) / 32767 or 1.0
    return {
        "name": view.words,
        "kind": "time" if moved.phasor is None else "phase",
        "target": view.target if view.actuator is None else "",
        "steps": [round(float(s), 7) for s in moved.steps],
        "values": _packed(np.rint(rows / scale), np.int16),
        "scale": scale,
        "gain": _gain(rows),
        "limit": 1e6 * _limit(results, moved),
    }


def _parts(values: FloatArray) -> FloatArray:
    return np.stack([values.real, values.imag])


def _gain(rows: FloatArray) -> float:
    """Millimetres drawn per micrometre, a nice number."""
    most = float(np.abs(rows).max())
    return nice(_BULGE / most) if most > 0 else 1.0


def _limit(results: Results, moved: Motion) -> float:
    return colour_limit(results, moved, Look())


def _content(results: Results, skin: Body, series: list[dict[str, Any]], frames: int) -> dict[str, Any]:
    g = results.transfer
    ports = (*g.inputs, *g.outputs)
    cones = cones_of(g.inputs)
    tags = [{"name": p.name, "kind": "point", "at": _above(p.position, p.axis, 0.8)} for p in g.outputs]
    above = cones.tops + np.array([0, 0, 3])
    tags += [{"name": n, "kind": "coil", "at": at.tolist()} for n, at in zip(cones.names, above, strict=True)]
    places = MM * np.array([p.position for p in ports])
    faces = np.asarray(skin.dataset.faces).reshape(-1, 4)[:, 1:]
    return {
        "points": _packed(skin.rest, np.float32),
        "normals": _packed(skin.normals, np.float32),
        "faces": _packed(faces, np.uint32),
        "solid": _packed(np.concatenate([_triangles(b) for b in cones.bodies]), np.float32),
        "lut": _packed(255 * colormaps[SIGNED](np.linspace(0, 1, 256))[:, :3], np.uint8),
        "tags": tags if len(g.outputs) <= 49 else tags[len(g.outputs) :],
        "centre": places.mean(axis=0).tolist(),
        "reach": float(np.ptp(places, axis=0).max()),
        "series": series,
        "start": (frames * 2) // 5,
    }


def _above(position: tuple[float, float, float], axis: tuple[float, float, float], lift: float) -> list[float]:
    return [float(v) for v in MM * np.array(position) + lift * np.array(axis)]


def _triangles(body: Any) -> FloatArray:
    """Corners (3 n, 3) of a pyvista surface."""
    surface = body.triangulate()
    order = np.asarray(surface.faces).reshape(-1, 4)[:, 1:].ravel()
    corners: FloatArray = np.asarray(surface.points, dtype=float)[order]
    return corners


def _packed(values: Any, kind: Any) -> str:
    return base64.b64encode(np.ascontiguousarray(np.asarray(values).astype(kind)).tobytes()).decode()
