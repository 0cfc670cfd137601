"""What comes with the package: scenarios by name, a scenario to start from, metadata, and a wheel that stands alone."""

from __future__ import annotations

import ast
import re
import tomllib
from collections.abc import Iterator
from graphlib import TopologicalSorter
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules

from cli_runner import cli as run
from pydantic import BaseModel

import forearm_fem
from forearm_fem.questions.campaign import load_campaign
from forearm_fem.questions.design.model import load_design
from forearm_fem.scenario import Scenario, load_scenario, parse_scenario, scenario_file, scenario_template
from forearm_fem.scenario.model import scenario_beside, shipped_folder, shipped_scenarios
from forearm_fem.scenario.text import all_keys
from forearm_fem.study.run import Prepared

HOME = Path(__file__).parents[1]


def test_shipped_scenarios_are_found_by_name_and_load(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert {"thesis", "quick"} <= set(shipped_scenarios())
    for name in shipped_scenarios():
        assert load_scenario(name) == load_scenario(scenario_file(name))
    assert (shipped_folder("meshes") / "thesis.vtu").is_file()


def test_a_file_of_ones_own_wins_over_a_shipped_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "thesis").write_text("name = 'mine'\n")
    assert scenario_file("thesis") == Path("thesis")
    assert scenario_file("quick.toml") == Path("quick.toml")  # a file that is missing is not replaced silently
    assert scenario_file("no-such") == Path("no-such")
    (tmp_path / "quick").mkdir()  # as a folder of results may be called
    assert scenario_file("quick").name == "quick.toml"
    assert scenario_beside(tmp_path, "quick").name == "quick.toml"


def test_files_that_name_a_scenario_find_shipped_ones_and_prefer_their_own(tmp_path):
    """A study, a campaign and a design written into an empty folder work by a scenario's name, as `run` does."""
    study, campaign, design = (tmp_path / f"{kind}.toml" for kind in ("study", "campaign", "design"))
    study.write_text('name = "pilot"\nscenario = "quick"\n')
    campaign.write_text('name = "few"\nscenario = "quick"\n[grid]\n"device.spacing" = [0.04]\n')
    varied = '[[variables]]\nkey = "device.spacing"\nlow = 0.03\nhigh = 0.05\n'
    design.write_text(f'name = "pitch"\nscenario = "quick"\n{varied}')
    assert Prepared.of(study).scenario.name == "quick"
    assert load_campaign(campaign).members[0].scenario.device.spacing == 0.04
    assert load_design(design).data[0]["name"] == "quick"
    (tmp_path / "quick").write_text('name = "mine"\nengine = "layered"\n')
    assert Prepared.of(study).scenario.name == "mine"


def test_template_is_valid_and_its_keys_are_the_defaults():
    text = scenario_template("mine")
    assert parse_scenario(tomllib.loads(text)).name == "mine"
    every = re.sub(r"^# (\w+ = [^ #].*)$", r"\1", text, flags=re.MULTILINE)
    assert parse_scenario(tomllib.loads(every)) == Scenario(name="mine")
    own = {f"{path}{key}" for path, part in _parts(Scenario(), "") for key in part}
    assert own < _keys_of(text) <= set(all_keys())
    assert {"device.contacts", "sweep.frequencies", "supports.foam_stiffness"} < _keys_of(text) - own  # other kinds'


def _parts(part: BaseModel, path: str) -> Iterator[tuple[str, list[str]]]:
    """Path of each table and the keys in it that hold a value."""
    below = {k: v for k in type(part).model_fields if isinstance(v := getattr(part, k), BaseModel)}
    yield path, [k for k in type(part).model_fields if k not in below]
    for key, each in below.items():
        yield from _parts(each, f"{path}{key}.")


def _keys_of(text: str) -> set[str]:
    """Dotted keys of a template, commented out or not."""
    table, keys = "", set()
    for line in text.splitlines():
        if head := re.fullmatch(r"\[(.+)\]", line):
            table = f"{head[1]}."
        elif key := re.match(r"(?:# )?(\w+) =", line):
            keys.add(table + key[1])
    return keys


def test_new_writes_once_and_never_over_a_file(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert run("new", "mine").code == 0
    assert load_scenario(tmp_path / "mine.toml").name == "mine"
    (tmp_path / "mine.toml").write_text("name = 'kept'\n")
    assert run("new", "mine").code == 2
    assert load_scenario(tmp_path / "mine.toml").name == "kept"
    assert run("new", "../outside").code == 2
    assert not (tmp_path.parent / "outside.toml").exists()


def test_every_name_that_is_promised_is_there():
    """``__all__`` of the package and of its rooms."""
    rooms = [forearm_fem, *(import_module(f"forearm_fem.{r.name}") for r in iter_modules(forearm_fem.__path__))]
    promised = {room.__name__: room.__all__ for room in rooms if hasattr(room, "__all__")}
    assert {"forearm_fem", "forearm_fem.scenario", "forearm_fem.rendering", "forearm_fem.transfer"} <= set(promised)
    missing = [f"{room}.{n}" for room, names in promised.items() for n in names if not hasattr(import_module(room), n)]
    assert missing == []


def test_version_is_the_same_everywhere():
    project = tomllib.loads((HOME / "pyproject.toml").read_text())["project"]
    cited = re.search(r"^version: (.+)$", (HOME / "CITATION.cff").read_text(), re.MULTILINE)
    assert project["version"] == forearm_fem.__version__ == cited[1].strip()
    assert f"## {project['version']}" in (HOME / "CHANGELOG.md").read_text()


def test_rooms_import_no_circles():
    """A reader who goes down from a question to the solver never comes back up; ``notebook`` and ``api`` are the
    facade, which loads every room when it is asked."""
    home, below = HOME / "forearm_fem", dict[str, set[str]]()
    for file in home.rglob("*.py"):
        *folders, name = file.relative_to(home).with_suffix("").parts
        room = (*folders, name)[0]
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.level:
                path = [*folders[: len(folders) + 1 - node.level], *(node.module or "").split(".")]
                heads = [a.name for a in node.names] if path == [""] else [path[0]]
                below.setdefault(room, set()).update(h for h in heads if h not in (room, "notebook", "api"))
    order = list(TopologicalSorter({k: v for k, v in below.items() if k not in ("notebook", "api")}).static_order())
    assert order.index("scenario") < order.index("engines") < order.index("questions") < order.index("cli")
