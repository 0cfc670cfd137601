"""What a stored mesh or solve depends on is in its key, and what it does not depend on is not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from forearm_fem.engines import fem
from forearm_fem.engines.fem import solve_key
from forearm_fem.geometry.build import build_mesh, mesh_key
from forearm_fem.geometry.mesh.tissue_mesh import Bends
from forearm_fem.scenario import apply_overrides, parse_scenario

SLAB = {
    "accuracy": 0.5,
    "limb": {"shape": "slab", "length": 0.07, "width": 0.07, "depth": 0.012},
    "mesh": {"size_contact": 0.008, "size_grid": 0.014, "size_far": 0.02, "sublayers": {"skin": 1, "fat": 1}},
    "device": {"cone": {"contact": "pressure"}},
}
BAND = np.array([20.0, 100.0])


@pytest.fixture(scope="module")
def mesh():
    return build_mesh(parse_scenario(SLAB), base=Path())


def with_key(change):
    return parse_scenario(apply_overrides(SLAB, [change]))


@pytest.mark.parametrize(
    "change",
    [
        "supports.ends='free'",
        "tissues.override.skin.mu=2e4",
        "tissues.membrane.viscosity=1e-3",
        "tissues.patch.mass=0.2",
        "device.cone.contact='bonded'",
        "grid.points=[[0.0, 0.001]]",
        "solver.sweep='direct'",
        "solver.precision='double'",
        "accuracy=0.001",
    ],
)
def test_a_solve_is_not_reused_for(mesh, change):
    assert solve_key(with_key(change), mesh, BAND) != solve_key(parse_scenario(SLAB), mesh, BAND)


def test_a_solve_is_not_reused_for_other_frequencies_meshes_or_versions(mesh, monkeypatch):
    scenario = parse_scenario(SLAB)
    key = solve_key(scenario, mesh, BAND)
    bent = Bends(np.array([[0, 1]]), np.full((1, 3), 1e-4))
    moved = replace(mesh, points=mesh.points * (1 + 1e-12))
    others = [
        solve_key(scenario, mesh, BAND + 1e-9),
        solve_key(scenario, moved, BAND),
        solve_key(scenario, replace(mesh, bends=bent), BAND),
    ]
    monkeypatch.setattr(fem, "__version__", "0")
    others.append(solve_key(scenario, mesh, BAND))
    assert len({key, *others}) == 5


@pytest.mark.parametrize(
    "change", ["device.coil.moving_mass=1e-3", "device.housing.fixed=true", "rendering.targets=['5']", "name='other'"]
)
def test_a_solve_is_reused_for_another_coil_housing_or_target(mesh, change):
    assert solve_key(with_key(change), mesh, BAND) == solve_key(parse_scenario(SLAB), mesh, BAND)


@pytest.mark.parametrize(
    "change",
    [
        "limb.depth=0.013",
        "mesh.grading=0.2",
        "mesh.size_far=0.015",
        "mesh.sublayers.fat=2",
        "device.cone.radius=4e-3",
        "device.cone.contact='bonded'",
        "device.spacing=0.04",
        "grid.points=[[0.0, 0.001]]",
    ],
)
def test_a_mesh_is_not_reused_for(change):
    assert mesh_key(with_key(change)) != mesh_key(parse_scenario(SLAB))
