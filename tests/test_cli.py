"""The command line on the layered engine: what it prints, where it writes, how it fails."""

from __future__ import annotations

import contextlib
import json
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from cli_runner import SMALL, cli, leftovers

from forearm_fem import __version__
from forearm_fem.results.files import read_displacements, read_drives, read_signal_strength_csv, read_transfer


@pytest.fixture(scope="module")
def solved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a scenario, its G and its drives."""
    folder = tmp_path_factory.mktemp("solved")
    (folder / "small.toml").write_text(SMALL)
    answer = cli("render", "small.toml", cwd=folder)
    assert answer.code == 0, answer.err
    return folder


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """A folder with a scenario and nothing else."""
    (tmp_path / "small.toml").write_text(SMALL)
    return tmp_path


def test_the_help_loads_nothing_heavy() -> None:
    heavy = ("scipy", "xarray", "matplotlib", "pyvista", "skfem", "trimesh", "distributed")
    code = f"import sys, forearm_fem.cli.app; print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_the_installed_program_ends_with_its_code() -> None:
    program = [sys.executable, "-m", "forearm_fem.cli.app"]
    done = subprocess.run([*program, "run", "nowhere.toml"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    names = "halfspace, layered, line, own_arm, quick, thesis"
    assert done.stderr == f"error: nowhere.toml: no such file; by name there are {names}\n"
    assert subprocess.run([*program, "--version"], capture_output=True, check=False).returncode == 0


def test_the_package_runs_as_the_program() -> None:
    program = [sys.executable, "-m", "forearm_fem"]
    done = subprocess.run([*program, "--version"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, f"forearm-fem {__version__}\n", "")


def test_help_names_every_command() -> None:
    answer = cli("--help")
    names = ("run", "render", "calibrate", "daq", "compare", "fit", "figures", "workbench", "predict", "design",
             "study", "new", "verify", "campaign", "schema", "doctor")  # fmt: skip
    assert answer.code == 0
    assert all(f" {name} " in answer.out for name in names)


def test_an_unknown_command_suggests_the_nearest() -> None:
    assert "'render'" in cli("rendr").sentence


@pytest.mark.parametrize("option", [("--dry-run",), ("--library", "small.toml")])
def test_a_stage_to_stop_after_refuses_what_it_would_ignore(scene: Path, option: tuple[str, ...]) -> None:
    assert "--until: has no effect" in cli("run", "small.toml", "--until", "solve", *option, cwd=scene).sentence


def test_no_command_is_answered_with_the_help_alone() -> None:
    answer = cli()
    assert answer.code == 2
    assert "Simulate" in answer.out
    assert "error" not in answer.err


def test_schema_is_json_with_every_table() -> None:
    tables = json.loads(cli("schema").out)["properties"]
    assert {"limb", "tissues", "device", "grid", "sweep", "mesh", "solver", "rendering"} <= set(tables)


def test_doctor_says_what_the_machine_offers() -> None:
    out = cli("doctor").out
    assert all(word in out for word in ("forearm-fem", "numpy", "direct solvers", "memory", "rendering back end"))


def test_doctor_says_where_the_cache_is_and_how_much_lies_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FOREARM_FEM_CACHE", str(tmp_path / "kept"))
    monkeypatch.setattr("forearm_fem.cli.about.rendering_backend", lambda: "not tried")
    assert f"{tmp_path / 'kept'}: 0.0 MB in 0 files" in cli("doctor").out
    (tmp_path / "kept" / "solves").mkdir(parents=True)
    (tmp_path / "kept" / "solves" / "a.nc").write_bytes(bytes(2_500_000))
    assert f"{tmp_path / 'kept'}: 2.5 MB in 1 files" in cli("doctor").out
    (tmp_path / "file").write_text("x")
    monkeypatch.setenv("FOREARM_FEM_CACHE", str(tmp_path / "file" / "cache"))
    assert f"{tmp_path / 'file' / 'cache'}: nothing can be kept there ({tmp_path / 'file'} is no" in cli("doctor").out


def test_the_dry_run_refuses_what_the_run_refuses(tmp_path: Path) -> None:
    wide = ("thesis", "--set", "engine=layered", "--set", "device.columns=3", "--set", "device.spacing=30mm")
    answers = [cli("run", *wide, *more, cwd=tmp_path) for more in (("--dry-run",), ())]
    assert [a.code for a in answers] == [2, 2]
    assert answers[0].sentence == answers[1].sentence
    assert "61 degrees from facing up" in answers[0].sentence
    assert list(tmp_path.glob("results/*/transfer.nc")) == []  # said before anything is solved


def test_dry_run_solves_and_writes_nothing(scene: Path) -> None:
    answer = cli("run", "small.toml", "--dry-run", cwd=scene)
    assert answer.code == 0
    assert "frequencies" in answer.out
    assert leftovers(scene) == ["small.toml"]


def test_solve_states_the_error_and_the_file(solved: Path) -> None:
    answer = cli("run", "--until", "solve", "small.toml", cwd=solved)
    assert answer.code == 0
    assert "quadrature" in answer.out
    assert "met" in answer.out
    g = read_transfer(solved / "results/small/transfer.nc")
    assert (g.values.shape[1:], g.unit) == ((9, 4), "m/V")


def test_render_prints_the_strengths_it_wrote_to_the_digits_that_can_be_trusted(solved: Path) -> None:
    folder = solved / "results/small"
    said = cli("render", "small.toml", cwd=solved).out
    for row in read_signal_strength_csv(folder / "signal_strength.csv"):
        assert f"{row.S:.2f}" in said
    assert "results/small" in said.splitlines()[-1]
    assert not re.search(r"\d\.\d{5}", said)
    assert read_drives(folder / "drives.nc").targets == ("5", "6")
    for signals in (read_drives(folder / "drives.nc"), read_displacements(folder / "displacements.nc")):
        assert signals.provenance["scenario"]["name"] == "small"
        assert signals.positions is not None


def test_a_scenario_with_the_mark_that_windows_editors_write_is_read(tmp_path: Path) -> None:
    (tmp_path / "small.toml").write_bytes(b"\xef\xbb\xbf" + SMALL.encode())
    assert cli("run", "small.toml", "--dry-run", cwd=tmp_path).code == 0


def test_ctrl_c_in_compiled_code_is_an_interruption(scene: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A kernel that returns with KeyboardInterrupt set comes up as a SystemError."""

    def compiled(*_: object) -> None:
        raise SystemError("CPUDispatcher(<function>) returned a result with an exception set") from KeyboardInterrupt()

    monkeypatch.setattr("forearm_fem.questions.run.run_solve", compiled)
    answer = cli("run", "--until", "solve", "small.toml", cwd=scene)
    assert (answer.code, "interrupted; what was finished is kept" in answer.err) == (130, True), answer.err


