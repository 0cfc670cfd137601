"""The manual's sources: every key described, every place in the code there, every link found."""

from __future__ import annotations

import ast
import json
import re
import runpy
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import forearm_fem
from forearm_fem.pipeline.layered_engine import flat_ports
from forearm_fem.scenario import Scenario, parse_scenario, scenario_schema

HOME = Path(__file__).parents[1]
DOCS = HOME / "docs"
PAGES = [p for p in DOCS.rglob("*.md") if not {"_build", "made"} & set(p.parts)]
SCRIPTS = sorted((DOCS / "tutorials").glob("[0-9]*.py")) + sorted((DOCS / "gallery").glob("[0-9]*.py"))
sys.path[:0] = [str(DOCS / "_ext"), str(DOCS)]  # the role ``place`` looks names up with the same function
ROOTS = [HOME / "README.md", HOME / "CONTRIBUTING.md"]


def _undescribed(part: dict, known: dict, path: str) -> list[str]:
    missing = []
    for name, entry in part.get("properties", {}).items():
        refs = re.findall(r'"#/\$defs/(\w+)"', json.dumps(entry))
        tables = [r for r in refs if "properties" in known[r]]
        if not tables and not entry.get("description"):
            missing.append(f"{path}{name}")
        for each in tables:
            missing += _undescribed(known[each], known, f"{path}{name}.")
    return missing


def test_every_scenario_key_is_described():
    schema = json.loads(scenario_schema())
    assert _undescribed(schema, schema["$defs"], "") == []


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(DOCS)))
def test_places_named_on_a_page_are_in_the_code(page):
    from dotted_names import found

    for name in re.findall(r"\{place\}`(?:[^`<]*<)?([\w.]+)>?`", page.read_text(encoding="utf-8")):
        found(name)


@pytest.mark.parametrize("page", [*PAGES, *ROOTS], ids=lambda p: str(p.relative_to(HOME)))
def test_links_to_files_lead_somewhere(page):
    text = re.sub(r"```.*?```|`[^`\n]*`", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    for target in re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", text):
        if "://" not in target and "/made/" not in f"/{target}":
            assert (page.parent / target).exists(), target


def test_decisions_that_code_names_are_there():
    known = {p.name[:4] for p in (DOCS / "decisions").glob("[0-9]*.md")}
    named = set()
    for file in [*(HOME / "forearm_fem").rglob("*.py"), *(HOME / "tests").glob("*.py")]:
        named |= set(re.findall(r"docs/decisions/(\d{4})", file.read_text(encoding="utf-8")))
    assert named
    assert named <= known


def test_sections_of_the_physics_data_that_code_cites_are_there():
    page = (DOCS / "theory" / "physics_data.md").read_text(encoding="utf-8")
    headings = set(re.findall(r"^#+ (\d(?:\.\d)?) ", page, re.MULTILINE)) | set(re.findall(r"\((8\.\d)\)", page))
    for file in (HOME / "forearm_fem").rglob("*.py"):
        for section in re.findall(r"physics_data\.md (\d(?:\.\d)?)", file.read_text(encoding="utf-8")):
            assert section in headings, f"{file.name}: {section}"


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda p: p.stem)
def test_pages_of_the_gallery_assert_a_number(script):
    assert any(isinstance(node, ast.Assert) for node in ast.walk(ast.parse(script.read_text(encoding="utf-8"))))


def _python(page: Path) -> str:
    text = page.read_text(encoding="utf-8")
    return "\n".join(re.findall(r"```python\n(.*?)```", text, re.DOTALL)) if page.suffix == ".md" else text


WITH_PYTHON = [p for p in [*PAGES, HOME / "README.md"] if _python(p)]


@pytest.mark.parametrize("script", [*SCRIPTS, *WITH_PYTHON], ids=lambda p: p.stem)
def test_examples_keep_to_the_public_api(script):
    from public_rooms import PUBLIC, public_names

    code = _python(script)
    tree = ast.parse(code)
    imported = {a.name.split(".")[0] for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names}
    imported |= {str(n.module).split(".")[0] for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)}
    brought = {"__future__", "forearm_fem", "numpy", "matplotlib", "pyvista", "trimesh"}  # by the package itself
    others = imported - set(sys.stdlib_module_names) - brought
    assert not others, "a page that is downloaded runs where the package is installed"
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("forearm_fem"):
            assert node.module in PUBLIC
            assert {alias.name for alias in node.names} <= set(public_names(node.module)), node.module


@pytest.mark.parametrize("script", SCRIPTS[:1], ids=lambda p: p.stem)
def test_the_first_tutorial_runs(script, monkeypatch):
    """Five seconds on the twin; all others run when the manual is built."""
    monkeypatch.chdir(script.parent)
    import matplotlib.pyplot as plt

    runpy.run_path(str(script), run_name="__main__")
    plt.close("all")


