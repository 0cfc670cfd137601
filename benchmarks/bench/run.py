"""All parts of the benchmark, written as CSV, PNG and one page of sentences."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

from forearm_fem.errors import AccuracyWarning, DataError, SolverError
from forearm_fem.progress import Progress, tell

from . import asked, error, plots, size, text
from . import reduced as reduction
from .isolated import isolated, median, repeated, threads
from .tables import as_text, read_rows, record_machine, write_csv

Written = list[Path]
T = TypeVar("T")


def run_bench(
    folder: str | Path = "benchmarks/results",
    *,
    full: bool = False,
    only: Sequence[str] | None = None,
    count: int = 1,
    progress: Progress | None = None,
) -> Written:
    """Time the parts asked for (all of :data:`PARTS` by default) into ``folder`` and return the files written.

    Minutes on two cores; ``full`` adds larger systems and held-out frequencies. Figures and ``README.md`` are
    drawn from the CSV files, so parts can be run one by one. With one thread (``count``, the default)
    ``seconds_cpu`` is about the wall time of an idle machine even where others work on it; more threads need an
    idle machine.
    """
    chosen = tuple(only or PARTS)
    if bad := [name for name in chosen if name not in PARTS]:
        raise DataError(f"no part of the benchmark is called '{bad[0]}'; known are {', '.join(PARTS)}")
    out = Path(folder)
    with threads(count):
        written = [_part(name, out, full, progress) for name in chosen]
    return [*written, out / "machine.csv", *plots.draw_all(out), text.write_page(out)]


def _part(name: str, out: Path, full: bool, progress: Progress | None) -> Path:
    record_machine(out, name)
    return PARTS[name](out, full, progress)


class Table:
    """Rows of a part, each written as soon as it is there, so that an interrupted part goes on where it stopped.

    Until the part is finished they lie in ``NAME.partial.csv``; a finished part starts anew.
    """

    def __init__(self, out: Path, name: str, columns: Sequence[str]) -> None:
        self._path, self._partial, self._columns = out / f"{name}.csv", out / f"{name}.partial.csv", columns
        self._rows: list[dict[str, Any]] = [dict(r) for r in read_rows(self._partial)]

    def has(self, *values: object) -> bool:
        """Whether a row with these values in the identifying columns is there."""
        wanted = [as_text(v) for v in values]
        return any([r[c] for c in self._columns] == wanted for r in self._rows)

    def add(self, row: Any) -> None:
        """Write a row (dataclass or dictionary)."""
        self._rows.append(row if isinstance(row, dict) else asdict(row))
        write_csv(self._partial, self._rows)

    def finish(self) -> Path:
        """The part is complete."""
        if self._rows:
            self._partial.replace(self._path)
        return self._path


def _error(out: Path, full: bool, progress: Progress | None) -> Path:
    cases = error.cases(full=full)
    table = Table(out, "error", ("method", "element", "precision", "scale"))
    for case in _counted(cases, "speed against error", progress):
        if not table.has(case.method, case.element, case.precision, case.scale):
            with _lost(case):
                for row in error.timed(case):
                    table.add(row)
    return table.finish()


def _size(out: Path, full: bool, progress: Progress | None) -> Path:
    scales = size.SCALES + (size.MORE if full else ())
    table = Table(out, "size", ("precision", "scale"))
    cases = [(precision, scale) for scale in scales for precision in ("double", "single")]
    for case in _counted(cases, "cost against size", progress):
        if not table.has(*case):
            with _lost(case):
                table.add(median(repeated(size.sized, case)))
    return table.finish()


def _reduced(out: Path, full: bool, progress: Progress | None) -> Path:
    table = Table(out, "reduced", ("scale",))
    held_out = reduction.HELD_OUT if full else reduction.TIMED
    for scale in _counted((1.7, 1.3, 1.0, 0.8) if full else (1.7, 1.3), "reduced against direct", progress):
        if not table.has(scale):
            with _lost(scale):
                result = isolated(reduction.reduced, (scale, held_out))
                extra = {"speed_ratio": result.speed_ratio, "in_factorisations": result.in_factorisations}
                table.add({"scale": scale, **asdict(result), **extra})
    return table.finish()


def _asked(out: Path, full: bool, progress: Progress | None) -> Path:
    table = Table(out, "asked", ("accuracy",))
    accuracies = sorted(asked.ACCURACIES + (asked.MORE if full else ()), reverse=True)
    for accuracy in _counted(accuracies, "asked for", progress):
        if not table.has(accuracy):
            with _lost(accuracy):
                table.add(isolated(asked.asked, accuracy))
    return table.finish()


def _counted(cases: Sequence[T], stage: str, progress: Progress | None) -> Iterator[T]:
    for done, case in enumerate(cases):
        tell(progress, stage, done, len(cases))
        yield case
    tell(progress, stage, len(cases), len(cases))


@contextmanager
def _lost(case: object) -> Iterator[None]:
    """One run that fails or is killed loses its row, not the rest."""
    try:
        yield
    except SolverError as problem:
        warnings.warn(f"{case} is left out: {problem}", AccuracyWarning, stacklevel=3)


PARTS = MappingProxyType({"error": _error, "size": _size, "asked": _asked, "reduced": _reduced})
