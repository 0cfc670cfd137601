"""The quarter slab of `forearm-fem bench` in Debian's FEniCSx (complex PETSc, MUMPS): one complex matrix at 400 Hz.

    apt-get install python3-dolfinx-complex
    /usr/bin/python3 benchmarks/peers_fenicsx.py scene.npz [mumps]

``scene.npz`` comes from `benchmarks/peers.py`. Taylor-Hood on our tetrahedra, but with a pressure that is continuous
across tissues too (ours jumps there), so the compliance differs by a discretisation error of its own.
"""

from __future__ import annotations

import json
import os
import sys
import time

_COMPLEX = "/usr/lib/petscdir/petsc-complex"
os.environ.setdefault("PETSC_DIR", _COMPLEX)
sys.path.insert(0, f"{_COMPLEX}/lib/python3/dist-packages")

import numpy as np  # noqa: E402

try:
    import dolfinx
    import ufl
    from dolfinx import fem
    from mpi4py import MPI
    from petsc4py import PETSc
except ImportError:
    sys.exit("skipped: DOLFINx with complex PETSc is not installed (apt-get install python3-dolfinx-complex)")


def mesh_of(scene: dict) -> tuple:
    """Mesh, per-cell region numbers and tags of the named facets."""
    cell = ufl.Mesh(ufl.VectorElement("Lagrange", ufl.tetrahedron, 1))
    used, cells = np.unique(scene["tetrahedra"], return_inverse=True)
    cells = cells.reshape(-1, 4).astype(np.int64)
    mesh = dolfinx.mesh.create_mesh(MPI.COMM_WORLD, cells, scene["points"][used], cell)
    region = scene["region"][mesh.topology.original_cell_index]
    mesh.topology.create_entities(2)
    mesh.topology.create_connectivity(2, 0)
    mesh.topology.create_connectivity(2, 3)
    mesh.topology.create_connectivity(3, 0)
    node = np.zeros(mesh.geometry.x.shape[0], dtype=np.int64)  # geometry node of each vertex
    node[mesh.topology.connectivity(3, 0).array] = mesh.geometry.dofmap.array
    vertices = mesh.topology.connectivity(2, 0).array.reshape(-1, 3)
    ours = used[np.asarray(mesh.geometry.input_global_indices)[node[vertices]]]
    known = {tuple(k): i for i, k in enumerate(np.sort(ours, axis=1).tolist())}
    names = [str(n) for n in scene["boundary_names"]]
    return mesh, region, {n: _places(known, scene[f"facets {n}"]) for n in names}


def _places(known: dict, facets: np.ndarray) -> np.ndarray:
    return np.array(sorted(known[tuple(f)] for f in np.sort(facets, axis=1).tolist()), dtype=np.int32)


def forms(mesh: dolfinx.mesh.Mesh, region: np.ndarray, facets: dict, scene: dict) -> tuple:
    """Compiled complex saddle form and load, boundary conditions, space."""
    omega, scale = 2 * np.pi * float(scene["frequency"]), float(scene["pressure_scale"])
    pair = ufl.MixedElement([ufl.VectorElement("P", mesh.ufl_cell(), 2), ufl.FiniteElement("P", mesh.ufl_cell(), 1)])
    space = fem.FunctionSpace(mesh, pair)
    constant = {k: _per_cell(mesh, scene[k][region]) for k in ("mu", "density", "bulk")}
    names = list(facets)
    order = np.argsort(np.concatenate([facets[n] for n in names]), kind="stable")
    entities = np.concatenate([facets[n] for n in names])[order]
    tags = np.concatenate([np.full(len(facets[n]), k, dtype=np.int32) for k, n in enumerate(names)])[order]
    ds = ufl.Measure("ds", mesh, subdomain_data=dolfinx.mesh.meshtags(mesh, 2, entities, tags))
    (u, p), (v, q) = ufl.TrialFunctions(space), ufl.TestFunctions(space)
    e, d = ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v))
    a = 2 * constant["mu"] * (ufl.inner(e, d) - ufl.inner(ufl.div(u), ufl.div(v)) / 3) * ufl.dx
    a += -(omega**2) * constant["density"] * ufl.inner(u, v) * ufl.dx
    a += -scale * (ufl.inner(p, ufl.div(v)) + ufl.inner(ufl.div(u), q)) * ufl.dx
    a += -(scale**2) / constant["bulk"] * ufl.inner(p, q) * ufl.dx
    for name, impedance in zip(scene["region_names"], scene["impedance"], strict=True):
        a += 1j * omega * float(impedance) * ufl.inner(u, v) * ds(names.index(f"end_{name}"))
    load = ufl.inner(ufl.as_vector((0.0, 0.0, 1.0 / float(scene["disc_area"]))), v) * ds(names.index("contact"))
    held = [_held(space, axis, facets[f"symmetry{'xy'[axis]}"]) for axis in (0, 1)]
    return fem.form(a), fem.form(load), held, space


def _per_cell(mesh: dolfinx.mesh.Mesh, values: np.ndarray) -> fem.Function:
    field = fem.Function(fem.FunctionSpace(mesh, ("DG", 0)))
    field.x.array[:] = values
    return field


def _held(space: fem.FunctionSpace, axis: int, facets: np.ndarray) -> fem.DirichletBCMetaClass:
    dofs = fem.locate_dofs_topological(space.sub(0).sub(axis), 2, facets)
    return fem.dirichletbc(PETSc.ScalarType(0), dofs, space.sub(0).sub(axis))


def _normal_displacement(space: fem.FunctionSpace, x: PETSc.Vec, point: np.ndarray) -> complex:
    solution = fem.Function(space)
    solution.x.array[:] = x.array
    mesh, place = space.mesh, point[None, :] - np.array([0.0, 0.0, 1e-9])
    tree = dolfinx.geometry.BoundingBoxTree(mesh, 3)
    near = dolfinx.geometry.compute_collisions(tree, place)
    cell = dolfinx.geometry.compute_colliding_cells(mesh, near, place).links(0)[:1]
    return complex(solution.sub(0).collapse().eval(place, cell)[2])


def main() -> None:
    """Time the three steps and print one JSON line."""
    scene = dict(np.load(sys.argv[1], allow_pickle=False))
    mesh, region, facets = mesh_of(scene)
    a, load, held, space = forms(mesh, region, facets, scene)
    clock = [time.perf_counter()]
    matrix = fem.petsc.assemble_matrix(a, bcs=held)
    matrix.assemble()
    right = fem.petsc.assemble_vector(load)
    fem.petsc.set_bc(right, held)
    clock.append(time.perf_counter())
    matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    solver = PETSc.KSP().create(MPI.COMM_WORLD)
    solver.setOperators(matrix)
    solver.setType("preonly")
    solver.getPC().setType("cholesky")
    solver.getPC().setFactorSolverType("mumps")
    solver.getPC().setUp()
    clock.append(time.perf_counter())
    x = right.duplicate()
    solver.solve(right, x)
    clock.append(time.perf_counter())
    value = _normal_displacement(space, x, scene["point"]) / 4
    steps = np.diff(clock)
    print(json.dumps({
        "program": "FEniCSx", "version": dolfinx.__version__, "solver": "MUMPS LDL^T", "unknowns": int(matrix.size[0]),
        "seconds_assembly": round(steps[0], 3), "seconds_factorisation": round(steps[1], 3),
        "seconds_solve": round(steps[2], 3), "compliance": f"{value.real:.6g}{value.imag:+.6g}j",
    }))  # fmt: skip


if __name__ == "__main__":
    main()
