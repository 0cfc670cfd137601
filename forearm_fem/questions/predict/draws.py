"""Priors of arms, devices and measurements, and draws from them."""

from __future__ import annotations

import json
import math
import tomllib
import zlib
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from scipy.special import expit, logit, ndtr

from ...errors import ScenarioError
from ...geometry.device.layout import turned
from ...scenario import Scenario, parse_scenario
from ...scenario.device import VoltageDevice
from ...scenario.limb import limb_tissues
from ...scenario.model import resolve_tissues
from ...tissue import LAWS as BUILT_IN
from ...tissue import law
from ...typing import FloatArray
from ...usercode import is_code

# Uncertain inputs of an arm, a device and a measurement, with their laws and sources.

Kind = Literal["log-normal", "normal", "uniform", "log-uniform", "logistic", "choice"]
Known = Literal["seen", "derived", "judgement", "second-hand"]
FASCIA, TAPE = "fascia", "tape"
# What the joint fit moves beside the tissues of a law
SHARED = ("skin tension", "skin thickness", "fat thickness", "fascia thickness", "fascia modulus")


@dataclass(frozen=True)
class Prior:
    """The law of one input, its unit (SI unless it says otherwise), its ``source`` and how that is ``known``.

    A standard-normal z gives centre * spread^z (log-normal), centre + spread z (normal), low to high evenly, or evenly
    in the logarithm, by its quantile (uniform, log-uniform), a share whose logit is normal with deviation ``spread``
    (logistic), or one of ``choices``, all equally likely. With ``each`` there is one such input for each actuator,
    their normals correlated by that much.
    """

    name: str
    kind: Kind
    source: str
    known: Known
    group: str = "tissue"
    unit: str = ""
    centre: float = 0.0
    spread: float = 1.0
    low: float = 0.0
    high: float = 1.0
    choices: tuple[str, ...] = ()
    each: float | None = None

    def value(self, z: float) -> float:
        """The input at the standard-normal deviate ``z``; of a choice its index."""
        match self.kind:
            case "log-normal":
                return float(self.centre * self.spread**z)
            case "normal":
                return float(self.centre + self.spread * z)
            case "uniform":
                return float(self.low + (self.high - self.low) * ndtr(z))
            case "log-uniform":
                return float(self.low * (self.high / self.low) ** ndtr(z))
            case "logistic":
                return float(expit(logit(self.centre) + self.spread * z))
            case _:
                return float(min(int(len(self.choices) * ndtr(z)), len(self.choices) - 1))


@dataclass(frozen=True, eq=False)
class Joint:
    """Standard normals of ``names`` as measurements leave them: ``mean`` (n,) and ``covariance`` (n, n)."""

    names: tuple[str, ...]
    mean: FloatArray
    covariance: FloatArray

    @property
    def root(self) -> FloatArray:
        """Lower triangle L (n, n) with covariance = L L^T."""
        return np.asarray(np.linalg.cholesky(self.covariance))


@dataclass(frozen=True, eq=False)
class Priors:
    """Inputs of every arm, tissue inputs per law, and the joint fit per law of arms with a deep fascia (``joint``) and
    without (``bare``)."""

    inputs: Mapping[str, Prior]
    laws: Mapping[str, Mapping[str, Prior]]
    joint: Mapping[str, Joint]
    bare: Mapping[str, Joint]

    def tissue_inputs(self, name: str, bare: bool = False) -> Mapping[str, Prior]:
        """Inputs that the joint fit of the law ``name`` covers: its tissues, then tension, thicknesses and fascia."""
        own = self.laws[name] if name in self.laws else _of_class(name)
        shared = [key for key in SHARED if not (bare and key.startswith(FASCIA))]
        return {**own, **{key: self.inputs[key] for key in shared}}


@cache
def load_priors() -> Priors:
    """The priors that come with the program (priors.toml), with the joint fit of the laws (tissue_laws.json)."""
    fitted = json.loads(files("forearm_fem").joinpath("tissue_laws.json").read_text(encoding="utf-8"))
    joint, bare = (
        MappingProxyType({
            law: Joint(tuple(found["names"]), np.array(found["mean"]), np.array(found["covariance"]))
            for law, found in fitted[part].items()
        })
        for part in ("laws", "bare")
    )  # fmt: skip
    return replace(wide_priors(), joint=joint, bare=bare)


