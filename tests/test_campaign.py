"""Campaigns on the layered engine: grids, draws, failures, resuming, other schedulers."""

from __future__ import annotations

import csv
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_runner import SMALL, cli

from forearm_fem.accuracy.estimates import short_verdict
from forearm_fem.errors import MissingExtra, ScenarioError, SolverError
from forearm_fem.questions import campaign as run
from forearm_fem.questions.campaign import CampaignResult, DrawTable, MemberJob, draws, load_campaign, run_campaign
from forearm_fem.questions.predict.run import Question
from forearm_fem.scenario import Scenario, load_scenario, parse_scenario
from forearm_fem.store import work
from forearm_fem.tissue import PRESETS

QUICK = "set = { sweep = { frequencies = [100.0, 200.0] } }\n"


class Here:
    """A stand-in for a Dask client that works in this process, in reverse order."""

    def __init__(self) -> None:
        self.ran: list[str] = []


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> Here:
    """Members run in this process; Dask itself is tested once below."""
    log = Here()

    @contextmanager
    def client(*_: object) -> Iterator[Here]:
        yield log

    def results(client: Here, do: Any, jobs: dict[str, Any]) -> Iterator[tuple[str, Any]]:
        for key, job in reversed(jobs.items()):
            client.ran.append(job.name)
            yield key, do(job)

    monkeypatch.setattr(work, "cluster", client)
    monkeypatch.setattr(work, "completed", results)
    return log


def made(folder: Path, text: str, *, head: str = QUICK) -> Path:
    (folder / "small.toml").write_text(SMALL)
    (folder / "c.toml").write_text(f'name = "c"\nscenario = "small.toml"\nstage = "solve"\n{head}{text}')
    return folder / "c.toml"


def start(file: Path, out: Path | None = None) -> CampaignResult:
    return run_campaign(load_campaign(file), out or file.parent / "out")


def test_a_grid_is_every_combination(tmp_path: Path) -> None:
    file = made(tmp_path, '[grid]\n"device.spacing" = [0.03, 0.04]\n"tissues.preset" = ["default", "zhang"]\n')
    members = load_campaign(file).members
    assert [m.name for m in members] == [
        "spacing-0.03_preset-default", "spacing-0.03_preset-zhang",
        "spacing-0.04_preset-default", "spacing-0.04_preset-zhang",
    ]  # fmt: skip
    assert members[3].scenario.device.spacing == 0.04
    assert members[3].scenario.tissues.preset == "zhang"
    assert members[3].scenario.sweep.frequencies == (100.0, 200.0)


