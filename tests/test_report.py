"""The report of a run: the answer first, whole, self-contained, escaped, and honest about what is missing."""

from __future__ import annotations

import json
import os
import re
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, get_args

import numpy as np
import pytest
from scipy.special import gammainc
from test_figures_scene import folder  # noqa: F401

from forearm_fem.errors import DataError
from forearm_fem.ports import Port
from forearm_fem.rendering.limits import CLEARANCE, counted_points, limits_of, not_counted_words
from forearm_fem.scenario import parse_scenario
from forearm_fem.scenario.rendering import RickerWavelet
from forearm_fem.show import Results, kinds
from forearm_fem.show.answer import (
    answer_of,
    console_lines,
    is_thesis_device,
    just_counted,
    method_answers,
    next_steps,
    trust_of,
)
from forearm_fem.show.facts import (
    band_words,
    condition_words,
    differences,
    errors_block,
    exceeded,
    limit_words,
    play_block,
    scene_block,
)
from forearm_fem.show.judge import ERRORS, Strengths, strengths
from forearm_fem.show.page import Page
from forearm_fem.show.report import to_play, write_report
from forearm_fem.transfer import ErrorSource

pytestmark = pytest.mark.drawn


@pytest.fixture(scope="module")
def report(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, str, Path]:  # noqa: F811
    out = tmp_path_factory.mktemp("report")
    page, text = write_report(folder, out)
    return page.read_text(encoding="utf-8"), text.read_text(encoding="utf-8"), page


@pytest.fixture
def data(folder: Path) -> Strengths:  # noqa: F811
    """S that a person can check: 9 points, the first two of which lie beside a motor."""
    found = strengths(Results.open(folder))
    value = np.array([[9.0, 9.0, 2.0, 2.0, 2.0, 2.0, 2.0, 0.5, 1.1], [9.0, 9.0, *[1.2] * 7], [9.0, 9.0, *[0.5] * 7]])
    counted = np.array([False, False, *[True] * 7])
    return replace(found, values=value, low=value - 0.15, high=value + 0.15, counted=counted)


def test_the_answer_stands_above_everything_that_is_folded(report: tuple[str, str, Path]) -> None:
    """A reader who has to scroll past settings for S was not answered."""
    page, text, _ = report
    trust = page.index("People differ")
    assert page.index('class="answer"') < trust < page.index('id="map"') < page.index("<details")
    assert page.index("<details") < page.index('id="settings"')
    assert "SHA-256" not in text  # the short form leaves out what is folded


def test_the_page_fetches_nothing(report: tuple[str, str, Path]) -> None:
    assert "data:image/png;base64," in report[0]
    assert not re.findall(r'(?:src|href)="(?!data:)', report[0])


def test_notes_are_escaped_on_the_page(report: tuple[str, str, Path]) -> None:
    assert "the numbers &lt;b&gt;are&lt;/b&gt; synthetic" in report[0]
    assert "- the numbers <b>are</b> synthetic" in report[1]


def test_points_beside_a_motor_are_in_no_mean_and_no_verdict(data: Strengths) -> None:
    """They move with the motor: S of 9 there made the best method and the headline."""
    answers = {a.method: a for a in method_answers(data)}
    filtered = answers["inverse filter"]
    assert filtered.points == 7
    assert len(filtered.focused) == 6
    assert filtered.mean == pytest.approx(np.mean([2, 2, 2, 2, 2, 0.5, 1.1]))
    assert (filtered.least, filtered.least_at) == (0.5, data.targets[7])
    corners = data.table().mean[data.table().groups.index("Corners (1/3/7/9)")]
    assert corners[0] == pytest.approx(np.mean([2.0, 2.0, 1.1]))  # 3, 7 and 9: point 1 is not counted


def test_the_best_method_focuses_at_most_points(data: Strengths) -> None:
    """Funneling's mean is smaller than the inverse filter's, and it focuses at one point more."""
    assert [a.method for a in method_answers(data)] == ["funneling", "inverse filter", "combination"]


