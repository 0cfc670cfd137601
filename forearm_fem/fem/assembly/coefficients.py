"""Scalar coefficients of the affine operator: polynomials and tissue laws of frequency."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Protocol

import numpy as np

from ...geometry.limb.thickness import Stretch
from ...scenario.limb import FoamUnderside, Membrane, Patch, Supports
from ...tissue import Tissue
from ...typing import ComplexArray, FloatArray
from .thickness import factor, unmarked

# Scalar functions of frequency that multiply the operator's real matrices.


class Coefficient(Protocol):
    """theta(omega) and its Taylor coefficients; time dependence e^{+i omega t}."""

    def at(self, omega: FloatArray) -> ComplexArray:
        """Values (n,) at angular frequencies (n,) [rad/s]."""
        ...

    def taylor(self, omega0: float, n: int) -> ComplexArray:
        """Coefficients c_0 ... c_n of theta(omega0 + d) = sum_k c_k d^k."""
        ...


@dataclass(frozen=True)
class Polynomial:
    """theta = constant + i omega rate - omega^2 inertia: springs, dashpots and masses."""

    constant: float = 0.0
    rate: float = 0.0
    inertia: float = 0.0

    def at(self, omega: FloatArray) -> ComplexArray:
        """See :class:`Coefficient`."""
        w = np.asarray(omega, dtype=float)
        return self.constant + 1j * w * self.rate - w**2 * self.inertia

    def taylor(self, omega0: float, n: int) -> ComplexArray:
        """See :class:`Coefficient`."""
        terms = [complex(self.at(np.array(omega0))), 1j * self.rate - 2 * omega0 * self.inertia, -self.inertia]
        return np.array((terms + [0.0] * n)[: n + 1], dtype=complex)


@dataclass(frozen=True)
class Scaled:
    """theta = factor inner(omega)."""

    factor: float
    inner: Coefficient

    def at(self, omega: FloatArray) -> ComplexArray:
        """See :class:`Coefficient`."""
        return np.asarray(self.factor * self.inner.at(omega))

    def taylor(self, omega0: float, n: int) -> ComplexArray:
        """See :class:`Coefficient`."""
        return np.asarray(self.factor * self.inner.taylor(omega0, n))


@dataclass(frozen=True)
class Impedance:
    """theta = i omega sqrt(density mu*(omega)): shear waves of a ``modulus`` that leave through a plane."""

    density: float
    modulus: Coefficient

    def at(self, omega: FloatArray) -> ComplexArray:
        """See :class:`Coefficient`."""
        w = np.asarray(omega, dtype=float)
        return np.asarray(1j * w * np.sqrt(self.density * self.modulus.at(w)))

    def taylor(self, omega0: float, n: int) -> ComplexArray:
        """See :class:`Coefficient`; the root of a series, term by term."""
        squared, root = self.density * self.modulus.taylor(omega0, n), np.zeros(n + 1, dtype=complex)
        root[0] = np.sqrt(squared[0])
        for k in range(1, n + 1):
            root[k] = (squared[k] - root[1:k] @ root[1:k][::-1]) / (2 * root[0])
        return np.asarray(1j * (omega0 * root + np.concatenate([[0.0], root[:-1]])))


def is_polynomial(coefficient: Coefficient) -> bool:
    """True if it is a real polynomial in i omega of second degree at most (a hysteretic modulus is a complex one).

    Asked at 1 rad/s: at zero a springpot has no series, and a hysteretic modulus is real.
    """
    value, slope, curvature, rest = coefficient.taylor(1.0, 3)
    odd = (value - slope + curvature).imag, (slope - 2 * curvature).real, curvature.imag
    return not rest and bool(np.abs(odd).max() <= 1e-12 * abs(value))


def kelvin_voigt_like(coefficient: Coefficient, omega: float) -> Coefficient:
    """A spring and dashpot of the same size at ``omega`` [rad/s]; a polynomial as it is."""
    if is_polynomial(coefficient):
        return coefficient
    if isinstance(coefficient, Scaled):
        return Scaled(coefficient.factor, kelvin_voigt_like(coefficient.inner, omega))
    value = complex(coefficient.at(np.array(omega)))
    return Polynomial(max(value.real, 0.0), value.imag / omega)


def polynomial_weights(taylor: ComplexArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Weights (n,) of 1, i omega and -omega^2 from Taylor coefficients (n, 3) about zero."""
    return taylor[:, 0].real, (taylor[:, 1] / 1j).real, (-taylor[:, 2]).real


def polynomial_of(coefficient: Coefficient) -> tuple[float, float, float] | None:
    """Weights of 1, i omega and -omega^2 in one coefficient; None where it is no such polynomial."""
    if not is_polynomial(coefficient):
        return None
    constant, rate, inertia = polynomial_weights(coefficient.taylor(0.0, 2)[None])
    return float(constant[0]), float(rate[0]), float(inertia[0])


