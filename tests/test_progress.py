"""One signature of progress: every function that takes it takes the same."""

import ast
from pathlib import Path

import forearm_fem
from forearm_fem.progress import tell, within

PACKAGE = Path(forearm_fem.__file__).parent


def annotations():
    """(place, annotation) of every parameter and field called progress."""
    for file in sorted(PACKAGE.rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.arg) and node.arg == "progress" and node.annotation:
                yield f"{file.name}:{node.lineno}", ast.unparse(node.annotation)
            if isinstance(node, ast.AnnAssign) and ast.unparse(node.target) == "progress":
                yield f"{file.name}:{node.lineno}", ast.unparse(node.annotation)


def test_progress_has_one_signature_everywhere():
    found = dict(annotations())
    assert len(found) > 40  # the walk sees them at all
    assert {k: v for k, v in found.items() if v not in ("Progress", "Progress | None")} == {}


def test_a_part_tells_its_whole_and_nobody_need_listen():
    told = []
    tell(within(lambda *step: told.append(step), "mesh"), "core", 2, 5)
    tell(within(None, "mesh"), "core", 2, 5)
    assert told == [("mesh: core", 2, 5)]
