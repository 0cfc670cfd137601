"""The saved reduced model: compliance and G at any frequency, also for other tissues, without mesh or solver."""

from __future__ import annotations

import warnings
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar

import numpy as np

from ..accuracy.other_tissues import carried, probes, shortening, space_error
from ..device import close_loop
from ..errors import AccuracyWarning, DataError, ReductionError, ScenarioError
from ..fem.reduction.affine import AffineReduced, Modes
from ..ports import Port
from ..scenario import Scenario
from ..scenario.model import resolve_tissues
from ..scenario.sweep import frequencies
from ..store.record import dims, load
from ..transfer import Compliance, ErrorEstimate, TransferMatrix, error_words, masked
from ..typing import FloatArray

__all__ = ["SkinModel", "load_skin_model"]

# Keys in which a scenario may differ: terms follow them, or compliances do not follow from them.
_MAY_CHANGE = ("tissues", "device", "name", "description", "rendering", "measurement", "sweep", "solver", "accuracy")
BEYOND = 1.05  # ratio to the ends of the band up to which a model with unstable poles is trusted
_OF_SPACE = ("reduction", "linear solve")  # sources of errors of a compliance; mesh and ends are told of G
_BEYOND_BAND = "not estimated: frequencies lie outside the band that was solved; solve a wider one"
_NOT_AFFINE = "the bulk modulus is not a parameter of the reduced model; solve the scenario anew"


@dataclass(frozen=True, eq=False, repr=False)
class SkinModel:
    """A limb seen through its ports, by the ``reduced`` matrices of the ``scenario`` that was solved: ``reduced.nc``.

    ``core`` is how many of its directions, the first, were certified for this scenario; the others serve other moduli
    (:func:`.widened`), 0 where there are none. ``poles`` are what the sweep found. ``errors`` are those of the solved
    compliance, then those of its G by mesh and ends.
    """

    kind: ClassVar[str] = "reduced model"
    version: ClassVar[int] = 3

    scenario: Scenario
    ports: tuple[Port, ...] = field(metadata=dims("port"))
    reduced: AffineReduced = field(metadata=dims(name=""))
    poles: Modes | None = None
    core: int = 0
    errors: tuple[ErrorEstimate, ...] = ()

    def __repr__(self) -> str:
        band = frequencies(self.scenario.sweep)
        return (
            f"<SkinModel of '{self.scenario.name}', {len(self.ports)} ports, {band.min():g} to {band.max():g} Hz; as "
            f"solved {error_words(self.errors)}>"
        )

    @property
    def name(self) -> str:
        """See :class:`.Engine`."""
        return "reduced model of a run"

    def holds(self, scenario: Scenario) -> str:
        """See :class:`.Engine`: other tissues (not their bulk moduli) and devices (not their places)."""
        if reason := unfollowed(self.scenario, scenario, self.reduced.names):
            return reason
        if self.core or scenario.tissues == self.scenario.tissues:
            return ""
        return (
            "tissues: this reduced model tells no error for other tissues; solve the scenario anew, which is then kept "
            "with what other tissues ask for"
        )

    def compliance(self, scenario: Scenario, frequency: FloatArray) -> Compliance:
        """Compliance of all ports at ``frequency`` (n,) [Hz] with its errors; NaN for a point force under itself.

        Frequencies more than 5 % beyond the band are answered with an AccuracyWarning, and the error is unknown. Raises
        ReductionError for them where the model has unstable poles, as it may for incompressible tissue; DataError for
        none, or what is no frequency.
        """
        if frequency.ndim != 1 or not len(frequency) or not np.all(np.isfinite(frequency) & (frequency >= 0)):
            raise DataError("frequency: expected a row of one or more, finite and not negative [Hz]; correct it")
        if reason := self.holds(scenario):
            raise ScenarioError(reason)
        drawn, solved = self.reduced.at(scenario), scenario.tissues == self.scenario.tissues
        band = frequencies(self.scenario.sweep)
        beyond = frequency[(frequency < band.min() / BEYOND) | (frequency > band.max() * BEYOND)]
        if len(beyond) and (count := drawn.negative_directions()):
            raise ReductionError(
                f"{beyond[0]:g} Hz is outside the band of this reduced model, {band.min():g} to {band.max():g} Hz, and "
                f"the model has {count} unstable poles there: solve a wider band (sweep.f_min, sweep.f_max), or anew "
                "with solver.precision = 'double'"
            )
        if len(beyond):
            warnings.warn(
                f"{len(beyond)} frequencies lie outside the band of this reduced model, {band.min():g} to "
                f"{band.max():g} Hz: nothing is known of the error there; solve a wider band",
                AccuracyWarning,
                stacklevel=2,
            )
        if solved and self.poles:
            values = self.poles.compliance(frequency)
        else:
            values = (self._certified(scenario) if solved else drawn).response(frequency)
        found = Compliance(frequency.copy(), masked(values, self.ports), self.ports)
        space = [e for e in self.errors if e.source in _OF_SPACE]
        if len(beyond):
            space = [ErrorEstimate("reduction", np.nan, _BEYOND_BAND)]
        elif not solved:
            some, narrow = self._compared(found, scenario)
            error = space_error(some.frequency, *(c.block("point", "contact") for c in (some, narrow)))
            space = [*(e for e in space if e.source != "reduction"), replace(error, per_pair=None)]
        size = np.linalg.norm(found.block("point", "contact"), axis=(1, 2))
        mesh = (replace(e, per_pair=None, together=None) for e in self._of_mesh(scenario, frequency, size))
        return replace(found, errors=(*space, *mesh))

    def _of_mesh(self, scenario: Scenario, frequency: FloatArray, size: FloatArray) -> list[ErrorEstimate]:
        """Errors of G by mesh and ends: for other tissues those where waves were as long (:func:`.carried`).

        ``size`` (n,) is that of the values at ``frequency``.
        """
        mesh = [e for e in self.errors if e.source not in _OF_SPACE]
        if scenario.tissues == self.scenario.tissues:
            return mesh
        most, least = shortening(resolve_tissues(self.scenario), resolve_tissues(scenario), frequency)
        return [carried(e, frequency, least if e.source == "truncation" else most, size) for e in mesh]

    def _certified(self, scenario: Scenario) -> AffineReduced:
        """The model on the directions that were certified for what was solved."""
        return self.reduced.part(slice(self.core or None)).at(scenario)

    def _compared(self, found: Compliance, scenario: Scenario) -> tuple[Compliance, Compliance]:
        """Some rows of ``found``, and the same by the certified directions alone."""
        rows = probes(len(found.frequency))
        some = replace(found, frequency=found.frequency[rows], values=found.values[rows], errors=())
        narrow = self._certified(scenario).compliance(some.frequency)
        return some, replace(some, values=masked(narrow, self.ports))

    def transfer(self, frequency: FloatArray, scenario: Scenario | None = None) -> TransferMatrix:
        """G at ``frequency`` (n,) [Hz], increasing, of the scenario solved or another; otherwise as :meth:`compliance`.

        Its errors are estimated of G itself.
        """
        scenario = scenario or self.scenario
        found = self.compliance(scenario, frequency)
        g = close_loop(found, scenario.device)
        space = [e for e in g.errors if e.source in _OF_SPACE]
        if scenario.tissues != self.scenario.tissues and all(e.known for e in space):
            some, narrow = (close_loop(c, scenario.device) for c in self._compared(found, scenario))
            error = space_error(some.frequency, some.values, narrow.values)
            space = [*(e for e in space if e.source != "reduction"), error]
        mesh = self._of_mesh(scenario, frequency, np.linalg.norm(g.values, axis=(1, 2)))
        return replace(g, errors=(*mesh, *space))


