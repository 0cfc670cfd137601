"""The report: whole, self-contained, escaped, and honest about what is missing."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_figures_scene import folder  # noqa: F401

from forearm_fem.errors import DataError
from forearm_fem.scenario import parse_scenario
from forearm_fem.show import Results, kinds
from forearm_fem.show import report as write
from forearm_fem.show.facts import condition_words, differences, exceeded, mean_words, scene_block
from forearm_fem.show.report import write_report


@pytest.fixture(scope="module")
def report(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, str, Path]:  # noqa: F811
    out = tmp_path_factory.mktemp("report")
    page, text = write_report(folder, out)
    return page.read_text(encoding="utf-8"), text.read_text(encoding="utf-8"), page


def test_the_story_is_told_in_order(report: tuple[str, str, Path]) -> None:
    titles = re.findall(r"<h2[^>]*>([^<]*)</h2>", report[0])
    assert titles == [
        "Scene", "Mesh", "Estimated errors of G", "Transfer matrix G", "Renderers", "Limits", "Signal strength S",
        "Beside the thesis&#39; Table I", "Waves", "Warnings", "Cost", "Provenance",
    ]  # fmt: skip
    assert re.findall(r"^## (.*)$", report[1], re.M) == [t.replace("&#39;", "'") for t in titles]


def test_the_page_holds_its_pictures_and_fetches_nothing(report: tuple[str, str, Path]) -> None:
    assert report[0].count("data:image/png;base64,") == 5  # mesh, G, targets 5 and 6, one wavefield
    assert not re.findall(r'(?:src|href)="(?!data:)', report[0])


def test_notes_are_escaped_on_the_page(report: tuple[str, str, Path]) -> None:
    assert "the numbers &lt;b&gt;are&lt;/b&gt; synthetic" in report[0]
    assert "- the numbers <b>are</b> synthetic" in report[1]


def test_each_entry_of_table_one_that_differs_has_a_sentence(folder: Path, report: tuple[str, str, Path]) -> None:  # noqa: F811
    lines = differences(Results.open(folder))
    corner = next(x for x in lines if x.startswith("Corners (1/3/7/9), combination"))
    assert "2.60 in the thesis (spread 0.92)" in corner
    assert all(x in report[1] for x in lines)


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
    assert exceeded(Results.open(folder)) == []


def test_a_report_names_every_key_that_was_set(folder: Path) -> None:  # noqa: F811
    """Membrane, gains and springs were in none of its lines."""
    results = Results.open(folder)
    table = {"tissues": {"membrane": {"tension": 40.0}}, "device": {"gains": {"A1": 0.9}}}
    results.__dict__["scenario"] = parse_scenario({**results.scenario.model_dump(), **table})
    (row,) = (row for row in scene_block(results).rows if row[0].startswith("keys"))
    assert {"tissues.membrane.tension", "device.gains"} <= set(row[1].split(", "))


def test_one_limit_is_told_in_the_singular(folder: Path) -> None:  # noqa: F811
    results = Results.open(folder)
    assert write._limit_words(["a"], results) == "One limit is exceeded."
    assert write._limit_words(["a", "b"], results) == "2 limits are exceeded."


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
    titles = [kinds(run)["target-5"].title for run in (ours, other)]
    assert titles == ["Waves towards target 5 (thesis' figure 6)", "Waves towards target 5"]
    assert "figure" not in write._traces(other, "5").title
    assert write._traces(ours, "5").title.endswith("as in the thesis' figure 6")


def test_an_unfinished_run_has_no_report(folder: Path, tmp_path: Path) -> None:  # noqa: F811
    for file in folder.iterdir():
        if file.name != "signal_strength.csv":
            os.symlink(file, tmp_path / file.name)
    with pytest.raises(DataError, match=r"signal_strength\.csv is missing; `forearm-fem render"):
        write_report(tmp_path)


def test_the_page_opens_in_a_browser(chromium: str, report: tuple[str, str, Path], tmp_path: Path) -> None:
    command = [chromium, "--headless=new", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path}",
               f"--print-to-pdf={tmp_path / 'page.pdf'}", report[2].as_uri()]  # fmt: skip
    subprocess.run(command, capture_output=True, timeout=120, check=False)
    assert (tmp_path / "page.pdf").stat().st_size > 100_000


def test_a_mean_says_of_how_many_it_is():
    """Targets whose S is unknown were left out of "the mean over 3 targets"."""
    assert mean_words(np.array([1.0, 2.0, 3.0])) == "2.00"
    assert mean_words(np.array([1.0, np.nan, np.inf])) == "1.00 (of 1)"
    assert mean_words(np.array([np.nan, np.nan])) == "unknown"
