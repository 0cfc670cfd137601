"""A campaign: many variants of one scenario, each once, here or on a Dask scheduler, and their summary."""

from __future__ import annotations

import hashlib
import itertools
import json
import math
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pandas as pd
import psutil
from pydantic import Field, ValidationError

from .. import __version__
from ..accuracy.estimates import short_verdict
from ..errors import ForearmError, ScenarioError, first_problem
from ..progress import Progress, tell
from ..results.run import read_run
from ..scenario import Scenario, load_scenario, scenario_beside
from ..scenario.base import Name, Part, dotted
from ..scenario.model import read_toml, resolve_tissues
from ..scenario.text import DOTTED, contents, named_files
from ..show.page import Block, Page, Section
from ..store.folder import check_kind, locked, set_kind, write_text
from ..store.shelf import WORK, Shelf
from ..store.work import LIGHT, LOST, SHARE, done_once, spread
from ..tissue import PRESETS, KelvinVoigt, Sourced

__all__ = ["Campaign", "CampaignResult", "Member", "MemberResult", "load_campaign", "run_campaign"]


# One member of a campaign; its failure is data.


@dataclass(frozen=True)
class MemberJob:
    """A member for a worker: plain data, for any machine that sees ``folder`` and ``base``."""

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
        from .run import Run, run_all, run_render, run_solve

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


# The campaign file: a base scenario, and which of its keys vary how.
# ::
# name = "spacings"
# scenario = "thesis.toml"          # relative to this file
# stage = "render"                  # or "solve", "run" (with figures and report)
# set = { accuracy = 0.1 }          # for every member
# [grid]                            # every combination
# "device.spacing" = [0.035, 0.045]
# "tissues.preset" = ["default", "thesis"]
# [[members]]                       # single variants, beside the grid
# name = "wide"
# set = { "device.spacing" = 0.06 }
# [draw]                            # log-normal draws with the spreads of the preset's tissues
# count = 20
# seed = 1
# parameters = ["skin.mu", "fat.mu", "muscle.eta"]

_LONGEST_NAME = 100  # letters that a folder's name may have
Values = dict[str, Any]
Settings = Annotated[Values, DOTTED]


class MemberTable(Part):
    """A single variant."""

    name: Name
    set: Settings = Field(default_factory=dict)


class DrawTable(Part):
    """Random tissues: each parameter is the scenario's value times spread^z, z standard normal, all independent, with
    the spreads of its preset."""

    count: Annotated[int, Field(ge=1, le=100_000)]
    seed: int = 0
    parameters: tuple[str, ...] | None = Field(
        None, description="tissue.key; default: mu and eta of the limb's soft tissues"
    )


class CampaignFile(Part):
    """A campaign file; see the module."""

    name: Name
    scenario: str = Field(description="scenario file, relative to the campaign file")
    stage: Literal["solve", "render", "run"] = "render"
    set: Settings = Field(default_factory=dict, description="overrides for every member")
    grid: Annotated[dict[str, Annotated[list[Any], Field(min_length=1)]], DOTTED] = Field(default_factory=dict)
    members: tuple[MemberTable, ...] = ()
    draw: DrawTable | None = None


@dataclass(frozen=True)
class Member:
    """A variant: its ``values`` by dotted key, and the scenario they give."""

    name: str
    values: Mapping[str, Any]
    scenario: Scenario


@dataclass(frozen=True)
class Campaign:
    """All members; ``base`` is the folder that files named in the scenario are relative to."""

    name: str
    stage: Literal["solve", "render", "run"]
    base: Path
    members: tuple[Member, ...]


def load_campaign(path: str | Path) -> Campaign:
    """Campaign from a TOML file, every member's scenario checked; raises ScenarioError in one sentence."""
    file = Path(path)
    try:
        asked = CampaignFile.model_validate(read_toml(file, "no such campaign file"))
    except ValidationError as problem:
        known = ", ".join(CampaignFile.model_fields)
        raise ScenarioError(f"{file}: {first_problem(problem, 'campaign')}; known keys are {known}") from None
    if "name" in {*asked.set, *asked.grid, *(key for member in asked.members for key in member.set)}:
        raise ScenarioError(f"{file}: name: a scenario is called by its member; leave the key out of set and grid")
    if twice := sorted(set(asked.set) & set(asked.grid)):
        raise ScenarioError(f"{file}: {twice[0]} is given twice, in set and in grid; name each key once")
    source = scenario_beside(file.parent, asked.scenario)
    preset = load_scenario(source, overrides=[_override(*item) for item in asked.set.items()])
    variants = list(_variants(asked, preset))
    names = [name for name, _ in variants]
    if twice := sorted({n for n in names if names.count(n) > 1}):
        raise ScenarioError(f"{file}: members are called {', '.join(twice)} twice; give each its own name")
    members = []
    for name, values in variants:
        merged = {**asked.set, **dotted(values), "name": name}
        try:
            scenario = load_scenario(source, overrides=[_override(*item) for item in merged.items()])
        except ScenarioError as problem:
            raise ScenarioError(f"member {name}: {problem}") from None
        members.append(Member(name, values, scenario))
    return Campaign(asked.name, asked.stage, source.parent, tuple(members))


