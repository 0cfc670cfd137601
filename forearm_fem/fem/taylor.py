"""Right-hand sides of the recursion A_0 x_k = - sum_j A_j x_(k-j) for Taylor coefficients of solutions.

The Taylor matrices A_j are weighted sums of few real matrices, so each of those is multiplied once with each x_k, and
what it gives is handed on to all later right-hand sides it belongs to.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..typing import BoolArray, ComplexArray, IntArray
from .coefficients import Coefficient
from .symmetric import SymmetricMatrix


class TaylorRecursion:
    """Sums up the right-hand sides about ``omega`` [rad/s], in units of omega^k, as coefficients become known.

    ``orders`` (n_port,) are the highest orders wanted of each column; coefficient k has the columns with order k or
    more. A coefficient may be added in pieces, as what is added enters linearly.
    """

    def __init__(self, parts: Sequence[tuple[SymmetricMatrix, Coefficient]], omega: float, orders: IntArray) -> None:
        self._orders = orders
        powers = omega ** np.arange(int(orders.max()) + 1)
        self._parts = [(matrix, c.taylor(omega, len(powers) - 1) * powers) for matrix, c in parts]
        self._sums: dict[int, ComplexArray] = {}

    def right(self, k: int) -> ComplexArray:
        """Right-hand sides (n, columns with order k or more) from what was added so far."""
        return self._sums[k]

    def add(self, x: ComplexArray, k: int, *, product: bool = False) -> ComplexArray | None:
        """Note ``x`` (n, columns with order k or more) as a piece of coefficient k; A_0 x where ``product`` is set."""
        total = np.zeros_like(x) if product else None
        for matrix, weights in self._parts:
            later = [j for j in range(1, len(weights) - k) if weights[j] != 0]
            if not later and total is None:
                continue
            y = matrix.product(x)
            for j in later:
                self._subtract(k + j, weights[j] * _taken(y, self._going_on(k, k + j)))
            if total is not None:
                total += weights[0] * y
        return total

    def _subtract(self, k: int, y: ComplexArray) -> None:
        if k in self._sums:
            self._sums[k] -= y
        else:
            self._sums[k] = -y

    def _going_on(self, before: int, k: int) -> BoolArray:
        """Which columns of coefficient ``before`` coefficient ``k`` has as well."""
        return np.asarray(self._orders[self._orders >= before] >= k)


def _taken(y: ComplexArray, chosen: BoolArray) -> ComplexArray:
    return y if chosen.all() else y[:, chosen]
