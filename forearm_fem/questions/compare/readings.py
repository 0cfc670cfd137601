"""Readings of a G that would make two agree: units, signs, exchanged channels, delays."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.optimize import linear_sum_assignment

from ...metrics.common_ground import CommonGround
from ...typing import ComplexArray, FloatArray, IntArray

# Distance of two transfer matrices, and the test for a mistake instead of another arm.
# Nearness is s = ||A - B|| / sqrt(||A|| ||B||), as large for B a thousand times too small as for a thousand times too
# large.

_BETTER, _NEAR = 3.0, 1.0  # a reading must lower s at least so many times, to no more than this,
_SHAPE, _GAINED = 0.6, 0.5  # or raise the correlation by the second to above the first, sizes being within LARGE,
_FAR, _NEARISH = 10.0, 2.0  # or bring what lies beyond the first, correlating so, to within the second
PRICE = 1.5  # every further element of a reading must lower s this many times
FLOOR = 1e-3  # s below this counts as exact: rounding must not choose
AGREES = 0.5  # e_band up to which two are called so
LARGE = 30.0  # a ratio of norms beyond this is said even where no reading helps


def explains(base: float, shape_before: float, after: float, shape: float) -> bool:
    """True if distances and correlations before and after a reading are those of a mistake, not of another arm."""
    nearer = after <= min(base / _BETTER, _NEAR)
    alike = shape >= _SHAPE and shape - shape_before >= _GAINED and after <= math.sqrt(LARGE + 1 / LARGE - 2 * shape)
    return nearer or alike or (base >= _FAR and after <= _NEARISH and shape >= _SHAPE)


def distance(a: ComplexArray, b: ComplexArray) -> float:
    """s [-] of two matrices of one shape."""
    return float(np.linalg.norm(a - b) / np.sqrt(np.linalg.norm(a) * np.linalg.norm(b)))


def correlation(a: ComplexArray, b: ComplexArray) -> float:
    """Re <a, b> / (||a|| ||b||) [-]."""
    return float((a.conj() * b).real.sum() / (np.linalg.norm(a) * np.linalg.norm(b)))


# Exchanged channels, plugs in the wrong sockets, that would make two transfer matrices agree.
# Data are never changed.

_NAMED = 6  # ports a sentence names


@dataclass(frozen=True)
class Exchange:
    """Cycles of port names of B whose channels change places.

    ``before`` and ``after`` are e_band of B as it is, and so exchanged.
    """

    outputs: tuple[tuple[str, ...], ...]
    inputs: tuple[tuple[str, ...], ...]
    before: float
    after: float

    @property
    def sentence(self) -> str:
        """Channels to exchange, how well the two agree then, and that nothing was done."""
        sides = (("inputs", self.inputs), ("outputs", self.outputs))
        how = "agrees with" if self.after < AGREES else "comes nearest to"
        what = ", and ".join(f"its {side} {_spoken(cycles)}" for side, cycles in sides if cycles)
        return (
            f"B {how} A when {what}: e_band {self.after:.2g} instead of {self.before:.2g}. "
            "Nothing was changed; check the wiring or the names"
        )


def exchanged(ground: CommonGround) -> Exchange | None:
    """The fewest exchanges of inputs, outputs or both that bring B to A as no other arm is; None where none do.

    Two arms that differ by more than noise get none: their channels correlate too little for it. On a symmetric device
    exchanged inputs may equal exchanged outputs, and several orders may do as well: one that takes few is named.
    """
    a, b = (np.where(ground.valid, m, 0) for m in (ground.a, ground.b))
    if not (a.any() and b.any()):
        return None
    tries = [(rows, columns, b[:, rows][:, :, columns]) for rows, columns in _orders(a, b)]
    rows, columns, values = min(
        tries, key=lambda t: max(distance(a, t[2]), FLOOR) * PRICE ** len([*_cycles(t[0]), *_cycles(t[1])])
    )
    if not (_cycles(rows) or _cycles(columns)):
        return None
    if not explains(distance(a, b), correlation(a, b), distance(a, values), correlation(a, values)):
        return None
    before, after = (float(np.linalg.norm(a - x) / np.linalg.norm(a)) for x in (b, values))
    names = [p.name for p in ground.outputs], [p.name for p in ground.inputs]
    return Exchange(_named(rows, names[0]), _named(columns, names[1]), before, after)


def _orders(a: ComplexArray, b: ComplexArray) -> Iterator[tuple[IntArray, IntArray]]:
    """Orders of b's outputs and inputs: as they are, inputs alone, outputs alone, either after the other."""
    rows, columns = np.arange(a.shape[1]), np.arange(a.shape[2])
    yield rows, columns
    for pair in (_by_distance, _by_shape):
        first_columns, first_rows = pair(a, b, 2), pair(a, b, 1)
        yield rows, first_columns
        yield first_rows, columns
        yield pair(a, b[:, :, first_columns], 1), first_columns
        yield first_rows, pair(a, b[:, first_rows], 2)


