"""One draw from arm to S: its G, the G that is calibrated, drives designed on that, and S on both."""

from __future__ import annotations

import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from ...device import close_loop
from ...errors import ReductionError
from ...measurement.chain import reported
from ...ports import Port
from ...rendering.interval import interval
from ...rendering.job import RenderJob
from ...scenario import Scenario
from ...scenario.sweep import frequencies
from ...store.record import dims
from ...tissue import resolve_tissues
from ...transfer import TransferMatrix, finite, total_error
from ...typing import ComplexArray, FloatArray, IntArray
from .arm import ArmModel
from .draws import REFERENCE, SOFT, Draw, idle_inputs, measured_of, scenario_of, soft_tissues

KEPT = 16  # draws whose G is kept: 5 MB of the thesis' scene
_MOST = 1.0  # e_band: nothing is known of a G that may be wrong by as much as it is
_DRAWS = 6  # of an arm's errors, for the interval of its S; all targets of a method are pooled
READINGS = ("played", "reported", "played, record", "reported, record")


@dataclass(frozen=True, eq=False)
class Setup:
    """What all draws of a prediction share: the scene, its renderers, the ports that these aim by, inputs held."""

    scenario: Scenario
    job: RenderJob
    outputs: tuple[Port, ...]
    inputs: tuple[Port, ...]
    held: frozenset[str]

    @property
    def methods(self) -> tuple[str, ...]:
        """Names of the methods."""
        return self.job.names

    @property
    def targets(self) -> tuple[str, ...]:
        """Names of the targets."""
        return self.job.targets


def setup_of(scenario: Scenario, nominal: TransferMatrix, base: Path, held: Collection[str] = ()) -> Setup:
    """``nominal`` is G of the scene itself, whose ports are taken."""
    job = RenderJob.of(scenario, nominal, base=base)
    return Setup(scenario, job, nominal.outputs, nominal.inputs, frozenset(held))


@dataclass(frozen=True, eq=False)
class Outcome:
    """What became of a draw.

    ``strengths`` (n_reading, n_method, n_target) [-] by :data:`READINGS`: S as played on the skin, which is what the
    drives reach on the true G, and S as the rig reports it, on the G that it measured (as Table I); over the scene's
    window and over the record. ``drivers`` are what S may hang on, by name: the
    draw's inputs, and size [Pa] and loss tangent at 150 Hz of each tissue instead of its law's own parameters.
    ``numerics`` is e_band of all errors stated for the draw's G, ``spread`` (n_method, n_target) the half width of the
    interval of log S that these leave. ``problem`` says why there is no S (then NaN).
    ``transfer`` (n_frequency, n_out, n_in) is the true G of the first draws (:data:`KEPT`), to be looked at.
    """

    number: int
    law: str
    strengths: FloatArray
    drivers: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    numerics: float = float("nan")
    seconds: float = float("nan")
    problem: str = ""
    transfer: ComplexArray | None = None
    spread: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))

    @classmethod
    def none(cls, number: int, law: str, setup: Setup, problem: str) -> Outcome:
        """A draw without S, and why."""
        shape = (len(READINGS), len(setup.methods), len(setup.targets))
        return cls(number, law, np.full(shape, np.nan), problem=problem)

    def as_parts(self) -> dict[str, Any]:
        """Arrays and plain values, for a shelf."""
        parts = {f.name: getattr(self, f.name) for f in fields(self)}
        return {**{n: v for n, v in parts.items() if v is not None}, "drivers": dict(self.drivers)}


