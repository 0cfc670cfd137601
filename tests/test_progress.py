"""One signature of progress: every function that takes it takes the same."""

import ast
import time
from pathlib import Path

import pytest

import forearm_fem
from forearm_fem.cli import display
from forearm_fem.progress import Journey, tell, within

PACKAGE = Path(forearm_fem.__file__).parent


def annotations():
    """(place, annotation) of every parameter and field called progress."""
    for file in sorted(PACKAGE.rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.arg) and node.arg == "progress" and node.annotation:
                yield f"{file.name}:{node.lineno}", ast.unparse(node.annotation)
            if isinstance(node, ast.AnnAssign) and ast.unparse(node.target) == "progress":
                yield f"{file.name}:{node.lineno}", ast.unparse(node.annotation)


def test_progress_has_one_signature_everywhere():
    found = dict(annotations())
    assert len(found) > 40  # the walk sees them at all
    assert {k: v for k, v in found.items() if v not in ("Progress", "Progress | None")} == {}


def test_a_part_tells_its_whole_and_nobody_need_listen():
    told = []
    tell(within(lambda *step: told.append(step), "mesh"), "core", 2, 5)
    tell(within(None, "mesh"), "core", 2, 5)
    assert told == [("mesh: core", 2, 5)]


LAST = {"mesh": 10.0, "solve": 60.0, "render": 20.0}


def test_the_time_left_is_that_of_the_whole_job():
    """Each stage counted from zero again: 921 s left, ten seconds later 309."""
    journey = Journey(LAST, 0.0)
    journey.tell("mesh", 0, 1, 0.0)
    assert journey.left(4.0) == pytest.approx(86.0)
    journey.tell("solve", 0, 0, 10.0)
    assert journey.left(30.0) == pytest.approx(60.0)
    assert journey.share(30.0) == pytest.approx(30 / 90)


def test_a_run_at_half_the_speed_of_the_last_one_says_so():
    journey = Journey(LAST, 0.0)
    journey.tell("mesh", 0, 1, 0.0)
    journey.tell("solve", 0, 0, 20.0)  # the mesh took 20 s in place of 10
    assert journey.left(20.0) == pytest.approx(2 * 80.0)


def test_the_count_of_a_stage_corrects_what_was_learnt():
    """Half of the parts in 60 s: 60 s more, whatever the last run took; the render is learnt."""
    journey = Journey({"solve": 60.0, "render": 20.0}, 0.0)
    journey.tell("solve", 0, 10, 0.0)
    journey.tell("solve", 5, 10, 60.0)
    assert 40.0 <= journey.left(60.0) - 20.0 <= 60.0
    journey.tell("solve", 9, 10, 108.0)
    assert journey.left(108.0) - 20.0 == pytest.approx(12.0, rel=0.2)


def test_stages_that_reused_results_are_passed_over_and_not_forgotten():
    journey = Journey(LAST, 0.0)
    journey.tell("render", 0, 0, 1.0)
    assert journey.left(1.0) == pytest.approx(20.0)  # neither mesh nor solve will come
    assert journey.ended(19.0) == {"render": 18.0, "mesh": 10.0, "solve": 60.0}
    assert Journey(LAST, 0.0).left(0.0) == 90.0
    assert Journey({}, 0.0).left(5.0) is None


def test_a_display_learns_for_the_next_run_of_the_same_job(tmp_path, monkeypatch):
    monkeypatch.setenv("FOREARM_FEM_CACHE", str(tmp_path))
    assert display.job_words(["run", "quick", "--out", "here", "--set", "a=1"]) == "run quick --set a=1"
    with display.Display("run quick") as shown:
        shown("mesh", 0, 1)
        shown("solve", 0, 1)
    assert set(display.learnt_of("run quick")) == {"mesh", "solve"}
    stopped = display.Display("run other")
    stopped("mesh", 0, 1)
    stopped.__enter__().__exit__(KeyError)
    assert display.learnt_of("run other") == {}  # what was interrupted teaches nothing
    (tmp_path / "timings.json").write_text("damaged")
    assert display.learnt_of("run quick") == {}


def test_a_silent_stage_is_told_within_two_seconds():
    lines = []
    beat = display.Heartbeat(lambda: lines.append("told"))
    beat.start()
    deadline = time.monotonic() + 60  # of a busy machine; the promise is FIRST
    while not lines and time.monotonic() < deadline:
        time.sleep(0.02)
    beat.stop()
    assert display.Heartbeat.FIRST <= 2
    assert lines == ["told"]


def test_a_stage_that_is_late_is_not_about_to_end():
    """It said "about 1 s left" for a minute."""
    journey = Journey({"solve": 10.0, "write": 1.0}, 0.0)
    journey.tell("solve", 0, 0, 0.0)
    assert journey.left(5.0) == pytest.approx(6.0)
    assert journey.left(70.0) >= 7.0


def test_a_line_says_stage_count_and_time_left():
    journey = Journey({"drives": 36.0}, 0.0)
    journey.tell("drives", 3, 9, 12.0)
    assert display.progress_line(journey, 12.0).startswith("drives 3 of 9; 12 s gone, about ")
    assert display.progress_line(Journey({}, 0.0), 1.0) == ""


def test_a_first_run_guesses_by_its_kin_and_says_once_where_it_cannot(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("FOREARM_FEM_CACHE", str(tmp_path))
    display.learn("run lab.toml --set engine=layered --set device.spacing=40mm", {"solve": 3.0})
    assert display.learnt_of("run lab.toml --set engine=layered") == {"solve": 3.0}
    assert display.learnt_of("run lab.toml") == {}  # finite elements take longer
    assert display.learnt_of("run other.toml --set engine=layered") == {}
    assert sum(display.learnt_of("run thesis").values()) > 60
    shown = display.Display("design lab.toml")
    for stage in ("tables", "search"):
        shown(stage, 0, 1)
        shown._line()
    assert capsys.readouterr().err.count(display.NO_ESTIMATE) == 1
