"""The saved reduced model: compliance and G at any frequency, also for other tissues, without mesh or solver."""

from __future__ import annotations

import warnings
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from ..accuracy.other_tissues import carried, probes, shortening, space_error
from ..device import close_loop
from ..errors import AccuracyWarning, DataError, ReductionError, ScenarioError
from ..fem.assembly.coefficients import Coefficient, term_coefficient
from ..fem.reduction.basis import Basis
from ..fem.reduction.poles import PoleResidue, pole_residue
from ..fem.reduction.reduced_model import ReducedModel
from ..geometry.limb.thickness import stretches
from ..ports import Port
from ..scenario import Scenario, parse_scenario
from ..scenario.limb import Limb
from ..scenario.load import read_overrides
from ..scenario.sweep import frequencies
from ..store.record import dims, load, save
from ..tissue import resolve_tissues
from ..transfer import Compliance, ErrorEstimate, TransferMatrix
from ..typing import ComplexArray, FloatArray
from .fem import masked

__all__ = ["SkinModel", "check_followable", "load_skin_model", "save_skin_model", "with_scenario"]

_MAY_CHANGE = {"tissues", "device", "name", "description"}
_BEYOND = 1.05  # ratio to the ends of the band up to which a model with unstable poles is trusted
_OF_SPACE = ("reduction", "linear solve")  # sources of errors of a compliance; mesh and ends are told of G
_BEYOND_BAND = "not estimated: frequencies lie outside the band that was solved; solve a wider one"
_NOT_AFFINE = "the bulk modulus is not a parameter of the reduced model; solve the scenario anew"


@dataclass(frozen=True)
class SkinModel:
    """A limb seen through its ports: ``reduced`` matrices with the coefficients of ``scenario``.

    ``core`` is how many of its directions, the first, were certified for the scenario that was ``solved``; the others
    serve other moduli (:func:`.widened`), 0 where there are none. ``poles`` are what the sweep found for its
    coefficients; without them each evaluation finds its own. ``errors`` are those of the solved compliance, then those
    of its G by mesh and ends. ``solved`` is None where the scenario is the solved one.
    """

    scenario: Scenario
    ports: tuple[Port, ...]
    reduced: ReducedModel
    poles: PoleResidue | None = None
    core: int = 0
    errors: tuple[ErrorEstimate, ...] = ()
    solved: Scenario | None = None

    def compliance(self, frequency: FloatArray) -> Compliance:
        """Compliance of all ports at ``frequency`` (n,) [Hz] with its error; NaN for a point force under itself.

        Frequencies more than 5 % beyond the band are answered with an AccuracyWarning, and the error is unknown. Raises
        ReductionError for them where the model has unstable poles, as it may for incompressible tissue; DataError for
        none, or what is no frequency.
        """
        if frequency.ndim != 1 or not len(frequency) or not np.all(np.isfinite(frequency) & (frequency >= 0)):
            raise DataError("frequency: expected a row of one or more, finite and not negative [Hz]; correct it")
        band = frequencies(self.scenario.sweep)
        beyond = frequency[(frequency < band.min() / _BEYOND) | (frequency > band.max() * _BEYOND)]
        if len(beyond) and (count := self.reduced.negative_directions()):
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
        used = self._certified if self.solved is None else self.reduced
        values = masked((self.poles or pole_residue(used, frequency) or used).compliance(frequency), self.ports)
        found = Compliance(frequency.copy(), values, self.ports, tuple(e for e in self.errors if e.source in _OF_SPACE))
        if len(beyond):
            return replace(found, errors=(ErrorEstimate("reduction", np.nan, _BEYOND_BAND),))
        if self.solved is None:
            return found
        some, narrow = self._compared(found)
        error = space_error(some.frequency, *(c.block("point", "contact") for c in (some, narrow)))
        solves = (e for e in found.errors if e.source != "reduction")
        return replace(found, errors=(*solves, replace(error, per_pair=None)))

    @property
    def _certified(self) -> ReducedModel:
        """The model on the directions that were certified for what was solved."""
        own, k = self.reduced, self.core or self.reduced.size
        return replace(own, matrices=own.matrices[:, :k, :k], functionals=own.functionals[:k])

    def _compared(self, found: Compliance) -> tuple[Compliance, Compliance]:
        """Some rows of ``found``, and the same by the certified directions alone."""
        rows = probes(len(found.frequency))
        some = replace(found, frequency=found.frequency[rows], values=found.values[rows], errors=())
        return some, replace(some, values=masked(self._certified.compliance(some.frequency), self.ports))

    def transfer(self, frequency: FloatArray) -> TransferMatrix:
        """G of the scenario's device at ``frequency`` (n,) [Hz], increasing; otherwise as :meth:`compliance`.

        For other tissues errors by mesh and ends are taken where waves were as long (:func:`.carried`).
        """
        found = self.compliance(frequency)
        g, mesh = close_loop(found, self.scenario.device), [e for e in self.errors if e.source not in _OF_SPACE]
        if self.solved is None or any(not e.known for e in g.errors):
            return replace(g, errors=(*mesh, *g.errors))
        some, narrow = (close_loop(c, self.scenario.device) for c in self._compared(found))
        space = space_error(some.frequency, some.values, narrow.values)
        most, least = shortening(resolve_tissues(self.solved), resolve_tissues(self.scenario), frequency)
        size = np.linalg.norm(g.values, axis=(1, 2))
        mesh = [carried(e, frequency, least if e.source == "truncation" else most, size) for e in mesh]
        return replace(g, errors=(*mesh, *(e for e in g.errors if e.source != "reduction"), space))

    def changed(self, overrides: Sequence[str]) -> SkinModel:
        """The model for ``key.path=value`` overrides of tissues (not their bulk moduli) and device (not its places).

        Raises ScenarioError for a key that the reduced model cannot follow, and where it holds nothing to tell the
        error of other tissues by.
        """
        before = self.scenario.model_dump(mode="json")
        after = parse_scenario(before, changes=read_overrides(overrides))
        check_followable(self.scenario, after, self.reduced.names)
        old = self.solved or self.scenario
        if old.tissues == after.tissues:
            poles = self.poles if before == after.model_dump(mode="json") else None
            return replace(self, scenario=after, reduced=with_scenario(self.reduced, after), poles=poles, solved=None)
        if not self.core:
            raise ScenarioError(
                "tissues: this reduced model tells no error for other tissues; solve the scenario anew, which is then "
                "kept with what other tissues ask for"
            )
        return replace(self, scenario=after, reduced=with_scenario(self.reduced, after), poles=None, solved=old)


