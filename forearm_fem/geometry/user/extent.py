"""Sizes and places of a user's geometry that no limb has: almost always a wrong unit, and a mesher that never ends."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...errors import GeometryError
from ...typing import FloatArray
from ..device.layout import Layout

_LEAST, _MOST = 1e-3, 2.0  # m: a thin bone, a whole leg
_FLAT = 1e-4  # m: thinner than any bone
_UNITS = ((1.0, "metres"), (0.01, "centimetres"), (0.001, "millimetres"), (0.0254, "inches"))


def check_extent(file: Path, points: FloatArray, unit: float = 1.0) -> None:
    """Raise :class:`GeometryError` where ``points`` (n, 3) [m] are not finite, span no limb's size, or are flat.

    ``unit`` [m] is the file's, for the advice.
    """
    if not np.isfinite(points).all():
        bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
        raise GeometryError(f"{file}: {len(bad)} points are not finite, the first is vertex {bad[0]}; repair the file")
    spans = np.ptp(points, axis=0)
    longest = float(spans.max())
    if not _LEAST <= longest <= _MOST:
        sizes = [(u, name, u * (longest / unit)) for u, name in _UNITS]
        fitting = [f"{u:g} ({name}) makes it {size:.2g} m" for u, name, size in sizes if 0.02 <= size <= 1.0]
        raise GeometryError(
            f"{file}: is {longest:.3g} m long with limb.unit = {unit:g}, expected {_LEAST:g} to {_MOST:g} m; set "
            f"limb.unit, the metres per unit of the file{': ' if fitting else ''}{', '.join(fitting)}"
        )
    if spans.min() < _FLAT:
        raise GeometryError(
            f"{file}: is flat, {spans.min() * 1e3:.3g} mm in {'xyz'[int(spans.argmin())]}; expected a body with a "
            "volume, its x along the limb"
        )


def check_room(file: Path, points: FloatArray, layout: Layout, unit: float) -> None:
    """Raise :class:`GeometryError` where the limb of ``points`` (n, 3) [m] cannot hold the device, seen from above."""
    low, high = (f(points[:, :2], axis=0) for f in (np.min, np.max))
    need_low = np.minimum((layout.contacts - layout.radius).min(axis=0), layout.points.min(axis=0, initial=np.inf))
    need_high = np.maximum((layout.contacts + layout.radius).max(axis=0), layout.points.max(axis=0, initial=-np.inf))
    if ((low <= need_low) & (need_high <= high)).all():
        return
    limb, device = _spans(low, high), _spans(need_low, need_high)
    if (high - low < need_high - need_low).any():
        room = max(float(((need_high - need_low) / np.maximum(high - low, 1e-9)).max()), 1.0) * unit  # least that fits
        most = _MOST * unit / float(np.ptp(points, axis=0).max())
        larger = " or ".join(f"{u:g} ({name})" for u, name in _UNITS if room <= u <= most and u != unit)
        other = f", or should it be {larger}" if larger else ""
        tall, lacking = float(np.ptp(points[:, 2])), (high - low < need_high - need_low)
        if (tall >= (need_high - need_low)[lacking]).all():  # turned, it would have room
            other += f", or the file to be turned (z, out of the volar skin, spans {tall * 1e3:.0f} mm)"
        advice = f"is limb.unit = {unit:g} right{other}? else use a smaller device"
    else:
        advice = "move the limb so that the device's middle is over x = y = 0, the elbow towards +x"
    raise GeometryError(f"{file}: spans {limb}, the device needs {device}; {advice}")


def _spans(low: FloatArray, high: FloatArray) -> str:
    """Ranges in millimetres."""
    return " and ".join(f"{n} {a * 1e3:.0f} to {b * 1e3:.0f}" for n, a, b in zip("xy", low, high, strict=True)) + " mm"
