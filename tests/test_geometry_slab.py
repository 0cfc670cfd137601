"""Slab meshes, sizes, ports and refinement: fast, exact, deterministic."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from forearm_fem.accuracy.discretisation import COARSER
from forearm_fem.errors import GeometryError, MeshError
from forearm_fem.geometry.build import build_mesh, limb_volume
from forearm_fem.geometry.device.place import facet_area, from_axis, place_ports
from forearm_fem.geometry.device.sizing import SECOND, element_sizes
from forearm_fem.geometry.mesh.quality import check_mesh, mean_ratio, mesh_quality, nodes_per_wavelength
from forearm_fem.geometry.mesh.refinement import onto_circle, refine, refine_rims, rim_edges
from forearm_fem.geometry.mesh.tissue_mesh import FACES, keys
from forearm_fem.ports import Port
from forearm_fem.scenario import Scenario, parse_scenario

COARSE = {"size_grid": 4e-3, "size_contact": 2e-3, "size_far": 12e-3}


def slab(**changes):
    return parse_scenario({"limb": {"shape": "slab", **changes.pop("limb", {})}, "mesh": COARSE, **changes})


@pytest.fixture(scope="module")
def mesh():
    return build_mesh(slab())


@pytest.fixture(scope="module")
def quarter():
    return build_mesh(quarter_scenario())


def quarter_scenario():
    return slab(limb={"symmetry": ["x", "y"]}, device={"contacts": [[0, 0]]}, grid={"points": [[0.01, 0], [0.02, 0]]})


def test_volumes_of_layers_are_exact(mesh):
    area = 0.12 * 0.09
    expected = {"skin": 1.2e-3 * area, "fat": 3.0e-3 * area, "muscle": (0.04 - 4.2e-3) * area}
    assert mesh_quality(mesh).volumes == pytest.approx(expected, rel=1e-12)
    assert limb_volume(slab()) == pytest.approx(mesh.volumes.sum(), rel=1e-12)


def test_every_face_is_shared_by_two_or_on_a_named_boundary(mesh):
    key, count = np.unique(keys(mesh.tetrahedra[:, FACES].reshape(-1, 3), len(mesh.points)), return_counts=True)
    named = np.vstack([mesh.facets["skin"], mesh.facets["end"]])
    assert count.max() == 2
    assert set(key[count == 1]) == set(keys(named, len(mesh.points)))


def test_every_point_belongs_to_a_tetrahedron(mesh, quarter):
    """The centre of a contact's rings may be a corner of the slab: it was there twice."""
    for one in (mesh, quarter):
        assert np.array_equal(np.unique(one.tetrahedra), np.arange(len(one.points)))


def test_slab_is_the_same_at_every_call(quarter):
    assert build_mesh(quarter_scenario()).digest == quarter.digest


@pytest.mark.parametrize("name", ["A1", "A2", "A3", "A4"])
def test_rim_is_followed(mesh, name):
    port = next(p for p in place_ports(slab(), mesh) if p.name == name)
    facets = mesh.facets[f"contact {name}"]
    rim = from_axis(mesh.points[np.unique(rim_edges(mesh, name))], port)
    assert rim == pytest.approx(rim.max(), rel=1e-9)
    edges = mesh.points[rim_edges(mesh, name)]
    chord = np.linalg.norm(edges[:, 0] - edges[:, 1], axis=1).mean()
    drawn_in = port.radius - SECOND.rim_lead * chord  # acts like the disc, see with_true_rims
    assert facet_area(mesh.points, facets) == pytest.approx(np.pi * drawn_in**2, rel=2e-3)


def test_rim_area_converges_to_the_disc(quarter):
    ports = place_ports(quarter_scenario(), quarter)
    disc = np.pi * ports[0].radius ** 2 / 4
    circle = onto_circle(quarter.points[np.unique(rim_edges(quarter, "A1"))], ports[0])
    points = quarter.points.copy()
    points[np.unique(rim_edges(quarter, "A1"))] = circle  # before with_true_rims
    quarter = replace(quarter, points=points)
    areas = [facet_area(*_contact(refine_rims(quarter, ports, size))) for size in (0.75e-3, 0.25e-3)]
    miss = 1 - np.array(areas) / disc
    assert miss[1] < miss[0] / 3 < 0.005  # chords: quadratic, at least one halving


