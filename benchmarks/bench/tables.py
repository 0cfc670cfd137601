"""CSV files of measurements, and what they were measured on."""

from __future__ import annotations

import csv
import io
import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from forearm_fem import __version__
from forearm_fem.store.folder import write_text

Row = Mapping[str, str]


def read_rows(path: Path) -> list[Row]:
    """Rows of a CSV file; none where it does not exist yet."""
    if not path.is_file():
        return []
    with path.open(newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def record_machine(out: Path, part: str) -> None:
    """Say in ``machine.csv`` what ``part`` is timed on and with; a row a part, as machines may differ."""
    now = {"part": part, **machine()}
    others = [row for row in read_rows(out / "machine.csv") if row.get("part", part) != part]
    write_csv(out / "machine.csv", [*({key: row.get(key, "") for key in now} for row in others), now])


def machine() -> dict[str, Any]:
    """What timings are made on and with."""
    from forearm_fem.engines.simulation import versions

    return {
        "forearm_fem": __version__,
        "processor": _processor(),
        "cores": os.cpu_count(),
        "threads": os.environ.get("OMP_NUM_THREADS", "all"),
        "load_at_start": round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else "unknown",
        "system": platform.platform(),
        **versions(),
    }


def _processor() -> str:
    """Its name, and the instructions that a factor of up to two depends on."""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        return platform.processor()
    names = [line.partition(":")[2].strip() for line in text.splitlines() if line.startswith("model name")]
    return f"{names[0] if names else platform.machine()} {'with' if 'avx512f' in text else 'without'} AVX-512"


def write_csv(path: Path, rows: Sequence[Any]) -> None:
    """Rows (dataclasses or dictionaries with the same keys) as CSV, whole or not at all."""
    plain = [row if isinstance(row, dict) else asdict(row) for row in rows]
    stream = io.StringIO()
    writer = csv.DictWriter(stream, list(plain[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows({k: as_text(v) for k, v in row.items()} for row in plain)
    write_text(path, stream.getvalue())


def as_text(value: object) -> str:
    """A number as the tables have it, to six digits."""
    return f"{value:.6g}" if isinstance(value, float) else str(value)
