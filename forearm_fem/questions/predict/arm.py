"""Models of arms: what answers a draw with the compliance between its ports."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from ...engines.arm_meshes import ArmMeshes, arm_meshes
from ...engines.layered import (
    ALONE,
    Answer,
    LayeredArm,
    fibrous,
    flat_disc,
    flat_ports,
    without_bones,
)
from ...engines.parametric import ParametricModel, parametric_model, reciprocal
from ...errors import ForearmError, ScenarioError
from ...fem.reduction.rational import chebyshev_frequencies, rational
from ...geometry.limb.thickness import stretches
from ...metrics import smooth_noise
from ...progress import Progress, within
from ...scenario import Scenario
from ...transfer import Compliance, ErrorEstimate
from ...typing import ComplexArray, FloatArray
from ...usercode import is_code
from .draws import FASCIA, has_fascia

_OF_CHANGE = (1e-2, 3)  # tolerance and terms for what geometry changes: 5e-5 of it apart, in two thirds of the time
_FAR, _SCATTERED = 0.5, 0.06  # nearness up to which one order is taken, and what it leaves out
_ASKED = 33  # frequencies asked of the layered model for changes by geometry: polynomials through 49 leave .02 of it
_FITTED = 1e-4  # of the largest entry: what a rational function of it may miss at those that it does not pass through
_BETWEEN = 2  # times as much it may miss elsewhere: at single frequencies twice this was seen, over the band half
_OTHERS = 6  # answers as wrong as geometry may make one
_SMOOTH = 50.0  # Hz over which what geometry misses is alike, as for other errors of S (decision 0027)
_MISSED = 0.5  # of the change by geometry that the layered model may be wrong by
_TAPED = 2.0  # the same of a contact's radius beside tape: 1.9 of it was seen at 500 Hz, .1 to .4 at 180


@dataclass(frozen=True)
class ReducedArm:
    """The scene's own finite elements for any tissue and tension (:mod:`forearm_fem.engines.parametric`).

    Layers of other thicknesses stretch with the mesh, and its skin can be read anywhere: a draw's grid is read where it
    lies, if that is within millimetres of the scene's. What the contact radius changes, or thicknesses and a grid
    beyond what the model was made for, is the difference of two answers of the layered model for the draw's tissues,
    and stated to be wrong by up to half of itself. ``meshes`` tell what the elements err by
    for each draw; where there are none, ``without`` says why.
    """

    scenario: Scenario
    model: ParametricModel
    layered: LayeredArm
    meshes: ArmMeshes | None = None
    without: str = ""

    @property
    def name(self) -> str:
        """See :class:`.Engine`."""
        return "parametric finite elements, geometry by the layered model"

    def holds(self, scenario: Scenario) -> str:
        """See :class:`.Engine`: what the reduced terms can follow, on the mesh of its scene."""
        return self.model.holds(with_scene_geometry(self.scenario, scenario))

    @property
    def held(self) -> frozenset[str]:
        """See :class:`LayeredArm`: no fascia that the scene has not."""
        return frozenset(() if has_fascia(self.scenario) else (FASCIA,))

    @property
    def left_out(self) -> str:
        """See :class:`LayeredArm`."""
        still = self.model.around is None
        kinds = [] if self.model.thickness else ["thickness"]
        kinds += ["contact area", *(["the grid's place"] if still else [])]
        by_layers = " and ".join([", ".join(kinds[:-1]), kinds[-1]] if kinds[1:] else kinds)
        bare = "no arm has a deep fascia, for the scene has none (limb.layers); " if self.held else ""
        return (
            "girth, taper, bones and the device's place on the limb are the scene's own in every arm; "
            f"{bare}what {by_layers} change is that of flat layers without end"
        )

    @property
    def unknown(self) -> str:
        """See :class:`LayeredArm`: the mesh's error where there is no second mesh."""
        return f"what the mesh errs by for each arm is unknown ({self.without})" if self.meshes is None else ""

    def compliance(self, scenario: Scenario, frequency: FloatArray) -> Compliance:
        """See :class:`.Engine`; the mesh's and the geometry's share of the error are estimates of their own."""
        return self.answer(scenario, frequency).compliance

    def answer(self, scenario: Scenario, frequency: FloatArray) -> Answer:
        """See :class:`LayeredArm`: each error may be missed by its size at each pair of ports, alike at all of them or
        in any phase at each."""
        return self.answers(scenario, scenario, frequency)[0]

    def answers(self, scenario: Scenario, seen: Scenario, frequency: FloatArray) -> tuple[Answer, Compliance]:
        """See :class:`LayeredArm`."""
        own, own_seen = self._own(scenario), self._own(seen)
        found, missed, met = self.model.answers(own, own_seen, frequency)
        off: list[ComplexArray | FloatArray] = [missed.of(found)]
        if self.meshes is not None:
            estimate, missed = self.meshes.missed(own, found)
            found = replace(found, errors=(*found.errors, estimate))
            off.append(missed.of(found))
        if own != scenario or own_seen != seen:
            if _is_contacts_alone(scenario, own) and _is_contacts_alone(seen, own_seen):
                change, error, of_seen = self._change_beside_tape(scenario, own, found, met)
            else:
                change, error, of_seen = self._change((scenario, own), (seen, own_seen), found.frequency)
            met = replace(met, values=met.values + of_seen)
            if own != scenario:
                found = self._changed(found, change, error, scenario, own)
                off += [_missed(scenario, own) * change, error]
        return Answer(found, perturbed_answers(found, off), frozenset(e.source for e in found.errors)), met

    def _own(self, scenario: Scenario) -> Scenario:
        """The draw with the scene's geometry, but with its own layers and grid where all meshes can follow them."""
        own = with_scene_geometry(self.scenario, scenario)
        models = [self.model] if self.meshes is None else [self.model, self.meshes.second]
        if all(m.stretches(scenario) for m in models):
            own = own.changed({"limb": scenario.limb})
        for direction in (scenario.grid.direction, own.grid.direction):  # else the layered model turns it
            laid = own.changed({"grid": scenario.grid.changed({"direction": direction})})
            if all(m.follows(laid) for m in models):
                return laid
        return own

    def _changed(
        self, found: Compliance, change: ComplexArray, error: FloatArray, scenario: Scenario, own: Scenario
    ) -> Compliance:
        """The answer with the ``change`` that geometry makes of ``own``, which may be wrong by a share of itself and by
        the layered model's ``error`` (both (n, n_port, n_port) [m/N])."""
        frequency = found.frequency
        block = np.ix_(range(len(frequency)), found.indices("point"), found.indices("contact"))
        size, whole = np.abs(found.values[block]).max(axis=(1, 2)), np.linalg.norm(found.values[block])
        share = _missed(scenario, own)
        missed = (share * np.abs(change[block]).max(axis=(1, 2)) + error[block].max(axis=(1, 2))) / size
        band = (share * np.linalg.norm(change[block]) + np.linalg.norm(error[block])) / whole
        kinds = {
            "thickness": own.limb != scenario.limb, "contact area": own.device.cone != scenario.device.cone,
            "place of the grid": own.grid != scenario.grid,
        }  # fmt: skip
        differs = " and ".join(kind for kind, other in kinds.items() if other)
        estimate = ErrorEstimate(
            "interpolation", float(band),
            f"{share:g} of what the draw's {differs} changes on the layered model, and its errors",
            tuple(frequency.tolist()), tuple(missed.tolist()),
        )  # fmt: skip
        return replace(found, values=found.values + change, errors=(*found.errors, estimate))

    def _change(
        self, draw: tuple[Scenario, Scenario], seen: tuple[Scenario, Scenario], frequency: FloatArray
    ) -> tuple[ComplexArray, FloatArray, ComplexArray]:
        """Change of the layered model by the geometry of a ``draw`` against its own one, its errors, and the change
        with the grid as ``seen``, all (n, n_port, n_port) [m/N].

        The layered model states errors over the largest entry of their kind: of contacts, or of points under contacts.
        Where discs are far apart, one azimuthal order says what changes to some hundredths of it, which are stated.
        """
        far = 0 < max(_nearness(s) for s in (*draw, *seen)) <= _FAR
        layered = replace(self.layered, orders=ALONE) if far else self.layered
        few = len(frequency) <= _ASKED
        nodes = frequency if few else chebyshev_frequencies(frequency, _ASKED)
        pairs = [layered.answers(own, met, nodes) for own, met in zip(draw, seen, strict=True)]
        answers, contact = [a.compliance for a, _ in pairs], [p.kind == "contact" for p in pairs[0][1].ports]
        # a point on itself stays unknown in the sum
        values, met = ([np.nan_to_num(c.values) for c in some] for some in (answers, [c for _, c in pairs]))
        change, of_seen = (x[0] - x[1] for x in (values, met))
        at_nodes, between = change, change
        points, contacts = answers[0].indices("point"), answers[0].indices("contact")
        if not few:
            fit = reciprocal(nodes, change, contact, _FITTED)
            at_nodes, between = fit(nodes), fit(frequency)
            of_seen = between if seen == draw else reciprocal(nodes, of_seen, contact, _FITTED)(frequency)
        error = np.zeros(between.shape)
        for pair in ((points, contacts), (contacts, points), (contacts, contacts)):
            kind: Any = (slice(None), *np.ix_(*pair))
            sizes = [np.abs(v[kind]).max(axis=(1, 2)) for v in values]
            off = sum(size * np.array(a.errors[0].per_frequency) for size, a in zip(sizes, answers, strict=True))
            left, largest = (np.abs(v[kind]).max(axis=(1, 2)) for v in (at_nodes - change, change))
            left = np.divide(left, largest, out=np.zeros_like(left), where=largest > 0)
            size = np.abs(between[kind]).max(axis=(1, 2))
            share = _BETWEEN * left.max() + (_SCATTERED if far else 0.0)
            error[kind] = (np.interp(frequency, nodes, off) + share * size)[:, None, None]
        return between, error, of_seen

    def _change_beside_tape(
        self, draw: Scenario, own: Scenario, found: Compliance, met: Compliance
    ) -> tuple[ComplexArray, FloatArray, ComplexArray]:
        """The same where contacts alone differ, on the taped arm that answered ``found``, and ``met`` with the grid as
        seen. What points do under a contact changes by the factor that it has without tape, what contacts do by as much
        as without.

        With tape the layered model takes ten times as long.
        """
        draw, own = (s.changed({"tissues.patch": None}) for s in (draw, own))
        frequency, points, contacts = found.frequency, found.indices("point"), found.indices("contact")
        change, error, _ = self._change((draw, own), (draw, own), frequency)
        at = np.unique(np.linspace(0, len(frequency) - 1, _ASKED).round().astype(int))
        base = self.layered.compliance(own, frequency[at]).block("point", "contact")
        under: Any = (slice(None), *np.ix_(points, contacts))
        shares = (base.conj() * change[under][at]).sum(axis=1) / (np.abs(base) ** 2).sum(axis=1)
        if len(at) < len(frequency):
            shares = rational(frequency[at], shares, _FITTED).at(frequency)
        changes = [np.array(change), np.array(change)]
        for whole, answer in zip(changes, (found, met), strict=True):
            for pair, by in (((points, contacts), shares[:, None]), ((contacts, points), shares[:, :, None])):
                kind: Any = (slice(None), *np.ix_(*pair))
                whole[kind] = answer.values[kind] * by
        return changes[0], error, changes[1]


