r"""Surface compliance of a layered half-space in the wavenumber domain.

Convention :math:`e^{+i\omega t}`, SI units, z pointing into the body. In-plane (P-SV) motion is written as
:math:`u_x = iX e^{-ikx}`, :math:`u_z = W e^{-ikx}` so that every matrix is symmetric; the axisymmetric
problem has the same kernel (Kausel & Roesset, BSSA 71, 1981). With
:math:`p^2=k^2-k_p^2,\ q^2=k^2-k_s^2,\ \mathrm{Re}\,p,q\ge 0,\ \varepsilon=k_p^2/k_s^2` the half-space has

.. math::
    Y = \mu\begin{pmatrix} p r & k\delta\\ k\delta & q r\end{pmatrix},\quad
    r=\frac{k_s^2}{k^2-pq}=\frac{k^2+pq}{k^2(1+\varepsilon)-k_p^2},\quad
    \delta=2-r=\frac{k_s^2}{k^2+pq}+\frac{2\varepsilon q^2}{k^2(1+\varepsilon)-k_p^2}.

The second forms are free of the cancellation in :math:`k^2-pq` for :math:`k\gg k_s` and remain finite for
an incompressible solid (:math:`\varepsilon=0`). Layers are added from the bottom upwards with the matrix
exponential :math:`e^{-Gh}` of down-going motion, which only decays and needs no eigenvectors, so neither
thin layers, nor :math:`kh\to\infty`, nor :math:`p\to q` lose digits.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from ..typing import ComplexArray, FloatArray

Base = Literal["halfspace", "rigid"]


@dataclass(frozen=True)
class Layer:
    """One homogeneous isotropic layer.

    thickness_m : thickness [m]; ``math.inf`` for the half-space.
    density : [kg/m^3]
    modulus : complex shear modulus [Pa] of an array of angular frequencies [rad/s], same shape.
    bulk_modulus : lossless bulk modulus [Pa]; ``math.inf`` is an incompressible solid.
    """

    thickness_m: float
    density: float
    modulus: Callable[[FloatArray], ComplexArray]
    bulk_modulus: float = math.inf


@dataclass(frozen=True)
class Surface:
    """A thin sheet on the free surface, with the terms of :mod:`forearm_fem.fem.assembly.boundary`.

    ``tension`` [N/m] adds T k^2 to all stiffnesses (geometric stiffness, the integral of grad u : grad v), ``mass``
    [kg/m^2] subtracts m w^2 from all. ``membrane`` [N/m] + i w ``viscosity`` [N s/m] is the in-plane
    E h/(1 - nu^2) = 4 mu h of an incompressible sheet: times k^2 it adds to the stiffness along the wave, a quarter of
    it to that across. Bending is left out.
    """

    tension: float = 0.0
    membrane: float = 0.0
    mass: float = 0.0
    viscosity: float = 0.0

    @property
    def sheet(self) -> bool:
        """True if the sheet resists in-plane strain."""
        return self.membrane > 0 or self.viscosity > 0 or self.tension > 0


class Matrix(NamedTuple):
    """A 2 x 2 matrix ((a, b), (c, d)) at every (frequency, wavenumber)."""

    a: ComplexArray
    b: ComplexArray
    c: ComplexArray
    d: ComplexArray


class SurfaceCompliance(NamedTuple):
    """Displacement per traction at the surface [m/Pa], each of the shape of (frequency, wavenumber).

    For motion e^{i k.x}: ``zz`` normal per normal, ``xx`` along the wave, ``yy`` across it (horizontally polarised
    shear), ``zx`` normal per tangential: u_z = zz t_z + i zx t_x, u_x = xx t_x - i zx t_z, u_y = yy t_y.
    """

    zz: ComplexArray
    zx: ComplexArray
    xx: ComplexArray
    yy: ComplexArray


class Waves(NamedTuple):
    """Impedance and decay of one material: ``Y`` = mu ((pr, kd), (kd, qr)), motion ~ exp(-G z)."""

    Y: Matrix
    G: Matrix
    p: ComplexArray
    q: ComplexArray
    p_minus_q: ComplexArray


def check_layers(layers: Sequence[Layer], base: Base) -> None:
    """Raise ValueError unless thicknesses suit ``base`` and all constants are positive."""
    if not layers:
        raise ValueError("expected at least one layer, got none")
    inner = layers[:-1] if base == "halfspace" else layers
    if base == "halfspace" and not math.isinf(layers[-1].thickness_m):
        raise ValueError("the last layer of a half-space has thickness math.inf; or set base='rigid'")
    for i, layer in enumerate(inner):
        if not 0 < layer.thickness_m < math.inf:
            raise ValueError(f"layer {i}: expected 0 < thickness_m < inf, got {layer.thickness_m}")
    for i, layer in enumerate(layers):
        if not (layer.density > 0 and layer.bulk_modulus > 0):
            raise ValueError(f"layer {i}: density and bulk_modulus must be positive")


def shear_modulus(omega: FloatArray, layer: Layer) -> ComplexArray:
    """Complex modulus [Pa], in the shape of ``omega`` even if the callable returns one number."""
    return np.array(np.broadcast_to(layer.modulus(omega), np.shape(omega)), dtype=complex)


def wavenumbers(omega: FloatArray, layer: Layer) -> tuple[ComplexArray, ComplexArray]:
    """k_s = w sqrt(rho/mu) and k_p = k_s sqrt(eps) [1/m], imaginary parts <= 0."""
    mu = shear_modulus(omega, layer)
    ks = omega * np.sqrt(layer.density / mu)
    return np.asarray(ks), np.asarray(ks * np.sqrt(_speed_ratio(mu, layer.bulk_modulus)))


def surface_kernel(
    k: FloatArray | ComplexArray,
    omega: FloatArray,
    layers: Sequence[Layer],
    base: Base = "halfspace",
    surface: Surface | None = None,
) -> ComplexArray:
    """Normal displacement per normal stress U(k) = u_z/sigma_z at the free surface [m/Pa].

    ``k`` [1/m] (nonzero, real or in the first quadrant) and ``omega`` [rad/s] (> 0) broadcast against each
    other; both displacement and stress are positive into the body. Not covered: k = 0 and omega = 0 exactly.
    """
    check_layers(layers, base)
    omega, surface = np.asarray(omega, dtype=float), surface or Surface()
    a, d, b = _plane_stiffness(k, omega, layers, surface)
    return np.asarray(a / (a * d - b * b))


def surface_compliance(
    k: FloatArray | ComplexArray,
    omega: FloatArray,
    layers: Sequence[Layer],
    base: Base = "halfspace",
    surface: Surface | None = None,
) -> SurfaceCompliance:
    """Normal and tangential displacement per normal and tangential traction; as :func:`surface_kernel` otherwise."""
    check_layers(layers, base)
    omega, surface = np.asarray(omega, dtype=float), surface or Surface()
    a, d, b = _plane_stiffness(k, omega, layers, surface)
    det = a * d - b * b
    return SurfaceCompliance(a / det, -b / det, d / det, 1 / _cross_stiffness(k, omega, layers, surface))


def compliance_limits(omega: FloatArray, layer: Layer, surface: Surface) -> SurfaceCompliance:
    """Limits of k times the surface compliance for k -> inf, each (n_freq,) [1/Pa], on top of ``layer``.

    Statics of a half-space, k U = ((1, -eps), (-eps, 1))/(2 mu (1 - eps)) and 1/mu across; a sheet holds the
    tangential motion of ever shorter waves, tension the normal motion too.
    """
    mu = shear_modulus(omega, layer)
    eps = _speed_ratio(mu, layer.bulk_modulus)
    none = np.zeros_like(mu)
    if surface.tension > 0:
        return SurfaceCompliance(none, none, none, none)
    if surface.sheet:
        return SurfaceCompliance((1 + eps) / (2 * mu), none, none, none)
    normal = 1 / (2 * mu * (1 - eps))
    return SurfaceCompliance(normal, -eps * normal, normal, 1 / mu)


def _plane_stiffness(
    k: FloatArray | ComplexArray, omega: FloatArray, layers: Sequence[Layer], surface: Surface
) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Tangential, normal and coupling stiffness (Y11, Y22, Y12) of the surface in the plane of the wave."""
    below: Matrix | None = None
    for layer in reversed(layers):
        mu = shear_modulus(omega, layer)
        waves = _waves(k, omega, mu, layer)
        below = waves.Y if math.isinf(layer.thickness_m) else _add_layer(waves, layer.thickness_m, below)
    assert below is not None
    plain = surface.tension * k**2 - surface.mass * omega**2
    sheet = (surface.membrane + 1j * surface.viscosity * omega) * k**2
    return below.a + plain + sheet, below.d + plain, below.b