def wide_priors() -> Priors:
    """The priors before the joint fit: what that starts from."""
    table = tomllib.loads(files(__package__).joinpath("priors.toml").read_text(encoding="utf-8"))
    laws = {law: _table(inputs) for law, inputs in table["laws"].items()}
    return Priors(_table(table["inputs"]), MappingProxyType(laws), MappingProxyType({}), MappingProxyType({}))


def _of_class(name: str) -> Mapping[str, Prior]:
    """Inputs of a law of one's own, as its class says; ScenarioError where it does not."""
    found = {
        f"{tissue}.{key}": Prior(f"{tissue}.{key}", "log-normal", name, "judgement", centre=centre, spread=spread)
        for tissue, inputs in law(name).drawn.items()
        for key, (centre, spread) in inputs.items()
    }
    if not found or any(key.partition(".")[0] not in SOFT for key in found):
        raise ScenarioError(
            f"--law: {name} does not say how arms differ; give its class drawn = {{'skin': {{'mu': (13e3, 1.8)}}}}, "
            f"centre and factor of each input, for some of {', '.join(SOFT)}"
        )
    return found


def _table(rows: Mapping[str, Mapping[str, Any]]) -> Mapping[str, Prior]:
    found = {}
    for name, row in rows.items():
        stated: dict[str, Any] = {key: tuple(v) if isinstance(v, list) else v for key, v in row.items()}
        found[name] = Prior(name, **stated)
    return MappingProxyType(found)


# Draws of arms: named inputs from the priors, and the scenario that they make of another.

LAWS = ("kelvin-voigt", "zener", "springpot")  # drawn unless others are named
SOFT = ("skin", "fat", "muscle")
WRIST, ELBOW = "contact spring, wrist side", "contact spring, elbow side"
TAPE_INPUTS = {"tape thickness", "tape modulus"}  # drawn together or not at all
_PLACED = {"grid x", "grid y", "grid turn"}
_RIG = MappingProxyType(
    {"vibrometer noise": "noise", "arm motion": "motion", "entry gain": "gain", "entry phase": "phase"}
)
_TAPE_DENSITY = 1500.0  # kg/m^3: polyester has 1390, beads of glass more
_FASCIA_LOSS = 2e-4  # s: eta / mu, a loss tangent of .19 at 150 Hz (judgement)
# input -> the key under [device] that it spreads about the scenario's own
_SPREAD: Mapping[str, tuple[str, str]] = MappingProxyType(
    {
        "moving mass": ("coil", "moving_mass"),
        "coil resonance": ("coil", "resonance"),
        "coil quality": ("coil", "quality"),
        "housing mass": ("housing", "mass"),
        "strap stiffness": ("housing", "strap_stiffness"),
    }
)


@dataclass(frozen=True)
class Draw:
    """Number ``number`` of a ``seed``: its ``law``, and its inputs by name (``values``, SI; see priors.toml)."""

    seed: int
    number: int
    law: str
    values: Mapping[str, float]

    def generator(self, purpose: str) -> np.random.Generator:
        """Random numbers of this draw for a purpose of its own, e.g. "noise"."""
        return np.random.default_rng([self.seed, self.number, zlib.crc32(purpose.encode())])


