"""Precomputation shared by several aims: by places for any G of theirs, by G for all its targets."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Protocol, Self, runtime_checkable

from .drives import Renderer
from .inverse_filter import control_of
from .spectrum import Placed
from .zeros import FixedZeros


@runtime_checkable
class Settling(Renderer, Protocol):
    """A renderer that can say beforehand what it takes from places."""

    def settled(self, placed: Placed, targets: Sequence[str]) -> Self:
        """The same renderer with all that follows from where ports are found for ``targets``."""


def prepared(
    placed: Placed, methods: Iterable[Renderer], targets: Sequence[str]
) -> tuple[Placed, tuple[Renderer, ...]]:
    """G and renderers with all that aims at ``targets`` share: :func:`settled`, then :func:`with_controls`."""
    found = settled(methods, placed, targets)
    return with_controls(placed, found, targets), found


def settled(methods: Iterable[Renderer], placed: Placed, targets: Sequence[str]) -> tuple[Renderer, ...]:
    """The same renderers with zero points and shares of funneling found for ``targets``, so that draws of G find them
    there; for any G with the ports of ``placed`` whose inputs are known as there.

    Zero points that are searched stay a search. Raises as :meth:`.Renderer.aim` for ports that a renderer cannot serve.
    """
    return tuple(m.settled(placed, targets) if isinstance(m, Settling) else m for m in methods)


def with_controls(placed: Placed, methods: Iterable[Renderer], targets: Sequence[str]) -> Placed:
    """The same G with each set of control points by which settled ``methods`` aim at ``targets`` decomposed once.

    Corners of the thesis' grid have the control points of its middle, and where all other points are held still every
    target has the same. Drives are the same to the last bit. Raises as :func:`.control_of`.
    """
    sets = dict.fromkeys(
        frozenset((target, *zeros)) for m in methods for target in targets if (zeros := _zeros(m, target)) is not None
    )
    controls = (control_of(placed, names) for names in sets)
    return replace(placed, controls={c.rows: c for c in controls})


def _zeros(method: Renderer, target: str) -> tuple[str, ...] | None:
    """Zero points that are known before the renderer aims."""
    zeros = getattr(method, "zeros", None)
    return zeros.by_target.get(target) if isinstance(zeros, FixedZeros) else zeros if isinstance(zeros, tuple) else None
