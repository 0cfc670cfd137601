"""NVIDIA cuDSS for complex symmetric matrices, through nvmath-python (extra "cudss"): only where it is asked for.

Factors stay on the device; matrices and right-hand sides go there and solutions come back. Run on one device with
nvmath-python 1.0 and cuDSS 0.8; elsewhere tested with a stand-in that refuses what that refuses
(tests/stand_in_nvmath.py).
"""

from __future__ import annotations

import ctypes
import importlib.util
import logging
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from ...errors import SolverError
from ...typing import ComplexArray, FloatArray

T = TypeVar("T")
_AT_ONCE = 16  # right-hand sides: the library takes as many each time as were planned for
_DRIVERS = ("libcuda.so.1", "nvcuda.dll")
_log = logging.getLogger("forearm_fem.fem.cudss")
_log.setLevel(logging.ERROR)  # it warns at each new matrix that a factorisation has to follow, which it does here


def device_count() -> int:
    """CUDA devices that the driver of this machine offers, 0 where there is no driver."""
    for name in _DRIVERS:
        try:
            driver = ctypes.CDLL(name)
        except OSError:
            continue
        count = ctypes.c_int(0)
        return 0 if driver.cuInit(0) or driver.cuDeviceGetCount(ctypes.byref(count)) else count.value
    return 0


def _threading_layer() -> str | None:
    """The file by which cuDSS plans in several threads, where its wheel lies; without it the library warns."""
    wheels = importlib.util.find_spec("nvidia")
    roots = wheels.submodule_search_locations if wheels is not None else None
    found = sorted(str(f) for root in roots or () for f in Path(root).glob("*/*/*cudss_mtlayer_*"))
    return found[0] if found else None


def available() -> bool:
    """True if nvmath-python is installed and there is a device."""
    return importlib.util.find_spec("nvmath") is not None and device_count() > 0


def require() -> None:
    """Raise :class:`SolverError` naming what is missing."""
    if importlib.util.find_spec("nvmath") is None:
        missing = "nvmath-python is not installed (python3 -m pip install 'forearm-fem[cudss]')"
    elif device_count() == 0:
        missing = "no CUDA device was found"
    else:
        return
    raise SolverError(f"solver.backend = 'cudss': {missing}; set solver.backend = 'auto'")


class CudssFactor:
    """One analysis on the device, any number of factorisations of matrices with the same pattern.

    ``upper`` holds the upper triangle in CSR with sorted indices. Real matrices are factorised as complex ones: a
    second analysis would cost more than that saves. Raises SolverError for what the library or the driver refuses.
    """

    name = "cudss"

    def __init__(self, upper: csr_array, *, single: bool = False) -> None:
        require()
        self.single = single
        self.n = int(upper.shape[0])
        self._indices, self._indptr = upper.indices.astype(np.int32), upper.indptr.astype(np.int32)
        self._analyse(upper.data)

    def _analyse(self, data: ComplexArray | FloatArray) -> None:
        library = _told(lambda: import_module("nvmath.sparse.advanced"))
        self._dtype: Any = np.complex64 if self.single else np.complex128
        options = {
            "sparse_system_type": library.DirectSolverMatrixType.SYMMETRIC,
            "sparse_system_view": library.DirectSolverMatrixViewType.UPPER,
            "logger": _log,
            "multithreading_lib": _threading_layer(),
        }
        matrix, columns = self._matrix(data), self._columns(np.zeros((self.n, 0)))
        self._solver = _told(lambda: library.DirectSolver(matrix, columns, options=options))
        _told(self._solver.plan)

    def _matrix(self, data: ComplexArray | FloatArray) -> csr_array:
        return csr_array((data.astype(self._dtype), self._indices, self._indptr), shape=(self.n, self.n))

    def _columns(self, right: NDArray[Any]) -> NDArray[Any]:
        """``right`` (n, k <= 16) by columns, filled up with zeros."""
        columns = np.zeros((self.n, _AT_ONCE), dtype=self._dtype, order="F")
        columns[:, : right.shape[1]] = right
        return columns

    def factorise(self, data: ComplexArray | FloatArray) -> None:
        """See :class:`.factor.Factor`."""
        self._real = not np.iscomplexobj(data)
        _told(lambda: self._solver.reset_operands(a=self._matrix(data)))
        _told(self._solver.factorize)

    def solve(self, right: NDArray[Any]) -> NDArray[Any]:
        """See :class:`.factor.Factor`."""
        pieces = (right[:, k : k + _AT_ONCE] for k in range(0, right.shape[1], _AT_ONCE))
        x = np.hstack([self._solved(piece) for piece in pieces]).astype(complex)
        return np.asarray(x.real) if self._real else x

    def _solved(self, right: NDArray[Any]) -> NDArray[Any]:
        _told(lambda: self._solver.reset_operands(b=self._columns(right)))
        found: NDArray[Any] = _told(self._solver.solve)
        return found[:, : right.shape[1]]

    def products(self, data: ComplexArray | FloatArray, right: NDArray[Any]) -> ComplexArray | None:
        """See :class:`.factor.Factor`; factors lie on the device and are in nobody's way."""
        return None

    def harden(self, data: ComplexArray | FloatArray) -> bool:
        """See :class:`.factor.Factor`: in double precision."""
        if not self.single:
            return False
        self.release()
        self.single = False
        self._analyse(data)
        self.factorise(data)
        return True

    def release(self) -> None:
        """See :class:`.factor.Factor`."""
        self._solver.free()


def _told(call: Callable[[], T]) -> T:
    """Result of ``call``; exceptions of the library, of many classes, become a named error."""
    try:
        return call()
    except Exception as problem:
        first = next(iter(str(problem).strip().splitlines()), type(problem).__name__)
        raise SolverError(f"cuDSS: {first}; set solver.backend = 'auto' to solve without the device") from problem