def draw_inputs(
    priors: Priors, scenario: Scenario, seed: int, number: int, laws: Collection[str] = LAWS, *, bare: bool = False
) -> Draw:
    """Draw ``number`` of ``seed``: the same however many are asked for, by whom, and in which order; ``bare`` arms have
    tissues as measurements leave them where there is no deep fascia.

    Each input has random numbers of its own, so that draws of different laws or devices share what they have in common.
    """

    def normal(name: str) -> float:
        """This draw's normal score of an input, whatever else is drawn."""
        return float(np.random.default_rng([seed, number, zlib.crc32(name.encode())]).standard_normal())

    known = priors.inputs["law"].choices
    others = sorted(x for x in set(laws) - set(known) if is_code(x) or x in BUILT_IN)
    chosen = [*(x for x in known if x in laws), *others]
    if not chosen:
        raise ScenarioError(f"laws: expected some of {', '.join(LAWS)}, got {', '.join(sorted(laws)) or 'none'}")
    own = chosen[int(Prior("law", "choice", "", "judgement", choices=tuple(chosen)).value(normal("law")))]
    inputs = priors.tissue_inputs(own, bare)
    joint = (priors.bare if bare else priors.joint).get(own)
    names = tuple(inputs) if joint is None else joint.names
    z = np.array([normal(name) for name in names])
    z = z if joint is None else joint.mean + joint.root @ z
    values = {name: inputs[name].value(float(x)) for name, x in zip(names, z, strict=True)}
    for name, prior in priors.inputs.items():
        if prior.each is not None:
            values |= _each(prior, scenario, normal)
        elif name not in values and name != "law":
            values[name] = prior.value(normal(name))
    return Draw(seed, number, own, values)


def _each(prior: Prior, scenario: Scenario, normal: Any) -> dict[str, float]:
    """One input for each actuator that the prior speaks of, all leaning on one normal by its correlation."""
    assert prior.each is not None
    common, own = math.sqrt(prior.each) * normal(prior.name), math.sqrt(1 - prior.each)
    found = {}
    for key in each_name(prior.name, scenario):
        found[key] = prior.value(common + own * normal(key))
    return found


def each_name(prior: str, scenario: Scenario) -> tuple[str, ...]:
    """Names of the inputs of a ``prior`` that has one for each actuator, or for each on a side of the limb."""
    stem = prior.partition(",")[0]
    return tuple(
        f"{stem} A{k}"
        for k, (x, _) in enumerate(turned(scenario, scenario.device.centres), start=1)  # the device may be turned
        if not ((prior == WRIST and x >= 0) or (prior == ELBOW and x < 0))
    )


def scenario_of(draw: Draw, scenario: Scenario, held: Collection[str] = ()) -> Scenario:
    """``scenario`` on the arm and with the device of ``draw``; inputs of the names or groups ``held`` stay its own.

    Tissues called skin, fat and muscle get the drawn law, if it has inputs for them; others, and limbs without layers,
    keep theirs. A deep fascia comes between the last layer and a core of muscle that has none. What the rig makes of
    the arm is :func:`measured_of`; the places that the experimenter takes for true are the scenario's.
    """
    data: dict[str, Any] = scenario.model_dump()
    values = {name: value for name, value in draw.values.items() if name not in held}
    if "tissue" not in held:
        known, override, soft = resolve_tissues(scenario), data["tissues"]["override"], limb_tissues(scenario.limb)
        for tissue, parameters in law_parameters(draw.law, draw.values).items():
            bulk = "incompressible" if known[tissue].incompressible else known[tissue].bulk
            if tissue in soft:
                override[tissue] = {"density": known[tissue].density, "bulk": bulk, **parameters}
    if "skin tension" in values:
        data["tissues"]["membrane"]["tension"] = values["skin tension"]
    layers = data["limb"].get("layers", ())
    if _has_place_for_fascia(scenario) and "fascia thickness" in values:
        data["limb"]["layers"] = layers = [*layers, {"tissue": FASCIA, "thickness": values["fascia thickness"]}]
    if any(layer["tissue"] == FASCIA for layer in layers) and "fascia modulus" in values:
        data["tissues"]["override"][FASCIA] = fascia_parameters(values["fascia modulus"])
    if scenario.tissues.patch.is_on and values.keys() >= TAPE_INPUTS:
        data["tissues"]["patch"] |= tape_parameters(values["tape thickness"], values["tape modulus"])
    drawn_here = (*SOFT, FASCIA)
    whole = {tissue: sum(part["thickness"] for part in layers if part["tissue"] == tissue) for tissue in drawn_here}
    for layer in layers:  # layers of one tissue share what is drawn for it, as they share their own
        if (drawn := values.get(f"{layer['tissue']} thickness")) is not None:
            layer["thickness"] *= drawn / whole[layer["tissue"]]
    _set_device(data["device"], values)
    if _PLACED & values.keys():
        data["grid"] = {"points": moved_points(scenario, values), "direction": scenario.grid.direction}
    return parse_scenario(data)


