"""The page inside a notebook's cell."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from pathlib import Path

from ..data import Results
from .bundle import page_of
from .content import content_of


@dataclass(frozen=True)
class View:
    """A page shown in a frame of ``height`` pixels; :meth:`save` keeps it as a file."""

    page: str
    height: int = 900

    def _repr_html_(self) -> str:
        """What notebooks ask for; the frame runs the page's script and reaches nothing else."""
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
