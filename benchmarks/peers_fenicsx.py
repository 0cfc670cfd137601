"""The quarter slab of `python benchmarks/speed.py` in Debian's FEniCSx (complex PETSc, MUMPS) at a few frequencies.

    apt-get install python3-dolfinx-complex
    /usr/bin/python3 benchmarks/peers_fenicsx.py scene.npz [mumps|mumps-jumps|assembly]

``scene.npz`` comes from `benchmarks/peers.py`. Taylor-Hood on our tetrahedra. With ``mumps`` the pressure is continuous
across tissues too, as a user would write it, and the compliances differ from ours by a discretisation error of their
own; ``mumps-jumps`` gives every tissue a pressure of its own (three fields, held at zero outside their tissues) and
must agree with ours in all digits.
"""

from __future__ import annotations

import json
import os
import resource
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


class Form:
    """Complex saddle form, load and boundary conditions; frequency and moduli are constants that may be changed."""

    def __init__(self, mesh: dolfinx.mesh.Mesh, region: np.ndarray, facets: dict, scene: dict, *, jumps: bool) -> None:
        self._scene, self._region = scene, region
        tissues = range(len(scene["region_names"])) if jumps else (None,)
        pressures = [ufl.FiniteElement("P", mesh.ufl_cell(), 1) for _ in tissues]
        pair = ufl.MixedElement([ufl.VectorElement("P", mesh.ufl_cell(), 2), *pressures])
        self.space = fem.FunctionSpace(mesh, pair)
        self.omega = fem.Constant(mesh, PETSc.ScalarType(0))
        self.mu = _per_cell(mesh, np.zeros(len(region)))
        ds = _measure(mesh, facets)
        (u, *ps), (v, *qs) = ufl.TrialFunctions(self.space), ufl.TestFunctions(self.space)
        chosen = [1.0 if k is None else _per_cell(mesh, region == k) for k in tissues]
        p, q = (sum(c * x for c, x in zip(chosen, xs, strict=True)) for xs in (ps, qs))
        a = self._volume(mesh, u, v, p, q)
        for name, impedance in zip(scene["region_names"], scene["impedance"], strict=True):
            a += 1j * self.omega * float(impedance) * ufl.inner(u, v) * ds(list(facets).index(f"end_{name}"))
        push = ufl.as_vector((0.0, 0.0, 1.0 / float(scene["disc_area"])))
        self.matrix, self.load = fem.form(a), fem.form(ufl.inner(push, v) * ds(list(facets).index("contact")))
        self.held = [_held(self.space, axis, facets[f"symmetry{'xy'[axis]}"]) for axis in (0, 1)]
        self.held += [_outside(self.space, region, k) for k in tissues if k is not None]

    def _volume(self, mesh: dolfinx.mesh.Mesh, u, v, p, q) -> ufl.Form:
        scene, scale = self._scene, float(self._scene["pressure_scale"])
        density, bulk = (_per_cell(mesh, scene[k][self._region]) for k in ("density", "bulk"))
        e, d = ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v))
        a = 2 * self.mu * (ufl.inner(e, d) - ufl.inner(ufl.div(u), ufl.div(v)) / 3) * ufl.dx
        a += -(self.omega**2) * density * ufl.inner(u, v) * ufl.dx
        a += -scale * (ufl.inner(p, ufl.div(v)) + ufl.inner(ufl.div(u), q)) * ufl.dx
        return a - (scale**2) / bulk * ufl.inner(p, q) * ufl.dx

    def set(self, k: int) -> None:
        """Take the ``k``-th frequency of the scene."""
        self.omega.value = 2 * np.pi * self._scene["frequency"][k]
        self.mu.x.array[:] = self._scene["mu"][self._region, k]


def _measure(mesh: dolfinx.mesh.Mesh, facets: dict) -> ufl.Measure:
    names = list(facets)
    order = np.argsort(np.concatenate([facets[n] for n in names]), kind="stable")
    entities = np.concatenate([facets[n] for n in names])[order]
    tags = np.concatenate([np.full(len(facets[n]), k, dtype=np.int32) for k, n in enumerate(names)])[order]
    return ufl.Measure("ds", mesh, subdomain_data=dolfinx.mesh.meshtags(mesh, 2, entities, tags))