ArmModel = LayeredArm | ReducedArm  # engines for draws of an arm; a draw is a scenario (:func:`.draws.scenario_of`)


def _is_contacts_alone(draw: Scenario, own: Scenario) -> bool:
    """True if there is tape and the geometry of a draw differs from its ``own`` one by contacts alone."""
    return draw.tissues.patch.is_on and (draw.limb, draw.grid) == (own.limb, own.grid)


def _missed(draw: Scenario, own: Scenario) -> float:
    """Share of the change from its ``own`` geometry to that of a draw that the layered model may be wrong by."""
    return _TAPED if _is_contacts_alone(draw, own) else _MISSED


def _nearness(scenario: Scenario) -> float:
    """Largest ratio of a rigid disc's radius to its distance from another disc or point, 0 without any."""
    discs = [flat_disc(port) for port in flat_ports(without_bones(scenario))]
    apart = [(a.radius, math.hypot(a.x - b.x, a.y - b.y)) for a in discs if a.rigid for b in discs if a is not b]
    return max((radius / distance if distance > 0 else math.inf for radius, distance in apart), default=0.0)


def perturbed_answers(found: Compliance, off: Sequence[ComplexArray | FloatArray]) -> tuple[Compliance, ...]:
    """Answers as wrong as each error of ``off`` (n, n_port, n_port) [m/N] may make them, in any phase: every other one
    alike at all pairs of ports, as where the same waves decay too much everywhere, the rest at each pair by chance.

    What the same share of all pairs does to S does not average out over pairs.
    """
    size = np.abs(found.values)
    phase = np.divide(found.values, size, out=np.ones_like(found.values), where=size > 0)
    shapes = [each if np.iscomplexobj(each) else each * phase for each in off]
    parts = _parts(tuple(found.frequency.tolist()), len(found.ports), len(shapes))
    moved = [sum(each * part for each, part in zip(shapes, of_each, strict=True)) for of_each in parts]
    return tuple(replace(found, values=found.values + m, errors=()) for m in moved)


