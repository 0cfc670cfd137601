"""Parameters of a fit, and the models that answer for their values."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats.qmc import LatinHypercube

from ...accuracy.estimates import quadrature_estimate
from ...device.loop import close_loop
from ...engines.arm_meshes import ArmMeshes, arm_meshes
from ...engines.layered import NO_PATCH, LayeredEngine, between_ports, flat_disc, flat_layers, flat_surface
from ...engines.parametric import ParametricModel, parametric_model
from ...engines.simulation import Engine
from ...errors import ScenarioError
from ...geometry.device.layout import layers_of, planform_ports
from ...layered import layered_compliance
from ...layered.response import scattered_orders
from ...ports import Port
from ...progress import Progress
from ...scenario import Scenario, parse_scenario
from ...scenario.device import VoltageDevice
from ...scenario.model import resolve_tissues
from ...transfer import Compliance, TransferMatrix
from ...typing import FloatArray

# Parameters of a fit, and sentences on those not found.

_MEMBER = 0.3  # of a unit vector: parameters with this share belong to a combination


@dataclass(frozen=True)
class Parameter:
    """A number to be found between ``lower`` and ``upper``, from ``start``; ``log`` fits its logarithm.

    ``stage`` orders the fit: parameters of stage 0 are fitted first, with the others at their start, then
    those of stages 0 and 1, and so on. Scale, delay [s] and gains of actuators are multiplied onto the
    model by :func:`fit`.
    """

    name: str
    start: float
    lower: float
    upper: float
    log: bool = False
    stage: int = 1
    unit: str = ""

    def __post_init__(self) -> None:
        if not self.lower < self.upper or not self.lower <= self.start <= self.upper:
            raise ScenarioError(
                f"{self.name}: expected lower <= start <= upper, got {self.lower:g}, {self.start:g}, {self.upper:g}"
            )
        if self.log and self.lower <= 0:
            raise ScenarioError(f"{self.name}: a logarithm needs a positive lower bound, got {self.lower:g}")

    def to_unit(self, value: float) -> float:
        """Place of ``value`` between the bounds, 0 to 1."""
        f = math.log if self.log else float
        return (f(value) - f(self.lower)) / (f(self.upper) - f(self.lower))

    def from_unit(self, place: float) -> float:
        """The value at ``place``."""
        if self.log:
            return float(self.lower * (self.upper / self.lower) ** place)
        return float(self.lower + place * (self.upper - self.lower))

    @property
    def span(self) -> float:
        """Width of the range in the coordinate that is fitted: of the logarithm, or the parameter's unit."""
        return math.log(self.upper / self.lower) if self.log else self.upper - self.lower


@dataclass(frozen=True, eq=False)
class Direction:
    """A combination of parameters that the data do not tell: ``weights`` (unit vector over the ranges) and
    its standard ``deviation`` as a share of the allowed range."""

    weights: Mapping[str, float]
    deviation: float

    @property
    def sentence(self) -> str:
        """Combination of parameters that the data cannot tell."""
        names = [n for n, w in self.weights.items() if abs(w) >= _MEMBER]
        share = f"{100 * self.deviation:.0f} %" if self.deviation <= 1 else "more than all"
        if len(names) == 1:
            return f"the data do not determine {names[0]}: it is uncertain by {share} of its allowed range"
        sign = [f"{self.weights[n]:+.2f} {n}" for n in names]
        return (
            f"the data cannot tell {', '.join(names[:-1])} and {names[-1]} apart: along {' '.join(sign)} they are "
            f"uncertain by {share} of their allowed range"
        )


# Ready-made models for :func:`fit`: a scenario's tissue and actuator parameters, by their keys.

_POOL = 120  # arms within the ranges of a fit, from which its finite elements are reduced
_REACH = 3.0  # times or divided by: a fit's ranges reach to 6, where measured tissue is not
# Terms under rigid cones, and orders fewer than the layered model takes: 5e-5 of points for the thesis' device
_TERMS, _FEWER = 4, 1


class ScenarioModel:
    """Maps dotted scenario keys, e.g. ``tissues.override.skin.mu`` or ``device.coil.moving_mass``, to G.

    ``engine`` answers for the skin at ``frequency`` (n,) [Hz]; it is asked only when a key outside ``device`` changes,
    for the actuators are closed around it at no cost. The last ``memory`` skins are kept.
    """

    def __init__(self, scenario: Scenario, engine: Engine, frequency: FloatArray, memory: int = 64) -> None:
        self._base = scenario.model_dump(mode="json", exclude_none=True)
        self._engine, self._frequency = engine, frequency
        self._memory = memory
        self._known: dict[tuple[tuple[str, float], ...], Compliance] = {}

    def scenario(self, values: Mapping[str, float]) -> Scenario:
        """The scenario with ``values`` set; ScenarioError for an unknown key."""
        return _with_values(self._base, values)

    def __call__(self, values: Mapping[str, float]) -> TransferMatrix:
        """G at ``values``."""
        scenario = self.scenario(values)
        key = tuple(sorted((k, v) for k, v in values.items() if not _lumped(k)))
        if key not in self._known:
            if len(self._known) >= self._memory:
                self._known.pop(next(iter(self._known)))
            self._known[key] = self._engine.compliance(scenario, self._frequency)
        return close_loop(self._known[key], scenario.device)


