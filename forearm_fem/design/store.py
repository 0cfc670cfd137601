"""Candidates on disk: one line each, so that an interruption loses none."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from .. import __version__
from ..scenario.contents import contents, named_files
from ..store.text import digest_of
from .candidate import Candidate
from .model import Design, Values


class Store:
    """Candidates of one design on one model of the arm in ``candidates.jsonl``, by their values.

    Lines of an older question (another version, scenario or constraint) are left there and not used.
    """

    def __init__(self, folder: Path, design: Design, mark: str = "") -> None:
        self._file = folder / "candidates.jsonl"
        self._question = question(design, mark)
        self._known: dict[str, Candidate] = {}
        folder.mkdir(parents=True, exist_ok=True)
        text = self._file.read_text(encoding="utf-8", errors="replace") if self._file.is_file() else ""
        for line in text.splitlines():
            try:
                entry: dict[str, Any] = json.loads(line)
                if entry["question"] == self._question:
                    candidate = Candidate.from_json(entry["candidate"])
                    self._known[_key(candidate.values)] = candidate
            except (ValueError, KeyError, TypeError):  # a line cut short by an interruption
                continue
        if text and not text.endswith("\n"):  # cut short by an interruption
            with self._file.open("a", encoding="utf-8") as stream:
                stream.write("\n")

    def get(self, values: Values) -> Candidate | None:
        """The candidate with these values, if it was evaluated before."""
        return self._known.get(_key(values))

    def add(self, candidate: Candidate) -> None:
        """Keep ``candidate``, on disk at once."""
        self._known[_key(candidate.values)] = candidate
        line = json.dumps({"question": self._question, "candidate": candidate.as_json()})
        with self._file.open("a", encoding="utf-8") as stream:
            stream.write(line + "\n")

    @property
    def all(self) -> tuple[Candidate, ...]:
        """Every candidate of this question."""
        return tuple(self._known.values())


def question(design: Design, mark: str = "") -> str:
    """SHA-256 of what a candidate's numbers depend on: not the search's seed or length. ``mark`` is the
    arm model's."""
    asked = design.asked.model_dump(mode="json", include={"set", "objective", "constraints"})
    parts = [__version__, mark, asked, design.asked.search.duration, [dict(d) for d in design.data], _contents(design)]
    return digest_of(parts)[:32]


def _contents(design: Design) -> list[list[str]]:
    """What stands in the files that the scenarios, and choices of the search, name."""
    chosen = [str(c) for v in design.asked.variables if v.key.endswith(".file") for c in v.values or ()]
    arms = zip(design.scenarios({}), design.bases, strict=True)
    return [contents((*named_files(scenario), *chosen), base) for scenario, base in arms]


def _key(values: Values) -> str:
    return json.dumps(values, sort_keys=True)