def test_a_point_whose_interval_holds_one_is_open(folder: Path, data: Strengths) -> None:  # noqa: F811
    first = replace(data, values=data.values[:1], low=data.low[:1], high=data.high[:1], methods=data.methods[:1])
    assert method_answers(first)[0].open == (data.targets[8],)  # 0.95 to 1.25
    assert any(f"point {data.targets[8]} " in line for line in answer_of(Results.open(folder), first))


def test_the_line_of_trust_names_the_widest_interval_of_a_point_that_counts(folder: Path, data: Strengths) -> None:  # noqa: F811
    """0.15 of 0.5: 30 %."""
    assert "30 % (" in trust_of(Results.open(folder), data)
    unknown = replace(data, low=np.full_like(data.low, np.nan))
    assert "unknown" in trust_of(Results.open(folder), unknown)


def test_clearance_is_taken_from_the_rim() -> None:
    """9 mm of skin between point and cone; a place that is not known cannot lie too near."""
    cone = Port("A1", "contact", (0.0, 0.0, 0.0), radius=3.5e-3)
    gaps = (0.003, 0.0035 + CLEARANCE - 1e-4, 0.0035 + CLEARANCE, np.nan)
    points = tuple(Port(str(k), "point", (0.0, gap, 0.0)) for k, gap in enumerate(gaps, start=1))
    assert counted_points(points, (cone,)).tolist() == [False, False, True, True]
    assert counted_points(points, ()).all()
    told = not_counted_words(("1", "2", "3", "4"), points, (cone,))
    assert told == "point 1 is not counted: under a motor; point 2 is not counted: within 9 mm of a motor's rim"


def test_the_corners_of_the_thesis_device_count(folder: Path) -> None:  # noqa: F811
    """They lie 9.5 mm off a rim; 40 mm apart, motors come as near as 6 mm."""
    results = Results.open(folder)
    assert results.counted([str(k) for k in range(1, 10)]).all()
    nearer = [replace(p, position=tuple(40 / 45 * x for x in p.position)) for p in results.transfer.inputs]
    counted = counted_points(results.transfer.outputs, nearer)
    assert [p.name for p, c in zip(results.transfer.outputs, counted, strict=True) if not c] == ["1", "3", "7", "9"]


def test_a_console_gets_eight_lines(folder: Path) -> None:  # noqa: F811
    """150 lines of Markdown went by; every S and where to look must be among the few."""
    results = Results.open(folder)
    lines = console_lines(results)
    assert len(lines) <= 9
    assert max(map(len, lines)) < 400
    shown = " ".join(lines)
    assert all(f"{s:.2f}" in shown for s in strengths(results).values.ravel())
    assert str(folder) in lines[-1]


def test_commands_to_copy_name_what_was_asked(folder: Path) -> None:  # noqa: F811
    results = Results.open(folder)
    vars(results)["run"] = replace_asked(results, "thesis --set engine=layered --set device.spacing=0.04")
    commands = dict(next_steps(results, strengths(results)))
    assert f"forearm-fem workbench {folder}" in commands.values()
    assert "forearm-fem predict thesis --set engine=layered --set device.spacing=0.04" in commands.values()
    assert len(commands) == 3


def replace_asked(results: Results, asked: str) -> object:
    return results.run.model_copy(update={"asked": asked})


def test_table_one_stands_beside_the_thesis_device_only(folder: Path, report: tuple[str, str, Path]) -> None:  # noqa: F811
    """ "1411 % above the thesis" of another device compared nothing."""
    thesis = Results.open(folder).scenario
    assert is_thesis_device(thesis)
    for change in ({"spacing": 0.04}, {"rows": 3, "columns": 2}):
        other = {**thesis.model_dump(), "device": {**thesis.device.model_dump(), **change}}
        assert not is_thesis_device(parse_scenario(other))
    lines = differences(Results.open(folder))
    corner = next(x for x in lines if x.startswith("Corners (1/3/7/9), combination"))
    assert "2.60 in the thesis (spread 0.92)" in corner
    assert 'id="thesis"' in report[0]
    named = " ".join(lines)  # what agrees was left out silently
    places = ("Middle (5)", "Edges (2/4/6/8)", "Corners (1/3/7/9)")
    assert all(f"{place}, {method}" in named for place in places for method in strengths(Results.open(folder)).methods)