def _has_place_for_fascia(scenario: Scenario) -> bool:
    """True if the limb's core is muscle and no layer is a fascia yet."""
    return getattr(scenario.limb, "core", "") == "muscle" and not has_fascia(scenario)


def has_fascia(scenario: Scenario) -> bool:
    """True if a layer of the limb is a fascia."""
    return any(layer.tissue == FASCIA for layer in getattr(scenario.limb, "layers", ()))


def is_bare(scenario: Scenario, held: Collection[str]) -> bool:
    """True if arms of the ``scenario`` have no deep fascia: it has none, and none is drawn."""
    return not has_fascia(scenario) and ("fascia thickness" in held or not _has_place_for_fascia(scenario))


def fascia_parameters(mu: float) -> dict[str, float | str]:
    """Keys of ``[tissues.override.fascia]`` for a shear modulus ``mu`` [Pa]."""
    return {"law": "kelvin-voigt", "density": 1120.0, "bulk": 2.2e9, "mu": mu, "eta": _FASCIA_LOSS * mu}


def tape_parameters(thickness: float, modulus: float) -> dict[str, float]:
    """Keys of ``[tissues.patch]`` for an incompressible tape of a ``thickness`` [m] and Young's ``modulus`` [Pa]."""
    return {
        "mass": _TAPE_DENSITY * thickness, "stiffness": modulus * thickness / 3, "bending": modulus * thickness**3 / 9,
    }  # fmt: skip


def taped(scenario: Scenario, held: Collection[str]) -> Scenario:
    """The ``scenario`` with the tape of the thesis' rig on its grid, unless it has one or tape is ``held``."""
    if scenario.tissues.patch.is_on or TAPE_INPUTS & expanded(held, scenario):
        return scenario
    inputs = load_priors().inputs
    middle = tape_parameters(inputs["tape thickness"].value(0.0), inputs["tape modulus"].value(0.0))
    return scenario.changed({f"tissues.patch.{key}": value for key, value in middle.items()})


def expanded(held: Collection[str], scenario: Scenario) -> frozenset[str]:
    """Names of inputs for names and groups; of those that each actuator has, the names of the ``scenario``'s."""
    priors = load_priors()
    names = {n for n, p in priors.inputs.items() if n in held or p.group in held}
    each = {key for n in names if priors.inputs[n].each is not None for key in each_name(n, scenario)}
    return frozenset({*names, *each, *({"tissue"} & set(held))})


def measured_of(draw: Draw, arm: Scenario, held: Collection[str] = ()) -> Scenario:
    """The scenario of ``draw``'s ``arm`` as its rig measures it: the grid's points where the laser meets them, the
    laser's direction, and what ``[measurement.rig]`` adds to each entry.

    Points are measured in turn while the device slips evenly along ``device slip`` and ``device slip, turn``, half of
    it before the middle of the session; each is aimed at with ``laser aim`` to either side.
    """
    values = {name: value for name, value in draw.values.items() if name not in held}
    rig = {key: values[name] for name, key in _RIG.items() if name in values}
    changes: dict[str, Any] = {f"measurement.rig.{key}": value for key, value in rig.items()}
    places, rng = np.array(arm.grid.places), draw.generator("places measured")
    slip, aim = rng.standard_normal(3), rng.standard_normal(places.shape)
    done = np.linspace(-0.5, 0.5, len(places))
    turn = values.get("device slip, turn", 0.0) * slip[2] * done
    c, s = np.cos(turn), np.sin(turn)
    met = np.column_stack([c * places[:, 0] - s * places[:, 1], s * places[:, 0] + c * places[:, 1]])
    met = met + values.get("device slip", 0.0) * slip[:2] * done[:, None] + values.get("laser aim", 0.0) * aim
    direction = arm.grid.direction
    if values.get("laser direction", 0.0) == 1 and arm.limb.shape != "slab":
        direction = "vertical"
    if direction != arm.grid.direction or not np.array_equal(met, places):
        changes["grid"] = {"points": [(float(x), float(y)) for x, y in met], "direction": direction}
    return arm.changed(changes) if changes else arm


