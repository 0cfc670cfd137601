"""Any G to S: what a run printed comes back, a measured G gets its interval, and each G finds a scenario."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_runner import SMALL, cli

from forearm_fem.errors import DataError
from forearm_fem.files import save
from forearm_fem.questions.run import Run, run_all
from forearm_fem.rendering.job import UNASKED, RenderJob, is_on_bins, scenario_for
from forearm_fem.scenario import load_scenario
from forearm_fem.transfer import TransferMatrix

STRONG = 1e-3  # of the largest entry of each frequency: the noise of a good calibration


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A finished run on flat layers, 173 bins; its scenario lies beside the folder."""
    home = tmp_path_factory.mktemp("any_g")
    (home / "small.toml").write_text(SMALL.replace("f_max = 300.0", "f_max = 700.0"))  # all of the wavelet
    done = Run.start(load_scenario(home / "small.toml"), home / "run", home)
    run_all(done)
    return done


def bare(run: Run) -> TransferMatrix:
    """The run's G as a laboratory's would come: without origin, errors and driving points."""
    assert run.transfer is not None
    return replace(run.transfer, provenance={}, errors=(), contacts=None)


def strengths_in(folder: Path) -> dict[str, Any]:
    """S with its intervals, as a folder holds them."""
    return json.loads((folder / "signal_strength.json").read_text())["methods"]


def test_the_g_of_a_run_gives_the_s_of_the_run(run: Run, tmp_path: Path) -> None:
    """The same renderers on the same numbers: equal to the last digit, intervals included."""
    answer = cli("render", str(run.out), "--out", str(tmp_path / "again"))
    assert answer.code == 0, answer.err
    assert strengths_in(tmp_path / "again") == strengths_in(run.out)
    assert {"drives.nc", "displacements.nc", "report.html"} <= {p.name for p in (tmp_path / "again").iterdir()}


def test_a_file_gives_the_same_s_by_the_scenario_measured(run: Run, tmp_path: Path) -> None:
    """CSV keeps every digit that a float has. A G that states no error has no interval."""
    save(tmp_path / "lab.csv", bare(run))
    scenario = str(run.out.parent / "small.toml")
    answer = cli("render", str(tmp_path / "lab.csv"), "--scenario", scenario, "--out", str(tmp_path / "out"))
    assert answer.code == 0, answer.err
    ours = strengths_in(tmp_path / "out")
    for method, row in strengths_in(run.out).items():
        for target, entry in row.items():
            assert ours[method][target]["value"] == pytest.approx(entry["value"], rel=1e-12)
            assert ours[method][target]["low"] is None


def test_the_interval_of_a_measured_g_holds_the_truth(run: Run) -> None:
    """Nine in ten by its promise; fewer than five of these six would then come in one case of nine."""
    truth, rng = bare(run), np.random.default_rng(1)
    job = RenderJob.of(run.scenario, truth)
    size = STRONG * np.abs(truth.values).max(axis=(1, 2), keepdims=True)
    noise = size * (rng.standard_normal(truth.values.shape) + 1j * rng.standard_normal(truth.values.shape)) / np.sqrt(2)
    measured = replace(truth, values=truth.values + noise, deviation=np.broadcast_to(size, truth.values.shape).copy())
    account = job.play(measured).strength
    right = job.play(truth).strengths
    assert ((account.low <= right) & (right <= account.high)).sum() >= 5
    assert (account.high > account.low).all()


def test_drives_of_one_g_are_played_on_another(run: Run) -> None:
    """S of signals in full equals S of the quick way over many G, and A on A is A's own."""
    a = bare(run)
    b = replace(a, values=a.values * np.exp(0.3j * np.arange(1, 5)))
    job = RenderJob.of(run.scenario, a)
    own, crossed = job.strengths(a, a, b)[0]
    np.testing.assert_allclose(job.play(a).strengths, own, rtol=1e-12)
    np.testing.assert_allclose(job.play(a, b).strengths, crossed, rtol=1e-12)
    assert np.abs(crossed / own - 1).max() > 0.01


def test_a_g_without_a_scenario_gets_its_own_places_and_bins(run: Run) -> None:
    """The thesis' bins, 0.5 Hz apart, are none of a G at every 7 Hz; its record is 1/7 s then."""
    g = bare(run)
    sevens = replace(g, frequency=7.0 * np.arange(2, 2 + len(g.frequency)))
    found, notes = scenario_for(sevens)
    assert UNASKED in notes
    assert is_on_bins(sevens.frequency, found.sweep.duration)
    np.testing.assert_allclose(found.grid.places, [p.position[:2] for p in g.outputs], atol=1e-9)
    np.testing.assert_allclose(found.device.centres, [p.position[:2] for p in g.inputs], atol=1e-9)
    assert RenderJob.of(found, sevens).play(sevens).strengths.shape == (3, 9)


def test_another_device_is_refused(run: Run) -> None:
    g = bare(run)
    fewer = replace(g, values=g.values[:, :, :3], inputs=g.inputs[:3])
    with pytest.raises(DataError, match="9 points and 3 actuators"):
        scenario_for(fewer, run.scenario)


@pytest.mark.parametrize("option", [("--scenario", "thesis"), ("--declare", "unit='mm/V'")])
def test_options_of_a_file_are_refused_for_a_scenario(option: tuple[str, str]) -> None:
    answer = cli("render", "quick", *option)
    assert answer.code == 2
    assert option[0] in answer.err