def rate_weights(coefficients: Sequence[Coefficient], rate: float) -> FloatArray:
    """Weights (3, n_term) of A_0, A_1 and A_2 in A(s) = A_0 + A_1 d + A_2 d^2 with s = ``rate`` (1 + d) for i omega.

    For Kelvin-Voigt moduli; at a real rate [1/s] all are real.
    """
    constant, slope, inertia = polynomial_weights(np.array([c.taylor(0.0, 2) for c in coefficients]))
    first, second = rate * slope, rate**2 * inertia
    return np.array([constant + first + second, first + 2 * second, second])


def grouped(coefficients: Sequence[Coefficient]) -> list[tuple[FloatArray, Coefficient]]:
    """Sums of terms, as few as A(omega) can be made of: weights (n_term,) and the coefficient of each sum.

    All polynomial terms together are a constant, i omega and -omega^2; each other term stays with its multiples.
    """
    alone = [not is_polynomial(c) for c in coefficients]
    about_zero = [np.zeros(3) if out else c.taylor(0.0, 2) for c, out in zip(coefficients, alone, strict=True)]
    units = (Polynomial(constant=1.0), Polynomial(rate=1.0), Polynomial(inertia=1.0))
    common = zip(polynomial_weights(np.array(about_zero)), units, strict=True)
    others = list[tuple[FloatArray, Coefficient]]()
    for k in np.flatnonzero(alone).tolist():
        scaled = coefficients[k]
        inner, share = (scaled.inner, scaled.factor) if isinstance(scaled, Scaled) else (scaled, 1.0)
        weights = next((w for w, c in others if c == inner), None)
        if weights is None:
            weights = np.zeros(len(alone))
            others.append((weights, inner))
        weights[k] = share
    return [(weights, c) for weights, c in common if weights.any()] + others


# Coefficients of the operator's terms, by name: the affine parameters of a model.

_ONE, _NO_PATCH = Polynomial(1.0), Patch()


def term_coefficient(
    name: str,
    tissues: Mapping[str, Tissue],
    supports: Supports,
    membrane: Membrane,
    patch: Patch = _NO_PATCH,
    stretches: Mapping[str, Stretch] = MappingProxyType({}),
) -> Coefficient:
    """theta(omega) of a term: "shear fat", "fibres fat", "mass fat", "dashpots fat", "foam", "skin tension" and others.

    Those of other thicknesses (:mod:`forearm_fem.fem.assembly.thickness`) take the ``stretches`` of tissues, by
    default none. Raises KeyError for a name that no term has.
    """
    name, powers = unmarked(name)
    if powers is not None:
        share = factor(powers, stretches.get(name.partition(" ")[2], Stretch()))
        # nothing of a springpot is a polynomial, which it has no series at zero for
        return Scaled(share, term_coefficient(name, tissues, supports, membrane, patch)) if share else Polynomial()
    whole: dict[str, Coefficient] = {
        "skin mass": Polynomial(inertia=membrane.mass),
        "skin tension": Polynomial(membrane.tension),
        "skin membrane": Polynomial(membrane.stiffness, membrane.viscosity),
        "patch mass": Polynomial(inertia=patch.mass),
        "patch membrane": Polynomial(patch.stiffness, patch.viscosity),
        "patch bending": Polynomial(patch.bending),
        "incompressibility": _ONE,
        "compression": _ONE,
    }
    if isinstance(supports, FoamUnderside):
        whole["foam"] = Polynomial(supports.foam_stiffness, supports.foam_damping)
    if name in whole:
        return whole[name]
    kind, _, of = name.partition(" ")
    return _of_tissue(kind, tissues[of])


def _of_tissue(kind: str, tissue: Tissue) -> Coefficient:
    if kind == "shear":
        return tissue.modulus if tissue.fibres == 1 else Scaled(tissue.fibres**-0.5, tissue.modulus)
    if kind == "fibres":
        share = tissue.fibres**0.5 - tissue.fibres**-0.5
        return Scaled(share, tissue.modulus) if share else Polynomial()
    if kind in ("incompressibility", "compression"):
        return _ONE
    return {"mass": Polynomial(inertia=tissue.density), "dashpots": _dashpots(tissue)}[kind]


def _dashpots(tissue: Tissue) -> Coefficient:
    """i omega rho c_s (Lysmer and Kuhlemeyer 1969): of the static modulus where it is Kelvin-Voigt, which keeps A a
    polynomial; else sqrt(rho mu*(omega)), as a springpot has no static modulus. Of the mean modulus where there are
    fibres."""
    if is_polynomial(tissue.modulus):
        return Polynomial(rate=float(np.sqrt(tissue.density * np.abs(tissue.modulus.at(np.array([0.0]))[0]))))
    return Impedance(tissue.density, tissue.modulus)
