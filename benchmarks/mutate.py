"""Mutation list: each promise broken once in a copy of the repository, and the test that has to notice.

``python benchmarks/mutate.py [--only NAME] [--list] [--jobs 2]`` reads ``tests/mutations/*.toml`` and, for each
entry, changes one place of one file in a scratch copy, runs the named tests there and expects them to fail. Before
that the named tests must pass on an unchanged copy. Exit code 1 if a mutation survives or an entry is out of date.

With ``--log FILE`` each outcome is written down as it ends, and entries caught before are left out as long as the
entry, its file and the files of its tests are as they were then: the list can be tried in pieces. Code elsewhere may
have changed since; without the option everything is tried.

An entry has ``name``, ``file`` (from the repository's root), ``old`` (text that occurs exactly
once in it), ``new`` and ``tests`` (pytest's names). Copies keep their times, so compiled kernels are reused; a changed
module that compiles kernels gets a fresh kernel cache, for numba does not see that a function inlined from another
file changed.
"""

from __future__ import annotations

import argparse
import ast
import hashlib
import os
import queue
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = "forearm_fem"
_KEYS = {"name", "file", "old", "new", "tests"}
_TOO_LONG = 900.0  # s: a mutation that makes a test hang is noticed, too


@dataclass(frozen=True)
class Mutation:
    """One place of ``file`` where ``old`` becomes ``new``, and the ``tests`` that must fail then."""

    name: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]


@dataclass(frozen=True)
class Outcome:
    """What became of one mutation: caught, or the sentence that says why not; and the seconds it took."""

    mutation: Mutation
    problem: str
    seconds: float

    @property
    def caught(self) -> bool:
        """Whether the tests failed."""
        return not self.problem


def load(root: Path = ROOT) -> list[Mutation]:
    """All mutations below ``root``/tests/mutations, by file and order; ValueError for a misspelt or missing key."""
    found = []
    for file in sorted((root / "tests" / "mutations").glob("*.toml")):
        for entry in tomllib.loads(file.read_text(encoding="utf-8")).get("mutation", []):
            if set(entry) != _KEYS:
                raise ValueError(f"{file.name}: '{entry.get('name', '?')}' needs exactly the keys {sorted(_KEYS)}")
            found.append(Mutation(**{**entry, "tests": tuple(entry["tests"])}))
    return found


def fingerprint(m: Mutation, root: Path = ROOT) -> str:
    """SHA-256 of an entry, the file it breaks and the files of its tests."""
    digest = hashlib.sha256(repr(m).encode())
    for name in sorted({m.file, *(test.split("::")[0] for test in m.tests)}):
        digest.update((root / name).read_bytes())
    return digest.hexdigest()[:16]


def caught_before(log: Path) -> frozenset[str]:
    """Fingerprints that a log names as caught."""
    lines = log.read_text(encoding="utf-8").splitlines() if log.is_file() else []
    return frozenset(line.split("\t")[0] for line in lines if "\tcaught\t" in line)


def problems(mutations: Sequence[Mutation], root: Path = ROOT) -> list[str]:
    """What is out of date in the list, one sentence each: nothing is run."""
    said = [p for m in mutations for p in _entry_problems(m, root)]
    names = [m.name for m in mutations]
    return [*said, *(f"{n}: the name occurs {names.count(n)} times" for n in sorted(set(names)) if names.count(n) > 1)]


def _entry_problems(m: Mutation, root: Path) -> Iterable[str]:
    source = root / m.file
    if not source.is_file():
        yield f"{m.name}: {m.file} is no file of this repository"
    elif (count := source.read_text(encoding="utf-8").count(m.old)) != 1:
        yield f"{m.name}: `old` occurs {count} times in {m.file}, expected once"
    if m.old == m.new:
        yield f"{m.name}: `new` is `old`"
    if not m.tests:
        yield f"{m.name}: names no test"
    for test in m.tests:
        if not _defined(test, root):
            yield f"{m.name}: {test} is no test of this repository"


def _defined(test: str, root: Path) -> bool:
    """Whether a function of a test's name is written in its file (a parameter in brackets is left to pytest)."""
    path, *inner = test.split("[")[0].split("::")
    file = root / path
    if not file.is_file() or not inner:
        return file.is_file()
    return inner[-1] in _functions(file.read_text(encoding="utf-8"))


