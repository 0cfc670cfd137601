"""Predictions on the layered model: what noise and belief do to S, resuming, processes, statistics by hand, the
command."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from cli_runner import cli
from scipy import stats

from forearm_fem.device import close_loop
from forearm_fem.engines.layered import Answer, LayeredArm
from forearm_fem.errors import DataError, ScenarioError
from forearm_fem.measurement.chain import reported
from forearm_fem.metrics import signal_strength
from forearm_fem.questions.predict import run as runs
from forearm_fem.questions.predict import statistics as numbers
from forearm_fem.questions.predict.arm import arm_model
from forearm_fem.questions.predict.draws import (
    draw_inputs,
    kept_tissues,
    load_priors,
    measured_of,
    moved_points,
    scenario_of,
)
from forearm_fem.questions.predict.run import Prediction, Question, check_question, drivers_of, outcome_of, predict
from forearm_fem.questions.predict.statistics import shorter_waves, summary
from forearm_fem.rendering import displacements, drives, strengths
from forearm_fem.results.draws import DRAWS_FILE, KEPT, READINGS, DrawsFile, Outcome
from forearm_fem.scenario import parse_scenario
from forearm_fem.scenario.model import resolve_tissues
from forearm_fem.scenario.sweep import frequencies
from forearm_fem.show.data import Results
from forearm_fem.show.facts import strength_block
from forearm_fem.show.prediction import _numerics, _scope, lead_of, strength_words
from forearm_fem.store import work as store_work
from forearm_fem.store.record import load
from forearm_fem.store.shelf import WORK, Shelf
from forearm_fem.store.text import read_json
from forearm_fem.transfer import ErrorEstimate

# 50 bins, two targets and pressure discs: a draw in 0.1 s of an idle machine
SMALL = {
    "engine": "layered",
    "sweep": {"duration": 0.1},
    "rendering": {"targets": ["5", "1"]},
    "device": {"cone": {"contact": "pressure"}},
}
TOML = """engine = "layered"
name = "small"
sweep = { duration = 0.1 }
rendering = { targets = ["5", "1"] }
device = { cone = { contact = "pressure" } }
"""
SCENE = parse_scenario(SMALL)
N = numbers.LEAST


def question(held: tuple[str, ...] = ("measurement",), **changes: Any) -> Question:
    """By default without a rig, whose points lie elsewhere in each draw: six times the work."""
    return Question(SCENE, Path(), held=held, **changes)


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> tuple[Prediction, Path]:
    folder = tmp_path_factory.mktemp("prediction")
    return predict(question(), folder, draws=N, workers=1), folder


def test_an_interrupted_prediction_goes_on_with_the_same_numbers(
    found: tuple[Prediction, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, _ = found

    def stop(stage: str, done: int, total: int) -> None:
        if stage == "draws" and done == 7:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        predict(question(), tmp_path, draws=N, workers=1, progress=stop)
    assert len(Shelf(tmp_path / WORK).known()) == 1 + 7  # the scene itself, and draws
    assert not (tmp_path / DRAWS_FILE).exists()
    monkeypatch.setattr(runs, "simulate", lambda *asked, **how: pytest.fail("the scene itself was solved again"))
    again = predict(question(), tmp_path, draws=N, workers=1)
    assert again.reused == 7
    assert np.array_equal(again.draws.strengths, whole.draws.strengths)
    assert np.array_equal(again.draws.drivers, whole.draws.drivers)
    assert np.array_equal(again.nominal.low, whole.nominal.low)


def test_other_processes_give_the_same_numbers(
    found: tuple[Prediction, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Dask itself is tested with campaigns: here jobs come back from a worker's function in another order."""
    whole, folder = found

    @contextmanager
    def nobody(*_: object) -> Iterator[None]:
        yield None

    def backwards(_: object, work: Any, jobs: dict[str, Any]) -> Iterator[tuple[str, Any]]:
        for key in reversed(jobs):
            yield key, work(jobs[key])

    monkeypatch.setattr(store_work, "cluster", nobody)
    monkeypatch.setattr(store_work, "completed", backwards)
    other = predict(question(), tmp_path, draws=N, workers=2)
    assert np.array_equal(other.draws.strengths, whole.draws.strengths)
    assert other.draws.laws == whole.draws.laws
    one, two = (load(place / DRAWS_FILE, DrawsFile).outcomes[1].transfer for place in (folder, tmp_path))
    assert one is not None
    assert np.array_equal(one, two)


