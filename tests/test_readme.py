"""Every Python example of the README runs as it stands, in a folder laid out as a user's."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from test_skin_model import SCENE

from forearm_fem.pipeline.folder import Run, run_solve
from forearm_fem.scenario import parse_scenario

HOME = Path(__file__).parents[1]
EXAMPLES = re.findall(r"```python\n(.*?)```", (HOME / "README.md").read_text(encoding="utf-8"), re.DOTALL)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """scenarios/ of the repository, and results/thesis of a scene small enough for a test."""
    home = tmp_path_factory.mktemp("user")
    (home / "scenarios").symlink_to(HOME / "scenarios")
    run_solve(Run.start(parse_scenario(SCENE), home / "results" / "thesis", home))
    return home


def test_readme_has_examples():
    assert len(EXAMPLES) >= 2


@pytest.mark.parametrize("example", EXAMPLES)
def test_example_runs(example, folder, monkeypatch):
    monkeypatch.chdir(folder)
    exec(compile(example, "README.md", "exec"), {})
