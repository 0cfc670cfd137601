"""Meshes and surfaces that users bring: right, or one sentence that names file, cell or vertex, and remedy."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bad_files import CORNERS
from bad_meshes import BROUGHT, FINE, FINE_TETRA, MESHES, REST, SURFACES, Brought

from forearm_fem.engines.forecast import doubts_of
from forearm_fem.errors import ForearmError, GeometryError, MeshError
from forearm_fem.geometry import build
from forearm_fem.geometry.build import build_mesh
from forearm_fem.geometry.device.layout import layout_of
from forearm_fem.geometry.mesh import tissue_mesh as nearby
from forearm_fem.geometry.mesh.quality import check_mesh, mesh_quality
from forearm_fem.geometry.mesh.tissue_mesh import TissueMesh, boundary_faces, meeting
from forearm_fem.geometry.user import checks as crossing
from forearm_fem.geometry.user import surfaces
from forearm_fem.geometry.user import volume as tetwild
from forearm_fem.geometry.user.checks import check_room
from forearm_fem.geometry.user.meshes import joined, user_mesh
from forearm_fem.geometry.user.surfaces import read_surfaces
from forearm_fem.scenario import load_scenario, parse_scenario

WRONG = [case for case in BROUGHT if case.says]
VALID_MESHES = [case for case in MESHES if not case.says]
VALID_SURFACES = [case for case in SURFACES if not case.says]


def named(case: Brought) -> str:
    return case.name.replace(" ", "_")


@pytest.mark.parametrize("case", WRONG, ids=named)
def test_defects_get_one_sentence(case, tmp_path):
    case.write(tmp_path)
    with pytest.raises((MeshError, GeometryError)) as failure:
        build_mesh(parse_scenario(case.scenario()), base=tmp_path)
    said = str(failure.value).replace(f"{tmp_path}/", "")
    assert len(said) <= 300
    assert "\n" not in said
    for words in case.says:
        assert any(w in said for w in re.split(r"(?<=\w)\|", words)), said


def taken(case: Brought, folder) -> TissueMesh:
    case.write(folder)
    scenario = parse_scenario(case.scenario())
    return user_mesh(scenario.limb, folder, layout_of(scenario), 0.005, keep_bone=False)


@pytest.mark.parametrize("case", VALID_MESHES, ids=named)
def test_odd_but_valid_meshes_are_the_same_body(case, tmp_path):
    """A block of 80 x 80 x 20 mm, its upper half fat: whatever the file's form, volumes and boundary are the same."""
    mesh = taken(case, tmp_path)
    volume = 0.08 * 0.08 * 0.01
    precision = 1e-6 if "single" in case.name else 1e-12  # 24 bits of coordinates of 40 mm
    assert mesh_quality(mesh).volumes == pytest.approx({"muscle": volume, "fat": volume}, rel=precision)
    assert mesh.volumes.min() > 0
    assert set(mesh.facets) >= {"skin", "end"}
    assert len(boundary_faces(mesh.tetrahedra)[0]) == 2 * 2 * (8 * 8 + 2 * 8 * 2)
    assert len(mesh.points) == 9 * 9 * 3


@pytest.mark.parametrize("case", VALID_SURFACES, ids=named)
def test_odd_but_valid_surfaces_enclose_the_same_volumes(case, tmp_path):
    case.write(tmp_path)
    found = read_surfaces(parse_scenario(case.scenario()).limb, tmp_path)
    volumes = {s.tissue: s.volume for s in found}
    expected = {"skin": 0.12 * 0.07 * 0.06, "muscle": 0.12 * 0.06 * 0.05}
    expected |= {"bone": 2 * 0.12 * 0.01 * 0.01} if "bone" in case.name else {}
    assert volumes == pytest.approx(expected, rel=1e-6)  # STL holds single precision


@pytest.mark.slow  # 20 s: fTetWild for each
@pytest.mark.parametrize("case", VALID_SURFACES, ids=named)
def test_odd_but_valid_surfaces_are_meshed(case, tmp_path):
    case.write(tmp_path)
    mesh = build_mesh(parse_scenario(case.scenario()), base=tmp_path)
    check_mesh(mesh, 0.005)
    muscle = 0.12 * 0.06 * 0.05 - (2 * 0.12 * 0.01**2 if "bone" in case.name else 0.0)
    assert mesh_quality(mesh).volumes["muscle"] == pytest.approx(muscle, rel=0.05)  # edges of 12 mm round corners off


def test_there_are_enough_cases():
    assert len(WRONG) >= 40
    assert len(VALID_MESHES) + len(VALID_SURFACES) >= 15
    assert len({case.name for case in BROUGHT}) == len(BROUGHT)


