"""Right-hand sides of the recursion A_0 x_k = - sum_j A_j x_(k-j) for Taylor coefficients of solutions.

The Taylor matrices A_j are weighted sums of the operator's terms, so each of those is multiplied once with each x_k,
and what it gives is handed on to all later right-hand sides it belongs to.
"""

from __future__ import annotations

import numpy as np

from ...typing import BoolArray, ComplexArray, IntArray
from ..assembly.operator import AffineOperator


class TaylorRecursion:
    """Sums up the right-hand sides about ``omega`` [rad/s], in units of omega^k, as coefficients become known.

    ``orders`` (n_port,) are the highest orders wanted of each column; coefficient k has the columns with order k or
    more. A coefficient may be added in pieces, as what is added enters linearly.
    """

    def __init__(self, operator: AffineOperator, omega: float, orders: IntArray) -> None:
        self._matrices, self._orders = operator.matrices, orders
        powers = omega ** np.arange(int(orders.max()) + 1)
        self._weights = np.array([t.coefficient.taylor(omega, len(powers) - 1) * powers for t in operator.terms])
        self._sums: dict[int, ComplexArray] = {}

    def right(self, k: int) -> ComplexArray:
        """Right-hand sides (n, columns with order k or more) from what was added so far."""
        return self._sums[k]

    def add(self, x: ComplexArray, k: int, *, product: bool = False) -> ComplexArray | None:
        """Note ``x`` (n, columns with order k or more) as a piece of coefficient k; A_0 x where ``product`` is set."""
        later = [j for j in range(1, self._weights.shape[1] - k) if self._weights[:, j].any()]
        totals = [self._total(k, k + j, x) for j in later]
        weights = [-self._weights[:, j] for j in later]
        whole = np.zeros(x.shape, dtype=complex) if product else None
        if whole is not None:
            totals, weights = [*totals, whole], [*weights, self._weights[:, 0]]
        if totals:
            self._matrices.add_products_in_place(totals, np.array(weights), x)
        for j, total in zip(later, totals, strict=False):
            if k + j not in self._sums:
                self._sums[k + j] = np.ascontiguousarray(total[:, self._going_on(k, k + j)])
            elif total is not self._sums[k + j]:
                self._sums[k + j] += total[:, self._going_on(k, k + j)]
        return whole

    def _total(self, k: int, later: int, x: ComplexArray) -> ComplexArray:
        """What coefficient k's part of a later right-hand side is added to: itself where their columns are the same."""
        if later in self._sums and self._going_on(k, later).all():
            return self._sums[later]
        return np.zeros(x.shape, dtype=complex)

    def _going_on(self, before: int, k: int) -> BoolArray:
        """Which columns of coefficient ``before`` coefficient ``k`` has as well."""
        return np.asarray(self._orders[self._orders >= before] >= k)
