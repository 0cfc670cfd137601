"""Moduli: closed forms, Taylor series, dissipation; tissues: presets, overrides and their errors."""

import math

import numpy as np
import pytest

from forearm_fem.errors import ScenarioError
from forearm_fem.scenario import parse_scenario
from forearm_fem.scenario.model import resolve_tissues
from forearm_fem.tissue import PRESETS, Hysteretic, KelvinVoigt, Law, SpringPot, Tissue, Zener

MODULI = [
    KelvinVoigt(13e3, 3.0),
    SpringPot(2680.0, 0.253),
    Zener(5e3, 40e3, 8.0),
    Hysteretic(6.5e9, 0.02),
]
OMEGA = 2 * np.pi * np.array([10.0, 50.0, 200.0, 500.0])


@pytest.mark.parametrize("modulus", MODULI)
def test_passive_and_hermitian(modulus: Law) -> None:
    values = modulus.at(OMEGA)
    assert np.all(values.imag >= 0)  # e^{+i omega t}: dissipation
    assert np.array_equal(modulus.at(-OMEGA), values.conj())
    assert values.shape == OMEGA.shape
    assert values.dtype == complex


@pytest.mark.parametrize("modulus", MODULI)
def test_taylor_sums_to_the_modulus_nearby(modulus: Law) -> None:
    omega0, order = 2 * np.pi * 200.0, 40
    coefficients = modulus.taylor(omega0, order)
    assert coefficients.shape == (order + 1,)
    d = 0.3 * omega0 * np.array([-1.0, -0.5, 0.5, 1.0])
    series = np.polynomial.polynomial.polyval(d, coefficients)
    # 0.3^41 = 4e-22: truncation is nil for every model here, rounding is left
    np.testing.assert_allclose(series, modulus.at(omega0 + d), rtol=1e-13)


@pytest.mark.parametrize("modulus", MODULI)
def test_taylor_matches_central_differences(modulus: Law) -> None:
    omega0, h = 900.0, 1.0
    plus, here, minus = modulus.at(np.array([omega0 + h, omega0, omega0 - h]))
    c = modulus.taylor(omega0, 2)
    assert c[0] == pytest.approx(here, rel=1e-15)
    # differences err by h^2 / omega0^2 ~ 1e-6 of the next term and by rounding
    assert abs(c[1] - (plus - minus) / (2 * h)) < 1e-5 * abs(c[1]) + 1e-12 * abs(here)
    assert abs(c[2] - (plus - 2 * here + minus) / (2 * h**2)) < 1e-5 * abs(c[2]) + 1e-14 * abs(here)


@pytest.mark.parametrize("n", [0, 1, 5])
@pytest.mark.parametrize("modulus", MODULI)
def test_taylor_has_n_plus_one_terms(modulus: Law, n: int) -> None:
    assert modulus.taylor(700.0, n).shape == (n + 1,)


def test_springpot_refuses_expansion_at_zero() -> None:
    with pytest.raises(ValueError, match="0 rad/s"):
        SpringPot(1e3, 0.3).taylor(0.0, 2)


def test_springpot_reproduces_klatt() -> None:
    # physics_data.md 1.2: |G*|(50 Hz) = 1.56 kPa for mu 2.68 kPa, alpha 0.253, eta 1 Pa s
    assert abs(SpringPot(2680.0, 0.253).at(2 * np.pi * 50)) == pytest.approx(1560, rel=5e-3)


def test_zener_limits() -> None:
    zener = Zener(5e3, 40e3, 8.0)
    assert zener.at(0.0) == 5e3
    assert zener.at(1e12) == pytest.approx(40e3, rel=1e-6)
    low = zener.at(1e-3)  # a Kelvin-Voigt solid of the same eta at low frequency
    assert low.imag == pytest.approx(8.0e-3, rel=1e-6)


def test_kelvin_voigt_wave_closed_form() -> None:
    mu, eta, rho = 7860.0, 5.03, 1050.0
    tissue = Tissue("z", rho, KelvinVoigt(mu, eta))
    m = np.hypot(mu, OMEGA * eta)
    speed = np.sqrt(2 * m**2 / (rho * (mu + m)))  # physics_data.md 8.1
    decay = np.sqrt(rho * OMEGA**2 * (m - mu) / (2 * m**2))
    np.testing.assert_allclose(tissue.wave_speed(OMEGA), speed, rtol=1e-14)
    np.testing.assert_allclose(tissue.attenuation(OMEGA), decay, rtol=1e-12)  # m - mu cancels at 10 Hz


def test_incompressible_is_the_default() -> None:
    assert Tissue("z", 1050.0, KelvinVoigt(1.0, 0.0)).incompressible


