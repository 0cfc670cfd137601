"""``drives.nc`` and ``displacements.nc``: signals by method, target, channel and time."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from ..arguments import checked
from ..errors import DataError
from ..typing import FloatArray
from .dataset import labels, load, provenance_json, save, text


@dataclass(frozen=True, eq=False)
class Signals:
    """``values`` (n_method, n_target, n_channel, n_time) in ``unit`` at ``time`` (n_time,) [s].

    A channel is an actuator or a grid point, at ``positions`` (n_channel, 3) [m] where known.
    """

    values: FloatArray
    methods: tuple[str, ...]
    targets: tuple[str, ...]
    channels: tuple[str, ...]
    time: FloatArray
    unit: str
    positions: FloatArray | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict)


def stack(
    results: Mapping[tuple[str, str], FloatArray], channels: tuple[str, ...], time: FloatArray, unit: str
) -> Signals:
    """Signals from (method, target) -> (n_channel, n_time); every method must have every target."""
    methods, targets = (tuple(dict.fromkeys(key[i] for key in results)) for i in (0, 1))
    if missing := [(m, t) for m in methods for t in targets if (m, t) not in results]:
        raise DataError(f"no result for method '{missing[0][0]}' at target '{missing[0][1]}'")
    values = np.array([[results[m, t] for t in targets] for m in methods], dtype=float)
    return Signals(values, methods, targets, channels, time, unit)


@checked
def write_drives(path: str | Path, signals: Signals) -> None:
    """Write ``drives`` (method, target, actuator, time)."""
    _write(path, "drives", "actuator", signals)


@checked
def read_drives(path: str | Path) -> Signals:
    """Drives exactly as written; DataError if missing, damaged or something else."""
    return load(path, "drives", lambda dataset: _unpack(dataset, "drives", "actuator"))


@checked
def write_displacements(path: str | Path, signals: Signals) -> None:
    """Write ``displacements`` (method, target, point, time)."""
    _write(path, "displacements", "point", signals)


@checked
def read_displacements(path: str | Path) -> Signals:
    """Displacements exactly as written; DataError if missing, damaged or something else."""
    return load(path, "displacements", lambda dataset: _unpack(dataset, "displacements", "point"))


def _write(path: str | Path, content: str, channel: str, signals: Signals) -> None:
    expected = (len(signals.methods), len(signals.targets), len(signals.channels), len(signals.time))
    if signals.values.shape != expected:
        raise DataError(f"{path}: values have shape {signals.values.shape}, their labels say {expected}")
    variables: dict[str, tuple[tuple[str, ...], Any, dict[str, str]]] = {
        "method": (("method",), labels(signals.methods), {}),
        "target": (("target",), labels(signals.targets), {"long_name": "grid point aimed at"}),
        channel: ((channel,), labels(signals.channels), {}),
        "time": (("time",), signals.time, {"units": "s"}),
        content: (("method", "target", channel, "time"), signals.values, {"units": signals.unit}),
    }
    if signals.positions is not None:
        variables["xyz"] = (("xyz",), labels(("x", "y", "z")), {})
        variables[f"{channel}_position"] = ((channel, "xyz"), signals.positions, {"units": "m"})
    save(path, variables, {"content": content, "provenance": provenance_json(signals.provenance)})


def _unpack(dataset: xr.Dataset, content: str, channel: str) -> Signals:
    place = f"{channel}_position"
    methods, targets, channels = (tuple(text(dataset[key].values)) for key in ("method", "target", channel))
    return Signals(
        values=dataset[content].values,
        methods=methods,
        targets=targets,
        channels=channels,
        time=dataset["time"].values,
        unit=str(dataset[content].attrs["units"]),
        positions=dataset[place].values if place in dataset else None,
        provenance=json.loads(dataset.attrs["provenance"]),
    )
