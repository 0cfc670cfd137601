"""What fibres along the limb do to S: an operator with a shear stiffness of its own along x, on a slab.

    python3 benchmarks/anisotropy.py [default|lean]

Transversely isotropic and incompressible: mu_across as it is, and (mu_along - mu_across) times the squares of both
shears that hold x. Muscle has 5.8 and 1.9 kPa along and across (PMC8754054), skin 24.9 and 13.6 (ultrasound of 40 MHz,
five people); here the ratios count, about the isotropic modulus as geometric mean.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from unittest import mock

import numpy as np
from scipy.sparse import coo_array

from forearm_fem.device import close_loop
from forearm_fem.engines import fem
from forearm_fem.fem.assembly import model as assembly
from forearm_fem.fem.assembly import tissues as elements
from forearm_fem.fem.assembly.coefficients import Polynomial
from forearm_fem.fem.assembly.model import ForearmModel, build_model
from forearm_fem.fem.assembly.operator import Term
from forearm_fem.geometry.build import build_mesh
from forearm_fem.metrics.strength import signal_strength_table
from forearm_fem.rendering.job import RenderJob
from forearm_fem.scenario import Scenario, parse_scenario
from forearm_fem.scenario.sweep import frequencies
from forearm_fem.transfer import finite
from forearm_fem.typing import FloatArray

RATIOS = {"muscle": 5.8 / 1.9, "skin": 24.9 / 13.6}
SCENE = {
    "limb": {"shape": "slab", "length": 0.13, "width": 0.11, "depth": 0.03},
    "device": {"cone": {"contact": "pressure"}},
    "sweep": {"duration": 0.06},
    "mesh": {"element": "P2", "size_grid": 3.5e-3, "size_contact": 2.3e-3, "size_far": 1e-2},
    "rendering": {"window": [-0.03, 0.02]},
}
LEAN = {
    "limb": {
        **SCENE["limb"], "length": 0.11, "width": 0.1, "depth": 0.025,
        "layers": [{"tissue": "skin", "thickness": 1.5e-3}, {"tissue": "fat", "thickness": 1e-3}],
    },
    "mesh": {"element": "P2", "size_grid": 5.5e-3, "size_contact": 3.5e-3, "size_far": 1.4e-2},
}  # fmt: skip
STACKS = {"default": SCENE, "lean": {**SCENE, **LEAN}}  # the same fibres on another arm, and a coarser mesh


def along_fibres(metric: FloatArray) -> FloatArray:
    """Blocks (3, 3, ...) of the energy of both shears with x, from products (3, 3, ...) of gradients."""
    blocks = np.zeros_like(metric)
    for i in (1, 2):
        blocks[0, 0] += metric[i, i]
        blocks[i, i] += metric[0, 0]
        blocks[0, i] += metric[i, 0]
        blocks[i, 0] += metric[0, i]
    return blocks


@contextmanager
def patched() -> Iterator[None]:
    """Element matrices of :func:`along_fibres` in place of the deviatoric ones."""
    plain = mock.patch.object(elements, "compiled", return_value=None)
    with mock.patch.object(elements, "_deviatoric", along_fibres), plain:
        yield


def with_fibres(tissue: str) -> object:
    """``build_model`` for fibres along x in a ``tissue``."""

    def build(*args: object, **how: object) -> ForearmModel:
        """The model, its tissue softer across and stiffer along."""
        plain = build_model(*args, **how)  # type: ignore[arg-type]
        with patched():
            other = build_model(*args, **how)  # type: ignore[arg-type]
        name, root = f"shear {tissue}", np.sqrt(RATIOS[tissue])
        own, n = plain.operator, plain.operator.n
        stiff = next(t for t in other.operator.terms if t.name == name)
        entries = coo_array(other.operator.term_matrix(stiff))
        entries.eliminate_zeros()
        pattern = np.repeat(np.arange(n, dtype=np.int64), np.diff(own.indptr)) * n + own.indices
        order = np.argsort(pattern)
        wanted = entries.row.astype(np.int64) * n + entries.col
        positions = order[np.searchsorted(pattern, wanted, sorter=order)]
        assert np.array_equal(pattern[positions], wanted)
        ascending = np.argsort(positions)
        positions, values = positions[ascending].astype(own.terms[0].positions.dtype), entries.data[ascending]
        term = next(t for t in own.terms if t.name == name)
        mu, eta, more = term.coefficient.mu, term.coefficient.eta, root - 1 / root  # type: ignore[attr-defined]
        terms = [t for t in own.terms if t is not term]
        terms.append(replace(term, coefficient=Polynomial(mu / root, eta / root)))
        coefficient = Polynomial(mu * more, eta * more)
        terms.append(Term(f"fibres {tissue}", positions, values, coefficient))
        return replace(plain, operator=replace(plain.operator, terms=tuple(terms)))

    return build


def strength(scenario: Scenario, build: object) -> FloatArray:
    """S (n_method, n_group)."""
    with mock.patch.object(fem, "build_model", build):
        found = fem.solve_fem(scenario, build_mesh(scenario), frequencies(scenario.sweep), tolerance=1e-3).compliance
    g = finite(close_loop(found, scenario.device))
    job = RenderJob.of(scenario, g)
    return signal_strength_table(job.names, job.targets, job.strengths(g, g)[0, 0]).mean.T


def main() -> None:
    """The table."""
    assert assembly.build_model is build_model
    scenario = parse_scenario(STACKS[(sys.argv[1:] or ["default"])[0]])
    print("| fibres | middle | edges | corners |\n| --- | --- | --- | --- |")
    for name, build in (("none", build_model), *((t, with_fibres(t)) for t in RATIOS)):
        s = strength(scenario, build)
        print(f"| {name} | {' | '.join(' / '.join(f'{x:.2f}' for x in column) for column in s.T)} |", flush=True)


if __name__ == "__main__":
    main()
