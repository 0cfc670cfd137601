"""What a command is given is looked at before it begins, and what a file leaves open can be said where it is asked."""

from __future__ import annotations

import functools
import inspect
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args, get_type_hints

import numpy as np
import pytest
from cli_runner import SMALL, cli, every_command, leftovers
from scipy.io import savemat

from forearm_fem.cli import app as program
from forearm_fem.geometry.device.layout import planform_ports
from forearm_fem.ports import Port
from forearm_fem.results.files import write_transfer
from forearm_fem.scenario import load_scenario
from forearm_fem.store.folder import set_kind
from forearm_fem.transfer import TransferMatrix

WRITTEN = {"out", "save", "page", "data", "folder"}  # paths that a command makes
STUDY = 'name = "s"\nscenario = "small.toml"\ntransfer = "lab.csv"\n'
SAID = ("unit='um/V'", "sign='+iwt'", "spectrum='one-sided'")
LINES = {  # every command that reads a G, with a file that says nothing of itself
    "calibrate": ("small.toml", "--through", "lab.csv"),
    "convert": ("lab.csv", "lab.mat", "--scenario", "small.toml"),
    "daq play": ("small.toml", "drives.nc", "--through", "lab.csv"),
    "compare": ("lab.csv", "lab.csv", "--scenario", "small.toml"),
    "render": ("lab.csv", "--scenario", "small.toml"),
    "fit": ("small.toml", "lab.csv", "scale"),
    "workbench": ("lab.csv", "--scenario", "small.toml"),
    "validate": ("small.toml", "--measured", "lab.csv"),
    "study run": ("s.toml", "--participant", "01", "--task", "identification"),
    "study new": ("t", "--scenario", "small.toml", "--transfer", "lab.csv"),
    "study stimuli": ("s.toml", "--participant", "01"),
}


@pytest.fixture
def lab(tmp_path: Path) -> Path:
    """A scenario, a study, and a table that says nothing but its numbers."""
    (tmp_path / "small.toml").write_text(SMALL)
    (tmp_path / "s.toml").write_text(STUDY)
    (tmp_path / "drives.nc").write_text("looked at later")
    rows = [f"{f},{o},A{i},1.0,0.0" for f in (20, 24) for o in range(1, 10) for i in range(1, 5)]
    (tmp_path / "lab.csv").write_text("\n".join(["frequency_Hz,output,input,real,imag", *rows]))
    return tmp_path


def declared(said: tuple[str, ...], command: str) -> list[str]:
    option = "--declare-a" if command == "compare" else "--declare"
    return [word for item in said for word in (option, item)]


def bodies() -> dict[str, Any]:
    """What holds each command's function, by the command's name."""
    groups = [("", program.app), *((f"{g.name} ", g.typer_instance) for g in program.app.registered_groups)]
    return {f"{b}{i.callback.__name__}": i for b, app in groups for i in app.registered_commands if i.callback}


def paths() -> list[tuple[str, Any]]:
    """(command, parameter) of every path that must be there."""
    found = []
    for name, command in every_command():
        types = get_type_hints(bodies()[name].callback)
        wanted = [p for p in command.params if p.name in types and p.name not in WRITTEN]
        found += [(name, p) for p in wanted if Path in (types[p.name], *get_args(types[p.name]))]
    return found


def test_every_command_that_takes_a_g_is_among_those_tried() -> None:
    """A G in a file is known by the word in the path's help; that of a participant is named by the study."""
    takes = {name for name, p in paths() if re.search(r"\bG\b", p.help) and p.name != "scenario"}
    assert takes | {"study run", "study stimuli"} == set(LINES)


@pytest.mark.parametrize("command", LINES)
def test_what_a_file_does_not_say_is_asked_for_at_once_and_can_be_said(lab: Path, command: str) -> None:
    asked = cli(*command.split(), *LINES[command], cwd=lab)
    assert asked.code == 2
    options = declared(("unit='mm/V'", "sign='+iwt'", "spectrum='one-sided'"), command)
    assert " ".join(w if w.startswith("--") else f'"{w}"' for w in options) in asked.sentence
    # a unit that is none comes from the declaration, so the reader had it, and nothing was played or solved
    said = declared(("unit='furlong/V'", *SAID[1:]), command)
    assert "furlong/V" in cli(*command.split(), *LINES[command], *said, cwd=lab).sentence
    assert not any(name.endswith(("transfer.nc", ".html")) for name in leftovers(lab))