def _by_distance(a: ComplexArray, b: ComplexArray, axis: int) -> IntArray:
    """For each channel of ``a`` along ``axis`` the one of ``b`` that stands for it: what is left is least."""
    one, other = _channels(a, axis), _channels(b, axis)
    return np.asarray(linear_sum_assignment((np.abs(one[:, None] - other[None]) ** 2).sum(axis=2))[1])


def _by_shape(a: ComplexArray, b: ComplexArray, axis: int) -> IntArray:
    """The same for matrices of two arms: sizes do not count, channels correlate best."""
    one, other = (m / np.maximum(np.linalg.norm(m, axis=1, keepdims=True), np.finfo(float).tiny)
                  for m in (_channels(a, axis), _channels(b, axis)))  # fmt: skip
    return np.asarray(linear_sum_assignment(-(one.conj() @ other.T).real)[1])


def _channels(m: ComplexArray, axis: int) -> ComplexArray:
    return np.moveaxis(m, axis, 0).reshape(m.shape[axis], -1)


def _cycles(order: IntArray) -> list[list[int]]:
    """Cycles of a permutation that move something."""
    left, found = set(range(len(order))), []
    while left:
        start = min(left)
        cycle = [start]
        while (at := int(order[cycle[-1]])) != start:
            cycle.append(at)
        left -= set(cycle)
        found += [cycle] if len(cycle) > 1 else []
    return found


def _named(order: IntArray, names: Sequence[str]) -> tuple[tuple[str, ...], ...]:
    return tuple(tuple(names[i] for i in cycle) for cycle in _cycles(order))


def _spoken(cycles: tuple[tuple[str, ...], ...]) -> str:
    moved = sum(map(len, cycles))
    if moved > _NAMED:
        return f"are put in another order ({moved} of them)"
    return ", ".join(f"{' and '.join(c)} are {'exchanged' if len(c) == 2 else 'permuted'}" for c in cycles)


# Mistakes of units, convention or wiring that would explain a difference; data are never changed.
# A *reading* multiplies B by a power of ten, a power of i omega and a phase e^{i omega tau}, conjugates it, or negates
# channels. Each combination of these is tried and the simplest that brings B to A is named. Exchanged channels are
# looked for as well (:mod:`.exchanges`). Not covered: gains that are no power of a thousand (said as a ratio), two
# different mistakes in different channels, and exchanged channels of another unit.

_ALIKE = 0.1  # s below this: nothing to explain
_LONGEST = 0.02  # s: delays looked for
_OPPOSED = 0.5  # or turn channels of which each correlates with A by less than minus this
_ALL = "every entry"


@dataclass(frozen=True)
class Reading:
    """B as it would have to be read: times 10^(3 ``thousands``) (i omega)^``power`` e^{i omega ``advance``}, conjugated
    first where ``conjugate``, with the channels in ``negated`` ("output 3", "input A1", or "every entry") turned.

    ``before`` and ``after`` are e_band of B as it is, and so read.
    """

    conjugate: bool = False
    power: int = 0
    thousands: int = 0
    advance: float = 0.0
    negated: tuple[str, ...] = ()
    before: float = math.nan
    after: float = math.nan

    @property
    def elements(self) -> int:
        """Number of mistakes it takes."""
        return sum(map(bool, (self.conjugate, self.power, self.thousands, self.advance, self.negated)))

    @property
    def sentence(self) -> str:
        """Change that would make the two agree, how well, and that nothing was done."""
        how = "agrees with" if self.after < AGREES else "comes nearest to"
        return (
            f"B {how} A when it is {', '.join(self._parts())}: e_band {self.after:.2g} instead of {self.before:.2g}. "
            "Nothing was changed; correct or declare the one that is wrong"
        )

    def _parts(self) -> Iterator[str]:
        if self.conjugate:
            yield "conjugated (the other sign convention, e^{-iwt})"
        if self.power:
            yield _POWERS[self.power]
        if self.thousands:
            yield f"multiplied by {_THOUSANDS[self.thousands]}"
        if self.advance:
            yield f"{'advanced' if self.advance > 0 else 'delayed'} by {1e3 * abs(self.advance):.3g} ms"
        if self.negated:
            yield f"negated at {', '.join(self.negated)}"


