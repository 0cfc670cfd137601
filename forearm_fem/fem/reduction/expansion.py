"""Expansions that reduced models are made of: derivatives of solutions about a rate or frequencies, kept between
runs."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ...errors import SolverError
from ...progress import Progress, tell
from ...scenario.sweep import ReducedSolve
from ...store.shelf import Shelf
from ...typing import ComplexArray, FloatArray
from ..assembly.coefficients import is_polynomial, kelvin_voigt_like, rate_weights
from ..assembly.model import ForearmModel
from ..kernels.compiled import give_back
from ..linear.direct import DirectSolver, make_solver, watched
from .affine import AffineReduced, compressible, extend, with_last_columns
from .certificate import (
    DOUBTFUL,
    Certificate,
    Doubt,
    ResidualBound,
    certified,
    changes,
    doubt,
    dual_estimate,
    largest_change,
    most_doubtful_bin,
    probe_frequencies,
    sharp_modes,
)
from .rate_space import Chunk, Pairs, RateSpace

_log = logging.getLogger("forearm_fem.fem")
_QUIET, _SPREAD = 30.0, -0.2  # [Hz] flesh on bone hardly resonates below; expansions are even in f^-0.2 above it
_LOWEST = 20.0  # [Hz] below, what a rate further up spans is enough
_UPWARDS = 0.57  # 0.5, the middle, takes five derivatives more
_AT_ONCE = 5  # derivatives about a rate between two looks at what the last of them changed
_AT_LEAST, _SLOW = 20, 60  # derivatives about a rate before the first look, and before resonances are called sharp
_SHARP, _SEVERAL = 0.03, 3  # loss factor below which a mode may pass unseen between probes; one or two do not
_SURE = 1e-2  # of the tolerance: what derivatives may change where resonances are sharp, for the bound to pass soon
_TWICE = 2.0  # the error that a richer space finds: 0.7 to 2.3 times the true one (decision 0045)
_KNOWN = 3  # known solutions that are carried beside the loads of a certificate; with 13 ports they cost nothing
ROUNDED = 5e-5  # tolerance below which a certificate is refined: elimination alone is right to 1e-5 or so
_MOST = 1000  # columns about a rate where resonances are sharp; beyond, solves at all bins are no dearer


@dataclass(frozen=True)
class Expansion:
    """Direct solutions at ``frequency`` with Taylor coefficients: ``series[k]`` (n, n_port or fewer) for order k."""

    frequency: float
    series: tuple[ComplexArray, ...]
    residual: float
    solve_error: float


_CHUNK = ("last", "derivatives", "residual", "correction")


@dataclass(frozen=True)
class Snapshots:
    """Expansions and chunks of an interrupted sweep on a shelf, none of which is made twice; without a shelf none.

    Chunks are written in a thread beside the next one's making.
    """

    shelf: Shelf | None = None
    _writer: ThreadPoolExecutor = field(default_factory=lambda: ThreadPoolExecutor(1), repr=False, compare=False)

    def get(self, frequency: float) -> Expansion | None:
        """The expansion kept for a frequency, or None."""
        if self.shelf is None or (data := self.shelf.get(f"{frequency:g}")) is None:
            return None
        series = tuple(data[f"order{k}"] for k in range(data["count"]))
        return Expansion(frequency, series, data["residual"], data["solve_error"])

    def put(self, expansion: Expansion) -> None:
        """Keep an expansion."""
        parts: dict[str, Any] = {f"order{k}": x for k, x in enumerate(expansion.series)}
        parts["count"] = len(expansion.series)
        parts |= {"residual": float(expansion.residual), "solve_error": float(expansion.solve_error)}
        if self.shelf is not None:
            self.shelf.put(f"{expansion.frequency:g}", parts)

    def chunks(self) -> tuple[Chunk, ...]:
        """The space about a rate, in order, up to the first part that is missing or damaged."""
        found = list[Chunk]()
        while self.shelf is not None and (data := self.shelf.get(f"rate-{len(found)}")) is not None:
            pairs = Pairs(data["upper"], data["lower"])
            found.append(Chunk(data["columns"], pairs, *(data[name] for name in _CHUNK)))
        return tuple(found)

    def put_chunk(self, number: int, chunk: Chunk) -> None:
        """Keep a chunk, the ``number``-th from 0."""
        parts = {"columns": chunk.columns, "upper": chunk.pairs.upper, "lower": chunk.pairs.lower}
        if self.shelf is not None:
            whole = {**parts, **{name: getattr(chunk, name) for name in _CHUNK}}
            self._writer.submit(self.shelf.put, f"rate-{number}", whole)

    def finish(self) -> None:
        """Wait until all is written."""
        self._writer.shutdown()


@dataclass(frozen=True)
class ReducedSweepState:
    """A reduced model and what it was made from: a ``rate`` [1/s] with so many ``derivatives``, and ``expansions``.

    These come without their vectors. ``sharp`` says that resonances were, and are, not trusted without a bound at every
    bin. ``residual`` is the largest of any solution, ``solve_error`` what it causes in G.
    """

    reduced: AffineReduced
    rate: float = 0.0
    derivatives: int = 0
    expansions: tuple[Expansion, ...] = ()
    certificates: tuple[Certificate, ...] = ()
    residual: float = 0.0
    solve_error: float = 0.0
    sharp: bool = False

    def with_certificate(self, certificate: Certificate) -> ReducedSweepState:
        """The same after a comparison; what rounding may have done to its truth is an error of solves."""
        worst = max(self.solve_error, certificate.rounding)
        return replace(self, certificates=(*self.certificates, certificate), solve_error=worst)

    def after(self, solved: Expansion) -> ReducedSweepState:
        """The same with the errors of further solves."""
        worst, error = max(self.residual, solved.residual), max(self.solve_error, solved.solve_error)
        return replace(self, residual=worst, solve_error=error)


class Expander:
    """Makes expansions, or takes them from the store; factorises only when it must."""

    def __init__(self, model: ForearmModel, options: ReducedSolve, store: Snapshots, residual: float) -> None:
        self.model, self._options, self._store, self._residual = model, options, store, residual
        self.orders = np.full(len(model.ports), min(options.point_derivatives, options.derivatives))
        self.orders[watched(model)[1]] = options.derivatives  # more of the watched forces' solutions than the others'
        self._solver: DirectSolver | None = None
        self._space: RateSpace | None = None  # while the factors about its rate are there

    def direct(self, frequency: float) -> Expansion:
        """Direct solutions without derivatives, taken from a stored expansion where there is one."""
        self._space = None
        if (stored := self._store.get(frequency)) is not None:
            return stored
        solution = self._ready(frequency).at(frequency)
        error = self._ready(frequency).solve_error(solution)
        return Expansion(frequency, (solution.values,), solution.residual, error)

    def foreseen(self, made: ReducedSweepState, at: Doubt, tolerance: float) -> Certificate | None:
        """A certificate by the residual of a model about a rate, without another factorisation; None where it would
        not pass, or is not enough: as in :meth:`compared`, and where an unknown resonance could do much."""
        if self._space is None or at.wary or tolerance < ROUNDED:
            return None
        bound = ResidualBound(self._ready(at.frequency), made.rate)
        try:
            found = dual_estimate(bound, made.reduced, at.frequency, self._space.solved)
        except np.linalg.LinAlgError:  # the richer space is no space: that says nothing of the model
            return None
        certificate = Certificate(at.frequency, _TWICE * found.error, at.change, rounding=found.rounding, by="residual")
        return certificate if certificate.bound <= tolerance and found.bound <= DOUBTFUL else None

    def compared(self, made: ReducedSweepState, at: Doubt, tolerance: float) -> Certificate | None:
        """A certificate by elimination alone, which keeps no factors; None where it would not pass, or is not enough.

        That is where all changes are stated, where the tolerance is near to what rounding leaves, and with solvers that
        cannot. The first columns of the space are solutions that are known: what rounding does is seen on them.
        """
        first = made.reduced.basis.blocks[0][:, : len(self.model.ports)]
        if at.wary or tolerance < ROUNDED or self._store.get(at.frequency) is not None:
            return None
        self._space = None
        chosen = np.linspace(0, first.shape[1] - 1, min(_KNOWN, first.shape[1])).astype(int)
        found = self._ready(at.frequency).by_elimination(at.frequency, first[:, chosen].astype(float))
        if found is None:
            return None
        certificate = certified(made.reduced, self.model, found[0], at, len(made.expansions))
        certificate = replace(certificate, rounding=found[1], by="elimination")
        return certificate if certificate.bound <= tolerance else None

    def expand(self, frequency: float, start: Expansion | None = None) -> Expansion:
        """Solutions and derivatives; ``start`` are direct solutions whose factorisation is still held."""
        start = start or self.direct(frequency)
        if len(start.series) > self.orders.max():
            return start
        solver = self._ready(frequency)
        series = solver.taylor(frequency, start.series[0], self.orders)
        result = Expansion(frequency, tuple(series), start.residual, start.solve_error)
        self._store.put(result)
        return result

    def extended(self, made: ReducedSweepState, frequency: float, start: Expansion | None = None) -> ReducedSweepState:
        """``made`` with an expansion about ``frequency``."""
        expansion = self.expand(frequency, start)
        reduced = extend(made.reduced, self.model, expansion.series, self.orders)
        noted = (*made.expansions, replace(expansion, series=()))
        return replace(made, reduced=reduced, expansions=noted).after(expansion)

    def about_frequencies(self, planned: Sequence[float], progress: Progress | None) -> ReducedSweepState:
        """The model expanded about the ``planned`` frequencies."""
        made = ReducedSweepState(AffineReduced.of(self.model))
        for i, f in enumerate(planned):
            made = self.extended(made, f)
            tell(progress, "expansion frequencies", i + 1, len(planned))
        return made

    def about_rate(
        self, frequency: FloatArray, tolerance: float | None, progress: Progress | None
    ) -> ReducedSweepState | None:
        """The model on derivatives about :func:`expansion_rate`, as many as are needed.

        That is until the last five change nothing above ``tolerance``, all that are allowed where it is None. Where
        a mode in the band loses little, or sixty derivatives do not resolve it, resonances are sharp: see
        :meth:`_about_rate_with_care`.
        """
        most, rate = self._options.rate_derivatives, expansion_rate(frequency)
        stored = self._store.chunks()
        tell(progress, "ordering of unknowns", 0, 1)
        solver = self._ready(float(frequency[-1]))
        tell(progress, "ordering of unknowns", 1, 1)
        refined = {} if tolerance is not None else {"refined": 1}  # which tells whether factors are good at all
        self._space = space = RateSpace(solver, self.model.functionals, rate, stored, **refined)
        tell(progress, "reduced model", 0, most)
        reduced, derivatives = AffineReduced.of(self.model), 0
        probes, worst = probe_frequencies(frequency, ())[::2], np.zeros(0)
        for number in range(-(-most // _AT_ONCE)):
            chunk = stored[number] if number < len(stored) else space.more(min(_AT_ONCE, most - derivatives))
            if number >= len(stored):
                self._store.put_chunk(number, chunk)
            if not chunk.columns.shape[1]:
                break
            reduced, derivatives = with_last_columns(reduced, self.model, chunk.columns), chunk.derivatives
            tell(progress, "reduced model", derivatives, most)
            if tolerance is not None and derivatives >= _AT_LEAST:
                if derivatives == _AT_LEAST and sharp_modes(reduced, frequency, _SHARP) >= _SEVERAL:
                    return self._about_rate_with_care(frequency, _SURE * tolerance, progress)
                lower = reduced.lower()
                if len(worst) and derivatives < _SLOW and changes(self.model, reduced, lower, worst)[0] > tolerance:
                    continue  # where it changed most before it changes too much now: the others need not be looked at
                change = changes(self.model, reduced, lower, probes)
                worst = probes[[np.argmax(change)]]
                if change.max() <= tolerance:
                    break
                if change.max() > DOUBTFUL and derivatives >= _SLOW:
                    return self._about_rate_with_care(frequency, _SURE * tolerance, progress)
        return ReducedSweepState(reduced, rate, derivatives, residual=space.residual)

    def _about_rate_with_care(
        self, frequency: FloatArray, wanted: float, progress: Progress | None
    ) -> ReducedSweepState | None:
        """The model about the rate where resonances are sharp, in double precision from the start.

        What single-precision solves leave is magnified by the resonances: in double precision half the derivatives
        do. None where a thousand columns do not
        resolve the band to what is ``wanted``.
        """
        _log.warning("resonances of this band are sharp: their derivatives are made in double precision")
        self.release()
        self._solver, self._options = None, self._options.changed({"precision": "double"})
        space = RateSpace(self._ready(float(frequency[-1])), self.model.functionals, expansion_rate(frequency))
        reduced, change = AffineReduced.of(self.model), np.inf
        while change > wanted and reduced.size < _MOST:
            chunk = space.more(_AT_ONCE)
            if not chunk.columns.shape[1]:
                change = 0.0
                break
            reduced = with_last_columns(reduced, self.model, chunk.columns)
            tell(progress, "reduced model", chunk.derivatives, chunk.derivatives)
            if chunk.derivatives >= _AT_LEAST:
                change = largest_change(self.model, reduced, reduced.lower(), frequency)
        made = ReducedSweepState(
            reduced, expansion_rate(frequency), space.derivatives, residual=space.residual, sharp=True
        )
        return made if change <= wanted else None

    def most_doubtful(self, made: ReducedSweepState, frequency: FloatArray) -> Doubt | None:
        """Next frequency to certify; None where every bin was compared or expanded about.

        Where resonances are sharp it is the bin with the largest bound. Models of incompressible tissue keep each
        displacement's own pressure, and what solves leave in weak directions shows anywhere in the band: one true error
        stated a thirtieth of the largest there.
        """
        known = [*(c.frequency for c in made.certificates), *(e.frequency for e in made.expansions)]
        if not (made.sharp or sharp_modes(made.reduced, frequency, _SHARP) >= _SEVERAL):
            wary = any(c.wary for c in made.certificates) or not compressible(self.model.operator)
            return doubt(self.model, made.reduced, frequency, known, wary=wary)
        bound = ResidualBound(self._ready(float(frequency[-1])), expansion_rate(frequency))
        bounds = bound.errors(made.reduced, frequency, made.reduced.modes(frequency))
        return most_doubtful_bin(bounds, frequency, known)

    def inverse(self, frequency: FloatArray) -> Callable[[FloatArray], FloatArray]:
        """P^-1 times real columns, P the stiffness at :func:`expansion_rate`; factorised where its factors are gone."""
        if self._space is not None:
            return self._space.solved
        solver, rate = self._ready(float(frequency[-1])), expansion_rate(frequency)
        terms = [kelvin_voigt_like(t.coefficient, rate) for t in self.model.operator.terms]
        solver.factor.factorise(self.model.operator.combine(rate_weights(terms, rate)[0].tolist()))
        return solver.factor.solve

    @property
    def solver(self) -> str:
        """The direct solver at work, empty where none was needed."""
        return "" if self._solver is None else self._solver.factor.name

    def release(self) -> None:
        """Give the factor's memory back, to the system, too: the coarser mesh needs less."""
        self._space = None
        if self._solver is not None:
            self._solver.factor.release()
            give_back()

    def _ready(self, frequency: float) -> DirectSolver:
        if self._solver is None:
            made = make_solver(self.model, self._options, frequency)
            self._solver = replace(made, tolerance=max(made.tolerance, self._residual))
        return self._solver


