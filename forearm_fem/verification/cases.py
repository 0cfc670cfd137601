"""Rows of the finite-element core alone: manufactured solutions, closed forms, structure."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from ..fem.reduction.poles import pole_residue
from ..fem.reduction.sweep import direct_sweep, reduced_sweep
from ..scenario.sweep import DirectSolve, ReducedSolve
from ..transfer import relative_error
from .closed import free_block_error, punch_stiffness, shear_bar_errors, sphere_errors
from .manufactured import manufactured_errors, orders
from .rows import Row
from .scenes import DIRECT, MOVED_HZ, flesh, held_block, moved_compliances

_NAMES = {"P1": "MINI", "P2": "P2/P1", "P3": "P3/P2"}
_THEORY = {"P1": (2, 1, 1), "P2": (3, 2, 2), "P3": (4, 3, 3)}
_MESHES = {"P1": [8, 12], "P2": [5, 8], "P3": [3, 5]}
_JUMP_MESHES = {"P1": [8, 12], "P2": [5, 8], "P3": [4, 6]}
_NORMS = ("u in L2", "u in H1", "p in L2")
BULKS = (1e4, 1e6, 1e8, 1e10, 1e12, math.inf)  # [Pa]
_MMS = "manufactured complex waves"


def order_rows(element: str, *, jump: float = 1.0, bulks: Sequence[float] = BULKS) -> Iterator[Row]:
    """Orders seen, in displacement (L2, H1) and pressure, against theory: the worst over ``bulks`` [Pa].

    With a modulus ``jump`` the orders must not fall below theory.
    """
    jumps, counts = jump != 1.0, _JUMP_MESHES[element] if jump != 1.0 else _MESHES[element]
    seen = [orders([manufactured_errors(element, n, b, jump=jump) for n in counts], counts) for b in bulks]
    where = f"bulk {bulks[0]:.3g} ... {bulks[-1]:.3g} Pa" + (f", modulus jump {jump:g}" if jumps else "")
    for i, (name, theory) in enumerate(zip(_NORMS, _THEORY[element], strict=True)):
        at_least = jumps or (element == "P1" and i == 2)
        gaps = [theory - o[i] if at_least else abs(o[i] - theory) for o in seen]
        worst = seen[int(np.argmax(gaps))][i]
        quantity = f"order of {name} ({worst:.2f} at worst) off {theory}"
        reason = "asked for; it may superconverge, not fall below" if at_least else "asked for"
        yield Row(f"order, {_NAMES[element]}, {where}", _MMS, quantity, max(0.0, *gaps), 0.15, reason)


def locking_rows() -> Iterator[Row]:
    """The error constant over bulk moduli 1e4 ... infinity on one mesh: its spread over its size."""
    for element in ("P2", "P3"):
        errors = [manufactured_errors(element, _MESHES[element][0], b) for b in BULKS]
        for chosen, where, allowed, reason in (
            (errors, "1e4 ... inf Pa", 0.25, "the exact wave itself changes by mu/bulk = 0.6 at 1e4 Pa"),
            (errors[1:], "1e6 ... inf Pa", 0.02, "mu/bulk = 6e-3 at the softest"),
        ):
            for name in ("l2", "h1", "pressure"):
                values = np.array([getattr(e, name) for e in chosen])
                spread = float(np.ptp(values) / values.max())
                yield Row(f"no locking, {_NAMES[element]}, {where}", _MMS, f"spread of the {name} error", spread,
                          allowed, reason)  # fmt: skip


def shear_bar_rows() -> Iterator[Row]:
    """A Kelvin-Voigt shear wave in a bar."""
    for element, counts, tolerance in (("P2", (2, 4), 1e-3), ("P3", (1, 2), 5e-4)):
        _, fine = shear_bar_errors(element, counts)
        yield Row(f"shear wave in a bar, {_NAMES[element]}", "sin kx/(mu k cos kL)", "u at all nodes", fine, tolerance,
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
    _, fine = sphere_errors((3, 6), 300.0)
    yield Row("oscillating sphere, 300 Hz", "Oestreicher 1951", "impedance", fine, 0.01,
              "flat facets: second order, 3 % at three splits")  # fmt: skip
    (bent,) = sphere_errors((3,), 300.0, curved=True, element="P3")
    yield Row("oscillating sphere, 300 Hz, edges bent, P3/P2", "Oestreicher 1951", "impedance", bent, 0.003,
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


def moved_rows() -> Iterator[Row]:
    """The same block turned, 5 m away, and scaled with every dimensionless group kept."""
    truth = direct_sweep(held_block(2), MOVED_HZ, DIRECT).values
    for name, values in moved_compliances():
        gap = float(np.abs(values - truth).max() / np.abs(truth).max())
        yield Row(f"mesh {name}", "the block where it was", "C at 1, 40, 500 Hz", gap, 1e-9, "rounding of coordinates")


def solver_rows() -> Iterator[Row]:
    """Single against double precision, reduced against direct sweep, poles and residues."""
    model, band = held_block(3, tissue=flesh(bulk=2.2e9)), np.linspace(10.0, 500.0, 197)
    checks = np.array([10.0, 33.0, 80.0, 140.0, 210.0, 333.0, 470.0, 500.0])
    truth = direct_sweep(model, checks, DIRECT).values
    single = direct_sweep(model, checks, DirectSolve(precision="single")).values
    gap = float(relative_error(single, truth).max())
    yield Row("single precision", "double precision", "e(f), 10-500 Hz", gap, 1e-7, "refined to a residual of 1e-9")
    swept = reduced_sweep(model, band, ReducedSolve(), tolerance=1e-6)
    assert swept.reduced is not None
    error = float(relative_error(swept.reduced.compliance(checks), truth).max())
    yield Row(f"reduced sweep, {swept.factorisations} factorisations", "direct solves", "e(f), 10-500 Hz", error, 1e-5,
              "asked for 1e-6 where least certain")  # fmt: skip
    fast = pole_residue(swept.reduced)
    assert fast is not None
    gap = float(relative_error(fast.compliance(band), swept.reduced.compliance(band)).max())
    yield Row("poles and residues", "dense reduced solves", "e(f), 197 bins", gap, 1e-8, "its own limit")
