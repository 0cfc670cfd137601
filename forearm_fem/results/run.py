"""The record of a run, ``run.json``: what it made, from what, at what cost and how wrong it may be.

Records are read back from files of every version since 0.1: what an older program did not write has a default that
says so, what a newer one wrote besides is kept and written again. JSON has no NaN: None is *unknown*.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import AliasChoices, BaseModel, ConfigDict, Field, ValidationError

from ..errors import DataError
from ..metrics import condition_number, condition_summary
from ..store.text import read_json, write_json
from ..transfer import ErrorEstimate, TransferMatrix

VERSION = 1  # of the record's own form; files before 0.15 state none and are read as this one


class _Record(BaseModel):
    model_config = ConfigDict(frozen=True, extra="allow")


class StageCost(_Record):
    """Wall-clock ``seconds`` and the process's peak memory [bytes] while a stage was computed."""

    seconds: float
    peak_memory_bytes: float = Field(default=0.0, validation_alias=AliasChoices("peak_memory_bytes", "peak_memory"))


class ErrorRecord(_Record):
    """An :class:`.ErrorEstimate` as numbers that JSON has: None is unknown."""

    source: str
    band: float | None = None
    worst: float | None = None
    method: str = ""

    @classmethod
    def of(cls, error: ErrorEstimate) -> ErrorRecord:
        """The record of ``error``."""
        band, worst = (error.band, error.worst) if error.known else (None, None)
        return cls(source=error.source, band=band, worst=worst, method=error.method)


class ResolutionRecord(_Record):
    """Nodes per shear wavelength of one tissue, the least anywhere and near the ports."""

    tissue: str
    per_wavelength: float
    per_wavelength_near_ports: float


class QualityRecord(_Record):
    """Quality of tetrahedra, 1 for a regular one."""

    least: float
    median: float


class MeshRecord(_Record):
    """The mesh's digest (empty: no mesh), its quality and what it resolves."""

    sha256: str = ""
    quality: QualityRecord | None = None
    resolution: tuple[ResolutionRecord, ...] = ()


class SolutionRecord(_Record):
    """Record of the finite-element sweep; empty for the layered engine.

    Frequencies in Hz; ``residual`` is the largest relative one of the direct solves; ``certificates`` are what the
    reduced model was held against; ``ends_by`` says how the solution with other ends was made.
    """

    displacement_unknowns: int = 0
    pressure_unknowns: int = 0
    solver: str | None = None
    residual: float | None = None
    expansion_rate: float | None = None
    derivatives: int = 0
    expansion_frequencies: tuple[float, ...] = ()
    certificates: tuple[Mapping[str, Any], ...] = ()
    unstable_poles: int = 0
    reduced_size: int = 0
    ends_by: str = ""


class Spread(_Record):
    """Least, median and largest of a number over the band; None where there is none."""

    least: float | None = None
    median: float | None = None
    largest: float | None = None


class ConditionRecord(Spread):
    """Condition number of G [-] over the band; at ``singular`` frequencies, not among these, it is infinite."""

    singular: int = 0


class StrengthEntry(_Record):
    """One S with its interval, its reading over the whole record, and what band edges and holes of G do to it [-]."""

    value: float | None = None
    low: float | None = None
    high: float | None = None
    record: float | None = None
    edges: float | None = None
    holes: float | None = None


class StrengthRecord(_Record):
    """Every S by method and target with its zero points; ``unknown`` says why there is no interval, ``not_counted``
    are targets under or beside a motor, which are in no mean."""

    window: tuple[float, float] | None = None
    unknown: str = ""
    methods: Mapping[str, Mapping[str, StrengthEntry]] = {}
    zeros: Mapping[str, Mapping[str, tuple[str, ...]]] = {}
    not_counted: tuple[str, ...] = ()

    def means(self) -> dict[str, float]:
        """Mean S of each method over the targets that count and whose S is known; methods without any are left out."""
        found = {
            method: [e.value for t, e in row.items() if t not in self.not_counted and e.value is not None]
            for method, row in self.methods.items()
        }
        return {method: sum(values) / len(values) for method, values in found.items() if values}

    def largest(self, what: str) -> tuple[float, str]:
        """Largest |``what``| ("edges" or "holes") over S, and where; 0 and "" where nothing is on record."""
        found = [
            (abs(getattr(entry, what)) / entry.value, f"{method} towards {target}")
            for method, row in self.methods.items()
            for target, entry in row.items()
            if getattr(entry, what) is not None and entry.value
        ]
        return max(found, default=(0.0, ""))


class RunRecord(_Record):
    """Everything on record of a run. ``program`` is the version that made it, ``stages`` in the order they ran;
    ``warnings`` were told apart from ``notes`` by early versions; ``asked`` is the scenario as the command named it,
    with what it set."""

    program: str
    stages: Mapping[str, StageCost]
    notes: tuple[str, ...]
    version: int = VERSION
    scenario: Mapping[str, Any] = {}
    versions: Mapping[str, str] = {}
    mesh: MeshRecord = MeshRecord()
    solution: SolutionRecord = SolutionRecord()
    errors: tuple[ErrorRecord, ...] = ()
    accuracy: str = ""
    condition_number: ConditionRecord = ConditionRecord()
    signal_strength: StrengthRecord = StrengthRecord()
    warnings: tuple[str, ...] = ()
    asked: str = ""

    @classmethod
    def empty(cls) -> RunRecord:
        """Of a run that is not finished: nothing is known."""
        return cls(program="", stages={}, notes=())

    @property
    def seconds(self) -> float:
        """Wall-clock time of all stages."""
        return sum(cost.seconds for cost in self.stages.values())

    @property
    def band_error(self) -> float | None:
        """e_band of all sources together, as the report has it; None where one is unknown or none is stated."""
        bands = [e.band for e in self.errors if e.band is not None]
        return math.hypot(*bands) if bands and len(bands) == len(self.errors) else None


def read_run(path: str | Path) -> RunRecord:
    """The record in ``path``; DataError in one sentence for a missing, damaged or newer file."""
    content = read_json(path)
    if missing := [key for key in ("program", "stages", "notes") if key not in content]:
        raise DataError(f"{path}: damaged, it has no '{missing[0]}'")
    try:
        record = RunRecord.model_validate(content)
    except ValidationError as problem:
        first = problem.errors()[0]
        raise DataError(f"{path}: damaged at {'.'.join(map(str, first['loc']))} ({first['msg']})") from None
    if record.version > VERSION:
        raise DataError(f"{path}: written by a newer forearm_fem ({record.program}); update to read it")
    return record


def write_run(path: str | Path, record: RunRecord) -> None:
    """``record`` as JSON with its checksum, whole or not at all."""
    write_json(path, record.model_dump(mode="json"))


def condition_of(transfer: TransferMatrix) -> ConditionRecord:
    """Condition numbers of G over the bins where all of it is known."""
    found = condition_summary(condition_number(transfer.values))
    return ConditionRecord(
        least=found.least, median=found.median, largest=found.largest, singular=found.singular
    )