def with_scenario(reduced: ReducedModel, scenario: Scenario, limb: Limb | None = None) -> ReducedModel:
    """The reduced matrices with the coefficients that ``scenario`` gives their terms (:func:`coefficients_of`)."""
    return replace(reduced, coefficients=coefficients_of(reduced.names, scenario, limb))


def coefficients_of(names: Sequence[str], scenario: Scenario, limb: Limb | None = None) -> tuple[Coefficient, ...]:
    """Coefficients of the terms ``names`` in ``scenario``, whose layers may be of other thicknesses than the ``limb``
    that the terms are of."""
    tissues, sheets = resolve_tissues(scenario), scenario.tissues
    found = (stretches(limb, scenario.limb) if limb is not None else None) or {}
    return tuple(term_coefficient(n, tissues, scenario.supports, sheets.membrane, sheets.patch, found) for n in names)


@dataclass(frozen=True, eq=False)
class ReducedFile:
    """``reduced.nc``: the reduced model, a few megabytes that give the compliance at any frequency, for any moduli.

    ``matrices`` (n_term, r, r) of terms ``names``, real and symmetric, ``functionals`` (r, n_port) and ``shares``
    (n_port,) as in :class:`forearm_fem.fem.reduction.reduced_model.ReducedModel`, and the poles and residues of
    :class:`forearm_fem.fem.reduction.poles.PoleResidue` where there are any. The scenario multiplies the terms.
    ``core`` and ``errors`` are as in :class:`SkinModel`.
    """

    kind: ClassVar[str] = "reduced model"
    version: ClassVar[int] = 2

    names: tuple[str, ...] = field(metadata=dims("term", name="term"))
    matrices: FloatArray = field(metadata=dims("term entry", name="upper", upper=True))
    functionals: FloatArray = field(metadata=dims("row port", name="functional"))
    shares: FloatArray = field(metadata=dims("port", name="share"))
    ports: tuple[Port, ...] = field(metadata=dims("port"))
    scenario: dict[str, Any]
    poles: ComplexArray | None = field(default=None, metadata=dims("mode"))
    left: ComplexArray | None = field(default=None, metadata=dims("port mode"))
    right: ComplexArray | None = field(default=None, metadata=dims("mode port"))
    core: int = 0
    errors: tuple[ErrorEstimate, ...] = ()

    @classmethod
    def of(cls, model: SkinModel) -> ReducedFile:
        """The file of a model."""
        r, seen = model.reduced, model.poles
        poles = {} if seen is None else {name: getattr(seen, name) for name in ("poles", "left", "right")}
        scenario = model.scenario.model_dump(mode="json")
        kept = (r.names, r.matrices, r.functionals, r.shares, model.ports, scenario)
        return cls(*kept, **poles, core=model.core, errors=model.errors)

    def model(self, origin: str | Path) -> SkinModel:
        """The model of a file; ScenarioError for a scenario that is not known, which ``origin`` holds."""
        scenario = parse_scenario(self.scenario, origin=str(origin))
        low = np.zeros((len(self.functionals), 0))
        bare = ReducedModel(self.names, (), self.matrices, self.functionals, self.shares, Basis(), low)
        poles = None
        if self.poles is not None and self.left is not None and self.right is not None:
            poles = PoleResidue(self.poles, self.left, self.right, shares=self.shares)
        return SkinModel(scenario, self.ports, with_scenario(bare, scenario), poles, self.core, self.errors)


def save_skin_model(path: Path, model: SkinModel) -> None:
    """Write ``reduced.nc``, whole or not at all."""
    save(path, ReducedFile.of(model))


def load_skin_model(path: str | Path) -> SkinModel:
    """Read ``reduced.nc``; DataError for a missing or damaged file."""
    return load(path, ReducedFile).model(path)


def check_followable(before: Scenario, after: Scenario, terms: Sequence[str], *, unread: Collection[str] = ()) -> None:
    """Raise ScenarioError with the sentence of :func:`unfollowed`."""
    if reason := unfollowed(before, after, terms, unread=unread):
        raise ScenarioError(reason)


def unfollowed(before: Scenario, after: Scenario, terms: Sequence[str], *, unread: Collection[str] = ()) -> str:
    """Reason that a reduced model of ``terms``, made for one scenario, cannot answer for the other; empty where it
    can.

    Keys that are ``unread`` by the caller may differ, too.
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
