"""Devices as they come: rows, staggered rows and free places; what renders on them, and what is left out."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from forearm_fem.engines.simulation import render, simulate
from forearm_fem.errors import GeometryError, ScenarioError
from forearm_fem.ports import Port, is_thesis_grid, positions
from forearm_fem.questions.run import Run, run_render
from forearm_fem.rendering import funneling_weights
from forearm_fem.scenario import Scenario, parse_scenario
from forearm_fem.show import make_figures
from forearm_fem.show.data import Results
from forearm_fem.show.facts import scene_block
from forearm_fem.show.registry import applies, kinds

PRESSURE = {"cone": {"contact": "pressure"}}
LAYERED: dict[str, Any] = {
    "engine": "layered",
    "sweep": {"f_min": 100.0, "f_max": 400.0, "duration": 0.05, "sample_rate": 2000.0},
    "rendering": {"window": [-0.01, 0.01]},
}
HEXAGON = {"rows": 3, "columns": [2, 3, 2], "spacing": 0.0217, "spacing_y": 0.025}
SCATTERED = [[0.0, 0.0], [0.03, 0.004], [-0.027, 0.02], [-0.03, -0.018], [0.011, -0.03], [0.008, 0.028]]


def contacts(places) -> tuple[Port, ...]:
    return tuple(Port(f"A{k + 1}", "contact", (x, y, 0.0), radius=0.0035) for k, (x, y) in enumerate(places))


def point(x: float, y: float) -> Port:
    return Port("t", "point", (x, y, 0.0))


def test_the_thesis_device_and_grid_are_untouched():
    half = 0.0225
    assert Scenario().device.centres == ((-half, -half), (-half, half), (half, -half), (half, half))
    assert Scenario().grid.places[0] == (-0.0133, -0.0133)
    assert Scenario().grid.places[5] == (0.0, 0.0133)


def test_rows_of_different_lengths_interlock():
    """Six around one: all seven as far from the next as pitches of a regular hexagon are."""
    places = np.array(parse_scenario({"device": HEXAGON}).device.centres)
    away = np.linalg.norm(places - places[3], axis=1)
    assert np.allclose(np.delete(away, 3), 0.025, atol=5e-5)  # 0.0217 is sin 60 degrees of it, rounded
    staggered = parse_scenario({"device": {"rows": 2, "columns": 3, "stagger": 0.5, "spacing_y": 0.02}}).device.centres
    assert np.allclose(np.array(staggered)[:, 1], [-0.025, -0.005, 0.015, -0.015, 0.005, 0.025])


def test_the_distance_of_equation_6_by_hand():
    """45 mm apart, target 20 mm along x and 5 mm along y from the first: (1 - d_x/D)(1 - d_y/D)."""
    inputs, target = contacts([(0, 0), (0, 0.045), (0.045, 0), (0.045, 0.045)]), point(0.020, 0.005)
    for distance, length in (("spacing", 0.045), ("diagonal", 0.045 * np.sqrt(2)), (0.0595, 0.0595)):
        x, y = 1 - np.array([20, 25]) / (1e3 * length), 1 - np.array([5, 40]) / (1e3 * length)
        by_hand = [x[0] * y[0], x[0] * y[1], x[1] * y[0], x[1] * y[1]]
        assert funneling_weights(inputs, target, distance) == pytest.approx(by_hand, rel=1e-12)
    three = contacts([(0.045 * i, 0.045 * j) for i in range(3) for j in range(2)])
    far = funneling_weights(three, point(0.06, 0.01), "diagonal")
    assert (far > 0).tolist() == [False, False, True, True, True, True]  # those around the target
    with pytest.raises(GeometryError, match=r"shorter than the 0.045 m"):
        funneling_weights(inputs, target, 0.02)
    with pytest.raises(GeometryError, match="no rectangle"):
        funneling_weights(contacts(SCATTERED), point(0.01, 0.01), "diagonal")


@pytest.mark.parametrize("places", [SCATTERED, SCATTERED[:3], parse_scenario({"device": HEXAGON}).device.centres])
def test_funneling_weights_put_the_centre_of_gravity_on_the_target(places):
    """The linear law: non-negative, summing to one, their mean place the target's, three actuators at most."""
    inputs, rng = contacts(places), np.random.default_rng(0)
    for share in rng.dirichlet(np.ones(len(places)), 20):
        at = share @ np.array(places)  # inside the layout
        weights = funneling_weights(inputs, point(*at))
        assert weights @ positions(inputs)[:, :2] == pytest.approx(at, abs=1e-12)
        assert weights.min() >= 0
        assert np.count_nonzero(weights > 1e-12) <= 3


def test_funneling_falls_back_on_the_law_of_lines_and_rectangles():
    line = contacts([(k * 0.02 * np.cos(0.3), k * 0.02 * np.sin(0.3)) for k in (2, 0, 1, 3)])
    assert funneling_weights(line, point(0.025 * np.cos(0.3), 0.025 * np.sin(0.3))) == pytest.approx([0.25, 0, 0.75, 0])
    square = [(0, 0), (0.03, 0), (0, 0.03), (0.03, 0.03)]
    corner = contacts([*square, (0.09, 0.015)])  # the fifth makes it no rectangle; diagonals are a matter of choice
    assert funneling_weights(corner, point(0.015, 0.015)) == pytest.approx([0.25, 0.25, 0.25, 0.25, 0])
    mirrored = funneling_weights(corner, point(0.01, 0.005)), funneling_weights(corner, point(0.01, 0.025))
    assert mirrored[0] == pytest.approx(mirrored[1][[2, 3, 0, 1, 4]])


