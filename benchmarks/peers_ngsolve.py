"""The quarter slab of `forearm-fem bench` in NGSolve: one complex matrix at 400 Hz assembled, factorised and solved.

    /tmp/ngs/bin/python benchmarks/peers_ngsolve.py scene.npz [sparsecholesky|pardiso|umfpack] >> peers.jsonl

``scene.npz`` comes from `benchmarks/peers.py`. The pair (P2, pressure P1 per tissue), the tetrahedra and the load are
ours, so the compliance at 10 mm must agree with ours in all digits.
"""

from __future__ import annotations

import json
import sys
import time

import numpy as np

try:
    import ngsolve as ngs
    from netgen.meshing import Element2D, Element3D, FaceDescriptor, Mesh, MeshPoint, Pnt
except ImportError:
    sys.exit("skipped: NGSolve is not installed (python3 -m venv v && v/bin/pip install ngsolve)")


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


def forms(mesh: ngs.Mesh, scene: dict) -> tuple:
    """Complex saddle form, load under the disc, and the space."""
    omega = 2 * np.pi * float(scene["frequency"])
    mu = mesh.MaterialCF({str(n): complex(m) for n, m in zip(scene["region_names"], scene["mu"], strict=True)})
    rho = mesh.MaterialCF({str(n): float(r) for n, r in zip(scene["region_names"], scene["density"], strict=True)})
    bulk = mesh.MaterialCF({str(n): float(b) for n, b in zip(scene["region_names"], scene["bulk"], strict=True)})
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
    for n, p, q in zip(names, pressures, tests, strict=True):
        a += (-scale * (p * ngs.div(v) + q * ngs.div(u)) - scale**2 / bulk * p * q) * ngs.dx(n)
    for name, impedance in zip(scene["region_names"], scene["impedance"], strict=True):
        a += 1j * omega * float(impedance) * u.Trace() * v.Trace() * ngs.ds(f"end_{name}")
    area = float(scene["disc_area"])
    f = ngs.LinearForm(space)
    f += v.Trace()[2] / area * ngs.ds("contact")
    return space, a, f


def main() -> None:
    """Time the three steps and print one JSON line."""
    scene = dict(np.load(sys.argv[1], allow_pickle=False))
    solver = sys.argv[2] if len(sys.argv) > 2 else "sparsecholesky"
    ngs.SetNumThreads(int(scene["threads"]))
    mesh = netgen_mesh(scene)
    with ngs.TaskManager():
        space, a, f = forms(mesh, scene)
        clock = [time.perf_counter()]
        a.Assemble()
        f.Assemble()
        clock.append(time.perf_counter())
        inverse = a.mat.Inverse(space.FreeDofs(), inverse=solver)
        clock.append(time.perf_counter())
        x = ngs.GridFunction(space)
        x.vec.data = inverse * f.vec
        clock.append(time.perf_counter())
        value = x.components[0](mesh(*map(float, scene["point"]), ngs.BND))[2] / 4
        rest = f.vec.CreateVector()
        rest.data = f.vec - a.mat * x.vec
    steps = np.diff(clock)
    print(json.dumps({
        "program": "NGSolve", "version": ngs.__version__, "solver": solver, "unknowns": int(space.FreeDofs().NumSet()),
        "seconds_assembly": round(steps[0], 3), "seconds_factorisation": round(steps[1], 3),
        "seconds_solve": round(steps[2], 3), "compliance": f"{value.real:.6g}{value.imag:+.6g}j",
    }))  # fmt: skip


if __name__ == "__main__":
    main()
