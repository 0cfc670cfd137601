"""The directive ``commands``: every command with its arguments and options, as ``--help`` has them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective
from typer.main import get_command

from forearm_fem.cli.app import app as command_line


def every_command(group: Any = None, before: str = "") -> list[tuple[str, Any]]:
    """(name, command) of all that can be called, in the order of ``--help``; groups' as "study run"."""
    found = []
    for name, command in (group or get_command(command_line)).commands.items():
        inside = getattr(command, "commands", None)
        found += every_command(command, f"{before}{name} ") if inside else [(f"{before}{name}", command)]
    return found


def option_text(option: Any) -> tuple[str, str]:
    """How an option is given, e.g. "--render / --no-render", and its help with the default that holds without it."""
    default = option.default
    if isinstance(default, bool):  # the half that holds; none where leaving the option out is the other half
        default = (option.opts if default else option.secondary_opts or [None])[0]
    elif isinstance(default, Path):
        default = None if default == Path() else default.as_posix()
    stated = " (required)" if option.required else f" (default: {default})" if default not in (None, "", [], ()) else ""
    return " / ".join([*option.opts, *option.secondary_opts]), f"{option.help or ''}{stated}"


class Commands(SphinxDirective):
    """A section per command."""

    def run(self) -> list[nodes.Node]:
        """Name, what it does, how to call it, and its parameters in a definition list."""
        return [self._section(name, command) for name, command in every_command()]

    def _section(self, name: str, command: Any) -> nodes.section:
        section = nodes.section(ids=[nodes.make_id(f"command-{name}")])
        section += nodes.title("", name)
        self.state.document.note_implicit_target(section, section)
        section += _sentence(command.help or "")
        arguments = " ".join(
            _named(p) if p.required else f"[{_named(p)}]"
            for p in command.params if p.param_type_name == "argument"
        )  # fmt: skip
        section += nodes.literal_block("", f"forearm-fem {name} {arguments} [options]".replace("  ", " "))
        entries = [_entry(p) for p in command.params if p.name != "help"]
        if entries:
            section += nodes.definition_list("", *entries)
        return section


def _named(parameter: Any) -> str:
    return str(parameter.metavar or parameter.name).upper()


def _entry(parameter: Any) -> nodes.definition_list_item:
    if parameter.param_type_name == "option":
        name, text = option_text(parameter)
    else:
        name, text = _named(parameter), parameter.help or ""
    return nodes.definition_list_item(
        "",
        nodes.term("", "", nodes.literal("", name)),
        nodes.definition("", _sentence(text)),
    )


def _sentence(text: str) -> nodes.paragraph:
    """A paragraph in which what stands between backticks is code."""
    parts = enumerate(" ".join(text.split()).split("`"))
    return nodes.paragraph("", "", *(nodes.literal("", p) if k % 2 else nodes.Text(p) for k, p in parts))


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directive."""
    app.add_directive("commands", Commands)
    return {"parallel_read_safe": True}
