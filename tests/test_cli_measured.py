"""calibrate, play, compare and fit through the command line, on the layered model and the virtual DAQ."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from cli_runner import SMALL, cli

from forearm_fem.files import save
from forearm_fem.results.files import read_transfer
from forearm_fem.transfer import band_error

# 4 measurements instead of 36, each of which draws a picture
TWO_BY_TWO = """
[grid]
points = [[0.0, 0.0], [0.01, 0.0]]
[device]
contacts = [[-0.02, 0.0], [0.02, 0.0]]
"""


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a scenario, its G, and a virtual calibration through it."""
    folder = tmp_path_factory.mktemp("lab")
    (folder / "small.toml").write_text(
        SMALL.replace('["5", "6"]', '["1", "2"]').replace("[rendering]", "[rendering]\nmethods = ['funneling']")
        + TWO_BY_TWO
    )
    assert cli("render", "small.toml", cwd=folder).code == 0
    answer = cli(
        "calibrate",
        "small.toml",
        "--through",
        "results/small",
        "--snr",
        40,
        cwd=folder,
    )
    assert answer.code == 0, answer.err
    return folder


def test_calibration_recovers_g(lab: Path) -> None:
    truth, found = (read_transfer(lab / f"results/small/{f}transfer.nc") for f in ("", "calibration/"))
    both = np.isin(truth.frequency, found.frequency), np.isin(found.frequency, truth.frequency)
    # 40 dB of noise over 4 repeats of a 500-sample sweep leaves about 1 %
    assert band_error(found.values[both[1]], truth.values[both[0]]) < 0.03


def test_a_g_of_another_device_is_measured_with_a_word(lab: Path) -> None:
    """Its points and actuators are what a virtual device has; the scenario's own are not measured."""
    aside = ("--set", "device.contacts=[[-0.02, 0.0], [0.03, 0.0]]", "--out", "other")
    answer = cli("calibrate", "small.toml", "--through", "results/small", *aside, cwd=lab)
    assert answer.code == 0
    assert "or they lie elsewhere: those of G are measured" in answer.out + answer.err
    same = cli("calibrate", "small.toml", "--through", "results/small", "--out", "same", cwd=lab)
    assert "those of G are measured" not in same.out + same.err


def test_calibration_resumes_without_measuring_again(lab: Path) -> None:
    folder = lab / "results/small/calibration"
    before = {f: f.stat().st_mtime_ns for f in folder.glob("G_*.nc")}
    answer = cli("calibrate", "small.toml", "--through", "results/small", "--snr", 40, cwd=lab)
    assert answer.code == 0
    assert {f: f.stat().st_mtime_ns for f in folder.glob("G_*.nc")} == before


def test_real_hardware_needs_a_declared_sensor(lab: Path) -> None:
    answer = cli("calibrate", "small.toml", "--daq", "ni", cwd=lab)
    assert answer.code == 2
    assert "measurement.sensor" in answer.sentence


def test_compare_takes_folders_and_files(lab: Path) -> None:
    answer = cli("compare", "results/small", "results/small/calibration/transfer.nc", "--out", "c", cwd=lab)
    assert answer.code == 0, answer.err
    assert answer.out.startswith("calibration differs from small by ")
    assert answer.out.splitlines()[-1] == "open c/comparison.html"
    assert {f.suffix for f in (lab / "c").iterdir()} >= {".json", ".md", ".png"}


def test_two_engines_of_one_scenario_compare(lab: Path) -> None:
    cli(
        "run",
        "--until",
        "solve",
        "small.toml",
        "--set",
        "tissues.preset=thesis",
        "--out",
        "other",
        cwd=lab,
    )
    answer = cli("compare", "results/small", "other", "--no-render", cwd=lab)
    assert answer.code == 0, answer.err
    assert (lab / "results/compare-small-other/comparison.json").is_file()


def test_compare_asks_for_what_a_file_does_not_say(lab: Path, tmp_path: Path) -> None:
    save(tmp_path / "g.csv", read_transfer(lab / "results/small/transfer.nc"))
    answer = cli("compare", "results/small", tmp_path / "g.csv", "--declare-b", "colour='red'", cwd=lab)
    assert answer.code == 2
    assert "--declare colour" in answer.sentence
    assert "unit" in answer.sentence


@pytest.mark.parametrize("other", ["nowhere", "nowhere.nc", "small.toml"])
def test_compare_refuses_what_holds_no_g(lab: Path, other: str) -> None:
    answer = cli("compare", "results/small", other, "--out", "never", cwd=lab)
    assert answer.code == 2
    assert answer.sentence
    assert not (lab / "never").exists()


