"""Reference surface kernels with 60 digits; run by hand (needs mpmath): python make_layered_kernel.py.

Independent of forearm_fem: potentials in every layer, all interface conditions in one dense linear system
(Thomson/Haskell/Knopoff), no reformulation against cancellation. Writes layered_kernel.json.
"""

import json
import pathlib

from mpmath import exp, matrix, mp, mpc, mpf, pi, sqrt

mp.dps = 60

# name: (layers (thickness m or None, density, mu Pa, eta Pa s, K Pa or None = incompressible), base)
CASES = {
    "preset O": (
        [
            (8e-5, 1100.0, 350e3, 20.0, 2.2e9),
            (1.2e-3, 1100.0, 13e3, 3.0, 2.2e9),
            (3e-3, 950.0, 5e3, 1.5, 2.2e9),
            (None, 1060.0, 1e4, 4.0, 2.2e9),
        ],
        "halfspace",
    ),
    "preset O incompressible on bone": (
        [
            (8e-5, 1100.0, 350e3, 20.0, None),
            (1.2e-3, 1100.0, 13e3, 3.0, None),
            (3e-3, 950.0, 5e3, 1.5, None),
            (1.5e-2, 1060.0, 1e4, 4.0, None),
        ],
        "rigid",
    ),
    "1 MPa film on lossless fat": (
        [(8e-5, 1100.0, 1e6, 0.0, 2.2e9), (None, 950.0, 5e3, 0.0, 2.2e9)],
        "halfspace",
    ),
    "compressible": (
        [(2e-3, 1100.0, 2e4, 5.0, 6e4), (1e-2, 900.0, 5e3, 2.0, 4e4)],
        "rigid",
    ),
}
FREQUENCIES = [0.5, 50.0, 500.0]
WAVENUMBERS = [0.37, 11.0, 130.0, 900.0, 1.1e4, 2.3e6]


def columns(k, w, layer, z):
    """Displacement (X, W) and stress (S, N) of P down, S down, P up, S up at depth z; rows 4, columns 4.

    Down-going waves have their origin at the top, up-going ones at the bottom, so nothing grows.
    """
    h, rho, mu, eta, bulk = layer
    mu = mpc(mu, w * eta)
    ks2 = rho * w * w / mu
    kp2 = mpf(0) if bulk is None else rho * w * w / (bulk + 4 * mu / 3)
    p, q = sqrt(k * k - kp2), sqrt(k * k - ks2)
    p, q = (-p if p.real < 0 else p), (-q if q.real < 0 else q)
    shear = mu * (ks2 - 2 * k * k)
    down = [(k, p, -2 * mu * k * p, shear), (q, k, shear, -2 * mu * k * q)]
    up = [(x, -y, -s, n) for x, y, s, n in down]
    height = mpf(0) if h is None else h
    decay = [exp(-p * z), exp(-q * z), exp(-p * (height - z)), exp(-q * (height - z))]
    return [[decay[j] * (down + up)[j][i] for j in range(4)] for i in range(4)]


def kernel(k, w, layers, base):
    """W(0)/sigma for unit downward stress: N(0) = -1, S(0) = 0."""
    k, w = mpf(k), mpf(w)
    layers = [tuple(None if v is None else mpf(v) for v in layer) for layer in layers]
    n = 4 * len(layers) - (2 if base == "halfspace" else 0)
    a, b = matrix(n, n), matrix(n, 1)
    top = columns(k, w, layers[0], mpf(0))
    width = min(4, n)
    for j in range(width):
        a[0, j], a[1, j] = top[2][j], top[3][j]
    b[1] = -1
    row = 2
    for i, layer in enumerate(layers):
        if layer[0] is None:
            break
        at_bottom = columns(k, w, layer, layer[0])
        last = i == len(layers) - 1
        for r in range(2 if last else 4):
            for j in range(4):
                a[row + r, 4 * i + j] = at_bottom[r][j]
        if not last:
            below = columns(k, w, layers[i + 1], mpf(0))
            for r in range(4):
                for j in range(min(4, n - 4 * (i + 1))):
                    a[row + r, 4 * (i + 1) + j] = -below[r][j]
            row += 4
    x = mp.lu_solve(a, b)
    return sum(top[1][j] * x[j] for j in range(width))


def main():
    """Write every case as (n_freq, n_k) real and imaginary parts [m/Pa]."""
    out = {"frequency_hz": FREQUENCIES, "wavenumber_1_per_m": WAVENUMBERS, "cases": []}
    for name, (layers, base) in CASES.items():
        values = [[kernel(k, 2 * pi * mpf(f), layers, base) for k in WAVENUMBERS] for f in FREQUENCIES]
        out["cases"].append(
            {
                "name": name,
                "layers": layers,
                "base": base,
                "real": [[float(v.real) for v in row] for row in values],
                "imag": [[float(v.imag) for v in row] for row in values],
            }
        )
    path = pathlib.Path(__file__).with_name("layered_kernel.json")
    path.write_text(json.dumps(out, indent=1) + "\n")


if __name__ == "__main__":
    main()
