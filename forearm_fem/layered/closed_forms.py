r"""Closed forms to hold the layered engine and the finite elements against (:math:`e^{+i\omega t}`, SI).

None of these share code with :mod:`forearm_fem.layered.kernel`.
"""

from __future__ import annotations

import math

import numpy as np

from ..typing import ComplexArray, FloatArray

# Real root of x^3 - 8 x^2 + 24 x - 16 = 0, x = (c_R/c_s)^2 for an incompressible solid: c_R = 0.95531 c_s.
_RAYLEIGH_RATIO = math.sqrt(0.9126219746158474)


def rayleigh_wavenumber(omega: FloatArray, mu: ComplexArray, rho: float) -> ComplexArray:
    """Complex Rayleigh root k_R = w/(0.95531 sqrt(mu/rho)) [1/m] of an incompressible half-space.

    ``mu`` complex modulus [Pa], ``omega`` [rad/s], same shape. Further complex roots (Currie 1977) lie on
    other Riemann sheets or decay faster and are not given.
    """
    return np.asarray(omega / (_RAYLEIGH_RATIO * np.sqrt(np.asarray(mu, dtype=complex) / rho)))


def kelvin_voigt_shear_wave(omega: FloatArray, mu: float, eta: float, rho: float) -> tuple[FloatArray, FloatArray]:
    """Phase speed [m/s] and attenuation [1/m] of a plane shear wave for mu* = mu + i w eta.

    c = sqrt(2 |mu*|^2/(rho (mu + |mu*|))), alpha = sqrt(rho w^2 (|mu*| - mu)/(2 |mu*|^2)).
    """
    w = np.asarray(omega, dtype=float)
    size = np.hypot(mu, w * eta)
    lossy = (w * eta) ** 2 / (size + mu)  # |mu*| - mu without cancellation
    return np.sqrt(2 * size**2 / (rho * (mu + size))), np.sqrt(rho * w**2 * lossy / (2 * size**2))


def miller_pursey_kernel(
    k: FloatArray | ComplexArray, omega: FloatArray, mu: ComplexArray, rho: float, bulk_modulus: float
) -> ComplexArray:
    """u_z/sigma_z of a homogeneous half-space, -k_s^2 p/(mu R), R = (2k^2 - k_s^2)^2 - 4 k^2 p q [m/Pa].

    Miller & Pursey 1954. R is evaluated as k_s^2 (4 k^2 D/(k^2 + pq) - 4 k^2 + k_s^2) with
    D = k^2 (1 + eps) - k_p^2, the same number without its cancellation for k >> k_s.
    """
    mu = np.asarray(mu, dtype=complex)
    eps = np.zeros_like(mu) if math.isinf(bulk_modulus) else mu / (bulk_modulus + 4 * mu / 3)
    ks2 = rho * np.asarray(omega) ** 2 / mu
    kp2, k2 = eps * ks2, np.asarray(k) ** 2
    p, q = np.sqrt(k2 - kp2 + 0j), np.sqrt(k2 - ks2 + 0j)
    pq = p * q
    direct = ((2 * k2 - ks2) ** 2 - 4 * k2 * pq) / ks2
    with np.errstate(divide="ignore", invalid="ignore"):
        stable = 4 * k2 * (k2 * (1 + eps) - kp2) / (k2 + pq) - 4 * k2 + ks2
    return np.asarray(-p / (mu * np.where(pq.real < 0, direct, stable)))


def inertial_near_field(r: FloatArray, omega: FloatArray, rho: float) -> FloatArray:
    """u_z/F = 1/(2 pi rho w^2 r^3) [m/N], incompressible and lossy, r >> 1/alpha; in phase with the force."""
    return np.asarray(1 / (2 * np.pi * rho * np.asarray(omega) ** 2 * np.asarray(r) ** 3))


def boussinesq(r: FloatArray, mu: float, nu: float = 0.5) -> FloatArray:
    """Static point force, u_z/F = (1 - nu)/(2 pi mu r) [m/N]."""
    return np.asarray((1 - nu) / (2 * np.pi * mu * np.asarray(r)))


def uniform_disc_centre(radius: float, mu: float, nu: float = 0.5) -> float:
    """Static uniform pressure on a disc, displacement of its centre, (1 - nu)/(pi a mu) [m/N]."""
    return (1 - nu) / (math.pi * radius * mu)


def uniform_disc_mean(radius: float, mu: float, nu: float = 0.5) -> float:
    """Static uniform pressure on a disc, mean displacement under it, 8 (1 - nu)/(3 pi^2 a mu) [m/N]."""
    return 8 * (1 - nu) / (3 * math.pi**2 * radius * mu)


def rigid_disc(radius: float, mu: float, nu: float = 0.5) -> float:
    """Static frictionless rigid disc, d/F = (1 - nu)/(4 mu a) [m/N] (Sneddon 1966)."""
    return (1 - nu) / (4 * mu * radius)


def bonded_disc(radius: float, mu: float, nu: float = 0.5) -> float:
    """Static rigid disc bonded to the surface, d/F = (1 - 2 nu)/(4 mu a ln(3 - 4 nu)) [m/N].

    Mossakovskii 1954; Spence 1968. For nu = 1/2 it is the frictionless disc, 1/(8 mu a).
    """
    if nu == 0.5:
        return rigid_disc(radius, mu)
    return (1 - 2 * nu) / (4 * mu * radius * math.log(3 - 4 * nu))
