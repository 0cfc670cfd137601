"""The directive ``commands``: every command with its arguments and options, as ``--help`` has them."""

from __future__ import annotations

from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective
from typer.main import get_command

from forearm_fem.cli import app as command_line


class Commands(SphinxDirective):
    """A section per command."""

    def run(self) -> list[nodes.Node]:
        """Name, what it does, how to call it, and its parameters in a definition list."""
        group: Any = get_command(command_line)
        return [self._section(name, command) for name, command in group.commands.items()]

    def _section(self, name: str, command: Any) -> nodes.section:
        section = nodes.section(ids=[nodes.make_id(f"command-{name}")])
        section += nodes.title("", name)
        self.state.document.note_implicit_target(section, section)
        section += nodes.paragraph("", " ".join((command.help or "").split()))
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
    is_option = parameter.param_type_name == "option"
    name = ", ".join(parameter.opts) if is_option else _named(parameter)
    text = " ".join((parameter.help or "").split())
    return nodes.definition_list_item(
        "", nodes.term("", "", nodes.literal("", name)), nodes.definition("", nodes.paragraph("", text))
    )


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directive."""
    app.add_directive("commands", Commands)
    return {"parallel_read_safe": True}
