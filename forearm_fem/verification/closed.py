"""Finite elements against closed forms, the layered model, and what every answer must keep."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from ..fem.assembly.boundary import facet_load
from ..fem.assembly.model import build_model
from ..fem.reduction.sweep import direct_sweep
from ..layered import kelvin_voigt_shear_wave
from ..ports import Port
from ..scenario.limb import FreeUnderside, Membrane
from .scenes import (
    DIRECT,
    RADIUS,
    Row,
    block_mesh,
    flesh,
    held_block,
    layered_truth,
    quarter_slab,
    shell_mesh,
    slab_model,
    slab_response,
    solved_with,
)

BAR = 0.02  # length [m]
BAR_HZ = 100.0


def shear_bar_errors(element: str, counts: Sequence[int]) -> list[float]:
    """Relative error of the nodal displacement of a bar sheared at its end, for ``counts`` cells through its width.

    It is held at x = 0 with a shear traction of 1 Pa on x = L; u_x = 0 on its z faces. With k = omega / c - i alpha
    from the closed form: u_z = sin kx / (mu* k cos kL).
    """
    tissue, width, omega, errors = flesh(2500.0, 2.0), 0.004, 2 * np.pi * BAR_HZ, []
    c, alpha = kelvin_voigt_shear_wave(np.array(omega), 2500.0, 2.0, tissue.density)
    k = omega / c - 1j * alpha
    sides = {"end": ("x0",), "tip": ("x1",), "symmetry x": ("z0", "z1")}
    for n in counts:
        mesh = block_mesh((5 * n, n, n), (BAR, width, width), facets=sides)
        model = build_model(mesh, (), {"block": tissue}, FreeUnderside(ends="fixed"), Membrane(), element=element)
        right = np.zeros((model.operator.n, 1))
        load = facet_load(model.space, mesh.facets["tip"], np.array([0.0, 0.0, 1.0]))
        right[: model.operator.n_displacements, 0] = model.constraints.transform.T @ load
        found = model.displacements(solved_with(model, BAR_HZ, right)[:, 0])[:, 2]
        exact = np.sin(k * model.space.node_points[:, 0]) / (complex(tissue.modulus.at(omega)) * k * np.cos(k * BAR))
        nodes = slice(len(mesh.points)) if element == "P1" else slice(None)  # a bubble's coefficient is not a value
        errors.append(float(np.abs(found - exact)[nodes].max() / np.abs(exact).max()))
    return errors


def punch_stiffness(contact: str, side: float, *, rim: float = 1.0) -> float:
    """Static stiffness [N/m] of a rigid disc on an incompressible block of half-width and depth side / 2, all held.

    ``rim`` multiplies the element sizes.
    """
    sizes = {"size_grid": 6e-3, "size_contact": 1.2e-3, "size_far": 0.1 * side, "grading": 0.6}
    scenario = quarter_slab(
        (0.008,), side=side, depth=side / 2, mesh=sizes, ends="fixed", contact=contact,
        override={"muscle": {"bulk": "incompressible", "eta": 0.0}},
    )  # fmt: skip
    value = slab_response(slab_model(scenario, scale=rim), [1e-3])[0, 0]
    return float(1 / value.real)


def oestreicher_impedance(omega: float, radius: float, mu: complex, rho: float) -> complex:
    """Force per velocity [N s/m] of a rigid sphere oscillating in an infinite incompressible medium.

    Oestreicher 1951 for k -> 0: (2/3) pi a^3 rho i omega (1 - 9 i/ah - 9/(ah)^2), h^2 = rho omega^2/mu, Im h < 0.
    """
    ah = radius * omega * np.sqrt(rho / mu)
    return complex(2 / 3 * np.pi * radius**3 * rho * 1j * omega * (1 - 9j / ah - 9 / ah**2))


def sphere_errors(
    splits: Sequence[int], frequency: float, *, curved: bool = False, element: str = "P2"
) -> list[float]:
    """Relative error of the impedance of a 3.5 mm sphere, bonded to flesh that is held at 12 radii.

    Its facets are flat, or ``curved`` like the sphere.
    """
    tissue, omega = flesh(), 2 * np.pi * frequency
    exact = oestreicher_impedance(omega, RADIUS, complex(tissue.modulus.at(omega)), tissue.density)
    errors = []
    for n in splits:
        radii = RADIUS * np.geomspace(1.0, 12.0, 2 * n + 1)
        port = Port("A1", "contact", (0.0, 0.0, 0.0), radius=RADIUS, contact="bonded")
        mesh, held = shell_mesh(radii, n, curved=curved), FreeUnderside(ends="fixed")
        model = build_model(mesh, (port,), {"block": tissue}, held, Membrane(), element=element)
        value = direct_sweep(model, np.array([frequency]), DIRECT).values[0, 0, 0]
        errors.append(float(abs(1 / (1j * omega * value) / exact - 1)))
    return errors


def free_block_error(frequency: float) -> float:
    """|C (-omega^2 m) - 1| of a 20 mm cube of flesh held by nothing, pushed evenly over its whole top."""
    side, tissue = 0.02, flesh()
    mesh = block_mesh((2, 2, 2), (side,) * 3, facets={"contact A1": ("z1",)}, bend=0.05)
    port = Port("A1", "contact", (side / 2, side / 2, side), radius=side / 2)
    model = build_model(mesh, (port,), {"block": tissue}, FreeUnderside(ends="free"), Membrane())
    value = direct_sweep(model, np.array([frequency]), DIRECT).values[0, 0, 0]
    return float(abs(-((2 * math.pi * frequency) ** 2) * tissue.density * side**3 * value - 1))


# --- rows ------------------------------------------------------------------------------------------------------------


def shear_bar_rows() -> Iterator[Row]:
    """A Kelvin-Voigt shear wave in a bar."""
    for element, counts, tolerance in (("P2", (2, 4), 1e-3), ("P3", (1, 2), 5e-4)):
        fine = shear_bar_errors(element, counts)[-1]
        yield Row(f"shear wave in a bar, {element}", "sin kx/(mu k cos kL)", "u at all nodes", fine, tolerance,
                  "theory's order from the next coarser mesh")  # fmt: skip


def punch_rows() -> Iterator[Row]:
    """8 mu a, walls extrapolated away with k = 8 mu a (1 + c a/R)."""
    for contact in ("frictionless", "bonded"):
        near, far = (punch_stiffness(contact, side, rim=0.75) for side in (0.1, 0.2))
        error = abs((2 * far - near) / (8 * 7860.0 * 3.5e-3) - 1)
        yield Row(f"rigid punch, {contact}", "8 mu a", "static stiffness", error, 0.02,
                  "rim singularity on 0.3 mm elements 1 %, walls (a/R)^2 0.5 %")  # fmt: skip


def sphere_rows() -> Iterator[Row]:
    """Oestreicher's oscillating sphere."""
    fine = sphere_errors((6,), 300.0)[0]
    yield Row("oscillating sphere, 300 Hz", "Oestreicher 1951", "impedance", fine, 0.01,
              "flat facets: second order, 3 % at three splits")  # fmt: skip
    bent = sphere_errors((3,), 300.0, curved=True, element="P3")[0]
    yield Row("oscillating sphere, 300 Hz, edges bent, P3", "Oestreicher 1951", "impedance", bent, 0.003,
              "the wall at 12 radii leaves 0.001 on any mesh; flat facets 0.013")  # fmt: skip