def test_a_bone_left_out_of_the_mesh_is_a_hole_and_stays_one(tmp_path):
    """A cavity of 2 x 2 x 1 cubes has 32 facets: that is meant, unlike one cell that was lost."""
    import meshio

    middle = FINE[FINE_TETRA].mean(axis=1)
    hole = (np.abs(middle[:, :2]) < 0.01).all(axis=1) & (np.abs(middle[:, 2] + 0.025) < 0.005)
    cells = FINE_TETRA[~hole]
    made = meshio.Mesh(FINE, [("tetra", cells)], cell_data={"region": [np.ones(len(cells), int)]})
    case = Brought("hole", lambda p: made.write(p / "limb.vtu"), {**MESHES[0].limb, "regions": {"1": "muscle"}})
    mesh = taken(case, tmp_path)
    assert len(mesh.facets["bone"]) == 2 * (2 * 4 + 4 * 2)


def test_vertices_that_coincide_are_one():
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 1 + 1e-9], [1, 1, 1.0], [9, 9, 9]])
    new, cells = joined(points, np.array([[0, 1, 2, 3], [1, 2, 4, 5]]))
    assert len(new) == 5
    assert len(np.intersect1d(*cells)) == 3


def test_pairs_that_meet_are_those_of_all_pairs():
    rng = np.random.default_rng(0)
    a, b = rng.random((60, 3)), rng.random((80, 3))
    ra, rb = 0.3 * rng.random(60) ** 4, 0.5 * rng.random(80) ** 6
    found = {tuple(p) for p in meeting(a, ra, b, rb).T.tolist()}
    away = np.linalg.norm(a[:, None] - b[None], axis=2)
    assert found == {tuple(p) for p in np.argwhere(away <= ra[:, None] + rb[None]).tolist()}
    assert meeting(a[:0], ra[:0], b, rb).shape == (2, 0)


def test_wide_triangles_do_not_make_all_pairs_near(monkeypatch):
    """A fan at the end of a finely cut tube once made each triangle a neighbour of all: minutes without a word."""
    n, rings = 100, 20
    angle = np.arange(n) * 2 * np.pi / n
    points = np.concatenate(
        [np.column_stack([np.cos(angle), np.sin(angle), np.full(n, 0.06 * k)]) for k in range(rings)]
    )
    here = np.arange(rings * n).reshape(rings, n)
    wall = np.stack([here[:-1], np.roll(here, -1, axis=1)[:-1], here[1:]], axis=-1).reshape(-1, 3)
    fan = np.column_stack([np.full(n, rings * n), here[0], np.roll(here[0], -1)])
    corners = np.vstack([points, [[0, 0, 0]]])[np.vstack([wall, fan])]
    seen = []

    class Counting(nearby.cKDTree):
        def query_ball_point(self, *args, **options):
            hits = super().query_ball_point(*args, **options)
            seen.append(sum(map(len, hits)))
            return hits

    monkeypatch.setattr(nearby, "cKDTree", Counting)
    assert not len(crossing.crossing_faces(corners, None, np.vstack([wall, fan])))
    # fan and wall are near each other, from either side: 2 n rings n / 4; one radius for all would give (n rings)^2 / 6
    assert sum(seen) < 0.06 * len(corners) ** 2


def test_ports_are_placed_before_the_long_work(tmp_path, monkeypatch):
    case = SURFACES[0]
    case.write(tmp_path)
    monkeypatch.setattr(surfaces, "tetrahedralise", lambda *a: pytest.fail("meshed first"))
    data = {**case.scenario(), "grid": {"points": [[0, 0.0345]]}}
    said: list[tuple[str, int, int]] = []
    monkeypatch.setattr(build, "ports_on", _refused)
    with pytest.raises(GeometryError, match="placed first"):
        build_mesh(parse_scenario(data), base=tmp_path, progress=lambda *step: said.append(step))
    assert said == [("reading and checking the surfaces", 0, 0)]


def _refused(*_: object) -> None:
    raise GeometryError("placed first")


def test_meshing_that_took_too_long_is_not_tried_again(tmp_path, monkeypatch):
    case, tries = SURFACES[0], []
    case.write(tmp_path)

    def slow(*args: object) -> None:
        tries.append(1)
        raise tetwild.MeshTimeout("did not finish")

    monkeypatch.setattr(surfaces, "tetrahedralise", slow)
    with pytest.raises(ForearmError, match="did not finish"):
        build_mesh(parse_scenario(case.scenario()), base=tmp_path)
    assert len(tries) == 1