def _variants(asked: CampaignFile, preset: Scenario) -> Iterator[tuple[str, Values]]:
    keys = list(asked.grid)
    for combination in itertools.product(*asked.grid.values()) if keys else ():
        values = dict(zip(keys, combination, strict=True))
        yield grid_name(values), values
    for member in asked.members:
        yield member.name, dict(member.set)
    if asked.draw is not None:
        width = len(str(asked.draw.count - 1))
        for k, values in enumerate(draws(preset, asked.draw)):
            yield f"draw-{k:0{width}d}", values
    if not keys and not asked.members and asked.draw is None:
        yield asked.name, {}


def grid_name(values: Mapping[str, Any]) -> str:
    """A folder name that says what varies: last part of each key and its value; a long one is cut and marked."""
    plain = {key: f"{value:.12g}" if isinstance(value, float) else value for key, value in values.items()}
    parts = [f"{key.rpartition('.')[2]}-{value}" for key, value in plain.items()]
    name = re.sub(r"[^A-Za-z0-9_.-]+", "-", "_".join(parts)).strip("-.")
    if len(name) <= _LONGEST_NAME:
        return name
    mark = hashlib.sha256("_".join(parts).encode()).hexdigest()[:8]
    return f"{name[: _LONGEST_NAME - 9].rstrip('-.')}-{mark}"


def draws(scenario: Scenario, table: DrawTable) -> Iterator[Values]:
    """Overrides of each draw; draw k is the same however many are asked for (one generator, row by row).

    Raises :class:`ScenarioError` for what no spread is known of, such as the laws of bounded damping, whose parameters
    go together.
    """
    known, met = _drawable(scenario), set(scenario.tissue_keys.values())
    wanted = table.parameters or tuple(k for k in known if k.partition(".")[0] in met and k.endswith((".mu", ".eta")))
    if bad := [k for k in wanted if k not in known]:
        raise ScenarioError(
            f"draw.parameters: no spread is known of '{bad[0]}'; known are {', '.join(known) or 'none'}"
        )
    if not table.parameters and (joint := _drawn_jointly(scenario)):
        raise ScenarioError(
            f"draw: {joint[0]} has a law whose parameters go together, so that they are not drawn one by one; take "
            "`forearm-fem predict`, which draws them jointly, or name draw.parameters of other tissues"
        )
    spread = {key: known[key] for key in wanted}
    random = np.random.default_rng(table.seed)
    for _ in range(table.count):
        z = random.standard_normal(len(spread))
        yield {f"tissues.override.{key}": s.draw(float(v)) for (key, s), v in zip(spread.items(), z, strict=True)}


def _drawable(scenario: Scenario) -> dict[str, Sourced]:
    """Parameters that may be drawn, about the scenario's own value, by "tissue.key": of tissues with Kelvin-Voigt's
    law whose spread the preset has."""
    tissues, found = resolve_tissues(scenario), dict[str, Sourced]()
    for name, record in PRESETS[scenario.tissues.preset].items():
        modulus = tissues[name].modulus
        if record.model != "kelvin-voigt" or not isinstance(modulus, KelvinVoigt):
            continue
        own = {"density": tissues[name].density, "mu": modulus.mu, "eta": modulus.eta}
        for key, sourced in record.parameters.items():
            if sourced.spread > 1:
                found[f"{name}.{key}"] = replace(sourced, value=own[key])
    return found


def _drawn_jointly(scenario: Scenario) -> list[str]:
    """Soft tissues of the limb with another law than Kelvin-Voigt's."""
    tissues = resolve_tissues(scenario)
    met = dict.fromkeys(scenario.tissue_keys.values())
    return [n for n in met if n != "bone" and not isinstance(tissues[n].modulus, KelvinVoigt)]


def _override(key: str, value: Any) -> str:
    return f"{key}={_toml(value)}"


def _toml(value: Any) -> str:
    """A value as TOML writes it."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    if isinstance(value, Mapping):
        return "{" + ", ".join(f'"{k}" = {_toml(v)}' for k, v in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return repr(value)


# All members of a campaign on Dask: local processes by default, an existing scheduler by address.


@dataclass(frozen=True)
class MemberResult:
    """Result of a member: numbers for the table, or the sentence why it failed; ``reused`` if done before."""

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
    table = pd.DataFrame(rows, columns=columns, dtype=object)
    write_text(out / "summary.csv", str(table.to_csv(index=False, lineterminator="\n")))
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


# Many variants of one scenario: a list, a grid, or draws of the tissues; on this machine or a Dask scheduler.