def test_the_triangle_is_of_actuators_that_no_other_is_nearer_than():
    inputs = contacts(SCATTERED)
    at = np.array([0.004, 0.006])
    used = np.array(SCATTERED)[funneling_weights(inputs, point(*at)) > 0]
    spans = [max(np.linalg.norm(a - b) for a, b in combinations(used, 2))]
    others = [c for c in combinations(np.array(SCATTERED), 3) if _inside(np.array(c), at)]
    assert spans[0] <= min(max(np.linalg.norm(a - b) for a, b in combinations(c, 2)) for c in others) + 1e-12


def _inside(corner, at) -> bool:
    share = np.linalg.lstsq(np.vstack([corner.T, np.ones(3)]), np.append(at, 1), rcond=None)[0]
    return bool(share.min() > 0)


def test_targets_beside_a_line_or_a_triangle_are_told():
    with pytest.raises(GeometryError, match=r"'t' lies 0\.01 m outside the actuators' line"):
        funneling_weights(contacts([(0, 0), (0.02, 0), (0.04, 0)]), point(0.01, 0.01))
    with pytest.raises(GeometryError, match=r"'t' lies outside the actuators"):
        funneling_weights(contacts(SCATTERED[:3]), point(0.03, 0.03))
    with pytest.raises(GeometryError, match="expected two or more, got one"):
        funneling_weights(contacts([(0, 0)]), point(0, 0))


def test_a_symmetric_layout_has_symmetric_strengths():
    """Mirrored in x and in y: a hexagon with a middle on a 3x3 grid, by all three methods."""
    scenario = parse_scenario({**LAYERED, "device": {**HEXAGON, **PRESSURE}})
    found = render(simulate(scenario))
    assert found.methods == ("inverse filter", "funneling", "combination")
    s = found.strengths.reshape(3, 3, 3)
    # the integrals are good to 1e-7 of the largest entry, and drives divide by entries down to a thousandth of it
    assert np.allclose(s, s[:, ::-1], rtol=1e-3)
    assert np.allclose(s, s[:, :, ::-1], rtol=1e-3)


@pytest.mark.parametrize(
    ("device", "grid", "left_out"),
    [
        pytest.param({"contacts": [[0.0, 0.0]]}, {}, ("funneling", "combination"), marks=pytest.mark.slow),
        pytest.param({"rows": 5, "columns": 1, "spacing": 0.015}, {"rows": 6, "columns": 1, "pitch": 0.01}, (),
                     marks=pytest.mark.slow),
        ({"contacts": SCATTERED}, {"points": [[0.0, 0.01], [0.01, 0.002], [-0.011, 0.007], [0.003, -0.012]]}, ()),
    ],
    ids=["one", "line", "free"],
)
def test_any_layout_renders_and_draws(device, grid, left_out, tmp_path):
    aims = {**LAYERED["rendering"], "targets": ["1"]}
    scenario = parse_scenario({**LAYERED, "rendering": aims, "device": {**device, **PRESSURE}, "grid": grid})
    run = Run.start(scenario, tmp_path, Path())
    rendering = run_render(run)
    assert set(rendering.methods) == {"inverse filter", "funneling", "combination"} - set(left_out)
    assert [n for n in run.notes if "is left out" in n and not n.startswith(left_out or "-")] == []
    results = Results.open(tmp_path)
    wanted = None if grid.get("points") else ["strength", "target-1", "figure-4"]  # one with all there are
    # drawn, and their numbers written; what files of them look like is for test_figures
    drawn = {Path(f).stem for f in make_figures(results, only=wanted, formats=()) if Path(f).suffix == ".csv"}
    assert {"strength", "target-1", "figure-4"} <= drawn
    assert ("figure-a2" in drawn, "table-1" in drawn) == (False, False)  # no row of points; see below
    assert applies(kinds()["table-1"], results)  # none is the thesis' device
    assert f"{len(scenario.device.centres)} actuator" in dict(scene_block(results).rows)["device"]


def test_groups_of_table_one_are_for_three_by_three_points():
    def grid(*shape: int, names: int = 0) -> tuple[Port, ...]:
        places = parse_scenario({"grid": {"rows": shape[0], "columns": shape[1]}}).grid.places
        return tuple(Port(str(k + 1), "point", (*xy, 0.0)) for k, xy in enumerate(places))

    assert is_thesis_grid(grid(3, 3))
    assert not is_thesis_grid(grid(2, 3))
    assert not is_thesis_grid(grid(9, 1))
    shuffled = grid(3, 3)
    assert not is_thesis_grid((*shuffled[:4], *(Port(a.name, "point", b.position) for a, b in
                                                 ((shuffled[4], shuffled[8]), (shuffled[8], shuffled[4]))),
                               *shuffled[5:8]))  # fmt: skip


@pytest.mark.parametrize(
    ("device", "said"),
    [
        ({"rows": 3, "columns": [2, 3]}, "columns gives 2 rows, but rows is 3"),
        ({"rows": 20, "columns": 20}, "rows and columns make 400 actuators, expected at most 100"),
        ({"rows": 2, "columns": 0}, "expected 1 to 20"),
        ({"rows": 3, "columns": 3, "out_of_contact": ["A10"]}, "out_of_contact names"),
    ],
)
def test_rows_that_cannot_be_are_one_sentence(device, said):
    with pytest.raises(ScenarioError, match=said):
        parse_scenario({"device": device})
