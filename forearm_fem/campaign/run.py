"""All members of a campaign on Dask: local processes by default, an existing scheduler by address."""

from __future__ import annotations

import csv
import io
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import psutil

from .. import __version__
from ..errors import ForearmError
from ..progress import Progress, tell
from ..show.page import Block, Page, Section
from ..store.folder import check_kind, set_kind, write_text
from ..store.shelf import WORK, Shelf
from ..store.work import LIGHT, LOST, SHARE, done_once, spread
from .member import MemberJob, finish_member
from .model import Campaign, Member


@dataclass(frozen=True)
class MemberResult:
    """What became of a member: numbers for the table, or the sentence why it failed; ``reused`` if done before."""

    name: str
    values: Mapping[str, Any]
    numbers: Mapping[str, Any]
    problem: str = ""
    reused: bool = False


@dataclass(frozen=True)
class CampaignResult:
    """All members, in the file's order; ``table`` is the summary as markdown."""

    folder: Path
    members: tuple[MemberResult, ...]
    table: str


def run_campaign(
    campaign: Campaign,
    folder: str | Path,
    *,
    scheduler: str | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> CampaignResult:
    """Run what is not finished yet, each member into ``folder/NAME``, and write ``summary.csv``, ``.html`` and ``.md``.

    A failed member is reported and does not stop the others; running again does only what is missing. ``scheduler`` is
    the address of a Dask scheduler whose workers see ``folder`` and the scenario's folder under the same path;
    otherwise ``workers`` local processes are started (default: as many as cores and forecast memory allow; without Dask
    members run here, one after the other).
    """
    check_kind(folder, "campaign")
    out = Path(folder).resolve()
    set_kind(out, "campaign")
    shelf, jobs = Shelf(out / WORK, "finished members"), [_job(campaign, m, out) for m in campaign.members]
    keys = {f"{job.name} {job.digest}": job for job in jobs}
    known = set(shelf.known())
    whole = {key for key, job in keys.items() if key in known and (Path(job.folder) / "run.json").is_file()}
    missing = [job for key, job in keys.items() if key not in whole]
    names = {job.name for job in missing}  # whose files are replaced from here on, whatever they answered
    shelf.drop(*(key for key in known if key.partition(" ")[0] in names))
    many = spread(
        workers or (lambda: member_workers(campaign, missing)), scheduler, "a campaign", asked=workers is not None,
        apart=True,
    )  # fmt: skip
    done, reused = dict[str, dict[str, Any]](), {keys[key].name for key in whole}
    counted = partial(tell, progress, "members")
    for key, found in done_once(shelf, keys, finish_member, run=many, tell=counted):
        done[keys[key].name] = found
        if key not in whole:
            _write(out, campaign.name, _collected(campaign, done, reused))
    return _write(out, campaign.name, _collected(campaign, done, reused))


def _job(campaign: Campaign, member: Member, out: Path) -> MemberJob:
    scenario = member.scenario.model_dump_json()
    return MemberJob(member.name, scenario, campaign.stage, str(campaign.base.resolve()), str(out / member.name))


def member_workers(campaign: Campaign, jobs: Sequence[MemberJob]) -> int:
    """Processes that cores and free memory allow, by the forecast of the first finite-element member."""
    wanted = {job.name for job in jobs}
    heavy = [m for m in campaign.members if m.name in wanted and m.scenario.engine == "fem"]
    need = LIGHT
    if heavy:
        from ..engines.forecast import forecast

        try:
            need = forecast(heavy[0].scenario, base=campaign.base).memory_bytes
        except ForearmError:  # the member itself will say so
            need = heavy[0].scenario.solver.memory_limit
    free = SHARE * psutil.virtual_memory().available
    return max(1, min(len(jobs), os.cpu_count() or 1, int(free // need)))


def _collected(campaign: Campaign, done: Mapping[str, Mapping[str, Any]], reused: set[str]) -> list[MemberResult]:
    found = []
    for member in campaign.members:
        if member.name in done:
            numbers = dict(done[member.name])
            problem = str(numbers.pop(LOST, ""))
            found.append(MemberResult(member.name, member.values, numbers, problem, member.name in reused))
    return found


def _write(out: Path, name: str, members: Sequence[MemberResult]) -> CampaignResult:
    rows = [{"member": m.name, **m.values, **m.numbers, "problem": m.problem} for m in members]
    columns = [*dict.fromkeys(key for row in rows for key in row if key != "problem"), "problem"]
    stream = io.StringIO()
    writer = csv.DictWriter(stream, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_text(out / "summary.csv", stream.getvalue())
    page = campaign_page(name, columns, rows)
    page.save(out, "summary")
    return CampaignResult(out, tuple(members), page.sections[0].block.markdown() if page.sections[0].block else "")


def campaign_page(name: str, columns: Sequence[str], rows: Sequence[Mapping[str, Any]]) -> Page:
    """The page of a campaign: the best member by each S, then one row a member."""
    best = []
    for column in (c for c in columns if c.startswith("S ")):
        known = [r for r in rows if isinstance(r.get(column), float) and math.isfinite(r[column])]
        if known:
            top = max(known, key=lambda r: r[column])
            best.append(f"Largest mean {column}: {top[column]:.3g}, {top['member']}.")
    lost = sum(bool(r["problem"]) for r in rows)
    finished = f"{len(rows) - lost} of {len(rows)} members finished."
    note = "S is the mean over the points that count; points under or beside a motor are in none."
    sections = [Section("members", "Members", Block.of(columns, rows, note if best else ""))]
    return Page(f"Campaign {name}", [*best, finished], sections, f"forearm_fem {__version__}")
