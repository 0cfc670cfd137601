"""MKL PARDISO for complex symmetric matrices (mtype 6), called through the C interface of ``mkl_rt``.

Only the upper triangle is stored and factorised. Matching lets zero pivots on the diagonal pass, as incompressible
tissue has them; nearly incompressible limbs are factorised a quarter faster without.
"""

from __future__ import annotations

import ctypes
import os
import sys
import sysconfig
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from ...errors import SolverError
from ...typing import ComplexArray, FloatArray, IntArray

_COMPLEX_SYMMETRIC = 6
_ANALYSE, _FACTORISE, _SOLVE, _RELEASE = 11, 22, 33, -1
_MESSAGES = {
    -2: "not enough memory",
    -3: "reordering failed",
    -4: "zero pivot: the system is singular at this frequency",
    -7: "the diagonal matrix is singular",
    -9: "not enough memory for the out-of-core mode",
}


@lru_cache(maxsize=1)
def mkl_library() -> ctypes.CDLL | None:
    """The MKL runtime, or None where it is not installed or FOREARM_FEM_MKL is "off" in the environment."""
    if os.environ.get("FOREARM_FEM_MKL") == "off":
        return None
    # files named mkl_rt inside this environment first: wheels put them off the loader's path
    roots = {Path(sysconfig.get_path("data")), Path(sys.prefix), Path(sys.base_prefix)}
    folders = [root / sub for root in roots for sub in ("lib", "Library/bin")]
    found = [
        str(f) for folder in folders for f in sorted(folder.glob("*mkl_rt*")) if ".so" in f.name or ".dll" in f.name
    ]
    for candidate in (*found, "libmkl_rt.so", "libmkl_rt.so.2", "mkl_rt.2.dll"):
        try:
            return ctypes.CDLL(candidate)
        except OSError:
            continue
    return None


class PardisoFactor:
    """One analysis, any number of numerical factorisations of matrices with the same pattern.

    ``upper`` holds the upper triangle in CSR with sorted indices and every diagonal entry stored.
    ``order`` (n,) is that of elimination (:mod:`.ordering`), PARDISO's own where it is None or with matching.
    With ``single`` the factors are kept in single precision: half the memory, residual about 5e-5.
    """

    name = "pardiso"

    def __init__(
        self, upper: csr_array, order: IntArray | None = None, *, single: bool = False, matching: bool = True
    ) -> None:
        mkl = mkl_library()
        if mkl is None:
            raise SolverError("MKL PARDISO is not installed; python3 -m pip install mkl, or solver.backend='superlu'")
        self._mkl = mkl
        self.single = single
        self._matching = matching
        self._handle = np.zeros(64, dtype=np.int64)
        self._indptr = upper.indptr.astype(np.int32)
        self._indices = upper.indices.astype(np.int32)
        self.n = int(upper.shape[0])
        self._order = None if order is None or matching else order.astype(np.int32)  # matching needs its own
        self._analyse(upper.data)

    def _analyse(self, data: ComplexArray | FloatArray) -> None:
        self._dtype = np.complex64 if self.single else np.complex128
        parameters = self._parameters = np.zeros(64, dtype=np.int32)
        parameters[0] = 1  # own values below, not the defaults
        parameters[1] = 2  # nested dissection (METIS), where it is not given
        parameters[4] = int(self._order is not None)
        parameters[9] = 8  # perturb pivots below 1e-8 |A|
        parameters[10] = 1  # scaling
        parameters[12] = int(self._matching)  # symmetric weighted matching
        parameters[17] = -1  # count the factors' entries
        parameters[20] = 1  # Bunch-Kaufman pivoting
        parameters[27] = int(self.single)
        parameters[34] = 1  # zero-based indices
        self._data = np.ascontiguousarray(data, dtype=self._dtype)
        self._run(_ANALYSE)

    def factorise(self, data: ComplexArray | FloatArray) -> None:
        """Numerical factorisation for new values ``data`` on the pattern analysed; real ones become complex."""
        self._real = not np.iscomplexobj(data)
        self._data = np.ascontiguousarray(data, dtype=self._dtype)
        self._run(_FACTORISE)

    def products(self, data: ComplexArray | FloatArray, right: NDArray[Any]) -> ComplexArray | None:
        """See :class:`.factor.Factor`; this one cannot."""
        return None

    def harden(self, data: ComplexArray | FloatArray) -> bool:
        """Factorise this matrix and all later ones with matching, at the next call in double precision, then False."""
        if self._matching and not self.single:
            return False
        self.release()
        self.single = self.single and not self._matching
        self._matching, self._order = True, None
        self._analyse(data)
        self._run(_FACTORISE)
        return True

    def solve(self, right: NDArray[Any]) -> NDArray[Any]:
        """Solutions (n, k) of the factorised system for right-hand sides (n, k); no outer refinement."""
        b: Any = np.asfortranarray(right.reshape(self.n, -1), dtype=self._dtype)
        x: Any = np.zeros_like(b, order="F")
        self._run(_SOLVE, b, x)
        x = x.astype(np.complex128).reshape(right.shape)
        return np.asarray(x.real if self._real else x)

    @property
    def factor_bytes(self) -> float:
        """Peak memory of the factorisation as PARDISO states it after the analysis [bytes]."""
        return 1024.0 * max(int(self._parameters[14]), int(self._parameters[15]) + int(self._parameters[16]))

    @property
    def entries(self) -> int:
        """Entries of the factors, by the analysis."""
        return int(self._parameters[17])

    @property
    def perturbed_pivots(self) -> int:
        """Pivots that had to be perturbed in the last factorisation."""
        return int(self._parameters[13])

    def release(self) -> None:
        """Give the factor's memory back."""
        if self._handle.any():
            self._run(_RELEASE)
            self._handle[:] = 0

    def __del__(self) -> None:
        try:
            self.release()
        except Exception:
            return

    def _run(self, phase: int, b: ComplexArray | None = None, x: ComplexArray | None = None) -> None:
        columns = 1 if b is None else b.shape[1]
        empty = np.zeros(1, dtype=self._dtype)
        order = np.zeros(1, dtype=np.int32) if self._order is None else self._order
        error = ctypes.c_int(0)
        self._mkl.pardiso(
            _pointer(self._handle), _integer(1), _integer(1), _integer(_COMPLEX_SYMMETRIC), _integer(phase),
            _integer(self.n), _pointer(self._data), _pointer(self._indptr), _pointer(self._indices),
            _pointer(order), _integer(columns), _pointer(self._parameters), _integer(0),
            _pointer(empty if b is None else b), _pointer(empty if x is None else x), ctypes.byref(error),
        )  # fmt: skip
        if error.value:
            raise SolverError(f"PARDISO: {_MESSAGES.get(error.value, f'error {error.value}')} (n = {self.n})")


def _integer(value: int) -> ctypes._Pointer[ctypes.c_int]:
    return ctypes.pointer(ctypes.c_int(value))


def _pointer(array: NDArray[Any]) -> ctypes.c_void_p:
    return array.ctypes.data_as(ctypes.c_void_p)