def starts_from_rate(model: ForearmModel, options: ReducedSolve) -> bool:
    """True if the reduced model starts from a rate; SolverError where that is asked for and moduli do not allow it."""
    able = all(is_polynomial(t.coefficient) for t in model.operator.terms)
    if options.start == "rate" and not able:
        raise SolverError(
            "solver.start = 'rate' needs Kelvin-Voigt tissue: other moduli are no polynomials of the rate; "
            "set solver.start = 'auto'"
        )
    return able and options.start != "frequencies"


def expansion_rate(frequency: FloatArray, upwards: float = _UPWARDS) -> float:
    """Rate [1/s] from which a band is spanned with the fewest derivatives: 126 Hz for 10-500 Hz.

    A little above the geometric mean of the band, from 20 Hz on where it goes well beyond (decision 0005); ``upwards``
    is its place between the ends on a scale of logarithms.
    """
    low = max(frequency[0], min(_LOWEST, frequency[-1] / 12))
    return float(2 * np.pi * low ** (1 - upwards) * frequency[-1] ** upwards)


def expansion_frequencies(frequency: FloatArray, options: ReducedSolve) -> tuple[float, ...]:
    """Middles of equal parts of the band in f^-0.2, from 30 Hz on where the band goes well beyond.

    Below, an expansion from above holds; far above, resonances are damped and one expansion reaches far.
    """
    count = min(options.expansions, len(frequency))
    low = max(frequency[0], min(_QUIET, frequency[-1] / 8)) ** _SPREAD
    high = frequency[-1] ** _SPREAD
    wanted = (low + (high - low) * (np.arange(count) + 0.5) / count) ** (1 / _SPREAD)
    return tuple(sorted({float(frequency[np.argmin(np.abs(frequency - f))]) for f in wanted}))
