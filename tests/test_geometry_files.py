"""Mesh files, the cache, and limbs that the user brings."""

from __future__ import annotations

import json
import logging
import os
import subprocess
import sys
import tempfile
import warnings
from dataclasses import replace

import meshio
import numpy as np
import pytest
import trimesh

from forearm_fem.errors import GeometryError, MeshError
from forearm_fem.geometry.build import build_mesh, cached_mesh, mesh_key
from forearm_fem.geometry.device.place import facet_area, place_ports
from forearm_fem.geometry.mesh.files import read_mesh, write_mesh
from forearm_fem.geometry.mesh.quality import check_mesh, mesh_quality
from forearm_fem.geometry.user import volume as tetwild
from forearm_fem.scenario import parse_scenario
from forearm_fem.store.folder import default_cache_dir

SLAB = {
    "limb": {"shape": "slab", "symmetry": ["x", "y"], "length": 0.08, "width": 0.06},
    "mesh": {"size_grid": 4e-3, "size_contact": 2e-3, "size_far": 12e-3},
    "device": {"contacts": [[0, 0]]},
    "grid": {"points": [[0.01, 0]]},
}
USER = {
    "mesh": {"size_grid": 6e-3, "size_contact": 3e-3, "size_far": 12e-3, "min_quality": 0.005},
    "device": {"contacts": [[-0.012, 0], [0.012, 0]]},
    "grid": {"points": [[0, 0]]},
}


OF_A_MESH = {**USER, "mesh": {"size_contact": 3e-3, "min_quality": 0.005}}  # its own elements: no other sizes


@pytest.fixture(scope="module")
def slab():
    return build_mesh(parse_scenario(SLAB))


@pytest.mark.parametrize("ending", [".vtu", ".msh"])
def test_mesh_files_read_back_exactly(slab, tmp_path, ending):
    file = tmp_path / f"mesh{ending}"
    write_mesh(slab, file)
    back = read_mesh(file)
    assert back.digest == slab.digest
    assert back.region_names == slab.region_names
    assert list(back.facets) == list(slab.facets)
    assert [f.name for f in tmp_path.iterdir()] == [file.name]


def test_vtu_names_tissues_and_boundaries(slab, tmp_path):
    write_mesh(slab, tmp_path / "m.vtu")
    names = set(meshio.read(tmp_path / "m.vtu").cell_data)
    assert {"region", "region 0 skin", "region 2 muscle", "boundary skin", "boundary contact A1"} <= names


def test_msh_has_physical_groups(slab, tmp_path):
    write_mesh(slab, tmp_path / "m.msh")
    groups = meshio.read(tmp_path / "m.msh").field_data
    assert set(groups) >= {"skin", "fat", "muscle", "boundary skin", "boundary end"}


def test_unreadable_mesh_files_are_named(slab, tmp_path):
    (tmp_path / "bad.vtu").write_text("no mesh")
    meshio.Mesh(np.eye(4)[:, :3], [("tetra", [[0, 1, 2, 3]])]).write(tmp_path / "foreign.vtu")
    with pytest.raises(MeshError, match=r"bad\.vtu: cannot be read"):
        read_mesh(tmp_path / "bad.vtu")
    with pytest.raises(MeshError, match="no such mesh file"):
        read_mesh(tmp_path / "missing.vtu")
    with pytest.raises(MeshError, match="not a mesh written by this program"):
        read_mesh(tmp_path / "foreign.vtu")
    with pytest.raises(MeshError, match=r"kept as \.vtu or \.msh, not '\.stl'"):
        write_mesh(slab, tmp_path / "m.stl")


def _cached(tmp_path, **changes):
    scenario = parse_scenario({**SLAB, **changes})
    built: list[str] = []
    import forearm_fem.geometry.build as module

    original = module.build_mesh

    def counted(*args, **kwargs):
        built.append("once")
        return original(*args, **kwargs)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "build_mesh", counted)
        mesh = cached_mesh(scenario, base=tmp_path, cache_dir=tmp_path / "cache", shipped_dir=tmp_path / "shipped")
    return mesh, len(built)


def test_cache_hits_misses_and_recovers(tmp_path, caplog):
    first, built = _cached(tmp_path)
    assert built == 1
    again, built = _cached(tmp_path)
    assert (built, again.digest) == (0, first.digest)
    assert _cached(tmp_path, device={"contacts": [[0, 0]], "cone": {"radius": 3e-3}})[1] == 1
    key = mesh_key(parse_scenario(SLAB), base=tmp_path)
    file = tmp_path / "cache" / f"{key}.vtu"
    file.write_bytes(file.read_bytes()[:2000])
    with caplog.at_level(logging.WARNING, logger="forearm_fem.geometry"):
        mended, built = _cached(tmp_path)
    assert (built, mended.digest) == (1, first.digest)
    assert "will be built again" in caplog.text
    assert _cached(tmp_path)[1] == 0


