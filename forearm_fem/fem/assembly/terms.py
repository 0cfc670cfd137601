"""What each term of the operator is multiplied with, by its name: the affine parameters of a model."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ...scenario.elements import FoamUnderside, Supports
from ...scenario.tissues import Membrane, Patch
from ...tissue import Tissue
from .coefficients import Coefficient, Impedance, Polynomial, is_polynomial

_ONE, _NO_PATCH = Polynomial(1.0), Patch()


def term_coefficient(
    name: str, tissues: Mapping[str, Tissue], supports: Supports, membrane: Membrane, patch: Patch = _NO_PATCH
) -> Coefficient:
    """theta(omega) of a term: "shear fat", "mass fat", "dashpots fat", "foam", "skin tension" and the like.

    Raises KeyError for a name that no term has.
    """
    whole: dict[str, Coefficient] = {
        "skin mass": Polynomial(inertia=membrane.mass),
        "skin tension": Polynomial(membrane.tension),
        "skin membrane": Polynomial(membrane.stiffness, membrane.viscosity),
        "patch mass": Polynomial(inertia=patch.mass),
        "patch membrane": Polynomial(patch.stiffness, patch.viscosity),
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
        return tissue.modulus
    return {"mass": Polynomial(inertia=tissue.density), "dashpots": _dashpots(tissue)}[kind]


def _dashpots(tissue: Tissue) -> Coefficient:
    """i omega rho c_s (Lysmer and Kuhlemeyer 1969): of the static modulus where it is Kelvin-Voigt, which keeps A a
    polynomial; else sqrt(rho mu*(omega)), as a springpot has no static modulus."""
    if is_polynomial(tissue.modulus):
        return Polynomial(rate=float(np.sqrt(tissue.density * np.abs(tissue.modulus.at(np.array([0.0]))[0]))))
    return Impedance(tissue.density, tissue.modulus)
