"""A design from its file to its winner: evaluated, kept, confirmed, written."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from ..campaign.executor import LIGHT, SHARE, cluster
from ..errors import ScenarioError
from ..pipeline.folder import Run, run_all
from ..progress import Progress, tell, within
from ..rendering.job import wavelet
from ..results import read_run
from ..store.folder import check_kind, set_kind
from .arm import ArmModel, TwinArm
from .candidate import Candidate, evaluate, s_interval, score_of
from .front import pareto_front
from .model import Design, Values
from .search import planned, search
from .store import Store

Evaluate = Callable[[Sequence[Values]], Iterator[Candidate]]


@dataclass(frozen=True)
class Confirmation:
    """The winner solved in full: S (mean, least or share) there and on the model; ``folders`` hold the runs."""

    score: float
    model: float
    folders: tuple[Path, ...]

    @property
    def difference(self) -> float:
        """Confirmed over modelled score, less one [-]."""
        return self.score / self.model - 1


@dataclass(frozen=True)
class DesignResult:
    """All candidates, the Pareto ``front``, the ``best`` with its ``interval`` of the score by the model's own errors
    and its ``confirmation`` (None where not asked), the ``reference``: the scenario's own device, and the keys of
    ``idle`` variables, at whose other values the best has the same numbers."""

    design: Design
    folder: Path
    candidates: tuple[Candidate, ...]
    front: tuple[Candidate, ...]
    best: Candidate
    interval: tuple[float, float]
    reference: Candidate
    confirmation: Confirmation | None
    idle: tuple[str, ...] = ()


def run_design(
    design: Design,
    folder: str | Path,
    *,
    arm: ArmModel | None = None,
    confirm: bool = True,
    scheduler: str | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> DesignResult:
    """Search, confirm and write. Every candidate is on disk before the next is asked for; run again, it goes on.

    ``arm`` is what candidates are evaluated on (None: the layered twin from tables); with ``workers`` above 1 or a
    ``scheduler`` generations are spread over Dask. Raises ScenarioError where no candidate is feasible.
    """
    for scenario, base in zip(design.scenarios({}), design.bases, strict=True):
        wavelet(scenario.rendering, scenario.sweep, base)  # a missing file is said before the search
    check_kind(folder, "design")
    out = Path(folder).resolve()
    model = arm or TwinArm(progress=progress)
    set_kind(out, "design")
    store = Store(out, design, model.mark)
    with _evaluating(design, model, scheduler, workers, own=arm is None) as many:
        total = planned(design)

        def ask(wanted: Sequence[Values]) -> list[Candidate]:
            """Candidates of ``wanted`` values; those not in the store yet are evaluated and kept."""
            missing = [v for v in wanted if store.get(v) is None]
            for candidate in many(list({repr(v): v for v in missing}.values())):
                store.add(candidate)
                tell(progress, "candidates", min(len(store.all), total), total)
            return [c for v in wanted if (c := store.get(v)) is not None]

        search(design, ask)
    best = _best(store.all)
    reference = evaluate(design, {}, model)
    interval, idle = s_interval(design, best, model), _idle(design, best, store.all, model)
    confirmation = _confirmed(design, best, out, progress) if confirm else None
    front = pareto_front(store.all)
    found = DesignResult(design, out, store.all, front, best, interval, reference, confirmation, idle)
    from .report import write_design_report

    write_design_report(found)
    return found


@contextmanager
def _evaluating(
    design: Design, arm: ArmModel, scheduler: str | None, workers: int | None, *, own: bool
) -> Iterator[Evaluate]:
    """A function that evaluates many, one after another or on Dask: there on the ``arm``, sent to each process once,
    or with ``own`` on the twin that each process makes of tables in its cache."""
    if scheduler is None and (workers or 1) == 1:
        yield lambda wanted: (evaluate(design, v, arm) for v in wanted)
        return

    def count() -> int:
        """Processes that the cores and the free memory allow."""
        each = LIGHT if own else LIGHT + psutil.Process().memory_info().rss  # an arm as here, and answers on it
        return max(1, min(workers or os.cpu_count() or 1, int(SHARE * psutil.virtual_memory().available // each)))

    with cluster(scheduler, count, "a design on several processes") as client:
        distributed: Any = import_module("distributed")
        sent = None if own else client.scatter(arm, broadcast=True, hash=False)

        def many(wanted: Sequence[Values]) -> Iterator[Candidate]:
            """Candidates of ``wanted`` values as they are done."""
            if own and wanted:  # makes the tables
                yield evaluate(design, wanted[0], arm)
            rest = wanted[1:] if own else wanted
            futures = [client.submit(_evaluated, design, v, sent, pure=False) for v in rest]
            yield from (future.result() for future in distributed.as_completed(futures))

        yield many


def _evaluated(design: Design, values: Values, arm: ArmModel | None) -> Candidate:
    """In a worker: on the ``arm`` that was sent, or the twin of this process."""
    return evaluate(design, values, arm or _own_twin())


@cache
def _own_twin() -> TwinArm:
    """The twin of this process, so that its tables are read once."""
    return TwinArm()


def _best(candidates: Sequence[Candidate]) -> Candidate:
    feasible = [c for c in candidates if c.feasible]
    if feasible:
        return max(feasible, key=lambda c: (c.score, -c.actuators))
    problems = [c.problem or f"{', '.join(c.violations)} not held" for c in candidates]
    common = max(set(problems), key=problems.count) if problems else "none was evaluated"
    if len(set(problems)) == 1 and all(c.problem for c in candidates):  # what all have is not of the variables
        raise ScenarioError(f"none of {len(candidates)} candidates can be evaluated: {common}")
    raise ScenarioError(f"none of {len(candidates)} candidates is feasible, mostly: {common}; widen variables")


def _idle(design: Design, best: Candidate, known: Sequence[Candidate], arm: ArmModel) -> tuple[str, ...]:
    """Keys of variables that change nothing of ``best``: not among the ``known`` candidates that differ from it by that
    key alone, nor at the ends and in the middle of its choices."""
    found = list[str]()
    for variable in design.asked.variables:
        key, levels = variable.key, variable.levels or (variable.low, variable.high)
        beside = [c for c in known if {**c.values, key: best.values[key]} == best.values]
        tried = ({**best.values, key: value} for value in (levels[0], levels[-1], levels[len(levels) // 2]))
        if all(c.outcome == best.outcome for c in chain(beside, (evaluate(design, v, arm) for v in tried))):
            found.append(key)
    return tuple(found)


def _confirmed(design: Design, best: Candidate, out: Path, progress: Progress | None) -> Confirmation:
    """The winner by the scenarios' own engine, whole record, with figures and report."""
    scores, folders = [], []
    objective = design.asked.objective
    for k, (scenario, base) in enumerate(zip(design.scenarios(best.values), design.bases, strict=True)):
        aims: dict[str, Any] = {"targets": objective.targets}
        rendering = scenario.rendering.model_copy(update=aims)
        folder = out / ("confirmed" if len(design.data) == 1 else f"confirmed-{k + 1}")
        run_all(Run.start(scenario.model_copy(update={"rendering": rendering}), folder, base,
                          within(progress, "confirmation")))  # fmt: skip
        strength = read_run(folder / "run.json").signal_strength
        assert strength is not None
        s = np.array([entry.value for entry in strength.methods[objective.method].values()], dtype=float)
        scores.append(score_of(s, objective))
        folders.append(folder)
    over = np.min(scores) if objective.over == "least" else np.mean(scores)
    return Confirmation(float(over), best.score, tuple(folders))