def test_cache_distrusts_changed_contents(tmp_path, slab, caplog):
    _cached(tmp_path)
    note = next((tmp_path / "cache").glob("*.json"))
    write_mesh(replace(slab, points=slab.points * 1.01), note.with_suffix(".vtu"))
    with caplog.at_level(logging.WARNING, logger="forearm_fem.geometry"):
        assert _cached(tmp_path)[1] == 1
    assert "does not match its note" in caplog.text


def test_shipped_meshes_come_first(tmp_path):
    mesh, _ = _cached(tmp_path)
    (tmp_path / "shipped").mkdir()
    for file in (tmp_path / "cache").iterdir():
        file.rename(tmp_path / "shipped" / f"named{file.suffix}")
    again, built = _cached(tmp_path)
    assert (built, again.digest) == (0, mesh.digest)
    assert "command" in json.loads((tmp_path / "shipped" / "named.json").read_text())


def test_key_ignores_what_the_mesh_does_not_depend_on():
    key = mesh_key(parse_scenario(SLAB))
    assert mesh_key(parse_scenario({**SLAB, "name": "other", "sweep": {"f_min": 20}})) == key
    assert mesh_key(parse_scenario(SLAB), scale=1.5) != key
    assert mesh_key(parse_scenario({**SLAB, "grid": {"points": [[0.011, 0]]}})) != key


def test_cache_folder_follows_the_environment(monkeypatch, tmp_path):
    monkeypatch.setenv("FOREARM_FEM_CACHE", str(tmp_path / "own"))
    assert default_cache_dir() == tmp_path / "own"
    monkeypatch.delenv("FOREARM_FEM_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    if sys.platform.startswith("linux"):
        assert default_cache_dir() == tmp_path / "forearm_fem"
        (tmp_path / "file").touch()
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))  # root, too, cannot write below a file
        monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
        assert default_cache_dir() == tmp_path / f"forearm_fem-{os.getuid()}"


# ---- surfaces and meshes of the user ----


def cylinder(radius, *, at=(0.0, 0.0), length=60.0, sections=40):
    body = trimesh.creation.cylinder(radius, length, sections=sections)
    body.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [0, 1, 0]))
    body.apply_translation([0, *at])
    return body


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("surfaces")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        cylinder(25).export(place / "skin.stl")
        cylinder(21).export(place / "muscle.ply")
        cylinder(6, at=(0, -4)).export(place / "bone.obj")
        cylinder(6, at=(0, -22)).export(place / "crossing.stl")
        cylinder(6, at=(0, -60)).export(place / "outside.stl")
        open_body = cylinder(25)
        open_body.update_faces(np.arange(len(open_body.faces)) > 3)
        open_body.export(place / "open.stl")
        bow = cylinder(25)
        bow.vertices = np.where(bow.vertices[:, :1] > 0, bow.vertices * [1, -1, -1] * [-1.2, 0.3, 0.3], bow.vertices)
        bow.export(place / "selfcrossing.stl")
    (place / "text.stl").write_text("hello")
    return place


def surfaces_scenario(unit=1e-3, **surfaces):
    return parse_scenario({**USER, "limb": {"shape": "surfaces", "unit": unit, "surfaces": surfaces}})


@pytest.fixture(scope="module")
def nested(folder):
    scenario = surfaces_scenario(skin="skin.stl", muscle="muscle.ply", bone="bone.obj")
    return scenario, build_mesh(scenario, base=folder)


def test_surfaces_become_regions(nested):
    scenario, mesh = nested
    check_mesh(mesh, 0.005)
    assert mesh.region_names == ("skin", "muscle")
    assert {"skin", "bone", "end", "contact A1", "contact A2"} <= set(mesh.facets)
    area = {r: 20 * r**2 * np.sin(2 * np.pi / 40) * 1e-6 for r in (25, 21, 6)}
    volumes = mesh_quality(mesh).volumes
    assert volumes["skin"] == pytest.approx((area[25] - area[21]) * 0.06, rel=0.06)
    assert volumes["muscle"] == pytest.approx((area[21] - area[6]) * 0.06, rel=0.03)
    assert place_ports(scenario, mesh)[2].position == pytest.approx((0, 0, 0.025), abs=2e-4)


