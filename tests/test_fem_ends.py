"""Absorbing ends of tissues that are not Kelvin-Voigt: the impedance of shear waves at the frequency itself."""

from __future__ import annotations

import numpy as np
import pytest

from forearm_fem.fem.assembly.coefficients import Impedance, Polynomial, term_coefficient
from forearm_fem.fem.reduction.sweep import direct_sweep
from forearm_fem.scenario.limb import FreeUnderside, Membrane
from forearm_fem.tissue import Hysteretic, SpringPot, Tissue, Zener
from forearm_fem.verification.scenes import (
    DIRECT,
    flesh,
    held_block,
    layered_truth,
    quarter_slab,
    slab_model,
    slab_response,
)

MODULI = [SpringPot(2680.0, 0.253), Zener(3e3, 9e3, 5.0), Hysteretic(8e3, 0.1)]


@pytest.mark.parametrize("modulus", MODULI)
def test_impedance_is_that_of_a_shear_wave(modulus):
    """mu du/dx = -i omega rho c u for a wave e^(-ikx): both moduli of the half-space's are in the coefficient."""
    omega = 2 * np.pi * np.array([30.0, 300.0])
    wave_number = omega * np.sqrt(1050.0 / modulus.at(omega))
    assert Impedance(1050.0, modulus).at(omega) == pytest.approx(1j * wave_number * modulus.at(omega), rel=1e-12)


@pytest.mark.parametrize("modulus", MODULI)
def test_impedance_has_the_series_of_its_values(modulus):
    """At 2 % of detuning with six coefficients: the remainder is 0.02^7 of a function that is smooth over its omega."""
    theta, omega = Impedance(1050.0, modulus), 2 * np.pi * 120.0
    d = 0.02 * omega
    series = np.sum(theta.taylor(omega, 6) * d ** np.arange(7))
    assert series == pytest.approx(complex(theta.at(np.array(omega + d))), rel=1e-10)


def test_kelvin_voigt_keeps_its_real_rate():
    """A polynomial, which the derivatives about one rate need."""
    theta = term_coefficient("dashpots block", {"block": flesh()}, FreeUnderside(), Membrane())
    assert theta == Polynomial(rate=float(np.sqrt(1050.0 * 7860.0)))


@pytest.mark.parametrize("modulus", MODULI)
def test_ends_of_every_law_absorb(modulus):
    """Freed ends change the answer, or what they send back would be estimated as nothing."""
    tissue = Tissue("block", 1050.0, modulus, 2.2e9)
    band = np.array([100.0])
    absorbed, free = (
        direct_sweep(held_block(2, tissue=tissue, ends=e), band, DIRECT).values for e in ("absorb", "free")
    )
    to_points = np.s_[0, 1:, 0]
    assert np.abs(absorbed - free)[to_points].max() > 0.1 * np.abs(free)[to_points].max()


def test_absorbing_ends_of_a_springpot_slab_are_nearer_to_the_endless_one():
    """At 60 Hz to the layered model: .006 with ends that absorb, .022 with free ones (the mesh leaves .006)."""
    law = {"muscle": {"law": "springpot", "mu": 3000.0, "eta": 1.0, "exponent": 0.3}}
    error = {}
    for ends in ("absorb", "free"):
        scene = quarter_slab(
            (0.008, 0.014),
            side=0.05,
            depth=0.03,
            frequencies=(60.0,),
            ends=ends,
            override=law,
            mesh={"size_grid": 0.004},
        )
        exact = layered_truth(scene, (60.0,))
        error[ends] = np.abs(slab_response(slab_model(scene), (60.0,)) - exact).max() / np.abs(exact).max()
    assert error["absorb"] < 0.5 * error["free"]
    assert error["absorb"] < 0.01