def test_readme_is_short_and_every_sentence_has_two_numbers_at_most():
    text = (HOME / "README.md").read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 120
    prose = re.sub(r"```.*?```", "", text, flags=re.DOTALL)
    prose = "\n".join(line for line in prose.splitlines() if not line.startswith(("|", "#", "!")))
    prose = re.sub(r"\]\([^)]*\)|`[^`]*`", "", prose)
    for sentence in re.split(r"(?<=[.:;])\s+", " ".join(prose.split())):
        assert len(re.findall(r"\d[\d.,]*", sentence)) <= 2, sentence


def _arms() -> list[tuple[str, dict]]:
    """(page, scenario) of the manual's TOML that is a scenario on a limb of the program's own."""
    found = []
    for page in PAGES:
        for text in re.findall(r"```toml\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL):
            table = tomllib.loads(text)
            if set(table) <= set(Scenario.model_fields) and "limb" not in table:
                found.append((page.stem, table))
    return found


def test_arrangements_that_the_manual_shows_fit_the_arm():
    """A reader copies them: they load, and each contact and point lands on the default arm's volar skin."""
    assert len(_arms()) >= 3
    for _, table in _arms():
        assert flat_ports(parse_scenario(table))


def _lines() -> set[str]:
    """Command lines that a page shows to be copied: in a block, or after ``::`` in a tutorial."""
    found = []
    for page in [*PAGES, *SCRIPTS]:
        text = page.read_text(encoding="utf-8")
        blocks = re.findall(r"```([^\n`]*)\n(.*?)```", text, re.DOTALL)
        shown = [b for language, b in blocks if not language] if page.suffix == ".md" else [text]
        found += [line for block in shown for line in re.findall(r"^#? *(forearm-fem [a-z].*)$", block, re.MULTILINE)]
    parts = (part.strip() for line in found for part in re.split(r" +# |&&", line))
    return {part for part in parts if part.startswith("forearm-fem ")}


def test_lines_to_be_copied_have_the_options_they_need_and_no_others():
    from command_pages import every_command

    commands = dict(every_command())
    assert len(_lines()) > 30
    for line in _lines():
        words = shlex.split(line)[1:]
        name = " ".join(words[:2]) if words[0] == "study" else words[0]
        options = [p for p in commands[name].params if p.param_type_name == "option"]
        known = {o for p in options for o in (*p.opts, *p.secondary_opts)}
        given = {w for w in words if w.startswith("--")}
        assert given <= known, line
        assert {p.opts[0] for p in options if p.required} <= given, line


def test_every_option_is_described_and_its_description_reaches_the_reader():
    """The help is rich text, in which "[dB]" is a style and vanishes; the manual has both halves of a flag."""
    from command_pages import every_command, option_text

    names = [name for name, _ in every_command()]
    assert {"run", "study run", "study withdraw"} <= set(names)
    for name, command in every_command():
        for given in command.params:
            assert given.help or given.name == "help", f"{name}: {given.name}"
            assert "[" not in (given.help or ""), f"{name}: {given.name}"
    options = {p.name: p for p in dict(every_command())["fit"].params}
    assert option_text(options["fem"])[0] == "--fem / --twin"
    assert option_text(options["fem"])[1].endswith("(default: --twin)")


def test_a_figure_of_pyplot_is_shown_once(tmp_path):
    """Also where the cell's last line drew on it: the gallery's own scraper closes what it has shown."""
    pytest.importorskip("sphinx_gallery")
    import matplotlib.pyplot as plt
    from own_figures import scraper
    from sphinx_gallery.gen_gallery import DEFAULT_GALLERY_CONF

    _, axes = plt.subplots()
    axes.plot([0, 1], label="a line")
    paths = [tmp_path / "1.png", tmp_path / "2.png"]
    shown = {"example_globals": {"___": axes.legend()}, "image_path_iterator": iter(paths)}
    conf = {**DEFAULT_GALLERY_CONF, "matplotlib_animations": (False, "jshtml"), "src_dir": str(tmp_path)}
    assert scraper(("code", "", 1), shown, conf)
    assert [path.exists() for path in paths] == [True, False]
    scraper(("code", "", 1), shown, conf)  # a block that draws nothing
    assert not paths[1].exists()


def test_broken_links_of_a_built_page_are_found(tmp_path):
    from check_links import broken

    (tmp_path / "a.html").write_text('<p id="here"><a href="b.html#there">1</a><a href="#here">2</a><img src="c.png">')
    (tmp_path / "b.html").write_text('<p id="there"><a href="a.html#gone">1</a><a href="https://example.org/x">2</a>')
    assert broken(tmp_path) == ["a.html: c.png", "b.html: a.html#gone"]


@pytest.mark.slow  # three minutes; CI builds the manual too
def test_manual_builds_without_a_warning(tmp_path):
    pytest.importorskip("sphinx")
    command = [sys.executable, "-m", "sphinx", "-W", "-b", "html", str(DOCS), str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "index.html").is_file()
    assert forearm_fem.__version__ in (tmp_path / "index.html").read_text(encoding="utf-8")