@lru_cache(maxsize=1)  # draws of a scene have the same frequencies and ports
def _parts(frequency: tuple[float, ...], ports: int, errors: int) -> tuple[tuple[ComplexArray, ...], ...]:
    """Shares (n, n_port, n_port) of so many ``errors``, 1 at most, that each of the other answers is off by: smooth,
    reciprocal, and alike at all pairs of ports in every other one. In single precision: they are random."""
    rng, found = np.random.default_rng(0), list[tuple[ComplexArray, ...]]()
    for n in (1 if k % 2 == 0 else ports for k in range(_OTHERS)):
        parts = list[ComplexArray]()
        for _ in range(errors):
            noise = smooth_noise(np.array(frequency), (n, n), rng, _SMOOTH)
            noise = noise + noise.swapaxes(1, 2)
            parts.append((noise / np.abs(noise).max(axis=(1, 2), keepdims=True)).astype(np.complex64))
        found.append(tuple(parts))
    return tuple(found)


def with_scene_geometry(scene: Scenario, draw: Scenario) -> Scenario:
    """The ``draw`` with the geometry that the mesh of the ``scene`` has."""
    return draw.changed({"limb": scene.limb, "grid": scene.grid, "device.cone.radius": scene.device.cone.radius})


def arm_model(
    scenario: Scenario,
    *,
    base: str | Path = ".",
    draws: Sequence[Scenario] = (),
    layered: bool = False,
    progress: Progress | None = None,
) -> ArmModel:
    """The model that answers draws of ``scenario``, whose user files lie in ``base``.

    Finite elements for a scene of finite elements, made from ``draws`` like those that will be asked and kept in the
    cache; the layered model for the others, and where ``layered`` asks for it. Raises what solving the scenario raises.
    """
    if is_code(scenario.engine) and not layered:
        raise ScenarioError(
            "engine: arms are drawn on finite elements or on the layered model, not on an engine of your own; set "
            "engine = 'layered'"
        )
    if reason := fibrous(scenario):
        raise ScenarioError(
            f"{reason.partition(':')[0]}: arms are drawn without fibres on either engine, as no prior says how they "
            "differ; leave it out"
        )
    if scenario.engine == "layered" or layered:
        return LayeredArm(scenario.engine == "fem")
    known = [
        own if stretches(scenario.limb, d.limb) is None else own.changed({"limb": d.limb})
        for d in draws for own in [with_scene_geometry(scenario, d)]
    ]  # fmt: skip
    model = parametric_model(scenario, base=base, draws=known or None, progress=progress)
    known = known if model.thickness else [with_scene_geometry(scenario, d) for d in known]
    try:
        meshes, without = arm_meshes(scenario, base, known or None, within(progress, "coarser mesh")), ""
    except ForearmError as problem:
        meshes, without = None, str(problem)
    return ReducedArm(scenario, model, LayeredArm(True, *_OF_CHANGE), meshes, without)
