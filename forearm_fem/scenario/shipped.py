"""Scenarios that come with the package, and TOML as people write it."""

from __future__ import annotations

import hashlib
import re
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from ..errors import ForearmError, ScenarioError
from ..usercode import is_code, with_code_beside
from .limb import Limb, MeshLimb, SurfacesLimb
from .model import Scenario
from .rendering import SampledWavelet

# Reading TOML files: whatever is wrong with one is a sentence.

_BACKSLASH = "within double quotes \\ begins an escape: write paths with /, or in single quotes"


def _line(file: Path, problem: Exception) -> str:
    """The line of ``file`` that a ``problem`` names; all of it where it names none."""
    lines = file.read_text(encoding="utf-8-sig").splitlines()
    named = re.search(r"at line (\d+)", str(problem))
    return "\n".join(lines) if named is None else "".join(lines[int(named[1]) - 1 : int(named[1])])


def read_toml(file: Path, missing: str, error: type[ForearmError] = ScenarioError) -> dict[str, Any]:
    """The table in ``file``, user code beside it named in full (:mod:`forearm_fem.usercode`).

    ``error`` with the sentence ``missing`` where there is no file, or with why it cannot be read.
    """
    if file.is_dir():
        raise error(f"{file}: is a folder, expected a TOML file")
    try:
        table = tomllib.loads(file.read_text(encoding="utf-8-sig"))
    except FileNotFoundError:
        raise error(f"{file}: {missing}") from None
    except (OSError, UnicodeDecodeError) as problem:
        raise error(f"{file}: cannot be read as a text file ({problem})") from None
    except RecursionError:
        raise error(f"{file}: not valid TOML: nested too deeply") from None
    except tomllib.TOMLDecodeError as problem:
        more = f"; {_BACKSLASH}" if "\\" in _line(file, problem) else ""
        raise error(f"{file}: not valid TOML: {problem}{more}") from None
    except ValueError:  # Python reads no more
        raise error(f"{file}: a number has more than 4300 digits") from None
    beside: dict[str, Any] = with_code_beside(table, file.parent)
    return beside


# Files: scenarios that come with the program, and what a scenario names.

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


def named_files(scenario: Scenario) -> tuple[str, ...]:
    """Files that ``scenario`` names, seen from its own folder: of the limb, of the wavelet, and of the user's code."""
    wave = scenario.rendering.wavelet
    sampled = (wave.file,) if isinstance(wave, SampledWavelet) else ()
    return (*limb_files(scenario.limb), *sampled, *code_files(scenario.rendering.methods), *law_files(scenario))


def law_files(scenario: Scenario) -> tuple[str, ...]:
    """Files of the user's own tissue laws."""
    return code_files(law for override in scenario.tissues.override.values() if (law := override.law) is not None)


def code_files(names: Iterable[str]) -> tuple[str, ...]:
    """Files of the user's code among ``names``: those named in full, and those in the current folder."""
    places = (name.rpartition(":")[0] for name in names if is_code(name))
    files = (Path(place if place.endswith(".py") else place.replace(".", "/") + ".py") for place in places)
    return tuple(str(file.resolve()) for file in files if file.is_file())


def limb_files(limb: Limb) -> tuple[str, ...]:
    """Files that a ``limb`` is made of; none for a parametric one."""
    if isinstance(limb, MeshLimb):
        return (limb.file,)
    return tuple(limb.surfaces.values()) if isinstance(limb, SurfacesLimb) else ()


def contents(files: Iterable[str], base: str | Path) -> list[str]:
    """SHA-256 of each of the ``files`` seen from ``base``; "missing" for one that is not there."""
    paths = [Path(base) / file for file in files]
    return [hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else "missing" for path in paths]