def _set_device(device: dict[str, Any], values: Mapping[str, float]) -> None:
    """Spreads about the scenario's own device: what is drawn about a centre multiplies what it has."""
    if "contact area" in values:
        device["cone"]["radius"] *= math.sqrt(values["contact area"])
    if "housing share" in values and "skin_share" in device.get("housing", ()):
        device["housing"]["skin_share"] = values["housing share"]
    inputs = load_priors().inputs
    for name, (part, key) in _SPREAD.items():
        if name in values and key in device.get(part, ()):
            device[part][key] *= values[name] / inputs[name].centre
    springs, gains = (
        {who: value for n, value in values.items() for what, _, who in [n.rpartition(" ")] if what == name}
        for name in ("contact spring", "gain")
    )
    touching = {who: k for who, k in springs.items() if who not in device["out_of_contact"]}
    device["contact_springs"] = {**device["contact_springs"], **touching}
    device["gains"] = {**device["gains"], **{who: device["gains"].get(who, 1.0) * g for who, g in gains.items()}}


def idle_inputs(scenario: Scenario) -> frozenset[str]:
    """Inputs that no G of the ``scenario`` hangs on: coil and housing where forces or displacements are given or the
    housing is held, springs where forces are given, what is between a cone and skin that it does not touch, and tape
    that is not there."""
    device = scenario.device
    parts = device.model_dump()
    keys = {**_SPREAD, "housing share": ("housing", "skin_share")}
    idle = {name for name, (part, key) in keys.items() if key not in parts.get(part, ())}
    if scenario.limb.shape == "slab":
        idle.add("laser direction")
    if not scenario.tissues.patch.is_on:
        idle |= TAPE_INPUTS
    for name in (f"A{k}" for k in range(1, len(device.centres) + 1)):
        apart = name in device.out_of_contact
        if apart or device.drive == "force":
            idle.add(f"contact spring {name}")
        if apart and (not isinstance(device, VoltageDevice) or device.housing.fixed):
            idle.add(f"gain {name}")
    return frozenset(idle)


def law_parameters(name: str, values: Mapping[str, float]) -> dict[str, dict[str, Any]]:
    """Keys of ``[tissues.override.T]`` for T = skin, fat and muscle from inputs of the law ``name``, called
    "T.input"; a tissue without inputs is not among them."""
    own = {t: {n[len(t) + 1 :]: v for n, v in values.items() if n.startswith(f"{t}.")} for t in SOFT}
    return {t: law(name).of_inputs(inputs).stated(name) for t, inputs in own.items() if inputs}


def moved_points(scenario: Scenario, values: Mapping[str, float]) -> list[tuple[float, float]]:
    """Grid points where they are in truth: turned about the origin, then shifted [m], in the device's frame."""
    turn = values.get("grid turn", 0.0)
    c, s = math.cos(turn), math.sin(turn)
    dx, dy = values.get("grid x", 0.0), values.get("grid y", 0.0)
    return [(c * x - s * y + dx, s * x + c * y + dy) for x, y in scenario.grid.places]


def soft_tissues(scenario: Scenario) -> tuple[str, ...]:
    """Soft tissues of the limb, of skin, fat and muscle: those that a draw changes."""
    limb = scenario.limb
    named = {layer.tissue for layer in getattr(limb, "layers", ())} | {getattr(limb, "core", "")}
    named |= set(getattr(limb, "surfaces", {})) | set(getattr(limb, "regions", {}).values())
    return tuple(t for t in SOFT if t in named)


def kept_tissues(scenario: Scenario) -> tuple[str, ...]:
    """Tissues of the limb's layers and core that no draw changes, for the priors do not name them."""
    limb = scenario.limb
    named = [*(layer.tissue for layer in getattr(limb, "layers", ())), getattr(limb, "core", "")]
    return tuple(dict.fromkeys(t for t in named if t and t not in (*SOFT, FASCIA)))