def test_all_commands_ask_by_the_same_option() -> None:
    texts = {
        re.sub("a file|the first|the second", "X", p.help, count=1)
        for _, command in every_command()
        for p in command.params
        if p.name.startswith("declare")
    }
    assert len(texts) == 1


@pytest.mark.parametrize(("command", "option"), [("calibrate", "--through"), ("validate", "--measured")])
def test_a_declaration_of_no_file_is_refused(lab: Path, command: str, option: str) -> None:
    answer = cli(command, "small.toml", "--declare", SAID[0], cwd=lab)
    assert (answer.code, f"has no effect without {option}" in answer.sentence) == (2, True)


def test_an_array_without_names_asks_for_all_it_lacks_in_a_sentence(lab: Path) -> None:
    """Which array, unit, sign and sides; then the axes of a square one and its frequencies: two sentences, not six."""
    savemat(lab / "lab.mat", {"H": np.ones((4, 4, 30)) + 0j, "coherence": np.ones((4, 4, 30))})
    square = ("fit", "small.toml", "lab.mat", "scale", "--set", "grid.rows=2", "--set", "grid.columns=2",
              "--set", "rendering.targets='all'")  # fmt: skip
    first = cli(*square, cwd=lab)
    keys = ("variable='H'", "unit='mm/V'", *SAID[1:])
    assert all(f'--declare "{key}"' in first.sentence for key in keys)
    then = cli(*square, *declared(keys, "fit"), cwd=lab)
    assert all(f'--declare "{key}=' in then.sentence for key in ("axes", "sample_rate"))
    assert max(len(first.sentence), len(then.sentence)) <= 300


def never(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function of the same parameters that must not be called."""

    @functools.wraps(function)
    def begun(**_: object) -> None:
        pytest.fail("the command began")

    assert inspect.signature(begun) == inspect.signature(function)
    return begun


@pytest.mark.parametrize(("command", "given"), paths(), ids=lambda x: getattr(x, "name", x))
def test_a_missing_file_is_said_before_the_command_begins(
    lab: Path, monkeypatch: pytest.MonkeyPatch, command: str, given: Any
) -> None:
    """Scenarios are looked up by name, so the command's first line reads them; all else is seen before."""
    body = bodies()[command]
    if given.name != "what" and given.name != "scenario":
        monkeypatch.setattr(body, "callback", never(body.callback))
    words = command.split()
    for p in next(c for name, c in every_command() if name == command).params:
        if p.required or p is given or p.name == given.name:
            named = [p.opts[0]] if p.param_type_name == "option" else []
            fitting = {"scenario": "small.toml", "file": "small.toml", "pilot": ".", "participant": "01"}
            there = fitting.get(p.name, "lab.csv")
            twice = [there] if p.nargs == -1 else []  # two are compared
            words += [*named, *twice, "missing.toml" if p.name == given.name else there]
    before = leftovers(lab)
    answer = cli(*words, cwd=lab)
    assert (answer.code, "missing.toml" in answer.sentence) == (2, True)
    assert leftovers(lab) == before


@pytest.mark.parametrize(
    ("line", "remedy"),
    [
        (("figures", "lab.csv"), "lab.csv: no such results folder; `forearm-fem run SCENARIO` makes one"),
    ],
)
def test_a_table_where_a_run_is_wanted_is_told_which_command_serves(lab: Path, line: Any, remedy: str) -> None:
    assert remedy in cli(*line, cwd=lab).sentence


@pytest.mark.parametrize("line", [("status",), ("analyse",), ("withdraw", "--participant", "01", "--yes")])
def test_answers_are_not_looked_for_in_a_folder_that_is_not_there(lab: Path, line: Any) -> None:
    """An empty one of that name would say that nobody is enrolled."""
    before = leftovers(lab)
    answer = cli("study", line[0], "s.toml", "--data", "mistyped", *line[1:], cwd=lab)
    assert (answer.code, answer.sentence) == (2, "mistyped: no such folder of answers")
    assert leftovers(lab) == before


@pytest.mark.slow  # 2 s
def test_a_language_that_is_not_there_is_said_before_anybody_is_enrolled(lab: Path) -> None:
    """Who is enrolled binds the study file, and the language could not be put right any more."""
    assert cli("run", "small.toml", "--out", "out", cwd=lab).code == 0
    text = (
        'name = "pilot"\nscenario = "small.toml"\ntransfer = "out"\nlanguage = "xx"\n[stimuli]\ntargets = ["5", "6"]\n'
    )
    (lab / "pilot.toml").write_text(text)
    words = ("--participant", "01", "--task", "identification", "--consent", "2026-11-24")
    answer = cli("study", "run", "pilot.toml", *words, cwd=lab)
    assert answer.sentence == "language: 'xx' is neither en, de, nl nor a readable TOML file of texts"
    assert not (lab / "pilot").exists()


def test_a_lost_wavelet_is_said_before_a_run_solves(lab: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("forearm_fem.engines.layered.solve_layered", lambda *_, **__: pytest.fail("solved"))
    (lab / "lost.toml").write_text(f"{SMALL}[rendering.wavelet]\nfile = 'lost.csv'\n")
    answer = cli("run", "lost.toml", "--out", "out", cwd=lab)
    assert (answer.code, "lost.csv" in answer.sentence) == (2, True)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        (("run", "."), "is a folder, expected a TOML file"),
        (("run", "small.toml", "--library", "."), "is a folder, expected a file"),
        (("run", "s.toml"), "names a scenario, so it is a file for `forearm-fem design`"),
        (("fit", "small.toml", "small.toml", "scale"), "is no recipe of a G"),
        (("figures", "."), "no run's folder, unless one works there now"),
        (("fit", "small.toml", "lab.csv", "scale", "--declare", "unit"), "--declare expects key.path=value"),
        (("workbench", ".", "--scenario", "small.toml"), "--scenario and --declare have no effect"),
    ],
)
def test_what_is_of_another_kind_is_called_by_its_name(lab: Path, line: Any, said: str) -> None:
    """And a folder that no run has begun is not recommended for one."""
    before = leftovers(lab)
    answer = cli(*line, cwd=lab)
    assert (answer.code, said in answer.sentence, "--out" in answer.sentence) == (2, True, False), answer.err
    assert leftovers(lab) == before


