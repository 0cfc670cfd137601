"""The layered kernel against closed forms and 60-digit references."""

import json
import math
import pathlib

import numpy as np
import pytest

from forearm_fem.layered import (
    Layer,
    Surface,
    kelvin_voigt_shear_wave,
    miller_pursey_kernel,
    rayleigh_wavenumber,
    surface_kernel,
)

REFERENCE = json.loads((pathlib.Path(__file__).parent / "data" / "layered_kernel.json").read_text())
OMEGA = 2 * np.pi * np.array([0.5, 10.0, 100.0, 500.0])[:, None]
K = np.logspace(-3, 6, 451)[None]


def voigt(mu, eta):
    return lambda omega: mu + 1j * omega * eta


def homogeneous(thicknesses, bulk, mu=7860.0, eta=5.03, rho=1050.0):
    return [Layer(h, rho, voigt(mu, eta), bulk) for h in (*thicknesses, math.inf)]


@pytest.mark.parametrize("bulk", [1e4, 2.2e9, math.inf])
@pytest.mark.parametrize(
    "thicknesses", [(), (1e-6,), (8e-5, 1e-3, 3e-3), (1e-4,) * 30, (1.0, 10.0)], ids=lambda t: f"{len(t)}"
)
def test_fake_layers_are_invisible(thicknesses, bulk):
    """k h from 1e-9 to 1e7; 1e-12 leaves 30 layers times some tens of roundings."""
    exact = miller_pursey_kernel(K, OMEGA, 7860 + 5.03j * OMEGA, 1050.0, bulk)
    u = surface_kernel(K, OMEGA, homogeneous(thicknesses, bulk))
    assert np.max(np.abs(u / exact - 1)) < 1e-12


def test_miller_pursey_equals_its_textbook_form():
    """R = (2k^2 - ks^2)^2 - 4k^2 p q loses (k/ks)^2 digits: held where k < 10 ks, to 1e-12."""
    omega, mu, rho = 2 * np.pi * 200.0, 7860 + 5.03j * 2 * np.pi * 200.0, 1050.0
    k = np.linspace(0.5, 5000.0, 400)
    kp2, ks2 = rho * omega**2 / (2.2e9 + 4 * mu / 3), rho * omega**2 / mu
    p, q = np.sqrt(k**2 - kp2), np.sqrt(k**2 - ks2)
    textbook = -ks2 * p / (mu * ((2 * k**2 - ks2) ** 2 - 4 * k**2 * p * q))
    assert np.allclose(miller_pursey_kernel(k, omega, mu, rho, 2.2e9), textbook, rtol=1e-12)


@pytest.mark.parametrize("case", REFERENCE["cases"], ids=lambda case: case["name"])
def test_matches_sixty_digits(case):
    """Held to 1e-12; on a rigid base thin against 1/k the stiffness ~ 1/(kH)^3 costs that many digits."""
    layers = [
        Layer(math.inf if h is None else h, rho, voigt(mu, eta), math.inf if bulk is None else bulk)
        for h, rho, mu, eta, bulk in case["layers"]
    ]
    omega = 2 * np.pi * np.array(REFERENCE["frequency_hz"])[:, None]
    k = np.array(REFERENCE["wavenumber_1_per_m"])[None]
    exact = np.array(case["real"]) + 1j * np.array(case["imag"])
    u = surface_kernel(k, omega, layers, case["base"])
    depth = sum(layer.thickness_m for layer in layers)
    allowed = 1e-12 + (1e-15 / np.minimum(1, k * depth) ** 3 if case["base"] == "rigid" else 0)
    assert np.all(np.abs(u / exact - 1) < allowed)


def test_loads_of_wavelength_far_below_the_layer_see_only_it():
    """k h = 1e4: the exponentials are zero, nothing overflows, and the top layer's half-space remains."""
    fat, film = Layer(math.inf, 950.0, voigt(5e3, 1.5), 2.2e9), Layer(1e-3, 1100.0, voigt(1e6, 20.0), 2.2e9)
    k, omega = np.array([1e7]), np.array([300.0])
    alone = surface_kernel(k, omega, [Layer(math.inf, 1100.0, film.modulus, 2.2e9)])
    assert np.allclose(surface_kernel(k, omega, [film, fat]), alone, rtol=1e-13)
    assert np.allclose(surface_kernel(k, omega, [film], "rigid"), alone, rtol=1e-13)


def test_incompressible_is_the_limit_of_bulk_modulus():
    """The change is first order in mu/K: about 1e-3 .. 1e-9 for K = 1e7 .. 1e13 at k >> k_p."""
    k, omega = np.logspace(1, 5, 60), np.array(2 * np.pi * 200.0)
    limit = surface_kernel(k, omega, homogeneous((1e-3,), math.inf))
    gaps = [
        np.max(np.abs(surface_kernel(k, omega, homogeneous((1e-3,), bulk)) / limit - 1)) for bulk in (1e9, 1e11, 1e13)
    ]
    assert gaps[0] < 1e-2
    assert np.allclose(np.array(gaps[1:]) / gaps[:-1], 1e-2, rtol=0.1)


