"""Places in rows: rectangles, staggered rows, and rows of different lengths."""

from __future__ import annotations

from collections.abc import Iterator, Sequence


def places_in_rows(
    counts: Sequence[int], along: float, across: float, stagger: float = 0.0
) -> tuple[tuple[float, float], ...]:
    """Places (x, y) [m] of rows ``along`` [m] apart in x, with ``counts`` places each, ``across`` [m] apart in y.

    Rows as a whole are centred on x = 0, each row on y = 0; then the first, third, ... move by -``stagger``/2 of
    ``across`` along y, the others by as much the other way.
    """
    return tuple(_places(counts, along, across, stagger))


def _places(counts: Sequence[int], along: float, across: float, stagger: float) -> Iterator[tuple[float, float]]:
    first = (len(counts) - 1) / 2
    for r, count in enumerate(counts):
        aside = (stagger if r % 2 else -stagger) / 2
        yield from (((r - first) * along, (c - (count - 1) / 2 + aside) * across) for c in range(count))
