"""The command line: parses, shows progress, prints; all work is done by the library."""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, NoReturn

import typer
from typer.core import TyperGroup

from .. import __version__
from ..errors import DataError, ForearmError
from ..processes import interrupts_heard
from . import about, decide, look, measure, simulate, study
from .common import any_encoding, console, print_error


class _NoEmptyValues(TyperGroup):
    """Refuses "" wherever a value is expected: what a shell's variable that is not set leaves would be this folder."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Click's own, once no argument is found empty, as an unset variable of the shell leaves it."""
        for before, value in zip(["", *args], args, strict=False):
            option, given, rest = value.partition("=")
            if given and not rest and option.startswith("--"):
                before, value = option, rest
            if value.strip():
                continue
            named = before.startswith("--")
            what, remedy = (before, "leave it out, or ") if named else ("an argument", "")
            raise DataError(f"{what}: expected a value, got '{value}'; {remedy}set the variable that was meant")
        return super().parse_args(ctx, args)


class _ByQuestion(_NoEmptyValues):
    """Lists commands and groups by panel: what is seldom used comes last."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Names, those of the panel "More" last."""
        names = super().list_commands(ctx)
        return sorted(names, key=lambda name: getattr(self.commands[name], "rich_help_panel", "") == "More")


app = typer.Typer(
    cls=_ByQuestion, add_completion=False, no_args_is_help=True, pretty_exceptions_enable=False,
    help="Simulate vibration in a layered forearm, focus it on a point, and state the error of each number.",
)  # fmt: skip

_GROUPS: Mapping[str, Sequence[Callable[..., None]]] = {  # docs/reference/commands.md says why
    "Simulate": (simulate.run, simulate.render),
    "Measure": (measure.calibrate, measure.convert),
    "Compare": (measure.compare, measure.fit),
    "Look": (look.figures, look.workbench),
    "Decide": (decide.predict, decide.design),
    "More": (
        about.new, decide.campaign, decide.library, decide.validate, decide.verify, about.schema,
        about.doctor,
    ),
}  # fmt: skip
_daq = typer.Typer(cls=_NoEmptyValues, no_args_is_help=True, help="Play drives, and measure latency, with a device.")
for _panel, _commands in _GROUPS.items():
    for _command in _commands:
        app.command(rich_help_panel=_panel)(_command)
_daq.command()(measure.play)
_daq.command()(measure.loopback)
app.add_typer(_daq, name="daq", rich_help_panel="Measure")
app.add_typer(study.app, name="study", rich_help_panel="People")


def main() -> None:
    """Entry point: a known failure is one sentence and exit code 2, an interruption exit code 130."""
    logging.basicConfig(level=logging.WARNING, format="%(message)s")
    any_encoding()
    os.environ["MPLBACKEND"] = "agg"  # pictures are written here: a notebook's backend may not even be installed
    try:
        with interrupts_heard() as pressed:
            code = app(standalone_mode=False)
        if code == 130:  # what typer makes of Ctrl-C
            raise KeyboardInterrupt
    except ForearmError as problem:
        print_error(problem)
        sys.exit(2)
    except (KeyboardInterrupt, typer.Abort):
        _interrupted()
    except MemoryError:
        print_error("out of memory; set mesh sizes or accuracy larger, or solver.precision = 'single'")
        sys.exit(2)
    except OSError as problem:  # names too long, no access, an output that takes no more: wherever they came up
        print_error(f"{problem.filename or 'the output'}: {problem.strerror or problem}")
        sys.exit(2)
    except Exception as problem:
        if pressed or _was_interrupted(problem):
            _interrupted()
        if not type(problem).__module__.startswith(("click", "typer")):  # a wrong option, as the parser says it
            raise
        if getattr(problem, "message", "") or str(problem):  # else the help was the answer
            wrong: Any = problem
            said = wrong.format_message() if hasattr(wrong, "format_message") else str(wrong)
            context = getattr(wrong, "ctx", None)
            more = f"; `{context.command_path} --help` says more" if context is not None else ""
            print_error(said.replace("Value error, ", "").rstrip(".") + more)
        sys.exit(2)
    sys.exit(code if isinstance(code, int) else 0)


def _interrupted() -> NoReturn:
    console.print("interrupted; what was finished is kept, run the same command to go on")
    sys.exit(130)


def _was_interrupted(problem: BaseException | None) -> bool:
    """True if Ctrl-C stands behind a ``problem``: compiled code makes a SystemError of it."""
    while problem is not None and not isinstance(problem, KeyboardInterrupt):
        problem = problem.__cause__ or problem.__context__
    return problem is not None


@app.callback(invoke_without_command=True)
def _version(
    version: Annotated[bool, typer.Option("--version", help="print the version and stop", is_eager=True)] = False,
) -> None:
    if version:
        typer.echo(f"forearm-fem {__version__}")
        raise typer.Exit()


if __name__ == "__main__":
    main()