@dataclass(frozen=True, eq=False)
class DrawsFile:
    """``draws.nc``: every draw of a prediction with its inputs and its S, in the order of their numbers.

    ``question`` is the digest of what was asked. ``kept`` are the numbers of draws whose ``transfer`` was kept, in
    ``unit`` at ``frequency``.
    """

    kind: ClassVar[str] = "prediction"
    version: ClassVar[int] = 1

    question: str
    unit: str
    draw: IntArray = field(metadata=dims("draw", long_name="number of the draw"))
    reading: tuple[str, ...] = field(metadata=dims("reading", long_name="G that S is taken on, and over what"))
    method: tuple[str, ...] = field(metadata=dims("method"))
    target: tuple[str, ...] = field(metadata=dims("target"))
    driver: tuple[str, ...] = field(metadata=dims("driver"))
    strengths: FloatArray = field(
        metadata=dims("draw reading method target", name="S", units="1", long_name="signal strength")
    )
    drivers: FloatArray = field(metadata=dims("draw driver", long_name="inputs of the draw, SI; NaN where it has none"))
    law: tuple[str, ...] = field(metadata=dims("draw"))
    spread: FloatArray = field(
        metadata=dims(
            "draw method target", units="1",
            long_name="half width of the interval of log S that the errors of the draw's G leave",
        )
    )  # fmt: skip
    numerics: FloatArray = field(metadata=dims("draw", units="1", long_name="e_band of G"))
    seconds: FloatArray = field(metadata=dims("draw", units="s"))
    problem: tuple[str, ...] = field(metadata=dims("draw"))
    frequency: FloatArray = field(metadata=dims("frequency", units="Hz"))
    kept: IntArray = field(metadata=dims("kept", long_name="draws with a G"))
    transfer: ComplexArray = field(
        metadata=dims(
            "kept frequency output input", name="G", units="=unit", long_name="true transfer matrix of the draw"
        )
    )

    @classmethod
    def of(
        cls, outcomes: Sequence[Outcome], methods: Sequence[str], targets: Sequence[str], question: str,
        frequency: FloatArray, unit: str = "m/V",
    ) -> DrawsFile:  # fmt: skip
        """The file of some ``outcomes``."""
        ordered = sorted(outcomes, key=lambda o: o.number)
        names = sorted({name for o in ordered for name in o.drivers})
        drivers = [[o.drivers.get(name, np.nan) for name in names] for o in ordered]
        shape = len(methods), len(targets)
        kept = [o for o in ordered if o.transfer is not None]
        values = np.array([o.transfer for o in kept]) if kept else np.zeros((0, len(frequency), 0, 0), dtype=complex)
        return cls(
            question, unit, np.array([o.number for o in ordered], dtype=np.int64), READINGS, tuple(methods),
            tuple(targets), tuple(names), np.array([o.strengths for o in ordered]).reshape(-1, len(READINGS), *shape),
            np.array(drivers).reshape(len(ordered), -1), tuple(o.law for o in ordered),
            np.array([o.spread if o.spread.size else np.full(shape, np.nan) for o in ordered]).reshape(-1, *shape),
            np.array([o.numerics for o in ordered]), np.array([o.seconds for o in ordered]),
            tuple(o.problem for o in ordered), np.asarray(frequency, dtype=float),
            np.array([o.number for o in kept], dtype=np.int64), values,
        )  # fmt: skip

    @property
    def outcomes(self) -> list[Outcome]:
        """The draws."""
        drivers = [
            {n: float(v) for n, v in zip(self.driver, values, strict=True) if np.isfinite(v)} for values in self.drivers
        ]
        kept = dict(zip(self.kept.tolist(), self.transfer, strict=True))
        rows = zip(
            self.draw.tolist(), self.law, self.strengths, drivers, self.numerics, self.seconds, self.problem,
            self.spread, strict=True,
        )  # fmt: skip
        return [
            Outcome(n, law, s, MappingProxyType(driven), float(e), float(t), problem, kept.get(n), spread)
            for n, law, s, driven, e, t, problem, spread in rows
        ]


def outcome_of(draw: Draw, setup: Setup, arm: ArmModel) -> Outcome:
    """S of ``draw``; raises the :class:`ForearmError` of an arm that cannot be, or whose error is too large to say."""
    began = time.perf_counter()
    held = setup.held | arm.held
    scenario = scenario_of(draw, setup.scenario, held)
    values = {name: value for name, value in draw.values.items() if name not in held}
    answer = arm.answer(scenario, frequencies(scenario.sweep))
    true, *others = (
        with_nominal_ports(finite(close_loop(c, scenario.device)), setup) for c in (answer.compliance, *answer.others)
    )
    if not total_error(true.errors) < _MOST:
        raise ReductionError(f"G of the arm may be wrong by as much as it is: e_band is {_MOST:g} or more, or unknown")
    seen = measured_of(replace(draw, values=values), scenario)
    met = true
    if seen.grid != scenario.grid:
        compliance = arm.compliance(seen, frequencies(seen.sweep))
        met = with_nominal_ports(finite(close_loop(compliance, seen.device)), setup)
    found = strengths_of(setup.job, true, reported(met, seen, draw.generator("rig")))
    job = setup.job
    noise = tuple(e for e in true.errors if e.source not in answer.shown)
    spread = interval(true, noise, job.targets, job.span, job.methods, job.wavelet, draws=_DRAWS, others=others)
    return Outcome(
        draw.number, draw.law, found, drivers_of(draw, scenario, held), total_error(true.errors),
        time.perf_counter() - began, spread=spread,
        transfer=true.values.astype(np.complex64) if draw.number < KEPT else None,
    )  # fmt: skip


def with_nominal_ports(transfer: TransferMatrix, setup: Setup) -> TransferMatrix:
    """The same G with the ports where the experimenter thinks they are: renderers aim by these places."""
    return replace(transfer, outputs=setup.outputs, inputs=setup.inputs)


def strengths_of(job: RenderJob, true: TransferMatrix, measured: TransferMatrix) -> FloatArray:
    """S (n_reading, n_method, n_target) of drives designed on the ``measured`` G, on the ``true`` one and there."""
    found = job.strengths(measured, true, measured, windows=(job.window, "record"))
    return found.reshape(len(READINGS), *found.shape[2:])


def drivers_of(draw: Draw, scenario: Scenario, held: Collection[str]) -> dict[str, float]:
    """What S may hang on: inputs, and of each drawn tissue its size |mu*| [Pa] and loss tangent at 150 Hz; nothing of a
    tissue or layer that the limb has not, or of a part that the drive leaves out, for chance would make it a driver."""
    tissue_input = {f"{t}." for t in SOFT}
    own, layers = soft_tissues(scenario), {layer.tissue for layer in getattr(scenario.limb, "layers", ())}
    absent = {f"{t} thickness" for t in SOFT if t not in layers} | idle_inputs(scenario)
    found = {
        name: value
        for name, value in draw.values.items()
        if name not in held and name not in absent and not any(name.startswith(t) for t in tissue_input)
    }
    if "tissue" not in held:
        for name, tissue in resolve_tissues(scenario).items():
            if name in own:
                modulus = complex(tissue.modulus.at(2 * np.pi * REFERENCE))
                found |= {f"{name} stiffness": abs(modulus), f"{name} loss": modulus.imag / modulus.real}
    return found