def structure_rows() -> Iterator[Row]:
    """Reciprocity, passivity, conjugate symmetry, rigid bodies."""
    band = np.array([1.0, 40.0, 200.0, 500.0])
    for contact in ("pressure", "frictionless", "bonded"):
        values = direct_sweep(held_block(2, contact=contact), band, DIRECT).values
        gap = np.abs(values - values.swapaxes(1, 2)).max(axis=(1, 2)) / np.abs(values).max(axis=(1, 2))
        yield Row(f"reciprocity, {contact}", "C = C^T", "1-500 Hz", float(gap.max()), 1e-9, "A = A^T, residual 1e-11")
        gain = max(float(np.linalg.eigvalsh((c - c.conj().T) / 2j).max() / np.abs(c).max()) for c in values)
        yield Row(f"passivity, {contact}", "-Im C >= 0", "largest power gained", max(0.0, gain), 1e-9, "rounding")
    model = held_block(2)
    back = direct_sweep(model, -band, DIRECT).values - direct_sweep(model, band, DIRECT).values.conj()
    yield Row("real signals", "C(-w) = conj C(w)", "1-500 Hz", float(np.abs(back).max()), 1e-10, "rounding")
    yield Row("free block", "-1/(m w^2)", "C at 0.05 Hz", free_block_error(0.05), 1e-6, "elastic part 6e-7")


def slab_rows() -> Iterator[Row]:
    """Skin and fat on muscle at 250 Hz, a quarter slab against endless layers."""
    layers, sizes = (("skin", 1.2e-3), ("fat", 3e-3)), {"size_grid": 1.3e-3, "size_contact": 0.9e-3, "size_far": 5e-3}
    scenario = quarter_slab((0.01, 0.02), side=0.07, depth=0.025, layers=layers, preset="default", mesh=sizes)
    found, truth = slab_response(slab_model(scenario), [250.0])[0], layered_truth(scenario, [250.0])[0]
    gap = np.abs(found - truth)
    case = "skin and fat on muscle, 250 Hz"
    yield Row(case, "layered model", "mean under the disc", float(gap[0] / abs(truth[0])), 0.01, "rim polygon 0.5 %")
    yield Row(case, "layered model", "e(f), r = 10 and 20 mm", float(gap[1:].max() / np.abs(truth[1:]).max()), 0.02,
              "five elements a wave leave 1 %")  # fmt: skip
