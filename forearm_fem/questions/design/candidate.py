"""A candidate device: its model, S, power and constraints."""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from ...accuracy.estimates import quadrature_estimate
from ...device import close_loop
from ...engines.layered import NO_PATCH, LayeredEngine, flat_disc, flat_ports, kept_tables, tables_reach
from ...engines.simulation import Engine
from ...errors import AccuracyWarning, ForearmError, ScenarioError
from ...layered.tables import Tabulated
from ...metrics.strength import WITHOUT_BOUND
from ...progress import Progress
from ...rendering import Rendering
from ...rendering.job import RenderJob, check_servable
from ...scenario import Scenario
from ...scenario.device import Housing, VoltageDevice
from ...scenario.sweep import FrequencyList, frequencies
from ...transfer import Compliance, TransferMatrix, finite, total_error
from ...typing import FloatArray
from .model import Constraints, Design, DesignFile, Objective, Values

# Models of an arm that answer for any device on it.


class TabulatedArm:
    """The layered model from tables: flat layers without end, any equal discs, a fraction of a second each.

    Tables are made once per tissue, radius and contact, and kept in ``folder`` (None: the cache).
    """

    def __init__(self, folder: Path | None = None, progress: Progress | None = None) -> None:
        self._folder, self._progress = folder, progress
        self._known: dict[str, Tabulated] = {}

    name = "tables"

    def holds(self, scenario: Scenario) -> str:
        """See :class:`.Engine`: as the layered model."""
        return NO_PATCH if scenario.tissues.patch.is_on else LayeredEngine().holds(scenario)

    def compliance(self, scenario: Scenario, frequency: FloatArray) -> Compliance:
        """See :class:`.Engine`; entries between two points are NaN."""
        ports = flat_ports(scenario)
        omega = 2 * np.pi * frequency
        places = np.array([p.position[:2] for p in ports])
        reach = tables_reach(float(np.ptp(places, axis=0).max() * np.sqrt(2)))
        table = kept_tables(scenario, reach, folder=self._folder, progress=self._progress, known=self._known)
        result = table.compliance(omega, [flat_disc(port) for port in ports])
        e = result.error
        estimate = quadrature_estimate(
            frequency, e,
            "twice the tables' difference from the layered model itself on one arrangement, the last coefficients "
            "between frequencies, and the last terms and orders of the tractions under rigid discs",
        )  # fmt: skip
        return Compliance(frequency, result.values, ports, (estimate,))


# One candidate: S, drives, errors and constraints of a device on one or several arms.

_NEARNESS = 1e-3  # m


@dataclass(frozen=True)
class Candidate:
    """Result of the design variables ``values``.

    ``score`` is the objective [-], NaN where the device cannot be; ``strengths`` S by target, mean over the arms;
    ``voltage`` [V] and ``power`` [W] are the largest of any actuator with the target's motion at ``target_peak``,
    ``total_power`` [W] all actuators' mean over targets, NaN for drives that are no voltages; powers are means over the
    scenario's own record, however short it was while searching. ``error`` is e_band of G, the largest over the arms.
    ``violations`` are the constraints that do not hold, by how much [-]; ``problem`` says why the device cannot be.
    """

    values: Values
    score: float
    strengths: Mapping[str, float]
    actuators: int
    voltage: float
    power: float
    total_power: float
    mass: float
    error: float
    violations: Mapping[str, float]
    problem: str = ""

    @property
    def feasible(self) -> bool:
        """True if the device can be and every constraint holds."""
        return not self.problem and not self.violations and math.isfinite(self.score)

    @property
    def cost(self) -> float:
        """Cost that a search minimises: minus the objective; 100 more, and growing, for constraints that do not
        hold; 1000 for a device that cannot be."""
        if self.problem or not math.isfinite(self.score):
            return 1000.0
        return -self.score + (100.0 + 100.0 * sum(self.violations.values()) if self.violations else 0.0)

    @property
    def outcome(self) -> str:
        """Everything found for the values, to nine digits."""
        return json.dumps({k: v for k, v in _rounded(self.as_json()).items() if k != "values"}, sort_keys=True)

    def as_json(self) -> dict[str, Any]:
        """Plain data; NaN as None."""
        return {k: None if isinstance(v, float) and math.isnan(v) else v for k, v in asdict(self).items()}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Candidate:
        """The same back."""
        numbers = ("score", "voltage", "power", "total_power", "mass", "error")
        return cls(**{**data, **{k: math.nan for k in numbers if data[k] is None}})


def _rounded(data: Any) -> Any:
    if isinstance(data, Mapping):
        return {k: _rounded(v) for k, v in data.items()}
    return float(f"{data:.9g}") if isinstance(data, float) else data


def evaluate(design: Design, values: Values, arm: Engine) -> Candidate:
    """The candidate ``values`` of ``design`` on ``arm``; what cannot be is data, not an error."""
    asked = design.asked
    try:
        scenarios = design.scenarios(values)
        first = scenarios[0]
        broken = _geometry(first, asked.constraints, _targets(first, asked.objective))
        found = [_one(s, arm, asked, base) for s, base in zip(scenarios, design.bases, strict=True)]
    except ForearmError as problem:
        unknown = math.nan
        return Candidate(values, unknown, {}, 0, unknown, unknown, unknown, unknown, unknown, {}, str(problem))
    s = np.array([f.strengths for f in found])
    scores = [score_of(row, asked.objective) for row in s]
    over = float(np.min(scores) if asked.objective.over == "least" else np.mean(scores))  # NaN where one is
    count, limits = len(first.device.centres), asked.constraints
    voltage, power = (float(np.max([getattr(f, what) for f in found])) for what in ("voltage", "power"))
    total = float(np.mean([f.total_power for f in found]))
    housing = first.device.housing if isinstance(first.device, VoltageDevice) else None
    mass = housing.mass if isinstance(housing, Housing) else math.nan
    are = {"max_voltage": voltage, "max_power": power, "max_mass": mass, "max_actuators": count}
    for name, value in are.items():
        most = getattr(limits, name)
        if most is not None and not value <= most:
            broken[name] = float(value / most - 1) if math.isfinite(value) else 1.0
    means = dict(zip(found[0].targets, map(float, s.mean(axis=0)), strict=True))
    error = float(np.max([f.error for f in found]))
    return Candidate(values, over, means, count, voltage, power, total, mass, error, broken)


