"""SciPy's single-precision BLAS and LAPACK, complex and real, called from compiled code by address."""

from __future__ import annotations

import ctypes
from typing import Any, NamedTuple

import llvmlite.binding as llvm
import numpy as np
from numba import types
from numba.extending import get_cython_function_address
from numpy.typing import NDArray
from threadpoolctl import threadpool_info

from ...kernels.jit import inner_kernel

_PRODUCTS = "scipy_cgemm3m_", "cgemm3m_"


def product_address() -> int:
    """Address of the matrix product of SciPy's OpenBLAS, of three real products for a complex one if it offers that.

    A tenth of a factorisation's time, for residuals up to a fifth larger (decision 0009).
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
llvm.add_symbol("forearm_fem_sgemm", get_cython_function_address("scipy.linalg.cython_blas", "sgemm"))
for _name in ("cgetrf", "cgetri", "sgetrf", "sgetri"):
    llvm.add_symbol(f"forearm_fem_{_name}", get_cython_function_address("scipy.linalg.cython_lapack", _name))


def _external(name: str, count: int) -> Any:
    return types.ExternalFunction(f"forearm_fem_{name}", types.void(*[types.intp] * count))


_product, _sgemm = _external("product", 13), _external("sgemm", 13)
_cgetrf, _cgetri = _external("cgetrf", 6), _external("cgetri", 7)
_sgetrf, _sgetri = _external("sgetrf", 6), _external("sgetri", 7)

BLOCK = 64  # unknowns that pivots are exchanged among
REAL = 4  # bytes of a float, complex numbers have eight
NEITHER, SECOND = (0, 0), (0, 1)  # which factor of a product is transposed


class Arguments(NamedTuple):
    """Memory for what BLAS takes by reference, and for one block; every thread has its own.

    Its numbers are complex64, or float32 for real matrices.
    """

    integers: NDArray[np.int32]
    scalars: NDArray[Any]
    letters: NDArray[np.uint8]
    block: NDArray[Any]
    pivots: NDArray[np.int32]
    work: NDArray[Any]


def arguments(number: type[np.complex64] | type[np.float32]) -> Arguments:
    """Fresh memory for one thread's calls with such numbers."""
    return Arguments(
        np.zeros(16, np.int32),
        np.array([1, 0, -1], number),
        np.frombuffer(b"NT", np.uint8).copy(),
        np.empty(BLOCK * BLOCK, number),
        np.empty(BLOCK, np.int32),
        np.empty(BLOCK * BLOCK, number),
    )


@inner_kernel
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
    first, second, bytes_ = letter + transposed[0], letter + transposed[1], call.scalars.itemsize
    alpha, beta = scalar + bytes_ * scaled[0], scalar + bytes_ * scaled[1]
    m, n, k, d, e, f = integer, integer + 4, integer + 8, integer + 12, integer + 16, integer + 20
    if bytes_ == REAL:
        _sgemm(first, second, m, n, k, alpha, a, d, b, e, beta, c, f)
    else:
        _product(first, second, m, n, k, alpha, a, d, b, e, beta, c, f)


@inner_kernel
def set_product(call: Any, size: Any, a: int, lda: int, b: int, ldb: int, c: int, ldc: int) -> None:
    """C = A B: ``size`` (rows of C, columns of C, columns of A), addresses and leading dimensions."""
    _gemm(call, size, a, lda, b, ldb, c, ldc, NEITHER, (0, 1))


@inner_kernel
def subtract_product(
    call: Any, size: Any, a: int, lda: int, b: int, ldb: int, c: int, ldc: int, transposed: Any
) -> None:
    """C -= A B, one of which may be ``transposed``; see :func:`set_product`."""
    _gemm(call, size, a, lda, b, ldb, c, ldc, transposed, (2, 0))


@inner_kernel
def invert_block(call: Any, size: int) -> bool:
    """Invert the dense matrix (size, size) in ``call.block`` where it lies; False where it is singular."""
    integers = call.integers
    integers[8], integers[9], integers[10] = size, call.work.size, 0
    n, length, info = integers.ctypes.data + 32, integers.ctypes.data + 36, integers.ctypes.data + 40
    block, pivots = call.block.ctypes.data, call.pivots.ctypes.data
    if call.block.itemsize == REAL:
        _sgetrf(n, n, block, n, pivots, info)
        if integers[10] == 0:
            _sgetri(n, block, n, pivots, call.work.ctypes.data, length, info)
    else:
        _cgetrf(n, n, block, n, pivots, info)
        if integers[10] == 0:
            _cgetri(n, block, n, pivots, call.work.ctypes.data, length, info)
    return bool(integers[10] == 0)