def test_a_vertex_under_a_contacts_middle_stays_there():
    """A wall of the skin just below it lifts a vertex onto the axis, from which no way leads outwards."""
    port = Port("A1", "contact", (0.0, 0.0, 0.1), (0.6, 0.0, 0.8), 3e-3)
    points = np.array([port.position, (0.0, 1e-3, 0.1)])
    assert np.array_equal(onto_circle(points, port), [port.position, (0.0, 3e-3, 0.1)])


def _contact(mesh):
    return mesh.points, mesh.facets["contact A1"]


def test_rim_edges_are_as_short_as_asked(mesh):
    rim = 0.45 * COARSE["size_grid"]
    edges = rim_edges(mesh, "A1")
    assert np.linalg.norm(np.diff(mesh.points[edges], axis=1), axis=2).max() <= rim


def test_refinement_keeps_volumes_areas_and_conformity(mesh):
    marked = np.linalg.norm(mesh.points[mesh.tetrahedra].mean(axis=1), axis=1) < 0.01
    finer = refine(mesh, marked)
    before, after = mesh_quality(mesh), mesh_quality(finer)
    assert after.volumes == pytest.approx(before.volumes, rel=1e-12)
    for name, facets in mesh.facets.items():
        assert facet_area(finer.points, finer.facets[name]) == pytest.approx(facet_area(mesh.points, facets))
    check_mesh(finer, 0.02)
    assert len(finer.tetrahedra) > len(mesh.tetrahedra) + marked.sum() - 1


def test_repeated_refinement_does_not_degenerate(quarter):
    mesh = quarter
    for _ in range(4):
        mesh = refine(mesh, np.linalg.norm(mesh.points[mesh.tetrahedra].mean(axis=1), axis=1) < 4e-3)
    assert mean_ratio(mesh).min() > 0.02


def test_quarter_has_symmetry_planes_and_a_quarter_contact(quarter):
    check_mesh(quarter, 0.02)
    for axis, name in enumerate("xy"):
        assert np.abs(quarter.points[quarter.facets[f"symmetry {name}"]][:, :, axis]).max() == 0
    area = facet_area(*_contact(quarter))
    assert area == pytest.approx(np.pi * 3.5e-3**2 / 4, rel=0.02)
    assert quarter.volumes.sum() == pytest.approx(0.12 * 0.09 * 0.04 / 4)


def test_grid_points_are_vertices_of_the_slab(mesh):
    points = [p.position for p in place_ports(slab(), mesh) if p.kind == "point"]
    away = [np.linalg.norm(mesh.points - np.array(p), axis=1).min() for p in points]
    assert max(away) < 1e-12


def test_ports_turn_with_the_device(mesh):
    turned = place_ports(slab(device={"rotation": np.pi / 2, "spacing": 0.04}), mesh)
    assert turned[0].position == pytest.approx((0.02, -0.02, 0))  # (-s, -s) a quarter turn on
    assert [p.name for p in turned[:5]] == ["A1", "A2", "A3", "A4", "1"]
    assert turned[0].axis == (0, 0, 1)


@pytest.mark.parametrize(
    ("element", "contact", "widest", "ratio"),
    [
        ("P2", "pressure", 0.6, 2.0),
        ("P2", "bonded", 0.6, 2.0),
        ("P2/P3", "pressure", 0.43, 2.0),
        ("P2/P3", "bonded", 0.43, 2.0),
    ],
)
def test_elements_under_contacts_are_coarser_on_the_coarser_mesh(element, contact, widest, ratio):
    """They are held at a share of the radius; not on both meshes, or no change shows their error."""
    cone = {"cone": {"contact": contact}}
    scenario = parse_scenario({"accuracy": 0.3, "device": cone, "mesh": {"element": element}})
    fine, coarse = element_sizes(scenario), element_sizes(scenario, scale=2.0)
    assert fine.contact == pytest.approx(widest * scenario.device.cone.radius)
    assert coarse.contact == pytest.approx(ratio * fine.contact)


@pytest.mark.parametrize("accuracy", [0.005, 0.05])
@pytest.mark.parametrize("highest", [100.0, 500.0])
def test_slabs_that_accuracy_sizes_are_meshed_with_third_order(accuracy, highest):
    """A narrow disc on a deep slab: uncapped, elements of 36 mm below its columns were slivers of quality 0.0199."""
    limb = {"length": 0.16, "width": 0.16, "depth": 0.08, "symmetry": ["x", "y"]}
    device = {"contacts": [[0, 0]], "cone": {"contact": "pressure", "radius": 3.5e-3}}
    scenario = slab(
        limb=limb, device=device, grid={"points": [[0.01, 0], [0.02, 0]]}, mesh={}, accuracy=accuracy,
        sweep={"frequencies": [highest / 2, highest]},
    )  # fmt: skip
    assert scenario.element == "P2/P3"
    assert element_sizes(scenario).far <= 20e-3
    assert element_sizes(scenario, scale=2.0).far == pytest.approx(2 * element_sizes(scenario).far)
    for scale in (1.0, COARSER):  # the estimate's mesh too
        assert mesh_quality(build_mesh(scenario, scale=scale)).least > 0.024


