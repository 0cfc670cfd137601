"""Two commands and one folder: the second waits for nothing, and each reports what it made; no stage is silent."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from cli_runner import SMALL, cli, leftovers

from forearm_fem.cli.common import out_folder
from forearm_fem.errors import DataError
from forearm_fem.questions.run import Run
from forearm_fem.results.files import read_transfer
from forearm_fem.scenario import Scenario, parse_scenario
from forearm_fem.store.folder import locked

posix = pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
HOLD = """
import sys, time
from forearm_fem.store.folder import locked
with locked(sys.argv[1]):
    print("held", flush=True)
    time.sleep(600)
"""


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """A folder with a scenario of three frequencies, on discs of uniform pressure, which take a tenth of the time."""
    text = SMALL.replace("f_max = 300.0", "frequencies = [100.0, 104.0, 108.0]")
    (tmp_path / "small.toml").write_text(f'{text}\n[device.cone]\ncontact = "pressure"\n')
    return tmp_path


@pytest.fixture
def holder(scene: Path) -> Iterator[subprocess.Popen[str]]:
    """Another process that works in results/small."""
    program = [sys.executable, "-c", HOLD, str(scene / "results" / "small")]
    with subprocess.Popen(program, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "held\n"
        yield process
        process.kill()


def test_a_second_command_gets_one_sentence_and_touches_nothing(scene: Path, holder: subprocess.Popen[str]) -> None:
    before = leftovers(scene)
    answer = cli("run", "--until", "solve", "small.toml", cwd=scene)
    assert answer.code == 2
    assert f"process {holder.pid}" in answer.sentence or os.name == "nt"
    assert "--out" in answer.sentence
    assert leftovers(scene) == before
    assert cli("run", "--until", "solve", "small.toml", "--out", "elsewhere", cwd=scene).code == 0


@posix
def test_a_killed_command_leaves_no_lock_that_blocks(scene: Path, holder: subprocess.Popen[str]) -> None:
    holder.send_signal(signal.SIGKILL)
    holder.wait()
    assert (scene / "results/small/.lock").exists()  # nobody could remove it
    assert cli("run", "--until", "solve", "small.toml", cwd=scene).code == 0
    assert ".lock" not in {Path(name).name for name in leftovers(scene)}


@pytest.mark.slow  # two processes solve for 10 s; the lock itself is tested above
def test_two_commands_at_once_each_print_their_own_g_or_refuse(scene: Path) -> None:
    program = [sys.executable, "-m", "forearm_fem", "render", "small.toml", "--out", "one"]
    spacings = (0.04, 0.05)
    running = [
        subprocess.Popen([*program, "--set", f"device.spacing={s}"], cwd=scene, text=True,
                         stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        for s in spacings
    ]  # fmt: skip
    said = [process.communicate() for process in running]
    codes = [process.returncode for process in running]
    assert set(codes) <= {0, 2}
    assert 0 in codes
    for (out, err), code, spacing in zip(said, codes, spacings, strict=True):
        alone = cli("render", "small.toml", "--set", f"device.spacing={spacing}", "--out", f"own{spacing}", cwd=scene)
        assert code == 2 or out.splitlines()[:-1] == alone.out.splitlines()[:-1]
        assert code == 0 or "another forearm-fem command" in err


def test_a_lock_of_this_process_holds_too_and_leaves_nothing(tmp_path: Path) -> None:
    folder = tmp_path / "a" / "b"
    with locked(folder), pytest.raises(DataError, match="another forearm-fem command"), locked(folder):
        pass
    assert list(tmp_path.iterdir()) == []


def test_what_is_set_has_a_folder_of_its_own() -> None:
    scenario = Scenario()
    plain, near, far = (out_folder(None, scenario, o) for o in ([], ["device.spacing=0.04"], ["device.spacing=0.05"]))
    assert plain == Path("results/scenario")
    assert len({plain, near, far}) == 3
    assert near == out_folder(None, scenario, ["device.spacing = 0.040"])  # the value counts, not how it is written
    assert out_folder(Path("here"), scenario, ["device.spacing=0.04"]) == Path("here")
    assert out_folder(None, scenario, ["name=scenario", "device.spacing=0.04"]) == plain


def test_files_of_another_scenario_leave_the_folder(scene: Path) -> None:
    cli("render", "small.toml", "--out", "one", cwd=scene)
    answer = cli("run", "--until", "solve", "small.toml", "--set", "device.spacing=0.05", "--out", "one", cwd=scene)
    assert "drives.nc" in answer.err
    assert not {"drives.nc", "displacements.nc", "signal_strength.csv"} & set(leftovers(scene / "one"))
    assert {abs(p.position[0]) for p in read_transfer(scene / "one/transfer.nc").inputs} == {0.025}


def test_figures_find_the_wavelet_wherever_they_are_made(scene: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    from forearm_fem.show.data import Results

    t = np.arange(-100, 100) / 2000
    (scene / "wave.csv").write_text("\n".join(f"{v:.6f}" for v in (1 - 2 * (400 * t) ** 2) * np.exp(-((400 * t) ** 2))))
    answer = cli("render", "small.toml", "--set", "rendering.wavelet.file='wave.csv'", "--out", "one", cwd=scene)
    assert answer.code == 0, answer.err
    (scene / "wave.csv").unlink()
    assert np.abs(Results.open(scene / "one").wavelet.samples).max() == 1.0


def test_an_account_without_its_keys_is_damaged(scene: Path) -> None:
    cli("render", "small.toml", cwd=scene)
    for text in ("{}", "[]", '{"program": "0"}'):
        (scene / "results/small/run.json").write_text(text)
        answer = cli("figures", "results/small", "--only", "condition", cwd=scene)
        assert answer.code == 2
        assert "run.json" in answer.sentence


def test_every_stage_is_told_before_its_work(scene: Path) -> None:
    told: list[tuple[str, int]] = []
    scenario = parse_scenario({"engine": "layered", "sweep": {"frequencies": [100.0]}})
    run = Run.start(scenario, scene / "out", scene, lambda stage, done, total: told.append((stage, done)))
    with run.stage("anything"):
        assert told == [("anything", 0)]
    assert told[-1] == ("anything", 1)


def test_hand_placed_contacts_are_reported_as_they_lie() -> None:
    from forearm_fem.show.facts import _device, _grid

    placed = parse_scenario(
        {"device": {"contacts": [[0, 0], [0.032, 0]]}, "grid": {"points": [[0.0, 0.0], [0.01, 0.0]]}}
    )
    assert "2 actuators at own places, the nearest 32 mm apart" in _device(placed)
    assert _grid(placed, 2) == "2 points at own places, the nearest 10 mm apart"
    assert "4 actuators in 2 x 2, 45 mm apart" in _device(Scenario())


def test_an_unknown_s_is_named() -> None:
    from types import SimpleNamespace

    from forearm_fem.questions.run import unknown_strengths

    made = SimpleNamespace(methods=("funneling",), targets=("1", "2"), strengths=np.array([[np.nan, 1.0]]))
    assert unknown_strengths(made)[0].startswith("S of funneling is unknown at 1:")


def test_nothing_of_another_scenario_stays_beside_a_run(tmp_path: Path) -> None:
    """Figures of the drives before stayed in `figures`, and the checksum of an S that was gone. What others put there
    stays."""
    (tmp_path / "flat.toml").write_text(
        'name = "flat"\nengine = "layered"\nsweep = { duration = 0.1 }\ndevice.cone.contact = "pressure"\n'
    )
    assert cli("run", "flat.toml", "--out", "one", cwd=tmp_path).code == 0
    figures = tmp_path / "one/figures"
    assert cli("figures", "one", "--only", "transfer,figure-6", cwd=tmp_path).code == 0
    (figures / "mine.png").touch()
    (figures / "target-7.csv").touch()
    assert {"transfer.png", "figure-6.png"} <= {p.name for p in figures.iterdir()}
    again = cli("run", "--until", "solve", "flat.toml", "--set", "device.spacing=0.05", "--out", "one", cwd=tmp_path)
    assert {p.name for p in figures.iterdir()} == {"mine.png"}
    assert not list((tmp_path / "one").glob("*.sha256"))
    assert "figures/figure-6.png" in again.out + again.err
