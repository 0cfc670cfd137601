"""A trial: the system at a real rate by MINRES with multigrid, beside its factorisation.

    python3 -m pip install pyamg
    python benchmarks/multigrid.py [--scales 3 2 1.2 0.8 0.55] [--out FOLDER]

At a real rate the displacement block is positive definite, so that nothing of Helmholtz' trouble is left. It is
preconditioned by a V-cycle of smoothed aggregation that knows the rigid motions, the pressures by the diagonal of what
the displacements leave of them. Writes ``multigrid.csv``: unknowns, iterations and processor's seconds with one thread
of a column solved to 1e-9 in the preconditioned norm, its true residual, and the seconds of the single-precision
factorisation and of its refined solve of one column. Without pyamg it says so and ends.
"""

from __future__ import annotations

import argparse
import importlib.util
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import csc_array, csr_array, csr_matrix, triu
from scipy.sparse.linalg import LinearOperator, minres

from bench.isolated import isolated, threads
from bench.scene import quarter
from bench.tables import record_machine, write_csv
from forearm_fem.fem.assembly.coefficients import rate_weights
from forearm_fem.fem.assembly.model import ForearmModel
from forearm_fem.fem.assembly.operator import WeightedSum
from forearm_fem.fem.linear.factor import make_factor, refined_solve
from forearm_fem.fem.reduction.expansion import expansion_rate
from forearm_fem.scenario.sweep import frequencies
from forearm_fem.typing import FloatArray
from forearm_fem.verification.scenes import slab_model

ENOUGH, PATIENCE = 1e-9, 3000  # relative residual in the preconditioned norm, iterations


def main() -> None:
    """Solve at each scale and write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scales", type=float, nargs="+", default=[3.0, 2.0, 1.2, 0.8, 0.55])
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results")
    asked = parser.parse_args()
    if importlib.util.find_spec("pyamg") is None:
        sys.exit("skipped: pyamg is not installed (python3 -m pip install pyamg)")
    rows = list[dict[str, Any]]()
    with threads(1):
        record_machine(asked.out, "multigrid")
        for scale in asked.scales:
            rows.append(isolated(tried, scale))
            print(rows[-1], flush=True)
    write_csv(asked.out / "multigrid.csv", rows)


def tried(scale: float) -> dict[str, Any]:
    """One row: both ways on the quarter slab with elements ``scale`` times as large."""
    import pyamg

    model, marks = slab_model(quarter(), scale=scale), [time.process_time()]
    operator, right = model.operator, model.functionals[:, :1]
    weights = rate_weights([t.coefficient for t in operator.terms], expansion_rate(frequencies(quarter().sweep)))[0]
    data = operator.combine(weights.tolist())
    upper = operator.upper(data)
    whole = csr_array(upper + triu(upper, k=1).T)
    n = operator.n_displacements
    stiffness, coupling = csr_array(whole[:n, :n]), csr_array(whole[n:, :n])
    marks.append(time.process_time())
    grids = pyamg.smoothed_aggregation_solver(csr_matrix(stiffness), B=rigid_motions(model), symmetry="symmetric")
    cycle = grids.aspreconditioner()
    pressures = coupling.power(2) @ (1 / stiffness.diagonal()) + np.abs(whole.diagonal()[n:])
    marks.append(time.process_time())
    counted, shape = [0], (operator.n, operator.n)
    inverse = LinearOperator(shape, lambda x: np.concatenate([cycle @ x[:n], x[n:] / pressures]), dtype=float)

    def count(_: FloatArray) -> None:
        """One iteration more."""
        counted[0] += 1

    found, _ = minres(csr_matrix(whole), right[:, 0], rtol=ENOUGH, maxiter=PATIENCE, M=inverse, callback=count)
    marks.append(time.process_time())
    factor = make_factor(operator, 0.0, "auto", single=True, matching=False)
    factor.factorise(data)
    marks.append(time.process_time())
    solution = refined_solve(factor, WeightedSum(operator.matrices, weights), right, tolerance=ENOUGH)
    marks.append(time.process_time())
    _, setup, column, factorisation, solve = np.diff(marks).tolist()
    rest, off = np.linalg.norm(whole @ found - right[:, 0]), np.linalg.norm(found - solution.values[:, 0])
    return {
        "scale": f"{scale:g}", "unknowns": operator.n, "iterations": counted[0], "seconds_setup": f"{setup:.3g}",
        "seconds_column": f"{column:.3g}", "residual": f"{rest / np.linalg.norm(right):.1e}",
        "off": f"{off / np.linalg.norm(solution.values[:, 0]):.1e}", "seconds_factorisation": f"{factorisation:.3g}",
        "seconds_solve": f"{solve:.3g}",
    }  # fmt: skip


def rigid_motions(model: ForearmModel) -> FloatArray:
    """Three translations and three rotations (n_displacements, 6), of the unknowns as they are after constraints."""
    columns = csc_array(model.constraints.transform)
    first = columns.indices[columns.indptr[:-1]]
    place, along = model.space.node_points[first // 3].T, first % 3
    found = np.zeros((len(first), 6))
    found[np.arange(len(first)), along] = 1
    for axis in range(3):
        after, last = (axis + 1) % 3, (axis + 2) % 3
        found[:, 3 + axis] = np.where(along == after, -place[last], 0) + np.where(along == last, place[after], 0)
    return found


if __name__ == "__main__":
    main()
