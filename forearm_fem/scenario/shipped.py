"""Scenarios that come with the program: found by name, in an installed package and in a clone alike."""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parents[1]


def shipped_folder(kind: str) -> Path:
    """Folder of the "scenarios" or "meshes" that come with the program: inside a wheel, else beside the package."""
    inside = _PACKAGE / "_data" / kind
    return inside if inside.is_dir() else _PACKAGE.parent / kind


def shipped_scenarios() -> tuple[str, ...]:
    """Names of the scenarios that come with the program, e.g. "thesis"."""
    return tuple(sorted(file.stem for file in shipped_folder("scenarios").glob("*.toml")))


def scenario_file(given: str | Path) -> Path:
    """``given`` where it is a file or looks like one, else the file of the shipped scenario of that name."""
    file = Path(given)
    if file.is_file() or file.suffix or len(file.parts) != 1 or file.name not in shipped_scenarios():
        return file
    return shipped_folder("scenarios") / f"{file.name}.toml"


def scenario_beside(folder: Path, named: str) -> Path:
    """The scenario that a file in ``folder`` names: the file there, else the shipped scenario of that name."""
    beside = folder / named
    if beside.is_file() or named not in shipped_scenarios():
        return beside
    return shipped_folder("scenarios") / f"{named}.toml"
