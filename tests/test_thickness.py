"""Layers of other thicknesses on one mesh: terms of the operator against the mesh moved for itself, and unseen arms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import csr_array, diags

from forearm_fem.engines import parametric
from forearm_fem.engines.fem import fem_model
from forearm_fem.engines.parametric import Ranges, parametric_model
from forearm_fem.errors import GeometryError
from forearm_fem.fem.assembly.coefficients import grouped
from forearm_fem.fem.assembly.model import ForearmModel
from forearm_fem.fem.assembly.thickness import follows_thickness, motion_of
from forearm_fem.fem.reduction.affine import coefficients_of
from forearm_fem.fem.reduction.parametric_greedy import Growth
from forearm_fem.fem.reduction.sweep import direct_sweep
from forearm_fem.geometry.build import cached_mesh
from forearm_fem.geometry.device.place import grid_places
from forearm_fem.geometry.limb.thickness import stretched, stretches
from forearm_fem.geometry.limb.tube import tube_of
from forearm_fem.geometry.mesh.tissue_mesh import true_volumes
from forearm_fem.scenario import Scenario, parse_scenario
from forearm_fem.transfer import band_error

DEVICE = {
    "device": {"contacts": [[-0.012, 0.0], [0.012, 0.004]], "cone": {"contact": "pressure"}},
    "grid": {"points": [[0.0, 0.003], [0.002, -0.009]]},
    "mesh": {"element": "P2", "size_contact": 7.2e-3, "size_grid": 12.8e-3, "size_far": 19.2e-3,
             "sublayers": {"skin": 1, "fat": 1}},
    "solver": {"discretisation_estimate": False},
}  # fmt: skip
LAYERS = [{"tissue": "skin", "thickness": 1.2e-3}, {"tissue": "fat", "thickness": 3e-3}]
SLAB = {**DEVICE, "limb": {"shape": "slab", "length": 0.05, "width": 0.04, "depth": 0.012, "layers": LAYERS}}
FIBRES = {"override": {"skin": {"fibres": 3.0}, "fat": {"fibres": 0.3}}}
# along its longest side unknowns are numbered, where nothing moves
ROUND = {**DEVICE, "limb": {"shape": "cylinder", "length": 0.06, "diameter": 0.054, "layers": LAYERS}}


@pytest.fixture(scope="module", autouse=True)
def cache(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("FOREARM_FEM_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


def thick(scene: Scenario, skin: float, fat: float) -> Scenario:
    layers = [{"tissue": "skin", "thickness": skin}, {"tissue": "fat", "thickness": fat}]
    return scene.changed({"limb.layers": layers})


def misfit(scene: Scenario, others: list[Scenario], drawn: Scenario, following: bool) -> tuple[float, float]:
    """Share of a drawn arm's stiffness, rows and columns of unit diagonal, and of its divergences that the terms of the
    scene's mesh lack, at 200 Hz; without ``following`` those of the scene's own thickness."""
    mesh, omega = cached_mesh(scene), np.array(2 * np.pi * 200.0)
    motion = motion_of(mesh, scene.limb, [o.limb for o in others])
    assert motion is not None
    model = fem_model(scene, motion.mesh, motion=motion)
    truth = fem_model(drawn, stretched(motion.mesh, scene.limb, drawn.limb))
    names = [t.name for t in model.operator.terms]
    found = coefficients_of(names, drawn, scene.limb if following else None)
    scale = model.operator.pressure_scale / truth.operator.pressure_scale
    mine = upper(model, np.array([complex(c.at(omega)) for c in found]))
    true = upper(truth, np.array([complex(t.coefficient.at(omega)) for t in truth.operator.terms]))
    n = model.operator.n_displacements
    unit = diags(1 / np.sqrt(np.abs(true.diagonal()[:n])))
    return (
        size(unit @ (mine - true)[:n, :n] @ unit) / size(unit @ true[:n, :n] @ unit),
        size((mine / scale - true)[:n, n:]) / size(true[:n, n:]),
    )


def upper(model: ForearmModel, weights: np.ndarray) -> csr_array:
    return model.operator.upper(model.operator.combine(weights.tolist()))


def size(matrix: csr_array) -> float:
    return float(np.linalg.norm(csr_array(matrix).data))


def test_flat_layers_follow_their_thickness_exactly():
    """s K_t + K_c + K_n / s and the like: rounding is left, where a quarter changes."""
    scene = parse_scenario({**SLAB, "tissues": FIBRES})
    others, drawn = [thick(scene, 0.8e-3, 2e-3), thick(scene, 2e-3, 4.5e-3)], thick(scene, 1.7e-3, 2.2e-3)
    assert max(misfit(scene, others, drawn, following=True)) < 1e-13
    assert misfit(scene, others, drawn, following=False)[0] > 0.05


def test_bent_layers_follow_to_a_thousandth():
    """Six powers leave the second order of thickness over radius: 2e-4 of the stiffness here. First order is quick."""
    scene = parse_scenario({**ROUND, "mesh": {**ROUND["mesh"], "element": "P1"}, "tissues": FIBRES})
    others, drawn = [thick(scene, 0.8e-3, 1.5e-3), thick(scene, 1.9e-3, 6e-3)], thick(scene, 1e-3, 5e-3)
    assert max(misfit(scene, others, drawn, following=True)) < 1e-3


def test_a_stretched_mesh_has_the_volumes_of_its_limb():
    scene = parse_scenario(ROUND)
    mesh, drawn = cached_mesh(scene), thick(scene, 1.9e-3, 5e-3)
    found, exact = stretched(mesh, scene.limb, drawn.limb), tube_of(drawn.limb).volumes(bones_kept=False)
    for number, name in enumerate(found.region_names):
        own = true_volumes(found)[found.region == number].sum()
        assert own == pytest.approx(exact[name], rel=5e-3)  # facets of the core's wall: the mesh itself is as far off
    assert np.array_equal(found.facets["skin"], mesh.facets["skin"])
    with pytest.raises(GeometryError, match="leave too little of the core"):
        stretched(mesh, scene.limb, thick(scene, 2e-3, 13e-3).limb)


def test_limbs_that_differ_in_more_have_no_stretch():
    slab, tube = parse_scenario(SLAB), parse_scenario(ROUND)
    assert stretches(slab.limb, tube.limb) is None
    assert stretches(slab.limb, slab.changed({"limb.depth": 0.013}).limb) is None
    found = stretches(slab.limb, thick(slab, 2.4e-3, 1.5e-3).limb)
    assert found is not None
    assert (found["skin"].scale, found["fat"].scale) == pytest.approx((2.0, 0.5))
    assert found["fat"].offset == pytest.approx(1.2e-3)
    assert found["muscle"].scale == pytest.approx(8.1 / 7.8)


def test_springpots_on_the_meshs_own_thickness_have_no_more_terms():
    """Terms of other thicknesses are then nothing, which a springpot has no series at zero for."""
    scene, names = parse_scenario({**SLAB, "tissues": {"preset": "springpot"}}), ["shear fat", "shear fat; 1 0"]
    own, other = (grouped(coefficients_of(names, s, scene.limb)) for s in (scene, thick(scene, 1.2e-3, 4.5e-3)))
    assert [w.tolist() for w, _ in own] == [[1.0, 0.0]]
    assert [w.tolist() for w, _ in other] == [[1.0, pytest.approx(0.5)]]


@pytest.mark.slow
def test_unseen_arms_are_as_right_as_stated():
    """Thicknesses, laws and moduli of a hypercube of another seed, against solves on meshes moved for them."""
    scene, ranges = parse_scenario(SLAB), Ranges(thickness=1.5)
    growth = Growth(rate=10, solves=12, checks=4, of_points=4, parts=1, states=60)
    model = parametric_model(scene, draws=ranges.draws(scene, 48), growth=growth)
    probes = np.array([60.0, 150.0, 300.0])
    for draw in ranges.draws(scene, 3, seed=99):
        found = model.compliance(draw, probes)
        own = fem_model(draw, stretched(cached_mesh(scene), scene.limb, draw.limb))
        truth = direct_sweep(own, probes, draw.solver).values[:, 2:, :2]
        true = band_error(found.block("point", "contact"), truth)
        assert true < found.errors[0].band < 0.5


def test_round_limbs_are_read_from_above_too():
    """The laser's direction needs no other model: places once along the normals, once along z; flat skin has one."""
    flat, bent = parse_scenario(SLAB), parse_scenario(ROUND)
    for scene, times in ((flat, 1), (bent, 2)):
        found = grid_places(scene, cached_mesh(scene))
        assert found is not None
        around, ports = found
        assert len(ports) == times * len(around.places)
        assert around.hold(scene)
        assert all(p.axis == (0.0, 0.0, 1.0) for p in ports[(times - 1) * len(around.places) :])
    assert around.hold(bent.changed({"grid": bent.grid.changed({"direction": "vertical"})}))
    assert ports[0].position == ports[len(around.places)].position
    assert ports[-1 - len(around.places)].axis != (0.0, 0.0, 1.0)


def test_terms_that_do_not_fit_into_memory_are_left_out(monkeypatch):
    """Layers then stay, as the layered model's change serves."""

    class Assembled(Exception):
        pass

    def stop(model: ForearmModel, *_: object) -> None:
        raise Assembled(follows_thickness([t.name for t in model.operator.terms]))

    monkeypatch.setattr(parametric, "united_model", stop)
    scene = parse_scenario({**SLAB, "solver": {**SLAB["solver"], "memory_limit": 1e8}})
    with pytest.raises(Assembled) as told:
        parametric_model(scene, ranges=Ranges(thickness=1.5))
    assert told.value.args == (False,)