def test_keys_without_quotes_change_what_they_name_and_nothing_beside(tmp_path: Path) -> None:
    """TOML makes a table of `device.spacing = 0.03`; it took the place of the file's whole table, without a word."""
    text = "[grid]\ndevice.spacing = [0.03, 0.04]\n[[members]]\nname = 'one'\nset = { sweep.duration = 0.3 }\n"
    members = load_campaign(made(tmp_path, text)).members
    assert [m.name for m in members] == ["spacing-0.03", "spacing-0.04", "one"]
    own = load_scenario(tmp_path / "small.toml")
    assert all(m.scenario.device.cone == own.device.cone for m in members)
    assert (members[2].scenario.sweep.frequencies, members[2].scenario.sweep.duration) == ((100.0, 200.0), 0.3)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[grid]\nname = ['a', 'b']\n", "name: a scenario is called by its member"),
        ("[[members]]\nname = 'a'\nset = { name = 'b' }\n", "name: a scenario is called by its member"),
        ("[grid]\n'sweep.frequencies' = [[100.0], [200.0]]\n", r"sweep\.frequencies is given twice, in set and"),
    ],
)  # fmt: skip
def test_no_key_of_a_campaign_is_overruled_without_a_word(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(ScenarioError, match=said):
        load_campaign(made(tmp_path, text))


def test_every_combination_of_a_grid_has_a_folder_of_its_own(tmp_path: Path) -> None:
    """Values that six digits do not tell apart, and names longer than a folder's."""
    near = load_campaign(made(tmp_path, "[grid]\n'device.spacing' = [0.04, 0.0400000001]\n")).members
    assert [m.name for m in near] == ["spacing-0.04", "spacing-0.0400000001"]
    places = [[[0.02 + 0.001 * k, 0.025], [-0.02, 0.0201], [0.021, -0.0234], [-0.0217, -0.0225]] for k in range(2)]
    text = f"[grid]\n'device.contacts' = {places}\n'tissues.override.muscle.mu' = [9876.54321, 10000.0]\n"
    names = [m.name for m in load_campaign(made(tmp_path, text)).members]
    assert len(set(names)) == 4
    assert all(len(name) <= 100 for name in names)
    assert names == [m.name for m in load_campaign(made(tmp_path, text)).members]  # the same folder next time


def test_draws_follow_the_sourced_spreads_and_the_seed() -> None:
    table = DrawTable(count=4000, seed=3, parameters=("skin.mu", "fat.eta"))
    drawn = list(draws(Scenario(), table))
    logs = np.log([[d["tissues.override.skin.mu"], d["tissues.override.fat.eta"]] for d in drawn])
    skin, fat = PRESETS["default"]["skin"].parameters["mu"], PRESETS["default"]["fat"].parameters["eta"]
    # 4000 draws: the mean of a log is known to spread / 63, its deviation to 1.1 %
    assert logs.mean(axis=0) == pytest.approx(np.log([skin.value, fat.value]), abs=0.04)
    assert np.exp(logs.std(axis=0)) == pytest.approx([skin.spread, fat.spread], rel=0.03)
    assert abs(np.corrcoef(logs.T)[0, 1]) < 0.06
    assert drawn[:5] == list(draws(Scenario(), table.model_copy(update={"count": 5})))
    assert drawn[0] != next(draws(Scenario(), table.model_copy(update={"seed": 4})))


def test_all_soft_tissues_are_drawn_by_default() -> None:
    first = next(draws(Scenario(), DrawTable(count=1)))
    assert set(first) == {f"tissues.override.{t}.{k}" for t in ("skin", "fat", "muscle") for k in ("mu", "eta")}


def test_draws_lie_about_the_scenarios_own_value() -> None:
    own = parse_scenario({"tissues": {"override": {"muscle": {"mu": 25e3}}}})
    table = DrawTable(count=2, parameters=("muscle.mu", "skin.mu"))
    preset, moved = list(draws(Scenario(), table)), list(draws(own, table))
    ratio = [[b[k] / a[k] for k in a] for a, b in zip(preset, moved, strict=True)]
    assert np.array(ratio) == pytest.approx(np.array([[2.5, 1.0]] * 2))


@pytest.mark.parametrize(
    "tissues",
    [
        {"preset": "zener"}, {"preset": "springpot"},
        {"override": {"fat": {"law": "springpot", "mu": 4e3, "exponent": 0.2}}},
    ],
)  # fmt: skip
def test_laws_whose_parameters_go_together_are_not_drawn_one_by_one(tissues: dict[str, Any]) -> None:
    """They gave members that were all alike."""
    with pytest.raises(ScenarioError, match=r"go together.*predict"):
        next(draws(parse_scenario({"tissues": tissues}), DrawTable(count=2)))


def test_one_failed_member_does_not_lose_the_rest(tmp_path: Path, here: Here) -> None:
    mesh = '{ limb = { shape = "mesh", file = "x.vtu", regions = { 1 = "fat" } } }'
    members = f'[[members]]\nname = "fine"\n[[members]]\nname = "no-layers"\nset = {mesh}\n'
    result = start(made(tmp_path, members))
    fine, failed = result.members
    assert fine.problem == ""
    assert fine.numbers["e_band"] < 1e-3  # the layered model of rigid cones states its series and its interpolation
    assert "needs layers" in failed.problem
    assert (tmp_path / "out/fine/transfer.nc").is_file()
    assert not (tmp_path / "out/no-layers").exists()
    with (tmp_path / "out/summary.csv").open(newline="") as stream:
        assert [row["member"] for row in csv.DictReader(stream)] == ["fine", "no-layers"]
    assert "needs layers" in (tmp_path / "out/summary.md").read_text()


def test_a_summary_says_what_may_be_trusted(tmp_path: Path, here: Here) -> None:
    """Numbers of members whose accuracy was not met, or whose G is hardly driven, stood beside the others unmarked."""
    members = (
        '[[members]]\nname = "fine"\n[[members]]\nname = "asks-much"\nset = { accuracy = 1e-5 }\n'
        '[[members]]\nname = "hardly-driven"\nset = { "sweep.frequencies" = [148.0, 152.0, 248.0, 252.0] }\n'
    )
    file = made(tmp_path, members, head="")
    file.write_text(file.read_text().replace('"solve"', '"render"'))
    start(file)
    with (tmp_path / "out/summary.csv").open(newline="") as stream:
        rows = {row["member"]: row for row in csv.DictReader(stream)}
    assert {name: row["verdict"] for name, row in rows.items()} == {
        "fine": "met", "asks-much": "NOT met", "hardly-driven": "met"
    }  # fmt: skip
    assert "they are not driven" in rows["hardly-driven"]["notes"]
    assert "they are not driven" in (tmp_path / "out/summary.md").read_text()
    assert short_verdict("no error estimate was made") == "UNKNOWN"


def test_finished_members_are_skipped_and_changed_ones_are_not(tmp_path: Path, here: Here) -> None:
    file = made(tmp_path, '[grid]\n"device.spacing" = [0.03, 0.04]\n')
    start(file)
    assert len(here.ran) == 2
    again = start(file)
    assert (len(here.ran), [m.reused for m in again.members]) == (2, [True, True])
    made(tmp_path, '[grid]\n"device.spacing" = [0.03, 0.04, 0.05]\n')
    assert [m.reused for m in start(file).members] == [True, True, False]
    made(tmp_path, '[grid]\n"device.spacing" = [0.03]\n', head="set = { sweep = { frequencies = [150.0] } }\n")
    assert [m.reused for m in start(file).members] == [False]


def test_a_killed_campaign_keeps_what_was_finished(tmp_path: Path, here: Here, monkeypatch: pytest.MonkeyPatch) -> None:
    file = made(tmp_path, '[grid]\n"device.spacing" = [0.03, 0.04, 0.05]\n')
    whole, calls = run.finish_member, []

    def killed(job: Any) -> Any:
        calls.append(job)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return whole(job)

    monkeypatch.setattr(run, "finish_member", killed)
    with pytest.raises(KeyboardInterrupt):
        start(file)
    assert (tmp_path / "out/summary.csv").is_file()
    monkeypatch.setattr(run, "finish_member", whole)
    assert [m.reused for m in start(file).members] == [False, False, True]


def test_a_member_that_was_begun_anew_and_killed_is_not_taken_for_its_older_self(
    tmp_path: Path, here: Here, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its files may be the newer question's already, so who asks the older one again gets them made again."""
    older = '[[members]]\nname = "one"\nset = {{ "device.spacing" = {} }}\n'
    start(made(tmp_path, older.format(0.03)))
    file = made(tmp_path, older.format(0.04))
    with monkeypatch.context() as patched:
        patched.setattr("forearm_fem.questions.campaign.member_summary", _interrupted)
        with pytest.raises(KeyboardInterrupt):
            start(file)
    assert [m.reused for m in start(made(tmp_path, older.format(0.03))).members] == [False]


def _interrupted(*_: object) -> dict[str, Any]:
    raise KeyboardInterrupt


def test_a_fault_of_the_program_is_kept_to_its_member(
    tmp_path: Path, here: Here, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object) -> None:
        raise ZeroDivisionError("oh")

    monkeypatch.setattr("forearm_fem.questions.run.run_solve", broken)
    assert "ZeroDivisionError: oh" in start(made(tmp_path, "")).members[0].problem


def test_what_is_kept_is_not_of_files_that_changed_since(tmp_path: Path) -> None:
    """A member, and a prediction's draws: their marks hold what stands in the files that the scenario names."""
    scenario = parse_scenario({"rendering": {"wavelet": {"file": "burst.csv"}}})
    job = MemberJob("a", scenario.model_dump_json(), "render", str(tmp_path), str(tmp_path / "a"))
    marks = {(job.digest, Question(scenario, tmp_path).digest)}
    for text in ("0\n1\n0\n", "0\n1\n-1\n", "0\n1\n-1\n"):
        (tmp_path / "burst.csv").write_text(text)
        marks.add((job.digest, Question(scenario, tmp_path).digest))
    assert [len(set(each)) for each in zip(*marks, strict=True)] == [3, 3]


def test_rendered_members_state_their_strengths(tmp_path: Path, here: Here) -> None:
    file = made(tmp_path, "", head="")
    file.write_text(file.read_text().replace('"solve"', '"render"'))
    numbers = start(file).members[0].numbers
    assert {"S inverse filter", "S funneling", "S combination"} <= set(numbers)
    assert all(v > 0 for name, v in numbers.items() if name not in ("verdict", "notes"))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("colour = 1\n", "colour"),
        ('[grid]\n"device.spacings" = [0.03]\n', "device.spacings: unknown key"),
        ('[grid]\n"device.spacing" = []\n', "grid.device.spacing"),
        ('[grid]\n"device.spacing" = [0.03, 0.03]\n', "twice"),
        ('[draw]\ncount = 2\nparameters = ["skin.colour"]\n', "skin.colour"),
        ("[draw]\ncount = 0\n", "draw.count"),
        ("[grid\n", "TOML"),
    ],
)
def test_a_wrong_campaign_file_is_one_sentence(tmp_path: Path, text: str, says: str) -> None:
    answer = cli("campaign", made(tmp_path, text), cwd=tmp_path)
    assert answer.code == 2
    assert says in answer.sentence
    assert not (tmp_path / "results").exists()


