"""Fitting: known parameters recovered within the stated uncertainty, and what cannot be known is said to be
unknown.
"""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scenes import shows_itself
from test_measurement_scene import INPUTS, OUTPUTS, wave_matrix

from forearm_fem.engines.simulation import simulate
from forearm_fem.errors import DataError, ScenarioError
from forearm_fem.geometry.device.layout import planform_ports
from forearm_fem.ports import Port, distances
from forearm_fem.questions.compare.fit import fit
from forearm_fem.questions.compare.parameters import LayeredBetween, Parameter, ScenarioModel, common_parameters
from forearm_fem.questions.compare.run import _unmeasured, all_inputs, fit_text, run_fit
from forearm_fem.scenario import Scenario, parse_scenario
from forearm_fem.transfer import TransferMatrix

F = np.arange(20.0, 400.0, 10.0)
D = distances(OUTPUTS, INPUTS)
TRUE = {"speed": 3.4, "loss": 55.0, "resonance": 280.0}


def model(p):
    """Damped waves through a resonance, like the scene's."""
    w = 2 * np.pi * F[:, None, None]
    k = w / p["speed"] - 1j * p["loss"]
    return (
        1e-5
        / (1 - (F[:, None, None] / p["resonance"]) ** 2 + 0.5j * F[:, None, None] / p["resonance"])
        * np.exp(-1j * k * D)
    )


PARAMETERS = (
    Parameter("speed", 3.0, 1.0, 10.0, log=True),
    Parameter("loss", 40.0, 10.0, 200.0, log=True),
    Parameter("resonance", 300.0, 150.0, 600.0, log=True),
)


def noisy(values, seed, sigma=3e-7, deviation=True):
    rng = np.random.default_rng(seed)
    noise = sigma / np.sqrt(2) * (rng.standard_normal(values.shape) + 1j * rng.standard_normal(values.shape))
    known = np.full(values.shape, sigma) if deviation else None
    return TransferMatrix(F, values + noise, OUTPUTS, INPUTS, deviation=known)


def test_exact_data_give_exact_parameters():
    result = fit(model, TransferMatrix(F, model(TRUE), OUTPUTS, INPUTS), PARAMETERS)
    assert result.values == pytest.approx(TRUE, rel=1e-6)
    assert result.identified
    assert not result.sentences  # what rounding leaves is no gain of its own
    assert result.e_band < 1e-6


@pytest.mark.parametrize("deviation", [True, False])
def test_coverage_of_the_stated_intervals(deviation):
    """40 seeds, 3 parameters: 95 % intervals hold the truth, z scores have unit spread."""
    inside, z = [], []
    for seed in range(40):
        result = fit(model, noisy(model(TRUE), seed, deviation=deviation), PARAMETERS)
        for name, value in TRUE.items():
            low, high = result.interval[name]
            inside.append(low < value < high)
            z.append((result.values[name] - value) / result.deviation[name])
        assert result.identified
    # binomial, 120 trials at 0.95: 0.89 is three standard deviations below
    assert 0.89 <= np.mean(inside) <= 1.0
    assert np.std(z) == pytest.approx(1.0, abs=0.2)  # 120 samples: +-0.065, three of these


def test_the_ends_of_a_narrow_interval_are_told_apart():
    """Quiet data: "3.4, 3.4 to 3.4" says nothing; as many digits are printed as the interval is narrow."""
    result = fit(model, noisy(model(TRUE), 0, sigma=1e-11), PARAMETERS)
    rows = [line.split(" | ") for line in fit_text(result).splitlines()[2 : 2 + len(TRUE)]]
    for _, value, interval, *_ in rows:
        low, high = interval.split(" to ")
        assert float(low) < float(value) < float(high)


def test_scale_and_delay_are_fitted_with_the_rest():
    start = {**TRUE, "resonance": 280.0}
    shifted = model(start) * 0.6 * np.exp(-2j * np.pi * F * 1.5e-3)[:, None, None]
    extra = (
        Parameter("scale", 1.0, 0.2, 5.0, log=True, stage=0),
        Parameter("delay", 0.0, -5e-3, 5e-3, stage=0, unit="s"),
    )
    extra = (extra[0], replace(extra[1], start=1.4e-3))  # a phase is ambiguous: the start must be near
    result = fit(model, noisy(shifted, 1), (*extra, *PARAMETERS))
    assert result.values["scale"] == pytest.approx(0.6, abs=4 * result.deviation["scale"])
    assert result.values["delay"] == pytest.approx(1.5e-3, abs=4 * result.deviation["delay"])
    assert result.values["speed"] == pytest.approx(3.4, abs=4 * result.deviation["speed"])


