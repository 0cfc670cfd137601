"""What targets share when they are aimed at together: the drives are those of each target aimed at alone."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scenes import sampled
from test_rendering import waves

from forearm_fem.errors import DataError, GeometryError
from forearm_fem.ports import Port
from forearm_fem.rendering import (
    AutoZeros,
    Combination,
    FixedZeros,
    Funneling,
    InverseFilter,
    SearchedZeros,
    ThesisZeros,
    drives,
    render_all,
    ricker,
)
from forearm_fem.rendering.renderers import known_bins

COARSE = np.arange(10.0, 500.1, 10.0)  # the bins of a record of 0.1 s
TARGETS = tuple("123456789")
FIXED = FixedZeros({t: tuple(sorted({"1", "3", "5", "7"} - {t})) for t in TARGETS})
ZEROS = {"auto": AutoZeros(), "thesis": ThesisZeros(), "fixed": FIXED, "searched": SearchedZeros(size=2)}


def contacts(columns: int, rows: int):
    """A lattice of actuators 45 mm wide around the grid; no centre is a point, where waves are endless."""
    x, y = np.linspace(-0.0225, 0.0225, columns), np.linspace(-0.0225, 0.0225, rows)
    places = [(float(a) + 1e-3, float(b) + 5e-4, 0.0) for a in x for b in y]
    return tuple(Port(f"A{k + 1}", "contact", p) for k, p in enumerate(places))


def matrix(columns: int, rows: int, *, dead: bool = False, gap: bool = False):
    """G of waves under these actuators; without the last one, or without some bins in all entries of a point."""
    inputs = contacts(columns, rows)
    g = waves(COARSE, inputs=inputs, gains=np.linspace(0.7, 1.3, len(inputs)))
    valid = np.ones(g.values.shape, dtype=bool)
    valid[:, :, -1] &= not dead
    valid[10:14, 4, :] &= not gap
    return replace(g, values=np.where(valid, g.values, np.nan), valid=valid)


@pytest.mark.parametrize("zeros", ZEROS)
@pytest.mark.parametrize(("columns", "rows"), [(2, 2), (3, 2), (3, 3)])
@pytest.mark.filterwarnings("ignore:nothing is known of G's actuator")
@pytest.mark.parametrize("harm", sampled(["gap", "none", "dead"], 3))
def test_targets_together_are_driven_as_each_alone(zeros, columns, rows, harm):
    """All nine at once against a fresh renderer on a bare G for each, to the last bit."""
    g = matrix(columns, rows, dead=harm == "dead", gap=harm == "gap")
    rule, wavelet = ZEROS[zeros], ricker(duration=0.1)
    targets = TARGETS if zeros != "searched" else TARGETS[:2]  # a search aims some dozen times

    def methods():
        return (InverseFilter(zeros=rule), Funneling(), Combination(zeros=rule))

    together = render_all(g, targets, methods(), wavelet)
    usable = together.bridged.transfer
    for method in methods():
        for target in targets:
            fresh = drives(method, usable, target, wavelet)
            assert np.array_equal(together[method.name, target].drives.spectrum, fresh.spectrum), (method.name, target)


def test_a_target_that_funneling_cannot_serve_is_refused_as_it_is_alone():
    """The point outside all actuators, among points that can be served."""
    g = matrix(2, 2)
    far = replace(g.outputs[0], position=(0.2, 0.2, 0.0))
    g = replace(g, outputs=(far, *g.outputs[1:]))
    with pytest.raises(GeometryError) as alone:
        drives(Funneling(), g, far.name, ricker(duration=0.1))
    with pytest.raises(GeometryError) as together:
        render_all(g, TARGETS, (InverseFilter(), Funneling()), ricker(duration=0.1))
    assert str(together.value) == str(alone.value)


def test_the_output_that_nothing_is_known_of_is_named_alone():
    """Of five control points one was never measured: the other four are not to be measured again."""
    valid = np.ones((7, 5, 2), dtype=bool)
    valid[:, 4] = False
    ports = tuple(SimpleNamespace(name=str(k)) for k in (1, 3, 5, 7, 9))
    placed: Any = SimpleNamespace(bins=SimpleNamespace(valid=valid), outputs=ports)
    with pytest.raises(DataError, match=r"for output\(s\) 9; choose"):
        known_bins(placed, [0, 1, 2, 3, 4])
