"""The limb's own mesher: unrolling, even triangles, filling, slivers, layers that thin out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import Delaunay

from forearm_fem.errors import MeshError
from forearm_fem.geometry import build
from forearm_fem.geometry.build import build_mesh, limb_volume
from forearm_fem.geometry.device.sizing import element_sizes
from forearm_fem.geometry.limb.core import Chart, _bone_wall, _check_tubes, spread
from forearm_fem.geometry.limb.filling import Shell, fill, oriented, stack_prisms, without_slivers
from forearm_fem.geometry.limb.tube import tube_of
from forearm_fem.geometry.mesh.quality import check_mesh
from forearm_fem.geometry.mesh.tissue_mesh import boundary_faces, mean_ratios, true_volumes
from forearm_fem.scenario import Scenario, load_scenario, parse_scenario

ROOT = Path(__file__).parents[1]
TUBE = tube_of(Scenario().limb)
THESIS = load_scenario(ROOT / "scenarios/thesis.toml")


def test_chart_keeps_angles_and_scales():
    """Small steps along and around on the skin are ``scale`` times those of the plane, and at right angles."""
    chart, step = Chart.of_skin(TUBE), 1e-2
    u, v = (each.ravel() for each in np.meshgrid(np.linspace(0.5, chart.u[-1] - 0.5, 15), np.linspace(-3, 3, 13)))
    here, along, around = (np.column_stack(p) for p in ((u, v), (u + step, v), (u, v + step)))
    places = [TUBE.place(*chart.surface(p), 0.0) for p in (here, along, around)]
    a, b = places[1] - places[0], places[2] - places[0]
    scale = chart.scale(here) * step
    assert np.linalg.norm(a, axis=1) == pytest.approx(scale, rel=5e-3)  # half a step times the taper's slope
    assert np.linalg.norm(b, axis=1) == pytest.approx(scale, rel=1e-4)
    assert np.abs((a * b).sum(axis=1)).max() < 5e-3 * scale.max() ** 2  # the chord's b^2 / 2R


def test_plane_and_surface_are_inverse():
    chart = Chart.of_skin(TUBE)
    x, angle = np.linspace(-0.11, 0.11, 9), np.linspace(-3, 3, 9)
    back = chart.surface(chart.plane(x, angle))
    assert back[0] == pytest.approx(x, abs=1e-9)
    assert back[1] == pytest.approx(angle, abs=1e-9)


def test_points_spread_on_a_bone_are_as_far_apart_as_asked():
    bone = TUBE.bones[0]
    x, _ = spread(Chart.of_bone(TUBE, bone), lambda x, angle: np.full(len(x), 3e-3))
    area = 2 * np.pi * bone.radius * TUBE.length
    assert len(x) == pytest.approx(area / (np.sqrt(3) / 2 * 3e-3**2), rel=0.08)  # a triangular lattice of 3 mm
    assert x.min() == -TUBE.length / 2
    assert x.max() == TUBE.length / 2


def test_the_coarser_mesh_has_coarser_facets_far_from_the_device_too():
    """What both meshes share their difference does not show: 0.4 % was stated for 1.2 % with equal bones' facets."""
    fine, coarse = (element_sizes(THESIS, scale=k) for k in (1.0, 2.0))
    few, many = (len(_bone_wall(TUBE, TUBE.bones[0], _far, sizes.facet)) for sizes in (coarse, fine))
    assert many > 3 * few  # four times, but for whole numbers of facets round a bone
    assert coarse.wall == pytest.approx(2 * fine.wall)


def _far(points):
    """Sizes (n,) [m] where nothing but a bone's own facets limits them."""
    return np.full(len(points), 0.1)


def test_a_mesh_that_fails_is_tried_again_with_narrower_facets(caplog, monkeypatch):
    """Four facets of 1.4 rad may not enclose what lies in a cylinder, which hangs on rounding: so it is said here."""
    scenario = parse_scenario({"limb": {"shape": "cylinder", "length": 0.2, "diameter": 0.06}, "accuracy": 0.3})
    made, facets = build._unmarked, []

    def failing_at_first(scenario, base, size, progress, attempt):
        facets.append(size.sizes.facet)
        if attempt == 1:
            raise MeshError("points on the limb's wall do not enclose it")
        return made(scenario, base, size, progress, attempt)

    monkeypatch.setattr(build, "_unmarked", failing_at_first)
    with caplog.at_level("INFO", logger="forearm_fem.geometry"):
        mesh = build_mesh(scenario, scale=2.0)
    assert "attempt 1 at the mesh failed (points on the limb's wall" in caplog.text
    assert facets[1] == pytest.approx(0.75 * facets[0])
    assert mean_ratios(mesh.points, mesh.tetrahedra).min() > scenario.mesh.min_quality