def _with_values(data: Mapping[str, Any], values: Mapping[str, float]) -> Scenario:
    """The scenario of ``data`` with ``values`` set by their dotted keys."""
    for key, value in values.items():
        data = _put(data, key.split("."), value, key)
    return parse_scenario(data, origin="fit")


def _lumped(key: str) -> bool:
    """Keys that do not change the skin: coil, cone mass and housing (the cone's radius does)."""
    return key.startswith(("device.coil.", "device.housing.")) or key == "device.cone.mass"


def _put(data: Any, path: list[str], value: float, key: str) -> Any:
    if not path:
        return value
    if isinstance(data, list | tuple):
        if not path[0].isdigit() or int(path[0]) >= len(data):
            raise ScenarioError(f"{key}: '{path[0]}' is no position in a list of {len(data)}")
        at = int(path[0])
        return [*data[:at], _put(data[at], path[1:], value, key), *data[at + 1 :]]
    if not isinstance(data, Mapping):
        raise ScenarioError(f"{key}: nothing can be set below '{path[0]}'")
    return {**data, path[0]: _put(data.get(path[0], {}), path[1:], value, key)}


@dataclass(frozen=True)
class LayeredBetween:
    """The layered model between the planform places of measured ports, with the scenario's cones and membrane.

    Flat and infinite: a fit absorbs what that leaves out into its parameters. The core is a half-space. Points do not
    drive.
    """

    outputs: tuple[Port, ...]
    inputs: tuple[Port, ...]
    tolerance: float = 1e-4
    name: str = "layered model"

    def holds(self, scenario: Scenario) -> str:
        """See :class:`.Engine`: as the layered model."""
        return NO_PATCH if scenario.tissues.patch.is_on else LayeredEngine().holds(scenario)

    def compliance(self, scenario: Scenario, frequency: FloatArray) -> Compliance:
        """See :class:`.Engine`; columns of contacts."""
        cone = scenario.device.cone
        contacts = tuple(Port(p.name, "contact", p.position, p.axis, cone.radius, cone.contact) for p in self.inputs)
        ports = (*contacts, *self.outputs)
        discs = [flat_disc(port) for port in ports]
        result = layered_compliance(
            flat_layers(scenario), 2 * np.pi * frequency, discs[: len(contacts)], discs,
            surface=flat_surface(scenario.tissues), tolerance=self.tolerance, terms=_TERMS,
            orders=max(scattered_orders(discs) - _FEWER, 0),
        )  # fmt: skip
        estimate = quadrature_estimate(
            frequency, result.error, "last terms and orders of the tractions under rigid discs, quadrature"
        )
        values = between_ports(result.values, ports)
        return Compliance(frequency, values, ports, (estimate,), provenance={"engine": "layered"})


def fem_model_for(
    scenario: Scenario, parameters: Sequence[Parameter], *, base: str | Path = ".", progress: Progress | None = None
) -> ParametricModel:
    """The scene's finite elements for values of the ``parameters`` from a third to three times their start.

    Kept in the cache. Raises ScenarioError for parameters that need another mesh, and what solving the scenario raises.
    """
    return parametric_model(scenario, base=base, draws=_pool(scenario, parameters), progress=progress)


def fem_meshes_for(
    scenario: Scenario, parameters: Sequence[Parameter], *, base: str | Path = ".", progress: Progress | None = None
) -> ArmMeshes:
    """The same on a second mesh, which tells what the elements err by; MeshError says why there is none."""
    return arm_meshes(scenario, base, _pool(scenario, parameters), progress)


@dataclass(frozen=True, eq=False)
class LessElements:
    """The reduced finite elements less a ``share`` (n_frequency,) of the change on the ``second`` mesh: what the
    elements err by, as far as it has the shape of that change."""

    model: ParametricModel
    second: ParametricModel
    share: FloatArray
    name: str = "parametric finite elements, elements' error taken off"

    def holds(self, scenario: Scenario) -> str:
        """See :class:`.Engine`: as the model."""
        return self.model.holds(scenario)

    def compliance(self, scenario: Scenario, frequency: FloatArray) -> Compliance:
        """See :class:`.Engine`."""
        own, other = (m.compliance(scenario, frequency) for m in (self.model, self.second))
        return replace(own, values=own.values - self.share[:, None, None] * (other.values - own.values))


