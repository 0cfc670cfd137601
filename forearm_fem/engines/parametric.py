"""One reduced model for many arms: other moduli, laws, tension and tape without a mesh, each with its own error."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import astuple, dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from .. import __version__
from ..accuracy.estimates import PairErrors, raised_to_row_column_mean
from ..errors import GeometryError, ReductionError, ScenarioError
from ..fem.assembly.model import readings
from ..fem.assembly.thickness import follows_thickness, motion_of
from ..fem.kernels.compiled import freed_memory_kept
from ..fem.reduction.affine import AffineReduced, coefficients_of
from ..fem.reduction.parametric_greedy import Growth, Piece, TrialSolve, piece_at, united_model
from ..fem.reduction.per_query_basis import FIRST, Summed, spanned
from ..fem.reduction.rational import chebyshev_frequencies, rational
from ..geometry.build import cached_mesh
from ..geometry.device.place import GridPlaces, grid_places
from ..geometry.limb.thickness import stretched, stretches
from ..geometry.mesh.tissue_mesh import TissueMesh
from ..ports import Port
from ..progress import Progress, tell
from ..scenario import Scenario, parse_scenario
from ..scenario.model import resolve_tissues
from ..scenario.sweep import frequencies
from ..store.folder import default_cache_dir
from ..store.record import dims
from ..store.shelf import Shelf
from ..store.text import digest_of
from ..tissue import law as law_class
from ..transfer import Compliance, ErrorEstimate, masked
from ..typing import BoolArray, ComplexArray, FloatArray
from .fem import fem_model, solve_key
from .skin_model import BEYOND, unfollowed

_MODEL = "model"  # the key of the finished one
_NODES = 33  # frequencies of a piece that a draw's rational function is made from; up to so many are solved as asked
_SPANNED = 1e-3  # of the largest entry of points under contacts: what the span of a draw's solutions may err by there
_BETWEEN = 2e-4  # of the largest entry: what a rational function may miss at the nodes that it does not pass through
_ROUGHER = 2  # degrees of the polynomials that a moved grid is read by: what one less changes may cancel by chance
_POOL = 48  # draws that a model is made from
_TYPICAL = 100.0  # Hz at which springpots are as stiff as the scenario's tissue
_MIDDLE = 0.5
_ROOM = 0.25  # of the memory limit that terms of other thicknesses may take; where they would more, layers stay
_ENTRY = 180.0  # bytes of an entry in all of them: six times a value, its place, and both triangles for products
_OF_THICKNESS = Growth(solves=12, checks=4, states=80)  # effort where arms differ in thickness, too


@dataclass(frozen=True)
class Ranges:
    """Ranges of arms around a scenario: uniform in the logarithm, tension uniform.

    ``moduli`` multiplies or divides mu and eta of each soft tissue (a springpot's size at 100 Hz); ``tension`` [N/m];
    ``laws`` in turn, whose classes say what is near to the scenario's; ``thickness`` multiplies or divides that of each
    layer.
    """

    moduli: float = 2.0
    tension: tuple[float, float] = (0.0, 92.0)
    laws: tuple[str, ...] = ("kelvin-voigt", "zener", "springpot")
    thickness: float = 1.0

    def draws(self, scenario: Scenario, count: int, *, seed: int = 0) -> tuple[Scenario, ...]:
        """``count`` arms by a Latin hypercube over all inputs."""
        from scipy.stats import qmc

        names = soft_tissues(scenario)
        layers = len(getattr(scenario.limb, "layers", ())) if self.thickness != 1 else 0
        places = qmc.LatinHypercube(3 * len(names) + 1 + layers, rng=seed).random(count)
        return tuple(self._draw(scenario, names, self.laws[i % len(self.laws)], p) for i, p in enumerate(places))

    def _draw(self, scenario: Scenario, names: Sequence[str], law: str, places: FloatArray) -> Scenario:
        tissues, data = resolve_tissues(scenario), scenario.model_dump(mode="json", exclude_none=True)
        last = 3 * len(names)
        for name, place in zip(names, places[:last].reshape(-1, 3), strict=True):
            own = data["tissues"]["override"].get(name, {})
            kept = {key: value for key, value in own.items() if key in ("density", "bulk", "fibres")}
            stiff, viscous = self.moduli ** (2 * place[:2] - 1)
            near = law_class(law).near(tissues[name].modulus, 2 * np.pi * _TYPICAL, stiff, viscous, place[2])
            data["tissues"]["override"][name] = {**kept, **near.stated(law)}
        data["tissues"]["membrane"]["tension"] = float(np.interp(places[last], [0, 1], self.tension))
        for layer, place in zip(data["limb"].get("layers", ()), places[last + 1 :], strict=False):
            layer["thickness"] *= self.thickness ** (2 * place - 1)
        return parse_scenario(data)


def soft_tissues(scenario: Scenario) -> tuple[str, ...]:
    """The limb's tissues but bone, from the skin inwards."""
    return tuple(dict.fromkeys(t for t in scenario.tissue_keys.values() if t != "bone"))


@dataclass(frozen=True, eq=False)
class ParametricModel:
    """A limb seen through its ports for any tissue, tension and tape near those it was made from.

    ``pieces`` are the reduced models of the parts of the band. ``checks`` are comparisons with direct solves that had
    no part in making them; ``factor`` is what their estimates were too small by. ``around`` are the places where points
    of the grid can be read, None where they stay where they are. ``thickness`` [m] are the least and the largest of
    each layer that it was made for, then of all together; empty where layers stay as they are. It is
    kept in the cache as it stands here.
    """

    kind: ClassVar[str] = "parametric model"
    version: ClassVar[int] = 2

    scenario: Scenario
    ports: tuple[Port, ...] = field(metadata=dims("port"))
    pieces: tuple[Piece, ...]
    trials: tuple[TrialSolve, ...]
    checks: tuple[TrialSolve, ...]
    solves: int
    around: GridPlaces | None = None
    thickness: tuple[tuple[float, float], ...] = ()

    @property
    def name(self) -> str:
        """See :class:`.Engine`."""
        return "parametric"

    def holds(self, scenario: Scenario) -> str:
        """See :class:`.Engine`: scenarios that differ in what the model's terms can follow."""
        grid, limb = self.follows(scenario), self.stretches(scenario)
        unread = {key for key, may in (("grid", grid), ("limb", limb)) if may}
        return unfollowed(self.scenario, scenario, self.names, unread=unread)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the terms, such as "shear muscle" and "skin tension"."""
        return self.pieces[0].whole.names

    @property
    def factor(self) -> float:
        """Safety factor of estimates: the largest ratio of a true to an estimated error among the checks."""
        return max([1.0, *(c.true / c.estimated for c in self.checks if c.estimated > 0)])

    @property
    def coarser(self) -> ParametricModel:
        """The model without what a third of the solves gave it."""
        return replace(self, pieces=tuple(replace(p, whole=p.core) for p in self.pieces))

    def follows(self, scenario: Scenario) -> bool:
        """True if the grid of ``scenario`` can be read where it lies."""
        return self._reads_own(scenario) or (self.around is not None and self.around.hold(scenario))

    def _reads_own(self, scenario: Scenario) -> bool:
        """True if the grid of ``scenario`` is the model's own."""
        mine, its = self.scenario.grid, scenario.grid
        return its.direction == mine.direction and its.places == mine.places

    def stretches(self, scenario: Scenario) -> bool:
        """True if the layers of ``scenario`` are as thick as those of some arm that the model was made for, or as the
        scene's."""
        if scenario.limb == self.scenario.limb:
            return True
        if not self.thickness or stretches(self.scenario.limb, scenario.limb) is None:
            return False
        own = zip(_thicknesses(scenario), self.thickness, strict=True)
        return all(a / BEYOND <= t <= b * BEYOND for t, (a, b) in own)

    def compliance(self, scenario: Scenario, frequency: FloatArray) -> Compliance:
        """Compliance of all ports for a draw, with the error of the reduction stated for it.

        ``scenario`` may differ from the model's own in tissues (not their bulk moduli), in membrane and tape as far as
        the model has terms for them, in its layers' thicknesses (:meth:`stretches`), in where the grid lies by some
        millimetres (:meth:`follows`), in the device but for its contacts, and in what compliances do not follow from.
        Ports are named and placed as the model's own.
        Raises ScenarioError for anything else and ReductionError for frequencies more than 5 % beyond the band.
        """
        return self.answer(scenario, frequency)[0]

    def bare(self, scenario: Scenario, frequency: FloatArray) -> ComplexArray:
        """Values of :meth:`compliance` at tens of frequencies (n, n_port, n_port), without a statement of their error:
        for half of the time."""
        frequency = np.asarray(frequency, dtype=float)
        values = np.empty((len(frequency), len(self.ports), len(self.ports)), dtype=complex)
        for piece, mine in self._asked(scenario, frequency):
            values[mine] = Summed.of(self._drawn(piece, scenario)[0].whole).compliance(frequency[mine])
        return masked(values, self.ports)

    def _asked(self, scenario: Scenario, frequency: FloatArray) -> list[tuple[Piece, BoolArray]]:
        """Pieces of the band with the places (n,) of the frequencies that they answer; raises as :meth:`compliance`."""
        if reason := self.holds(scenario):
            raise ScenarioError(reason)
        band = frequencies(self.scenario.sweep)
        beyond = frequency[(frequency < band[0] / BEYOND) | (frequency > band[-1] * BEYOND)]
        if len(beyond):
            raise ReductionError(
                f"{beyond[0]:g} Hz is outside the band of this parametric model, {band[0]:g} to {band[-1]:g} Hz; make "
                "one for a wider band (sweep.f_min, sweep.f_max)"
            )
        places = [np.array([piece_at(self.pieces, f) is p for f in frequency], dtype=bool) for p in self.pieces]
        return [(piece, mine) for piece, mine in zip(self.pieces, places, strict=True) if mine.any()]

    def answer(self, scenario: Scenario, frequency: FloatArray) -> tuple[Compliance, PairErrors]:
        """The same with what it may miss at each pair of ports, which is smaller for points far from a contact."""
        return self.answers(scenario, scenario, frequency)[:2]

    def answers(
        self, scenario: Scenario, seen: Scenario, frequency: FloatArray
    ) -> tuple[Compliance, PairErrors, Compliance]:
        """The same, and the compliance of ``seen``, which is ``scenario`` but for its grid, by one solve."""
        if reason := self.holds(seen):
            raise ScenarioError(reason)
        frequency, moved = np.asarray(frequency, dtype=float), seen.grid != scenario.grid
        values, met = (np.empty((len(frequency), *(len(self.ports),) * 2), dtype=complex) for _ in range(2))
        found = list[_Answer]()
        for piece, mine in self._asked(scenario, frequency):
            drawn, rough = self._drawn(piece, scenario)
            points = self._read(piece.whole, seen) if moved else None
            found.append(self._answered(drawn, rough, points, frequency[mine]))
            values[mine], met[mine] = found[-1].values, found[-1].seen
        missed = self._missed(found)
        true, other = (Compliance(frequency, masked(v, self.ports), self.ports) for v in (values, met))
        return replace(true, errors=(self._error(found, missed),)), missed, other

    def _drawn(self, piece: Piece, scenario: Scenario) -> tuple[Piece, AffineReduced]:
        """The models of a ``piece`` with the draw's coefficients and with its points where its grid lies, and the whole
        one with points read by polynomials of two degrees less, which tells what these err by."""
        whole, core = (m.at(scenario, self.scenario.limb) for m in (piece.whole, piece.core))
        if self.around is not None and not self._reads_own(scenario):
            degree, above = self.around.count - 1, self.around.turned and scenario.grid.direction == "vertical"
            shares, rougher = (self.around.shares(scenario, d) for d in (degree, degree - _ROUGHER))
            rough = self._moved(whole, rougher, above)
            return replace(piece, whole=self._moved(whole, shares, above), core=self._moved(core, shares, above)), rough
        return replace(piece, whole=whole, core=core), whole

    @property
    def _points(self) -> list[int]:
        return [i for i, p in enumerate(self.ports) if p.kind == "point"]

    def _moved(self, reduced: AffineReduced, shares: FloatArray, above: bool) -> AffineReduced:
        """The model whose points read ``shares`` (n_point, k) of the k places around each, along the normals or from
        ``above``."""
        functionals = reduced.functionals.copy()
        places = reduced.places.reshape(reduced.size, -1, *shares.shape)[:, int(above)]
        functionals[:, self._points] = np.einsum("rpk,pk->rp", places, shares)
        return replace(reduced, functionals=functionals)

    def _read(self, reduced: AffineReduced, scenario: Scenario) -> FloatArray:
        """Functionals (r, n_point) of the points where the grid of ``scenario`` lies."""
        if self.around is None or self._reads_own(scenario):
            return reduced.functionals[:, self._points]
        above = self.around.turned and scenario.grid.direction == "vertical"
        shares = self.around.shares(scenario, self.around.count - 1)
        return self._moved(reduced, shares, above).functionals[:, self._points]

    def _answered(
        self, drawn: Piece, rough: AffineReduced, points: FloatArray | None, frequency: FloatArray
    ) -> _Answer:
        """Answer of a ``drawn`` piece at ``frequency`` (n,): values, interpolation error, and values of its core and
        of the model of ``rough`` points; with ``points`` (r, n_point), what would be seen there instead."""
        system, moved, n = Summed.of(drawn.whole), rough is not drawn.whole, len(self.ports)
        every = system if points is None else replace(system, reduced=_with_more(drawn.whole, points, self._points))
        if len(frequency) <= _NODES:
            values, between = every.compliance(frequency), np.zeros((n, n))
            some = np.unique(np.linspace(0, len(frequency) - 1, FIRST).round().astype(int))
            probes, whole = frequency[some], values[some, :n, :n]
            other = replace(system, reduced=rough).compliance(probes) if moved else whole
        else:
            known = spanned(system, frequency, _SPANNED, self._block, rough.functionals if moved else None)
            nodes, probes = chebyshev_frequencies(frequency, _NODES), known.solved[:FIRST]
            values, between = self._fitted(nodes, replace(known.span, system=every).compliance(nodes), frequency)
            between, whole = between[:n, :n] + known.missed, known.span.compliance(probes)
            other = known.beside * rough.shares if moved else whole
        met = np.arange(n)
        met[self._points] = np.arange(n, values.shape[1]) if points is not None else self._points
        seen = values[:, met[:, None], met]
        core = Summed.of(drawn.core).compliance(probes)
        return _Answer(values[:, :n, :n], between, probes, whole, core, other, seen)

    def _fitted(
        self, nodes: FloatArray, values: ComplexArray, frequency: FloatArray
    ) -> tuple[ComplexArray, FloatArray]:
        """Rational functions at ``frequency`` through ``values`` at the ``nodes`` (:func:`reciprocal`), and what they
        miss of these (n_port, n_port), in shares of the largest entry of points under contacts; further ports are
        points."""
        contact = [p.kind == "contact" for p in self.ports]
        contact += [False] * (values.shape[1] - len(contact))
        shares = self.pieces[0].whole.shares
        shares = np.append(shares, shares[self._points])[: len(contact)]
        shares = np.where(np.isfinite(shares), shares, 1.0)  # 1 where a force has no symmetric solution
        fit = reciprocal(nodes, values / shares, contact, _BETWEEN)
        sizes = np.abs(values[(slice(None), *self._block)]).max(axis=(1, 2))
        missed = np.triu((np.abs(fit(nodes) - values / shares) / sizes[:, None, None]).max(axis=0))
        return np.asarray(fit(frequency) * shares), missed + np.triu(missed, 1).T

    @property
    def _block(self) -> tuple[Any, ...]:
        """Places of points under contacts, of whichever kind there is else."""
        contacts = [i for i, p in enumerate(self.ports) if p.kind == "contact"]
        points = [i for i, p in enumerate(self.ports) if p.kind == "point"] or contacts
        return np.ix_(points, contacts or points)

    def _missed(self, found: Sequence[_Answer]) -> PairErrors:
        points, contacts = ([i for i, p in enumerate(self.ports) if p.kind == kind] for kind in ("point", "contact"))
        pairs = [(points, contacts), (contacts, points), (contacts, contacts)]
        blocks: list[tuple[Any, ...]] = [np.ix_(*pair) for pair in pairs if all(pair)]
        shares = []
        for answer in found:
            change = np.abs(np.nan_to_num(answer.whole - answer.core))
            change += np.abs(np.nan_to_num(answer.whole - answer.rough))
            for block in blocks:
                change[(slice(None), *block)] = raised_to_row_column_mean(change[(slice(None), *block)])
            size = np.array([np.abs(c[self._block]).max() for c in answer.whole])
            shares.append(self.factor * change / size[:, None, None] + answer.between)
        return PairErrors(np.concatenate([a.probes for a in found]), np.concatenate(shares))

    def _error(self, found: Sequence[_Answer], missed: PairErrors) -> ErrorEstimate:
        whole, core, rough = (
            np.array([c[self._block] for a in found for c in getattr(a, part)]) for part in ("whole", "core", "rough")
        )
        probes, error = missed.probes, np.array([shares[self._block].max() for shares in missed.shares])
        between = max(float(a.between[self._block].max()) for a in found)
        change = np.linalg.norm(whole - core) + np.linalg.norm(whole - rough)
        band = self.factor * change / np.linalg.norm(whole) + between
        worst = max(self.checks, key=lambda c: c.true, default=None)
        seen = f"; the checks' largest true error is {worst.true:.1e} at {worst.frequency:g} Hz" if worst else ""
        return ErrorEstimate(
            "reduction",
            float(band),
            f"change without a third of the solves at {len(probes)} frequencies, times {self.factor:.2g} as "
            f"{len(self.checks)} direct solves of other draws had it{seen}",
            tuple(probes.tolist()),
            tuple(error.tolist()),
        )


@dataclass(frozen=True, eq=False)
class _Answer:
    """Answer of a piece for one draw.

    ``values``: at the frequencies asked.
    ``between`` (n_port, n_port): interpolation error over the largest entry between nodes.
    ``whole``, ``core``, ``rough``: values at ``probes`` of the piece, its core and the model of rough points.
    ``seen``: as ``values``, of points elsewhere.
    """

    values: ComplexArray
    between: FloatArray
    probes: FloatArray
    whole: ComplexArray
    core: ComplexArray
    rough: ComplexArray
    seen: ComplexArray


def _with_more(reduced: AffineReduced, points: FloatArray, like: Sequence[int]) -> AffineReduced:
    """The model with ``points`` (r, n) as further ports, whose forces have the shares of the ports ``like`` them."""
    functionals, shares = np.hstack([reduced.functionals, points]), np.append(reduced.shares, reduced.shares[like])
    return replace(reduced, functionals=functionals, shares=shares)


def reciprocal(
    nodes: FloatArray, values: ComplexArray, contact: Sequence[bool], tolerance: float
) -> Callable[[FloatArray], ComplexArray]:
    """A rational function of frequency [Hz] through ``values`` (n_node, n_port, n_port) at ``nodes`` (n_node,) [Hz].

    It goes through the upper triangle, which keeps it reciprocal; entries of the ports that are a ``contact`` (n_port,)
    shape it.
    """
    rows, columns = np.triu_indices(len(contact))
    shaping = np.array(contact)[rows] | np.array(contact)[columns]
    order = np.argsort(~shaping, kind="stable")
    rows, columns = rows[order], columns[order]
    fit = rational(nodes, values[:, rows, columns], tolerance, int(shaping.sum()) or None)

    def at(frequency: FloatArray) -> ComplexArray:
        """Both triangles at ``frequency`` (n,) [Hz]."""
        out = np.empty((len(frequency), *values.shape[1:]), dtype=complex)
        out[:, rows, columns] = out[:, columns, rows] = fit.at(frequency)
        return out

    return at


def parametric_model(
    scenario: Scenario,
    *,
    base: str | Path = ".",
    ranges: Ranges | None = None,
    draws: Sequence[Scenario] | None = None,
    growth: Growth | None = None,
    mesh: TissueMesh | None = None,
    progress: Progress | None = None,
) -> ParametricModel:
    """The model for ``draws`` of ``scenario``, or for 48 within ``ranges`` of it; kept in the cache.

    ``base`` is the folder that user files refer to, ``mesh`` another one than the scenario's own. Draws, and what will
    be asked, may differ as :meth:`ParametricModel.compliance` says; give those that will be asked, or some like them.
    Layers stay as thick as the scene's where following them would take a quarter of ``solver.memory_limit``.
    What an interrupted call has finished is not made again. Raises what a run of the scenario raises, and ScenarioError
    for the layered engine, which needs no such model.
    """
    if scenario.engine == "layered":
        raise ScenarioError(
            "engine: a parametric model needs engine = 'fem'; the layered model solves each draw itself"
        )
    given = tuple(draws) if draws is not None else (ranges or Ranges()).draws(scenario, _POOL)
    if not given:
        raise ScenarioError("a parametric model needs at least one draw to be made from; give some, or ranges")
    own = _with_all_sheets(scenario, given)
    tell(progress, "mesh", 0, 0)
    mesh, band = mesh or cached_mesh(own, base=Path(base), progress=progress), frequencies(own.sweep)
    if _terms_bytes(own, mesh) > _ROOM * own.solver.memory_limit:
        given = tuple(d if stretches(own.limb, d.limb) is None else d.changed({"limb": own.limb}) for d in given)
    growth = growth or (Growth() if all(draw.limb == own.limb for draw in given) else _OF_THICKNESS)
    tissues = [(draw.tissues.model_dump(mode="json"), draw.limb.model_dump(mode="json")) for draw in given]
    key = digest_of([__version__, solve_key(own, mesh, band), tissues, astuple(growth)])[:32]
    shelf = Shelf(default_cache_dir() / "parametric" / f"{key}.sqlite", "the parametric model")
    if (kept := shelf.record(_MODEL, ParametricModel)) is not None:
        return kept
    tell(progress, "matrices", 0, 0)
    given = tuple(draw for draw in given if not _too_thick(own, draw, mesh))
    if not given:
        raise ScenarioError("limb.layers: no draw leaves enough of the core of the scene's mesh; give thinner ones")
    motion = motion_of(mesh, own.limb, [draw.limb for draw in given])
    model = fem_model(own, mesh if motion is None else motion.mesh, motion=motion)
    names = tuple(t.name for t in model.operator.terms)
    moves = follows_thickness(names)
    for draw in given:
        if reason := unfollowed(own, draw, names, unread=("limb",) if moves else ()):
            raise ScenarioError(reason)
    found = [coefficients_of(names, draw, own.limb) for draw in given]
    parts = Shelf(shelf.file.with_name(f"{key}-parts.sqlite"), "what is solved for the parametric model")
    around = grid_places(own, mesh)
    read = readings(model, around[1] if around else ())
    with freed_memory_kept():
        united = united_model(model, found, band, own.solver, growth, parts, progress, read)
    thickness = tuple((min(t), max(t)) for t in zip(*(_thicknesses(d) for d in (own, *given)), strict=True))
    made = ParametricModel(
        own, model.ports, *united, 1 + growth.solves + growth.checks, around[0] if around else None,
        thickness if moves else (),
    )  # fmt: skip
    if shelf.keep(_MODEL, made):
        parts.remove()
    return made


def _thicknesses(scenario: Scenario) -> tuple[float, ...]:
    """Of each layer [m], then of all together."""
    found = tuple(layer.thickness for layer in getattr(scenario.limb, "layers", ()))
    return (*found, sum(found))


def _terms_bytes(scenario: Scenario, mesh: TissueMesh) -> float:
    """Memory [bytes] that terms of other thicknesses take, about."""
    unknowns = 60 if "P3" in scenario.element else 30  # of a tetrahedron
    return _ENTRY * 0.3 * len(mesh.tetrahedra) * unknowns**2


def _too_thick(own: Scenario, draw: Scenario, mesh: TissueMesh) -> bool:
    """True if layers leave too little of the core of the ``mesh``."""
    if draw.limb == own.limb or stretches(own.limb, draw.limb) is None:
        return False
    try:
        stretched(mesh, own.limb, draw.limb)
    except GeometryError:
        return True
    return False


def _with_all_sheets(scenario: Scenario, draws: Sequence[Scenario]) -> Scenario:
    """The scenario with whatever some draw has on the skin and it has not, at half of the draws' largest."""
    tissues = scenario.tissues
    changed = dict[str, Any]()
    for part in ("membrane", "patch"):
        sheet = getattr(tissues, part)
        largest = {
            k: max(getattr(getattr(d.tissues, part), k) for d in draws)
            for k in type(sheet).model_fields if k not in ("length", "width")
        }  # fmt: skip
        missing = {k: _MIDDLE * v for k, v in largest.items() if v and not getattr(sheet, k)}
        size = draws[0].tissues.patch if part == "patch" and missing else sheet
        given = {k: getattr(size, k) for k in ("length", "width")} if part == "patch" else {}
        changed[part] = sheet.changed({**given, **missing})
    return scenario.changed({"tissues": tissues.changed(changed)})
