"""A design from its file to its winner: searched, evaluated, kept, confirmed, written."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from importlib import import_module
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import psutil
from scipy.optimize import differential_evolution, minimize
from scipy.stats import qmc

from ... import __version__
from ...engines.simulation import Engine
from ...errors import ScenarioError
from ...notebook import Manners
from ...progress import Progress, tell, within
from ...rendering.job import wavelet
from ...results.run import read_run
from ...scenario.text import contents, named_files
from ...store.folder import check_kind, set_kind
from ...store.shelf import WORK, Shelf
from ...store.text import digest_of
from ...store.work import LIGHT, SHARE, cluster, done_once
from ...store.work import Run as Spread
from ...typing import BoolArray, FloatArray
from ..run import Run, run_all
from .candidate import Candidate, TabulatedArm, evaluate, s_interval, score_of
from .model import Design, Values

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import FigureBase


# Pareto front: candidates that no other beats in everything at once.


def pareto_front(candidates: Sequence[Candidate]) -> tuple[Candidate, ...]:
    """Feasible candidates with no other of at least their score, at most their actuators and at most their power, one
    of these strictly; by number of actuators, then power. Power is unknown of drives that are no voltages: such a
    candidate is compared with its like alone, by score and actuators.
    """
    feasible = [c for c in candidates if c.feasible]
    kept: list[Candidate] = []
    for unknown in (False, True):
        alike = [c for c in feasible if math.isnan(c.total_power) == unknown]
        goods = np.array([(-c.score, c.actuators, _power(c)) for c in alike]).reshape(-1, 3)
        seen: set[tuple[float, ...]] = set()  # of equals the first is kept
        for mine, candidate in zip(goods, alike, strict=True):
            worse = (goods <= mine).all(axis=1) & (goods < mine).any(axis=1)
            if not worse.any() and tuple(mine) not in seen:
                seen.add(tuple(mine))
                kept.append(candidate)
    return tuple(sorted(kept, key=lambda c: (c.actuators, _power(c), -c.score)))


def _power(candidate: Candidate) -> float:
    return math.inf if math.isnan(candidate.total_power) else candidate.total_power


# The search: differential evolution over everything, then Nelder-Mead over what is continuous.

Ask = Callable[[Sequence[Values]], list[Candidate]]
_STILL = 1e-4  # of each range: a local search ends there


def search(design: Design, ask: Ask) -> None:
    """Ask for candidates until the design's numbers of them are spent; the best is among those asked for.

    Storn & Price 1997 as in SciPy, whole generations at a time so that they can be computed side by side, from a Sobol
    start; then Nelder & Mead 1965 from the best, within the bounds. Both depend on their seed and on what was
    answered only, so that a search begun anew asks for the same.
    """
    low, high, whole = design.bounds
    options = design.asked.search
    if _levels(low, high, whole) <= options.candidates:
        axes = [np.arange(a, b + 1) for a, b in zip(low, high, strict=True)]
        every = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(low))
        ask([design.values(at) for at in every])
        return

    def many(points: FloatArray) -> list[float]:
        """Costs of candidates at ``points`` (n, variables)."""
        return [c.cost for c in ask([design.values(at) for at in points])]

    power = int(np.ceil(np.log2(max(options.population, 2))))
    start = low + (high - low) * qmc.Sobol(len(low), seed=options.seed).random_base2(power)[: options.population]
    generations = max(0, options.candidates // options.population - 1)
    found = differential_evolution(
        lambda x: many(np.asarray(x).T if np.ndim(x) > 1 else np.atleast_2d(x)),
        list(zip(low, high, strict=True)), maxiter=generations, init=start, seed=options.seed, polish=False, tol=0,
        updating="deferred", vectorized=True, integrality=whole,
    )  # fmt: skip
    free = ~whole
    if not options.local or not free.any():
        return
    span = np.where(free, high - low, 1.0)

    def one(part: FloatArray) -> float:
        """Cost where the free variables stand at ``part`` (0 to 1) of their ranges."""
        at = np.array(found.x, dtype=float)
        at[free] = low[free] + span[free] * part
        return many(at[None])[0]

    minimize(
        one, ((found.x - low) / span)[free], method="Nelder-Mead", bounds=[(0, 1)] * int(free.sum()),
        options={"maxfev": options.local, "xatol": _STILL, "fatol": 1e-6},
    )  # fmt: skip


def most_candidates(design: Design) -> int:
    """Number of candidates that the search asks for at most."""
    options, (low, high, whole) = design.asked.search, design.bounds
    levels = _levels(low, high, whole)
    return int(levels) if levels <= options.candidates else options.candidates + options.local


def _levels(low: FloatArray, high: FloatArray, whole: BoolArray) -> float:
    """Combinations of choices; infinite where something is continuous."""
    return float(np.prod(np.where(whole, high - low + 1, np.inf)))


# A design from its file to its winner: evaluated, kept, confirmed, written.

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


@dataclass(frozen=True, repr=False)
class DesignResult(Manners):
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

    @property
    def line(self) -> str:
        """The best device."""
        from .report import outcome_words

        return outcome_words(self)[0].rstrip(".")

    @property
    def rows(self) -> list[list[object]]:
        """Devices on the Pareto front, each with its score."""
        keys = list(self.best.values)
        return [[*keys, "score"], *([*(c.values.get(k) for k in keys), f"{c.score:.3g}"] for c in self.front)]

    def to_xarray(self) -> xr.Dataset:
        """Values, numbers and S of every candidate."""
        import xarray as xr

        from .report import arrays

        return xr.Dataset({name: (d, v, a) for name, (d, v, a) in arrays(self).items()})

    def plot(self) -> FigureBase:
        """Candidates, and the front among them."""
        from .report import plot_front

        return plot_front(self)

    def save(self, folder: str | Path) -> None:
        """Write report, pictures and tables into ``folder``."""
        from .report import write_design_report

        write_design_report(replace(self, folder=Path(folder)))


def run_design(
    design: Design,
    folder: str | Path,
    *,
    arm: Engine | None = None,
    confirm: bool = True,
    scheduler: str | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> DesignResult:
    """Search, confirm and write. Every candidate is on disk before the next is asked for; run again, it goes on.

    ``arm`` is what candidates are evaluated on (None: the layered model from tables); with ``workers`` above 1 or a
    ``scheduler`` generations are spread over Dask. Raises ScenarioError where no candidate is feasible.
    """
    for scenario, base in zip(design.scenarios({}), design.bases, strict=True):
        wavelet(scenario.rendering, scenario.sweep, base)  # a missing file is said before the search
    check_kind(folder, "design")
    out = Path(folder).resolve()
    model = arm or TabulatedArm(progress=progress)
    set_kind(out, "design")
    asked = question(design, getattr(model, "mark", model.name))
    shelf, total = Shelf(out / WORK, "candidates"), most_candidates(design)
    mine = [key for key in shelf.known() if key.startswith(asked)]
    known = {key: Candidate.from_json(parts) for key in mine if (parts := shelf.get(key)) is not None}
    with _evaluating(design, model, scheduler, workers, own=arm is None) as run:

        def ask(wanted: Sequence[Values]) -> list[Candidate]:
            """Candidates of ``wanted`` values; those not known yet are evaluated and kept."""
            keys = [f"{asked} {json.dumps(v, sort_keys=True)}" for v in wanted]
            jobs = {key: v for key, v in zip(keys, wanted, strict=True) if key not in known}
            for key, parts in done_once(shelf, jobs, lambda v: evaluate(design, v, model).as_json(), run=run):
                known[key] = Candidate.from_json(parts)
                tell(progress, "candidates", min(len(known), total), total)
            return [known[key] for key in keys]

        search(design, ask)
    every = tuple(known.values())
    best = _best(every)
    reference = evaluate(design, {}, model)
    interval, idle = s_interval(design, best, model), _idle(design, best, every, model)
    confirmation = _confirmed(design, best, out, progress) if confirm else None
    front = pareto_front(every)
    found = DesignResult(design, out, every, front, best, interval, reference, confirmation, idle)
    from .report import write_design_report

    write_design_report(found)
    return found


@contextmanager
def _evaluating(
    design: Design, arm: Engine, scheduler: str | None, workers: int | None, *, own: bool
) -> Iterator[Spread | None]:
    """Spread of candidates over Dask, None for this process: on the ``arm``, sent to each process once, or with
    ``own`` on the layered model that each process makes of tables in its cache."""
    if scheduler is None and (workers or 1) == 1:
        yield None
        return

    def count() -> int:
        """Processes that the cores and the free memory allow."""
        each = LIGHT if own else LIGHT + psutil.Process().memory_info().rss  # an arm as here, and answers on it
        return max(1, min(workers or os.cpu_count() or 1, int(SHARE * psutil.virtual_memory().available // each)))

    with cluster(scheduler, 1 if scheduler else count(), "a design on several processes") as client:
        distributed: Any = import_module("distributed")
        sent = None if own else client.scatter(arm, broadcast=True, hash=False)

        def many(jobs: Mapping[str, Values], _: Any) -> Iterator[tuple[str, dict[str, Any]]]:
            """Candidates of the values of ``jobs`` as they are done."""
            rest = dict(jobs)
            if own and rest:  # makes the tables
                first = next(iter(rest))
                yield first, evaluate(design, rest.pop(first), arm).as_json()
            futures = {client.submit(_evaluated, design, v, sent, pure=False): key for key, v in rest.items()}
            yield from ((futures[f], f.result()) for f in distributed.as_completed(list(futures)))

        yield many


def _evaluated(design: Design, values: Values, arm: Engine | None) -> dict[str, Any]:
    """In a worker: on the ``arm`` that was sent, or the layered model of this process."""
    return evaluate(design, values, arm or _own_arm()).as_json()


@cache
def _own_arm() -> TabulatedArm:
    """The layered model of this process, so that its tables are read once."""
    return TabulatedArm()


def _best(candidates: Sequence[Candidate]) -> Candidate:
    feasible = [c for c in candidates if c.feasible]
    if feasible:
        return max(feasible, key=lambda c: (c.score, -c.actuators))
    problems = [c.problem or f"{', '.join(c.violations)} not held" for c in candidates]
    common = max(set(problems), key=problems.count) if problems else "none was evaluated"
    if len(set(problems)) == 1 and all(c.problem for c in candidates):  # what all have is not of the variables
        raise ScenarioError(f"none of {len(candidates)} candidates can be evaluated: {common}")
    raise ScenarioError(f"none of {len(candidates)} candidates is feasible, mostly: {common}; widen variables")


def _idle(design: Design, best: Candidate, known: Sequence[Candidate], arm: Engine) -> tuple[str, ...]:
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
        folder = out / ("confirmed" if len(design.data) == 1 else f"confirmed-{k + 1}")
        run_all(Run.start(scenario.changed({"rendering.targets": objective.targets}), folder, base,
                          within(progress, "confirmation")))  # fmt: skip
        strength = read_run(folder / "run.json").signal_strength
        assert strength is not None
        s = np.array([entry.value for entry in strength.methods[design.method].values()], dtype=float)
        scores.append(score_of(s, objective))
        folders.append(folder)
    over = np.min(scores) if objective.over == "least" else np.mean(scores)
    return Confirmation(float(over), best.score, tuple(folders))


def question(design: Design, mark: str = "") -> str:
    """Digest of what a candidate's numbers depend on: not the search's seed or length. ``mark`` is the engine's."""
    asked = design.asked.model_dump(mode="json", include={"set", "objective", "constraints"})
    parts = [__version__, mark, asked, design.asked.search.duration, [dict(d) for d in design.data], _contents(design)]
    return digest_of(parts)[:32]


def _contents(design: Design) -> list[list[str]]:
    """Contents of the files that the scenarios, and choices of the search, name."""
    chosen = [str(c) for v in design.asked.variables if v.key.endswith(".file") for c in v.values or ()]
    arms = zip(design.scenarios({}), design.bases, strict=True)
    return [contents((*named_files(scenario), *chosen), base) for scenario, base in arms]
