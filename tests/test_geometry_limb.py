"""Forearm and cylinder: volumes, layers, rims, ports; one coarse mesh of each serves all tests."""

from __future__ import annotations

import numpy as np
import pytest

from forearm_fem.accuracy.discretisation import COARSER
from forearm_fem.errors import GeometryError
from forearm_fem.fem.assembly.boundary import covered_area, resting_nodes, rests
from forearm_fem.fem.space.numbering import mixed_space
from forearm_fem.geometry.build import build_mesh, limb_volume
from forearm_fem.geometry.device.place import facet_area, from_axis, place_ports
from forearm_fem.geometry.device.sizing import element_sizes
from forearm_fem.geometry.limb.tube import tube_of
from forearm_fem.geometry.mesh.quality import check_mesh, mesh_quality
from forearm_fem.geometry.mesh.refinement import refine, refine_skin, rim_edges
from forearm_fem.scenario import Scenario, parse_scenario
from forearm_fem.scenario.limb import ForearmLimb

COARSE = {"size_grid": 5e-3, "size_contact": 3e-3, "size_far": 12e-3}


def forearm(**changes):
    limb = changes.pop("limb", {"shape": "forearm", "length": 0.16})  # short, and all that is asked here is there
    return parse_scenario({"limb": limb, "mesh": COARSE, **changes})


@pytest.fixture(scope="module")
def scenario():
    return forearm()


@pytest.fixture(scope="module")
def mesh(scenario):
    return build_mesh(scenario)


@pytest.fixture(scope="module")
def cylinder():
    ulna = {"name": "ulna", "y": 0.0, "depth": 0.025, "diameter": 0.014}
    limb = {"shape": "cylinder", "length": 0.1, "bones": [ulna]}
    scenario = forearm(limb=limb, supports={"bone": "elastic"}, device={"spacing": 0.03}, grid={"pitch": 0.008})
    return scenario, build_mesh(scenario)


def test_forearm_is_sound(mesh):
    check_mesh(mesh, 0.02)
    assert mesh.region_names == ("skin", "fat", "muscle")
    assert {"skin", "bone", "end", "underside", "contact A1", "contact A4"} <= set(mesh.facets)
    assert mesh_quality(mesh).median > 0.5


def test_volumes_are_the_analytic_ones_where_edges_bend(mesh, scenario):
    """Facets of up to 0.5 rad: flat ones lack 0.7 % of the limb; bent ones only what vertices on chords cost, which
    refinement put there."""
    expected = limb_volume(scenario)
    quality = mesh_quality(mesh, expected_volume=expected)
    assert quality.volume == pytest.approx(quality.expected_volume, rel=5e-4)
    assert mesh.volumes.sum() < 0.995 * expected
    exact = tube_of(scenario.limb).volumes(bones_kept=False)
    for tissue, volume in quality.volumes.items():
        assert volume == pytest.approx(exact[tissue], rel=1e-3)


def test_interfaces_lie_at_their_depths(mesh, scenario):
    """But for vertices that refinement put on chords: those of 5 mm lie 0.1 mm below their arc."""
    tube = tube_of(scenario.limb)
    for outer, inner, depth in (("skin", "fat", 1.2e-3), ("fat", "muscle", 4.2e-3)):
        shared = np.intersect1d(_of(mesh, outer), _of(mesh, inner))
        points = mesh.points[shared]
        exact = tube.place(points[:, 0], tube.angle_of(points), depth)
        away = np.linalg.norm(points - exact, axis=1)
        assert np.median(away) < 1e-9
        assert away.max() < 1e-4


def test_accuracy_sets_the_length_of_a_forearm_that_leaves_it_out():
    lengths = [parse_scenario({"accuracy": a}).limb.length for a in (0.01, 0.05, 0.3)]
    assert lengths[0] == lengths[1] == ForearmLimb().length > lengths[2]
    assert parse_scenario({"accuracy": 0.3, "limb": {"shape": "forearm", "length": 0.2}}).limb.length == 0.2
    wider = parse_scenario({"accuracy": 0.3, "limb": {"shape": "forearm", "aspect": 1.2}}).limb
    assert (wider.length, wider.aspect) == (lengths[2], 1.2)


def test_thickness_is_measured_along_the_normal(scenario):
    tube = tube_of(scenario.limb)
    x, angle = np.array([-0.03, 0.0, 0.04]), np.array([0.2, 1.0, 2.5])
    skin, inner = tube.place(x, angle, 0.0), tube.place(x, angle, 1.2e-3)
    assert ((skin - inner) * tube.normal(x, angle)).sum(axis=1) == pytest.approx(1.2e-3, rel=1e-12)


def _of(mesh, tissue):
    return np.unique(mesh.tetrahedra[mesh.region == mesh.region_names.index(tissue)])


