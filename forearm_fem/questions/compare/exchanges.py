"""Which channels, exchanged, would make two transfer matrices agree: plugs in the wrong sockets.

Data are never changed.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from ...typing import ComplexArray, IntArray
from .common import CommonGround
from .nearness import AGREES, FLOOR, PRICE, correlation, distance, explains

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
        """Which channels to exchange, how well the two agree then, and that nothing was done."""
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