@pytest.mark.parametrize("preset", list(PRESETS))
def test_presets_are_sourced_within_range_and_immutable(preset: str) -> None:
    for record in PRESETS[preset].values():
        for p in record.parameters.values():
            assert p.source
            assert p.unit
            assert p.low <= p.value <= p.high
            assert p.draw(0.0) == p.value
            assert p.draw(1.0) / p.value == pytest.approx(p.spread)
    assert set(PRESETS[preset]) == {"skin", "fat", "fascia", "muscle", "bone"}
    with pytest.raises(TypeError):
        PRESETS[preset]["skin"] = None  # type: ignore[index]


def test_default_preset_values() -> None:
    tissues = resolve_tissues(parse_scenario({}))
    assert tissues["skin"] == Tissue("skin", 1100.0, KelvinVoigt(13e3, 3.0), 2.2e9)
    assert tissues["fat"] == Tissue("fat", 950.0, KelvinVoigt(5e3, 1.5), 2.2e9)
    assert tissues["muscle"] == Tissue("muscle", 1060.0, KelvinVoigt(10e3, 4.0), 2.2e9)
    bone = tissues["bone"].modulus.at(100.0)
    assert bone.real == pytest.approx(17e9 / 2.6)
    assert bone.imag / bone.real == pytest.approx(0.02)


def test_a_drawn_tissue_replaces_single_values() -> None:
    record = PRESETS["default"]["fat"]
    drawn = record.tissue({"mu": record.parameters["mu"].draw(-1.0)})
    assert drawn.modulus == KelvinVoigt(5e3 / 1.8, 1.5)


def resolve(override: dict, **rest: object):
    return resolve_tissues(parse_scenario({"tissues": {"override": override}, "supports": {"bone": "elastic"}, **rest}))


def test_override_replaces_single_values() -> None:
    tissues = resolve({"skin": {"mu": 20e3, "bulk": "incompressible"}, "bone": {"mu": 1e9}})
    assert tissues["skin"] == Tissue("skin", 1100.0, KelvinVoigt(20e3, 3.0), math.inf)
    assert tissues["bone"].modulus == Hysteretic(1e9, 0.02)


def test_change_of_model_restates_its_parameters() -> None:
    muscle = resolve({"muscle": {"law": "springpot", "mu": 2680, "exponent": 0.253}})["muscle"]
    assert muscle == Tissue("muscle", 1060.0, SpringPot(2680.0, 0.253, 1.0), 2.2e9)
    with pytest.raises(ScenarioError, match=r"tissues\.override\.muscle.*mu"):
        resolve({"muscle": {"law": "springpot", "exponent": 0.253}})


def test_new_tissue_is_complete_and_may_be_a_layer() -> None:
    new = {"tendon": {"density": 1120, "mu": 75e3, "eta": 10, "bulk": 3e9}}
    limb = {"layers": [{"tissue": "tendon", "thickness": 1e-3}]}
    assert resolve(new, limb=limb)["tendon"].modulus == KelvinVoigt(75e3, 10.0)


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ({"tendon": {"mu": 75e3}}, r"tissues\.override\.tendon: .*density, bulk, eta"),
        ({"skin": {"exponent": 0.3}}, r"tissues\.override\.skin\.exponent: has no effect"),
        ({"bone": {"eta": 3.0}}, r"tissues\.override\.bone\.eta: has no effect"),
        ({"fat": {"law": "zener", "mu": 5e3, "eta": 1, "mu_infinity": 4e3}}, r"fat\.mu_infinity: must"),
    ],
)
def test_bad_overrides_name_their_key(override: dict, message: str) -> None:
    rest = {"limb": {"layers": [{"tissue": "tendon", "thickness": 1e-3}]}} if "tendon" in override else {}
    with pytest.raises(ScenarioError, match=message):
        resolve(override, **rest)


@pytest.mark.parametrize(
    ("limb", "path"),
    [
        ({"layers": [{"tissue": t, "thickness": 1e-3} for t in ("skin", "lard")]}, "limb.layers.1.tissue"),
        ({"core": "lard"}, "limb.core"),
        ({"shape": "surfaces", "surfaces": {"lard": "a.stl"}}, "limb.surfaces.lard"),
        ({"shape": "mesh", "file": "a.msh", "regions": {"3": "lard"}}, "limb.regions.3"),
    ],
)
def test_unknown_limb_tissue_names_its_key(limb: dict, path: str) -> None:
    with pytest.raises(ScenarioError, match=rf"{path}: no tissue is called 'lard'"):
        resolve_tissues(parse_scenario({"limb": limb}))
