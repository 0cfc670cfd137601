"""The mutation list is current, and its runner tells a caught mutation from one that survives."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="module")
def mutate():
    spec = importlib.util.spec_from_file_location("mutate", ROOT / "benchmarks" / "mutate.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["mutate"] = module
    spec.loader.exec_module(module)
    yield module
    del sys.modules["mutate"]


def test_every_mutation_still_fits_the_code_and_names_tests_that_exist(mutate):
    mutations = mutate.load()
    assert len(mutations) >= 10
    assert mutate.problems(mutations) == []


def test_the_manual_s_table_is_current(mutate):
    assert (ROOT / "docs" / "mutations.md").read_text(encoding="utf-8") == mutate.page(mutate.load())


ENTRY = """[[mutation]]
name = "{name}"
file = "forearm_fem/sums.py"
old = "{old}"
new = "{new}"
tests = ["tests/test_sums.py::test_double"]
"""


@pytest.fixture
def small(tmp_path, monkeypatch):
    """A repository with one function, half of which its test looks at; pytest starts without plugins, a second less."""
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")
    monkeypatch.setenv("PYTEST_ADDOPTS", "-p xdist.plugin")  # -n 0 is its word
    for file, text in {
        "forearm_fem/__init__.py": "",
        "forearm_fem/sums.py": "def double(x):\n    return 2 * x\n\n\ndef triple(x):\n    return 3 * x\n",
        "tests/test_sums.py": "from forearm_fem.sums import double\n\ndef test_double():\n    assert double(2) == 4\n",
        "tests/mutations/sums.toml": ENTRY.format(name="seen", old="2 * x", new="5 * x"),
    }.items():
        (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / file).write_text(text)
    return tmp_path


def add(root, **entry):
    with (root / "tests" / "mutations" / "sums.toml").open("a") as file:
        file.write(ENTRY.format(**entry))


def test_runner_tells_caught_from_survived_and_leaves_the_package_alone(mutate, small, capsys):
    add(small, name="not seen", old="3 * x", new="4 * x")
    before = (small / "forearm_fem" / "sums.py").read_text()
    assert mutate.main([], small) == 1
    said = capsys.readouterr().out
    assert "1 of 2 caught" in said
    assert "| not seen | forearm_fem/sums.py | **SURVIVED" in said
    assert (small / "forearm_fem" / "sums.py").read_text() == before
    assert mutate.main(["--only", "seen", "--list"], small) == 0


def test_a_log_leaves_out_what_was_caught_until_its_files_change(mutate, small, tmp_path, capsys):
    """What survived is tried again; what was caught only once the code or the test is another."""
    add(small, name="not seen", old="3 * x", new="4 * x")
    log = tmp_path / "log"
    assert mutate.main(["--log", str(log)], small) == 1
    capsys.readouterr()
    assert mutate.main(["--log", str(log)], small) == 1
    said = capsys.readouterr().out
    assert "1 of 2 were caught before" in said
    assert "0 of 1 caught" in said
    assert mutate.main(["--log", str(log), "--only", "sums"], small) == 1
    assert len(mutate.caught_before(log)) == 1
    code = small / "forearm_fem" / "sums.py"
    code.write_text(code.read_text() + "\n")
    assert not {mutate.fingerprint(m, small) for m in mutate.load(small)} & mutate.caught_before(log)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"old": "x", "new": "y"}, "occurs 4 times"),
        ({"old": "7 * x", "new": "y"}, "occurs 0 times"),
        ({"old": "3 * x", "new": "3 * x"}, "`new` is `old`"),
        ({"name": "seen", "old": "3 * x", "new": "4 * x"}, "the name occurs 2 times"),
    ],
)
def test_entries_out_of_date_are_named_and_nothing_is_run(mutate, small, capsys, change, said):
    add(small, **{"name": "other", **change})
    assert mutate.main([], small) == 1
    assert said in capsys.readouterr().out


def test_named_tests_must_exist_and_pass_unbroken(mutate, small, capsys):
    test = small / "tests" / "test_sums.py"
    test.write_text(test.read_text().replace("== 4", "== 5"))
    assert mutate.main([], small) == 1
    assert "fail without any mutation" in capsys.readouterr().out
    test.write_text("")
    assert mutate.main([], small) == 1
    assert "is no test of this repository" in capsys.readouterr().out


def test_a_mutant_that_does_not_even_load_counts_as_a_broken_entry(mutate, small, capsys):
    add(small, name="syntax", old="def triple(x):", new="def triple(x:")
    assert mutate.main(["--only", "syntax"], small) == 1
    assert "did not run" in capsys.readouterr().out