@pytest.mark.parametrize("name", ["A1", "A2", "A3", "A4"])
def test_contacts_fill_their_discs(mesh, scenario, name):
    port = next(p for p in place_ports(scenario, mesh) if p.name == name)
    facets = mesh.facets[f"contact {name}"]
    rim = from_axis(mesh.points[np.unique(rim_edges(mesh, name))], port)
    assert np.median(rim) == pytest.approx(rim.max(), rel=1e-9)  # a circle, but for vertices that could not move
    a, b, c = mesh.points[facets].transpose(1, 0, 2)
    seen = np.abs(np.cross(b - a, c - a) @ np.array(port.axis)).sum() / 2
    edges = mesh.points[rim_edges(mesh, name)]
    chord = np.linalg.norm(edges[:, 0] - edges[:, 1], axis=1).mean()
    drawn_in = port.radius - element_sizes(scenario).rim_lead * chord  # seen along the axis; acts like the disc
    assert seen == pytest.approx(np.pi * drawn_in**2, rel=2e-3)
    assert facet_area(mesh.points, facets) == pytest.approx(seen, rel=0.02)  # the skin's slopes under the disc


def test_end_facets_are_plane_and_underside_faces_down(mesh, scenario):
    assert np.abs(mesh.points[mesh.facets["end"]][:, :, 0]) == pytest.approx(scenario.limb.length / 2, abs=1e-12)
    under = mesh.points[mesh.facets["underside"]]
    normal = np.cross(under[:, 1] - under[:, 0], under[:, 2] - under[:, 0])
    assert (normal[:, 2] < -0.5 * np.linalg.norm(normal, axis=1)).all()


@pytest.mark.parametrize("scale", [1.0, COARSER])
def test_what_rests_is_a_third_of_the_way_round(scale):
    """n_z < -1/2 is a third of a round arm whatever its facets, here as long as its radius: whole ones have a sixth of
    that too much. Parabolas in place of arcs turn the normal by less than 2 degrees of 120.
    """
    layers = [{"tissue": "skin", "thickness": 1.7e-3}]
    limb = {"shape": "cylinder", "length": 0.07, "diameter": 0.06, "layers": layers}
    mesh = build_mesh(
        parse_scenario({"accuracy": 0.3, "limb": limb, "device": {"contacts": [[0.0, 0.0]]}}), scale=scale
    )
    third, skin = 2 * np.pi / 3 * 0.03 * 0.07, mesh.facets["skin"]
    assert abs(facet_area(mesh.points, mesh.facets["underside"]) / third - 1) > 0.1  # what whole facets would hold
    for element in ("P2", "P3"):
        assert covered_area(mixed_space(mesh, element), skin, rests) == pytest.approx(third, rel=0.02)
    space = mixed_space(mesh, "P2")
    held = resting_nodes(space, skin)
    y, z = space.node_points[:, 1:].T
    angle = np.degrees(np.arctan2(np.abs(y), -z))
    assert angle[held].max() < 62
    assert angle[np.setdiff1d(space.facet_nodes(skin), held)].min() > 58


def test_bone_walls_are_round(mesh, scenario):
    """Vertices and the middles of edges, but for a few that refinement put on chords."""
    tube = tube_of(scenario.limb)
    at = np.isin(mesh.bends.edges, mesh.facets["bone"]).all(axis=1)
    middles = mesh.points[mesh.bends.edges[at]].mean(axis=1) + mesh.bends.offsets[at]
    for points in (mesh.points[np.unique(mesh.facets["bone"])], middles):
        away = [np.linalg.norm(points[:, 1:] - tube.bone_centre(b, points[:, 0]), axis=1) for b in tube.bones]
        radius = np.min(away, axis=0)
        assert np.median(radius) == pytest.approx(7e-3, rel=1e-9)
        assert (np.abs(radius - 7e-3) < 1e-9).mean() > 0.95
        assert radius.min() > 7e-3 * np.cos(np.pi / 8)


def test_ports_lie_on_the_skin_with_its_normals(mesh, scenario):
    ports = place_ports(scenario, mesh)
    assert [p.name for p in ports] == ["A1", "A2", "A3", "A4", *(str(i) for i in range(1, 10))]
    centre = ports[8]
    radius = 0.227 / (2 * np.pi)
    assert centre.position == pytest.approx((0, 0, radius))
    assert centre.axis[1] == pytest.approx(0)
    assert centre.axis[0] == pytest.approx(-0.08, abs=0.03)  # the limb widens towards the elbow, +x
    assert ports[0].position[:2] == pytest.approx((-0.0225, -0.0225))
    assert ports[1].axis == pytest.approx(np.array(ports[0].axis) * [1, -1, 1])  # mirror image in y


def test_refinement_carries_all_boundaries(mesh):
    finer = refine(mesh, np.arange(len(mesh.tetrahedra)) % 50 == 0)
    check_mesh(finer, 0.005)
    for name, facets in mesh.facets.items():
        assert facet_area(finer.points, finer.facets[name]) == pytest.approx(facet_area(mesh.points, facets))