@pytest.fixture(scope="module")
def limb():
    scenario = parse_scenario(
        {"limb": {"shape": "cylinder", "length": 0.07}, "mesh": {"size_grid": 3.2e-3, "size_far": 12e-3}}
    )
    return scenario, build_mesh(scenario)


def test_skin_between_the_ports_is_even(limb):
    """10 % of the least angles are below 42 degrees at most (fTetWild left 34), edges are 3.2 mm on average."""
    _, mesh = limb
    corners = mesh.points[mesh.facets["skin"]]
    middle = corners.mean(axis=1)
    inside = (np.abs(middle[:, :2]).max(axis=1) < 20e-3) & (middle[:, 2] > 0)
    inside &= np.abs(np.abs(middle[:, :2]) - 22.5e-3).max(axis=1) > 7e-3  # rims are refined
    edges = np.sort(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)[inside], axis=1)
    least = np.degrees(
        np.arccos((edges[:, 1] ** 2 + edges[:, 2] ** 2 - edges[:, 0] ** 2) / (2 * edges[:, 1] * edges[:, 2]))
    )
    assert np.quantile(least, 0.1) > 42
    assert edges.mean() == pytest.approx(3.2e-3, rel=0.1)


def test_the_same_mesh_every_time():
    ports = {"device": {"contacts": [[0.0, 0.0]]}, "grid": {"points": [[0.012, 0.0]]}}
    limb = {"shape": "cylinder", "length": 0.06, "diameter": 0.04}
    scenario = parse_scenario({"limb": limb, **ports, "mesh": {"size_grid": 8e-3}})
    mesh, again = (build_mesh(scenario) for _ in range(2))
    assert np.array_equal(mesh.points, again.points)
    assert np.array_equal(mesh.tetrahedra, again.tetrahedra)


def test_grid_points_are_vertices(limb):
    """Columns stand at the grid points, so that a receptance is read at a node."""
    scenario, mesh = limb
    skin, _ = tube_of(scenario.limb).volar(np.array(scenario.grid.places))
    away = np.linalg.norm(mesh.points[:, None] - skin, axis=2).min(axis=0)
    assert away.max() < 1e-9


@pytest.mark.parametrize(
    "changes",
    [
        pytest.param({"limb": {"shape": "forearm", "aspect": 1.5, "length": 0.1}}, marks=pytest.mark.slow),
        pytest.param({"limb": {"shape": "cylinder", "diameter": 0.03, "length": 0.08},
                      "device": {"spacing": 0.018}, "grid": {"pitch": 0.005}}, marks=pytest.mark.slow),
        pytest.param({"limb": {"shape": "cylinder", "layers": [], "length": 0.1}}, marks=pytest.mark.slow),
        pytest.param(
            {"limb": {"shape": "forearm", "length": 0.09}, "supports": {"bone": "elastic"}}, marks=pytest.mark.slow
        ),  # a shorter one in test_geometry_limb
        {"limb": {"shape": "cylinder", "length": 0.08, "diameter": 0.06,
                  "bones": [{"name": "near", "y": 0.0, "depth": 0.0122, "diameter": 0.014}]}},
    ],
    ids=["elliptic", "thin", "bare", "elastic bones", "bone 1 mm under the fat"],
)  # fmt: skip
@pytest.mark.parametrize("size", [pytest.param(3e-3, marks=pytest.mark.slow), 6e-3])
def test_unusual_limbs_are_meshed(changes, size):
    scenario = parse_scenario({**changes, "mesh": {"size_grid": size, "size_contact": 2e-3}})
    mesh = build_mesh(scenario)
    check_mesh(mesh, 0.02)
    assert true_volumes(mesh).sum() == pytest.approx(limb_volume(scenario), rel=1e-3)  # as in test_geometry_limb


def _cube_shell(n):
    """Points on the unit cube's surface, and which of its six faces each lies on."""
    t = np.linspace(0, 1, n + 1)
    grid = np.stack(np.meshgrid(t, t, t, indexing="ij"), axis=-1).reshape(-1, 3)
    on = np.column_stack([grid == 0, grid == 1])
    kept = on.any(axis=1)
    free = (on.sum(axis=1) == 1)[:, None] & (grid % 1 > 0)  # a regular grid has many points on one sphere
    points = grid + np.where(free, np.random.default_rng(4).uniform(-0.15, 0.15, grid.shape) / n, 0)
    return Shell(points[kept], on[kept], np.ones(6, dtype=bool))


