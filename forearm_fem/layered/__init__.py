"""Semi-analytic twin: exact response of a horizontally layered body to vertical disc loads on its surface."""

from .closed_forms import (
    boussinesq,
    inertial_near_field,
    kelvin_voigt_shear_wave,
    miller_pursey_kernel,
    rayleigh_wavenumber,
    rigid_disc,
    uniform_disc_centre,
    uniform_disc_mean,
)
from .kernel import Base, Layer, Surface, surface_kernel
from .response import Disc, LayeredResult, layered_compliance

__all__ = [
    "Base",
    "Disc",
    "Layer",
    "LayeredResult",
    "Surface",
    "boussinesq",
    "inertial_near_field",
    "kelvin_voigt_shear_wave",
    "layered_compliance",
    "miller_pursey_kernel",
    "rayleigh_wavenumber",
    "rigid_disc",
    "surface_kernel",
    "uniform_disc_centre",
    "uniform_disc_mean",
]
