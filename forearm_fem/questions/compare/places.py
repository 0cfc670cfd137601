"""Ports of two transfer matrices matched by name and by place, and what to say where the two do not agree."""

from __future__ import annotations

import numpy as np

from ...errors import DataError
from ...ports import Port
from ...typing import FloatArray

_NEAR = 0.25  # of the smallest distance between A's ports: closer ones are at the same place
_CLOSE = 1e-3  # m: what no word is lost about
_SHAPE = 0.02  # of the ports' spread: how well a scaled or mirrored layout must fit to be called so

_SIGNS = (((1, 1), ""), ((-1, 1), ", mirrored in x"), ((1, -1), ", mirrored in y"), ((-1, -1), ", turned around"))


def matched(ours: tuple[Port, ...], theirs: tuple[Port, ...], what: str) -> tuple[list[int], str]:
    """Positions in ``theirs`` of the partners of ``ours``, by name, or by place where the names differ, and a note.

    ``what`` is "outputs" or "inputs". The note says where names and places disagree ("" where they do not, or where one
    side does not know its places). Places are compared in the plane of the skin (x, y). DataError where neither names
    nor places pair all ports.
    """
    names = [p.name for p in theirs]
    by_place = _by_place(_plane(ours), _plane(theirs))
    if len(set(names)) == len(names) and sorted(names) == sorted(p.name for p in ours):
        order = [names.index(p.name) for p in ours]
        return order, _disagreement(ours, theirs, order, by_place, what)
    if by_place is None and (lacking := _lacking(ours, theirs)):
        raise DataError(f"{what}: {lacking}; compare needs the same {what} in both: leave the others out of one")
    if by_place is None:
        raise DataError(
            f"the {what} of A ({_listed(ours)}) and B ({_listed(theirs)}) pair neither by name nor by place; "
            "rename them"
        )
    pairs = ", ".join(f"{p.name} = {names[k]}" for p, k in zip(ours, by_place, strict=True) if p.name != names[k])
    return by_place, f"the {what} have different names and are matched by place, A = B: {_short(pairs, 180)}"


def _lacking(ours: tuple[Port, ...], theirs: tuple[Port, ...]) -> str:
    """Which ports one side has beyond those of the other, by name; "" where neither holds all of the other's."""
    a, b = ({p.name for p in side} for side in (ours, theirs))
    if not a < b and not b < a:
        return ""
    more = tuple(p for p in (*ours, *theirs) if p.name in a ^ b)
    return f"{'A lacks' if a < b else 'B lacks'} {_listed(more)} of {'B' if a < b else 'A'}"


def _plane(ports: tuple[Port, ...]) -> FloatArray | None:
    """Places (n, 2) [m], None where they are not known: not finite, or all the same."""
    place = np.array([p.position[:2] for p in ports], dtype=float).reshape(-1, 2)
    known = len(place) > 0 and np.isfinite(place).all() and (len(place) == 1 or float(np.ptp(place, axis=0).max()) > 0)
    return place if known else None


def _by_place(ours: FloatArray | None, theirs: FloatArray | None) -> list[int] | None:
    """The one port of ``theirs`` at each place of ``ours``; None where that is no pairing of all."""
    if ours is None or theirs is None or len(ours) != len(theirs):
        return None
    spacing = 0.01  # m, of a single place
    if len(ours) > 1:
        spacing = float(np.linalg.norm(ours[:, None] - ours, axis=2)[np.triu_indices(len(ours), 1)].min())
    apart = np.linalg.norm(ours[:, None] - theirs, axis=2)
    nearest = apart.argmin(axis=1)
    if len(set(nearest.tolist())) < len(ours) or apart.min(axis=1).max() > _NEAR * spacing:
        return None
    return [int(k) for k in nearest]


def _disagreement(
    ours: tuple[Port, ...], theirs: tuple[Port, ...], order: list[int], by_place: list[int] | None, what: str
) -> str:
    """What to say of ports that bear the same names."""
    if by_place is not None and by_place != order:
        moved = [f"A's {p.name} = B's {theirs[k].name}" for p, k in zip(ours, by_place, strict=True)]
        moved = [m for m, (k, o) in zip(moved, zip(by_place, order, strict=True), strict=True) if k != o]
        return (
            f"names and places of the {what} disagree: by place {_short(', '.join(moved), 110)}; they are compared by "
            f"name. If the places are right, rename B's {what}"
        )
    a, b = _plane(ours), _plane(theirs)
    if a is None or b is None:
        return ""
    b = b[order]
    furthest = float(np.linalg.norm(b - a, axis=1).max())
    if furthest <= _CLOSE:
        return ""
    how = _transform(a, b)
    return (
        f"the {what} of the same name lie up to {1e3 * furthest:.3g} mm apart in A and B{how}; they are compared by "
        "name as if they were at one place: correct the positions, or expect G to differ"
    )


def _transform(a: FloatArray, b: FloatArray) -> str:
    """How B's layout (n, 2) follows from A's, where it is a shift, a factor or a mirror image."""
    shift = (b - a).mean(axis=0)
    spread = max(float(np.linalg.norm(a - a.mean(axis=0), axis=1).max()), _CLOSE)
    if float(np.linalg.norm(b - a - shift, axis=1).max()) <= _SHAPE * spread:
        return f" (B is shifted by {1e3 * shift[0]:.3g}, {1e3 * shift[1]:.3g} mm)"
    from_centre, other = a - a.mean(axis=0), b - b.mean(axis=0)
    for signs, said in _SIGNS:
        turned = from_centre * np.array(signs)
        factor = float((turned * other).sum() / (turned**2).sum()) if len(a) > 1 else 0.0
        if factor > 0 and float(np.linalg.norm(other - factor * turned, axis=1).max()) <= _SHAPE * spread * factor:
            size = "" if abs(factor - 1) <= _SHAPE else f" {factor:.3g} times as wide"
            return f" (B's layout is{size or ' the same'}{said})"
    return ""


def _listed(ports: tuple[Port, ...]) -> str:
    return _short(", ".join(p.name for p in ports), 80)


def _short(text: str, most: int) -> str:
    return text if len(text) <= most else f"{text[:most].rsplit(', ', 1)[0]}, ..."
