"""The layered model against published numbers and closed forms that share no code with it."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from scipy.special import hyp2f1, j0, j1

from ..layered import (
    Disc,
    Layer,
    bonded_disc,
    inertial_near_field,
    layered_compliance,
    miller_pursey_kernel,
    rayleigh_wavenumber,
    rigid_disc,
    surface_kernel,
    uniform_disc_centre,
)
from ..layered.discs import Contact
from ..tissue import KelvinVoigt
from ..typing import ComplexArray, FloatArray
from .scenes import RADIUS, Row

TABLE_HZ = (50.0, 100.0, 200.0, 400.0)
TABLE_RADII = (0.0, 0.010, 0.020, 0.0318, 0.045)
BULK = 2.2e9
HALF_SPACE = (Layer(math.inf, 1050.0, KelvinVoigt(7860.0, 5.03).at, BULK),)
PRESET_O = (
    Layer(8e-5, 1100.0, KelvinVoigt(350e3, 20.0).at, BULK),
    Layer(1.2e-3, 1100.0, KelvinVoigt(13e3, 3.0).at, BULK),
    Layer(3e-3, 950.0, KelvinVoigt(5e3, 1.5).at, BULK),
    Layer(math.inf, 1060.0, KelvinVoigt(1e4, 4.0).at, BULK),
)
# physics_data.md 8, um/N, rows TABLE_HZ, columns TABLE_RADII
TABLE_HALF_SPACE = (
    (4933 - 2426j, -52.86 - 962.9j, -507.9 - 129.1j, -164.4 + 283.5j, 137.9 + 115.7j),
    (3070 - 3664j, -754.4 - 123.4j, 82.24 + 288.1j, 16.29 - 37.59j, 40.80 + 31.71j),
    (185.3 - 3123j, -6.663 + 318.4j, 22.33 + 10.92j, 4.105 - 12.89j, -0.0772 + 0.3941j),
    (-756.7 - 1067j, 54.96 + 30.98j, 4.205 - 4.202j, 0.5856 + 0.0958j, 0.2659 - 0.0135j),
)
TABLE_O = (
    (5737 - 1686j, 48.12 - 815.5j, -398.6 - 251.4j, -259.9 + 186.5j, 66.41 + 200.0j),
    (4997 - 3373j, -906.7 - 339.1j, -0.998 + 441.1j, 110.0 - 114.9j, -44.86 + 74.61j),
    (1338 - 5320j, 205.6 + 803.4j, -131.6 + 2.07j, -2.217 - 37.80j, 3.320 - 12.29j),
    (-1839 - 1508j, -22.93 - 60.41j, 2.984 + 1.845j, -0.185 - 0.507j, 0.441 + 0.134j),
)


def disc_line(layers: tuple[Layer, ...], frequencies: tuple[float, ...], radii: tuple[float, ...]) -> ComplexArray:
    """Displacement at points ``radii`` from the centre of a 7 mm disc per force (n_frequency, n_radius) [m/N]."""
    omega = 2 * np.pi * np.array(frequencies)
    outputs = [Disc(r, 0.0) for r in radii]
    return layered_compliance(layers, omega, [Disc(0.0, 0.0, RADIUS)], outputs, tolerance=1e-8).values[:, :, 0]


def table_rows() -> Iterator[Row]:
    """Both tables of physics_data.md 8; its own accuracy is 0.1 %, 1 % for far values at 400 Hz."""
    for name, layers, table in (("half-space", HALF_SPACE, TABLE_HALF_SPACE), ("preset O", PRESET_O, TABLE_O)):
        error = np.abs(disc_line(layers, TABLE_HZ, TABLE_RADII) * 1e6 / np.array(table) - 1)
        near, far = np.concatenate([error[:3].ravel(), error[3, :2]]), error[3, 2:]
        case, reference = f"layered model, table of {name}", "physics_data.md 8, independent code"
        quantity = "u/F, each entry, 50-200 Hz and r <= 10 mm at 400 Hz"
        yield Row(case, reference, quantity, float(near.max()), 1e-3, "stated there")
        yield Row(case, reference, "u/F, each entry, r >= 20 mm at 400 Hz", float(far.max()), 1e-2, "stated there")


def miller_pursey(frequency: float, radii: tuple[float, ...]) -> ComplexArray:
    """u_z/F [m/N]: mean under the disc, then at ``radii`` (0 or beyond the rim), from Miller and Pursey's integral.

    (1/pi a) int k U(k) J1(ka) J0(kr)/k dk by a plain composite Gauss rule, with the limit of k U for large k taken out
    and added in closed form; the mean over the disc has 2 J1(ka)/ka in the place of J0(kr).
    """
    omega = np.array(2 * np.pi * frequency)
    mu = np.asarray(7860.0 + 5.03j * omega)
    limit = complex(1 / (2 * mu * (1 - mu / (BULK + 4 / 3 * mu))))
    edges = np.concatenate([[0.0], np.geomspace(1e-3, 2.0, 200), np.linspace(2.0, 2e2, 1500)[1:], _MIDDLE, _TAIL])
    x, w = np.polynomial.legendre.leggauss(8)
    k = (0.5 * (edges[1:] + edges[:-1])[:, None] + 0.5 * np.diff(edges)[:, None] * x).ravel()
    weight = (0.5 * np.diff(edges)[:, None] * w).ravel()
    smooth = weight * (k * miller_pursey_kernel(k, omega, mu, 1050.0, BULK) - limit) * j1(k * RADIUS) / k
    mean = np.sum(smooth * 2 * j1(k * RADIUS) / (k * RADIUS)) + limit * 8 / (3 * np.pi)
    parts = [mean, *(np.sum(smooth * j0(k * r)) + limit * _static(r) for r in radii)]
    return np.asarray(np.array(parts, dtype=complex) / (np.pi * RADIUS))


_MIDDLE = np.linspace(2e2, 4e3, 2000)[1:]
_TAIL = np.linspace(4e3, 4e5, 20000)[1:]


def _static(r: float) -> float:
    """int J1(ka) J0(kr)/k dk: 1 on the axis, (a/2r) 2F1(1/2, 1/2; 2; a^2/r^2) beyond the rim."""
    return 1.0 if r == 0 else float(RADIUS / (2 * r) * hyp2f1(0.5, 0.5, 2.0, (RADIUS / r) ** 2))


def miller_pursey_rows() -> Iterator[Row]:
    """Uniform disc on a half-space at 10-500 Hz: another kernel, another quadrature."""
    for f in (10.0, 60.0, 250.0, 500.0):
        radii = (0.0, 0.01, 0.02)
        found = disc_line(HALF_SPACE, (f,), radii)[0]
        exact = miller_pursey(f, radii)[1:]
        error = float(np.abs(found - exact).max() / np.abs(exact).max())
        reason = "the plain rule's own error (cut off at k a = 1400) is below 1e-9"
        case, quantity = f"layered model, uniform disc, {f:g} Hz", "u/F at r = 0, 10, 20 mm"
        yield Row(case, "Miller-Pursey 1954", quantity, error, 1e-6, reason)


def limit_rows() -> Iterator[Row]:
    """Rayleigh root, inertial near field and static limit."""
    omega, tissue = 2 * np.pi * 200.0, KelvinVoigt(7860.0, 5.03)
    elastic = (Layer(math.inf, 1050.0, tissue.at),)
    k = complex(rayleigh_wavenumber(np.array(omega), tissue.at(omega), 1050.0))
    root = _pole(elastic, omega, k)
    yield Row("layered model, Rayleigh root", "k_R = w/(0.9553 c_s)", "pole of the kernel", abs(root / k - 1), 1e-9,
              "secant iteration to rounding")  # fmt: skip
    r = 0.2
    found = disc_line((Layer(math.inf, 1050.0, tissue.at),), (200.0,), (r,))[0, 0]
    exact = float(inertial_near_field(np.array(r), np.array(omega), 1050.0))
    reason = "the next term falls like r^-2 and is 1.7 % at 120 mm"
    gap = float(abs(found / exact - 1))
    yield Row("layered model, inertial near field", "F/(2 pi rho w^2 r^3)", "u/F at 200 mm, 200 Hz", gap, 1e-2, reason)
    slow = disc_line((Layer(math.inf, 1050.0, KelvinVoigt(7860.0, 0.0).at),), (1e-3,), (0.0,))[0, 0]
    static = uniform_disc_centre(RADIUS, 7860.0)
    gap, reason = float(abs(slow / static - 1)), "radiation adds k_s a ~ 1e-5 of it"
    yield Row("layered model, static limit", "(1 - nu)/(pi a mu)", "u/F at the centre, 1 mHz", gap, 1e-5, reason)


_STATICS: tuple[tuple[Contact, float], ...] = (
    ("bonded", 0.5), ("frictionless", 0.5), ("frictionless", 0.3), ("bonded", 0.3), ("bonded", 0.0),
)  # fmt: skip


def rigid_rows() -> Iterator[Row]:
    """Rigid discs in statics: 8 mu a, 4 mu a/(1 - nu) without friction, Mossakovskii's bonded disc, and more terms."""
    case, omega = "layered model, rigid disc", np.array([2e-3 * np.pi])

    def modulus(omega: FloatArray) -> ComplexArray:
        """7860 Pa at any frequency, with a loss factor of 1e-4."""
        return np.asarray(7860.0 * (1 + 1e-4j) + 0 * np.asarray(omega))

    for contact, nu in _STATICS:
        bulk = math.inf if nu == 0.5 else 2 * 7860.0 * (1 + nu) / (3 * (1 - 2 * nu))
        body = [Layer(math.inf, 1050.0, modulus, bulk)]
        exact = (bonded_disc if contact == "bonded" else rigid_disc)(RADIUS, 7860.0, nu)
        disc = [Disc(0.0, 0.0, RADIUS, contact)]
        found = abs(layered_compliance(body, omega, disc, disc, tolerance=1e-8, terms=12).values[0, 0, 0])
        bound, reason = 1e-4, "loss and inertia 1e-5"
        if contact == "bonded" and nu < 0.5:
            bound, reason = (1e-4 if nu else 2e-4), "the rim's oscillating singularity: terms^-2"
        reference = "Mossakovskii 1954" if contact == "bonded" else "4 mu a/(1 - nu)"
        yield Row(f"{case}, {contact}", reference, f"d/F, nu = {nu:g}, 12 terms", abs(found / exact - 1), bound, reason)
    at, points = 2 * np.pi * np.array([50.0, 200.0, 500.0]), [Disc(0.01, 0.0), Disc(0.02, 0.0)]
    disc = [Disc(0.0, 0.0, RADIUS, "bonded")]
    few, many = (
        layered_compliance(PRESET_O[1:], at, disc, [*disc, *points], tolerance=1e-9, terms=n).values for n in (6, 12)
    )
    error = float(np.max(np.abs(few - many).max(axis=(1, 2)) / np.abs(many).max(axis=(1, 2))))
    reason = "the series converges like 20^-n"
    yield Row(f"{case}, bonded, skin on fat", "twelve terms", "e(f), six terms", error, 1e-6, reason)


def _pole(layers: tuple[Layer, ...], omega: float, near: complex) -> complex:
    """Zero of 1/U(k) by the secant method, started 1 % beside ``near``."""

    def stiffness(k: complex) -> complex:
        """Inverse of the surface kernel at a complex wavenumber."""
        return complex(1 / surface_kernel(np.array([k]), np.array(omega), layers)[0])

    a, b = 1.01 * near, 1.02 * near
    fa, fb = stiffness(a), stiffness(b)
    for _ in range(30):
        if abs(b - a) < 1e-13 * abs(b):
            break
        a, b, fa = b, b - fb * (b - a) / (fb - fa), fb
        fb = stiffness(b)
    return b
