"""The package in numbers at two revisions: files, lines, functions, and what a reader stumbles over.

``python benchmarks/house.py [REVISION ...]`` prints a table, 0.13.1 beside the working tree unless told otherwise;
``--rooms [REVISION]`` prints the lines of each room, and how many stand in files that the revision did not have.
"""

from __future__ import annotations

import ast
import io
import re
import subprocess
import sys
import tarfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path, PurePosixPath

ROOT = Path(__file__).parents[1]
PACKAGE = "forearm_fem"
BEFORE = "44448b6"  # 0.13.1
Sources = Mapping[str, str]
Function = ast.FunctionDef | ast.AsyncFunctionDef


def sources(revision: str | None) -> Sources:
    """Python files of the package by path, at ``revision`` or (None) in the working tree."""
    if revision is None:
        return {str(p.relative_to(ROOT)): p.read_text("utf-8") for p in sorted((ROOT / PACKAGE).rglob("*.py"))}
    packed = subprocess.run(["git", "archive", revision, PACKAGE], cwd=ROOT, capture_output=True, check=True).stdout
    with tarfile.open(fileobj=io.BytesIO(packed)) as archive:
        files = [m for m in archive if m.isfile() and m.name.endswith(".py")]
        return {m.name: archive.extractfile(m).read().decode() for m in files}  # type: ignore[union-attr]


def functions(files: Sources) -> Iterator[Function]:
    """Every function and method, nested ones included."""
    for text in files.values():
        yield from (n for n in ast.walk(ast.parse(text)) if isinstance(n, Function))


def doubled(files: Sources) -> dict[str, list[str]]:
    """Public functions and classes whose name lives in two or more modules, and those modules."""
    homes: dict[str, list[str]] = {}
    for file, text in files.items():
        for n in ast.parse(text).body:
            if isinstance(n, Function | ast.ClassDef) and not n.name.startswith("_"):
                homes.setdefault(n.name, []).append(file)
    return {name: found for name, found in sorted(homes.items()) if len(found) > 1}


def doubled_beside_commands(files: Sources) -> dict[str, list[str]]:
    """Of these, those that are not a command and the one function that it calls: a command bears that verb."""
    inside = {name: [f for f in found if f"{PACKAGE}/commands/" not in f] for name, found in doubled(files).items()}
    return {name: found for name, found in inside.items() if len(found) > 1}


def used_once(files: Sources) -> tuple[int, int]:
    """Private functions whose name occurs once besides its definition, and all private functions."""
    words = Counter(re.findall(r"\w+", "\n".join(files.values())))
    private = [f.name for f in functions(files) if f.name.startswith("_") and not f.name.startswith("__")]
    return sum(words[name] == 2 for name in private), len(private)


def undocumented(files: Sources) -> int:
    """Functions, methods and classes without a docstring whose name has no underscore, inside others, too."""
    defined = (n for t in files.values() for n in ast.walk(ast.parse(t)) if isinstance(n, Function | ast.ClassDef))
    return sum(not n.name.startswith("_") and not ast.get_docstring(n) for n in defined)


def progress_signatures(files: Sources) -> int:
    """Different annotations of what is called ``progress``, optional or not."""
    found = {
        ast.unparse(n.annotation).removesuffix(" | None")
        for text in files.values()
        for n in ast.walk(ast.parse(text))
        if isinstance(n, ast.arg) and n.arg == "progress" and n.annotation
    }
    aliases = {a for text in files.values() for a in re.findall(r"^Progress = (.*)$", text, re.M)}
    return len((found - {"Progress"}) | aliases)


def _long(files: Sources) -> int:
    return sum((f.end_lineno or f.lineno) - f.lineno >= 60 for f in functions(files))


def _repeated_files(files: Sources) -> int:
    names = Counter(PurePosixPath(f).name for f in files)
    return sum(count > 1 for name, count in names.items() if name != "__init__.py")


ROWS: Mapping[str, Callable[[Sources], object]] = {
    "files": len,
    "lines": lambda s: sum(len(text.splitlines()) for text in s.values()),
    "functions": lambda s: sum(1 for _ in functions(s)),
    "lines a function, mean": lambda s: f"{_mean([(f.end_lineno or 0) - f.lineno + 1 for f in functions(s)]):.1f}",
    "functions of more than 60 lines": _long,
    "public names in two modules": lambda s: len(doubled(s)),
    "of these, beside commands": lambda s: len(doubled_beside_commands(s)),
    "file names that repeat": _repeated_files,
    "private functions used once": lambda s: "{} of {}".format(*used_once(s)),
    "public without docstring": undocumented,
    "signatures of progress": progress_signatures,
}


def _mean(values: list[int]) -> float:
    return sum(values) / len(values)


def kinds_of_lines(text: str) -> Counter[str]:
    """Lines of code, docstrings, comments and blank ones of a module."""
    documented: set[int] = set()
    for n in ast.walk(ast.parse(text)):
        if isinstance(n, ast.Module | ast.ClassDef | Function) and ast.get_docstring(n) is not None:
            documented |= set(range(n.body[0].lineno, (n.body[0].end_lineno or 0) + 1))
    found = Counter[str]()
    for number, line in enumerate(map(str.strip, text.splitlines()), start=1):
        plain = "blank" if not line else "comments" if line.startswith("#") else "code"
        found["docstrings" if number in documented else plain] += 1
    return found


def added_since(revision: str) -> set[str]:
    """Files of the package that ``revision`` had under no name: less than 40 % of them is the same anywhere."""
    command = ["git", "diff", "--name-status", "-M40%", "-l0", revision, "--", PACKAGE]
    told = subprocess.run(command, cwd=ROOT, capture_output=True, check=True, text=True).stdout.splitlines()
    return {line.split("\t")[1] for line in told if line.startswith("A")}


def rooms_table(revision: str) -> str:
    """Lines of each room then and now, what they are, and how many stand in files added since."""

    def by_room(files: Sources) -> dict[str, Counter[str]]:
        """Kinds of lines of each room, and of all."""
        found: dict[str, Counter[str]] = {}
        for file, text in files.items():
            inside = PurePosixPath(file).parts[1:-1]
            for room in (inside[0] if inside else "beside the rooms", "all"):
                found.setdefault(room, Counter()).update(kinds_of_lines(text))
        return found

    now, new = sources(None), added_since(revision)
    before, after, since = by_room(sources(revision)), by_room(now), by_room({f: now[f] for f in now if f in new})
    nothing: Counter[str] = Counter()
    head = ["room", revision, "now", "code", "docstrings", "comments", "blank", "in files added since"]
    lines = [head, ["---"] * len(head)]
    for room in [*sorted({*before, *after} - {"all"}), "all"]:
        a, b = before.get(room, nothing), after.get(room, nothing)
        figures = (a.total(), b.total(), *(b[k] for k in head[3:7]), since.get(room, nothing).total())
        lines.append([room, *map(str, figures)])
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def main() -> None:
    """Print the table."""
    if sys.argv[1:2] == ["--rooms"]:
        print(rooms_table(sys.argv[2] if len(sys.argv) > 2 else BEFORE))
        return
    revisions = sys.argv[1:] or [BEFORE]
    columns = [*(sources(r) for r in revisions), sources(None)]
    print(f"| | {' | '.join(revisions)} | now |\n| --- |{' --- |' * len(columns)}")
    for name, count in ROWS.items():
        print(f"| {name} | {' | '.join(str(count(files)) for files in columns)} |")


if __name__ == "__main__":
    main()
