"""What lies on the skin: tension against the layered model, and a patch of tape that ends somewhere."""

from __future__ import annotations

import numpy as np
import pytest

from forearm_fem.engines.fem import fem_model
from forearm_fem.engines.layered import kept_tables
from forearm_fem.errors import GeometryError, ScenarioError
from forearm_fem.fem.assembly.bending import facet_bending
from forearm_fem.fem.assembly.boundary import covered_area, facet_mass, facet_membrane, under_rectangle
from forearm_fem.fem.assembly.model import build_model
from forearm_fem.fem.reduction.sweep import direct_sweep
from forearm_fem.fem.space.numbering import _node_place
from forearm_fem.geometry.build import build_mesh
from forearm_fem.layered import integrals, kernel
from forearm_fem.scenario import parse_scenario
from forearm_fem.scenario.limb import FreeUnderside, Membrane, Patch
from forearm_fem.verification.scenes import (
    DIRECT,
    flesh,
    held_block,
    layered_truth,
    quarter_slab,
    slab_model,
    slab_response,
)

SIZES = {"size_grid": 5e-3, "size_far": 8e-3, "size_contact": 2e-3, "element": "P2/P3"}


def test_tension_is_that_of_the_layered_model():
    """60 N/m under and around a bonded disc on a slab, 300 Hz: mesh and side walls leave 0.4 % of the largest entry,
    the tension changes it by a third."""
    slack, taut = (
        quarter_slab((0.010, 0.020), side=0.09, depth=0.03, mesh=SIZES, contact="bonded", membrane={"tension": t})
        for t in (0.0, 60.0)
    )
    found, truth = slab_response(slab_model(taut), [300.0])[0], layered_truth(taut, [300.0])[0]
    assert np.abs(found - truth).max() < 0.01 * np.abs(truth).max()
    assert np.abs(found - truth)[1] < 0.02 * np.abs(truth[1])
    assert np.abs(truth - layered_truth(slack, [300.0])[0]).max() > 0.2 * np.abs(truth).max()


def test_a_plate_on_the_skin_is_that_of_the_half_space_under_it(monkeypatch):
    """Tape on all of a slab under a pressed disc, 150 Hz, against D k^4 in the surface's impedance: these elements
    leave 0.8 % of the largest entry at points, which bending changes by a third."""
    sizes = {**SIZES, "size_grid": 6e-3, "size_far": 1e-2}
    bare = quarter_slab((0.008, 0.014), side=0.07, depth=0.025, mesh=sizes)
    tape = {"length": 0.4, "width": 0.4, "mass": 0.2, "stiffness": 2500.0, "bending": 1e-4}
    taped = bare.changed({f"tissues.patch.{key}": value for key, value in tape.items()})
    found, exact = slab_response(slab_model(taped), [150.0])[0], kernel._plane_stiffness

    def stiffened(k, omega, layers, surface):
        """With the plate's share of the normal stiffness."""
        tangential, normal, coupling = exact(k, omega, layers, surface)
        return tangential, normal + 1e-4 * k**4, coupling

    sheet = bare.changed({"tissues.membrane.mass": 0.2, "tissues.membrane.stiffness": 2500.0})
    without = layered_truth(sheet, [150.0])[0]
    monkeypatch.setattr(kernel, "_plane_stiffness", stiffened)
    none = lambda omega, *_: kernel.SurfaceCompliance(*np.zeros((4, omega.size)))  # noqa: E731
    monkeypatch.setattr(integrals, "compliance_limits", none)
    truth = layered_truth(sheet, [150.0])[0]
    assert np.abs(found - truth)[0] < 0.01 * np.abs(truth[0])
    assert np.abs(found - truth)[1:].max() < 0.015 * np.abs(truth[1:]).max()
    assert np.abs(without - truth)[1:].max() > 0.3 * np.abs(truth[1:]).max()