@cache
def _functions(source: str) -> frozenset[str]:
    """Names of all functions in a file's text: many mutations name tests of one file."""
    return frozenset(n.name for n in ast.walk(ast.parse(source)) if isinstance(n, ast.FunctionDef))


def copied(root: Path, folder: Path) -> Path:
    """A copy of the repository in ``folder``, compiled kernels and times included."""
    left_out = shutil.ignore_patterns(".git", "_build", "results", ".venv", ".*_cache")
    shutil.copytree(root, folder, ignore=left_out)
    return folder


def attempt(m: Mutation, scratch: Path, root: Path = ROOT) -> Outcome:
    """Break ``scratch``'s copy, run its tests, mend it."""
    began, target, original = time.perf_counter(), scratch / m.file, root / m.file
    text = original.read_text(encoding="utf-8")
    target.write_text(text.replace(m.old, m.new), encoding="utf-8")
    try:
        with tempfile.TemporaryDirectory() as kernels:
            code, output = run_tests(m.tests, scratch, kernels=kernels if "njit" in text else None)
    finally:
        shutil.copy2(original, target)
    problem = {0: "SURVIVED: its tests pass", 1: ""}.get(code, f"the tests did not run (exit code {code}): {output}")
    return Outcome(m, problem, time.perf_counter() - began)


def run_tests(tests: Sequence[str], scratch: Path, kernels: str | None = None) -> tuple[int, str]:
    """pytest's exit code for ``tests`` with the package of ``scratch``, and what it says failed; 1 also for a hang."""
    where = {"PYTHONPATH": str(scratch), "PYTHONSAFEPATH": "1", "PYTHONDONTWRITEBYTECODE": "1", "MPLBACKEND": "Agg"}
    environment = {**os.environ, **where, **({"NUMBA_CACHE_DIR": kernels} if kernels else {})}
    with tempfile.TemporaryDirectory() as cache:
        environment["FOREARM_FEM_CACHE"] = cache
        options = ["-x", "--no-header", "-n", "0", "-p", "no:cacheprovider", "-m", ""]
        command = [sys.executable, "-m", "pytest", *options, *tests]
        try:
            done = subprocess.run(
                command, cwd=scratch, env=environment, capture_output=True, text=True, timeout=_TOO_LONG, check=False
            )
        except subprocess.TimeoutExpired:
            return 1, f"no end after {_TOO_LONG:g} s"
    lines = done.stdout.splitlines()
    named = [line for line in lines if line.startswith(("FAILED", "ERROR"))] or lines[-1:]
    return done.returncode, "; ".join(named) or done.stderr.strip()[-300:]


def _check_copy(scratch: Path) -> None:
    """RuntimeError if the tests would not see the copy."""
    code = f"import {PACKAGE}; print({PACKAGE}.__file__)"
    environment = {**os.environ, "PYTHONPATH": str(scratch), "PYTHONSAFEPATH": "1"}
    where = subprocess.run(
        [sys.executable, "-c", code], cwd=scratch, env=environment, capture_output=True, text=True, check=True
    ).stdout.strip()
    if not Path(where).is_relative_to(scratch):
        raise RuntimeError(f"the tests would import {where}, not the copy; nothing was tried")


def run(mutations: Sequence[Mutation], jobs: int = 1, root: Path = ROOT, log: Path | None = None) -> list[Outcome]:
    """Try all ``mutations`` on ``jobs`` scratch copies, printing each as it ends, and writing it to a ``log``.

    RuntimeError if the named tests fail without any.
    """
    keys = {m.name: fingerprint(m, root) for m in mutations}
    with tempfile.TemporaryDirectory() as folder:
        free: queue.Queue[Path] = queue.Queue()
        for job in range(jobs):
            free.put(copied(root, Path(folder).resolve() / str(job)))
        first = Path(folder).resolve() / "0"
        _check_copy(first)
        code, last = run_tests(sorted({t for m in mutations for t in m.tests}), first)
        if code:
            raise RuntimeError(f"the named tests fail without any mutation, so nothing can be learned: {last}")

        def one(m: Mutation) -> Outcome:
            """One mutation in a scratch copy that is free."""
            scratch = free.get()
            try:
                outcome = attempt(m, scratch, root)
            finally:
                free.put(scratch)
            became = "caught" if outcome.caught else outcome.problem
            print(f"{became:8} {outcome.seconds:6.1f} s  {m.name}", flush=True)
            if log is not None:
                with log.open("a", encoding="utf-8") as file:
                    file.write(f"{keys[m.name]}\t{became}\t{outcome.seconds:.0f} s\t{m.name}\n")
            return outcome

        with ThreadPoolExecutor(jobs) as pool:
            return list(pool.map(one, mutations))


