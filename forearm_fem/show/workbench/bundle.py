"""The workbench as one HTML page, in a file or in a notebook."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from html import escape
from importlib import resources
from pathlib import Path
from typing import Any

from ...engines.library import is_library, load_library
from ...errors import DataError
from ...files.declaration import Declaration
from ...files.read import read
from ...progress import Progress
from ...rendering.job import on_own_bins
from ...scenario import Scenario, parse_scenario
from ...store.folder import write_text
from ..data import Results
from .content import content_of, library_content, measured_content

# The page as one file: template, styles, script and content, and nothing that a browser would have to fetch.

_IMPORT = re.compile(r"^import \{ ([^}]*) \} from \"\./(\w+)\.js\";$", re.MULTILINE)
_EXPORT = re.compile(r"^export ((?:async )?(?:const|function\*?|class) ([\w$]+))", re.MULTILINE)
_NO_NAME = re.compile(r"[^A-Za-z0-9_.-]+")  # what no scenario's name holds: the page keeps one that can be run
_FIRST = "main"
_HEAD = 4096  # characters in which a page says what it was made of
LIBRARY = ".library.nc"


def write_workbench(
    what: Results | str | Path, path: str | Path, *, scenario: Scenario | None = None,
    declaration: Declaration | None = None, progress: Progress | None = None, base: str | Path = ".",
) -> Path:  # fmt: skip
    """Write the page of a results folder, a ``NAME.library.nc`` or a measured G, whole or not at all.

    A measured G is a file, or the folder of a calibration. ``scenario`` gives it its record, wavelet, limits and, where
    it names none, its points and actuators (default: the record of a calibration's sweep, else all of the thesis), a
    library its device; its wavelet's file is seen from ``base``. Raises DataError for anything that is neither, and
    where the folder's run is unfinished.
    """
    made_of = Path(what).name if not isinstance(what, Results) and Path(what).is_file() else ""
    write_text(path, page_of(_content(what, scenario, declaration, progress, Path(base)), made_of))
    return Path(path)


def page_beside(file: Path) -> Path:
    """``NAME.html`` beside a ``file`` with G or a library; DataError where that is no page of it."""
    page = file.with_suffix(".html")
    if page.exists():
        with page.open(encoding="utf-8", errors="replace") as stream:
            head = stream.read(_HEAD)
        if _made_of(file.name) not in head:
            raise DataError(
                f"{page}: is there and no page of {file.name}; it is not replaced, name another with --save"
            )
    return page


def _made_of(name: str) -> str:
    return f'<meta name="made-of" content="{escape(name)}">'


def _content(
    what: Results | str | Path, scenario: Scenario | None, declaration: Declaration | None, progress: Progress | None,
    base: Path,
) -> dict[str, Any]:  # fmt: skip
    if isinstance(what, Results):
        return content_of(what, progress)
    place, name = Path(what), Path(what).stem
    if _holds_g_alone(place):
        place, name = place / "transfer.nc", place.resolve().name
    if place.is_dir():
        if scenario is not None or declaration is not None:
            raise DataError(
                f"{place}: a run holds its own scenario and unit, so that --scenario and --declare have no effect; "
                "leave them out, or name its transfer.nc"
            )
        return content_of(Results.open(place), progress)
    if not place.is_file():
        raise DataError(f"{place}: no such results folder or file; `forearm-fem run SCENARIO` makes a folder")
    if place.name.endswith(LIBRARY) or is_library(place):
        if declaration is not None:
            raise DataError(f"{place}: a library says all of itself, so that --declare has no effect; leave it out")
        arm = load_library(place)
        asked = scenario or arm.scenario.changed({"name": place.name.removesuffix(LIBRARY)})
        return library_content(arm, asked, f"library {place.name}", progress, base)
    asked = scenario or Scenario()
    transfer = read(place, declaration, scenario=asked)
    if scenario is None and isinstance(sweep := transfer.provenance.get("sweep"), Mapping):  # of a calibration
        asked = parse_scenario({"sweep": {k: sweep[k] for k in ("duration", "sample_rate", "f_min", "f_max")}})
    asked, note = on_own_bins(transfer, asked)
    named = asked.changed({"name": _NO_NAME.sub("-", name).strip(".-")[:100] or "measured"})
    return measured_content(transfer, named, f"measured G of {Path(what).name}", base, note)


def _holds_g_alone(folder: Path) -> bool:
    """True if a ``folder`` holds a G and no run, as one of ``forearm-fem calibrate`` does."""
    there = [(folder / file).is_file() for file in ("transfer.nc", "scenario.json", "run.json")]
    return folder.is_dir() and there == [True, False, False]


def page_of(content: dict[str, Any], made_of: str = "") -> str:
    """The page that shows ``content``, of a file of the name ``made_of``, where it is of one.

    Names and notes stand in JSON inside a script element, of which no text can close the element or open another.
    """
    files = resources.files(__package__).joinpath("page")
    read = {name: files.joinpath(name).read_text(encoding="utf-8") for name in ("page.html", "page.css")}
    data = json.dumps(content, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    parts = {
        "MADE_OF": _made_of(made_of) if made_of else "",
        "TITLE": escape(f"{content['name']}: workbench"),
        "STYLE": read["page.css"],
        "DATA": data,
        "SCRIPT": script(),
    }
    return re.sub(r"%%(MADE_OF|TITLE|STYLE|DATA|SCRIPT)%%", lambda found: parts[found[1]], read["page.html"])


def script() -> str:
    """All modules of ``page/`` that ``main.js`` needs, each in a function of its own and after those it imports."""
    done: dict[str, str] = {}

    def take(name: str) -> None:
        """Put a module behind those that it imports, as a function that returns what it exports."""
        source = resources.files(__package__).joinpath(f"page/{name}.js").read_text(encoding="utf-8")
        for _, needed in _IMPORT.findall(source):
            if needed not in done:
                take(needed)
        exported = ", ".join(found[1] for found in _EXPORT.findall(source))
        body = _EXPORT.sub(r"\1", _IMPORT.sub(r"const { \1 } = page_\2;", source))
        done[name] = f"const page_{name} = (() => {{\n{body}\nreturn {{ {exported} }};\n}})();"

    take(_FIRST)
    body = "\n".join(done.values())
    assert not re.search(r"^(?:import|export) ", body, re.MULTILINE)  # a form that the patterns above do not know
    assert "</script" not in body  # would end the page's script element early, as the next would
    assert "<!--" not in body
    return f'"use strict";\n(() => {{\n{body}\n}})();'


# The page inside a notebook's cell.


@dataclass(frozen=True)
class View:
    """A page shown in a frame of ``height`` pixels; :meth:`save` keeps it as a file."""

    page: str
    height: int = 900

    def _repr_html_(self) -> str:
        """HTML for notebooks; the frame runs the page's script and reaches nothing else."""
        return (
            f'<iframe srcdoc="{escape(self.page, quote=True)}" sandbox="allow-scripts allow-downloads" '
            f'style="width:100%;height:{self.height}px;border:0" title="forearm_fem workbench"></iframe>'
        )

    def save(self, path: str | Path) -> Path:
        """Write the page."""
        from ...store.folder import write_text

        write_text(path, self.page)
        return Path(path)


def view(results: Results | str | Path, *, height: int = 900) -> View:
    """The workbench of a results folder as the last value of a notebook's cell; DataError for an unfinished run."""
    found = results if isinstance(results, Results) else Results.open(results)
    return View(page_of(content_of(found)), height)
