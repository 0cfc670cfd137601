"""A first run compiles kernels: those of factors and of products in two processes beside, while the mesh is made and
matrices are assembled, complex ones in a third while derivatives are.

What is compiled is kept on disk, so that a run that waits for such a process only reads it there. The assembly's
kernels are needed first and are left to the run.
"""

from __future__ import annotations

import atexit
import gc
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from functools import lru_cache
from threading import Thread
from typing import Any

import numpy as np
from scipy.sparse import csr_array, diags_array, triu

from ...progress import Progress, tell
from ...typing import FloatArray
from ..kernels.compiled import compiled
from ..kernels.matrices import SymmetricMatrices
from .basis import Basis

PARTS = ("factors", "products", "complex factors")
_UNKNOWNS, _PRESSURES, _LOADS = 40, 4, 4
_PATIENCE = 1.0  # s between two signs of life


@lru_cache  # once a process
def start_compiling() -> tuple[subprocess.Popen[bytes], ...]:
    """Start the first two of these processes where kernels have not been compiled since they were installed.

    They end with this one. Without a place for what they compile there is nothing to start.
    """
    factor = compiled("linear.multifrontal.factor")
    if factor is None or not sys.executable:
        return ()
    if are_kept(factor.backward):
        return ()
    return _process("factors"), _process("products")


def finish_compiling(progress: Progress | None = None, *, complex_ones: bool = True) -> None:
    """Wait for what :func:`start_compiling` started, then start the last process if ``complex_ones`` will be needed;
    nothing where none was started.

    Compiling the same here would take as long, and a core from the others. What a process did not get done the run
    compiles as it meets it.
    """
    processes = start_compiling() if start_compiling.cache_info().currsize else ()
    for done, process in enumerate(processes):
        while process.poll() is None:
            tell(progress, "compiling, once", done, len(processes))
            with suppress(subprocess.TimeoutExpired):
                process.wait(_PATIENCE)
    if processes and complex_ones:
        _start_last()


@lru_cache
def _start_last() -> None:
    _process("complex factors")


def _process(part: str) -> subprocess.Popen[bytes]:
    quiet = subprocess.DEVNULL
    process = subprocess.Popen([sys.executable, "-m", __name__, part], stdin=quiet, stdout=quiet, stderr=quiet)
    atexit.register(process.terminate)  # whole files are put into place: none is left half-written
    Thread(target=process.wait, daemon=True).start()
    return process


def are_kept(kernel: Any) -> bool:
    """True if ``kernel`` was compiled by this version before, or could not be kept for another process."""
    kept = getattr(kernel._cache, "is_kept", None)
    return kept is None or bool(kept())


def compile_kernels(parts: Sequence[str] = PARTS) -> None:
    """Factorise and solve once in real numbers or in complex ones, and project, on a chain of springs.

    Arrays are of the types that a run has: numba compiles for types.
    """
    factor = compiled("linear.multifrontal.factor")
    if factor is None:
        return
    chain = triu(diags_array([[4.0] * _UNKNOWNS, [-1.0] * (_UNKNOWNS - 1)], offsets=[0, 1]), format="csr")
    upper, loads = csr_array(chain), np.ones((_UNKNOWNS, _LOADS))
    if "products" in parts:
        _project(upper, loads)
    for part, number in (("factors", float), ("complex factors", complex)):  # the latter for ends held otherwise
        if part in parts:
            solver = factor.MultifrontalFactor(upper, _UNKNOWNS - _PRESSURES, np.arange(_UNKNOWNS))
            solver.factorise(upper.data.astype(number))
            solver.solve(loads.astype(number))


def _project(upper: csr_array, loads: FloatArray) -> None:
    matrices, weights, turning = SymmetricMatrices.from_uppers([upper]), np.ones((1, 1)), loads.astype(complex)
    matrices.add_products_in_place([turning.copy()], weights.astype(complex), turning)
    single = loads.astype(np.float32)
    for number in (float, complex):
        matrices.upper_sum(np.ones(1, number), upper.indptr, upper.indices)
    for columns in (loads, single):
        matrices.real_sum(weights, [columns])
    matrices.products(single)(0, slice(0, _UNKNOWNS))
    basis = Basis().with_block(single)
    basis.subtract_in_place(loads.copy(), basis.inner(loads))


if __name__ == "__main__":
    gc.disable()  # what compiling makes is kept to the end: going through it again and again took an eighth of the time
    compile_kernels(sys.argv[1:])
