"""Rigid discs in the layered model: static limits, terms, azimuthal orders of scattering, and seconds of a sweep.

    python3 benchmarks/rigid_discs.py

Prints four tables.
"""

from __future__ import annotations

import math
import time

import numpy as np

from forearm_fem.engines.layered import flat_disc, flat_layers, flat_ports, solve_layered
from forearm_fem.layered import Disc, Layer, bonded_disc, layered_compliance, rigid_disc
from forearm_fem.scenario import Scenario, parse_scenario
from forearm_fem.scenario.sweep import frequencies
from forearm_fem.typing import ComplexArray

RADIUS, MU = 3.5e-3, 7860.0


def statics() -> None:
    """d/F of a disc on a half-space at 1 mHz over the closed forms."""
    print("nu, contact: error with 3, 6, 12 terms")
    for nu in (0.5, 0.45, 0.3, 0.0):
        bulk = math.inf if nu == 0.5 else 2 * MU * (1 + nu) / (3 * (1 - 2 * nu))
        body = [Layer(math.inf, 1050.0, lambda omega: MU * (1 + 1e-4j) + 0 * omega, bulk)]
        for contact, closed in (("bonded", bonded_disc), ("frictionless", rigid_disc)):
            disc = [Disc(0.0, 0.0, RADIUS, contact)]
            found = [abs(layered_compliance(body, np.array([6e-3]), disc, disc, terms=n).values[0, 0, 0])
                     for n in (3, 6, 12)]  # fmt: skip
            print(nu, contact, *(f"{abs(u / closed(RADIUS, MU, nu) - 1):.1e}" for u in found))


def thesis(contact: str) -> Scenario:
    """The thesis' device on the default layers."""
    return parse_scenario({"engine": "layered", "device": {"cone": {"contact": contact}}})


def error(found: ComplexArray, truth: ComplexArray) -> str:
    """e(f) per frequency."""
    worst = np.nanmax(np.abs(found - truth), axis=(1, 2)) / np.nanmax(np.abs(truth), axis=(1, 2))
    return " ".join(f"{e:.1e}" for e in worst)


def series(contact: str) -> None:
    """e(f) of fewer terms under one disc, and of fewer orders between the four."""
    scenario = thesis(contact)
    layers, discs = flat_layers(scenario), [flat_disc(port) for port in flat_ports(scenario)]
    omega = 2 * np.pi * np.array([10.0, 100.0, 300.0, 500.0])
    one = [discs[0], Disc(discs[0].x + 0.01, discs[0].y)]
    truth = layered_compliance(layers, omega, one[:1], one, tolerance=1e-10, terms=14).values
    for n in (1, 2, 3, 4, 5, 6, 8):
        print(
            contact,
            n,
            "terms",
            error(layered_compliance(layers, omega, one[:1], one, tolerance=1e-10, terms=n).values, truth),
        )
    truth = layered_compliance(layers, omega, discs, discs, tolerance=1e-8, terms=10, orders=6).values
    for m in (0, 1, 2, 3, 4):
        result = layered_compliance(layers, omega, discs, discs, tolerance=1e-8, orders=m)
        print(contact, m, "orders", error(result.values, truth), "stated", " ".join(f"{e:.1e}" for e in result.error))


def seconds() -> None:
    """Wall seconds of the thesis' 981 bins."""
    for contact in ("pressure", "frictionless", "bonded"):
        scenario = thesis(contact)
        start = time.perf_counter()
        found = solve_layered(scenario, frequencies(scenario.sweep))
        print(contact, f"{time.perf_counter() - start:.2f} s, stated {found.errors[0].band:.1e}")


if __name__ == "__main__":
    statics()
    for kind in ("frictionless", "bonded"):
        series(kind)
    seconds()
