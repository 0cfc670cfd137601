"""Finite elements against closed forms: shear bar, rigid punch, oscillating sphere, rigid bodies."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ..fem.assembly.boundary import facet_load
from ..fem.assembly.model import build_model
from ..fem.reduction.sweep import direct_sweep
from ..layered import kelvin_voigt_shear_wave
from ..ports import Port
from ..scenario.supports import FreeUnderside
from ..scenario.tissues import Membrane
from .blocks import block_mesh, shell_mesh
from .scenes import DIRECT, RADIUS, flesh, quarter_slab, slab_model, slab_response, solved_with

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