def test_default_sizes_and_explicit_ones():
    second = element_sizes(parse_scenario({"mesh": {"element": "P2"}}))
    assert 1.8e-3 < second.grid < 2.4e-3
    assert second.sublayers == (2, 2)  # a rigid rim: two through the skin
    assert second.rim == pytest.approx(0.45 * second.grid)
    sizes = element_sizes(Scenario())
    assert 3.6e-3 < sizes.grid < 4.8e-3
    assert sizes.sublayers == (1, 1)
    assert element_sizes(Scenario(), scale=2.0).rim == pytest.approx(2 * sizes.rim)  # the estimate must see the rim
    assert element_sizes(Scenario(), scale=1.5).grid == pytest.approx(1.5 * sizes.grid)
    finer = parse_scenario({"accuracy": 0.05 / 16})
    assert element_sizes(finer).grid == pytest.approx(sizes.grid / 2)  # h ~ accuracy^(1/4)
    block = {"limb": {"shape": "slab", "length": 0.2, "width": 0.2, "depth": 0.08}}
    assert element_sizes(parse_scenario(block)).far == pytest.approx(20e-3)
    assert element_sizes(parse_scenario({**block, "accuracy": 0.027 / 16})).far == pytest.approx(10e-3, rel=1e-3)
    own = parse_scenario({"mesh": {"size_grid": 3e-3, "sublayers": {"fat": 4}}})
    assert element_sizes(own).grid == 3e-3
    assert element_sizes(own).sublayers == (1, 4)


def test_scale_makes_a_coarser_mesh(mesh):
    assert len(build_mesh(slab(), scale=1.5).tetrahedra) < 0.7 * len(mesh.tetrahedra)


def test_pressure_contacts_have_coarse_rims():
    fine = {**COARSE, "size_contact": 1e-3, "size_grid": 0.8e-3}
    bonded, pressed = (
        build_mesh(
            parse_scenario(
                {
                    **quarter_scenario().model_dump(),
                    "device": {"contacts": [[0, 0]], "cone": {"contact": kind}},
                    "mesh": fine,
                }
            )
        )
        for kind in ("bonded", "pressure")
    )
    assert len(pressed.tetrahedra) < len(bonded.tetrahedra)


def test_nodes_per_wavelength_are_those_of_the_edges(quarter):
    found = nodes_per_wavelength(
        quarter,
        "P2",
        {"skin": 3.0, "fat": 2.2, "muscle": 3.0},
        {"skin": 5e-3, "fat": 4e-3, "muscle": 6e-3},
        500,
    )
    assert [r.tissue for r in found] == ["skin", "fat", "muscle"]
    for r in found:
        assert 0 < r.per_wavelength <= r.per_wavelength_near_ports < 40
        assert 0 < r.per_decay <= r.per_decay_near_ports


def test_a_tissue_that_lies_deep_is_judged_by_its_nearest_elements(quarter):
    (near,) = nodes_per_wavelength(quarter, "P2", {"muscle": 3.0}, {}, 500, reach=0.02)
    (deep,) = nodes_per_wavelength(quarter, "P2", {"muscle": 3.0}, {}, 500, reach=1e-4)
    assert near.per_wavelength == deep.per_wavelength
    assert deep.per_wavelength_near_ports > deep.per_wavelength


BAD_SLABS = [
    ({"limb": {"depth": 0.004}}, "4.2 mm thick together"),
    ({"limb": {"length": 0.045}}, "contact A1 at .* does not lie on the modelled slab"),
    ({"limb": {"width": 0.04}}, "contact A1 .* enlarge limb.width$"),
    ({"limb": {"symmetry": ["x"]}}, "contact A1 .* symmetry"),
    ({"device": {"spacing": 0.006}}, "contacts A1 and A2 are 6 mm apart"),
    ({"device": {"contacts": [[0, 0], [0.005, 0]]}}, "A1 and A2 are 5 mm apart, .* move one in device.contacts"),
    ({"grid": {"points": [[0.0, 0.05]]}}, "grid point 1"),
    ({"limb": {"symmetry": ["y"]}, "device": {"contacts": [[0, 0.001]]}}, "put its centre on the plane"),
]


