"""Tissues: a law of the shear modulus, density, bulk modulus, and five sourced presets.

A law is a complex shear modulus mu*(omega), a small class, which says all that is known of it. Time dependence
e^{+i omega t}, so a passive tissue has Im mu*(omega) >= 0 for omega > 0 and mu*(-omega) = conj mu*(omega). Fibres along
the limb make a tissue stiffer along than across (:class:`Tissue`). Not covered: pre-stress (the skin's is a membrane
term, ``scenario.tissues``), fibres in other directions.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass, replace
from importlib.resources import files
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from .errors import ScenarioError
from .typing import ComplexArray, FloatArray
from .usercode import named

REFERENCE = 150.0  # Hz at which the size of a springpot's modulus is drawn
KEYS = ("mu", "eta", "exponent", "mu_infinity")  # of [tissues.override.T]; other parameters have a table there


class Law:
    """A complex shear modulus as a function of frequency: a frozen dataclass whose fields are its parameters.

    A law that comes with the program has a ``name``, by which scenarios and ``predict --law`` know it: there is no
    other list. ``at`` must take complex omega and be smooth about every positive one. ``drawn`` says how arms differ:
    of "skin", "fat" and "muscle" the centre of each input, and the factor of one standard deviation; without it, or a
    table of priors.toml, `predict` does not draw the law. Inputs are the parameters, unless ``of_inputs`` says more.
    """

    name: ClassVar[str] = ""
    drawn: ClassVar[Mapping[str, Mapping[str, tuple[float, float]]]] = MappingProxyType({})

    @property
    def problem(self) -> str:
        """Reason that the parameters cannot be, as "key: sentence"; empty where they can."""
        return ""

    def at(self, omega: ArrayLike) -> ComplexArray:
        """mu*(omega) [Pa], of omega's shape; omega [rad/s]."""
        raise NotImplementedError

    def taylor(self, omega0: float, n: int) -> ComplexArray:
        """Coefficients c (n + 1,) of mu*(omega0 + d) = sum_k c_k d^k [Pa s^k], by Cauchy's integral on a circle of 0.3
        omega0."""
        radius, count = 0.3 * (abs(omega0) or 1.0), 8 * (n + 2)
        circle = np.exp(2j * np.pi * np.arange(count) / count)
        return np.asarray(np.fft.fft(self.at(omega0 + radius * circle))[: n + 1] / count / radius ** np.arange(n + 1))

    @classmethod
    def of_inputs(cls, inputs: Mapping[str, float]) -> Law:
        """The law of an arm with these ``inputs``."""
        return cls(**inputs)

    @classmethod
    def near(cls, other: Law, omega: float, stiff: float, viscous: float, place: float) -> Law:
        """A law ``stiff`` and ``viscous`` times ``other``, as that is at ``omega`` [rad/s]; ``place`` (0 to 1) among
        what else it has. Of the laws of :class:`forearm_fem.engines.parametric.Ranges`."""
        raise NotImplementedError

    def below(self, parameter: str) -> float:
        """Bound that a parameter must stay below while the others are kept."""
        return math.inf

    def stated(self, name: str) -> dict[str, Any]:
        """Keys of ``[tissues.override.T]`` for this law, which is called ``name``."""
        numbers = {f.name: getattr(self, f.name) for f in fields(self)}  # type: ignore[arg-type]
        own = {key: value for key, value in numbers.items() if key not in KEYS}
        keys = {key: value for key, value in numbers.items() if key not in own}
        return {"law": name, **keys, **({"parameters": own} if own else {})}


@dataclass(frozen=True)
class KelvinVoigt(Law):
    """Spring and dashpot in parallel: mu* = mu + i omega eta; loss grows without bound: fit in-band only."""

    name: ClassVar[str] = "kelvin-voigt"
    mu: float
    eta: float

    def at(self, omega: ArrayLike) -> ComplexArray:
        """mu*(omega) [Pa], of omega's shape; omega [rad/s]."""
        return np.asarray(self.mu + 1j * self.eta * np.asarray(omega, dtype=float))

    def taylor(self, omega0: float, n: int) -> ComplexArray:
        """Coefficients (n + 1,) about ``omega0`` [rad/s]: mu*(omega0), i eta, 0, ..."""
        return np.array([self.mu + 1j * omega0 * self.eta, 1j * self.eta, *[0] * n], dtype=complex)[: n + 1]

    @classmethod
    def near(cls, other: Law, omega: float, stiff: float, viscous: float, _: float) -> KelvinVoigt:
        """See :class:`Law`."""
        modulus = complex(other.at(omega))
        return cls(getattr(other, "mu", modulus.real) * stiff, modulus.imag / omega * viscous)


