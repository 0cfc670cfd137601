"""The next best measurement where the answer is known beforehand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from forearm_fem.ports import Port
from forearm_fem.questions.compare.fit import fit, with_model_error
from forearm_fem.questions.compare.next_best import candidates_of, next_best
from forearm_fem.questions.compare.parameters import Parameter
from forearm_fem.transfer import TransferMatrix

F = np.linspace(20.0, 320.0, 30)
NAMES = ("near", "far", "deaf")
INPUTS = (Port("A1", "contact", (0.0, 0.0, 0.0), radius=1e-3),)
PARAMETERS = (Parameter("size", 1.0, 0.2, 5.0, log=True), Parameter("loss", 1.0, 0.2, 5.0, log=True))
TRUE = {"size": 1.3, "loss": 0.8}


def everything(values):
    """``loss`` acts strongly at the far point above 220 Hz, a tenth as much elsewhere; a deaf point hears nothing."""
    high = np.where(F > 220.0, 1.0, 0.1)
    near = values["size"] * np.exp(-0.01 * values["loss"] * F / 100) + 0j
    far = values["size"] * 0.5 * np.exp(-values["loss"] * high)
    return np.stack([near, far, 0 * near], axis=1)[:, :, None]


def measured(rows, names, sigma=0.02, seed=1):
    rng = np.random.default_rng(seed)
    clean = everything(TRUE)[rows][:, [NAMES.index(n) for n in names]]
    noise = sigma / np.sqrt(2) * (rng.standard_normal(clean.shape) + 1j * rng.standard_normal(clean.shape))
    outputs = tuple(Port(n, "point", (0.01 * k, 0.0, 0.0)) for k, n in enumerate(names))
    return TransferMatrix(F[rows], clean + noise, outputs, INPUTS, deviation=np.full(clean.shape, sigma))


def fitted(rows, names, **noise):
    columns = [NAMES.index(n) for n in names]
    return fit(lambda v: everything(v)[rows][:, columns], measured(rows, names, **noise), PARAMETERS)


def test_the_point_and_band_that_hear_a_parameter_are_named():
    found = next_best(fitted(slice(None), ("near",)), everything, F, NAMES, ["A1"], 0.02)
    assert (found.parameter, found.candidate.output) == ("loss", "far")
    assert found.candidate.band == (pytest.approx(F[20]), pytest.approx(320.0))  # of three bands the highest
    assert found.share < 0.2
    assert "next best measurement: point far at 227-320 Hz; the widest interval, that of loss" in found.sentence


def test_the_interval_shrinks_as_said_once_it_is_measured():
    """The forecast against a fit that has the measurement; both are linear at the same values but for noise."""
    before, rows = fitted(slice(None), ("near",)), slice(20, 30)
    found = next_best(before, everything, F, NAMES, ["A1"], 0.02)
    columns = [NAMES.index("near")]

    def both(v):
        far = everything(v)[rows][:, [1]]
        return np.concatenate([everything(v)[:, columns], far])

    first, second = measured(slice(None), ("near",)), measured(rows, ("far",), seed=2)
    joint = TransferMatrix(  # bins in a row: the model answers for them by number
        np.arange(1.0, 1 + len(first.frequency) + len(second.frequency)), np.concatenate([first.values, second.values]),
        first.outputs, INPUTS, deviation=np.concatenate([first.deviation, second.deviation]),
    )  # fmt: skip
    after = fit(both, joint, PARAMETERS)
    widths = [np.log(r.interval["loss"][1] / r.interval["loss"][0]) for r in (before, after)]
    assert widths[1] / widths[0] == pytest.approx(found.share, rel=0.15)


@pytest.mark.parametrize("said", [0.02, 0.005, 0.2, None])
def test_the_forecast_follows_the_misfit_and_not_what_was_said_of_the_noise(said):
    """Noise of 0.02 that is stated right, too small by four, or not at all (then taken for 5 % of the rms): intervals
    follow the misfit, and so must the measurement to come. Forecasts were .66 and .99 of a true .83, and what counts is
    the ratio of what is known to what is added. Noise stated too large is believed, in the interval and the forecast.
    """
    data = measured(slice(None), ("near",))
    told = None if said is None else np.full(data.values.shape, said)
    taken = 0.05 * float(np.sqrt(np.mean(np.abs(data.values) ** 2))) if said is None else said
    right, other = (fit(lambda v: everything(v)[:, [0]], replace(data, deviation=d), PARAMETERS)
                    for d in (data.deviation, told))  # fmt: skip
    shares = [next_best(r, everything, F, NAMES, ["A1"], n).share for r, n in ((right, 0.02), (other, taken))]
    assert shares[1] == pytest.approx(shares[0], rel=0.02)  # chi^2 of 58 numbers is 1 +- 0.19; values hardly move


def test_what_the_model_errs_by_is_not_measured_away():
    """Half of the variance is the model's: however much is measured, sqrt(1/2) of the interval stays."""
    plain = fitted(slice(None), ("near",))
    off = {p.name: plain.values[p.name] for p in PARAMETERS}
    off["loss"] *= (plain.interval["loss"][1] / plain.interval["loss"][0]) ** 0.5  # as far as the interval reaches
    both = with_model_error(plain, off, 1.0)
    alone, found = (next_best(r, everything, F, NAMES, ["A1"], 0.02) for r in (plain, both))
    assert found.parameter == "loss"
    assert found.share == pytest.approx(np.sqrt((alone.share**2 + 1) / 2), rel=1e-3)


def test_what_nobody_hears_is_not_promised():
    result = fit(lambda v: everything({**v, "loss": 0.8})[:, [0]], measured(slice(None), ("near",)), PARAMETERS)
    found = next_best(result, lambda v: everything({**v, "loss": 0.8}), F, NAMES, ["A1"], 0.02)
    assert found.parameter == "loss"
    assert "no point and band asked about shrinks the widest interval, that of loss, by a tenth" in found.sentence


def test_every_point_in_every_band_is_a_candidate():
    found = candidates_of(F, NAMES, 3)
    assert len(found) == 9
    assert sorted(k for c in found if c.output == "far" for k in range(30)[c.rows]) == list(range(30))
