"""The quarter slab of `python benchmarks/speed.py` in forearm_fem itself, in the peers' columns.

    python benchmarks/peers_ours.py scene.npz [double|single|assembly]

The mesh is the one in ``scene.npz`` (built again from its scale, not timed). Beside the steps
at the scene's frequencies the whole reduced sweep is timed, from the mesh to G at the 981 bins of 10-500 Hz.
"""

from __future__ import annotations

import json
import resource
import sys

import numpy as np

from bench.isolated import clock
from bench.scene import options, quarter
from forearm_fem import __version__
from forearm_fem.fem.assembly.model import ForearmModel, build_model
from forearm_fem.fem.assembly.tissues import reference_tensors, tissue_matrices
from forearm_fem.fem.kernels.compiled import import_compiled
from forearm_fem.fem.linear.factor import make_factor, refined_solve
from forearm_fem.fem.reduction.sweep import reduced_sweep
from forearm_fem.fem.space.numbering import mixed_space
from forearm_fem.geometry.build import build_mesh
from forearm_fem.geometry.device.place import place_ports
from forearm_fem.geometry.mesh.tissue_mesh import TissueMesh
from forearm_fem.scenario.model import resolve_tissues

BINS = np.arange(10.0, 500.25, 0.5)  # Hz
DISC, POINT = 0, 2  # ports: the contact, and the point at 10 mm


def model_of(mesh: TissueMesh) -> ForearmModel:
    """Assembled model of the scene on its mesh."""
    scene = quarter()
    ports, tissues = place_ports(scene, mesh), resolve_tissues(scene)
    return build_model(mesh, ports, tissues, scene.supports, scene.tissues.membrane, element=scene.element)


def steps(mesh: TissueMesh, frequency: np.ndarray, precision: str) -> dict:
    """Seconds of assembly, factorisation (the first with its analysis) and solve, and the compliances."""
    single = precision == "single"
    start = clock()
    model, factor, rows, values = model_of(mesh), None, [], []
    assembled = clock() - start
    for f in frequency:
        marks = [clock()]
        if factor is None:
            factor = make_factor(model.operator, 2 * np.pi * f, options().backend, single=single, matching=not single)
        data = model.operator.data(2 * np.pi * f)
        factor.factorise(data)
        marks.append(clock())
        right, tolerance = model.functionals.astype(complex), 1e-9 if single else 1e-11
        x = refined_solve(factor, model.operator.matrix(data), right, tolerance=tolerance).values
        rows.append([assembled, *np.diff([*marks, clock()])])
        value = complex(model.functionals[:, POINT] @ x[:, DISC]) * model.shares[DISC]
        values.append([value.real, value.imag])
    factor.release()
    return {"unknowns": model.operator.n, "steps": np.round(rows, 4).tolist(), "compliances": values}


def whole(mesh: TissueMesh, frequency: np.ndarray, precision: str) -> dict:
    """Seconds from the mesh to G at all bins by the reduced sweep; its values at ``frequency``."""
    start = clock()
    sweep = reduced_sweep(model_of(mesh), BINS, options("auto" if precision == "single" else precision))
    seconds = clock() - start
    values = sweep.values[np.searchsorted(BINS, frequency), POINT, DISC]
    certified = max((c.error for c in sweep.certificates), default=float("nan"))
    return {
        "seconds_full": seconds, "factorisations": sweep.factorisations, "certified": certified,
        "reduced": np.column_stack([values.real, values.imag]).tolist(),
    }  # fmt: skip


def assembly(mesh: TissueMesh) -> dict:
    """Seconds of K, C (a multiple of K in each tissue), M, B and the pressure's mass, tissue by tissue, as they are
    kept; and of the whole operator, with constraints, ports and one pattern for all.
    """
    space = mixed_space(mesh, "P2")
    marks = [clock()]
    parts = [tissue_matrices(space, k, reference_tensors(space)) for k in range(len(mesh.region_names))]
    marks.append(clock())
    del parts
    marks.append(clock())
    model = model_of(mesh)
    first, _, second = np.diff([*marks, clock()]).tolist()
    return {"unknowns": model.operator.n, "seconds_assembly": first, "seconds_operator": second}


def main() -> None:
    """Time everything and print one JSON line."""
    scene = dict(np.load(sys.argv[1], allow_pickle=False))
    asked = sys.argv[2] if len(sys.argv) > 2 else "double"
    mesh = build_mesh(quarter(), scale=float(scene["scale"]))
    import_compiled()  # imports are timed in no program
    assert np.array_equal(mesh.tetrahedra, scene["tetrahedra"])
    if asked == "assembly":
        found = assembly(mesh)
    else:
        found = {**steps(mesh, scene["frequency"], asked), **whole(mesh, scene["frequency"], asked)}
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    print(json.dumps({"program": "forearm_fem", "version": __version__, "peak_bytes": peak, **found}))


if __name__ == "__main__":
    main()