@dataclass(frozen=True)
class SpringPot(Law):
    """Fractional element mu* = mu^(1-a) (i omega eta)^a with 0 < a < 1: constant loss angle a pi/2.

    Klatt 2010 gives mu and a for eta = 1 Pa s (physics_data.md 1.2). Zero and not smooth at omega = 0.
    """

    name: ClassVar[str] = "springpot"
    mu: float
    exponent: float
    eta: float = 1.0

    @property
    def problem(self) -> str:
        """Reason that the parameters cannot be; empty where they can."""
        return "eta: a springpot without viscosity has no stiffness either; set eta > 0 Pa s" if self.eta == 0 else ""

    def at(self, omega: ArrayLike) -> ComplexArray:
        """mu*(omega) [Pa], of omega's shape; omega [rad/s]."""
        return np.asarray(
            self.mu ** (1 - self.exponent) * (1j * self.eta * np.asarray(omega, dtype=float)) ** self.exponent
        )

    def taylor(self, omega0: float, n: int) -> ComplexArray:
        """Coefficients (n + 1,): mu*(omega0) binom(a, k) / omega0^k; converges for |d| < |omega0|."""
        if omega0 == 0:
            raise ValueError("a springpot has no Taylor series at 0 rad/s; expand about a positive frequency")
        from scipy.special import binom  # here: help on commands knows the laws' names, and loads nothing heavy

        k = np.arange(n + 1)
        return np.asarray(self.at(omega0) * binom(self.exponent, k) / float(omega0) ** k)

    @classmethod
    def of_inputs(cls, inputs: Mapping[str, float]) -> SpringPot:
        """From its size |mu*| [Pa] at 150 Hz, and its exponent."""
        exponent = inputs["exponent"]
        size = inputs["size"] / (2 * math.pi * REFERENCE) ** exponent
        return cls(size ** (1 / (1 - exponent)), exponent)

    @classmethod
    def near(cls, other: Law, omega: float, stiff: float, _: float, place: float) -> SpringPot:
        """See :class:`Law`; ``place`` among exponents."""
        exponent = float(np.interp(place, [0, 1], (0.15, 0.45)))
        size = (abs(complex(other.at(omega))) * stiff / omega**exponent) ** (1 / (1 - exponent))
        return cls(float(size), exponent)


@dataclass(frozen=True)
class Zener(Law):
    """Standard linear solid: mu* = mu + i omega eta / (1 + i omega tau), tau = eta / (mu_infinity - mu) [s].

    A spring mu beside a spring (mu_infinity - mu) in series with a dashpot eta; bounded at high frequency.
    """

    name: ClassVar[str] = "zener"
    mu: float
    mu_infinity: float
    eta: float

    @property
    def problem(self) -> str:
        """Reason that the parameters cannot be; empty where they can."""
        can = self.mu_infinity > self.mu
        return "" if can else f"mu_infinity: must exceed mu = {self.mu:g} Pa, is {self.mu_infinity:g}"

    @property
    def relaxation_time(self) -> float:
        """tau [s]."""
        return self.eta / (self.mu_infinity - self.mu)

    def at(self, omega: ArrayLike) -> ComplexArray:
        """mu*(omega) [Pa], of omega's shape; omega [rad/s]."""
        s = 1j * np.asarray(omega, dtype=float)
        return np.asarray(self.mu + s * self.eta / (1 + s * self.relaxation_time))

    def taylor(self, omega0: float, n: int) -> ComplexArray:
        """Coefficients (n + 1,) of mu_infinity - (mu_infinity - mu) / (1 + i omega tau), geometric."""
        pole = 1 + 1j * omega0 * self.relaxation_time
        k = np.arange(n + 1)
        series = -(self.mu_infinity - self.mu) / pole * (-1j * self.relaxation_time / pole) ** k
        return np.asarray(np.where(k == 0, self.mu_infinity + series, series))

    @classmethod
    def of_inputs(cls, inputs: Mapping[str, float]) -> Zener:
        """From mu [Pa], its stiffening mu_infinity/mu - 1 and its relaxation 1/(2 pi tau) [Hz]."""
        mu, rise = inputs["mu"], inputs["mu"] * inputs["stiffening"]
        return cls(mu, mu + rise, rise / (2 * math.pi * inputs["relaxation"]))

    def below(self, parameter: str) -> float:
        """See :class:`Law`: mu stays below mu_infinity."""
        return 0.999 * self.mu_infinity if parameter == "mu" else math.inf

    @classmethod
    def near(cls, other: Law, omega: float, stiff: float, viscous: float, place: float) -> Zener:
        """See :class:`Law`; ``place`` among ratios of mu_infinity to mu."""
        soft, (low, high) = KelvinVoigt.near(other, omega, stiff, viscous, place), (1.3, 4.0)
        return cls(soft.mu, soft.mu * low * (high / low) ** place, soft.eta)


