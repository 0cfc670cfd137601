"""Tissue laws: complex shear moduli mu*(omega), a small class each, which says all that is known of the law.

Time dependence e^{+i omega t}, so a passive tissue has Im mu*(omega) >= 0 for omega > 0 and
mu*(-omega) = conj mu*(omega).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from .errors import ScenarioError
from .typing import ComplexArray
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