def _per_cell(mesh: dolfinx.mesh.Mesh, values: np.ndarray) -> fem.Function:
    field = fem.Function(fem.FunctionSpace(mesh, ("DG", 0)))
    field.x.array[:] = values
    return field


def _held(space: fem.FunctionSpace, axis: int, facets: np.ndarray) -> fem.DirichletBCMetaClass:
    dofs = fem.locate_dofs_topological(space.sub(0).sub(axis), 2, facets)
    return fem.dirichletbc(PETSc.ScalarType(0), dofs, space.sub(0).sub(axis))


def _outside(space: fem.FunctionSpace, region: np.ndarray, tissue: int) -> fem.DirichletBCMetaClass:
    """The pressure of a tissue, held at zero where no tetrahedron of the tissue touches it."""
    sub = space.sub(1 + tissue)
    inside, outside = (
        fem.locate_dofs_topological(sub, 3, np.flatnonzero(chosen).astype(np.int32))
        for chosen in (region == tissue, region != tissue)
    )
    return fem.dirichletbc(PETSc.ScalarType(0), np.setdiff1d(outside, inside).astype(np.int32), sub)


def _normal_displacement(space: fem.FunctionSpace, x: PETSc.Vec, point: np.ndarray) -> complex:
    solution = fem.Function(space)
    solution.x.array[:] = x.array
    mesh, place = space.mesh, point[None, :] - np.array([0.0, 0.0, 1e-9])
    tree = dolfinx.geometry.BoundingBoxTree(mesh, 3)
    near = dolfinx.geometry.compute_collisions(tree, place)
    cell = dolfinx.geometry.compute_colliding_cells(mesh, near, place).links(0)[:1]
    return complex(solution.sub(0).collapse().eval(place, cell)[2])


def solve_all(form: Form, scene: dict, solver: str, clock) -> dict:
    """Seconds of every step per frequency, and the compliances at the point."""
    matrix, right = fem.petsc.create_matrix(form.matrix), fem.petsc.create_vector(form.load)
    x, ksp, steps, values = right.duplicate(), _direct_solver(matrix), [], []
    for k in range(len(scene["frequency"])):
        form.set(k)
        marks = [clock()]
        _assemble(form, matrix, right)
        marks.append(clock())
        if solver == "assembly":
            return {"unknowns": int(matrix.size[0]), "seconds_assembly": marks[1] - marks[0]}
        ksp.setOperators(matrix)
        ksp.getPC().setUp()  # the analysis is kept after the first
        marks.append(clock())
        ksp.solve(right, x)
        steps.append(np.diff([*marks, clock()]))
        value = _normal_displacement(form.space, x, scene["point"]) / 4
        values.append([value.real, value.imag])
    return {"unknowns": int(matrix.size[0]), "steps": np.round(steps, 4).tolist(), "compliances": values}


def _assemble(form: Form, matrix: PETSc.Mat, right: PETSc.Vec) -> None:
    matrix.zeroEntries()
    fem.petsc.assemble_matrix(matrix, form.matrix, bcs=form.held)
    matrix.assemble()
    with right.localForm() as local:
        local.set(0)
    fem.petsc.assemble_vector(right, form.load)
    fem.petsc.set_bc(right, form.held)


def _direct_solver(matrix: PETSc.Mat) -> PETSc.KSP:
    matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    solver = PETSc.KSP().create(MPI.COMM_WORLD)
    solver.setOperators(matrix)
    solver.setType("preonly")
    solver.getPC().setType("cholesky")
    solver.getPC().setFactorSolverType("mumps")
    return solver


def main() -> None:
    """Time everything and print one JSON line."""
    scene = dict(np.load(sys.argv[1], allow_pickle=False))
    solver = sys.argv[2] if len(sys.argv) > 2 else "mumps"
    clock = time.process_time if int(scene["threads"]) == 1 else time.perf_counter
    mesh, region, facets = mesh_of(scene)
    form = Form(mesh, region, facets, scene, jumps=solver != "mumps")
    found = solve_all(form, scene, solver, clock)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    print(json.dumps({"program": "FEniCSx", "version": dolfinx.__version__, "peak_bytes": peak, **found}))


if __name__ == "__main__":
    main()
