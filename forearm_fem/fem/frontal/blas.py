"""SciPy's single-precision complex BLAS and LAPACK, called from compiled code by address."""

from __future__ import annotations

import ctypes
from typing import Any, NamedTuple

import llvmlite.binding as llvm
import numpy as np
from numba import njit, types
from numba.extending import get_cython_function_address
from numpy.typing import NDArray
from threadpoolctl import threadpool_info

_PRODUCTS = "scipy_cgemm3m_", "cgemm3m_"


def product_address() -> int:
    """Where SciPy's OpenBLAS multiplies matrices, by three real products for a complex one if it offers that.

    A tenth of a factorisation's time, for residuals up to a fifth larger (docs/decisions.md).
    """
    usual = int(get_cython_function_address("scipy.linalg.cython_blas", "cgemm"))
    for pool in threadpool_info():
        if pool["internal_api"] == "openblas":
            library = ctypes.CDLL(pool["filepath"])
            for name in _PRODUCTS:
                if (found := getattr(library, name, None)) is not None:
                    return int(ctypes.cast(found, ctypes.c_void_p).value or usual)
    return usual


llvm.add_symbol("forearm_fem_product", product_address())
llvm.add_symbol("forearm_fem_cgetrf", get_cython_function_address("scipy.linalg.cython_lapack", "cgetrf"))
llvm.add_symbol("forearm_fem_cgetri", get_cython_function_address("scipy.linalg.cython_lapack", "cgetri"))
_product: Any = types.ExternalFunction("forearm_fem_product", types.void(*[types.intp] * 13))
_cgetrf: Any = types.ExternalFunction("forearm_fem_cgetrf", types.void(*[types.intp] * 6))
_cgetri: Any = types.ExternalFunction("forearm_fem_cgetri", types.void(*[types.intp] * 7))

BLOCK = 64  # unknowns that pivots are exchanged among
BYTES = 8  # of a complex64
NEITHER, SECOND = (0, 0), (0, 1)  # which factor of a product is transposed


class Arguments(NamedTuple):
    """Memory for what BLAS takes by reference, and for one block; every thread has its own."""

    integers: NDArray[np.int32]
    scalars: NDArray[np.complex64]
    letters: NDArray[np.uint8]
    block: NDArray[np.complex64]
    pivots: NDArray[np.int32]
    work: NDArray[np.complex64]


def arguments() -> Arguments:
    """Fresh memory for one thread's calls."""
    return Arguments(
        np.zeros(16, np.int32),
        np.array([1, 0, -1], np.complex64),
        np.frombuffer(b"NT", np.uint8).copy(),
        np.empty(BLOCK * BLOCK, np.complex64),
        np.empty(BLOCK, np.int32),
        np.empty(BLOCK * BLOCK, np.complex64),
    )


@njit(cache=True, nogil=True)
def _gemm(
    call: Any, size: Any, a: int, lda: int, b: int, ldb: int, c: int, ldc: int, transposed: Any, scaled: Any
) -> None:
    if size[0] == 0 or size[1] == 0 or size[2] == 0:
        return
    integers = call.integers
    for i in range(3):
        integers[i] = size[i]
    integers[3], integers[4], integers[5] = lda, ldb, ldc
    letter, scalar, integer = call.letters.ctypes.data, call.scalars.ctypes.data, integers.ctypes.data
    _product(
        letter + transposed[0], letter + transposed[1], integer, integer + 4, integer + 8, scalar + BYTES * scaled[0],
        a, integer + 12, b, integer + 16, scalar + BYTES * scaled[1], c, integer + 20,
    )  # fmt: skip


@njit(cache=True, nogil=True)
def set_product(call: Any, size: Any, a: int, lda: int, b: int, ldb: int, c: int, ldc: int) -> None:
    """C = A B: ``size`` (rows of C, columns of C, columns of A), addresses and leading dimensions."""
    _gemm(call, size, a, lda, b, ldb, c, ldc, NEITHER, (0, 1))


@njit(cache=True, nogil=True)
def subtract_product(
    call: Any, size: Any, a: int, lda: int, b: int, ldb: int, c: int, ldc: int, transposed: Any
) -> None:
    """C -= A B, one of which may be ``transposed``; see :func:`set_product`."""
    _gemm(call, size, a, lda, b, ldb, c, ldc, transposed, (2, 0))


@njit(cache=True, nogil=True)
def invert_block(call: Any, size: int) -> bool:
    """Invert the dense matrix (size, size) in ``call.block`` where it lies; False where it is singular."""
    integers = call.integers
    integers[8], integers[9], integers[10] = size, call.work.size, 0
    n, length, info = integers.ctypes.data + 32, integers.ctypes.data + 36, integers.ctypes.data + 40
    block, pivots = call.block.ctypes.data, call.pivots.ctypes.data
    _cgetrf(n, n, block, n, pivots, info)
    if integers[10] == 0:
        _cgetri(n, block, n, pivots, call.work.ctypes.data, length, info)
    return bool(integers[10] == 0)