def test_rigid_base_far_below_is_a_half_space():
    """exp(-2 k H) with k H >= 15 leaves 1e-12 (and k^2 H^2 before it)."""
    k, omega = np.linspace(20.0, 400.0, 50), np.array(2 * np.pi * 100.0)
    deep = surface_kernel(k, omega, [Layer(1.0, 1050.0, voigt(7860.0, 5.03), 2.2e9)], "rigid")
    assert np.allclose(deep, surface_kernel(k, omega, homogeneous((), 2.2e9)), rtol=1e-9)


def test_dissipation_has_the_right_sign():
    """Im U < 0 at every real k: a pressure does work on a lossy body."""
    layers = [Layer(8e-5, 1100.0, voigt(350e3, 20.0), 2.2e9), *homogeneous((), 2.2e9)]
    assert np.all(surface_kernel(K, OMEGA, layers).imag < 0)


def test_surface_terms_add_to_the_normal_stiffness():
    """Incompressible statics: Y12 -> 0, so tension adds T k^2 and mass -m w^2 to 2 mu k exactly."""
    k, omega = np.array([100.0, 1e3]), np.array(1e-3)
    layers = homogeneous((), math.inf, eta=0.0)
    stiffness = 1 / surface_kernel(k, omega, layers, surface=Surface(tension=50.0, membrane=1e4, mass=0.3))
    assert np.allclose(stiffness, 2 * 7860.0 * k + 50.0 * k**2 - 0.3e-6, rtol=1e-8)


def test_stiff_film_bends_like_a_plate():
    """80 um of 1 MPa on fat, statically: D k^4 + 2 mu k, D = mu h^3/3 (nu = 1/2) when the film may slide; the
    film also stretches no fibre, hence bonded and sliding differ by less than mu_fat/mu_film * few."""
    film, fat = (
        Layer(8e-5, 1100.0, voigt(1e6, 0.0), math.inf),
        Layer(math.inf, 950.0, voigt(5e3, 0.0), math.inf),
    )
    k = np.array([200.0, 1000.0])
    stiffness = 1 / surface_kernel(k, np.array(1e-2), [film, fat])
    plate = 1e6 * (8e-5) ** 3 / 3 * k**4 + 2 * 5e3 * k
    # k h = 0.08: thickness corrections of order k h; at k h = 0.016 they are a sixth of that
    assert np.abs(stiffness[0] / plate[0] - 1) < 0.03
    assert np.abs(stiffness[1] / plate[1] - 1) < 0.1


def test_rayleigh_root_is_a_pole():
    """The kernel grows like 1/|k - k_R|; 1e-9 away it exceeds its static value at least 1e7 times."""
    omega = np.array(2 * np.pi * 200.0)
    mu = 7860 + 5.03j * omega
    root = rayleigh_wavenumber(omega, mu, 1050.0)
    u = miller_pursey_kernel(root * (1 + 1e-9), omega, mu, 1050.0, math.inf)
    assert np.abs(u * 2 * mu * root) > 1e7
    assert root.real == pytest.approx(2 * np.pi * 200 / 3.14, rel=2e-3)  # physics_data.md 2.2, three digits
    assert -root.imag == pytest.approx(141, rel=5e-3)


def test_shear_wave_is_the_square_root_of_the_modulus():
    """Two forms of one identity, to rounding, from nearly elastic to nearly viscous."""
    omega = 2 * np.pi * np.logspace(-2, 5, 30)
    speed, decay = kelvin_voigt_shear_wave(omega, 7860.0, 5.03, 1050.0)
    ks = omega * np.sqrt(1050.0 / (7860.0 + 5.03j * omega))
    assert np.allclose(omega / speed, ks.real, rtol=1e-12)
    assert np.allclose(decay, -ks.imag, rtol=1e-9)  # ks.imag itself loses digits at small loss


@pytest.mark.parametrize(
    ("layers", "base"),
    [
        ([], "halfspace"),
        ([Layer(1e-3, 1e3, voigt(1.0, 0.0))], "halfspace"),
        ([Layer(math.inf, 1e3, voigt(1.0, 0.0))], "rigid"),
        ([Layer(-1.0, 1e3, voigt(1.0, 0.0)), Layer(math.inf, 1e3, voigt(1.0, 0.0))], "halfspace"),
        ([Layer(math.inf, 0.0, voigt(1.0, 0.0))], "halfspace"),
    ],
)
def test_impossible_layers_are_refused(layers, base):
    with pytest.raises(ValueError, match=r"expected|thickness|positive"):
        surface_kernel(np.array([1.0]), np.array(1.0), layers, base)