@pytest.mark.parametrize(("shape", "element"), [("slab", "P2"), ("slab", "P3"), ("cylinder", "P2")])
def test_bending_is_exact_of_even_curvature_and_nothing_of_rigid_motion(shape, element):
    """A patch whose edges cut through facets: H = (2, 0) has 4 per area with nu = 1/2, twist (0, 1) has 1. Turned as a
    whole it costs nothing, bent skin included, and nothing costs less than nothing."""
    limb = {"slab": {"length": 0.04, "width": 0.03, "depth": 0.01}, "cylinder": {"diameter": 0.05, "length": 0.06}}
    scenario = parse_scenario({"limb": {"shape": shape, "layers": [], **limb[shape]},
                               "mesh": {"element": element, "size_contact": 6e-3, "size_grid": 6e-3, "size_far": 9e-3},
                               "device": {"contacts": [[0.0, 0.0]], "cone": {"contact": "pressure"}},
                               "grid": {"points": [[0.01, 0.0]]}})  # fmt: skip
    space = fem_model(scenario, build_mesh(scenario)).space
    skin, under = space.mesh.facets["skin"], under_rectangle(0.02, 0.017)
    stiffness = facet_bending(space, skin, under)
    corner, flat = space.mesh.points[space.vertices], np.zeros(space.n_nodes)
    places = np.zeros((space.n_nodes, 3))
    for i in range(space.nodes.shape[1]):
        places[space.nodes[:, i]] = np.einsum("c,kci->ki", _node_place(space.pair.name, i), corner)
    x, y, _ = places.T

    def energy(motion):
        return motion.ravel() @ (stiffness @ motion.ravel())

    bent, twisted = (energy(np.stack([flat, flat, w], axis=1)) for w in (x**2, x * y))
    if shape == "slab":
        area = covered_area(space, skin, under)
        assert (bent / area, twisted / area) == pytest.approx((4, 1), rel=0.01)  # facets cut by two rules
    assert max(abs(energy(np.cross(axis, places))) for axis in np.eye(3)) < 1e-5 * bent
    used = np.flatnonzero(stiffness.diagonal() > 0)
    values = np.linalg.eigvalsh(stiffness[used][:, used].toarray())
    assert values[0] > -1e-12 * values[-1]


def test_linear_elements_do_not_bend():
    block = held_block(2, element="P1")
    with pytest.raises(ScenarioError, match=r"tissues\.patch\.bending: facets of P1 elements"):
        facet_bending(block.space, block.space.mesh.facets["skin"], under_rectangle(1.0, 1.0))


def test_a_rectangle_covers_its_area_of_the_upper_side():
    """Points of the facets' rule decide: exact where edges of facets are its edges, else to a few per cent."""
    scenario = parse_scenario({"limb": {"shape": "slab", "length": 0.04, "width": 0.03, "depth": 0.01, "layers": []},
                               "mesh": {"size_contact": 4e-3, "size_grid": 4e-3, "size_far": 4e-3},
                               "device": {"contacts": [[0.0, 0.0]], "cone": {"contact": "pressure"}},
                               "grid": {"points": [[0.01, 0.0]]}})  # fmt: skip
    space = fem_model(scenario, build_mesh(scenario)).space
    skin = space.mesh.facets["skin"]
    under = space.mesh.facets["end"]
    assert covered_area(space, skin, under_rectangle(1.0, 1.0)) == pytest.approx(covered_area(space, skin), rel=1e-12)
    assert covered_area(space, skin, under_rectangle(0.02, 0.017)) == pytest.approx(0.02 * 0.017, rel=0.05)
    assert covered_area(space, under, under_rectangle(1.0, 1.0)) == 0.0  # sides are upright, the bottom looks down
    everywhere = under_rectangle(1.0, 1.0)
    for matrix in (facet_mass, facet_membrane):
        assert abs(matrix(space, skin, everywhere) - matrix(space, skin)).max() == 0.0


def test_a_patch_on_all_of_the_skin_is_the_membrane():
    """The same tape by either key, and half of it between it and none."""
    block = held_block(2)
    skin = block.space.mesh.points[block.space.mesh.facets["skin"]].reshape(-1, 3)
    whole = {"length": 2.1 * np.abs(skin[:, 0]).max(), "width": 2.1 * np.abs(skin[:, 1]).max()}
    sheet = {"mass": 0.3, "stiffness": 40.0, "viscosity": 1e-3}

    def answer(membrane: Membrane, patch: Patch) -> complex:
        model = build_model(block.space.mesh, block.ports, {"block": flesh()}, FreeUnderside(ends="fixed"), membrane,
                            patch=patch)  # fmt: skip
        return complex(direct_sweep(model, np.array([40.0]), DIRECT).values[0, 0, 0])

    bare, covered = answer(Membrane(), Patch()), answer(Membrane(**sheet), Patch())
    assert answer(Membrane(), Patch(**whole, **sheet)) == pytest.approx(covered, rel=1e-12)
    half = answer(Membrane(), Patch(length=whole["length"], width=whole["width"] / 2, **sheet))
    assert abs(bare) > abs(half) > abs(covered)
    assert abs(bare - covered) > 0.05 * abs(bare)


def test_a_patch_beside_the_limb_or_in_tables_is_refused():
    block = held_block(2)  # its skin does not reach the origin's neighbourhood
    with pytest.raises(GeometryError, match=r"tissues\.patch"):
        build_model(block.space.mesh, block.ports, {"block": flesh()}, FreeUnderside(), Membrane(),
                    patch=Patch(length=1e-6, width=1e-6, mass=0.2))  # fmt: skip
    scenario = parse_scenario({"engine": "layered", "tissues": {"patch": {"mass": 0.2}}})
    with pytest.raises(ScenarioError, match=r"tissues\.patch: tables and fits of the layered model have no tape"):
        kept_tables(scenario, 0.1)
