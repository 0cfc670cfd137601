"""A first run compiles kernels: most of them in a process beside, while the mesh is made and matrices are assembled.

numba keeps what it compiled on disk, so that what the process has finished is only read when the run gets there, and
what it has not is compiled as it always was. The assembly's kernels are needed first and are left to the run.
"""

from __future__ import annotations

import atexit
import gc
import subprocess
import sys
from functools import lru_cache
from pathlib import Path
from threading import Thread

import numpy as np
from scipy.sparse import csr_array, diags_array, triu

from ...typing import FloatArray
from ..kernels.compiled import compiled
from ..kernels.matrices import SymmetricMatrices
from .basis import Basis

_UNKNOWNS, _PRESSURES, _LOADS = 40, 4, 4


@lru_cache  # once a process
def start_compiling() -> None:
    """Start that process where kernels have not been compiled since they were installed, else do nothing.

    It ends with this one. Without numba, or a place for what it compiles, there is nothing to start.
    """
    factor = compiled("linear.multifrontal.factor")
    if factor is None or not sys.executable:
        return
    if are_kept(Path(factor.backward.stats.cache_path), Path(str(factor.__file__))):
        return
    quiet = subprocess.DEVNULL
    process = subprocess.Popen([sys.executable, "-m", __name__], stdin=quiet, stdout=quiet, stderr=quiet)
    atexit.register(process.terminate)  # whole files are put into place: none is left half-written
    Thread(target=process.wait, daemon=True).start()


def are_kept(folder: Path, source: Path) -> bool:
    """Whether ``folder`` has numba's index of the substitution's kernels, not older than the module ``source``."""
    return any(index.stat().st_mtime >= source.stat().st_mtime for index in folder.glob("*.backward-*.nbi"))


def compile_kernels() -> None:
    """Factorise and solve once in real numbers and in complex ones, and project, on a chain of springs.

    Arrays are of the types that a run has: numba compiles for types.
    """
    factor = compiled("linear.multifrontal.factor")
    if factor is None:
        return
    chain = triu(diags_array([[4.0] * _UNKNOWNS, [-1.0] * (_UNKNOWNS - 1)], offsets=[0, 1]), format="csr")
    starts, columns = chain.indptr.astype(np.int64), chain.indices.astype(np.int64)
    upper = csr_array((chain.data, columns, starts), shape=chain.shape)
    solver = factor.MultifrontalFactor(upper, _UNKNOWNS - _PRESSURES, np.arange(_UNKNOWNS))
    loads = np.ones((_UNKNOWNS, _LOADS))
    solver.factorise(upper.data)
    solver.solve(loads)
    _project(upper, loads)
    solver.factorise(upper.data.astype(complex))  # for ends that are held otherwise; certificates take no factors
    solver.solve(loads.astype(complex))


def _project(upper: csr_array, loads: FloatArray) -> None:
    matrices, weights, turning = SymmetricMatrices.from_uppers([upper]), np.ones((1, 1)), loads.astype(complex)
    matrices.add_products_in_place([turning.copy()], weights.astype(complex), turning)
    matrices.real_sum(weights, [loads])
    single = loads.astype(np.float32)
    matrices.products(single)(0, slice(0, _UNKNOWNS))
    for block in (single, single[:, :-1]):  # a basis has whole blocks and parts of some
        basis = Basis().with_block(block)
        basis.subtract_in_place(loads.copy(), basis.inner(loads))


if __name__ == "__main__":
    gc.disable()  # what compiling makes is kept to the end: going through it again and again took an eighth of the time
    compile_kernels()