def test_finished_draws_are_not_made_again_and_other_questions_are_not_taken(
    found: tuple[Prediction, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, folder = found
    monkeypatch.setattr(runs, "drawn", lambda *_: pytest.fail("a finished draw was made again"))
    assert predict(question(), folder, draws=N, workers=1).reused == N
    others = (question(seed=1), question(laws=("zener",)), question(held=("tissue",)))
    assert len({question().digest, *(other.digest for other in others)}) == 4
    with pytest.raises(pytest.fail.Exception, match="a finished draw was made again"):
        predict(others[0], folder, draws=N, workers=1)
    assert whole.reused == 0


def test_draws_of_another_question_are_kept_beside(found: tuple[Prediction, Path], tmp_path: Path) -> None:
    whole, folder = found
    (tmp_path / WORK).write_bytes((folder / WORK).read_bytes())
    assert predict(question(held=("measurement", "actuator")), tmp_path, draws=N, workers=1).reused == 0
    again = predict(question(), tmp_path, draws=N, workers=1)
    assert again.reused == N
    assert np.array_equal(again.draws.strengths, whole.draws.strengths)


def prepared(asked: Question) -> Any:
    return runs._prepared(runs._plain(asked))


def test_without_a_rig_drives_play_as_reported() -> None:
    asked, job, arm = prepared(question())
    quiet = outcome_of(draw_inputs(load_priors(), SCENE, 3, 0), asked.scenario, asked.held, job, arm).strengths
    at = {name: quiet[k] for k, name in enumerate(READINGS)}
    assert np.array_equal(at["reported"], at["played"])
    assert np.array_equal(at["reported, record"], at["played, record"])
    louder, loud_job, _ = prepared(question(held=()))
    loud = outcome_of(draw_inputs(load_priors(), SCENE, 3, 0), louder.scenario, louder.held, loud_job, arm).strengths
    assert not np.allclose(loud[0], loud[1], rtol=1e-6)
    # the true arm is the same, noise or not: funneling does not look at G
    # (solved with the rig's points beside its own, within the layered model's tolerance)
    assert loud[0][job.names.index("funneling")] == pytest.approx(
        quiet[0][job.names.index("funneling")], rel=1e-4
    )


def test_an_outcome_by_hand() -> None:
    """Drives are designed on the G that the rig reports, of the places that the laser met, and play on the true one."""
    asked, job, arm = prepared(question(held=()))
    draw = draw_inputs(load_priors(), SCENE, 3, 1)
    found = outcome_of(draw, asked.scenario, asked.held, job, arm).strengths
    moved = scenario_of(draw, SCENE)
    seen = measured_of(draw, moved)
    assert not np.allclose(seen.grid.places, moved.grid.places, atol=1e-4)
    answer, there = arm.answers(moved, seen, frequencies(moved.sweep))
    alone = arm.compliance(seen, frequencies(seen.sweep))
    assert [p.position for p in there.ports] == [p.position for p in alone.ports]
    # solved with the points of the true grid beside them: the model's own tolerance of 1e-3
    assert np.nanmax(np.abs(there.values - alone.values)) < 2e-3 * np.nanmax(np.abs(alone.values))
    true, met = (
        replace(close_loop(c, moved.device), outputs=job.ports[0], inputs=job.ports[1])
        for c in (answer.compliance, there)
    )
    measured = reported(met, seen, draw.generator("rig"))
    by_hand = strengths(measured, job.targets, job.methods, job.wavelet)
    assert found[READINGS.index("reported")] == pytest.approx(by_hand, rel=1e-9)
    for m, method in enumerate(job.methods):
        for t, target in enumerate(job.targets):
            motion = displacements(true, drives(method, measured, target, job.wavelet))
            played = signal_strength(motion.values, motion.target_index, time=motion.time, window=job.span)
            assert found[READINGS.index("played"), m, t] == pytest.approx(played, rel=1e-9)
            record = signal_strength(motion.values, motion.target_index)
            assert found[READINGS.index("played, record"), m, t] == pytest.approx(record, rel=1e-9)


def test_renderers_believe_the_grid_where_it_was_laid_out() -> None:
    """The arm's points are moved, the ports that renderers see are not."""
    _, job, arm = prepared(question())
    draw = draw_inputs(load_priors(), SCENE, 3, 1)
    moved = scenario_of(draw, SCENE)
    compliance = arm.compliance(moved, np.array([100.0]))
    true = [p.position[:2] for p in compliance.ports if p.kind == "point"]
    assert np.allclose(true, moved_points(SCENE, draw.values))
    assert np.allclose([p.position[:2] for p in job.ports[0]], SCENE.grid.places)
    assert not np.allclose(true, SCENE.grid.places, atol=1e-4)


def test_the_arm_model_states_its_error_and_keeps_it() -> None:
    """A rigid cone with tension: fewer terms against the layered model as it solves a scene."""
    from forearm_fem.engines.layered import solve_layered

    scene = parse_scenario({"engine": "layered", "tissues": {"membrane": {"tension": 40.0}}, "limb": {"bones": []}})
    band = np.array([60.0, 250.0, 310.0, 380.0, 500.0])
    fast, truth = LayeredArm().compliance(scene, band), solve_layered(scene, band)
    difference = np.nanmax(np.abs(fast.values - truth.values), axis=(1, 2))
    assert (difference / np.nanmax(np.abs(truth.values), axis=(1, 2)) <= np.array(fast.errors[0].per_frequency)).all()
    assert fast.errors[0].band < 0.05
    assert "solved by finite elements" in arm_model(parse_scenario({}), layered=True).left_out
    assert "solved by finite elements" not in arm_model(scene).left_out


def test_an_arm_that_few_orders_do_not_answer_is_asked_with_more() -> None:
    """Little loss and a grid laid out towards a cone: of three orders 19 % is stated, of five .1 %."""
    scene = parse_scenario({"engine": "layered"})
    inputs = draw_inputs(load_priors(), scene, 0, 147)
    inputs = replace(inputs, values={**inputs.values, "skin tension": 30.0})
    draw = scenario_of(inputs, scene, {"fascia thickness", "fascia modulus"})
    band = np.array([440.0, 474.0, 500.0])
    found = LayeredArm().compliance(draw, band)
    assert found.errors[0].band < 0.05
    rough = LayeredArm(orders=(3,)).compliance(draw, band)
    assert rough.errors[0].band > 0.1
    change = np.nanmax(np.abs(rough.values - found.values), axis=(1, 2))
    size = np.nanmax(np.abs(found.values), axis=(1, 2))
    assert (change / size <= np.array(rough.errors[0].per_frequency)).all()


def test_an_arm_that_cannot_be_is_data(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = question(held=("measurement",))
    asked, job, arm = prepared(asked)

    def broken(*_: object) -> None:
        raise ScenarioError("no such arm")

    monkeypatch.setattr(LayeredArm, "compliance", broken)
    lost = runs.drawn(asked, job, arm, 4)
    assert (lost.problem, lost.number) == ("no such arm", 4)
    assert np.isnan(lost.strengths).all()
    good = [replace(lost, number=k, problem="", strengths=np.ones_like(lost.strengths)) for k in range(N - 1)]
    with pytest.raises(DataError, match=f"needs {N} draws with S, got {N - 1}; raise --draws; the.*no such arm"):
        numbers.draws_of([*good, lost], job.names, job.targets)


@pytest.mark.parametrize("band", [1.0, float("nan")])
def test_an_arm_whose_error_is_as_large_as_its_g_is_left_out_and_counted(
    band: float, found: tuple[Prediction, Path]
) -> None:
    """Its S would be noise, or unknown; the report says how many such arms there were."""
    asked = question(held=("measurement",))
    asked, job, arm = prepared(asked)

    class Poor(LayeredArm):
        def compliance(self, scenario: Any, frequency: Any) -> Any:
            found = arm.compliance(scenario, frequency)
            return replace(found, errors=(ErrorEstimate("reduction", band, "stated here"),))

    lost = runs.drawn(asked, job, Poor(), 4)
    assert "may be wrong by as much as it is" in lost.problem
    one = runs.drawn(asked, job, arm, 4)
    good = [replace(one, number=k) for k in range(N)]
    draws = numbers.draws_of([*good, replace(lost, number=N), replace(lost, number=N + 1)], ("a",) * 3, ("5", "1"))
    assert (len(draws.numerics), dict(draws.problems)) == (N, {lost.problem: 2})
    told = summary(replace(found[0], draws=replace(found[0].draws, problems=draws.problems)), sobol=False)
    assert "2 arms more without S left out" in lead_of(told)
    assert f"Left out, 2 of {N + 2} arms: {lost.problem}" in _scope(told)
    assert f"Of {N + 2} arms 2 are left out" in _numerics(told)


def test_an_arm_of_larger_error_has_a_wider_interval_of_s() -> None:
    asked = question(held=("measurement",))
    asked, job, arm = prepared(asked)

    class Stated(LayeredArm):
        def compliance(self, scenario: Any, frequency: Any) -> Any:
            found = arm.compliance(scenario, frequency)
            return replace(found, errors=(ErrorEstimate("reduction", self.band, "stated here"),))

    fine, poor = (type("S", (Stated,), {"band": band})() for band in (0.001, 0.01))
    one, ten = (runs.drawn(asked, job, model, 4) for model in (fine, poor))
    assert np.array_equal(one.strengths, ten.strengths)
    assert (ten.spread > 6 * one.spread).all()  # the same noise ten times as large: 10 where log S is linear in it


def test_an_error_of_known_shape_is_no_noise() -> None:
    """What a model says it may be as well sets the interval, and the estimate of that source does not count twice."""
    asked = question(held=("measurement",))
    asked, job, arm = prepared(asked)

    class Shaped(LayeredArm):
        def answer(self, scenario: Any, frequency: Any) -> Answer:
            found = arm.compliance(scenario, frequency)
            found = replace(found, errors=(ErrorEstimate("interpolation", 0.3, "stated here"),))
            return Answer(found, (replace(found, values=self.factor * found.values),), frozenset({"interpolation"}))

    f = np.linspace(0.8, 1.2, len(frequencies(SCENE.sweep)))[:, None, None]
    same, other = (type("S", (Shaped,), {"factor": factor})() for factor in (1.0, f))
    sure, unsure = (runs.drawn(asked, job, model, 4) for model in (same, other))
    assert sure.numerics == unsure.numerics >= 0.3
    assert (sure.spread == 0).all()
    assert (unsure.spread > 1e-4).all()


def test_arms_of_shorter_waves_than_the_mesh_was_made_for_are_told(found: tuple[Prediction, Path]) -> None:
    whole, _ = found
    assert shorter_waves(whole) is None  # the layered model has no mesh
    scene, drivers = parse_scenario({}), np.array(whole.draws.drivers)
    for tissue, soft in (("skin", 9.0), ("muscle", 9.0), ("fat", 0.25)):  # half as long in every second arm's fat
        own = abs(complex(resolve_tissues(scene)[tissue].modulus.at(2 * np.pi * 150.0)))
        drivers[:, whole.draws.names.index(f"{tissue} stiffness")] = own * np.where(np.arange(N) % 2, soft, 9.0)
    asked, draws = replace(whole.question, scenario=scene), replace(whole.draws, drivers=drivers)
    assert shorter_waves(replace(whole, question=asked, draws=draws)) == {"share": 0.5, "factor": pytest.approx(2.0)}
    told = {**summary(whole, sobol=False), "shorter_waves": {"share": 0.5, "factor": 2.0}}
    assert "50% of the arms have shorter waves in some tissue, one in twenty by a factor of 2 or" in _numerics(told)


def test_an_interruption_before_the_first_draw_leaves_what_is_solved(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stop(*_: object, **how: object) -> Outcome:
        raise KeyboardInterrupt

    monkeypatch.setattr(runs, "drawn", stop)
    with pytest.raises(KeyboardInterrupt):
        predict(question(), tmp_path, draws=N, workers=1)
    assert len(Shelf(tmp_path / WORK).known()) == 1
    monkeypatch.setattr(runs, "simulate", stop)
    with pytest.raises(KeyboardInterrupt):
        predict(question(), tmp_path / "nothing", draws=N, workers=1)
    assert not (tmp_path / "nothing").exists()


def test_quantiles_by_hand() -> None:
    values = np.arange(101.0)[::-1, None] + np.array([0.0, 1000.0])
    assert numbers.quantiles(values) == pytest.approx(np.array([5, 25, 50, 75, 95])[:, None] + np.array([0, 1000.0]))
    bare = numbers.IntervalSamples(values, values, values)
    assert bare.quantiles() == pytest.approx(numbers.quantiles(values))
    assert bare.judged(np.array([4.9, 1095.0]))[0].tolist() == [False, True]


def test_what_numerics_may_do_to_an_arm_widens_the_band_and_never_narrows_it() -> None:
    values = np.arange(1.0, 102)[:, None]
    spread = np.where(values <= 10, math.log(2), 0.0)  # low arms alone are uncertain by a factor of two
    arms = numbers.IntervalSamples(values, values * np.exp(-spread), values * np.exp(spread))
    assert arms.quantiles()[:, 0] == pytest.approx([3.0, 26.0, 51.0, 76.0, 96.0])  # 6 is halved, the others stay
    assert arms.above(8.0)[:, 0] == pytest.approx(np.array([91, 93, 97]) / 101)
    both = numbers.IntervalSamples(values, values / 2, values * 2)
    assert (both.quantiles()[[0, -1]] / arms.quantiles()[[0, -1]])[:, 0] == pytest.approx([1.0, 2.0])
    targets = both.of_groups({"Middle (5)": [0]})
    assert (targets.high / targets.low == 4).all()


def test_a_verdict_that_other_draws_may_not_repeat_is_not_sure() -> None:
    """A share of 5 % of 101 arms is known within 1.96 sqrt(.05 .95 / 101) = 4.25 %."""
    values = np.arange(101.0)[:, None]
    arms = numbers.IntervalSamples(values, values, values)
    told = {x: tuple(bool(v[0]) for v in arms.judged(np.array([x]))) for x in (0.5, 4.0, 6.0, 9.0, 10.0, 95.5, 99.5)}
    assert told == {
        0.5: (False, True), 4.0: (False, False), 6.0: (True, False), 9.0: (True, False), 10.0: (True, True),
        95.5: (False, False), 99.5: (False, True),
    }  # fmt: skip
    unsure = numbers.IntervalSamples(
        values, 0.5 * values, 2 * values
    )  # 15 is inside, unless numerics double the low arms
    assert [bool(v[0]) for v in unsure.judged(np.array([15.0]))] == [True, False]
    few = numbers.IntervalSamples(values[:20], values[:20], values[:20])
    assert not few.judged(np.array([-1.0]))[1].any()  # outside all of 20 arms: an end of their band is not known


def test_groups_and_winners_by_hand() -> None:
    assert numbers.group_columns(["1", "2", "5", "9"]) == {
        "Middle (5)": [2], "Edges (2/4/6/8)": [1], "Corners (1/3/7/9)": [0, 3],
    }  # fmt: skip
    assert numbers.group_columns(["1", "17"]) == {"All": [0, 1]}
    assert numbers.group_columns(["1", "2", "5", "9"], counted=("2", "9")) == {
        "Edges (2/4/6/8)": [1],
        "Corners (1/3/7/9)": [3],
    }  # points beside a motor are in no group
    assert numbers.group_columns(["1", "2", "3", "4"], thesis_grid=False) == {"All": [0, 1, 2, 3]}  # of 2 x 2 points
    s = np.array([[[1.0, 2.0, 3.0, 5.0]], [[2.0, 2.0, 2.0, 4.0]]])
    assert numbers.group_means(s, numbers.group_columns(["1", "2", "5", "9"]))[:, 0].tolist() == [[3, 2, 3], [2, 2, 3]]
    duel = np.array([[[3.0], [1.0]], [[1.0], [2.0]], [[2.0], [2.0]], [[5.0], [4.0]]])
    assert numbers.winners(duel)[:, 0].tolist() == [0.625, 0.375]


def test_rank_correlations_are_spearmans() -> None:
    rng = np.random.default_rng(2)
    x, y = rng.standard_normal((60, 3)), rng.standard_normal((60, 2, 1))
    y[:, 0, 0] += 2 * x[:, 1] ** 3
    x = np.column_stack([x, np.ones(60)])
    found = numbers.rank_correlations(x, y)
    for i in range(3):
        for j in range(2):
            assert found[i, j, 0] == pytest.approx(stats.spearmanr(x[:, i], y[:, j, 0]).statistic)
    assert np.isnan(found[3]).all()


def test_sobol_indices_of_a_linear_logarithm() -> None:
    pytest.importorskip("SALib")
    x = np.random.default_rng(0).standard_normal((1000, 3))
    y = np.exp(2 * x[:, 0] + x[:, 1])[:, None]
    found = numbers.sobol_indices(np.column_stack([x, np.zeros(1000)]), list("abcd"), y)[:, 0]
    assert found[:3] == pytest.approx([0.8, 0.2, 0.0], abs=0.06)  # 1/sqrt(1000) of sampling, twice over
    assert np.isnan(found[3])
    assert np.isnan(numbers.sobol_indices(x[:50], list("abc"), y[:50])).all()


def test_joint_distance_knows_correlation() -> None:
    z = np.random.default_rng(1).standard_normal((4000, 2))
    cloud = np.exp(np.column_stack([z[:, 0], 0.95 * z[:, 0] + np.sqrt(1 - 0.95**2) * z[:, 1]]))
    along, across = np.exp([1.5, 1.5]), np.exp([1.5, -1.5])  # both within each band of 90 %
    arms = numbers.IntervalSamples(cloud, cloud, cloud)
    assert arms.judged(along)[0].all()
    assert arms.judged(across)[0].all()
    assert numbers.joint_distance(cloud, along)[1] > 0.2
    distance, beyond = numbers.joint_distance(cloud, across)
    assert beyond == 0
    # sqrt(2) 1.5 / sqrt(1 - r) over the median radius sqrt(2 ln 2) of a plane normal
    assert distance == pytest.approx(1.5 * math.sqrt(2 / 0.05) / math.sqrt(2 * math.log(2)), rel=0.05)


def test_numerics_and_arms_are_never_mixed(found: tuple[Prediction, Path]) -> None:
    whole, _ = found
    content = summary(whole, sobol=False)
    cell = content["by_target"]["funneling"]["5"]
    m, t = whole.nominal.methods.index("funneling"), whole.nominal.targets.index("5")
    expected = [whole.nominal.value[m, t], whole.nominal.low[m, t], whole.nominal.high[m, t]]
    assert [cell["value"], cell["low"], cell["high"]] == pytest.approx(expected, abs=1e-6)
    m, t = whole.draws.methods.index("funneling"), whole.draws.targets.index("5")
    column, spread = whole.draws.reading("played")[:, m, t], whole.draws.spread[:, m, t]
    assert (spread > 0).all()
    assert cell["bare"] == pytest.approx(np.quantile(column, [0.05, 0.25, 0.5, 0.75, 0.95]), abs=1e-6)
    ends = np.quantile(column * np.exp(-spread), 0.05), np.quantile(column * np.exp(spread), 0.95)
    assert [cell["arms"][0], cell["arms"][2], cell["arms"][-1]] == pytest.approx(
        [ends[0], np.median(column), ends[1]], abs=1e-6
    )
    wider = replace(whole, nominal=replace(whole.nominal, low=whole.nominal.low / 2, high=whole.nominal.high * 2))
    assert summary(wider, sobol=False)["by_target"]["funneling"]["5"]["arms"] == cell["arms"]
    words = strength_words({"value": 1.31, "low": 1.298, "high": 1.318, "arms": [0.7, 0.9, 1.2, 1.5, 1.8]})
    assert words == "1.31 (numerics 1.30-1.32, arms 0.70-1.80)"
    unknown = strength_words({"value": 1.31, "low": None, "high": None, "arms": [0.7, 0.9, 1.2, 1.5, 1.8]})
    assert unknown == "1.31 (numerics unknown, arms 0.70-1.80)"


def test_what_is_held_moves_nothing(found: tuple[Prediction, Path]) -> None:
    everything = (
        "tissue", "thickness", "tension", "fascia", "contact", "actuator", "housing", "placement", "measurement",
    )  # fmt: skip
    asked, job, arm = prepared(question(held=everything))
    two = [outcome_of(draw_inputs(load_priors(), SCENE, 0, k), asked.scenario, asked.held, job, arm) for k in (0, 1)]
    assert np.array_equal(two[0].strengths, two[1].strengths)
    assert dict(two[0].drivers) == {}
    assert {"fat stiffness", "skin loss", "contact spring A1"} <= set(found[0].draws.names)


def test_draws_are_read_back_and_damage_is_told(found: tuple[Prediction, Path], tmp_path: Path) -> None:
    whole, folder = found
    file = load(folder / DRAWS_FILE, DrawsFile)
    back = file.outcomes
    assert file.question == question().digest
    assert [o.number for o in back] == list(range(N))
    assert np.array_equal([o.strengths for o in back], whole.draws.strengths)
    assert isinstance(back[0], Outcome)
    kept = [o.transfer for o in back if o.number < KEPT]
    assert all(g is not None and np.isfinite(g).all() and g.shape == kept[0].shape for g in kept)
    assert np.abs(kept[1] - kept[0]).max() > 0.01 * np.abs(kept[0]).max()  # another arm, another G
    with h5py.File(folder / DRAWS_FILE) as file:
        assert file["G"].attrs["units"] == "m/V"
    content = bytearray((folder / DRAWS_FILE).read_bytes())
    content[len(content) // 2] ^= 0x40
    (tmp_path / DRAWS_FILE).write_bytes(content)
    with pytest.raises(DataError):
        load(tmp_path / DRAWS_FILE, DrawsFile)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"held": ("skin",)}, "--hold: no input or group is called 'skin'; groups are actuator, contact"),
        ({"laws": ("maxwell",)}, "--law: no law is called 'maxwell'; known are kelvin-voigt, zener, springpot"),
        ({"laws": ()}, "--law: expected at least one of"),
    ],
)
def test_bad_questions_are_one_sentence(changes: dict[str, Any], message: str, tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match=message):
        predict(question(**changes), tmp_path, draws=N)
    assert not list(tmp_path.iterdir())


def test_a_lost_wavelet_is_a_bad_question_whatever_the_engine() -> None:
    """Models of finite elements take minutes to make, before the first S asks for the wavelet."""
    scene = parse_scenario({**SMALL, "engine": "fem", "rendering": {"wavelet": {"file": "lost.csv"}}})
    with pytest.raises(DataError, match=r"lost\.csv"):
        check_question(Question(scene, Path()))


def test_scenes_without_s_are_refused(tmp_path: Path) -> None:
    mesh = parse_scenario({"limb": {"shape": "mesh", "file": "a.msh", "regions": {"1": "skin"}}})
    with pytest.raises(ScenarioError, match=r"limb\.shape: 'mesh' has no layers to draw arms from"):
        predict(Question(mesh, Path()), tmp_path, draws=N)
    for rendering, message in (({"methods": []}, "no S to predict"), ({"zeros": "search"}, "takes days")):
        scene = parse_scenario({**SMALL, "rendering": rendering})
        with pytest.raises(ScenarioError, match=message):
            predict(Question(scene, Path()), tmp_path, draws=N)


def test_the_command_writes_report_pictures_and_numbers(tmp_path: Path) -> None:
    (tmp_path / "small.toml").write_text(TOML)
    asked = ("predict", "small.toml", "--draws", N, "--workers", 1, "--out", "out", "--law", "zener", "--no-sobol")
    answer = cli(*asked, "--hold", "measurement", cwd=tmp_path)
    assert answer.code == 0, answer.err
    folder = tmp_path / "out" / "prediction"
    names = {"draws.nc", "prediction.json", "prediction.md", "prediction.html"}
    assert names | {"figures", "SHA256SUMS"} <= {p.name for p in folder.iterdir()}
    assert {p.name for p in (folder / "figures").iterdir()} == {
        "bands.png", "methods.png", "drivers.png", "bands.csv", "drivers.csv",
    }  # fmt: skip
    text = (folder / "prediction.md").read_text()
    assert "two seconds" not in text  # the thesis' record; this scene's is shorter
    content = read_json(folder / "prediction.json")
    cell = content["by_target"]["combination"]["1"]
    assert strength_words(cell) in text
    assert strength_words(cell) in answer.out
    assert "flat layers without end" in text
    assert (content["laws"], content["draws"], content["failed"]) == (["zener"], N, {})
    assert cli("run", "small.toml", "--out", "out", cwd=tmp_path).code == 0
    assert Results.open(tmp_path / "out").prediction == content
    report, table = (tmp_path / "out" / "report.html").read_text(), content["by_group"]["combination"]
    assert f"<td>{strength_words(cell)}</td>" in report  # the same S, its numerics and the arms beside it
    low, high = table["Corners (1/3/7/9)"]["arms"][0], table["Corners (1/3/7/9)"]["arms"][-1]
    told = strength_block(Results.open(tmp_path / "out"))
    assert any(f"arms {low:.2f}-{high:.2f})" in row[2] for row in told.rows)
    assert "Never add the two" in report
    assert cli("run", "small.toml", "--set", "device.spacing=0.05", "--out", "out", cwd=tmp_path).code == 0
    assert "(numerics" not in (tmp_path / "out" / "report.html").read_text()  # of another scene: not quoted
    bad = cli("predict", "small.toml", "--hold", "bones", cwd=tmp_path)
    assert bad.code == 2
    assert "--hold: no input or group is called 'bones'" in bad.err


def test_what_the_limb_has_not_and_what_is_held_drives_nothing() -> None:
    """Chance made fat's stiffness a driver of S on a limb without fat, and the law one where tissues were held."""
    layers = [{"tissue": "dermis", "thickness": 1.2e-3}]
    limb = {"shape": "slab", "length": 0.12, "width": 0.12, "depth": 0.04, "layers": layers}
    dermis = {"mu": 2e4, "eta": 4.0, "density": 1100.0, "bulk": "incompressible"}
    scene = parse_scenario({**SMALL, "limb": limb, "tissues": {"override": {"dermis": dermis}}})
    draw = draw_inputs(load_priors(), scene, 0, 0)
    names = drivers_of(draw, scenario_of(draw, scene), ())
    assert {"muscle stiffness", "muscle loss", "skin tension"} <= set(names)
    assert not [n for n in names if n.startswith(("fat", "skin s", "skin thickness", "skin loss"))]
    assert kept_tissues(scene) == ("dermis",)
    held = drivers_of(draw, scenario_of(draw, scene, {"tissue"}), {"tissue"})
    rows = [
        Outcome(k, law, np.ones((4, 1, 1)), held, 0.0, 0.0, spread=np.zeros((1, 1)))
        for k, law in enumerate(("zener", "springpot") * 10)
    ]
    assert "law" not in numbers.draws_of(rows, ["m"], ["5"]).names


@pytest.mark.parametrize(
    ("device", "idle"),
    [
        ({}, set()),
        ({"housing": {"fixed": True}}, {"housing mass", "strap stiffness", "housing share"}),
        ({"out_of_contact": ["A1"]}, {"contact spring A1"}),
        ({"out_of_contact": ["A1"], "housing": {"fixed": True}}, {"contact spring A1", "gain A1", "housing mass"}),
        ({"out_of_contact": ["A1"], "drive": "displacement"}, {"contact spring A1", "gain A1"}),
        ({"drive": "displacement"}, {"moving mass", "coil quality", "coil resonance", "housing mass", "housing share"}),
        ({"drive": "force"}, {"moving mass", "strap stiffness", "contact spring A1", "contact spring A2"}),
    ],
)
def test_what_g_does_not_hang_on_drives_nothing(device: dict[str, Any], idle: set[str]) -> None:
    """Chance made the housing's mass a driver of S where displacements were given and no housing moved."""
    scene = parse_scenario({**SMALL, "device": {"cone": {"contact": "pressure"}, **device}})
    draw = draw_inputs(load_priors(), scene, 0, 0)
    arm = scenario_of(draw, scene)
    left = set(drivers_of(draw, arm, ()))
    assert idle <= set(draw.values)
    assert not idle & left
    compliance = LayeredArm().compliance(arm, np.array([50.0, 200.0]))
    here = close_loop(compliance, arm.device).values
    parts = ("moving", "coil", "housing", "strap", "contact spring", "gain")
    for name in (n for n in draw.values if n.startswith(parts)):
        other = scenario_of(replace(draw, values={**draw.values, name: 0.5 * draw.values[name]}), scene)
        change = abs(close_loop(compliance, other.device).values - here).max()
        assert (name in left) == (change > 1e-9 * abs(here).max()), name


def test_advice_can_be_followed_and_held_tissues_are_not_drawn(found: tuple[Prediction, Path]) -> None:
    """Groups that were held already were advised to be held; held tissues were said to have equally likely laws."""
    data = summary(found[0], sobol=False)

    def words(told: dict[str, Any]) -> str:
        return "\n".join((_numerics(told), *_scope(told)))

    wide = {**data, "numerics": {**data["numerics"], "factor": 2.0}}
    assert "(--hold thickness --hold contact --hold placement), or ask for a finer mesh" in words(wide)
    assert "(--hold placement), or ask" in words({**wide, "held": ["contact", "thickness"]})
    all_of_it = words({**wide, "held": ["contact", "placement", "thickness", "tissue"]})
    assert "--hold" not in all_of_it
    assert "ask for a finer mesh" in all_of_it
    assert "equally likely" not in all_of_it
    assert "in every arm: dermis, for only" in words({**data, "kept_tissues": ["dermis"]})


def test_what_cutting_the_limb_errs_by_is_said_to_be_in_no_band() -> None:
    """A run states it for its scene; no arm on finite elements did, and nothing said so."""
    arm = type("Arm", (), {"unknown": ""})()
    ends = ErrorEstimate("truncation", 0.027, "")
    assert runs._unknown(arm, ()) == ""
    assert "for each arm is unknown (an e_band of 2.7e-02 of the scene's own G)" in runs._unknown(arm, (ends,))
    assert runs._unknown(LayeredArm(), (ends,)) == ""
