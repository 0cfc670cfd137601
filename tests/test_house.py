"""What a reader stumbles over: names that live twice, and what is promised to be public."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import pytest

HOME = Path(__file__).parents[1]
sys.path[:0] = [str(HOME / "benchmarks"), str(HOME / "docs" / "_ext")]

from public_rooms import PUBLIC  # noqa: E402

from house import doubled_beside_commands, sources, undocumented  # noqa: E402

TWICE = {
    "main": "entry points: of the program, of a mesh's maker, of a page's writer",
    "respond": "public in two rooms: a device's response, a record's",
    "strengths": "public in two rooms: S of drives, S of a folder",
    "Surface": "what lies on the twin's surface; the skin that the workbench draws",
    "View": "which waves a still shows; the workbench in a notebook",
    "tabulate": "shape functions at points, the term of the field; the twin over a design's distances",
    "ArmModel": "what a design, what a prediction asks of an arm: other questions, other protocols",
    "Prior": "of a process between points, of a tissue's constants: the term of the field in both",
    "soft_tissues": "names for the reduced terms, records for the draws",
}


def test_no_public_name_lives_in_two_modules_without_a_reason():
    """A command bears the verb of what it calls; all others are named here with their reason."""
    assert set(doubled_beside_commands(sources(None))) <= set(TWICE)


def test_all_that_is_public_is_described():
    assert undocumented(sources(None)) == 0


@pytest.mark.parametrize("room", PUBLIC)
def test_a_public_room_states_its_names(room: str):
    module = importlib.import_module(room)
    assert module.__all__
    for name in module.__all__:
        assert getattr(module, name) is not None


def test_files_that_the_suite_begins_with_are_there():
    """A name that is out of date would go unnoticed: its file would come in the order of the alphabet."""
    from conftest import FIRST

    here = Path(__file__).parent
    assert [name for name in FIRST if not (here / name).is_file()] == []
