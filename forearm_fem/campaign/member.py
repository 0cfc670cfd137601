"""One member of a campaign; its failure is data."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .. import __version__
from ..accuracy.estimates import short_verdict
from ..errors import ForearmError
from ..results import read_run
from ..scenario import Scenario
from ..scenario.shipped import contents, named_files
from ..store.folder import locked
from ..store.work import LOST


@dataclass(frozen=True)
class MemberJob:
    """All that a worker needs: plain data, so that it travels to any machine that sees ``folder`` and ``base``."""

    name: str
    scenario: str
    stage: str
    base: str
    folder: str

    @property
    def digest(self) -> str:
        """SHA-256 of what is asked."""
        files = named_files(Scenario.model_validate_json(self.scenario))
        content = json.dumps([__version__, self.scenario, self.stage, contents(files, self.base)])
        return hashlib.sha256(content.encode()).hexdigest()


def finish_member(job: MemberJob) -> dict[str, Any]:
    """Run the member; its summary, or why there is none (:data:`.work.LOST`). Nothing it raises leaves the worker."""
    folder = Path(job.folder)
    try:
        from ..pipeline.folder import Run, run_all, run_render, run_solve

        run = Run.start(Scenario.model_validate_json(job.scenario), folder, Path(job.base))
        with locked(folder):
            {"solve": run_solve, "render": run_render, "run": run_all}[job.stage](run)
            summary = member_summary(folder)
        return summary
    except ForearmError as problem:
        return {LOST: str(problem)}
    except MemoryError:
        return {LOST: "out of memory; set mesh sizes or accuracy larger, or use fewer workers"}
    except Exception as problem:
        return {LOST: f"{type(problem).__name__}: {problem} (a fault of the program, please report it)"}


def member_summary(folder: Path) -> dict[str, Any]:
    """The numbers of a finished folder that belong in a table, and what stands beside them in its report: whether the
    accuracy asked was met, and every note."""
    account = read_run(folder / "run.json")
    found: dict[str, Any] = {
        "e_band": account.band_error,
        "condition": account.condition_number.median,
        "seconds": round(account.seconds, 1),
    }
    notes = dict.fromkeys((*account.warnings, *account.notes))
    said = {"verdict": short_verdict(account.accuracy), "notes": "; ".join(notes)}
    means = {f"S {method}": value for method, value in account.signal_strength.means().items()}
    return {**found, **means, **said}
