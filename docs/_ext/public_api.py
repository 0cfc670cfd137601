"""Reference pages from docstrings: the public names (``__all__`` of the public rooms), and every module behind them.

Pages are written to ``made/api`` before Sphinx reads: one for the public API, one per room of the package. A name is
described once: public ones on the public page, all others where they live.
"""

from __future__ import annotations

import importlib
import re
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

from public_rooms import PUBLIC, public_names
from pydantic import BaseModel
from sphinx.application import Sphinx

import forearm_fem

_EVERYTHING = ("   :members:", "   :undoc-members:", "   :ignore-module-all:")
_DEVELOPERS = ("forearm_fem.__main__",)


def _home(thing: Any, room: str, name: str) -> str:
    module, qualified = getattr(thing, "__module__", None), getattr(thing, "__qualname__", None)
    return f"{module}.{qualified}" if module and qualified else f"{room}.{name}"


def _public() -> dict[str, tuple[str, Any]]:
    """Where a public thing lives -> the shortest public name it is described under, and itself."""
    described: dict[str, tuple[str, Any]] = {}
    for room in PUBLIC:
        module = importlib.import_module(room)
        for name in public_names(room):
            thing = getattr(module, name)
            home = _home(thing, room, name)
            shown = home if f"{room}.{name}" in sys.modules else f"{room}.{name}"  # a module has that name too
            described.setdefault(home, (shown, thing))
    return described


def _directive(name: str, thing: Any) -> str:
    if isinstance(thing, type):
        return f".. autoclass:: {name}\n   :members:\n"
    return f".. autofunction:: {name}\n" if callable(thing) else f".. autodata:: {name}\n"


def _public_page(described: dict[str, tuple[str, Any]]) -> str:
    lines = ["Public API", "==========", "", (
        "These names are public: they keep their meaning within a minor version, and what goes is announced one minor "
        "version before. Everything else is described under :doc:`/reference/modules` and may change without notice."
    ), ""]  # fmt: skip
    for room, title in PUBLIC.items():
        names = [(n, t) for n, t in described.values() if _room_of(n) == room]
        if names:
            head = f"{title}: ``{room}``"
            lines += [head, "-" * len(head), "", *(_directive(n, t) for n, t in names)]
    return "\n".join(lines) + "\n"


def _room_of(name: str) -> str:
    """The public room of a name: the longest that it begins with, for modules of rooms belong to those."""
    return max((r for r in PUBLIC if name.startswith(r + ".")), key=len)


def _modules() -> dict[str, list[str]]:
    """Room -> its modules, found as files, for not every room has an ``__init__``."""
    home = Path(forearm_fem.__file__).parent
    rooms: dict[str, list[str]] = {}
    for file in sorted(home.rglob("*.py")):
        parts = file.relative_to(home.parent).with_suffix("").parts
        name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        if name not in (*_DEVELOPERS, "forearm_fem"):
            rooms.setdefault(parts[1] if len(parts) > 2 else "top level", []).append(name)
    return rooms


def _room_page(room: str, modules: list[str]) -> str:
    lines = [room, "=" * len(room), ""]
    for name in modules:
        lines += [name, "-" * len(name), "", f".. automodule:: {name}", *_EVERYTHING, ""]
    return "\n".join(lines)


def write_pages(app: Sphinx) -> None:
    """The public page and one page per room, written only where they differ."""
    folder = Path(app.srcdir) / "made" / "api"
    folder.mkdir(parents=True, exist_ok=True)
    app.forearm_described = described = _public()  # type: ignore[attr-defined]
    pages = {"public": _public_page(described)}
    pages |= {f"room-{room.replace(' ', '-')}": _room_page(room, names) for room, names in _modules().items()}
    for name, text in pages.items():
        file = folder / f"{name}.rst"
        if not file.exists() or file.read_text(encoding="utf-8") != text:
            file.write_text(text, encoding="utf-8")


def skip(app: Sphinx, what: str, name: str, thing: Any, skipped: bool, options: Any) -> bool | None:
    """Leave out of the rooms' pages what the public page describes, and what only passes through a module."""
    if what != "module" or isinstance(thing, ModuleType):
        return None
    if not (getattr(thing, "__module__", None) or "").startswith("forearm_fem"):
        return True if isinstance(thing, type) or callable(thing) else None
    described: dict[str, tuple[str, Any]] = app.forearm_described  # type: ignore[attr-defined]
    return True if _home(thing, "", name) in described else None


def plain(app: Sphinx, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """Docstrings are prose for a terminal: magnitudes |x|, star products and single backticks are not markup."""
    literal = False
    for i, line in enumerate(lines):
        if literal and (not line.strip() or line.startswith(" ")):
            continue
        literal = line.rstrip().endswith("::")
        parts = re.split(r"(``.+?``|`[^`]+`_?|:[a-z:]+:`[^`]+`)", line)
        lines[i] = "".join(p if k % 2 else _escaped(p) for k, p in enumerate(parts))


def _escaped(text: str) -> str:
    text = text.replace("|", r"\|")
    text = re.sub(r"(?<!\*)\*(?!\*)", r"\\*", text)
    return re.sub(r"(\w)_(?=\W|$)", r"\1\\_", text)


def link_home(app: Sphinx, env: Any, node: Any, content: Any) -> Any:
    """A link to where a thing lives finds the public name it is described under, else what it is a part of."""
    if node.get("refdomain") != "py":
        return None
    described: dict[str, tuple[str, Any]] = app.forearm_described  # type: ignore[attr-defined]
    head, tail = node["reftarget"], ""
    while head.startswith("forearm_fem."):
        names = [described[head][0] + tail, described[head][0]] if head in described else [head]
        for name in names:
            domain = env.get_domain("py")
            if found := domain.resolve_xref(env, node["refdoc"], app.builder, "obj", name, node, content):
                return found
        head, _, part = head.rpartition(".")
        tail = f".{part}{tail}"
    return None


def short_signature(
    app: Sphinx, what: str, name: str, thing: Any, options: Any, signature: str, returns: str
) -> tuple[str, str] | None:
    """Scenarios and their parts take keys; which ones has a page of its own."""
    return ("(**keys)", "") if isinstance(thing, type) and issubclass(thing, BaseModel) else None


def without_way_back(app: Sphinx, page: str, template: str, context: dict[str, Any], doctree: Any) -> None:
    """Sources link to descriptions by the name of their room, which public names do not have: leave those links out."""
    if page.startswith("_modules/") and "body" in context:
        context["body"] = re.sub(r'<a class="viewcode-back"[^>]*>.*?</a>', "", context["body"])


def setup(app: Sphinx) -> dict[str, Any]:
    """Write the pages first; leave doubles out; find public names by where they live."""
    app.connect("builder-inited", write_pages, priority=100)
    app.connect("autodoc-skip-member", skip)
    app.connect("autodoc-process-docstring", plain, priority=100)
    app.connect("autodoc-process-signature", short_signature)
    app.connect("missing-reference", link_home)
    app.connect("html-page-context", without_way_back)
    return {"parallel_read_safe": True}