def _in_cube(points, gap):
    return (np.minimum(points, 1 - points) > np.reshape(gap, (-1, 1))).all(axis=1)


def test_filling_a_cube_leaves_no_gap_and_no_sliver():
    points, tetrahedra = fill(_cube_shell(8), lambda p: np.full(len(p), 0.125), _in_cube)
    corner = points[tetrahedra]
    assert np.linalg.det(corner[:, 1:] - corner[:, :1]).sum() / 6 == pytest.approx(1.0, rel=1e-12)
    assert mean_ratios(points, tetrahedra).min() > 0.1
    edges = corner - np.roll(corner, 1, axis=1)
    # six shells gave 1.10 to 1.15 times what is asked; roundings of the processor seem to choose
    assert 1.0 < np.linalg.norm(edges, axis=2).mean() / 0.125 < 1.2


def test_a_boundary_face_on_no_surface_is_refused():
    shell = _cube_shell(3)
    open_top = Shell(shell.points, shell.on & (np.arange(6) != 5), shell.closed)
    with pytest.raises(MeshError, match="too far apart"):
        fill(open_top, lambda p: np.full(len(p), 0.33), _in_cube)


def test_slivers_become_rounder_and_nothing_flatter():
    rng = np.random.default_rng(3)
    points = np.vstack([_cube_shell(5).points, rng.uniform(0.1, 0.9, (150, 3))])
    tetrahedra = Delaunay(points).simplices
    corner = points[tetrahedra]
    tetrahedra = oriented(points, tetrahedra[np.abs(np.linalg.det(corner[:, 1:] - corner[:, :1])) > 1e-9])
    movable = np.arange(len(points)) >= len(points) - 150
    moved = without_slivers(points, tetrahedra, movable, lambda p: np.full(len(p), 0.2), rng)
    before, after = mean_ratios(points, tetrahedra), mean_ratios(moved, tetrahedra)
    assert np.array_equal(moved[~movable], points[~movable])
    assert (after < 0.1).sum() < 0.3 * (before < 0.1).sum()
    assert after.min() >= before.min()


def test_layers_thin_out_without_a_gap():
    """Three levels of which two fall together in half of the columns: volume and outside stay the same."""
    n = 5
    xy = np.stack(np.meshgrid(np.arange(n), np.arange(n), indexing="ij"), axis=-1).reshape(-1, 2)
    square = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    triangles = np.vstack([np.column_stack([square, square + n, square + 1]),
                           np.column_stack([square + 1, square + n, square + n + 1])])  # fmt: skip
    levels = np.arange(3)[:, None] * n * n + np.arange(n * n)
    levels[1, xy[:, 0] > 2] = levels[0, xy[:, 0] > 2]
    points = np.vstack([np.column_stack([xy, np.full(n * n, z)]) for z in (0.0, 0.5, 1.0)])
    tetrahedra, under = stack_prisms(triangles, levels)
    tetrahedra = oriented(points, tetrahedra)
    corner = points[tetrahedra]
    volumes = np.linalg.det(corner[:, 1:] - corner[:, :1]) / 6
    assert volumes.min() > 0
    assert volumes.sum() == pytest.approx(16.0, rel=1e-12)
    assert set(under) == {0, 1}
    faces, _ = boundary_faces(tetrahedra)
    flat = [(points[faces][:, :, k] == value).all(axis=1) for k in (0, 1) for value in (0, n - 1)]
    flat += [(points[faces][:, :, 2] == value).all(axis=1) for value in (0, 1)]
    assert np.any(flat, axis=0).all()


def tube_lattice(n, m):
    """Triangles (2 n m, 3) of a tube of n rings spacings and m points around: vertex (i, j) is i m + j."""
    i, j = (each.ravel() for each in np.meshgrid(np.arange(n), np.arange(m), indexing="ij"))
    here, right = i * m + j, i * m + (j + 1) % m
    return np.vstack([np.column_stack([here, here + m, right]), np.column_stack([right, here + m, right + m])])


def test_broken_walls_are_refused():
    whole = tube_lattice(4, 6)
    _check_tubes([whole])
    with pytest.raises(MeshError, match="too far apart"):
        _check_tubes([whole, np.delete(whole, 14, axis=0)])
