"""Rows of the finite-element core alone: manufactured solutions, closed forms, structure."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from ..fem.compress import pole_residue
from ..fem.sweep import direct_sweep, reduced_sweep
from ..scenario.sweep import SolverOptions
from ..transfer import relative_error
from .closed import free_block_error, punch_stiffness, shear_bar_errors, sphere_errors
from .manufactured import manufactured_errors, orders
from .rows import Row
from .scenes import DIRECT, flesh, held_block

_NAMES = {"P1": "MINI", "P2": "P2/P1", "P3": "P3/P2"}
_THEORY = {"P1": (2, 1, 1), "P2": (3, 2, 2), "P3": (4, 3, 3)}
_MESHES = {"P1": [8, 12], "P2": [5, 8], "P3": [3, 5]}
_MMS = "manufactured complex waves"


def order_rows(element: str, *, jump: float = 1.0) -> Iterator[Row]:
    """Orders seen, in displacement (L2, H1) and pressure, against theory; compressible and incompressible."""
    counts = [4, 6] if jump != 1.0 and element == "P3" else _MESHES[element]
    for bulk in (2.2e9,) if jump != 1.0 else (1e4, 2.2e9, math.inf):
        seen = orders([manufactured_errors(element, n, bulk, jump=jump) for n in counts], counts)
        for name, order, theory in zip(("u in L2", "u in H1", "p in L2"), seen, _THEORY[element], strict=True):
            at_least = (element == "P1" and name == "p in L2") or jump != 1.0
            gap = max(0.0, theory - order) if at_least else abs(order - theory)
            where = f"bulk {bulk:.3g} Pa" + (f", modulus jump {jump:g}" if jump != 1.0 else "")
            reason = "not below theory; superconverges" if at_least else "asked for"
            yield Row(f"order, {_NAMES[element]}, {where}", _MMS, f"order of {name} off {theory}", gap, 0.15, reason)


def locking_rows() -> Iterator[Row]:
    """The same mesh for bulk moduli 1e6 ... infinity: the error's spread over its size."""
    for element in ("P2", "P3"):
        n = _MESHES[element][0]
        errors = [manufactured_errors(element, n, b) for b in (1e6, 1e8, 1e10, 1e12, math.inf)]
        for name in ("l2", "h1", "pressure"):
            values = np.array([getattr(e, name) for e in errors])
            spread = float(np.ptp(values) / values.max())
            yield Row(f"no locking, {_NAMES[element]}, 1e6 ... inf Pa", _MMS, f"spread of the {name} error", spread,
                      0.02, "mu/bulk = 1e-2 at the softest")  # fmt: skip


def shear_bar_rows() -> Iterator[Row]:
    """A Kelvin-Voigt shear wave in a bar."""
    for element, counts, tolerance in (("P2", (2, 4), 1e-3), ("P3", (1, 2), 5e-4)):
        _, fine = shear_bar_errors(element, counts)
        yield Row(f"shear wave in a bar, {_NAMES[element]}", "sin kx/(mu k cos kL)", "u at all nodes", fine, tolerance,
                  "theory's order from the next coarser mesh")  # fmt: skip


def punch_rows() -> Iterator[Row]:
    """8 mu a, walls extrapolated away with k = 8 mu a (1 + c a/R)."""
    for contact in ("frictionless", "bonded"):
        near, far = (punch_stiffness(contact, side) for side in (0.1, 0.2))
        error = abs((2 * far - near) / (8 * 7860.0 * 3.5e-3) - 1)
        yield Row(f"rigid punch, {contact}", "8 mu a", "static stiffness", error, 0.02,
                  "rim singularity on 0.4 mm elements 1 %, walls (a/R)^2 0.5 %")  # fmt: skip


def sphere_rows() -> Iterator[Row]:
    """Oestreicher's oscillating sphere."""
    _, fine = sphere_errors((3, 6), 300.0)
    yield Row("oscillating sphere, 300 Hz", "Oestreicher 1951", "impedance", fine, 0.01,
              "flat facets: second order, 3 % at three splits")  # fmt: skip


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


def solver_rows() -> Iterator[Row]:
    """Single against double precision, reduced against direct sweep, poles and residues."""
    model, band = held_block(3, tissue=flesh(bulk=2.2e9)), np.linspace(10.0, 500.0, 197)
    checks = np.array([10.0, 33.0, 80.0, 140.0, 210.0, 333.0, 470.0, 500.0])
    truth = direct_sweep(model, checks, DIRECT).values
    single = direct_sweep(model, checks, SolverOptions(precision="single", sweep="direct")).values
    gap = float(relative_error(single, truth).max())
    yield Row("single precision", "double precision", "e(f), 10-500 Hz", gap, 1e-7, "refined to a residual of 1e-9")
    swept = reduced_sweep(model, band, SolverOptions(), tolerance=1e-6)
    assert swept.reduced is not None
    error = float(relative_error(swept.reduced.compliance(checks), truth).max())
    yield Row(f"reduced sweep, {len(swept.expansions)} expansions", "direct solves", "e(f), 10-500 Hz", error, 1e-5,
              "asked for 1e-6 where least certain")  # fmt: skip
    fast = pole_residue(swept.reduced)
    assert fast is not None
    gap = float(relative_error(fast.compliance(band), swept.reduced.compliance(band)).max())
    yield Row("poles and residues", "dense reduced solves", "e(f), 197 bins", gap, 1e-8, "its own limit")