def table(outcomes: Sequence[Outcome]) -> str:
    """The outcomes as a Markdown table."""
    lines = ["| mutation | file | caught by | s |", "| --- | --- | --- | --- |"]
    for o in outcomes:
        by = ", ".join(o.mutation.tests) if o.caught else f"**{o.problem}**"
        lines.append(f"| {o.mutation.name} | {o.mutation.file} | {by} | {o.seconds:.0f} |")
    return "\n".join(lines)


def page(mutations: Sequence[Mutation]) -> str:
    """docs/mutations.md: every mutation with the test that has to notice it; nothing is run."""
    lines = [
        "# Mutations: each promise broken once",
        "",
        f"{len(mutations)} places where the code is broken on purpose, and the test that fails then. The list is in "
        "`tests/mutations/*.toml`; `python benchmarks/mutate.py` tries all of it in copies of the repository and "
        "prints what was caught, `python benchmarks/mutate.py --page` writes this page. A test fails where the page or "
        "an entry is out of date.",
        "",
        "Files are those of `forearm_fem`. *device: housing moves as a rigid body* is the test "
        "`test_housing_moves_as_a_rigid_body` of `tests/test_device.py`.",
        "",
        "| broken promise | file | caught by |",
        "| --- | --- | --- |",
    ]
    lines += [
        f"| {m.name} | {m.file.removeprefix(f'{PACKAGE}/')} | {'; '.join(map(_spoken, m.tests))} |" for m in mutations
    ]
    return "\n".join(lines) + "\n"


def _spoken(test: str) -> str:
    """``tests/test_a.py::test_b_is_c`` as words, which a narrow column can break: a: b is c."""
    file, _, name = test.partition("::")
    words = name.removeprefix("test_").replace("_", " ")
    return f"{Path(file).stem.removeprefix('test_').replace('_', ' ')}" + (f": {words}" if words else "")


def main(arguments: Sequence[str] | None = None, root: Path = ROOT) -> int:
    """The command line; its exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--only", metavar="TEXT", help="mutations whose name or file holds TEXT")
    parser.add_argument("--list", action="store_true", help="print the names and stop")
    parser.add_argument("--jobs", type=int, default=1, help="how many at once")
    parser.add_argument("--log", type=Path, metavar="FILE", help="write outcomes down; leave out what it has as caught")
    parser.add_argument("--page", action="store_true", help="write docs/mutations.md and stop")
    options = parser.parse_args(arguments)
    if options.page:
        (root / "docs" / "mutations.md").write_text(page(load(root)), encoding="utf-8")
        return 0
    chosen = [m for m in load(root) if not options.only or options.only in m.name or options.only in m.file]
    if wrong := problems(chosen, root):
        print("\n".join(wrong))
        return 1
    if options.list:
        print("\n".join(f"{m.name}  ({m.file}; {', '.join(m.tests)})" for m in chosen))
        return 0
    if not chosen:
        print("no mutation has that name")
        return 1
    if options.log:
        known = caught_before(options.log)
        there = len(chosen)
        chosen = [m for m in chosen if fingerprint(m, root) not in known]
        print(f"{there - len(chosen)} of {there} were caught before")
        if not chosen:
            return 0
    try:
        outcomes = run(chosen, max(1, options.jobs), root, options.log)
    except RuntimeError as problem:
        print(problem)
        return 1
    print(f"\n{table(outcomes)}\n\n{sum(o.caught for o in outcomes)} of {len(outcomes)} caught")
    return 0 if all(o.caught for o in outcomes) else 1


if __name__ == "__main__":
    sys.exit(main())