@pytest.mark.parametrize(
    "line",
    [
        ("workbench", ".", "--save", "small.toml"),
        ("library", "small.toml", "--out", "small.toml"),
        ("daq", "loopback", "small.toml", "--out", "small.toml"),
    ],
)
def test_no_file_that_was_given_is_written_over(lab: Path, line: Any) -> None:
    answer = cli(*line, cwd=lab)
    assert (answer.code, "choose a name that ends in" in answer.sentence) == (2, True)
    assert (lab / "small.toml").read_text() == SMALL


def stored_g(file: Path, **provenance: Any) -> bytes:
    """A G of one entry in ``file``; its bytes."""
    port = Port("1", "point", (0.0, 0.0, 0.0)), Port("A1", "contact", (0.0, 0.0, 0.0))
    g = TransferMatrix(np.array([100.0]), np.ones((1, 1, 1)) + 0j, (port[0],), (port[1],), "m/V", provenance=provenance)
    write_transfer(file, g)
    return file.read_bytes()


@pytest.mark.parametrize(
    ("line", "provenance", "said"),
    [
        (("run", "--until", "solve", "small.toml", "--out", "."), {"source": "measured"}, "holds a measured G"),
        (("calibrate", "small.toml", "--through", "lab.nc", "--out", "."), {"scenario": {}}, "holds a G of a run"),
        (("library", "small.toml", "--set", "engine=fem", "--out", "transfer.nc"), {}, "is there and no library"),
    ],
)
def test_a_g_of_another_origin_is_not_replaced(lab: Path, line: Any, provenance: Any, said: str) -> None:
    before = stored_g(lab / "transfer.nc", **provenance)
    outputs, inputs = planform_ports(load_scenario(lab / "small.toml"))
    g = TransferMatrix(np.array([20.0, 300.0]), np.ones((2, 9, 4)) + 0j, outputs, inputs, "m/V")
    write_transfer(lab / "lab.nc", g)
    answer = cli(*line, cwd=lab)
    assert (answer.code, said in answer.sentence) == (2, True), answer.err
    assert (lab / "transfer.nc").read_bytes() == before


