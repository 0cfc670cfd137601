"""The role ``place``: an equation's place in the code, as a link to where it is described or to its source.

``{place}`forearm_fem.tissue.Tissue.mu_star` `` imports the name while the page is read, so that a page which names what
has moved or gone breaks the build. ``{place}`text <name>` `` shows another text.
"""

from __future__ import annotations

import importlib
import re
from typing import Any

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.util.docutils import SphinxRole

_LOG = logging.getLogger(__name__)


def found(name: str) -> Any:
    """The object of a dotted name; LookupError where there is none."""
    parts = name.split(".")
    for end in range(len(parts), 0, -1):
        try:
            thing: Any = importlib.import_module(".".join(parts[:end]))
        except ModuleNotFoundError:
            continue
        for part in parts[end:]:
            fields = getattr(thing, "__dataclass_fields__", {}) | getattr(thing, "model_fields", {})
            if not hasattr(thing, part) and part not in fields:
                raise LookupError(f"{name}: nothing of that name")
            thing = getattr(thing, part, None)
        return thing
    raise LookupError(f"{name}: no such module")


class Place(SphinxRole):
    """A link to code by its dotted name, checked to exist."""

    def run(self) -> tuple[list[nodes.Node], list[nodes.system_message]]:
        """A cross-reference that shows the last parts of the name."""
        explicit = re.fullmatch(r"(.+?)\s*<(.+)>", self.text)
        text, name = (explicit[1], explicit[2]) if explicit else (_short(self.text), self.text)
        try:
            found(name)
        except (LookupError, ImportError) as problem:
            _LOG.warning("place: %s", problem, location=self.get_location())
        code = nodes.literal(text, text, classes=["xref", "py"])
        link = addnodes.pending_xref(
            "", code, refdomain="py", reftype="obj", reftarget=name, refdoc=self.env.docname, refwarn=False
        )
        return [link], []


def _short(name: str) -> str:
    """``fem/boundary.py: facet_mass`` for a function of a module, as a reader opens it."""
    parts = name.split(".")
    for end in range(len(parts), 0, -1):
        try:
            importlib.import_module(".".join(parts[:end]))
        except ModuleNotFoundError:
            continue
        module = "/".join(parts[1:end]) + ".py"
        return f"{module}: {'.'.join(parts[end:])}" if parts[end:] else module
    return name


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the role."""
    app.add_role("place", Place())
    return {"parallel_read_safe": True}
