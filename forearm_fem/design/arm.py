"""Models of an arm that answer for any device on it."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Protocol
from zipfile import BadZipFile

import numpy as np
from scipy.interpolate import BSpline

from .. import __version__
from ..geometry.cache import default_cache_dir
from ..io.atomic import atomic_path
from ..layered.tabulated import DEGREE, Column, Tabulated, tabulate
from ..pipeline.frequencies import frequencies
from ..pipeline.layered_engine import flat_disc, flat_layers, flat_ports, flat_surface
from ..progress import Progress
from ..scenario import Scenario
from ..tissue import resolve_tissues
from ..transfer import Compliance, ErrorEstimate
from ..typing import IntArray

_REACH = 0.1  # [m]: tables reach to multiples of it, so that one serves every device of a forearm


class ArmModel(Protocol):
    """An arm, ready for any device: what a design evaluates its candidates on."""

    def compliance(self, scenario: Scenario) -> Compliance:
        """Compliance of the scenario's ports with its errors; raises a ForearmError for a device that cannot be."""


class TwinArm:
    """The layered twin from tables: flat layers without end, any equal discs, a fraction of a second each.

    Tables are made once per tissue, radius and contact, and kept in ``folder`` (None: the cache).
    """

    def __init__(self, folder: Path | None = None, progress: Progress | None = None) -> None:
        self._folder = folder or default_cache_dir() / "twin-tables"
        self._progress = progress
        self._known: dict[str, Tabulated] = {}

    def compliance(self, scenario: Scenario) -> Compliance:
        """See :class:`ArmModel`; entries between two points are NaN."""
        ports = flat_ports(scenario)
        omega = 2 * np.pi * (frequency := frequencies(scenario.sweep))
        places = np.array([p.position[:2] for p in ports])
        table = self._table(scenario, float(np.ptp(places, axis=0).max() * np.sqrt(2)))
        result = table.compliance(omega, [flat_disc(port) for port in ports])
        e = result.error
        estimate = ErrorEstimate(
            "quadrature", float(e.max()),
            "twice the tables' difference from the twin itself on one arrangement, the last coefficients between "
            "frequencies, and the last terms and orders of the tractions under rigid discs",
            tuple(frequency.tolist()), tuple(e.tolist()),
        )  # fmt: skip
        return Compliance(frequency, result.values, ports, (estimate,))

    def _table(self, scenario: Scenario, span: float) -> Tabulated:
        cone, sweep = scenario.device.cone, scenario.sweep
        f = frequencies(sweep)
        low, high = float(f[0]) * (1 - 1e-9), float(f[-1]) * (1 + 1e-9)
        reach = float(_REACH * np.ceil((span + 1e-9) / _REACH))
        key = self._key(scenario, low, high, reach)
        if key not in self._known:
            self._known[key] = self._kept(
                key,
                scenario,
                lambda: tabulate(
                    flat_layers(scenario), (2 * np.pi * low, 2 * np.pi * high), cone.radius, cone.contact,
                    surface=flat_surface(scenario.tissues), farthest=reach,
                    progress=self._progress,
                ),
            )  # fmt: skip
        return self._known[key]

    def _key(self, scenario: Scenario, low: float, high: float, reach: float) -> str:
        omega = 2 * np.pi * np.geomspace(low, high, 7)
        tissues = {n: (t.density, t.bulk, np.asarray(t.modulus.at(omega)).tolist())
                   for n, t in sorted(resolve_tissues(scenario).items())}  # fmt: skip
        layers = [(x.thickness_m, x.density) for x in flat_layers(scenario)]
        cone = scenario.device.cone
        parts = (__version__, tissues, layers, scenario.tissues.model_dump_json(), scenario.limb.model_dump_json(),
                 cone.radius, cone.contact, round(low, 6), round(high, 6), round(reach, 6))  # fmt: skip
        return hashlib.sha256(repr(parts).encode()).hexdigest()[:24]

    def _kept(self, key: str, scenario: Scenario, make: Callable[[], Tabulated]) -> Tabulated:
        file = self._folder / f"{key}.npz"
        try:
            return _read(file, scenario)
        except (OSError, ValueError, KeyError, BadZipFile):  # not there, or damaged: made anew
            made = make()
            file.parent.mkdir(parents=True, exist_ok=True)
            _write(file, made)
            return made


def _write(file: Path, made: Tabulated) -> None:
    def listed(columns: Mapping[Column, object]) -> IntArray:
        return np.array(list(columns), dtype=int).reshape(-1, 4)

    arrays = {"own": np.array(list(made.own.values())), "own_keys": listed(made.own), "omega": made.omega,
              "checked": made.checked, "ends": np.array([made.low, made.high, made.farthest])}  # fmt: skip
    for name, (index, spline) in (("discs", made.discs), ("points", made.points)):
        arrays |= {f"{name}_keys": listed(index), f"{name}_t": spline.t, f"{name}_c": spline.c}
    with atomic_path(file) as beside, beside.open("wb") as stream:
        np.savez(stream, **arrays)  # type: ignore[arg-type]


def _read(file: Path, scenario: Scenario) -> Tabulated:
    with np.load(file, allow_pickle=False) as kept:
        keys = {name: [Column(*map(int, row)) for row in kept[f"{name}_keys"]] for name in ("own", "discs", "points")}
        low, high, farthest = map(float, kept["ends"])
        discs, points = (
            ({c: i for i, c in enumerate(keys[name])}, BSpline(kept[f"{name}_t"], kept[f"{name}_c"], DEGREE))
            for name in ("discs", "points")
        )
        cone = scenario.device.cone
        return Tabulated(
            tuple(flat_layers(scenario)), flat_surface(scenario.tissues), cone.radius, cone.contact, farthest,
            low, high, kept["omega"], dict(zip(keys["own"], kept["own"], strict=True)), discs, points,
            kept["checked"],
        )  # fmt: skip