@pytest.mark.usefixtures("ctrl_c")
def test_ctrl_c_that_ends_in_another_errors_name_is_an_interruption(
    scene: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As in a module that is imported then: the interrupt is gone, and what it left half done fails."""

    def importing(*_: object) -> None:
        with contextlib.suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        raise NameError("name '_ndimage_api' is not defined")

    monkeypatch.setattr("forearm_fem.questions.run.run_solve", importing)
    answer = cli("run", "--until", "solve", "small.toml", cwd=scene)
    assert (answer.code, "interrupted; what was finished is kept" in answer.err) == (130, True), answer.err
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_overrides_reach_the_scenario(scene: Path) -> None:
    answer = cli(
        "run", "--until", "solve", "small.toml", "--set", "device.spacing=0.04", "--set", "name=other", cwd=scene
    )
    assert answer.code == 0, answer.err
    g = read_transfer(scene / "results/other/transfer.nc")
    assert {abs(p.position[0]) for p in g.inputs} == {0.02}


def test_an_override_changes_g_and_out_chooses_the_folder(solved: Path, tmp_path: Path) -> None:
    out = tmp_path / "elsewhere"
    cli("run", "--until", "solve", "small.toml", "--set", "tissues.override.skin.mu=26e3", "--out", out, cwd=solved)
    soft, stiff = (read_transfer(f / "transfer.nc") for f in (solved / "results/small", out))
    near, far = (abs(g.values[5, 0, 0]) for g in (stiff, soft))
    assert near != pytest.approx(far, rel=1e-3)


@pytest.mark.parametrize(
    ("item", "says"),
    [
        ("device.spacing", "--set expects key.path=value"),
        ("device.spacings=0.04", "device.spacings: unknown key"),
        ("device.spacing=wide", "valid number"),
        ("name.first=x", "is a value, not a table"),
    ],
)
def test_bad_overrides_are_one_sentence(scene: Path, item: str, says: str) -> None:
    answer = cli("run", "--until", "solve", "small.toml", "--set", item, cwd=scene)
    assert answer.code == 2
    assert says in answer.sentence
    assert leftovers(scene) == ["small.toml"]


@pytest.mark.parametrize("arguments", [("run",), ("run", "small.toml", "--sett", "a=1"), ("rnu", "small.toml")])
def test_misuse_is_one_sentence(scene: Path, arguments: tuple[str, ...]) -> None:
    answer = cli(*arguments, cwd=scene)
    assert answer.code == 2
    assert answer.sentence


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("predict", "quick", "--draws", "0"), "'--draws'"),
        (("calibrate", "quick", "--daq", "toaster"), "'--daq': 'toaster'"),
        (("run", "quick", "extra"), "extra"),
        (("run",), "'scenario'"),
        (("frobnicate",), "'frobnicate'"),
    ],
)
def test_a_wrong_option_is_named_with_the_help_that_lists_it(arguments: tuple[str, ...], says: str) -> None:
    answer = cli(*arguments)
    assert answer.code == 2
    assert says in answer.sentence
    assert " --help`" in answer.sentence


def test_an_interruption_ends_with_130(scene: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("forearm_fem.questions.run.simulate", interrupted)
    answer = cli("run", "--until", "solve", "small.toml", cwd=scene)
    assert answer.code == 130
    assert "interrupted" in answer.err
    assert leftovers(scene) == ["small.toml"]


def test_running_out_of_memory_is_one_sentence(scene: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def exhausted(*_: object, **__: object) -> None:
        raise MemoryError

    monkeypatch.setattr("forearm_fem.questions.run.simulate", exhausted)
    answer = cli("run", "--until", "solve", "small.toml", cwd=scene)
    assert answer.code == 2
    assert "memory" in answer.sentence


def test_a_results_folder_that_is_a_file_is_one_sentence(scene: Path) -> None:
    (scene / "taken").write_text("mine")
    answer = cli("run", "--until", "solve", "small.toml", "--out", "taken", cwd=scene)
    assert answer.code == 2
    assert "cannot be written" in answer.sentence
    assert (scene / "taken").read_text() == "mine"


def test_figures_writes_picture_and_numbers(solved: Path) -> None:
    answer = cli("figures", "results/small", "--only", "condition", "--format", "png,svg", cwd=solved)
    assert answer.code == 0, answer.err
    assert {Path(line).suffix for line in answer.out.split()} == {".png", ".svg", ".csv"}
    assert all((solved / line).is_file() for line in answer.out.split())


def test_figures_without_results_says_how_to_make_them(scene: Path) -> None:
    answer = cli("figures", "results/small", cwd=scene)
    assert answer.code == 2
    assert "forearm-fem run" in answer.sentence
