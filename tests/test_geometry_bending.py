"""Edges bent along a limb's walls: where their middles lie, who has them, and what would fold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from forearm_fem.geometry import build
from forearm_fem.geometry.build import build_mesh, cached_mesh
from forearm_fem.geometry.limb import tube as bending
from forearm_fem.geometry.limb.tube import bent, tube_of, with_bends
from forearm_fem.geometry.mesh.tissue_mesh import (
    EDGES,
    Bends,
    bent_jacobians,
    bent_places,
    straight_jacobians,
    true_volumes,
)
from forearm_fem.scenario import parse_scenario

COARSE = {"size_grid": 5e-3, "size_contact": 3e-3, "size_far": 12e-3}
UNIT = np.vstack([np.zeros(3), np.eye(3)])


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """A folder of meshes."""
    return tmp_path_factory.mktemp("meshes")


@pytest.fixture(scope="module")
def limb(kept):
    scenario = parse_scenario({"limb": {"shape": "forearm", "aspect": 1.3, "length": 0.1}, "mesh": COARSE})
    return scenario, cached_mesh(scenario, cache_dir=kept, shipped_dir=kept / "none")  # built and stored


def middles(mesh):
    return mesh.points[mesh.bends.edges].mean(axis=1) + mesh.bends.offsets


@pytest.mark.slow
def test_edges_that_refinement_bisects_far_from_a_rim_get_their_middle_on_the_skin():
    """On chords of facets of 0.5 rad vertices lay up to 1.4 mm below it."""
    limb = {"shape": "cylinder", "layers": [], "length": 0.08}
    scenario = parse_scenario({"limb": limb, "mesh": {"size_grid": 4e-3, "size_contact": 2e-3}})
    mesh, tube = build_mesh(scenario), tube_of(scenario.limb)
    skin = mesh.points[np.unique(mesh.facets["skin"])]
    assert tube.depth_of(skin, tube.angle_of(skin)).max() < 0.2e-3  # 1 % of 20 mm stays straight


@pytest.mark.slow  # 3 s
def test_middles_lie_as_deep_as_their_ends_on_average(limb):
    scenario, mesh = limb
    tube = tube_of(scenario.limb)
    layers = np.unique(mesh.tetrahedra[mesh.region < 2])
    edges = mesh.bends.edges
    chosen = np.isin(edges, layers).all(axis=1) & ~np.isin(edges, mesh.facets["bone"]).any(axis=1)

    def depth(points):
        return tube.depth_of(points, tube.angle_of(points))

    ends = np.mean([depth(mesh.points[edges[chosen, i]]) for i in (0, 1)], axis=0)
    assert depth(middles(mesh)[chosen]) == pytest.approx(ends, abs=1e-9)
    assert np.linalg.norm(mesh.bends.offsets, axis=1).max() > 2e-4  # chords of 12 mm


def test_ends_of_the_limb_stay_plane(limb):
    scenario, mesh = limb
    at_end = np.isin(mesh.bends.edges, mesh.facets["end"]).all(axis=1)
    ends = np.abs(mesh.points[mesh.bends.edges][:, :, 0]).min(axis=1) > scenario.limb.length / 2 - 1e-12
    assert (at_end & ends).any()
    assert mesh.bends.offsets[at_end & ends][:, 0] == pytest.approx(0, abs=1e-15)


def test_straight_edges_have_no_bend(limb):
    _, mesh = limb
    length = np.linalg.norm(np.diff(mesh.points[mesh.bends.edges], axis=1)[:, 0], axis=1)
    assert (np.linalg.norm(mesh.bends.offsets, axis=1) > 0.01 * length).all()
    small = {"shape": "slab", "length": 0.08, "width": 0.08, "depth": 0.02}
    slab = parse_scenario({"limb": small, "mesh": COARSE})
    assert not len(build_mesh(slab).bends.edges)


def test_meshes_from_files_bend_like_new_ones(limb, kept, monkeypatch):
    scenario, mesh = limb
    monkeypatch.setattr(build, "build_mesh", lambda *_, **__: pytest.fail("built, not read"))
    found = cached_mesh(scenario, cache_dir=kept, shipped_dir=kept / "none")
    assert found is not mesh
    assert np.array_equal(found.bends.edges, mesh.bends.edges)
    assert np.array_equal(found.bends.offsets, mesh.bends.offsets)
    straight = replace(mesh, bends=Bends())
    assert straight.digest == mesh.digest
    assert np.array_equal(with_bends(scenario, straight).bends.offsets, mesh.bends.offsets)


def test_what_would_fold_stays_straight(limb, monkeypatch):
    """Asked for hardly any change of the determinant, most elements refuse; none that is left falls below."""
    scenario, mesh = limb
    monkeypatch.setattr(bending, "_LEAST", 0.9)
    careful = bent(mesh, tube_of(scenario.limb))
    assert 0 < len(careful.bends.edges) < len(mesh.bends.edges)
    for each, least in ((mesh, 0.3), (careful, 0.9)):
        straight = straight_jacobians(each.points, each.tetrahedra)
        offsets = each.bends.of(each.tetrahedra)
        probes = np.linalg.det(bent_jacobians(straight, offsets, bending._PROBES))
        assert (probes.min(axis=1) >= least * np.linalg.det(straight)).all()
    volumes = true_volumes(mesh)
    assert volumes.min() > 0


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_jacobians_are_the_derivatives_of_places(seed):
    random = np.random.default_rng(seed)
    corners, offsets = random.normal(size=(1, 4, 3)), random.normal(size=(1, 6, 3))
    point, step = random.uniform(0, 0.3, (3, 1)), 1e-6
    straight = straight_jacobians(corners[0], np.arange(4)[None])
    exact = bent_jacobians(straight, offsets, point)[0, 0]
    for k in range(3):
        nudge = step * np.eye(3)[:, k : k + 1]
        ahead, behind = (bent_places(corners, offsets, point + sign * nudge)[0, 0] for sign in (1, -1))
        assert exact[:, k] == pytest.approx((ahead - behind) / (2 * step), abs=1e-8)  # quadratic: only rounding


def test_middles_of_edges_are_where_bends_say():
    offsets = np.random.default_rng(1).normal(size=(1, 6, 3))
    at = (UNIT[EDGES[:, 0]] + UNIT[EDGES[:, 1]]) / 2
    assert bent_places(UNIT[None], offsets, at.T)[0] == pytest.approx(at + offsets[0])
    assert bent_places(UNIT[None], offsets, UNIT.T)[0] == pytest.approx(UNIT)