def test_a_users_mesh_is_taken_and_contacts_pressed_in(nested, tmp_path):
    _, mesh = nested
    plain = replace(mesh, facets={k: v for k, v in mesh.facets.items() if not k.startswith("contact")})
    write_mesh(plain, tmp_path / "limb.msh")
    limb = {"shape": "mesh", "file": "limb.msh", "regions": {"skin": "fat", "muscle": "muscle"}}
    scenario = parse_scenario({**OF_A_MESH, "device": {"contacts": [[0.0, 0.0]]}, "limb": limb})
    taken = build_mesh(scenario, base=tmp_path)
    assert taken.region_names == ("fat", "muscle")
    assert taken.volumes.sum() == pytest.approx(mesh.volumes.sum(), rel=1e-3)
    assert facet_area(taken.points, taken.facets["contact A1"]) == pytest.approx(np.pi * 3.5e-3**2, rel=0.06)
    assert {"skin", "bone", "end"} <= set(taken.facets)


BAD_SURFACES = [
    ({}, "limb.surfaces is empty"),
    ({"skin": "missing.stl"}, "no such surface for 'skin'"),
    ({"skin": "text.stl"}, "cannot be read|holds no triangles"),
    ({"skin": "open.stl"}, "not closed"),
    ({"skin": "selfcrossing.stl"}, "crosses itself"),
    ({"skin": "skin.stl", "bone": "crossing.stl"}, "'skin' and 'bone' cross"),
    ({"skin": "skin.stl", "bone": "outside.stl"}, "mm out of 'skin'"),
    ({"bone": "skin.stl", "muscle": "muscle.ply"}, "largest surface is the bone's"),
]


@pytest.mark.parametrize(("surfaces", "message"), BAD_SURFACES)
def test_impossible_surfaces_are_refused(folder, surfaces, message):
    with pytest.raises(GeometryError, match=message):
        build_mesh(surfaces_scenario(**surfaces), base=folder)


def _file_mesh(tmp_path, cells, **data):
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1.0]])
    meshio.Mesh(points, cells, **data).write(tmp_path / "limb.vtu")


TETS = [("tetra", np.array([[0, 1, 2, 3], [1, 2, 3, 4]]))]
BAD_FILES = [
    ([("triangle", np.array([[0, 1, 2]]))], {}, {"1": "skin"}, "no tetrahedra"),
    ([("wedge", np.array([[0, 1, 2, 3, 4, 4]]))], {}, {"1": "skin"}, "only tetrahedra can be used"),
    (TETS, {}, {"1": "skin"}, "carry no region"),
    (TETS, {"cell_data": {"region": [np.array([1, 2])]}}, {"1": "skin"}, "regions 2 have no tissue"),
    (
        TETS,
        {"cell_data": {"region": [np.array([1, 1])]}},
        {"1": "skin", "5": "fat"},
        "names 5, but the file holds 1",
    ),
    (
        TETS,
        {"cell_data": {"region": [np.array([1, 1])]}},
        {"1": "bone"},
        "every region of the mesh is 'bone'",
    ),
]


@pytest.mark.parametrize(("cells", "data", "regions", "message"), BAD_FILES)
def test_unusable_mesh_files_are_refused(tmp_path, cells, data, regions, message):
    _file_mesh(tmp_path, cells, **data)
    limb = {"shape": "mesh", "file": "limb.vtu", "regions": regions}
    with pytest.raises(MeshError, match=message):
        build_mesh(parse_scenario({**OF_A_MESH, "limb": limb}), base=tmp_path)


def test_a_missing_pytetwild_is_not_blamed_on_the_sizes(monkeypatch, tmp_path):
    monkeypatch.setattr(tetwild, "find_spec", lambda name: None)
    with pytest.raises(MeshError, match="pip install pytetwild") as caught:
        tetwild._run(str(tmp_path))
    assert "size" not in str(caught.value)


def test_missing_mesh_file_is_named(tmp_path):
    limb = {"shape": "mesh", "file": "absent.msh", "regions": {"1": "skin"}}
    with pytest.raises(MeshError, match=r"absent\.msh: no such mesh file"):
        build_mesh(parse_scenario({**OF_A_MESH, "limb": limb}), base=tmp_path)


def test_failures_of_ftetwild_are_named(monkeypatch):
    box = trimesh.creation.box()
    grid, cells = tetwild.background_grid(np.array([-1.0] * 3), np.array([1.0] * 3), 1.0)
    given = (np.asarray(box.vertices), np.asarray(box.faces), grid, cells, np.full(len(grid), 0.5), 0.5)

    def late(*args, **kwargs):
        raise subprocess.TimeoutExpired("fTetWild", 1)

    monkeypatch.setattr(tetwild.subprocess, "run", late)
    with pytest.raises(MeshError, match="did not finish within"):
        tetwild.tetrahedralise(*given)
    crashed = subprocess.CompletedProcess([], -11, "", "boom\nsegmentation fault")
    monkeypatch.setattr(tetwild.subprocess, "run", lambda *a, **k: crashed)
    with pytest.raises(MeshError, match=r"exit status -11.*segmentation fault"):
        tetwild.tetrahedralise(*given)
