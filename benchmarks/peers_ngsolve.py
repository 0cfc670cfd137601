"""The quarter slab of `python benchmarks/speed.py` in NGSolve: one complex system per frequency, timed step by step.

    v/bin/python benchmarks/peers_ngsolve.py scene.npz [sparsecholesky|pardiso|umfpack|assembly]

``scene.npz`` comes from `benchmarks/peers.py`. The pair (P2, pressure P1 per tissue), the tetrahedra and the load are
ours, so the compliances must agree with ours in all digits. ``assembly`` stops after the first matrix.
"""

from __future__ import annotations

import json
import resource
import sys
import time

import numpy as np

try:
    import ngsolve as ngs
    from netgen.meshing import Element2D, Element3D, FaceDescriptor, Mesh, MeshPoint, Pnt
except ImportError:
    sys.exit("skipped: NGSolve is not installed (python3 -m venv v && v/bin/pip install ngsolve mkl)")


def netgen_mesh(scene: dict) -> ngs.Mesh:
    """Our tetrahedra and named facets as a Netgen mesh; materials by region name."""
    mesh = Mesh(dim=3)
    points = [mesh.Add(MeshPoint(Pnt(*map(float, p)))) for p in scene["points"]]
    names = [str(n) for n in scene["boundary_names"]]
    for k in range(len(names)):
        mesh.Add(FaceDescriptor(surfnr=k + 1, domin=1, domout=0, bc=k + 1))
        mesh.SetBCName(k, names[k])
    for k, facets in enumerate(scene[f"facets {n}"] for n in names):
        for f in facets:
            mesh.Add(Element2D(k + 1, [points[i] for i in f]))
    for region, cell in zip(scene["region"], scene["tetrahedra"], strict=True):
        mesh.Add(Element3D(int(region) + 1, [points[i] for i in cell]))
    for k, name in enumerate(scene["region_names"]):
        mesh.SetMaterial(k + 1, str(name))
    return ngs.Mesh(mesh)


class Frequency:
    """Angular frequency and shear moduli as parameters, so that only values change from one matrix to the next."""

    def __init__(self, scene: dict) -> None:
        self._scene = scene
        self.omega = ngs.ParameterC(0)
        self.mu = {str(n): ngs.ParameterC(0) for n in scene["region_names"]}

    def set(self, k: int) -> None:
        """Take the ``k``-th frequency of the scene."""
        self.omega.Set(complex(2 * np.pi * self._scene["frequency"][k]))
        for parameter, value in zip(self.mu.values(), self._scene["mu"][:, k], strict=True):
            parameter.Set(complex(value))


def forms(mesh: ngs.Mesh, scene: dict, at: Frequency) -> tuple:
    """Complex saddle form, load under the disc, and the space."""
    omega, mu = at.omega, mesh.MaterialCF(at.mu)
    rho = mesh.MaterialCF({str(n): float(r) for n, r in zip(scene["region_names"], scene["density"], strict=True)})
    u_space = ngs.VectorH1(mesh, order=2, complex=True, dirichletx="symmetryx", dirichlety="symmetryy")
    names = [str(n) for n in scene["region_names"]]  # the pressure jumps between tissues, so each has its own
    space = u_space
    for n in names:
        space = space * ngs.Compress(ngs.H1(mesh, order=1, complex=True, definedon=n))
    (u, *pressures), (v, *tests) = space.TnT()
    scale = float(scene["pressure_scale"])
    e, d = ngs.Sym(ngs.Grad(u)), ngs.Sym(ngs.Grad(v))
    a = ngs.BilinearForm(space, symmetric=True)
    a += (2 * mu * (ngs.InnerProduct(e, d) - ngs.div(u) * ngs.div(v) / 3) - omega**2 * rho * u * v) * ngs.dx
    for n, p, q, bulk in zip(names, pressures, tests, scene["bulk"], strict=True):
        a += (-scale * (p * ngs.div(v) + q * ngs.div(u)) - scale**2 / float(bulk) * p * q) * ngs.dx(n)
    for name, impedance in zip(names, scene["impedance"], strict=True):
        a += 1j * omega * float(impedance) * u.Trace() * v.Trace() * ngs.ds(f"end_{name}")
    f = ngs.LinearForm(space)
    f += v.Trace()[2] / float(scene["disc_area"]) * ngs.ds("contact")
    return space, a, f


def solve_all(mesh: ngs.Mesh, scene: dict, solver: str, clock) -> dict:
    """Seconds of every step per frequency, and the compliances at the point."""
    at = Frequency(scene)
    space, a, f = forms(mesh, scene, at)
    inverse, steps, values = None, [], []
    x = ngs.GridFunction(space)
    for k in range(len(scene["frequency"])):
        at.set(k)
        marks = [clock()]
        a.Assemble()
        f.Assemble()
        marks.append(clock())
        if solver == "assembly":
            return {"unknowns": int(space.FreeDofs().NumSet()), "seconds_assembly": marks[1] - marks[0]}
        if inverse is None:
            inverse = a.mat.Inverse(space.FreeDofs(), inverse=solver)
        else:
            inverse.Update()  # the analysis is kept
        marks.append(clock())
        x.vec.data = inverse * f.vec
        steps.append(np.diff([*marks, clock()]))
        value = complex(x.components[0](mesh(*map(float, scene["point"]), ngs.BND))[2]) / 4
        values.append([value.real, value.imag])
    return {"unknowns": int(space.FreeDofs().NumSet()), "steps": np.round(steps, 4).tolist(), "compliances": values}


def main() -> None:
    """Time everything and print one JSON line."""
    scene = dict(np.load(sys.argv[1], allow_pickle=False))
    solver = sys.argv[2] if len(sys.argv) > 2 else "sparsecholesky"
    ngs.SetNumThreads(int(scene["threads"]))
    clock = time.process_time if int(scene["threads"]) == 1 else time.perf_counter
    mesh = netgen_mesh(scene)
    with ngs.TaskManager():
        found = solve_all(mesh, scene, solver, clock)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    print(json.dumps({"program": "NGSolve", "version": ngs.__version__, "peak_bytes": peak, **found}))


if __name__ == "__main__":
    main()
