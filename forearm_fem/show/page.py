"""One page for every report: sections, tables, pictures."""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from jinja2 import Environment
from markupsafe import Markup, escape
from matplotlib import style

from ..store.folder import atomic_path, write_text
from ..store.text import markdown_table
from .style import SHEET, Drawn, arrange, figure_of, sign

# The numbers of a figure as CSV beside it.


def tables(data: xr.Dataset) -> dict[str, pd.DataFrame]:
    """Variables of a Dataset as tables, a row for each combination of their coordinates.

    One table for each set of dimensions: the first is called "", others by their first variable. What has fewer
    dimensions stands in the first table that holds them; variables with the attribute ``table`` "no" in none.
    """
    shown = {str(name): v for name, v in data.data_vars.items() if v.attrs.get("table") != "no"}
    kinds = [set(v.dims) for v in shown.values()]
    largest = [d for k, d in enumerate(kinds) if not any(d < other for other in kinds) and d not in kinds[:k]]
    found: dict[str, pd.DataFrame] = {}
    for dims in largest:
        names = [n for n, v in shown.items() if next(d for d in largest if set(v.dims) <= d) is dims]
        part = data[names].reset_coords(drop=True)
        for name in [n for n in names if np.iscomplexobj(part[n])]:
            sides = {f"{name}_{side}": getattr(part[name], side) for side in ("real", "imag")}
            part = part.assign({n: v.assign_attrs(part[name].attrs) for n, v in sides.items()}).drop_vars(name)
        order = next(v.dims for v in part.data_vars.values() if set(v.dims) == dims)
        frame = part.to_dataframe(dim_order=list(order))[list(part.data_vars)].dropna(how="all").reset_index()
        units = {n: f"{n}_{unit}" for n in frame.columns if n in part and (unit := part[n].attrs.get("units"))}
        found["" if not found else names[0]] = frame.rename(columns=units)
    return found


def as_csv(frame: pd.DataFrame, source: str = "") -> str:
    """Header and rows with ten digits, NaN as ``nan``; ``source`` in a first line starting with #."""
    head = f"# {source}\n" if source else ""
    return head + str(frame.to_csv(index=False, lineterminator="\n", float_format="%.10g", na_rep="nan"))


# Page: every report of the package, as one self-contained HTML file and as a short Markdown file beside it.

_DPI = 150  # of pictures on a page
_CSS_DPI = 96  # by which a browser draws them


@dataclass(frozen=True)
class Block:
    """A table with its heading; ``note`` is a sentence below it."""

    header: list[str]
    rows: list[list[str]]
    note: str = ""

    @classmethod
    def of(cls, columns: Sequence[str], rows: Sequence[Mapping[str, Any]], note: str = "") -> Block:
        """The ``columns`` of ``rows`` by name: numbers to four digits, what a row lacks left empty."""
        return cls(list(columns), [[_cell(row.get(c)) for c in columns] for row in rows], note)

    def markdown(self) -> str:
        """The table and its note."""
        table = markdown_table(self.header, self.rows) if self.rows else ""
        return "\n".join(part for part in (table, self.note) if part)


@dataclass(frozen=True)
class Picture:
    """A PNG in base64, its caption, and how wide [px] it is drawn at most; with a ``name`` it is a file as well."""

    title: str
    data: str
    name: str = ""
    width: int = 760


@dataclass(frozen=True)
class Section:
    """A heading with what stands below it; ``commands`` are (what for, command) to copy, ``folded`` opens on a click.

    Pictures stand side by side where there is room.
    """

    anchor: str
    title: str
    block: Block | None = None
    paragraphs: list[str] = field(default_factory=list)
    bullets: Sequence[str] = ()
    pictures: Sequence[Picture] = ()
    warn: bool = False
    commands: Sequence[tuple[str, str]] = ()
    folded: bool = False

    @property
    def holds(self) -> bool:
        """True if there is anything to show."""
        return bool(self.block or self.paragraphs or self.bullets or self.pictures or self.commands)


@dataclass(frozen=True)
class Page:
    """A ``title``, the ``subject`` below it, the ``answer`` in sentences, sections, and who made it (``stamp``)."""

    title: str
    answer: Sequence[str]
    sections: Sequence[Section]
    stamp: str
    subject: str = ""

    def html(self) -> str:
        """A self-contained page that fetches nothing."""
        source = resources.files(__package__).joinpath("page.html.j2").read_text(encoding="utf-8")
        environment = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
        environment.filters["coded"] = _coded
        template = environment.from_string(source)
        return template.render(page=self, sections=[s for s in self.sections if s.holds])

    def markdown(self) -> str:
        """The short form: what is not folded on the page, and pictures that are files."""
        parts = [f"# {self.title}\n", *([f"{self.subject}\n"] if self.subject else [])]
        parts += [f"{line}\n" for line in self.answer]
        for section in self.sections:
            if section.folded or not (body := _body(section)):
                continue
            parts += [f"## {section.title}\n", *body]
        return "\n".join([*parts, f"*{self.stamp}*\n"])

    def save(self, folder: str | Path, stem: str = "report") -> tuple[Path, Path]:
        """``stem.html``, ``stem.md``, and ``figures/NAME.png`` of pictures with a name; the paths of the first two."""
        out = Path(folder)
        for picture in (p for section in self.sections for p in section.pictures if p.name):
            with atomic_path(out / "figures" / f"{picture.name}.png") as target:
                target.write_bytes(base64.b64decode(picture.data))
        page, plain = out / f"{stem}.html", out / f"{stem}.md"
        write_text(plain, self.markdown())
        write_text(page, self.html())
        return page, plain


def _coded(text: str) -> Markup:
    """``text`` escaped, what stands between backticks as code."""
    return Markup(re.sub(r"`([^`]+)`", r"<code>\1</code>", str(escape(text))))


def _cell(value: Any) -> str:
    return "" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)


def _body(section: Section) -> list[str]:
    body = [f"{text}\n" for text in section.paragraphs]
    if section.block and (section.block.rows or section.block.note):
        body.append(section.block.markdown() + ("" if not section.block.note else "\n"))
    body += [f"![{picture.title}](figures/{picture.name}.png)\n" for picture in section.pictures if picture.name]
    body += [*(f"- {line}" for line in section.bullets), *([""] if section.bullets else [])]
    body += [f"{what}:\n\n    {command}\n" for what, command in section.commands]
    return body


def embedded(drawn: Drawn, title: str, stamp: str = "", name: str = "") -> Picture:
    """A figure as a picture of a page, signed with ``stamp``; ``name`` is that of its file."""
    figure = figure_of(drawn)
    if stamp:
        sign(figure, stamp)
    arrange(figure)
    stream = io.BytesIO()
    with style.context(SHEET):
        figure.savefig(stream, format="png", dpi=_DPI)
    return Picture(title, _text(stream), name, round(_CSS_DPI * figure.get_figwidth()))


def _text(stream: io.BytesIO) -> str:
    return base64.b64encode(stream.getvalue()).decode()
