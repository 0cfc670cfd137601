"""The role ``place``: an equation's place in the code, as a link to where it is described or to its source.

``{place}`forearm_fem.tissue.Tissue.mu_star` `` imports the name while the page is read, so that a page which names what
has moved or gone breaks the build. ``{place}`text <name>` `` shows another text.
"""

from __future__ import annotations

import importlib
import re
from typing import Any

from docutils import nodes
from dotted_names import found
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.util.docutils import SphinxRole

_LOG = logging.getLogger(__name__)


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
            "", code, refdomain="py", reftype="obj", reftarget=name, refdoc=self.env.docname, refwarn=True
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
