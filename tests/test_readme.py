"""Every Python example of the README runs as it stands, in a folder laid out as a user's."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
from test_skin_model import SCENE
from typer.main import get_command

from forearm_fem.cli import app
from forearm_fem.pipeline.folder import Run, run_solve
from forearm_fem.pipeline.forecast import forecast
from forearm_fem.scenario import load_scenario, parse_scenario

HOME = Path(__file__).parents[1]
README = (HOME / "README.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"```python\n(.*?)```", README, re.DOTALL)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """scenarios/ of the repository, and results/thesis of a scene small enough for a test."""
    home = tmp_path_factory.mktemp("user")
    (home / "scenarios").symlink_to(HOME / "scenarios")
    run_solve(Run.start(parse_scenario(SCENE), home / "results" / "thesis", home))
    return home


def test_readme_has_examples():
    assert len(EXAMPLES) >= 2


@pytest.mark.filterwarnings("ignore:.*outside the band of this reduced model")  # this scene's is narrower
@pytest.mark.parametrize("example", EXAMPLES)
def test_example_runs(example, folder, monkeypatch):
    monkeypatch.chdir(folder)
    exec(compile(example, "README.md", "exec"), {})


ROOT: Any = get_command(app)


@pytest.mark.parametrize("line", sorted(set(re.findall(r"forearm-fem ([a-z][^`\n&]*)", README))))
def test_a_command_of_the_readme_is_there_with_its_options(line):
    command, words = ROOT, line.split()
    while hasattr(command, "commands"):
        command = command.commands[words.pop(0)]
    known = {option for p in command.params for option in p.opts}
    assert {w for w in words if w.startswith("--")} <= known
    needed = [p.opts[0] for p in command.params if p.required and p.param_type_name == "option"]
    assert set(needed) <= set(words), "the line ends in a complaint when it is copied"
    shipped = {p.stem for p in (HOME / "scenarios").glob("*.toml")}
    assert all(w in shipped or w.isupper() or w == "virtual" for w in words if w.isalpha())


def test_files_that_the_readme_names_are_there():
    named = re.findall(r"(?:python3? |`)((?:scenarios|benchmarks|docs)/[\w/]+\.\w+)|\]\(([^)#]+)\)", README)
    assert len(named) > 10
    assert [n for pair in named for n in pair if n and not (HOME / n).exists()] == []


def test_the_readme_can_be_finished():
    assert len(README.splitlines()) <= 120


TEXT = re.sub(r"\s+", " ", README)
CLAIMS = tomllib.loads((HOME / "tests" / "readme_claims.toml").read_text(encoding="utf-8"))["claim"]


def promises() -> list[str]:
    """Every sentence and row of the README outside its examples, but for heads of tables and words that end in a colon
    and hand over to an example.
    """
    prose = re.sub(r"```.*?```", "", README, flags=re.DOTALL)
    blocks = [" ".join(b.split()) for b in re.split(r"\n(?=\|)|\n\n", prose)]
    pieces = [p for b in blocks if b and not b.startswith(("#", "!")) for p in re.split(r"(?<=[.:;])\s(?=[A-Z])", b)]
    heads = ("| ---", "| to | do |", "| what | true |", "| what | time |")
    return [p for p in pieces if not p.startswith(heads) and p != "Tests:"]


@pytest.mark.parametrize("claim", CLAIMS, ids=lambda c: c["says"][:40])
def test_a_claim_of_the_readme_is_held_by_what_is_there(claim):
    assert claim["says"] in TEXT, "the README says it no longer: change or delete the claim"
    for place in claim["held_by"]:
        file, _, test = place.partition("::")
        assert (HOME / file).exists(), place
        assert not test or f"def {test}(" in (HOME / file).read_text(encoding="utf-8"), place


def test_every_promise_of_the_readme_names_what_holds_it():
    """A sentence that no claim of tests/readme_claims.toml speaks of has nothing behind it."""
    spoken = [c["says"] for c in CLAIMS]
    assert [p for p in promises() if not any(s in p for s in spoken)] == []


def test_the_dry_run_says_what_the_thesis_run_took():
    """Too little runs out of memory, too much refuses what would run; of three runs 1.02 to 1.16 of it is said."""
    lines = (HOME / "benchmarks" / "results" / "account.csv").read_text(encoding="utf-8").splitlines()[1:]
    peak = 1e9 * max(float(line.split(",")[4]) for line in lines)
    said = forecast(load_scenario(HOME / "scenarios" / "thesis.toml"), base=HOME / "scenarios").memory_bytes
    assert 0.95 * peak < said < 1.2 * peak


def test_what_the_thesis_run_costs_is_said_alike():
    """Three pages name minutes and gigabytes of `run thesis`; what was timed is benchmarks/results/account.csv."""
    lines = (HOME / "benchmarks" / "results" / "account.csv").read_text(encoding="utf-8").splitlines()[1:]
    stages = [line.split(",") for line in lines]
    minutes = (float(stages[-1][1]) + float(stages[-1][2])) / 60
    gigabytes = max(float(s[4]) for s in stages)
    start, accuracy = ((HOME / "docs" / p).read_text(encoding="utf-8") for p in ("start.md", "howto/accuracy.md"))
    words = dict(enumerate(("two", "three", "four", "five", "six", "seven", "eight", "nine", "ten"), start=2))
    said = re.search(r"\| ([\d.]+) min from an empty cache, kernels compiled \| ([\d.]+) GB", README)
    assert said is not None
    assert [float(v) for v in said.groups()] == pytest.approx([minutes, gigabytes], abs=0.06)  # one digit is printed
    assert f"{words[round(minutes)]} minutes and {words[round(gigabytes)]} gigabytes" in start
    assert f"| 0.025 | {words[round(minutes)]} minutes |" in accuracy
