"""How often bands over arms held what was published: the one source of these figures, made by ``validate``."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cache
from importlib.resources import files
from typing import Any, Self

FILE = "track_record.json"
PAGE = "docs/trust.md"


@dataclass(frozen=True)
class TrackRecord:
    """What bands of 5-95 % over ``arms`` of the layered model held: ``entries`` of Table I's nine means of S and
    ``deviations`` of its six, as the rig reports them, over the wavelet's window; ``findings`` of so many
    ``compared`` others that no law was fitted to. ``width`` is the factor to either side, ``joint`` the distance of the
    nine over the arms' median, ``score`` their log score."""

    arms: int
    entries: int
    deviations: int
    findings: int
    compared: int
    width: float
    joint: float
    score: float

    @classmethod
    def of(cls, validation: Mapping[str, Any]) -> Self:
        """The record that :func:`forearm_fem.questions.predict.validate.validate` found."""
        found = validation["table_one"]["window"]["all"]
        other = [t for t in validation["targets"] if t.get("all") is not None and not t["fitted"]]
        return cls(
            found["draws"], found["inside"], sum(d["inside"] for d in found["deviations"]),
            sum(t["all"]["inside"] for t in other), len(other), round(found["width"], 2), round(found["distance"], 2),
            round(found["score"], 1),
        )  # fmt: skip

    @property
    def sentence(self) -> str:
        """One line for reports."""
        return (
            f"Of published values {self.entries} of 9 S of one person and {self.findings} of {self.compared} other "
            f"findings lay inside such bands; more in {PAGE}."
        )

    def as_text(self) -> str:
        """The file's text."""
        return json.dumps({f.name: getattr(self, f.name) for f in fields(self)}, indent=1) + "\n"


@cache
def track_record() -> TrackRecord:
    """The record that comes with the program; ``benchmarks/track_record.py`` makes it."""
    return TrackRecord(**json.loads(files("forearm_fem").joinpath(FILE).read_text(encoding="utf-8")))