_POWERS = {
    -1: "divided by iw (velocity for displacement)",
    -2: "divided by (iw)^2 (acceleration for displacement)",
    1: "multiplied by iw (A is a velocity)",
    2: "multiplied by (iw)^2 (A is an acceleration)",
}
_THOUSANDS = {
    -2: "1e-6 (micrometres for metres)",
    -1: "1e-3 (millimetres for metres)",
    1: "1e3 (A is in millimetres, or B per millivolt)",
    2: "1e6 (A is in micrometres)",
}


def explained(ground: CommonGround) -> str:
    """One sentence on what is zero in one alone, on the reading of B that makes it agree with A, or on a ratio.

    The ratio is one that no reading explains; "" where there is nothing to say.

    Honest differences (another tissue, another coil, noise) get none: a reading must bring the two three times nearer
    and to within s = 1, or raise their correlation by 0.5 to above 0.6, or turn channels that run against A.
    """
    a, b = (np.where(ground.valid, m, 0) for m in (ground.a, ground.b))
    if dead := _dead(ground, "A", a, b) or _dead(ground, "B", b, a):
        return dead
    if not a.any():
        return ""
    if said := mistake(ground):
        return said
    ratio = float(np.linalg.norm(b) / np.linalg.norm(a))
    if 1 / LARGE < ratio < LARGE:
        return ""
    return (
        f"B is {ratio:.3g} times as large as A and no usual mistake (mm for m, velocity, acceleration, conjugate, "
        "negated channel, delay) explains it; check gains and units"
    )


def mistake(ground: CommonGround) -> str:
    """One sentence on the reading or the exchange of channels, whichever brings B nearer to A; "" for neither."""
    found = [r for r in (best_reading(ground), exchanged(ground)) if r is not None]
    return min(found, key=lambda r: r.after).sentence if found else ""


def _dead(ground: CommonGround, name: str, own: ComplexArray, other: ComplexArray) -> str:
    """A sentence on ports at which ``own`` is zero throughout and ``other`` is not."""
    if other.any() and not own.any():
        return f"{name} is zero at every entry: nothing moved, or nothing was recorded"
    sides = ((ground.inputs, (0, 1)), (ground.outputs, (0, 2)))
    lost = [p.name for ports, axes in sides for p, here, there in
            zip(ports, np.any(own != 0, axis=axes), np.any(other != 0, axis=axes), strict=True)
            if there and not here]  # fmt: skip
    where = ", ".join(lost[:6])
    return f"{name} is zero at {where}: a dead channel, or an actuator out of contact" if lost else ""


def best_reading(ground: CommonGround) -> Reading | None:
    """The simplest reading that makes B agree with A, None where B agrees as it is or none does."""
    a, b = (np.where(ground.valid, m, 0) for m in (ground.a, ground.b))
    base = distance(a, b)
    if not base > _ALIKE:
        return None
    tried = [(r, read(b, r, ground)) for r in _candidates(ground, a, b)]
    reading, values = min(tried, key=lambda t: max(distance(a, t[1]), FLOOR) * PRICE ** t[0].elements)
    shapes = correlation(a, b), correlation(a, values)
    if reading.elements == 0 or not explains(base, shapes[0], distance(a, values), shapes[1]):
        reading = Reading(negated=_negated(ground, a, b))
        if not _turned(ground, a, b, reading.negated):
            return None
        values = read(b, reading, ground)
    scale = float(np.linalg.norm(a))
    before, after = (float(np.linalg.norm(x - a)) / scale for x in (b, values))
    return replace(reading, before=before, after=after)


