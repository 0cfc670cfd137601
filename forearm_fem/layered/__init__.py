"""Semi-analytic layered model: exact response of a horizontally layered body to contacts on its surface."""

from .closed_forms import (
    bonded_disc,
    boussinesq,
    inertial_near_field,
    kelvin_voigt_shear_wave,
    miller_pursey_kernel,
    rayleigh_wavenumber,
    rigid_disc,
    uniform_disc_centre,
    uniform_disc_mean,
)
from .discs import Disc
from .kernel import Base, Layer, Surface, SurfaceCompliance, surface_compliance, surface_kernel
from .response import LayeredResult, layered_compliance
from .tape import Sheet

__all__ = [
    "Base",
    "Disc",
    "Layer",
    "LayeredResult",
    "Sheet",
    "Surface",
    "SurfaceCompliance",
    "bonded_disc",
    "boussinesq",
    "inertial_near_field",
    "kelvin_voigt_shear_wave",
    "layered_compliance",
    "miller_pursey_kernel",
    "rayleigh_wavenumber",
    "rigid_disc",
    "surface_compliance",
    "surface_kernel",
    "uniform_disc_centre",
    "uniform_disc_mean",
]