def test_a_gain_of_one_actuator_is_told_and_found_beside_the_rest():
    """One scale would be the mean of gains that differ, with a narrow interval."""
    other = model(TRUE) * np.array([1.0, 0.8, *[1.0] * (len(INPUTS) - 2)])
    data = TransferMatrix(F, other, OUTPUTS, INPUTS)
    scale = Parameter("scale", 1.0, 0.2, 5.0, log=True, stage=0)
    name = INPUTS[1].name
    told = fit(model, data, (*PARAMETERS, scale))
    assert max(told.left, key=told.left.__getitem__) == name
    assert any(f"of {name}'s column" in s and "`gains`" in s for s in told.sentences)
    gains = tuple(replace(scale, name=f"gain.{p.name}") for p in INPUTS)
    found = fit(model, data, (*PARAMETERS, *gains))
    expected = {**TRUE, **{g.name: 0.8 if g.name == f"gain.{name}" else 1.0 for g in gains}}
    assert found.values == pytest.approx(expected, rel=1e-6)
    assert not found.sentences
    with pytest.raises(ScenarioError, match="leave scale out"):
        run_fit(parse_scenario({}), data, ["scale", "gains"])


def test_two_parameters_that_only_act_as_a_product_are_named():
    def product(p):
        return model({**TRUE, "speed": p["speed"]}) * p["gain"] * p["sensitivity"]

    parameters = (
        PARAMETERS[0],
        Parameter("gain", 1.0, 0.1, 10.0, log=True),
        Parameter("sensitivity", 1.0, 0.1, 10.0, log=True),
    )
    result = fit(product, noisy(model(TRUE), 3), parameters)
    assert not result.identified
    assert len(result.unknown) == 1
    assert "cannot tell gain and sensitivity apart" in result.sentences[0]
    assert result.values["speed"] == pytest.approx(3.4, abs=4 * result.deviation["speed"])  # the rest is still good


def test_a_parameter_without_effect_is_named():
    result = fit(
        lambda p: model({**TRUE, "speed": p["speed"]}),
        noisy(model(TRUE), 4),
        (PARAMETERS[0], Parameter("bone", 1.0, 0.5, 2.0)),
    )
    assert "do not determine bone" in result.sentences[0]
    assert result.correlation[0, 1] == pytest.approx(0, abs=1e-6)


def test_a_wrong_model_says_so_and_widens_its_interval():
    result = fit(lambda p: model({**TRUE, "resonance": 330.0, **p}), noisy(model(TRUE), 5), PARAMETERS[:1])
    assert result.chi2 > 10
    assert any("misses the data" in s for s in result.sentences)
    clean = fit(lambda p: model({**TRUE, **p}), noisy(model(TRUE), 5), PARAMETERS[:1])
    assert result.deviation["speed"] > 2 * clean.deviation["speed"]


def test_an_actuator_unlike_the_thesis_one_is_fitted_too():
    """Its values lie outside the ranges of the thesis' kind, which stay as they are for that."""
    own = {"device": {"coil": {"force_factor": 0.3, "resonance": 150.0}, "cone": {"mass": 0.0}}}
    (skin,) = common_parameters(parse_scenario(own), ["skin.mu"])
    assert skin.lower < skin.start < skin.upper
    weak, low = common_parameters(parse_scenario(own), ["coil.force_factor", "coil.resonance"])
    assert (weak.lower, weak.upper, low.lower, low.upper) == pytest.approx((0.1, 7.0, 50.0, 1000.0))
    with pytest.raises(ScenarioError, match=r"no parameter is called cone\.mass"):
        common_parameters(parse_scenario(own), ["cone.mass"])
    (usual,) = common_parameters(Scenario(), ["coil.resonance"])
    assert (usual.lower, usual.upper) == (300.0, 1000.0)


def test_a_bound_that_holds_is_named():
    result = fit(lambda p: model({**TRUE, **p}), noisy(model(TRUE), 6), (Parameter("loss", 30.0, 10.0, 45.0),))
    assert result.at_bound == ("loss",)
    assert any("ended on its bound" in s for s in result.sentences)


def test_more_starts_leave_a_local_minimum():
    """From 1.5 m/s the phase is a whole turn off at the far points."""
    far = (Parameter("speed", 1.5, 1.0, 10.0, log=True),)
    stuck = fit(lambda p: model({**TRUE, **p}), noisy(model(TRUE), 6), far)
    assert stuck.chi2 > 10
    assert any("misses the data" in s for s in stuck.sentences)
    free = fit(lambda p: model({**TRUE, **p}), noisy(model(TRUE), 6), far, starts=6)
    assert free.chi2 == pytest.approx(1.0, abs=0.15)
    assert free.values["speed"] == pytest.approx(3.4, abs=4 * free.deviation["speed"])


