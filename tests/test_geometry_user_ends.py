"""Which facets of a user's limb are skin, walls of bones, cut ends."""

from __future__ import annotations

import numpy as np
import pytest

from forearm_fem.engines.forecast import doubts_of
from forearm_fem.geometry.device.place import facet_area
from forearm_fem.geometry.limb.filling import oriented
from forearm_fem.geometry.mesh.files import write_mesh
from forearm_fem.geometry.mesh.tissue_mesh import TissueMesh
from forearm_fem.geometry.user.checks import with_boundaries, without_bone
from forearm_fem.geometry.user.volume import background_grid
from forearm_fem.questions.run import Run, run_solve
from forearm_fem.results.run import read_run
from forearm_fem.scenario import parse_scenario

LENGTH, WIDTH, STEP = 0.06, 0.04, 5e-3
BONE = 4 * 0.02 * LENGTH  # [m^2] walls of a square bone of 20 mm, which runs through


def bar(bone=lambda y, z: np.zeros(len(y), dtype=bool)):
    """A bar along x of muscle, with tetrahedra of ``bone`` where that is true of their middle's y and z."""
    half = np.array([LENGTH, WIDTH, WIDTH]) / 2
    points, cells = background_grid(-half + STEP, half - 1.5 * STEP, STEP)  # it adds a margin
    tetrahedra = oriented(points, cells)
    middle = points[tetrahedra].mean(axis=1)
    region = bone(middle[:, 1], middle[:, 2]).astype(np.int64)
    return TissueMesh(points, tetrahedra, region, ("muscle", "bone"), {})


def through(y, z):
    return (np.abs(y) < 0.01) & (np.abs(z) < 0.01)


def areas(mesh):
    return {name: facet_area(mesh.points, facets) for name, facets in mesh.facets.items()}


def moved(mesh, change):
    return TissueMesh(mesh.points + change, mesh.tetrahedra, mesh.region, mesh.region_names, mesh.facets)


def test_ends_walls_and_skin_of_a_bar_are_exact():
    found = areas(with_boundaries(without_bone(bar(through))))
    assert found["bone"] == pytest.approx(BONE)
    assert found["end"] == pytest.approx(2 * (WIDTH**2 - 0.02**2))
    assert found["skin"] == pytest.approx(4 * WIDTH * LENGTH)


@pytest.mark.parametrize("named", [True, False], ids=["region of bone", "cavity"])
def test_ends_are_plane_to_a_thousandth_only_and_walls_stay_walls(named):
    """fTetWild leaves vertices of a plane end up to its envelope off; a wall taken for skin would hang free."""
    mesh = without_bone(bar(through))
    mesh = TissueMesh(mesh.points, mesh.tetrahedra, mesh.region, mesh.region_names, mesh.facets if named else {})
    off = np.zeros_like(mesh.points)
    at_end = np.abs(np.abs(mesh.points[:, 0]) - LENGTH / 2) < 1e-9
    some = at_end & (np.random.default_rng(0).random(len(at_end)) < 0.2)
    off[some, 0] = -np.sign(mesh.points[some, 0]) * 0.9e-3 * LENGTH
    found = areas(with_boundaries(moved(mesh, off)))
    assert found["end"] == pytest.approx(2 * (WIDTH**2 - 0.02**2), rel=1e-3)  # tilted by .01: its square
    assert found["bone"] == pytest.approx(BONE, rel=2e-3)  # ends reach .9e-3 less far
    assert found["skin"] == pytest.approx(4 * WIDTH * LENGTH, rel=2e-3)


def test_a_rounded_end_is_skin_its_pole_too():
    mesh = bar()
    y, z = mesh.points[:, 1:].T
    bulge = np.zeros_like(mesh.points)
    bulge[:, 0] = -0.03 * mesh.points[:, 0] * (y**2 + z**2) / 0.02**2  # .056 mm where edges from the pole end
    mesh = with_boundaries(moved(mesh, bulge))
    assert "end" not in mesh.facets
    flat = bar()
    flat.points[:, 0] += np.where(flat.points[:, 0] > 0, bulge[:, 0], 0.0)
    assert areas(with_boundaries(flat))["end"] == pytest.approx(WIDTH**2)


def test_what_is_exactly_plane_is_an_end_though_its_edge_is_round():
    mesh = bar()
    y, z = np.abs(mesh.points[:, 1:].T)
    change = np.zeros_like(mesh.points)
    change[:, 0] = -0.02 * mesh.points[:, 0] * (np.maximum(y, z) > 0.0151)
    found = areas(with_boundaries(moved(mesh, change)))
    assert found["end"] == pytest.approx(2 * 0.03**2)


def test_the_wall_of_a_bone_that_lies_bare_at_the_skin_is_held_all_the_same():
    mesh = with_boundaries(without_bone(bar(lambda y, z: (np.abs(y) < 0.01) & (z > 0.0))))
    found = areas(mesh)
    assert found["bone"] == pytest.approx((0.02 + 2 * 0.02) * LENGTH)
    assert found["skin"] == pytest.approx((4 * WIDTH - 0.02) * LENGTH)


def test_a_limb_without_cut_ends_says_so_in_its_report(tmp_path):
    """Waves turn back at a rounded end; no estimate of truncation is made there."""
    mesh = bar()
    y, z = mesh.points[:, 1:].T
    mesh.points[:, 0] *= 1 - 0.03 * (y**2 + z**2) / 0.02**2
    write_mesh(with_boundaries(mesh), tmp_path / "limb.vtu")
    scenario = parse_scenario({
        "limb": {"shape": "mesh", "file": "limb.vtu", "regions": {"0": "muscle"}},
        "device": {"contacts": [[0.0, 0.0]]}, "grid": {"points": [[0.01, 0.0]]},
        "sweep": {"frequencies": [60.0]}, "rendering": {"methods": []},
        "mesh": {"element": "P2", "size_contact": 2e-3}, "solver": {"discretisation_estimate": False},
    })  # fmt: skip
    run_solve(Run.start(scenario, tmp_path / "out", tmp_path))
    (said,) = [n for n in read_run(tmp_path / "out" / "run.json").notes if "cut end" in n]
    assert said.startswith("limb: no plane cut end across x was found at its smallest and its largest x")
    assert len(said) <= 300
    assert doubts_of(scenario, with_boundaries(bar())) == ()
    half = with_boundaries(bar())
    half.facets["end"] = half.facets["end"][half.points[half.facets["end"]][:, 0, 0] > 0]
    assert "at its smallest x" in doubts_of(scenario, half)[0]
