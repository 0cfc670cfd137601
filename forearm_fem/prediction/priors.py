"""What is uncertain about an arm, a device on it and a measurement: named inputs with their laws and sources."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from scipy.special import expit, logit, ndtr

from ..typing import FloatArray

Kind = Literal["log-normal", "normal", "uniform", "log-uniform", "logistic", "choice"]
Known = Literal["seen", "derived", "judgement", "second-hand"]
SHARED = ("skin tension", "skin thickness", "fat thickness")  # what the joint fit moves beside the tissues of a law


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
    """Inputs of every arm, tissue inputs per law, and the ``joint`` fit per law."""

    inputs: Mapping[str, Prior]
    laws: Mapping[str, Mapping[str, Prior]]
    joint: Mapping[str, Joint]

    def tissue_inputs(self, law: str) -> Mapping[str, Prior]:
        """Inputs that the joint fit of ``law`` covers: its tissues, then tension and thicknesses."""
        return {**self.laws[law], **{name: self.inputs[name] for name in SHARED}}


@cache
def load_priors() -> Priors:
    """The priors that come with the program (priors.toml), with the joint fit of the laws (tissue_laws.json)."""
    fitted = json.loads(files("forearm_fem").joinpath("tissue_laws.json").read_text(encoding="utf-8"))
    joint = {
        law: Joint(tuple(found["names"]), np.array(found["mean"]), np.array(found["covariance"]))
        for law, found in fitted["laws"].items()
    }
    return replace(wide_priors(), joint=MappingProxyType(joint))


def wide_priors() -> Priors:
    """The priors before the joint fit: what that starts from."""
    table = tomllib.loads(files(__package__).joinpath("priors.toml").read_text(encoding="utf-8"))
    laws = {law: _table(inputs) for law, inputs in table["laws"].items()}
    return Priors(_table(table["inputs"]), MappingProxyType(laws), MappingProxyType({}))


def _table(rows: Mapping[str, Mapping[str, Any]]) -> Mapping[str, Prior]:
    found = {}
    for name, row in rows.items():
        stated: dict[str, Any] = {key: tuple(v) if isinstance(v, list) else v for key, v in row.items()}
        found[name] = Prior(name, **stated)
    return MappingProxyType(found)
