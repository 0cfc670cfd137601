"""Draws of a prediction: S of every arm by method and target, with what it hangs on, and their file ``draws.nc``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from ..store.record import dims
from ..typing import ComplexArray, FloatArray, IntArray

DRAWS_FILE = "draws.nc"
KEPT = 16  # draws whose G is kept: 5 MB of the thesis' scene
READINGS = ("played", "reported", "played, record", "reported, record")


@dataclass(frozen=True, eq=False)
class Outcome:
    """Result of a draw.

    ``strengths`` (n_reading, n_method, n_target) [-] by :data:`READINGS`: S as played on the skin,
    which is what the drives reach on the true G, and S as the rig reports it, on the G that it measured (as Table I);
    over the scene's window and over the record. ``drivers`` are what S may hang on, by name: the draw's inputs, and
    size [Pa] and loss tangent at 150 Hz of each tissue instead of its law's own parameters.
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
    def none(cls, number: int, law: str, methods: Sequence[str], targets: Sequence[str], problem: str) -> Outcome:
        """A draw without S, and why."""
        shape = (len(READINGS), len(methods), len(targets))
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