@pytest.mark.parametrize(("changes", "message"), BAD_SLABS)
def test_impossible_slabs_are_refused(changes, message):
    with pytest.raises(GeometryError, match=message):
        build_mesh(slab(**changes))


def test_too_many_elements_are_refused():
    scenario = parse_scenario({**quarter_scenario().model_dump(), "mesh": {**COARSE, "max_elements": 100}})
    with pytest.raises(MeshError, match=r"mesh\.max_elements allows 100"):
        build_mesh(scenario)


def _with(mesh, **changes):
    return replace(mesh, **changes)


def _inverted(m):
    return _with(m, tetrahedra=np.vstack([m.tetrahedra[:-1], m.tetrahedra[-1:, [1, 0, 2, 3]]]))


def _doubled(m):
    points = np.vstack([m.points, m.points[m.tetrahedra[0, 0]]])
    tets = m.tetrahedra.copy()
    tets[0, 0] = len(m.points)
    return _with(m, points=points, tetrahedra=tets)


def _hole(m):
    inner = np.flatnonzero(~np.isin(m.tetrahedra, np.vstack([*m.facets.values()])).any(axis=1))[0]
    keep = np.arange(len(m.tetrahedra)) != inner
    return _with(m, tetrahedra=m.tetrahedra[keep], region=m.region[keep])


def _twice(m):
    return _with(m, tetrahedra=np.vstack([m.tetrahedra, m.tetrahedra[:1]]), region=np.append(m.region, m.region[0]))


def _two_parts(m):
    n = len(m.points)
    facets = {k: np.vstack([f, f + n]) for k, f in m.facets.items()}
    return _with(
        m,
        points=np.vstack([m.points, m.points + 1.0]),
        tetrahedra=np.vstack([m.tetrahedra, m.tetrahedra + n]),
        region=np.tile(m.region, 2),
        facets=facets,
    )


BAD_MESHES = [
    (_inverted, "1 of .* inverted"),
    (_doubled, "1 pairs of points coincide"),
    (_hole, "neither skin, bone, end nor symmetry"),
    (_twice, "more than two tetrahedra"),
    (_two_parts, "2 separate parts"),
    (lambda m: _with(m, region=np.where(m.region == 1, 0, m.region)), "region 'fat' contains no tetrahedron"),
    (lambda m: _with(m, region=m.region + 1), "region numbers reach from 1 to 3"),
    (lambda m: _with(m, region=m.region[:-1]), "need one for each"),
    (lambda m: _with(m, facets={**m.facets, "skin": m.facets["skin"][:0]}), "has no skin"),
    (
        lambda m: _with(m, points=np.where(np.arange(len(m.points))[:, None] == 3, np.nan, m.points)),
        "not finite",
    ),
    (lambda m: _with(m, points=m.points[:-5]), "refer to point"),
    (lambda m: _with(m, tetrahedra=m.tetrahedra[:0]), "no tetrahedra"),
]


@pytest.mark.parametrize(("spoil", "message"), BAD_MESHES)
def test_unsound_meshes_are_refused(quarter, spoil, message):
    with pytest.raises(MeshError, match=message):
        check_mesh(spoil(quarter), 0.02)


def test_bad_quality_says_where(quarter):
    with pytest.raises(MeshError, match=r"worst tetrahedron, in \w+ at .* has quality .* need 0\.9"):
        check_mesh(quarter, 0.9)


def test_a_hanging_vertex_is_found(quarter):
    """Split only one of the tetrahedra around an edge: its new vertex hangs on the others."""
    m = quarter
    skin = m.facets["skin"][0]
    a, b = skin[:2]
    around = np.flatnonzero(np.isin(m.tetrahedra, [a, b]).sum(axis=1) == 2)
    t, new = around[0], len(m.points)
    tets = np.vstack([m.tetrahedra, m.tetrahedra[t]])
    tets[t] = np.where(tets[t] == b, new, tets[t])
    tets[-1] = np.where(tets[-1] == a, new, tets[-1])
    points = np.vstack([m.points, m.points[[a, b]].mean(axis=0)])
    from forearm_fem.geometry.mesh.tissue_mesh import boundary_faces

    faces, _ = boundary_faces(tets)
    hung = _with(m, points=points, tetrahedra=tets, region=np.append(m.region, m.region[t]), facets={"skin": faces})
    with pytest.raises(MeshError, match=r"hang on another facet's edge|not a closed surface"):
        check_mesh(hung, 0.0)
