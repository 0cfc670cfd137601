"""Parts shared by commands: argument types, a stage run with progress bars, notes, G from a file or folder."""

from __future__ import annotations

import codecs
import gc
import glob
import io
import shlex
import signal
import sys
import tomllib
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..errors import DataError, first_problem, one_sentence
from ..scenario import Scenario, apply_overrides, load_scenario, scenario_file
from ..scenario.model import read_overrides
from ..scenario.text import label_of
from .display import Display as Display
from .display import console as console

if TYPE_CHECKING:
    from ..engines.library import ArmLibrary
    from ..files.declaration import Declaration
    from ..transfer import TransferMatrix


_PLAIN = {"≤": "<=", "≥": ">=", "←": "<-", "→": "->", "µ": "u", "μ": "u", "±": "+-", "°": " deg", "–": "-", "—": "-",
          "−": "-", "×": "x", "²": "^2", "³": "^3", "·": "*", "…": "...", "“": '"', "”": '"', "’": "'", "ω": "omega",
          "•": "*", "━": "-", "╸": "-", "╺": "-", "─": "-", "│": "|", "∞": "inf", "≈": "~", "√": "sqrt"}  # fmt: skip


def _in_ascii(problem: UnicodeError) -> tuple[str, int]:
    """Other characters for what an encoding of the terminal or pipe does not have."""
    assert isinstance(problem, UnicodeEncodeError)
    told = "".join(_PLAIN.get(c, "?") for c in problem.object[problem.start : problem.end])
    return told.encode(problem.encoding, "replace").decode(problem.encoding), problem.end


def any_encoding() -> None:
    """Let stdout and stderr say everything, whatever their encoding: cp1252 of a pipe on Windows, or ASCII."""
    codecs.register_error("forearm_fem", _in_ascii)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="forearm_fem")


def there(remedy: str, folder: bool = False) -> Callable[[Path | None], Path | None]:
    """A callback that refuses a path without a file (or ``folder``), with the ``remedy``, before the command begins."""

    def checked(what: Path | None) -> Path | None:
        """The path, if it is there."""
        if what is not None and not (what.is_dir() if folder else what.exists()):
            raise DataError(f"{what}: {remedy}")
        return what

    return checked


def ends_in(ending: str) -> Callable[[Path | None], Path | None]:
    """A callback for a file to write: refused where it is a folder, or its name does not end in ``ending``, as one of
    another kind's."""

    def checked(what: Path | None) -> Path | None:
        """The path, if it ends so and is no folder."""
        if what is not None and what.suffix.lower() != ending:
            raise DataError(f"{what}: choose a name that ends in {ending}; this one may be of something else")
        refuse_folder(what)
        return what

    return checked


def refuse_folder(file: Path | None) -> None:
    """DataError where a ``file`` to write is a folder: before the work rather than after it."""
    if file is not None and file.is_dir():
        raise DataError(f"{file}: is a folder, expected the name of a file to write; give another")


def holds_g(what: Path | None) -> Path | None:
    """A callback that refuses what :func:`transfer_file` refuses, before the command begins."""
    if what is not None:
        transfer_file(what)
    return what


def all_hold_g(what: list[Path]) -> list[Path]:
    """A callback that refuses what :func:`transfer_file` refuses of each, and fewer than two."""
    for each in what:
        transfer_file(each)
    if len(what) < 2:
        raise DataError(f"expected two or more G or runs to compare, got {len(what)}; name another one")
    return what


def declared(option: str = "--declare", file: str = "a file") -> Any:
    """The option of a command that reads a G, the same in all."""
    return typer.Option(option, help=f"what {file} does not say of itself, e.g. unit='mm/V' or sign='+iwt'")


ScenarioFile = Annotated[
    Path, typer.Argument(callback=scenario_file, help="scenario file, or the name of one that comes along, e.g. thesis")
]
Overrides = Annotated[list[str] | None, typer.Option("--set", help="override a key, e.g. device.spacing=40mm")]
OutFolder = Annotated[
    Path | None, typer.Option("--out", help="results folder; default results/NAME, after --set results/NAME-KEY-VALUE")
]
LibraryFile = Annotated[
    Path | None,
    typer.Option("--library", help="an arm's library (`forearm-fem library`) in place of mesh and solve",
                 callback=there("no such file; `forearm-fem library SCENARIO` makes one")),
]  # fmt: skip
Declared = Annotated[list[str] | None, declared()]
Scheduler = Annotated[
    str | None, typer.Option(help="address of a running Dask scheduler, e.g. tcp://host:8786; default: this machine")
]
Workers = Annotated[
    int | None, typer.Option(min=1, help="processes on this machine; default: what cores and memory allow")
]
Resume = Annotated[bool, typer.Option("--resume/--anew", help="go on with draws that the folder holds")]


def out_folder(
    out: Path | None, of: Scenario | str, overrides: Sequence[str] | None = None, part: str = ""
) -> Path:
    """The folder asked for, else ``results/NAME`` of a scenario or name, or ``part`` of it.

    What ``--set`` changes without a name goes to ``NAME-KEY-VALUE``.
    """
    if out is not None:
        return out
    if isinstance(of, str):
        return Path("results") / of
    changed = read_overrides(overrides or ())
    named = "name" in changed or not changed
    return Path("results") / (of.name if named else f"{of.name}-{label_of(changed)}") / part