@pytest.mark.slow  # 2 s; a limb of elastic bone is meshed in test_geometry_even
def test_elastic_bone_is_a_region(cylinder):
    scenario, mesh = cylinder
    check_mesh(mesh, 0.02)
    assert mesh.region_names == ("skin", "fat", "muscle", "bone")
    assert "bone" not in mesh.facets
    quality = mesh_quality(mesh, expected_volume=limb_volume(scenario))
    assert quality.volume == pytest.approx(quality.expected_volume, rel=1e-3)
    # arcs of 0.8 rad; flat ones lack 10 %
    assert quality.volumes["bone"] == pytest.approx(np.pi * 0.007**2 * 0.1, rel=5e-3)


def test_elliptic_sections_have_the_circumference_asked_for():
    tube = tube_of(parse_scenario({"limb": {"aspect": 1.3, "bones": []}}).limb)
    angle = np.linspace(0, 2 * np.pi, 20001)
    ring = tube.place(np.zeros(20001), angle, 0.0)
    assert np.linalg.norm(np.diff(ring, axis=0), axis=1).sum() == pytest.approx(0.227, rel=1e-6)
    assert ring[:, 1].max() / ring[:, 2].max() == pytest.approx(1.3, rel=1e-6)
    inner = tube.place(np.zeros(20001), angle, 3e-3)
    assert tube.angle_of(inner) == pytest.approx(np.where(angle > np.pi, angle - 2 * np.pi, angle), abs=1e-9)


def _bones(*bones):
    keys = ("y", "depth", "diameter")
    return {"bones": [{"name": f"b{i}", **dict(zip(keys, b, strict=True))} for i, b in enumerate(bones)]}


BAD_LIMBS = [
    ({"limb": {"layers": [{"tissue": "skin", "thickness": 0.03}]}}, "layers are 30 mm thick together"),
    ({"limb": {"circumference": [[0, 0.02]], "bones": []}}, "4.2 mm thick together"),
    (
        {"limb": {"aspect": 2.0, "layers": [{"tissue": "fat", "thickness": 0.012}], "bones": []}},
        "bring limb.aspect nearer 1",
    ),
    ({"limb": _bones((0.03, 0.03, 0.014))}, "bone 'b0' does not lie inside the muscle"),
    ({"limb": _bones((0.0, 0.008, 0.014))}, "bone 'b0' does not lie inside"),
    ({"limb": _bones((0.0, 0.2, 0.014))}, "bone 'b0' does not lie inside"),
    ({"limb": _bones((-0.005, 0.03, 0.014), (0.005, 0.03, 0.014))}, "'b0' and 'b1' overlap by"),
    ({"limb": {"length": 0.05}}, "A1 .* reaches beyond the limb .* reduce device.cone.radius, .* enlarge limb.length"),
    ({"limb": {"length": 0.04}}, "contact A1 .* misses the limb"),
    ({"device": {"contacts": [[0.0, 0.0322]]}}, "contact A1 .* hangs over the limb's side.* place in device.contacts"),
    ({"device": {"spacing": 0.09}}, "contact A1 .* misses the limb"),
    ({"device": {"contacts": [[0, 0], [0.001, 0]]}}, "contacts A1 and A2"),
    ({"grid": {"points": [[0.0, 0.035]]}}, "grid point 1 .* hangs over"),
    ({"grid": {"points": [[0.0, 0.04]]}}, "grid point 1 .* misses .* place in grid.points, or enlarge limb.length"),
    ({"limb": {"shape": "cylinder", "diameter": 0.008}}, "layers are 4.2 mm thick together"),
]


@pytest.mark.parametrize(("changes", "message"), BAD_LIMBS)
def test_impossible_limbs_are_refused_at_once(changes, message):
    with pytest.raises(GeometryError, match=message):
        build_mesh(forearm(**changes))


def test_default_scenario_is_possible():
    tube = tube_of(Scenario().limb)
    assert len(tube.bones) == 2


def test_skin_is_bisected_where_it_is_coarser_than_asked(mesh):
    """Within 1.6 times the size asked for around one place; bisection keeps the volume."""
    place = mesh.points[mesh.facets["skin"][0, 0]]

    def size(points):
        return np.where(np.linalg.norm(points - place, axis=1) < 0.01, 2e-3, 1.0)

    def longest(tissue_mesh):
        ends = tissue_mesh.points[tissue_mesh.facets["skin"][:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)]
        return (np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1) / size(ends.mean(axis=1))).max()

    finer = refine_skin(mesh, size)
    assert longest(mesh) > 1.6 >= longest(finer)
    assert finer.volumes.sum() == pytest.approx(mesh.volumes.sum(), rel=1e-12)