def load_skin_model(path: str | Path) -> SkinModel:
    """Read ``reduced.nc``; DataError for a missing or damaged file."""
    return load(path, SkinModel)


def unfollowed(before: Scenario, after: Scenario, terms: Sequence[str], *, unread: Collection[str] = ()) -> str:
    """Reason that a reduced model of ``terms``, made for one scenario, cannot answer for the other; empty where it
    can. Keys that are ``unread`` by the caller may differ, too.
    """
    for key in type(before).model_fields:
        if key not in _MAY_CHANGE and key not in unread and getattr(before, key) != getattr(after, key):
            return f"{key}: the reduced model holds for the old value only; solve the scenario anew"
    if _places(before) != _places(after):
        return "device: contacts and cones are part of the reduced model; solve the scenario anew"
    if before.device.actuator != after.device.actuator:  # a preset fills in keys left out; in a run none is left
        return (
            "device.actuator: the run has settled all keys that a preset sets; change these themselves, or solve the "
            "scenario anew"
        )
    old, new = resolve_tissues(before), resolve_tissues(after)
    for name, tissue in old.items():
        if name in new and new[name].bulk != tissue.bulk:
            return f"tissues.override.{name}: {_NOT_AFFINE}"
        if name in new and new[name].fibres != tissue.fibres:
            return f"tissues.override.{name}.fibres: the reduced model holds for the old ratio only; solve it anew"
    if missing := [name for name, value in _sheets(after).items() if value and name not in terms]:
        key = "patch" if missing[0].startswith("patch") else "membrane"
        return f"tissues.{key}: the reduced model has no {missing[0]}; solve the scenario anew"
    patch, other = before.tissues.patch, after.tissues.patch
    if other.is_on and (patch.length, patch.width) != (other.length, other.width):
        return "tissues.patch: its size is part of the reduced model; solve the scenario anew"
    return ""


def _sheets(scenario: Scenario) -> dict[str, float]:
    """Sheets on the skin, by the name of their term."""
    sheet, patch = scenario.tissues.membrane, scenario.tissues.patch
    return {
        "skin mass": sheet.mass,
        "skin tension": sheet.tension,
        "skin membrane": sheet.stiffness + sheet.viscosity,
        "patch mass": patch.mass,
        "patch membrane": patch.stiffness + patch.viscosity,
        "patch bending": patch.bending,
    }


def _places(scenario: Scenario) -> tuple[object, ...]:
    device = scenario.device
    return device.centres, device.rotation, device.cone.radius, device.cone.contact