def _turned(ground: CommonGround, a: ComplexArray, b: ComplexArray, negated: tuple[str, ...]) -> bool:
    """True if each channel in ``negated`` by itself runs against ``a``; another arm does that to none."""
    names = [f"output {p.name}" for p in ground.outputs], [f"input {p.name}" for p in ground.inputs]
    channels = [(a[:, names[0].index(n)], b[:, names[0].index(n)]) for n in negated if n in names[0]]
    channels += [(a[:, :, names[1].index(n)], b[:, :, names[1].index(n)]) for n in negated if n in names[1]]
    return bool(channels) and all(x.any() and y.any() and correlation(x, y) <= -_OPPOSED for x, y in channels)


def read(b: ComplexArray, reading: Reading, ground: CommonGround) -> ComplexArray:
    """``b`` (n, n_out, n_in) as ``reading`` has it, on the frequencies and ports of ``ground``."""
    signs = (-1 if reading.negated == (_ALL,) else 1) * np.outer(
        [-1.0 if f"output {p.name}" in reading.negated else 1.0 for p in ground.outputs],
        [-1.0 if f"input {p.name}" in reading.negated else 1.0 for p in ground.inputs],
    )
    turn = 10.0 ** (3 * reading.thousands) * (1j * ground.omega) ** reading.power
    turn = turn * np.exp(1j * ground.omega * reading.advance)
    return np.asarray((b.conj() if reading.conjugate else b) * turn[:, None, None] * signs)


def _candidates(ground: CommonGround, a: ComplexArray, b: ComplexArray) -> Iterator[Reading]:
    """All combinations, each with its likeliest power of a thousand, delay and negated channels."""
    for conjugate, power, delayed in product((False, True), (0, -1, -2, 1, 2), (False, True)):
        plain = Reading(conjugate, power)
        ratio = np.linalg.norm(a) / np.linalg.norm(read(b, plain, ground))
        thousands = int(np.clip(np.rint(np.log10(ratio) / 3), -2, 2))
        scaled = replace(plain, thousands=thousands)
        if delayed:
            scaled = replace(scaled, advance=_advance(ground, a, read(b, scaled, ground)))
        yield scaled
        yield replace(scaled, negated=_negated(ground, a, read(b, scaled, ground)))


def _advance(ground: CommonGround, a: ComplexArray, b: ComplexArray) -> float:
    """tau [s] that brings b e^{i omega tau} nearest to ``a``, whatever the signs of entries; 0 for one frequency."""
    if len(ground.frequency) < 2:
        return 0.0
    cross = (a.conj() * b).reshape(len(a), -1)
    tau = np.linspace(-_LONGEST, _LONGEST, 2 * math.ceil(20 * _LONGEST * float(ground.frequency[-1])) + 1)

    def gain(at: FloatArray) -> FloatArray:
        """Size (n,) of the real cross spectrum, summed over entries, after each advance ``at`` [s]."""
        return np.asarray(np.abs((np.exp(1j * np.outer(at, ground.omega)) @ cross).real).sum(axis=1))

    best = float(tau[np.argmax(gain(tau))])
    fine = best + np.linspace(-1, 1, 201) * (tau[1] - tau[0])
    return float(fine[np.argmax(gain(fine))])


def _negated(ground: CommonGround, a: ComplexArray, b: ComplexArray) -> tuple[str, ...]:
    """Outputs and inputs whose signs bring ``b`` nearest to ``a``, as few as do it: alternating choice."""
    match = (a.conj() * b).real.sum(axis=0)
    tries = []
    for start in np.vstack([np.ones(match.shape[1]), np.sign(match) + (match == 0)]):
        columns = start
        for _ in range(8):
            rows = np.where(match @ columns < 0, -1, 1)
            columns = np.where(rows @ match < 0, -1, 1)
        tries += [(float(rows @ match @ columns), s * rows, s * columns) for s in (1, -1)]
    most = max(t[0] for t in tries)
    kept = [t for t in tries if t[0] >= most * (1 - 1e-9)]
    _, rows, columns = min(kept, key=lambda t: np.count_nonzero(t[1] < 0) + np.count_nonzero(t[2] < 0))
    if len(set(rows * 1.0)) == len(set(columns * 1.0)) == 1:
        return () if rows[0] * columns[0] > 0 else (_ALL,)
    names = (*(f"output {p.name}" for p in ground.outputs), *(f"input {p.name}" for p in ground.inputs))
    return tuple(n for n, s in zip(names, (*rows, *columns), strict=True) if s < 0)
