"""Tetrahedra with bent edges: matrices against scikit-fem's isoparametric ones, patch tests, an oscillating sphere."""

from __future__ import annotations

from dataclasses import fields, replace

import alternatives as slow
import numpy as np
import pytest
import skfem

from forearm_fem.fem.assembly import boundary
from forearm_fem.fem.assembly import tissues as assembly
from forearm_fem.fem.assembly.tissues import TissueMatrices, constrained_matrices, reference_tensors, tissue_matrices
from forearm_fem.fem.space.numbering import mixed_space
from forearm_fem.fem.space.orders import graded_orders, uniform_orders
from forearm_fem.geometry.mesh.tissue_mesh import EDGES, Bends, keys, true_volumes
from forearm_fem.verification.closed import sphere_errors
from forearm_fem.verification.scenes import block_mesh

ROUNDING = 1e-12  # of sums of some thousand terms


def bent_block(share=0.15):
    """Two tissues; a ``share`` of all edges is bent by up to 4 % of its length."""
    mesh = block_mesh((4, 2, 2), (0.02, 0.013, 0.007), facets={"end": ("x0", "y1")}, regions=("a", "b"), bend=0.1)
    edges = np.sort(mesh.tetrahedra[:, EDGES].reshape(-1, 2), axis=1)
    edges = edges[np.unique(keys(edges, len(mesh.points)), return_index=True)[1]]
    random = np.random.default_rng(5)
    edges = edges[random.random(len(edges)) < share]
    length = np.linalg.norm(mesh.points[edges[:, 0]] - mesh.points[edges[:, 1]], axis=1)
    offsets = 0.04 * length[:, None] * random.uniform(-1, 1, (len(edges), 3)) / np.sqrt(3)
    return replace(mesh, bends=Bends(edges, offsets))


def same(fast, oracle, tolerance):
    assert abs(fast - oracle).max() < tolerance * abs(oracle).max()


@pytest.mark.parametrize("region", [0, 1])
@pytest.mark.parametrize(("element", "tolerance"), [("P2", 4e-4), ("P3", 4e-6)])
def test_matrices_equal_skfems_isoparametric_ones(element, tolerance, region):
    """scikit-fem's rule is of degree 9, ours of 6 for P2: integrands are rational, so rules differ a little."""
    space = mixed_space(bent_block(), element)
    fast = tissue_matrices(space, region, reference_tensors(space), fibres=True)
    vector, _ = slow.bases(space, region)
    assert np.array_equal(vector.element_dofs[::3].T, 3 * space.nodes[space.mesh.region == region])
    same(fast.shear, slow.shear.assemble(vector), tolerance)
    same(fast.fibres, slow.fibres.assemble(vector), tolerance)
    same(fast.mass, slow.mass.assemble(vector), tolerance)


@pytest.mark.parametrize("element", ["P2", "P3"])
def test_compiled_kernels_equal_numpy_alone(element, monkeypatch):
    space = mixed_space(bent_block(), element)
    assert 0 < space.is_bent.sum() < len(space.is_bent)
    fast = tissue_matrices(space, 0, reference_tensors(space), fibres=True)
    monkeypatch.setattr(assembly, "compiled", lambda name: None)
    plain = tissue_matrices(space, 0, reference_tensors(space), fibres=True)
    for name in (f.name for f in fields(TissueMatrices)):
        same(getattr(fast, name), getattr(plain, name), ROUNDING)


@pytest.mark.parametrize("element", ["P2", "P2/P3", "P3"])
def test_linear_fields_have_their_energy_and_rigid_ones_none(element):
    """The patch test: places are themselves quadratic in the element, so fields linear in space are met exactly."""
    mesh = bent_block()
    half = np.arange(len(mesh.tetrahedra)) % 2 == 0
    orders = graded_orders(mesh, half) if element == "P2/P3" else uniform_orders(mesh, element)
    places = _kept_places(orders)
    slope = np.array([[0.1, 0.3, -0.2], [0.5, 0.2, 0.7], [-0.4, 0.1, 0.6]])
    strain = (slope + slope.T) / 2
    shearing = strain - np.trace(strain) / 3 * np.eye(3)
    field, spin = (places @ each.T for each in (slope, slope - slope.T))
    identity = assembly.csr_array(assembly.eye_array(3 * len(places), format="csr"))
    for region, volume in enumerate(np.bincount(mesh.region, true_volumes(mesh))):
        parts = constrained_matrices(orders, region, identity, fibres=True)
        energy = field.ravel() @ (parts.shear @ field.ravel())
        assert energy == pytest.approx(2 * (shearing**2).sum() * volume, rel=ROUNDING)
        along = field.ravel() @ (parts.fibres @ field.ravel())
        assert along == pytest.approx(4 * (strain[0, 1] ** 2 + strain[0, 2] ** 2) * volume, rel=ROUNDING)
        for stiffness in (parts.shear, parts.fibres):
            assert abs(stiffness @ spin.ravel()).max() < ROUNDING * abs(stiffness @ field.ravel()).max()
        assert (parts.divergence @ field.ravel()).sum() == pytest.approx(np.trace(slope) * volume, rel=ROUNDING)
        assert parts.pressure_mass.sum() == pytest.approx(volume, rel=ROUNDING)
        assert parts.mass.sum() == pytest.approx(3 * volume, rel=ROUNDING)


def _kept_places(orders):
    """Where the unknowns of kept nodes are: a quadratic edge has its middle in place of its first third."""
    places = np.zeros((orders.spread.shape[1], 3))
    numbers = orders.kept[orders.high.nodes]
    places[numbers[numbers >= 0]] = orders.high.node_points[orders.high.nodes[numbers >= 0]]
    middles = mixed_space(orders.high.mesh, "P2")
    tet, edge = np.nonzero(numbers[:, 5:16:2] < 0)
    if orders.high is not orders.low:
        places[numbers[tet, 4 + 2 * edge]] = middles.node_points[middles.nodes[tet, 4 + edge]]
    return places


@pytest.mark.parametrize("element", ["P2", "P3"])
@pytest.mark.parametrize(
    ("fast", "form"),
    [(boundary.facet_mass, slow.mass), (boundary.facet_gradients, slow.surface_gradients),
     (boundary.facet_membrane, slow.membrane)],
)  # fmt: skip
def test_facet_matrices_equal_skfems_isoparametric_ones(element, fast, form):
    space = mixed_space(bent_block(), element)
    facets = space.mesh.facets["end"]
    # rules of degree 6 or 8 beside 9: the measure of a bent facet is no polynomial
    same(fast(space, facets), form.assemble(slow.facet_basis(space, facets)), 2e-4)


def test_first_order_elements_stay_straight():
    mesh = bent_block()
    straight, bent = (mixed_space(m, "P1") for m in (replace(mesh, bends=Bends()), mesh))
    parts = [tissue_matrices(s, 0, reference_tensors(s)).shear for s in (straight, bent)]
    assert abs(parts[0] - parts[1]).max() == 0


def test_an_oscillating_sphere_needs_few_bent_facets():
    """Oestreicher's impedance; third order, arcs of 30 degrees. The wall at 12 radii leaves 0.001 of it."""
    (flat,), (bent,) = (sphere_errors((3,), 300.0, curved=curved, element="P3") for curved in (False, True))
    assert flat > 0.01
    assert bent < 0.002


def test_oracles_use_a_curved_mesh():
    assert isinstance(slow.skfem_mesh(mixed_space(bent_block(), "P2")), skfem.MeshTet2)
