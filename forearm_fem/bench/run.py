"""All parts of the benchmark, written as CSV, PNG and one page of sentences."""

from __future__ import annotations

import csv
import io
import os
import platform
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from types import MappingProxyType
from typing import Any

from ..errors import AccuracyWarning, DataError, SolverError
from ..io.atomic import write_text
from . import error, plots, size, text
from . import reduced as reduction
from .isolated import isolated, median, repeated, threads

Progress = Callable[[str, int, int], None]
Written = list[Path]


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
        write_csv(out / "machine.csv", [machine()])
        written = [PARTS[name](out, full, progress) for name in chosen]
    return [*written, out / "machine.csv", *plots.draw_all(out), text.write_page(out)]


def _error(out: Path, full: bool, progress: Progress | None) -> Path:
    rows: list[error.Timed] = []
    cases = error.cases(full=full)
    for done, case in enumerate(cases):
        _tell(progress, "speed against error", done, len(cases))
        with _lost(case):
            rows += error.timed(case)
            write_csv(out / "error.csv", rows)
    _tell(progress, "speed against error", len(cases), len(cases))
    return out / "error.csv"


def _size(out: Path, full: bool, progress: Progress | None) -> Path:
    scales = size.SCALES + (size.MORE if full else ())
    cases = [(precision, scale) for precision in ("double", "single") for scale in scales]
    rows: list[size.Sized] = []
    for done, case in enumerate(cases):
        _tell(progress, "cost against size", done, len(cases))
        with _lost(case):
            rows.append(median(repeated(size.sized, case)))
            write_csv(out / "size.csv", rows)
    _tell(progress, "cost against size", len(cases), len(cases))
    return out / "size.csv"


def _reduced(out: Path, full: bool, progress: Progress | None) -> Path:
    scales, rows = (1.7, 1.3, 1.0, 0.8) if full else (1.7, 1.3), []
    for done, scale in enumerate(scales):
        _tell(progress, "reduced against direct", done, len(scales))
        result = isolated(reduction.reduced, (scale, reduction.HELD_OUT if full else reduction.TIMED))
        extra = {"speed_ratio": result.speed_ratio, "in_factorisations": result.factorisations}
        rows.append({**asdict(result), **extra})
        write_csv(out / "reduced.csv", rows)
    _tell(progress, "reduced against direct", len(scales), len(scales))
    return out / "reduced.csv"


@contextmanager
def _lost(case: object) -> Iterator[None]:
    """One run that fails or is killed loses its row, not the rest."""
    try:
        yield
    except SolverError as problem:
        warnings.warn(f"{case} is left out: {problem}", AccuracyWarning, stacklevel=3)


PARTS = MappingProxyType({"error": _error, "size": _size, "reduced": _reduced})


def machine() -> dict[str, Any]:
    """What the timings were made on and with."""
    from ..pipeline.folder import versions

    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "threads": os.environ.get("OMP_NUM_THREADS", "all"),
        "load_at_start": round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else "unknown",
        "system": platform.platform(),
        **versions(),
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    return next(
        (line.partition(":")[2].strip() for line in lines if line.startswith("model name")),
        platform.machine(),
    )


def write_csv(path: Path, rows: Sequence[Any]) -> None:
    """Rows (dataclasses or dictionaries with the same keys) as CSV, whole or not at all."""
    plain = [row if isinstance(row, dict) else asdict(row) for row in rows]
    stream = io.StringIO()
    writer = csv.DictWriter(stream, list(plain[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows({k: f"{v:.6g}" if isinstance(v, float) else v for k, v in row.items()} for row in plain)
    write_text(path, stream.getvalue())


def _tell(progress: Progress | None, stage: str, done: int, total: int) -> None:
    if progress is not None:
        progress(stage, done, total)