@contextmanager
def job(folder: Path | None = None, *rooms: str, sums: bool = True) -> Iterator[Display]:
    """A command's work: its ``folder`` locked, one progress bar, warnings as notes once it is done.

    ``rooms`` that take seconds to load on a slow or busy machine are loaded first, which the bar says. What fails is
    one sentence, and Ctrl-C says that the same command goes on (:func:`forearm_fem.cli.app.main`).
    """
    gc.freeze()  # else what was imported is gone through again and again
    with ExitStack() as held:
        if folder is not None:
            from ..store.folder import locked

            held.enter_context(locked(folder, sums=sums))
        held.enter_context(noted())
        display = held.enter_context(Display())
        for k, room in enumerate(rooms):
            display("loading", k, len(rooms))
            import_module(f"forearm_fem.{room}")
        yield display


def scenario_word(file: Path) -> str:
    """A scenario as a command line names it: a shipped one by its name."""
    return file.stem if file == scenario_file(file.stem) else str(file)


def asked_words(file: Path, overrides: Sequence[str] | None = None, library: Path | None = None) -> str:
    """The scenario as a command line names it, with what was set: what another command needs to be of the same."""
    words = [scenario_word(file), *(word for item in overrides or () for word in ("--set", item))]
    return shlex.join([*words, *(["--library", str(library)] if library is not None else [])])


def library_file(file: Path | None) -> ArmLibrary | None:
    """The arm's library in ``file``; None where none was named."""
    if file is None:
        return None
    from ..engines.library import load_library

    return load_library(file)


def print_notes(notes: Sequence[str]) -> None:
    """Each note once, on stderr."""
    for note in dict.fromkeys(notes):
        console.print(f"[yellow]note:[/yellow] {_plain(note)}", highlight=False, soft_wrap=True)


def print_error(message: object) -> None:
    """One sentence on stderr, brackets in it not taken for markup."""
    console.print(f"[red]error:[/red] {_plain(one_sentence(str(message)))}", highlight=False, soft_wrap=True)


def _plain(text: str) -> str:
    from rich.markup import escape

    return escape(" ".join(text.split()))


@contextmanager
def noted() -> Iterator[None]:
    """Warnings of the library as notes instead of Python's own two lines."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("default")
        yield
    print_notes([str(w.message) for w in caught if not issubclass(w.category, DeprecationWarning)])


def transfer_file(what: Path) -> Path:
    """A file as it is; of a results folder its ``transfer.nc``; a folder or a pattern of files of a lab."""
    if what.is_dir():
        if (what / "transfer.nc").is_file():
            return what / "transfer.nc"
        from ..files.read import several

        several(what)  # refuses a folder of nothing known
    elif not what.exists() and not glob.glob(str(what)):
        made = Path("results") / what
        meant = f"; did you mean {made}?" if made.is_dir() else "; `forearm-fem run SCENARIO` makes a results folder"
        raise DataError(f"{what}: no such file or results folder{meant}")
    return what


def is_g(what: Path) -> bool:
    """True if ``what`` is meant as a G: a folder, a file of a kind that holds one, or a recipe that reads one."""
    if what.suffix.lower() != ".toml":
        return what.is_dir() or bool(what.suffix)
    try:
        table = tomllib.loads(what.read_text(encoding="utf-8"))
    except (OSError, ValueError):  # said in words of its own where the scenario is read
        return False
    return bool({"array", "declaration"} & set(table))


def measured_g(
    what: Path | None, asked: Scenario, declare: Sequence[str] | None, option: str = ""
) -> TransferMatrix | None:
    """G in a file or folder, which takes the places of the scenario where it names none; None where none was named.

    DataError where ``declare`` says something of a file that ``option`` did not name.
    """
    if what is None:
        if declare:
            raise DataError(f"--declare: has no effect without {option}; name the file, or leave it out")
        return None
    from ..files.read import read

    with noted():  # what was recognised, and what a file does not look like
        return read(transfer_file(what), declaration(declare), scenario=asked)


def scene_of(scenario: Path | None) -> Scenario | None:
    """The scenario in a file or of a shipped one's name; None where none was named."""
    return None if scenario is None else load_scenario(scenario_file(scenario))


def declaration(items: Sequence[str] | None) -> Declaration | None:
    """``--declare key=value`` items as a declaration; None where there are none."""
    if not items:
        return None
    from pydantic import ValidationError

    from ..files.declaration import Declaration

    try:
        return Declaration.model_validate(apply_overrides({}, items, "--declare"))
    except ValidationError as problem:
        known = ", ".join(Declaration.model_fields)
        raise DataError(f"--declare {first_problem(problem, 'declaration')}; known are {known}") from None


class Stop:
    """True once Ctrl-C was pressed: the drive is then ramped down; a second Ctrl-C cuts it."""

    def __init__(self) -> None:
        self.pressed = False
        self.waiting = False  # for the operator: nothing sounds, so Ctrl-C ends the program at once

    def __call__(self) -> bool:
        """Polled by the library, block by block."""
        return self.pressed


@contextmanager
def stop_on_ctrl_c() -> Iterator[Stop]:
    """Emergency stop by Ctrl-C while hardware plays."""
    stop = Stop()

    def press(number: int, _: object) -> None:
        """The first Ctrl-C asks for a stop, the second, or one while a question waits, interrupts."""
        if stop.pressed or stop.waiting:
            raise KeyboardInterrupt
        stop.pressed = True

    before = signal.signal(signal.SIGINT, press)
    try:
        yield stop
    finally:
        signal.signal(signal.SIGINT, before)