def test_fit_finds_the_modulus_and_rejects_unknown_names(lab: Path) -> None:
    common = ("fit", "small.toml", "results/small/calibration")
    found = cli(*common, "skin.mu", "--frequencies", 6, cwd=lab)
    assert found.code == 0, found.err
    assert "tissues.override.skin.mu" in found.out
    wrong = cli(*common, "skin.colour", cwd=lab)
    assert wrong.code == 2
    assert "skin.mu" in wrong.sentence


def test_a_table_without_places_takes_those_of_the_scenario_that_is_named(lab: Path) -> None:
    """A lab's CSV knows names alone; who names the scenario that was measured has said where they are."""
    g = read_transfer(lab / "results/small/calibration/transfer.nc")
    rows = ["frequency_Hz,output,input,real,imag"]
    for k, i, j in np.ndindex(g.values.shape):
        value = 1e6 * g.values[k, i, j]
        rows.append(f"{g.frequency[k]},{g.outputs[i].name},{g.inputs[j].name},{value.real!r},{value.imag!r}")
    (lab / "lab.csv").write_text("\n".join(rows).replace("np.float64(", "").replace(")", ""))
    places = ("--scenario", "small.toml", "--no-render")
    asked = cli("compare", "lab.csv", "results/small", *places, cwd=lab).sentence
    assert all(key in asked for key in ("spectrum=", "sign=", "unit="))  # at once, not one by one
    said = ("unit='um/V'", "sign='+iwt'", "spectrum='one-sided'")
    known = [word for item in said for word in ("--declare-a", item)]
    found = cli("compare", "lab.csv", "results/small/calibration", *known, *places, "--out", "same", cwd=lab)
    assert found.code == 0, found.err
    assert json.loads((lab / "same" / "comparison.json").read_text())["overall"]["e_band"] < 1e-9  # the same numbers
    fitted = cli("fit", "small.toml", "lab.csv", "scale", "--frequencies", 6,
                 *(word for item in said for word in ("--declare", item)), cwd=lab)  # fmt: skip
    assert fitted.code == 0, fitted.err
    lost = cli("compare", "lab.csv", "results/small", *known, "--out", "never", cwd=lab)
    assert (lost.code, "--scenario FILE" in lost.sentence) == (2, True)


def test_play_says_what_makes_drives_before_it_solves(lab: Path, tmp_path: Path) -> None:
    (tmp_path / "bare").mkdir()
    answer = cli("daq", "play", "small.toml", tmp_path / "bare", "--method", "funneling", cwd=lab)
    assert answer.code == 2
    assert "`forearm-fem render` makes a drives.nc" in answer.sentence


def test_play_obeys_the_voltage_limit(lab: Path) -> None:
    common = (
        "daq",
        "play",
        "small.toml",
        "results/small",
        "--target",
        1,
        "--through",
        "results/small",
    )
    fine = cli(*common, "--scale", 0.1, cwd=lab)
    assert fine.code == 0, fine.err
    assert "played" in fine.out
    loud = cli(*common, "--scale", 100, cwd=lab)
    assert loud.code == 2
    assert "V" in loud.sentence


@pytest.mark.parametrize("command", ["compare", "fit"])
def test_a_folder_keeps_one_result_whole_and_what_others_wrote(lab: Path, command: str) -> None:
    """The same again just works; another question replaces all and says so; what is not its own is refused."""
    g = "results/small/calibration"
    first = {"compare": ("results/small", g, "--no-render"), "fit": ("small.toml", g, "scale", "--frequencies", 4)}
    other = {"compare": (g, "results/small", "--no-render"), "fit": ("small.toml", g, "delay", "--frequencies", 4)}
    out = lab / f"kept-{command}"
    for line in (first, first):
        answer = cli(command, *line[command], "--out", out, cwd=lab)
        assert (answer.code, "another question" in answer.err) == (0, False), answer.err
    (out / "mine.txt").write_text("mine")
    names = {f.name for f in out.iterdir()}
    assert "another question and are replaced" in cli(command, *other[command], "--out", out, cwd=lab).err
    assert {f.name for f in out.iterdir()} == names
    account = lab / f"theirs-{command}" / {"compare": "comparison.json", "fit": "fit.json"}[command]
    account.parent.mkdir()
    account.write_text('{"colour": "red"}')
    refused = cli(command, *first[command], "--out", account.parent, cwd=lab)
    assert (refused.code, "name another folder with --out" in refused.sentence) == (2, True)
    assert account.read_text() == '{"colour": "red"}'