def _cross_stiffness(
    k: FloatArray | ComplexArray, omega: FloatArray, layers: Sequence[Layer], surface: Surface
) -> ComplexArray:
    """Stiffness of the surface across the wave: Y = Z (1 - R)/(1 + R), R = e^{-2qh} (Z - Y')/(Z + Y'), Z = mu q."""
    below: ComplexArray | None = None
    for layer in reversed(layers):
        mu = shear_modulus(omega, layer)
        q = np.sqrt(k * k - layer.density * omega**2 / mu + 0j)
        z = mu * q
        if math.isinf(layer.thickness_m):
            below = z
            continue
        echo = np.exp(-2 * q * layer.thickness_m) * (-1 if below is None else (z - below) / (z + below))
        below = z * (1 - echo) / (1 + echo)
    assert below is not None
    sheet = surface.tension + 0.25 * (surface.membrane + 1j * surface.viscosity * omega)
    return np.asarray(below + sheet * k**2 - surface.mass * omega**2)


def _speed_ratio(mu: ComplexArray, bulk_modulus: float) -> ComplexArray:
    """eps = (c_s/c_p)^2 = mu/(K + 4 mu/3)."""
    if math.isinf(bulk_modulus):
        return np.zeros_like(mu)
    return np.asarray(mu / (bulk_modulus + 4 * mu / 3))