def test_a_limb_that_lies_otherwise_than_meant_is_named(tmp_path):
    """A limb that stands on its end, one that is nowhere cut across x, and two files that were exchanged."""
    mesh, scenario = taken(MESHES[0], tmp_path), parse_scenario(MESHES[0].scenario())
    assert doubts_of(scenario, mesh) == ()
    (upright,) = doubts_of(scenario, replace(mesh, points=mesh.points * [1, 1, 8]))
    assert upright.startswith("limb: is 160 mm long in z, but 80 mm in x")
    (wide,) = doubts_of(scenario, replace(mesh, points=mesh.points * [5, 5, 5]))  # centimetres taken for their fifth
    assert wide.startswith("limb: is 400 mm across")
    (uncut,) = doubts_of(scenario, replace(mesh, facets={k: v for k, v in mesh.facets.items() if k != "end"}))
    assert "no plane cut end" in uncut
    limb = {"shape": "surfaces", "surfaces": {"skin": "a.stl", "bone": "b.stl", "fat": "c.stl", "muscle": "d.stl"}}
    nested = parse_scenario({**REST, "limb": limb})
    mesh = replace(mesh, region=0 * mesh.region)  # skin all around
    assert doubts_of(nested, replace(mesh, region_names=("skin", "fat", "muscle"))) == ()
    (exchanged,) = doubts_of(nested, replace(mesh, region_names=("skin", "muscle", "fat")))
    assert exchanged.startswith("limb.surfaces: names fat before muscle, whose surface encloses it")


def test_a_limb_on_its_side_is_asked_about(tmp_path):
    """80 x 20 x 80 mm has no room for the device across, and would have it turned."""
    layout = layout_of(parse_scenario({**REST, "device": {"spacing": 0.03}}))
    points = CORNERS[:, [0, 2, 1]]
    with pytest.raises(GeometryError, match=r"or the file to be turned \(z, .* spans 80 mm\)\?") as problem:
        check_room(tmp_path / "limb.vtu", points, layout, 1.0)
    assert len(str(problem.value)) <= 300
    with pytest.raises(GeometryError, match=r"is limb\.unit = 1 right\? else"):
        check_room(tmp_path / "limb.vtu", points * [1, 1, 0.3], layout, 1.0)


def test_a_limb_upside_down_is_named(tmp_path):
    """Skin below and muscle under the device; a limb of one tissue, or with tissues of one's own, tells nothing."""
    mesh, scenario = taken(MESHES[0], tmp_path), parse_scenario(MESHES[0].scenario())
    over = replace(mesh, points=mesh.points * [1, 1, -1], tetrahedra=mesh.tetrahedra[:, [0, 2, 1, 3]])
    up = over.region[np.argmax(over.points[over.tetrahedra].mean(axis=1)[:, 2])]
    named = {True: ("fat", "skin"), False: ("skin", "fat")}[up == 0]  # as the file, turned over, has them
    (said,) = doubts_of(scenario, replace(over, region_names=named))
    assert said.startswith("limb: the device presses on fat, and skin lies on the far side")
    assert doubts_of(scenario, replace(over, region_names=named[::-1])) == ()
    assert doubts_of(scenario, replace(over, region_names=("skin", "gel"))) == ()
    assert doubts_of(scenario, replace(over, region=0 * over.region, region_names=("fat",))) == ()


def test_the_sample_arm_is_sound_and_small():
    """scenarios/own_arm.toml names files that exist, nest, and hold the device; volumes follow from their half axes."""
    file = Path(__file__).parents[1] / "scenarios" / "own_arm.toml"
    scenario = load_scenario(file)
    assert [s.tissue for s in read_surfaces(scenario.limb, file.parent)] == ["skin", "muscle", "bone"]
    all_four = {**scenario.limb.surfaces, "fat": "../meshes/sample/fat.stl"}
    found = read_surfaces(scenario.limb.model_copy(update={"surfaces": all_four}), file.parent)
    assert [s.tissue for s in found] == ["skin", "fat", "muscle", "bone"]
    # ellipse of 40 x 32 mm; 0.3 % is what tapering (15 %, squared, over 3) adds less what 40 sides lack
    assert found[0].volume == pytest.approx(np.pi * 0.04 * 0.032 * 0.16, rel=0.01)
    assert found[3].volume == pytest.approx(2 * np.pi * 0.007**2 * 0.16, rel=0.03)  # 16 sides lack 2.6 %
    size = sum(f.stat().st_size for f in (file.parent / ".." / "meshes" / "sample").glob("*.stl"))
    assert size < 300e3