def _pool(scenario: Scenario, parameters: Sequence[Parameter]) -> list[Scenario]:
    """The arms that a fit's finite elements are reduced for, the scene first."""
    skin = [p for p in parameters if not _lumped(p.name) and not p.name.startswith(("scale", "delay", "gain."))]
    if geometry := [p.name for p in skin if not p.name.startswith("tissues.")]:
        raise ScenarioError(
            f"{geometry[0]}: a mesh has one geometry, so that a fit on finite elements cannot look for it; leave it "
            "out, or fit on the layered model"
        )
    base = scenario.model_dump(mode="json", exclude_none=True)
    places = LatinHypercube(max(len(skin), 1), rng=np.random.default_rng(0)).random(_POOL)
    drawn = [
        _with_values(base, {p.name: p.start * _REACH ** (2 * x - 1) for p, x in zip(skin, row, strict=False)})
        for row in places
    ]
    return [scenario, *drawn]


def common_parameters(scenario: Scenario, names: Sequence[str]) -> tuple[Parameter, ...]:
    """Parameters with sourced ranges (physics_data.md 4 and 9) for short names: skin.mu, skin.eta, fat.mu, ...,
    coil.moving_mass, cone.mass, coil.resonance, coil.quality, fat.thickness, plus scale, delay and gain.A1, ... (stage
    0). ScenarioError for names that are none, such as those of tissues that the limb has not, and for repeated ones.
    """
    known = _known(scenario)
    if repeated := [n for n in dict.fromkeys(names) if list(names).count(n) > 1]:
        raise ScenarioError(f"{repeated[0]} is named twice; name each parameter of a fit once")
    if unknown := [n for n in names if n not in known]:
        raise ScenarioError(f"no parameter is called {', '.join(unknown)}; known are {', '.join(known)}")
    return tuple(known[n] for n in names)


def _around(key: str, start: float, low: float, high: float, unit: str = "") -> Parameter:
    """A parameter of an actuator, from ``low`` to ``high`` for the thesis' kind; for another the range is wider."""
    if not low <= start <= high:
        low, high = min(low, start / 3), max(high, 3 * start)
    return Parameter(key, start, low, high, log=True, unit=unit)


def _known(scenario: Scenario) -> dict[str, Parameter]:
    tissues = resolve_tissues(scenario)
    found = {
        "scale": Parameter("scale", 1.0, 0.2, 5.0, log=True, stage=0),
        "delay": Parameter("delay", 0.0, -2e-3, 2e-3, stage=0, unit="s"),
    }
    found |= {f"gain.{p.name}": Parameter(f"gain.{p.name}", 1.0, 0.2, 5.0, log=True, stage=0)
              for p in planform_ports(scenario)[1]}  # fmt: skip
    if isinstance(device := scenario.device, VoltageDevice):
        coil, cone = device.coil, device.cone
        found |= {
            "coil.moving_mass": _around("device.coil.moving_mass", coil.moving_mass, 0.1e-3, 1e-3, "kg"),
            "coil.force_factor": _around("device.coil.force_factor", coil.force_factor, 0.8, 7.0, "T m"),
            "coil.resonance": _around("device.coil.resonance", coil.resonance, 300.0, 1000.0, "Hz"),
            "coil.quality": _around("device.coil.quality", coil.quality, 1.0, 10.0),
        }
        if cone.mass > 0:
            found["cone.mass"] = _around("device.cone.mass", cone.mass, 0.1e-3, 1.5e-3, "kg")
    layers = layers_of(scenario.limb)
    alike = Counter(part.tissue for part in layers)
    for layer, part in enumerate(layers):
        key = f"limb.layers.{layer}.thickness"  # layers of one tissue are told apart by their place from outside
        name = part.tissue if alike[part.tissue] == 1 else f"{part.tissue}.{layer + 1}"
        found[f"{name}.thickness"] = Parameter(
            key, part.thickness, part.thickness / 3, part.thickness * 3, log=True, unit="m"
        )
    own = {*scenario.tissue_keys.values(), *(("bone",) if getattr(scenario.limb, "bones", ()) else ())}
    for name, tissue in tissues.items():
        stated = tissue.modulus.stated("")
        keys = {"mu": "mu", "eta": "eta", **{short: f"parameters.{short}" for short in stated.get("parameters", ())}}
        for short, key in keys.items():
            value = getattr(tissue.modulus, short, None)
            if name in own and isinstance(value, float) and value > 0:
                high, unit = min(6 * value, tissue.modulus.below(short)), {"mu": "Pa", "eta": "Pa s"}.get(short, "")
                place = f"tissues.override.{name}.{key}"
                found[f"{name}.{short}"] = Parameter(place, value, value / 6, high, log=True, unit=unit)
    return found
