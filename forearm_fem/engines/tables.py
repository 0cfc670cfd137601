"""Tables of a scenario's flat twin, made once per tissue, disc and band, and kept in the cache."""

from __future__ import annotations

import hashlib
from collections.abc import MutableMapping
from pathlib import Path

import numpy as np

from .. import __version__
from ..layered.tables import Tabulated, from_arrays, tabulate
from ..progress import Progress
from ..scenario import Scenario
from ..scenario.sweep import frequencies
from ..store.shelf import Shelf
from ..tissue import resolve_tissues
from ..user_cache import default_cache_dir
from .layered import flat_layers, flat_surface

_REACH = 0.1  # [m]: tables reach to multiples of it, so that one serves every device of a forearm


def tables_reach(span: float) -> float:
    """The distance [m] that tables for ports up to ``span`` [m] apart reach to."""
    return float(_REACH * np.ceil((span + 1e-9) / _REACH))


def kept_tables(
    scenario: Scenario,
    reach: float,
    *,
    folder: Path | None = None,
    known: MutableMapping[str, Tabulated] | None = None,
    progress: Progress | None = None,
) -> Tabulated:
    """The flat twin of the scenario's layers for its disc and band, ports up to ``reach`` [m] apart.

    From ``known``, which is added to, else from ``folder`` (None: the cache), else made and kept there.
    """
    key = _key(scenario, reach)
    if known is not None and key in known:
        return known[key]
    shelf = Shelf((folder or default_cache_dir()) / "twin-tables.sqlite", "tables of the layered model")
    cone, layers, surface = scenario.device.cone, flat_layers(scenario), flat_surface(scenario.tissues)
    found: Tabulated | None = None
    if (arrays := shelf.get(key)) is not None:
        found = from_arrays(arrays, layers, surface, cone.radius, cone.contact)
    if found is None:
        low, high = _band(scenario)
        omega = 2 * np.pi * low, 2 * np.pi * high
        found = tabulate(layers, omega, cone.radius, cone.contact, surface=surface, farthest=reach, progress=progress)
        shelf.put(key, found.arrays())
    if known is not None:
        known[key] = found
    return found


def _band(scenario: Scenario) -> tuple[float, float]:
    """Ends [Hz], a rounding beyond the sweep's."""
    f = frequencies(scenario.sweep)
    return float(f[0]) * (1 - 1e-9), float(f[-1]) * (1 + 1e-9)


def _key(scenario: Scenario, reach: float) -> str:
    low, high = _band(scenario)
    omega = 2 * np.pi * np.geomspace(low, high, 7)
    tissues = {n: (t.density, t.bulk, np.asarray(t.modulus.at(omega)).tolist())
               for n, t in sorted(resolve_tissues(scenario).items())}  # fmt: skip
    layers = [(x.thickness_m, x.density) for x in flat_layers(scenario)]
    cone = scenario.device.cone
    parts = (__version__, tissues, layers, scenario.tissues.model_dump_json(), scenario.limb.model_dump_json(),
             cone.radius, cone.contact, round(low, 6), round(high, 6), round(reach, 6))  # fmt: skip
    return hashlib.sha256(repr(parts).encode()).hexdigest()[:24]