def s_interval(design: Design, candidate: Candidate, arm: Engine) -> tuple[float, float]:
    """Least and largest score [-] that the errors of the model's G allow, by draws (decision 0027)."""
    asked, low, high = design.asked, [], []
    for whole, base in zip(design.scenarios(candidate.values), design.bases, strict=True):
        scenario = _shorter(whole, asked.search.duration)
        g = transfer_on(scenario, arm)
        job = RenderJob.of(scenario, g, base=base, targets=_targets(scenario, asked.objective))
        account = _played(job, g).strength
        low.append(score_of(account.low[0], asked.objective))
        high.append(score_of(account.high[0], asked.objective))
    pick = np.min if asked.objective.over == "least" else np.mean
    return float(pick(low)), float(pick(high))


@dataclass(frozen=True)
class _Found:
    targets: tuple[str, ...]
    strengths: FloatArray
    voltage: float
    power: float
    total_power: float
    error: float


def transfer_on(scenario: Scenario, arm: Engine) -> TransferMatrix:
    """G of the scenario's device on ``arm``."""
    return finite(close_loop(arm.compliance(scenario, frequencies(scenario.sweep)), scenario.device))


def _one(whole: Scenario, arm: Engine, asked: DesignFile, base: Path) -> _Found:
    scenario = _shorter(whole, asked.search.duration)
    check_servable(scenario)
    targets = _targets(scenario, asked.objective)
    g = transfer_on(scenario, arm)
    rendering = _played(RenderJob.of(scenario, g, base=base, targets=targets), g)
    method = rendering.methods[0]
    if np.nanmax(rendering.strengths[0], initial=0.0) > WITHOUT_BOUND:
        raise ScenarioError(
            "S has no bound: so many actuators hold all other points still, and rounding would choose; use more grid "
            "points than actuators, or fewer of these"
        )
    share = np.array([_share(rendering, method, t, asked.constraints.target_peak) for t in targets])
    reports = [rendering[method, t].report for t in targets]
    peak = np.array([r.peak for r in reports]) * share[:, None]
    silence = scenario.sweep.duration / whole.sweep.duration  # a drive ends, and the rest of its record is still
    power = np.array([r.power for r in reports]) * share[:, None] ** 2 * silence
    volts = g.unit == "m/V"
    return _Found(
        targets, rendering.strengths[0], float(peak.max()) if volts else math.nan, float(power.max()),
        float(power.sum(axis=1).mean()), total_error(g.errors),
    )  # fmt: skip


def _played(job: RenderJob, g: TransferMatrix) -> Rendering:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", AccuracyWarning)  # told by the confirmation
        return job.play(g)


def _share(rendering: Rendering, method: str, target: str, wanted: float) -> float:
    """Factor on the drives with which the target's largest motion is ``wanted`` [m]."""
    moved = rendering[method, target].displacements
    reached = float(np.abs(moved.values[moved.target_index]).max())
    return wanted / reached if reached > 0 else math.inf


def score_of(strengths: FloatArray, objective: Objective) -> float:
    """The objective [-] of S (n_target,); NaN where some S is."""
    if objective.of == "share":
        return float(np.mean(strengths > 1)) if not np.isnan(strengths).any() else math.nan
    return float(strengths.min() if objective.of == "least" else strengths.mean())


def _targets(scenario: Scenario, objective: Objective) -> tuple[str, ...]:
    every = tuple(str(k + 1) for k in range(len(scenario.grid.places)))
    return every if objective.targets == "all" else objective.targets


def _geometry(scenario: Scenario, limits: Constraints, targets: tuple[str, ...]) -> dict[str, float]:
    """Distances that are too small, by the share that they lack [-]; of 1 mm where none is asked for."""
    contacts, places = np.array(scenario.device.centres), np.array(scenario.grid.places)
    aimed = places[[int(t) - 1 for t in targets]]
    clear = float(np.linalg.norm(aimed[:, None] - contacts[None], axis=2).min()) - scenario.device.cone.radius
    apart = min((math.dist(a, b) for a, b in combinations(contacts, 2)), default=math.inf)
    found = {}
    for name, is_, least in (("clearance", clear, limits.clearance), ("min_distance", apart, limits.min_distance)):
        if is_ < least * (1 - 1e-9):
            found[name] = (least - is_) / (least or _NEARNESS)
    return found


def _shorter(scenario: Scenario, duration: float) -> Scenario:
    """The scenario on a shorter record; unchanged where S is taken over the whole record, or frequencies are listed."""
    window = scenario.rendering.window
    if isinstance(scenario.sweep, FrequencyList) or window == "record" or scenario.sweep.duration <= duration:
        return scenario
    return scenario.changed({"sweep.duration": duration})
