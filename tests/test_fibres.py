"""Fibres along the limb: plane shear waves along and across, limits, reduced sweep, and who has none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from forearm_fem.engines.layered import LayeredEngine, solve_layered
from forearm_fem.engines.library.make import make_library
from forearm_fem.errors import ScenarioError
from forearm_fem.fem.assembly.model import build_model
from forearm_fem.fem.reduction.sweep import direct_sweep, reduced_sweep
from forearm_fem.fem.reduction.widening import _other_moduli
from forearm_fem.questions.predict.arm import arm_model
from forearm_fem.scenario import parse_scenario
from forearm_fem.scenario.limb import FreeUnderside, Membrane
from forearm_fem.scenario.model import resolve_tissues
from forearm_fem.scenario.sweep import ReducedSolve
from forearm_fem.tissue import Hysteretic, SpringPot, Tissue, Zener
from forearm_fem.transfer import relative_error
from forearm_fem.verification.scenes import DIRECT, block_mesh, flesh, held_block

MODULI = {
    "voigt": flesh().modulus,
    "springpot": SpringPot(2680.0, 0.253),
    "zener": Zener(3e3, 9e3, 5.0),
    "hysteretic": Hysteretic(8e3, 0.1),
}
X, Y, Z = np.eye(3)
SKEW = (X + Y) / np.sqrt(2), (X - Y) / np.sqrt(2)
MUSCLE = {"tissues": {"override": {"muscle": {"fibres": 3.05}}}}


def tissue(name="voigt", fibres=3.05):
    return Tissue("block", 1050.0, MODULI[name], 2.2e9, fibres)


@pytest.mark.parametrize("name", MODULI)
def test_plane_shear_waves_along_and_across(name):
    """u = d sin(k n.x) stores mu* k^2 - omega^2 rho per volume: mu* sqrt(r) where n or d is x, else mu* / sqrt(r).

    At 45 degrees in a plane of the fibres neither shear with x is there: that wave is one across. Half a wave on three
    elements of third order has its energy to 4e-4; where fibres are left out it is 1.7 times as large or small.
    """
    side, omega, r = 0.01, 2 * np.pi * 50.0, 3.05
    mesh = block_mesh((3, 3, 3), (side, side, side), facets={"all": ("x0", "x1", "y0", "y1", "z0", "z1")})
    model = build_model(mesh, (), {"block": tissue(name, r)}, FreeUnderside(ends="free"), Membrane(), element="P3")
    operator, k = model.operator, np.pi / side
    mean = complex(MODULI[name].at(np.array(omega)))
    for normal, direction, share in [
        (X, Y, r**0.5), (X, Z, r**0.5), (Y, X, r**0.5), (Z, X, r**0.5), (Z, Y, r**-0.5), (Y, Z, r**-0.5),
        (*SKEW, r**-0.5), ((X + Z) / np.sqrt(2), (X - Z) / np.sqrt(2), r**-0.5),
    ]:  # fmt: skip
        phase = k * model.space.node_points @ normal
        energy = 0j
        for wave in (np.sin(phase), np.cos(phase)):  # whose squares add to one everywhere
            u = model.constraints.transform.T @ np.outer(wave, direction).ravel()
            x = np.concatenate([u, np.zeros(model.space.n_pressures)])
            energy += complex(x @ operator.multiply(operator.data(omega), x[:, None])[:, 0])
        expected = (share * mean * k**2 - omega**2 * 1050.0) * side**3
        assert abs(energy - expected) < 1e-3 * abs(mean) * k**2 * side**3


def test_a_ratio_of_one_is_none():
    """The operator has the same terms, and the key the same meaning as none at all."""
    one, none = (
        held_block(2, tissue=t).operator for t in (tissue(fibres=1.0), Tissue("block", 1050.0, MODULI["voigt"], 2.2e9))
    )
    assert [t.name for t in one.terms] == [t.name for t in none.terms]
    assert np.array_equal(one.data(700.0), none.data(700.0))
    stated = parse_scenario({"tissues": {"override": {"muscle": {"fibres": 1.0}}}})
    assert resolve_tissues(stated) == resolve_tissues(parse_scenario({}))


@pytest.mark.parametrize(
    ("name", "fibres", "ends"),
    [("voigt", 3.05, "absorb"), ("springpot", 0.3, "fixed"), ("zener", 30.0, "absorb"), ("hysteretic", 0.05, "free")],
)
def test_reciprocal_and_passive(name, fibres, ends):
    """Also where the term counts negative, as it does below one; 1e-9 as without fibres."""
    values = direct_sweep(held_block(2, tissue=tissue(name, fibres), ends=ends), np.array([40.0, 500.0]), DIRECT).values
    for c in values:
        assert np.abs(c - c.T).max() < 1e-9 * np.abs(c).max()
        assert np.linalg.eigvalsh(-(c - c.conj().T) / 2j).min() > -1e-9 * np.abs(c).max()


@pytest.mark.parametrize("name", ["voigt", "springpot"])
def test_the_reduced_sweep_agrees_with_solves(name):
    """By its own certificate of 1e-5."""
    model, band = held_block(2, tissue=tissue(name)), np.linspace(20, 400, 39)
    found = reduced_sweep(model, band, ReducedSolve(), tolerance=1e-5).values
    assert relative_error(found[::6], direct_sweep(model, band[::6], DIRECT).values).max() < 1e-5


def test_directions_for_other_tissues_follow_fibres_and_shear_alike():
    """One modulus scales both: with a third of the storage along alone, that across could be less than none."""
    operator = held_block(2, tissue=tissue(fibres=0.05)).operator
    names = [t.name for t in operator.terms]
    shear, along = names.index("shear block"), names.index("fibres block")
    for theta in _other_moduli(operator, np.array([100.0, 200.0])):
        assert theta[along] / theta[shear] == pytest.approx(0.05 - 1)


def test_who_has_no_preferred_direction_refuses_in_one_sentence():
    scene = parse_scenario(MUSCLE)
    flat = scene.changed({"engine": "layered"})
    assert "engine = 'fem'" in LayeredEngine().holds(flat)
    for ask in (lambda: solve_layered(flat, np.array([100.0])), lambda: make_library(scene), lambda: arm_model(scene),
                lambda: arm_model(scene, layered=True)):  # fmt: skip
        with pytest.raises(ScenarioError, match=r"^tissues\.override\.muscle\.fibres: .*leave it out$"):
            ask()


def test_the_slowest_wave_is_the_one_across():
    slow, mean = tissue(fibres=16.0), replace(tissue(), fibres=1.0)
    for each in (slow, replace(slow, fibres=1 / 16)):
        assert each.wavenumber(700.0) == pytest.approx(2 * mean.wavenumber(700.0))