@pytest.mark.parametrize(
    ("line", "said"),
    [
        (("calibrate", "small.toml", "--card", "3"), "--card: has no effect with --daq virtual"),
        (
            ("daq", "play", "small.toml", "drives.nc", "--daq", "sound", "--through", "lab.csv"),
            "--through: has no effect",
        ),
        (("library", "small.toml"), "engine: a library is made of finite elements"),
        (("verify", "--out", "small.toml"), "small.toml: cannot be written"),
        (("calibrate", "small.toml", "--daq", "ni", "--snr", "40"), "--snr: has no effect with --daq ni"),
        (("calibrate", "small.toml", "--daq", "sound", "--declare", "unit=m/V"), "--declare: has no effect with"),
        (("calibrate", "small.toml", "--loopback", "lab.csv"), "--loopback: has no effect with --daq virtual"),
        (
            ("daq", "play", "small.toml", "drives.nc", "--daq", "ni", "--snr", "40"),
            "--snr: has no effect with --daq ni",
        ),
        (("figures", ".", "--format", ","), "--format: expected names between the commas"),
        (("figures", ".", "--only", ","), "--only: expected names between the commas"),
        (("library", "thesis", "--out", "folder.nc"), "folder.nc: is a folder, expected the name of a file"),
        (("figures", ".", "--film", "folder.gif"), "folder.gif: is a folder, expected the name of a file"),
    ],
)
def test_what_would_have_no_effect_or_no_place_is_said_at_once(lab: Path, line: Any, said: str) -> None:
    for name in ("folder.nc", "folder.gif"):
        (lab / name).mkdir()
    before = leftovers(lab)
    answer = cli(*line, cwd=lab)
    assert (answer.code, said in answer.sentence) == (2, True), answer.err
    assert leftovers(lab) == before


def valued() -> list[tuple[str, str]]:
    """(command, option) of every option that takes a value."""
    return [
        (name, parameter.opts[0])
        for name, command in every_command()
        for parameter in command.params
        if parameter.opts[0].startswith("--") and not getattr(parameter, "is_flag", False)
    ]


@pytest.mark.parametrize(("command", "option"), valued())
def test_an_empty_value_is_refused_and_not_taken_for_this_folder(tmp_path: Path, command: str, option: str) -> None:
    """A path of "" is this folder, and an empty list everything: "$RESULTS" of a shell that does not know it."""
    for given in ((option, ""), (f"{option}=",), (option, " ")):
        answer = cli(*command.split(), *given, cwd=tmp_path)
        assert (answer.code, answer.sentence.partition(": expected a value")[0]) == (2, option), answer.err
    assert leftovers(tmp_path) == []


def test_an_empty_argument_is_refused_and_an_empty_text_of_a_key_is_the_keys_matter(tmp_path: Path) -> None:
    assert cli("run", "", cwd=tmp_path).sentence.startswith("an argument: expected a value")
    assert "toml: name: expected a folder's name" in cli("run", "quick", "--set", "name=", cwd=tmp_path).sentence


CAMPAIGN = 'name = "c"\nscenario = "small.toml"\nstage = "solve"\n[[members]]\nname = "m"\n'
DESIGN = 'name = "d"\nscenario = "small.toml"\n[[variables]]\nkey = "device.spacing"\nlow = 0.04\nhigh = 0.05\n'
OF_ANOTHER = {  # each kind of folder, and the line that would work in it
    "run": ("run", "small.toml", "--out"),
    "design": ("design", "d.toml", "--out"),
    "campaign": ("campaign", "c.toml", "--out"),
    "study": ("study", "stimuli", "s.toml", *("--participant", "01"), *declared(SAID, ""), "--data"),
    "calibration": ("calibrate", "small.toml", "--through", "lab.csv", *declared(SAID, ""), "--out"),
}


@pytest.mark.parametrize("kind", OF_ANOTHER)
@pytest.mark.parametrize("own", OF_ANOTHER)
def test_the_folder_of_another_command_is_refused_before_anything_is_written(lab: Path, own: str, kind: str) -> None:
    """Both would write report.md, or figures, and who opens the folder would read one as the other."""
    if own == kind:
        return
    (lab / "c.toml").write_text(CAMPAIGN)
    (lab / "d.toml").write_text(DESIGN)
    set_kind(lab / "theirs", kind)
    before = leftovers(lab)
    answer = cli(*OF_ANOTHER[own], "theirs", cwd=lab)
    assert (answer.code, answer.sentence) == (
        2, f"theirs: holds a {kind} (folder.json), with which a {own} does not mix; name another folder",
    )  # fmt: skip
    assert leftovers(lab) == before
