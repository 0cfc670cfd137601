"""The next best measurement where the answer is known beforehand."""

from __future__ import annotations

import numpy as np
import pytest

from forearm_fem.compare.fit import fit
from forearm_fem.compare.next_best import candidates_of, next_best
from forearm_fem.compare.parameters import Parameter
from forearm_fem.ports import Port
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
    found = next_best(fitted(slice(None), ("near",)), everything, F, NAMES, 0.02)
    assert (found.parameter, found.candidate.output) == ("loss", "far")
    assert found.candidate.band == (pytest.approx(F[20]), pytest.approx(320.0))  # of three bands the highest
    assert found.share < 0.2
    assert "next best measurement: point far at 227-320 Hz; the widest interval, that of loss" in found.sentence


def test_the_interval_shrinks_as_said_once_it_is_measured():
    """The forecast against a fit that has the measurement; both are linear at the same values but for noise."""
    before, rows = fitted(slice(None), ("near",)), slice(20, 30)
    found = next_best(before, everything, F, NAMES, 0.02)
    columns = [NAMES.index("near")]

    def both(v):
        far = everything(v)[rows][:, [1]]
        return np.concatenate([everything(v)[:, columns], far])

    first, second = measured(slice(None), ("near",)), measured(rows, ("far",), seed=2)
    joint = TransferMatrix(
        np.concatenate([first.frequency, second.frequency]), np.concatenate([first.values, second.values]),
        first.outputs, INPUTS, deviation=np.concatenate([first.deviation, second.deviation]),
    )  # fmt: skip
    after = fit(both, joint, PARAMETERS)
    widths = [np.log(r.interval["loss"][1] / r.interval["loss"][0]) for r in (before, after)]
    assert widths[1] / widths[0] == pytest.approx(found.share, rel=0.15)


def test_what_nobody_hears_is_not_promised():
    result = fit(lambda v: everything({**v, "loss": 0.8})[:, [0]], measured(slice(None), ("near",)), PARAMETERS)
    found = next_best(result, lambda v: everything({**v, "loss": 0.8}), F, NAMES, 0.02)
    assert found.parameter == "loss"
    assert "no point and band asked about shrinks the widest interval, that of loss, by a tenth" in found.sentence


def test_every_point_in_every_band_is_a_candidate():
    found = candidates_of(F, NAMES, 3)
    assert len(found) == 9
    assert sorted(k for c in found if c.output == "far" for k in range(30)[c.rows]) == list(range(30))