@dataclass(frozen=True)
class Hysteretic(Law):
    """Constant loss factor: mu* = mu (1 + i loss sign(omega)); used for bone."""

    name: ClassVar[str] = "hysteretic"
    mu: float
    loss: float

    def at(self, omega: ArrayLike) -> ComplexArray:
        """mu*(omega) [Pa], of omega's shape; omega [rad/s]."""
        return np.asarray(self.mu * (1 + 1j * self.loss * np.sign(np.asarray(omega, dtype=float))))

    def taylor(self, omega0: float, n: int) -> ComplexArray:
        """Coefficients (n + 1,): mu*(omega0), then zeros."""
        return np.array([self.at(omega0), *[0] * n], dtype=complex)


LAWS: Mapping[str, type[Law]] = MappingProxyType({law.name: law for law in Law.__subclasses__()})


def law(model: str) -> type[Law]:
    """The class of the law ``model``: one of :data:`LAWS`, or the user's own by ``module:Name``.

    ScenarioError where it is no dataclass that inherits from :class:`Law`.
    """
    if model in LAWS:
        return LAWS[model]
    found = named(model, "tissues.override: law")
    if not is_dataclass(found) or not isinstance(found, type) or not issubclass(found, Law):
        raise ScenarioError(f"tissues.override: {model} is no law; write a frozen dataclass that inherits from Law")
    return found


@dataclass(frozen=True)
class Tissue:
    """A tissue: density [kg/m^3], shear modulus, bulk modulus [Pa] (inf = incompressible).

    ``fibres`` is the ratio of shear stiffness along the limb to across, storage and loss alike: the shears xy and xz
    have mu* sqrt(fibres), all else has mu* / sqrt(fibres); 1 = none. Wave properties are for omega > 0.
    """

    name: str
    density: float
    modulus: Law
    bulk: float = math.inf
    fibres: float = 1.0

    @property
    def incompressible(self) -> bool:
        """True if the bulk modulus is infinite."""
        return math.isinf(self.bulk)

    def wavenumber(self, omega: ArrayLike) -> ComplexArray:
        """Shear wavenumber k = omega sqrt(rho / mu*) [1/m], Im k <= 0 (the wave is e^{i(omega t - k x)}); of the
        slowest wave where there are fibres."""
        w = np.asarray(omega, dtype=float)
        return np.asarray(w * np.sqrt(self.density / self.modulus.at(w)) * max(self.fibres, 1 / self.fibres) ** 0.25)

    def wave_speed(self, omega: ArrayLike) -> FloatArray:
        """Phase speed omega / Re k of a plane shear wave [m/s] (physics_data.md 8.1)."""
        return np.asarray(np.asarray(omega, dtype=float) / self.wavenumber(omega).real)

    def attenuation(self, omega: ArrayLike) -> FloatArray:
        """Decay -Im k of a plane shear wave [1/m] (physics_data.md 8.1)."""
        return np.asarray(-self.wavenumber(omega).imag)


