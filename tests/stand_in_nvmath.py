"""What nvmath-python 1.0 offers of cuDSS, by SuperLU: it refuses what DirectSolver refuses, as read in its source.

Shapes, strides, types and numbers of entries must stay as they were planned, right-hand sides lie by columns, steps
have an order, and nothing works after ``free``.
"""

from __future__ import annotations

import enum
from importlib.machinery import ModuleSpec
from types import ModuleType

import numpy as np
from scipy.sparse import csc_array, csr_array, triu
from scipy.sparse.linalg import splu


class MatrixType(enum.IntEnum):
    GENERAL, SYMMETRIC = 0, 1


class ViewType(enum.IntEnum):
    FULL, LOWER, UPPER = 0, 1, 2


def _kind(a):
    return a.dtype, a.indices.dtype, a.indptr.dtype, a.shape, a.nnz


class DirectSolver:
    """Like ``nvmath.sparse.advanced.DirectSolver`` without batches."""

    def __init__(self, a, b, *, options=None, execution=None, stream=None):
        assert isinstance(a, csr_array)
        if {str(a.indices.dtype), str(a.indptr.dtype)} != {"int32"} or a.dtype != b.dtype:
            raise TypeError("index type or dtypes")
        if not b.flags.f_contiguous:
            raise TypeError("column-major layout")
        if (triu(a) != a).nnz or options["sparse_system_type"] != MatrixType.SYMMETRIC:
            raise TypeError("not the upper triangle of a symmetric matrix")
        assert options["sparse_system_view"] == ViewType.UPPER
        self._a, self._b, self._done = a, b, {"new"}

    def _needs(self, step):
        if step not in self._done:
            raise RuntimeError(f"not before {step}")

    def plan(self):
        self._needs("new")
        self._done.add("plan")

    def reset_operands(self, *, a=None, b=None, stream=None):
        self._needs("new")
        if a is None and b is None:
            raise ValueError("at least one operand")
        if a is not None and _kind(a) != _kind(self._a):
            raise TypeError("another pattern or type of 'a'")
        if b is not None and (b.dtype, b.shape, b.strides) != (self._b.dtype, self._b.shape, self._b.strides):
            raise TypeError("another shape or type of 'b'")
        self._a, self._b = self._a if a is None else a, self._b if b is None else b

    def factorize(self):
        self._needs("plan")
        full = csc_array(self._a + self._a.T)
        full.setdiag(self._a.diagonal())
        self._lu = splu(full.astype(self._a.dtype))
        self._done.add("factorize")

    def solve(self):
        self._needs("factorize")
        return np.asfortranarray(self._lu.solve(self._b).astype(self._b.dtype))

    def free(self):
        self._done = set()


def modules() -> dict[str, ModuleType]:
    """Name -> module, for ``sys.modules``."""
    names = ("nvmath", "nvmath.sparse", "nvmath.sparse.advanced")
    found = {name: ModuleType(name) for name in names}
    for name, module in found.items():
        module.__spec__ = ModuleSpec(name, None)
    vars(found[names[-1]]).update(
        DirectSolver=DirectSolver, DirectSolverMatrixType=MatrixType, DirectSolverMatrixViewType=ViewType
    )
    return found