def test_a_point_that_counts_by_half_a_millimetre_says_so(folder: Path) -> None:  # noqa: F811
    """Corners 9.5 mm off a rim made the mean, as all others; with 20 mm asked for, the middle alone is clear."""
    results = Results.open(folder)
    data = strengths(results)
    said = just_counted(results, data)
    assert said.startswith("Points 1, 3, 7, 9 lie only 0.5 mm beyond the 9 mm")
    best = method_answers(data)[0].method
    edges = [results.transfer.outputs[k].name for k in (1, 3, 4, 5, 7)]
    mean = np.mean([r.S for r in results.strengths if r.method == best and r.target in edges])
    assert f"{mean:.2f}" in said
    assert said in answer_of(results, data)
    results.__dict__["scenario"] = results.scenario.changed({"rendering.clearance": 0.004})
    assert just_counted(results, data) == ""


def test_a_rig_reads_what_to_play(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:  # noqa: F811
    """Volts of each actuator with their sign, and room to a limit that is the drives' own."""
    results = Results.open(folder)
    sent, limits = results.drives, limits_of(results.scenario.device)
    block = play_block(results, ["funneling"])
    row = dict(zip(block.header, block.rows[4], strict=True))
    signals = sent.values[sent.methods.index("funneling"), sent.targets.index("5")]
    volts = [float(row[f"{name} [V]"].replace("\N{MINUS SIGN}", "-")) for name in sent.channels]
    largest = [s[np.abs(s).argmax()] for s in signals]
    np.testing.assert_allclose(volts, largest, rtol=5e-3)  # three digits
    assert limits is not None
    room = float(row["room to a limit"].removesuffix(" times"))
    power = np.mean((room * signals) ** 2, axis=1).max() / limits.resistance
    share = max(room * np.abs(signals).max() / limits.voltage, np.sqrt(power / limits.power))
    assert share == pytest.approx(1, abs=0.01)
    monkeypatch.setattr("forearm_fem.show.report.is_measured", lambda _: True)
    first, others = to_play(results, strengths(results))
    assert f"{results.folder} --method" in first.commands[0][1]
    assert others.folded


def test_what_the_band_cuts_from_the_wavelet_is_said(folder: Path) -> None:  # noqa: F811
    """Energy of a Ricker wavelet below f: an incomplete gamma function of 2 (f / peak)^2."""
    results = Results.open(folder)
    options, f = results.scenario.rendering.wavelet, results.transfer.frequency
    assert isinstance(options, RickerWavelet)
    low, high = gammainc(2.5, 2 * (f[[0, -1]] / options.peak) ** 2)
    found = re.search(r"(\d+) % of its energy", band_words(results))
    assert found is not None
    assert float(found[1]) == pytest.approx(100 * (high - low), abs=0.6)  # whole per cent
    wide = np.concatenate([f, [1e3]])
    results.__dict__["transfer"] = SimpleNamespace(frequency=wide)
    assert band_words(results) == ""


def test_limits_exceeded_are_named(folder: Path, tmp_path: Path) -> None:  # noqa: F811
    shutil.copytree(folder, tmp_path / "run")
    file = tmp_path / "run" / "scenario.json"
    scene = json.loads(file.read_text())
    scene["device"]["max_voltage"] = 0.1
    file.write_text(json.dumps(scene))
    lines = exceeded(Results.open(tmp_path / "run"))
    assert [x.split(":")[0] for x in lines] == ["inverse filter", "funneling", "combination"]  # each method once
    said = r"funneling: \d+ of 36 drives exceed 0\.1 V peak, most of all \S+ V at A\d towards \d; rendering\.amplitude"
    assert re.match(said, lines[1])
    assert limit_words(Results.open(tmp_path / "run")).startswith("Beyond a limit")
    assert exceeded(Results.open(folder)) == []
    room = re.search(r"may grow (\S+) times", limit_words(Results.open(folder)))
    largest = np.abs(Results.open(folder).drives.values).max()
    assert room is not None
    assert float(room[1]) == pytest.approx(2.5 / largest, rel=0.05)  # printed to two digits


def test_a_report_names_every_key_that_was_set(folder: Path) -> None:  # noqa: F811
    """Membrane, gains and springs were in none of its lines."""
    results = Results.open(folder)
    table = {"tissues": {"membrane": {"tension": 40.0}}, "device": {"gains": {"A1": 0.9}}}
    results.__dict__["scenario"] = parse_scenario({**results.scenario.model_dump(), **table})
    (row,) = (row for row in scene_block(results).rows if row[0].startswith("keys"))
    assert {"tissues.membrane.tension", "device.gains"} <= set(row[1].split(", "))


def test_a_singular_g_is_no_well_conditioned_one() -> None:
    """Bins at which an actuator moves nothing were left out of the median and the largest."""
    assert condition_words(np.array([2.0, 5.0, np.nan, 9.0])) == "median 5.0, largest 9.0"
    assert condition_words(np.array([2.0, np.inf, 3e16, np.nan])).startswith("infinite at 2 of 3 frequencies")
    assert condition_words(np.full(3, np.nan)) == "unknown"


def test_another_grids_waves_are_not_called_the_thesis_figures(folder: Path) -> None:  # noqa: F811
    """Point 5 of 3 x 3 is the middle; of another grid it may be a corner, which no figure of the thesis shows."""
    ours = Results.open(folder)
    *rest, last = ours.transfer.outputs
    other = Results.open(folder)
    vars(other)["transfer"] = replace(ours.transfer, outputs=(*rest, replace(last, position=(0.03, 0.03, 0.0))))
    titles = [kinds(run)[name].title for run, name in ((ours, "figure-6"), (other, "target-5"))]
    assert titles == ["Waves towards target 5 (thesis' figure 6)", "Waves towards target 5"]


def test_an_unfinished_run_has_no_report(folder: Path, tmp_path: Path) -> None:  # noqa: F811
    for file in folder.iterdir():
        if file.name != "signal_strength.csv":
            os.symlink(file, tmp_path / file.name)
    with pytest.raises(DataError, match=r"signal_strength\.csv is missing; `forearm-fem render"):
        write_report(tmp_path)


def test_a_phone_shows_the_page_without_scrolling_sideways(browser: Any, report: tuple[str, str, Path]) -> None:
    """390 px wide, all folds open: tables and pictures scroll or shrink within the page."""
    page = browser.new_page(viewport={"width": 390, "height": 844})
    page.goto(report[2].as_uri())
    page.evaluate("document.querySelectorAll('details').forEach(d => { d.open = true; })")
    assert page.evaluate("document.documentElement.scrollWidth") <= 390


def test_errors_are_told_in_the_glossarys_words(folder: Path) -> None:  # noqa: F811
    """Each source that an engine may state has a name there; "order p is 1.85 below 0.115" told nobody."""
    results = Results.open(folder)
    block = errors_block(results)
    assert len(block.rows) == len(results.transfer.errors)
    stated = {e.source for e in results.transfer.errors}
    assert stated <= set(ERRORS)
    assert {row[0] for row in block.rows} == {ERRORS[s][0] for s in stated}
    assert set(get_args(ErrorSource)) <= set(ERRORS)


def test_code_in_a_sentence_is_code_on_the_page() -> None:
    page = Page("t", ["see `forearm-fem predict` <now>"], [], "s")
    assert "see <code>forearm-fem predict</code> &lt;now&gt;" in page.html()
    assert "`forearm-fem predict` <now>" in page.markdown()
