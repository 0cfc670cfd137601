"""Short rows of column numbers put in order in compiled code: numba's own sort takes seconds to compile."""

from __future__ import annotations

from ...typing import IntArray
from .jit import kernel


@kernel
def sort_in_place(keys: IntArray) -> None:
    """Put ``keys`` (m,) in ascending order; m is a row's entries, some hundreds (Shell 1959, gaps of Knuth)."""
    gap = 1
    while 3 * gap + 1 < len(keys):
        gap = 3 * gap + 1
    while gap:
        for k in range(gap, len(keys)):
            key, at = keys[k], k
            while at >= gap and keys[at - gap] > key:
                keys[at] = keys[at - gap]
                at -= gap
            keys[at] = key
        gap //= 3
