"""Products of a real sparse matrix with a few columns by MKL: twice as fast as scipy's (docs/decisions.md)."""

from __future__ import annotations

import ctypes

import numpy as np
from scipy.sparse import csr_array

from ..errors import SolverError
from ..typing import FloatArray
from .pardiso import library

_AS_IT_IS, _GENERAL, _BY_ROWS, _ZERO_BASED = 10, 20, 101, 0


class _Description(ctypes.Structure):
    """``struct matrix_descr`` of MKL's inspector-executor routines; the last two are for triangular matrices."""

    _fields_ = (("type", ctypes.c_int), ("mode", ctypes.c_int), ("diagonal", ctypes.c_int))


class MklMatrix:
    """A real matrix (m, n) in CSR that MKL multiplies; raises SolverError where MKL refuses it or is missing."""

    def __init__(self, matrix: csr_array) -> None:
        mkl = library()
        if mkl is None:
            raise SolverError("MKL is not installed; python3 -m pip install mkl")
        self._mkl, self._shape = mkl, matrix.shape
        self._data = np.ascontiguousarray(matrix.data, dtype=np.float64)
        self._indptr, self._indices = matrix.indptr.astype(np.int32), matrix.indices.astype(np.int32)
        self._handle = ctypes.c_void_p()
        starts, ends = self._indptr[:-1], self._indptr[1:]
        state = mkl.mkl_sparse_d_create_csr(
            ctypes.byref(self._handle), _ZERO_BASED, self._shape[0], self._shape[1],
            *(a.ctypes.data_as(ctypes.c_void_p) for a in (starts, ends, self._indices, self._data)),
        )  # fmt: skip
        _check(state)

    def product(self, x: FloatArray) -> FloatArray:
        """A x for real columns ``x`` (n, k); raises ValueError for another n, beyond which MKL would read."""
        if len(x) != self._shape[1]:
            raise ValueError(f"a matrix of {self._shape[1]} columns was given {len(x)} rows")
        x = np.ascontiguousarray(x, dtype=np.float64)
        y = np.empty((self._shape[0], x.shape[1]))
        _check(
            self._mkl.mkl_sparse_d_mm(
                _AS_IT_IS, ctypes.c_double(1.0), self._handle, _Description(_GENERAL), _BY_ROWS,
                x.ctypes.data_as(ctypes.c_void_p), x.shape[1], x.shape[1],
                ctypes.c_double(0.0), y.ctypes.data_as(ctypes.c_void_p), x.shape[1],
            )
        )  # fmt: skip
        return y

    def __del__(self) -> None:
        if getattr(self, "_handle", None):
            self._mkl.mkl_sparse_destroy(self._handle)


def _check(state: int) -> None:
    if state:
        raise SolverError(f"MKL's sparse product failed with status {state}")
