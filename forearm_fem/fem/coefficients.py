"""Scalar functions of frequency that multiply the operator's real matrices."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..typing import ComplexArray, FloatArray


class Coefficient(Protocol):
    """theta(omega) and its Taylor coefficients; time dependence e^{+i omega t}."""

    def at(self, omega: FloatArray) -> ComplexArray:
        """Values (n,) at angular frequencies (n,) [rad/s]."""
        ...

    def taylor(self, omega0: float, n: int) -> ComplexArray:
        """Coefficients c_0 ... c_n of theta(omega0 + d) = sum_k c_k d^k."""
        ...


@dataclass(frozen=True)
class Polynomial:
    """theta = constant + i omega rate - omega^2 inertia: springs, dashpots and masses."""

    constant: float = 0.0
    rate: float = 0.0
    inertia: float = 0.0

    def at(self, omega: FloatArray) -> ComplexArray:
        """See :class:`Coefficient`."""
        w = np.asarray(omega, dtype=float)
        return self.constant + 1j * w * self.rate - w**2 * self.inertia

    def taylor(self, omega0: float, n: int) -> ComplexArray:
        """See :class:`Coefficient`."""
        terms = [complex(self.at(np.array(omega0))), 1j * self.rate - 2 * omega0 * self.inertia, -self.inertia]
        return np.array((terms + [0.0] * n)[: n + 1], dtype=complex)


def is_polynomial(coefficient: Coefficient) -> bool:
    """Whether it is of second degree in omega at most; asked beside zero, where a springpot has no series."""
    return not coefficient.taylor(1.0, 3)[3]


def polynomial_weights(taylor: ComplexArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Weights (n,) of 1, i omega and -omega^2 from Taylor coefficients (n, 3) about zero."""
    return taylor[:, 0].real, (taylor[:, 1] / 1j).real, (-taylor[:, 2]).real
