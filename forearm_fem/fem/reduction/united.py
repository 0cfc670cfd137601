"""One reduced space for many tissues: solutions for several coefficients of the same terms, taken where it errs most.

The terms' matrices do not depend on moduli or tension, so a space that holds solutions for several of these serves all
between them. It starts from derivatives about a real rate for the model's own ones. Then, over and over, the place
(draw and frequency) where the model changes most without its highest derivatives is solved directly. That gives a true
error there, and the solution with its derivatives extends the space. At the end each part of the band gets a model of
its own, on the principal directions of what the draws do there (docs/decisions/0038-parametric-model.md).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from typing import Any

import numpy as np
from scipy.sparse import csr_array

from ...progress import Progress, tell
from ...scenario.sweep import SolverOptions
from ...typing import ComplexArray, FloatArray
from ..assembly.model import ForearmModel
from .growing import Coefficients, Growing, PartStore, Place, TrialSolve, part_of
from .quick import quick_compliance
from .reduced_model import ReducedModel, empty_model

_STAGE = "arms solved"
_LOOKED_AT = 24  # places among which the next solve is chosen; each costs two small dense solves
_THIRDS = 3  # of the band, equally many bins each
_LOW = 6  # the band's low end is this part of it, in the root of the frequency
_AT_LOW = 2  # solves there at most
_LOW_ORDER = 2  # derivatives of solves there, where solutions hardly change with frequency
_FEW = 8  # bins below which a band is not cut
_TESTED = 12  # states of each part that size its model and do not shape it
_CORE = 0.7  # of the whole model's directions
_STEP = 1.25  # ratio of the sizes tried
_LEAST = 40  # directions
_MODELS, _ARRAYS = ("whole", "core"), ("matrices", "functionals", "places")


@dataclass(frozen=True)
class Piece:
    """The models of a part of the band, up to ``high`` [Hz]: the ``whole`` one, and the ``core``, of fewer directions,
    in which a third of the solves had no part. What an answer changes between them is the estimate of its error."""

    high: float
    whole: ReducedModel
    core: ReducedModel

    def change(self, draw: Coefficients, frequency: float) -> tuple[ComplexArray, ComplexArray]:
        """Compliances (n_port, n_port) of the whole and of the core for a draw."""
        one = np.array([frequency])
        whole, core = (quick_compliance(replace(m, coefficients=draw), one)[0] for m in (self.whole, self.core))
        return whole, core


@dataclass(frozen=True)
class United:
    """A reduced model for many coefficients, in ``pieces`` from the low to the high end of the band.

    ``trials`` were compared while the space grew and then extended it; ``checks`` afterwards, and did not. ``solves``
    counts the factorisations.
    """

    pieces: tuple[Piece, ...]
    trials: tuple[TrialSolve, ...]
    checks: tuple[TrialSolve, ...]
    solves: int


@dataclass(frozen=True)
class Growth:
    """How much work is put into a model.

    It starts from so many derivatives about a ``rate``. Direct ``solves`` extend the space, each with derivatives by
    frequency, ``of_contacts`` and ``of_points``; ``checks`` follow. The band is cut into ``parts``, equal in the root
    of the frequency, whose models are made from ``states`` (of draws at frequencies) each: as many directions as err
    by ``tolerance`` (rms over the draws) beside the space, but ``most``.
    """

    rate: int = 20
    solves: int = 7
    checks: int = 3
    of_contacts: int = 4
    of_points: int = 3
    parts: int = 4
    states: int = 60
    tolerance: float = 4e-3
    most: int = 700
    seed: int = 1


class NothingKept:
    """For a model that is made in one go."""

    def get(self, name: str) -> Mapping[str, Any] | None:
        """See :class:`.growing.PartStore`."""

    def put(self, name: str, parts: Mapping[str, Any]) -> None:
        """See :class:`.growing.PartStore`."""


def united_model(
    model: ForearmModel,
    draws: Sequence[Coefficients],
    frequency: FloatArray,
    options: SolverOptions,
    growth: Growth,
    progress: Progress | None = None,
    kept: PartStore | None = None,
    readings: csr_array | None = None,
) -> United:
    """A space for the model's own coefficients and those of the ``draws``, in the band of ``frequency`` (n,) [Hz].

    All draws serve for choosing where to solve and for compression, random ones for checks. What is ``kept`` of an
    interrupted call of the same arguments is not made again. ``readings`` (k, n_u) of places that are no ports are
    worked out for each piece's models.
    """
    kept = kept or NothingKept()
    work = Growing(model, draws, options, float(frequency[-1]), kept, readings)
    work.restored()
    parts = cut(frequency, growth.parts)
    places = _places(np.random.default_rng([growth.seed, 2]), len(draws), frequency, growth.checks)
    pieces = [_read_piece(kept, model, k) for k in range(len(parts))]
    checks = [_read_check(kept, i) for i in range(len(places))]
    done, total = 0, 1 + growth.solves - work.steps + sum(x is None for x in (*pieces, *checks))

    def step() -> None:
        """Tell that one more is done."""
        nonlocal done
        done += 1
        tell(progress, _STAGE, done, total)

    tell(progress, _STAGE, 0, total)  # of what is left, so that the time left is told from what was done now
    for i in range(work.steps, 1 + growth.solves):
        _grow(work, i, frequency, growth)
        step()
    whole = list[Piece]()
    for k, (part, piece) in enumerate(zip(parts, pieces, strict=True)):
        whole.append(piece or _made_piece(work, kept, k, part, len(draws), growth))
        if piece is None:
            step()
    compared = list[TrialSolve]()
    for i, (place, check) in enumerate(zip(places, checks, strict=True)):
        compared.append(check or _made_check(work, kept, i, place, piece_at(whole, place[1]), draws))
        if check is None:
            step()
    work.release()
    return United(tuple(whole), tuple(work.trials), tuple(compared), 1 + growth.solves + growth.checks)


def _grow(work: Growing, step: int, frequency: FloatArray, growth: Growth) -> None:
    """Derivatives about a rate first. Then two solves in the upper two thirds of the band in turn, where waves are
    short, and one at its low end, where the ratios of moduli shape what moves and derivatives show none of it; two
    such are enough."""
    if step == 0:
        work.start(frequency, growth.rate)
        return
    place, early = step - 1, step <= growth.solves - max(1, growth.solves // 3)
    rng, fresh = np.random.default_rng([growth.seed, 0, place]), work.unsolved()
    low_ones = min(place // _THIRDS, _AT_LOW)
    if place % _THIRDS == _THIRDS - 1 and low_ones < _AT_LOW:
        end = np.sqrt(frequency[[0, -1]]) @ [1 - 1 / _LOW, 1 / _LOW]
        part, most = frequency[np.sqrt(frequency) <= end], _LOW_ORDER
    else:
        thirds, turn = np.array_split(frequency, min(_THIRDS, len(frequency))), place - low_ones
        part, most = thirds[-1 - turn % 2 % len(thirds)], growth.of_contacts
    places = [(fresh[d], f) for d, f in _places(rng, len(fresh), part, _LOOKED_AT)]
    work.extended_where_worst(places, min(most, growth.of_contacts), min(most, growth.of_points), early=early)


def _made_piece(work: Growing, kept: PartStore, number: int, part: FloatArray, draws: int, growth: Growth) -> Piece:
    """The models of a ``part`` (n,) [Hz] of the band, of as few directions as serve some of the states, which had no
    part in them."""
    rng = np.random.default_rng([growth.seed, 1, number])
    places = _places(rng, draws, part, growth.states + _TESTED)
    states = work.states(places)
    tested, shaping = states[:_TESTED], states[_TESTED:]
    largest = work.compressed(shaping, growth.most)
    size = min(_LEAST, largest.size)
    while size < largest.size:
        if work.misfit(part_of(largest, np.arange(largest.size) < size), places[:_TESTED], tested) <= growth.tolerance:
            break
        size = min(largest.size, round(_STEP * size))
    whole = part_of(largest, np.arange(largest.size) < size)
    core = work.core(shaping[: growth.states // 2], max(_LEAST // 2, round(_CORE * size)))
    piece = Piece(float(part[-1]), whole, core)
    kept.put(f"piece-{number}", {
        "high": piece.high, **{f"{of}-{name}": getattr(getattr(piece, of), name) for of in _MODELS for name in _ARRAYS}
    })  # fmt: skip
    return piece


def _read_piece(kept: PartStore, model: ForearmModel, number: int) -> Piece | None:
    found = kept.get(f"piece-{number}")
    if found is None:
        return None
    empty = empty_model(model)
    whole, core = (replace(empty, **{name: found[f"{of}-{name}"] for name in _ARRAYS}) for of in _MODELS)
    return Piece(float(found["high"]), whole, core)


def _made_check(
    work: Growing, kept: PartStore, number: int, place: Place, piece: Piece, draws: Sequence[Coefficients]
) -> TrialSolve:
    """What a finished ``piece`` says at a place, against a direct solution."""
    whole, core = piece.change(draws[place[0]], place[1])
    check = TrialSolve(*place, *work.errors(whole, core, place))
    kept.put(f"check-{number}", {"check": np.array(astuple(check), dtype=float)})
    return check


def _read_check(kept: PartStore, number: int) -> TrialSolve | None:
    found = kept.get(f"check-{number}")
    if found is None:
        return None
    draw, frequency, estimated, true = found["check"].tolist()
    return TrialSolve(int(draw), frequency, estimated, true)


def cut(frequency: FloatArray, parts: int) -> list[FloatArray]:
    """The band of ``frequency`` (n,) [Hz], rising, in so many parts, equal in the root of the frequency."""
    if len(frequency) < _FEW * parts:
        return [frequency]
    ends = np.linspace(np.sqrt(frequency[0]), np.sqrt(frequency[-1]), parts + 1)[1:-1] ** 2
    return [p for p in np.split(frequency, np.searchsorted(frequency, ends)) if len(p)]


def piece_at(pieces: Sequence[Piece], frequency: float) -> Piece:
    """The piece whose part of the band holds ``frequency`` [Hz]; the last one beyond."""
    return next((p for p in pieces if frequency <= p.high), pieces[-1])


def _places(rng: np.random.Generator, draws: int, frequency: FloatArray, count: int) -> list[Place]:
    """Random draws, each as often as the others, at bins that are dense in the square root of the frequency."""
    order = np.concatenate([rng.permutation(draws) for _ in range(1 + count // draws)])[:count]
    wanted = rng.uniform(np.sqrt(frequency[0]), np.sqrt(frequency[-1]), count) ** 2
    return [(int(d), float(frequency[np.argmin(np.abs(frequency - f))])) for d, f in zip(order, wanted, strict=True)]
