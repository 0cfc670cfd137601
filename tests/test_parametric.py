"""One reduced model for many arms: draws that it has not seen against direct solves, its statements, its borders."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from forearm_fem.device import close_loop
from forearm_fem.errors import DataError, ReductionError, ScenarioError
from forearm_fem.fem.reduction.rational import chebyshev_frequencies, rational
from forearm_fem.fem.reduction.sweep import direct_sweep
from forearm_fem.fem.reduction.united import Growth
from forearm_fem.geometry.cache import cached_mesh
from forearm_fem.pipeline import parametric
from forearm_fem.pipeline.fem_engine import fem_model
from forearm_fem.pipeline.frequencies import frequencies
from forearm_fem.pipeline.parametric import Ranges, load_parametric, parametric_model, save_parametric
from forearm_fem.scenario import Scenario, parse_scenario
from forearm_fem.tissue import resolve_tissues
from forearm_fem.transfer import band_error

SCENE = {
    "name": "small",
    "limb": {
        "shape": "slab", "length": 0.05, "width": 0.04, "depth": 0.012,
        "layers": [{"tissue": "skin", "thickness": 1.2e-3}, {"tissue": "fat", "thickness": 3e-3}],
    },
    "device": {"contacts": [[-0.012, 0.0], [0.012, 0.004]], "cone": {"contact": "pressure"}},
    "grid": {"points": [[0.0, 0.003], [0.002, -0.009]]},
    "mesh": {"size_contact": 4.5e-3, "size_grid": 8e-3, "size_far": 12e-3, "sublayers": {"skin": 1, "fat": 1}},
    "solver": {"discretisation_estimate": False},
    "sweep": {"f_min": 20.0, "f_max": 500.0},
}  # fmt: skip
PROBES = np.array([20.0, 80.0, 200.0, 330.0, 490.0])
GROWTH = Growth(solves=15, checks=5)


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("FOREARM_FEM_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(scope="module")
def model(cache):
    return parametric_model(parse_scenario(SCENE), growth=GROWTH)


def solved(draw: Scenario, frequency: np.ndarray = PROBES) -> np.ndarray:
    """Compliance (n_frequency, n_point, n_contact) of a draw by direct solves."""
    model = fem_model(draw, cached_mesh(draw))
    return direct_sweep(model, frequency, draw.solver).values[:, 2:, :2]


def test_unseen_draws_are_as_right_as_stated(model):
    """One of each law, of a hypercube of another seed; asked is 2 %, and to be stated."""
    for draw in Ranges().draws(parse_scenario(SCENE), 3, seed=99):
        found = model.compliance(draw, PROBES)
        true = band_error(found.block("point", "contact"), solved(draw))
        assert true < 0.02
        assert true < found.errors[0].band < 0.2


def test_far_outside_its_ranges_the_error_is_still_stated(model):
    """Tissue eight times softer than any draw: beyond what the space can do, and said."""
    far = Ranges(moduli=1.0, laws=("zener",)).draws(softer(8.0), 2, seed=3)[1]
    found = model.compliance(far, PROBES)
    true = band_error(found.block("point", "contact"), solved(far))
    assert true > 0.05
    assert found.errors[0].band > true


def _soft(scenario: Scenario) -> Any:
    """Soft tissues by name, Kelvin-Voigt all."""
    return {name: tissue for name, tissue in resolve_tissues(scenario).items() if name != "bone"}


def softer(factor: float) -> Scenario:
    scenario = parse_scenario(SCENE)
    moduli = {n: {"mu": t.modulus.mu / factor} for n, t in _soft(scenario).items()}
    return parse_scenario({**SCENE, "tissues": {"override": moduli}})


def test_all_bins_follow_from_few(model):
    """The rational function between solved frequencies errs by less than it says."""
    scenario = parse_scenario(SCENE)
    for draw in Ranges().draws(scenario, 3, seed=5):
        band = frequencies(scenario.sweep)
        whole, some = model.compliance(draw, band), slice(None, None, 24)
        exact = model.compliance(draw, band[some])
        contact = whole.block("point", "contact")[some]
        assert np.abs(contact - exact.block("point", "contact")).max() < 5e-3 * np.abs(contact).max()
        values = np.nan_to_num(whole.values)
        assert np.array_equal(values, values.swapaxes(1, 2))  # a slab that is whole: reciprocal to the last digit


def test_draws_are_passive(model):
    """No force on the contacts gives energy: -Im C is positive semi-definite for every law."""
    for draw in Ranges().draws(parse_scenario(SCENE), 6, seed=7):
        under = model.compliance(draw, frequencies(draw.sweep)[::8]).block("contact", "contact")
        lost = -(under.imag + under.imag.swapaxes(1, 2)) / 2
        assert np.linalg.eigvalsh(lost).min() > -1e-3 * np.abs(under).max()  # what lies between solved frequencies


def test_springs_gains_and_coils_need_no_other_model(model):
    changed = parse_scenario({**SCENE, "device": {**SCENE["device"], "contact_springs": {"A1": 50.0}}})
    one, other = (close_loop(model.compliance(s, PROBES), s.device).values for s in (parse_scenario(SCENE), changed))
    assert np.linalg.norm(other - one) > 0.05 * np.linalg.norm(one)


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"limb": {**SCENE["limb"], "depth": 0.013}}, "limb"),
        ({"grid": {"points": [[0.0, 0.003]]}}, "grid"),
        ({"device": {**SCENE["device"], "rotation": 0.1}}, "device"),
        ({"tissues": {"override": {"fat": {"bulk": 1e8}}}}, "tissues.override.fat"),
        ({"tissues": {"membrane": {"mass": 0.1}}}, "tissues.membrane"),
    ],
)
def test_another_geometry_is_refused(model, change, key):
    with pytest.raises(ScenarioError, match=f"^{key}"):
        model.compliance(parse_scenario({**SCENE, **change}), PROBES)


def test_frequencies_beyond_the_band_are_refused(model):
    with pytest.raises(ReductionError, match="600 Hz is outside the band"):
        model.compliance(parse_scenario(SCENE), np.array([100.0, 600.0]))


def test_the_twin_needs_none():
    with pytest.raises(ScenarioError, match="engine"):
        parametric_model(parse_scenario({**SCENE, "engine": "layered"}))


def test_it_is_made_once_and_read_back(model, tmp_path, monkeypatch):
    monkeypatch.setattr(parametric, "united_model", None)  # whatever is made again ends here
    again = parametric_model(parse_scenario(SCENE), growth=GROWTH)
    draw = Ranges().draws(parse_scenario(SCENE), 2, seed=11)[1]
    first, second = (m.compliance(draw, PROBES) for m in (model, again))
    assert np.array_equal(np.nan_to_num(first.values), np.nan_to_num(second.values))
    assert first.errors == second.errors
    assert again.checks == model.checks
    with pytest.raises(TypeError):
        parametric_model(parse_scenario(SCENE), growth=Growth(solves=9))
    save_parametric(tmp_path / "parametric.nc", model)
    broken = bytearray((tmp_path / "parametric.nc").read_bytes())
    broken[len(broken) // 2] ^= 0xFF
    (tmp_path / "parametric.nc").write_bytes(broken)
    with pytest.raises(DataError):
        load_parametric(tmp_path / "parametric.nc")


def test_the_worst_check_decides_what_is_stated(model):
    """An estimate that was once ten times too small is taken ten times as large everywhere."""
    draw, worst = parse_scenario(SCENE), model.checks[0]
    wary = replace(model, checks=(replace(worst, estimated=worst.true / (10 * model.factor)), *model.checks[1:]))
    small, large = (m.compliance(draw, PROBES).errors[0].band for m in (model, wary))
    assert large == pytest.approx(10 * small, rel=1e-9)


def test_draws_stay_within_their_ranges():
    scenario = parse_scenario(SCENE)
    draws = Ranges(moduli=2.0, tension=(10.0, 20.0)).draws(scenario, 30, seed=2)
    own = _soft(scenario)
    for i, draw in enumerate(draws):
        assert 10.0 <= draw.tissues.membrane.tension <= 20.0
        for name in ("skin", "fat", "muscle"):
            modulus, before = _soft(draw)[name].modulus, own[name].modulus
            if i % 3 == 2:
                size = abs(modulus.at(200 * np.pi)) / abs(before.at(200 * np.pi))
            else:
                size = modulus.mu / before.mu
                assert 0.5 <= modulus.eta / before.eta <= 2.0
            assert 0.5 <= size <= 2.0 + 1e-12


def test_a_rational_function_is_found_and_a_wild_one_told():
    """Six damped modes come back from twenty values; three hundred within the band do not, and the misfit says so."""
    rng, f = np.random.default_rng(0), np.linspace(10.0, 500.0, 300)

    def modes(count: int, frequency: np.ndarray) -> np.ndarray:
        poles = 2 * np.pi * np.random.default_rng(1).uniform(30, 450, count) * (1j - 0.05)
        return (1 / (2j * np.pi * frequency[:, None] - poles)) @ shapes[:count]

    shapes = rng.normal(size=(300, 5))
    nodes = chebyshev_frequencies(f, 20)
    smooth, wild = (rational(nodes, modes(n, nodes), 1e-6) for n in (6, 300))
    assert smooth.misfit < 1e-6
    assert np.abs(smooth.at(f) - modes(6, f)).max() < 1e-5 * np.abs(modes(6, f)).max()
    assert wild.misfit > 1e-2