def test_gradients_replace_differences():
    calls = []

    def counted(p):
        calls.append(1)
        return model({**TRUE, **p})

    def gradient(p):
        w = 2 * np.pi * F[:, None, None]
        return {"speed": model({**TRUE, **p}) * (1j * w / p["speed"] ** 2 * D)}

    data = noisy(model(TRUE), 7)
    scale = Parameter("scale", 1.0, 0.2, 5.0, log=True, stage=0)
    by_gradient = fit(counted, data, (scale, PARAMETERS[0]), gradient=gradient)
    spent = len(calls)
    by_difference = fit(counted, data, (scale, PARAMETERS[0]))
    assert by_gradient.values["speed"] == pytest.approx(by_difference.values["speed"], rel=1e-6)
    np.testing.assert_allclose(by_gradient.covariance, by_difference.covariance, rtol=1e-3, atol=1e-12)
    assert spent < len(calls) - spent + 10


def test_impossible_fits_are_refused():
    with pytest.raises(ScenarioError, match="lower <= start <= upper"):
        Parameter("speed", 11.0, 1.0, 10.0)
    with pytest.raises(ScenarioError, match="positive lower bound"):
        Parameter("delay", 0.0, -1.0, 1.0, log=True)
    few = TransferMatrix(F[:1], model(TRUE)[:1, :1, :1], OUTPUTS[:1], INPUTS[:1])
    with pytest.raises(DataError, match="measure more"):
        fit(lambda p: model(p)[:1, :1, :1], few, PARAMETERS)
    with pytest.raises(DataError, match="distinct names"):
        fit(model, few, ())


SCENARIO = parse_scenario({"device": {"housing": {"fixed": True}}})
LAYERED_F = np.array([60.0, 120.0, 180.0, 250.0, 330.0, 420.0])


def layered(**values):
    skin = LayeredBetween(OUTPUTS, INPUTS, tolerance=1e-5)
    return ScenarioModel(SCENARIO, skin, LAYERED_F)(values)


def test_layered_model_recovers_skin_and_coil_parameters(tmp_path):
    """Actuator and tissue parameters from a noisy G of the layered model (40 dB), in tissue keys of the scenario."""
    true = {"tissues.override.skin.mu": 18e3, "device.coil.moving_mass": 0.5e-3}
    truth = layered(**true)
    sigma = 0.01 * np.sqrt(np.mean(np.abs(truth.values) ** 2))
    rng = np.random.default_rng(11)
    noise = (
        sigma / np.sqrt(2) * (rng.standard_normal(truth.values.shape) + 1j * rng.standard_normal(truth.values.shape))
    )
    data = replace(truth, values=truth.values + noise, deviation=np.full(truth.values.shape, sigma), contacts=None)
    result = run_fit(SCENARIO, data, ["scale", "skin.mu", "coil.moving_mass"], folder=tmp_path)
    shows_itself(result)
    assert result.sel("scale") == (result.fit.values["scale"], *result.fit.interval["scale"])
    assert [e.source for e in result.model.errors] == ["quadrature"]  # the fitted G states the model's own error
    assert not result.numerics  # the layered model's own error counts for nothing beside this noise
    for name, value in true.items():
        low, high = result.fit.interval[name]
        assert low < value < high
    assert result.fit.chi2 == pytest.approx(1.0, abs=0.2)  # 432 numbers: +-0.07, three of these
    assert json.loads((tmp_path / "fit.json").read_text())["identified"]


def test_data_of_arbitrary_gain_are_fitted_with_a_scale_of_any_size():
    """A scale between a fifth and five times cannot undo a gain of 3,000: the tissues would have to."""
    truth = layered(**{"tissues.override.skin.mu": 18e3})
    data = replace(truth, values=3e3 * truth.values, contacts=None, provenance={"gain": "arbitrary"})
    with pytest.raises(DataError, match="name `scale` among the parameters"):
        run_fit(SCENARIO, data, ["skin.mu"])
    found = run_fit(SCENARIO, data, ["scale", "skin.mu"]).fit.values
    assert found["scale"] == pytest.approx(3e3, rel=1e-3)
    assert found["tissues.override.skin.mu"] == pytest.approx(18e3, rel=1e-3)