def test_a_missing_campaign_file_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="no such campaign file"):
        load_campaign(tmp_path / "none.toml")


def test_without_dask_members_run_here_and_who_asks_for_processes_is_told_the_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What `pip install .` gives runs the commands of the manual as they stand there."""
    monkeypatch.setitem(sys.modules, "distributed", None)
    file = made(tmp_path, '[grid]\n"device.spacing" = [0.03, 0.04]\n')
    assert [m.problem for m in start(file).members] == ["", ""]
    with pytest.raises(MissingExtra, match=r"forearm-fem\[campaign\]"):
        run_campaign(load_campaign(file), tmp_path / "again", workers=2)


def test_memory_limits_the_workers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    campaign = load_campaign(made(tmp_path, '[grid]\n"device.spacing" = [0.03, 0.04, 0.05]\n'))
    jobs = [run._job(campaign, m, tmp_path) for m in campaign.members]
    monkeypatch.setattr(run.os, "cpu_count", lambda: 64)
    for free, workers in ((0.1e9, 1), (1.6e9, 2), (100e9, 3)):
        monkeypatch.setattr(run.psutil, "virtual_memory", lambda free=free: type("M", (), {"available": free}))
        assert run.member_workers(campaign, jobs) == workers


def test_no_scheduler_at_the_address_is_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(work, "PATIENCE", 0.5)
    file = made(tmp_path, "")
    with pytest.raises(SolverError, match="no Dask scheduler"):
        run_campaign(load_campaign(file), tmp_path / "out", scheduler="tcp://127.0.0.1:1")


@pytest.mark.usefixtures("ctrl_c")
@pytest.mark.parametrize("moment", ["starts", "ends"])
def test_ctrl_c_waits_for_processes_that_start_or_end(moment: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is cut off half way cannot be closed any more: Dask then prints tracebacks at the exit."""
    distributed = pytest.importorskip("distributed")
    seen: list[str] = []

    class StandIn:
        def __init__(self, *_: object, **__: object) -> None:
            if moment == "starts":
                signal.raise_signal(signal.SIGINT)
            if hasattr(signal, "pthread_sigmask"):  # what starts now does not hear the terminal
                assert signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ())
            seen.append("started")

        def __enter__(self) -> StandIn:
            return self

        def __exit__(self, *_: object) -> None:
            if moment == "ends":
                signal.raise_signal(signal.SIGINT)
            seen.append("ended")

    monkeypatch.setattr(distributed, "LocalCluster", StandIn)
    monkeypatch.setattr(distributed, "Client", StandIn)
    with pytest.raises(KeyboardInterrupt), work.cluster(None, 1, "a campaign"):
        assert moment == "ends", "the work is not begun"
    assert seen == ["started", "started", "ended", "ended"]


@pytest.mark.filterwarnings("ignore")  # Dask's own
@pytest.mark.slow
def test_dask_processes_here_and_by_address(tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    file = made(tmp_path, '[grid]\n"device.spacing" = [0.03, 0.04]\n')
    answer = cli("campaign", file, "--out", tmp_path / "out", "--workers", 1, cwd=tmp_path)
    assert answer.code == 0, answer.err
    assert "spacing-0.04" in answer.out
    assert "cheduler" not in answer.err  # Dask's comings and goings
    with distributed.LocalCluster(n_workers=1, processes=False, dashboard_address=None) as cluster:
        there = run_campaign(load_campaign(file), tmp_path / "there", scheduler=cluster.scheduler_address)
    assert [m.problem for m in there.members] == ["", ""]