@dataclass(frozen=True)
class Sourced:
    """A value with its plausible range, its spread and where it came from (SI).

    ``spread`` is the factor of a log-normal law: one standard deviation is x/÷ ``spread``; 1 = held.
    """

    value: float
    unit: str
    low: float
    high: float
    spread: float
    source: str

    def draw(self, z: float) -> float:
        """The value for a standard-normal deviate ``z``: value * spread^z (not clipped to the range)."""
        return float(self.value * self.spread**z)


@dataclass(frozen=True)
class TissueRecord:
    """One tissue of a preset: its model and its sourced parameters (density, mu, eta or loss, bulk)."""

    name: str
    model: str
    parameters: Mapping[str, Sourced]
    note: str = ""

    @property
    def values(self) -> dict[str, float]:
        """The bare numbers, SI."""
        return {key: p.value for key, p in self.parameters.items()}

    def tissue(self, values: Mapping[str, float] | None = None) -> Tissue:
        """The tissue, with ``values`` (drawn or chosen) in place of the recorded ones."""
        return tissue_of(self.name, self.model, {**self.values, **(values or {})})


def parameters_of(model: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names that a law must be given, and names that it may be given."""
    every = fields(law(model))  # type: ignore[arg-type]
    return tuple(f.name for f in every if f.default is MISSING), tuple(f.name for f in every)


def tissue_of(name: str, model: str, values: Mapping[str, float]) -> Tissue:
    """The tissue that these numbers (SI) describe; they must be complete for the model."""
    modulus = law(model)(**{key: values[key] for key in parameters_of(model)[1] if key in values})
    return Tissue(name, values["density"], modulus, values["bulk"], values.get("fibres", 1.0))


def _density(value: float, low: float, high: float, spread: float) -> Sourced:
    return Sourced(value, "kg/m^3", low, high, spread, "physics_data.md 9; range and spread: PMC3233242, 1.1")


def _soft(name: str, density: Sourced, mu: Sourced, eta: Sourced, note: str) -> TissueRecord:
    """A soft tissue; its bulk modulus matters only in being large (physics_data.md 2.4)."""
    bulk = Sourced(2.2e9, "Pa", 1e8, 3.1e9, 1.0, "physics_data.md 9 (rho c^2 of 1.1 gives 2.0-3.1 GPa)")
    parameters = {"density": density, "mu": mu, "eta": eta, "bulk": bulk}
    return TissueRecord(name, "kelvin-voigt", MappingProxyType(parameters), note)


def _bone() -> TissueRecord:
    """Cortical bone, E = 17 GPa, nu = 0.3: mu = E / 2(1 + nu), bulk = E / 3(1 - 2 nu)."""
    young, poisson = 17e9, 0.3
    source = "physics_data.md 9: E 17 GPa, nu 0.3 (recalled; irrelevant detail)"
    mu = young / (2 * (1 + poisson))
    bulk = young / (3 * (1 - 2 * poisson))
    parameters = {
        "density": Sourced(1860.0, "kg/m^3", 1800.0, 2200.0, 1.05, "physics_data.md 1.1, measured 1862+-101"),
        "mu": Sourced(mu, "Pa", 0.65 * mu, 1.06 * mu, 1.2, source),
        "loss": Sourced(0.02, "-", 0.01, 0.03, 1.5, "physics_data.md 1.1 (recalled)"),
        "bulk": Sourced(bulk, "Pa", 0.65 * bulk, 1.06 * bulk, 1.2, source),
    }
    return TissueRecord("bone", "hysteretic", MappingProxyType(parameters), "nearly rigid beside flesh")


_RHO: Mapping[str, Sourced] = MappingProxyType(
    {
        "skin": _density(1100.0, 1079.0, 1183.0, 1.05),
        "fat": _density(950.0, 912.0, 950.0, 1.02),
        "muscle": _density(1060.0, 1042.0, 1074.0, 1.02),
    }
)
# name -> plausible range of mu [Pa] and eta [Pa s]; physics_data.md 9
_RANGES: Mapping[str, tuple[float, float, float, float]] = MappingProxyType(
    {
        "skin": (8e3, 35e3, 2.0, 5.0),
        "fat": (0.8e3, 6e3, 0.5, 3.0),
        "muscle": (2.5e3, 20e3, 3.0, 8.0),
    }
)


def _layered(name: str, mu: float, eta: float, source: str, note: str) -> TissueRecord:
    """A layer with the ranges and spreads of physics_data.md 9 (mu x/÷ 1.8, eta x/÷ 1.6)."""
    low, high, eta_low, eta_high = _RANGES[name]
    shear = Sourced(mu, "Pa", low, high, 1.8, source)
    viscosity = Sourced(eta, "Pa s", eta_low, eta_high, 1.6, source)
    return _soft(name, _RHO[name], shear, viscosity, note)


def _zhang(name: str) -> TissueRecord:
    """Zhang et al. 2011, Med Eng Phys 33:31: one half-space for all soft tissue, mean +- SD of 30 people."""
    source = "Zhang et al. 2011, forearm, 7.86+-1.86 kPa and 5.03+-0.60 Pa s (physics_data.md 1.2)"
    density = Sourced(1050.0, "kg/m^3", 950.0, 1100.0, 1.02, "physics_data.md 8, the half-space computed there")
    mu = Sourced(7860.0, "Pa", 6000.0, 9720.0, 1.24, source)
    eta = Sourced(5.03, "Pa s", 4.43, 5.63, 1.12, source)
    return _soft(name, density, mu, eta, "homogeneous half-space (preset Z)")


def _fascia() -> TissueRecord:
    """Deep fascia as an isotropic layer, stiff beside flesh and soft beside tendon."""
    source = "physics_data.md 1.2: elastography in vivo 8-25 kPa, tensile tests across the fibres from 3 MPa (E)"
    mu = Sourced(120e3, "Pa", 15e3, 1e6, 3.4, source)
    eta = Sourced(24.0, "Pa s", 3.0, 200.0, 3.4, "judgement: a loss tangent of 0.19 at 150 Hz")
    return _soft("fascia", _density(1120.0, 1076.0, 1166.0, 1.04), mu, eta, "no layer of the default limb")


def _preset(*records: TissueRecord) -> Mapping[str, TissueRecord]:
    return MappingProxyType({r.name: r for r in (*records, _fascia(), _bone())})


_FITTED_UNITS: Mapping[str, str] = MappingProxyType({"mu": "Pa", "mu_infinity": "Pa", "eta": "Pa s", "exponent": "-"})


def _fitted(law: str) -> Mapping[str, TissueRecord]:
    """Preset of a law of bounded damping: tissue_laws.json, made by benchmarks/tissue_laws.py from data of skin, fat
    and muscle, of speeds and of stiffness, jointly; ranges and spreads hold people and the sources' disagreement."""
    account = json.loads(files("forearm_fem").joinpath("tissue_laws.json").read_text(encoding="utf-8"))["bare"][law]
    records = []
    for name, numbers in account["tissues"].items():
        data = "; ".join(d["source"].partition(":")[0] for d in account["data"] if d["tissue"] in (name, ""))
        source = f"physics_data.md 1.4, fitted jointly to: {data}"
        parameters = {key: Sourced(unit=_FITTED_UNITS[key], source=source, **found) for key, found in numbers.items()}
        soft = _soft(name, _RHO[name], parameters["mu"], parameters["eta"], "not fitted to the thesis")
        records.append(replace(soft, model=law, parameters=MappingProxyType({**soft.parameters, **parameters})))
    return _preset(*records)


_O = "physics_data.md 9, preset O"
_K = "physics_data.md 9, preset K (fitted to the thesis, appendix A, so that is no test of it)"

PRESETS: Mapping[str, Mapping[str, TissueRecord]] = MappingProxyType(
    {
        "default": _preset(
            _layered("skin", 13e3, 3.0, f"{_O}; dermis, OCE, Feng et al. 2022", "medium confidence"),
            _layered("fat", 5e3, 1.5, f"{_O}; OCE 5 kPa, but MRE 0.75 kPa", "low to medium confidence"),
            _layered("muscle", 10e3, 4.0, _O, "low to medium confidence"),
        ),
        "thesis": _preset(
            _layered("skin", 25e3, 3.0, _K, "1.3 mm thick in the match"),
            _layered("fat", 6e3, 2.0, _K, "2 mm thick in the match"),
            _layered("muscle", 15e3, 5.0, _K, ""),
        ),
        "zhang": _preset(_zhang("skin"), _zhang("fat"), _zhang("muscle")),
        "zener": _fitted("zener"),
        "springpot": _fitted("springpot"),
    }
)
