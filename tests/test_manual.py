"""What the README and the manual tell people to type works: commands, examples, scenarios, the first tutorial."""

from __future__ import annotations

import ast
import importlib
import json
import re
import runpy
import shlex
import shutil
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
from cli_runner import every_command
from scenes import once
from test_skin_model import solve

from forearm_fem.engines.forecast import forecast
from forearm_fem.engines.layered import flat_ports
from forearm_fem.scenario import Scenario, load_scenario, parse_scenario, scenario_schema

HOME = Path(__file__).parents[1]
DOCS = HOME / "docs"
README = HOME / "README.md"
PAGES = [README, *(p for p in sorted(DOCS.rglob("*.md")) if not {"_build", "made"} & set(p.parts))]
SCRIPTS = sorted((DOCS / "tutorials").glob("[0-9]*.py")) + sorted((DOCS / "gallery").glob("[0-9]*.py"))


def blocks(page: Path, language: str = "") -> list[str]:
    """Blocks of code in one language (none: of a shell) on a page."""
    return re.findall(rf"```{language}\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)


# --- examples in Python ----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """scenarios/ of the repository, and results/thesis of a scene small enough for a test."""
    home = tmp_path_factory.mktemp("user")
    (home / "scenarios").symlink_to(HOME / "scenarios")
    shutil.copytree(once(tmp_path_factory, "skin_model", solve) / "out", home / "results" / "thesis")
    return home


@pytest.mark.filterwarnings("ignore:.*outside the band of this reduced model")  # this scene's is narrower
@pytest.mark.parametrize("example", blocks(README, "python"))
def test_an_example_of_the_readme_runs(example: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    exec(compile(example, "README.md", "exec"), {})


def test_the_first_tutorial_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Five seconds on flat layers; all others run when the manual is built."""
    monkeypatch.chdir(SCRIPTS[0].parent)
    import matplotlib.pyplot as plt

    runpy.run_path(str(SCRIPTS[0]), run_name="__main__")
    plt.close("all")


WITH_PYTHON = [*SCRIPTS, *(p for p in PAGES if blocks(p, "python"))]


@pytest.mark.parametrize("page", WITH_PYTHON, ids=lambda p: p.stem)
def test_examples_import_public_names_of_what_the_install_brings(page: Path) -> None:
    code = page.read_text(encoding="utf-8") if page.suffix == ".py" else "\n".join(blocks(page, "python"))
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.Import):
            modules = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            modules = [str(node.module)]
        else:
            continue
        brought = {"__future__", "forearm_fem", "numpy", "matplotlib", "pyvista", "trimesh", "xarray"}
        own = brought | set(sys.stdlib_module_names)
        assert {m.split(".")[0] for m in modules} <= own
        if isinstance(node, ast.ImportFrom) and modules[0].startswith("forearm_fem"):
            public = importlib.import_module(modules[0]).__all__
            assert {alias.name for alias in node.names} <= set(public), modules[0]


# --- lines for a shell -----------------------------------------------------------------------------------------------


def lines() -> set[str]:
    """Command lines to be copied: on a page in a block, in a tutorial after ``::``."""
    shown = [*(block for page in PAGES for block in blocks(page)), *(p.read_text(encoding="utf-8") for p in SCRIPTS)]
    found = {line for text in shown for line in re.findall(r"^#? *(forearm-fem [a-z].*)$", text, re.MULTILINE)}
    found |= {f"forearm-fem {line}" for line in re.findall(r"forearm-fem ([a-z][^`\n&]*)", README.read_text("utf-8"))}
    parts = {part.strip() for line in found for part in re.split(r" +# |&&", line)}
    return {part for part in parts if part.startswith("forearm-fem ")}


@pytest.mark.parametrize("line", sorted(lines()))
def test_a_line_to_be_copied_has_the_options_it_needs_and_no_others(line: str) -> None:
    words = shlex.split(line)[1:]
    name = " ".join(words[:2]) if words[0] == "study" else words[0]
    options = [p for p in dict(every_command())[name].params if p.param_type_name == "option"]
    given = {w for w in words if w.startswith("--")}
    assert given <= {o for p in options for o in (*p.opts, *p.secondary_opts)}
    assert {p.opts[0] for p in options if p.required} <= given


def test_every_option_is_described_and_its_description_reaches_the_reader() -> None:
    """The help is rich text, in which "[dB]" is a style and vanishes."""
    for name, command in every_command():
        for given in command.params:
            assert given.help or given.name == "help", f"{name}: {given.name}"
            assert "[" not in (given.help or ""), f"{name}: {given.name}"


def test_the_dry_run_says_what_the_thesis_run_took() -> None:
    """Too little runs out of memory, too much refuses what would run; of three runs 1.02 to 1.16 of it is said."""
    rows = (HOME / "benchmarks" / "results" / "account.csv").read_text(encoding="utf-8").splitlines()[1:]
    peak = 1e9 * max(float(row.split(",")[4]) for row in rows)
    said = forecast(load_scenario(HOME / "scenarios" / "thesis.toml"), base=HOME / "scenarios").memory_bytes
    assert 0.95 * peak < said < 1.2 * peak


# --- scenarios -------------------------------------------------------------------------------------------------------


def _undescribed(part: dict[str, Any], known: dict[str, Any], path: str) -> list[str]:
    missing = []
    for name, entry in part.get("properties", {}).items():
        tables = [r for r in re.findall(r'"#/\$defs/(\w+)"', json.dumps(entry)) if "properties" in known[r]]
        if not tables and not entry.get("description"):
            missing.append(f"{path}{name}")
        for each in tables:
            missing += _undescribed(known[each], known, f"{path}{name}.")
    return missing


def test_every_scenario_key_is_described() -> None:
    schema = json.loads(scenario_schema())
    assert _undescribed(schema, schema["$defs"], "") == []


def test_arrangements_that_the_manual_shows_fit_the_arm() -> None:
    """A reader copies them: they load, and each contact and point lands on the default arm's volar skin."""
    tables = [tomllib.loads(text) for page in PAGES for text in blocks(page, "toml")]
    arms = [t for t in tables if set(t) <= set(Scenario.model_fields) and "limb" not in t]
    assert arms
    for table in arms:
        assert flat_ports(parse_scenario(table))