def test_cones_that_stand_close_are_fitted_with_the_waves_that_they_scatter():
    """A fit's own layered model took one azimuthal order whatever the distances: 3 % of G beside cones 9 mm apart, and
    moduli that were wrong by ten times their intervals."""
    scenario = parse_scenario({
        "engine": "layered",
        "device": {"drive": "force", "contacts": [(-0.0042, 0.0), (0.0042, 0.0)]},
        "grid": {"points": [(0.0, 0.008), (0.013, 0.002)]},
        "tissues": {"override": {"muscle": {"mu": 14e3}}},
        "sweep": {"frequencies": [80.0, 200.0, 350.0]},
    })  # fmt: skip
    data = replace(simulate(scenario).transfer, contacts=None)
    start = scenario.model_copy(update={"tissues": Scenario().tissues})
    answer = run_fit(start, data, ["scale", "muscle.mu"])
    found = answer.fit
    assert "series and quadrature of the fit's layered model err by an e_band" in answer.numerics  # data without noise
    assert found.values["scale"] == pytest.approx(1.0, rel=1e-3)
    assert found.values["tissues.override.muscle.mu"] == pytest.approx(14e3, rel=2e-3)
    assert found.e_band < 2e-3


def test_layered_model_says_that_coil_and_cone_mass_are_one_number():
    data = replace(layered(), contacts=None)
    sigma = 0.01 * np.sqrt(np.mean(np.abs(data.values) ** 2))
    data = replace(data, deviation=np.full(data.values.shape, sigma))
    model_of = ScenarioModel(SCENARIO, LayeredBetween(OUTPUTS, INPUTS), LAYERED_F)
    resonance_free = [
        p for p in common_parameters(SCENARIO, ["coil.moving_mass", "cone.mass", "coil.resonance", "coil.quality"])
    ]
    result = fit(model_of, data, resonance_free)
    assert not result.identified
    assert "cannot tell" in result.sentences[0]


def test_scenario_keys_are_checked():
    with pytest.raises(ScenarioError, match="known are"):
        common_parameters(SCENARIO, ["skin.colour"])
    with pytest.raises(ScenarioError, match="unknown key"):
        ScenarioModel(SCENARIO, None, LAYERED_F)({"device.coil.colour": 1.0})
    assert wave_matrix().unit == "m/V"


def test_actuators_and_points_that_were_not_measured_turn_with_the_device():
    """They stood where a device that is not turned has them, beside those measured."""
    scenario = parse_scenario({"engine": "layered", "device": {"rotation": 0.4}})
    outputs, inputs = planform_ports(scenario)
    data = TransferMatrix(F, np.ones((len(F), 1, 1), dtype=complex), outputs[:1], inputs[:1])
    assert all_inputs(scenario, data) == inputs
    assert _unmeasured(scenario, data) == outputs[1:]


def test_a_large_misfit_without_deviations_is_said() -> None:
    """Data of unknown scatter, of which the model leaves two thirds, were fitted without a word."""
    f = np.linspace(50.0, 250.0, 21)
    rng = np.random.default_rng(0)
    values = np.asarray(rng.standard_normal((21, 1, 1)) + 1j * rng.standard_normal((21, 1, 1)) + 2.0, dtype=complex)
    ports = tuple(Port(n, k, (0.0, 0.0, 0.0)) for n, k in (("1", "point"), ("A1", "contact")))
    data = TransferMatrix(f, values, ports[:1], ports[1:], "m/V")
    result = fit(lambda v: np.full((21, 1, 1), 1.0 + 0j), data, [Parameter("scale", 1.0, 0.2, 5.0, log=True)])
    assert result.e_band > 0.3
    assert any("of the data's norm unexplained" in s for s in result.sentences)
    calm = fit(lambda v: np.asarray(1.1 * values), data, [Parameter("scale", 1.0, 0.2, 5.0, log=True)])
    assert not any("unexplained" in s for s in calm.sentences)


def test_ranges_of_a_fit_stay_within_its_law_and_layers_of_one_tissue_are_told_apart() -> None:
    """Six times a Zener law's mu is above its mu_infinity, which no scenario may have; of two layers one was found."""
    layers = [{"tissue": t, "thickness": d} for t, d in (("skin", 4e-4), ("skin", 8e-4), ("fat", 3e-3))]
    limb = {"shape": "slab", "length": 0.12, "width": 0.12, "depth": 0.04, "layers": layers}
    scene = parse_scenario({"limb": limb, "tissues": {"preset": "zener"}})
    names = ["muscle.mu", "skin.1.thickness", "skin.2.thickness", "fat.thickness"]
    mu, outer, inner, fat = common_parameters(scene, names)
    high = {"muscle": {"mu": mu.upper}}
    assert parse_scenario({"limb": limb, "tissues": {"preset": "zener", "override": high}})
    assert (outer.start, inner.start, fat.start) == (4e-4, 8e-4, 3e-3)
    assert [p.name for p in (outer, inner)] == ["limb.layers.0.thickness", "limb.layers.1.thickness"]