def _waves(k: FloatArray | ComplexArray, omega: FloatArray, mu: ComplexArray, layer: Layer) -> Waves:
    """Impedance Y and generator G of down-going motion (module docstring)."""
    eps = _speed_ratio(mu, layer.bulk_modulus)
    ks2 = layer.density * omega**2 / mu
    kp2, k2 = eps * ks2, k * k
    q2 = k2 - ks2
    p, q = np.sqrt(k2 - kp2 + 0j), np.sqrt(q2)
    pq = p * q
    plus, den = k2 + pq, k2 * (1 + eps) - kp2
    slow = pq.real < 0  # k < k_s: here k^2 - pq is the sum without cancellation, and plus, den may vanish
    with np.errstate(divide="ignore", invalid="ignore"):
        r = np.where(slow, ks2 / (k2 - pq), plus / den)
        delta = np.where(slow, 2 - r, ks2 / plus + 2 * eps * q2 / den)
    p_minus_q = ks2 * (1 - eps) / (p + q)
    coupling = k * p_minus_q * r / ks2
    pr, qr, kd = p * r, q * r, k * delta
    return Waves(
        Matrix(mu * pr, mu * kd, mu * kd, mu * qr),
        Matrix(pr, -q * coupling, p * coupling, eps * qr),
        p, q, p_minus_q,
    )  # fmt: skip


def _decay(waves: Waves, h: float) -> Matrix:
    """exp(-G h) = f(m) + f[m, M] (G - m), f(s) = exp(-s h), over the eigenvalues m, M of G, Re m <= Re M."""
    swap = waves.p.real > waves.q.real
    m = np.where(swap, waves.q, waves.p)
    gap = np.where(swap, waves.p_minus_q, -waves.p_minus_q)
    f = np.exp(-m * h)
    df = f * np.expm1(-gap * h) / gap
    G = waves.G
    return Matrix(f + df * (G.a - m), df * G.b, df * G.c, f + df * (G.d - m))


def _add_layer(waves: Waves, h: float, below: Matrix | None) -> Matrix:
    """Stiffness seen at the top of a layer of thickness h resting on ``below`` (None: rigid).

    Down-going motion a, reflected R a with R = (Yb + Yu)^-1 (Yd - Yb), Q = E~ R E (E~ mirrored decay):
    Y = Yd - (Yd + Yu) Q (1 + Q)^-1.
    """
    Yd, E = waves.Y, _decay(waves, h)
    Yu = Matrix(Yd.a, -Yd.b, -Yd.c, Yd.d)
    mirrored = Matrix(E.a, -E.b, -E.c, E.d)
    if below is None:
        Q = _times(mirrored, Matrix(-E.a, -E.b, -E.c, -E.d))
    else:
        both = Matrix(below.a + Yu.a, below.b + Yu.b, below.c + Yu.c, below.d + Yu.d)
        rest = Matrix(Yd.a - below.a, Yd.b - below.b, Yd.c - below.c, Yd.d - below.d)
        R = _times(_inverse(both), rest)
        Q = _times(mirrored, _times(R, E))
    S = _times(Q, _inverse(Matrix(1 + Q.a, Q.b, Q.c, 1 + Q.d)))
    b = Yd.b - (Yd.a * S.b + Yd.d * S.c)  # the mean of both off-diagonals, equal in exact arithmetic
    return Matrix(Yd.a - 2 * Yd.a * S.a, b, b, Yd.d - 2 * Yd.d * S.d)


def _times(x: Matrix, y: Matrix) -> Matrix:
    return Matrix(x.a * y.a + x.b * y.c, x.a * y.b + x.b * y.d, x.c * y.a + x.d * y.c, x.c * y.b + x.d * y.d)


def _inverse(x: Matrix) -> Matrix:
    det = x.a * x.d - x.b * x.c
    return Matrix(x.d / det, -x.b / det, -x.c / det, x.a / det)
