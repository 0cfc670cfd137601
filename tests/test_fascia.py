"""The deep fascia: a thin stiff layer on both engines, against a sheet's limit and against none."""

from __future__ import annotations

import math

import numpy as np
import pytest

from forearm_fem.layered import Disc, Layer, Surface, layered_compliance, surface_kernel
from forearm_fem.tissue import KelvinVoigt
from forearm_fem.verification.scenes import layered_truth, quarter_slab, slab_model, slab_response

BULK = 2.2e9
SKIN, FAT, MUSCLE = KelvinVoigt(13e3, 3.0), KelvinVoigt(5e3, 1.5), KelvinVoigt(10e3, 4.0)
OMEGA = 2 * np.pi * np.array([60.0, 200.0, 450.0])
K = np.geomspace(20.0, 900.0, 9)[:, None]


def arm(*fascia: Layer) -> list[Layer]:
    """Skin, fat, what is between, and muscle."""
    above = [Layer(1.2e-3, 1100.0, SKIN.at, BULK), Layer(3e-3, 950.0, FAT.at, BULK)]
    return [*above, *fascia, Layer(math.inf, 1060.0, MUSCLE.at, BULK)]


def test_a_fascia_of_muscle_is_none():
    """Exact, so rounding is all that is left: 1e-9 of the largest."""
    disc, points = Disc(0.0, 0.0, 3.5e-3), [Disc(0.0, 0.0, 3.5e-3), Disc(0.0133, 0.0), Disc(0.03, 0.0)]
    two = [layered_compliance(arm(*f), OMEGA, [disc], points, tolerance=1e-9).values
           for f in ((), (Layer(0.7e-3, 1060.0, MUSCLE.at, BULK),))]  # fmt: skip
    assert np.abs(two[0] - two[1]).max() < 1e-8 * np.abs(two[0]).max()  # both integrals to 1e-9


def test_a_thin_stiff_layer_is_a_sheet():
    """On the skin: in-plane 4 mu h and mass rho h of a sheet; bending, (k h)^2 / 3 of it, and the layer's own
    thickness are what is left, which fall with h."""
    missed = []
    for h in (20e-6, 10e-6):
        stiff, mass = KelvinVoigt(100.0 / h, 0.02 / h), 1100.0 * h
        layered = surface_kernel(K, OMEGA, [Layer(h, 1100.0, stiff.at, BULK), *arm()])
        sheet = surface_kernel(K, OMEGA, arm(), surface=Surface(membrane=400.0, viscosity=0.08, mass=mass))
        missed.append(np.abs(layered / sheet - 1).max())
    assert missed[1] < 0.01
    assert missed[1] < 0.6 * missed[0]


def test_within_the_arm_its_product_of_modulus_and_thickness_counts():
    """70 N/m between fat and muscle: 0.35 and 0.7 mm differ by what the thickness itself does; less than the tenth that
    no fascia at all differs by at every wavenumber where it matters."""
    def seen(h: float) -> np.ndarray:
        """Kernel with a fascia of 70 N/m that takes its room from the muscle."""
        return surface_kernel(K, OMEGA, arm(Layer(h, 1120.0, KelvinVoigt(70.0 / h, 0.014 / h).at, BULK)))

    none, thin, thick = surface_kernel(K, OMEGA, arm()), seen(0.35e-3), seen(0.7e-3)
    assert np.abs(thick / none - 1).max() > 0.3
    assert np.abs(thin - thick).max() < 0.25 * np.abs(thick - none).max()


@pytest.mark.slow
def test_finite_elements_meet_the_layered_model_with_a_fascia_of_07_mm():
    """One layer of elements through it, 120 kPa: as a slab without one, within 1 % under the disc and 2 % at points."""
    scene = quarter_slab(
        (0.010, 0.020), side=0.10, depth=0.045, preset="default", frequencies=(200.0,),
        layers=(("skin", 1.2e-3), ("fat", 3.0e-3), ("fascia", 0.7e-3)),
        mesh={"size_grid": 1.6e-3, "size_contact": 1.1e-3, "size_far": 7e-3, "element": "P2", "grading": 0.3},
    )  # fmt: skip
    found, truth = slab_response(slab_model(scene), [200.0])[0], layered_truth(scene, [200.0])[0]
    assert abs(found[0] / truth[0] - 1) < 0.01
    assert np.abs(found - truth)[1:].max() < 0.02 * np.abs(truth[1:]).max()
