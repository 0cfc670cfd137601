"""Matrices against scikit-fem's own forms, element by element exact; the cubic element's properties."""

from __future__ import annotations

from itertools import combinations

import alternatives as slow
import numpy as np
import pytest
import skfem
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csr_array, random_array
from skfem.refdom import RefTet

from forearm_fem.fem.assembly import boundary
from forearm_fem.fem.assembly import tissues as assembly
from forearm_fem.fem.assembly.tissues import reference_tensors, tissue_matrices
from forearm_fem.fem.kernels.matrices import added, congruent, projected
from forearm_fem.fem.space.constraints import tangents
from forearm_fem.fem.space.numbering import CUBIC_EDGES, CUBIC_FACES, ElementTetP3, mixed_space, tabulate
from forearm_fem.verification.scenes import block_mesh

SAME = 1e-13  # both sum the same numbers in double precision, in another order
ELEMENTS = ("P1", "P2", "P3")


def bent_block(element):
    """Two tissues, tetrahedra of all shapes, a curved inside; numbers mixed up to exercise the orientation."""
    mesh = block_mesh((4, 2, 2), (0.02, 0.013, 0.007), facets={"end": ("x0", "y1")}, regions=("a", "b"), bend=0.1)
    return mixed_space(mesh, element)


def distance(fast, reference):
    """Largest entry of the difference over the largest entry."""
    return abs(fast - reference).max() / abs(reference).max()


@pytest.mark.parametrize("element", ELEMENTS)
def test_reference_mass_is_exact(element):
    """Against integrals in exact arithmetic: scikit-fem's rules are one degree short of their name from 5 on."""
    space = bent_block(element)
    reference = reference_tensors(space)
    for mass, basis in (
        (reference.mass, space.pair.displacement), (reference.pressure_mass, space.pair.pressure)
    ):  # fmt: skip
        points, weights = collapsed_gauss(6)
        values, _ = tabulate(basis, points)
        assert distance(mass, np.einsum("aq,bq,q->ab", values, values, weights)) < SAME


def collapsed_gauss(n):
    """Conical product of Gauss-Legendre rules on the reference tetrahedron, exact to degree 2 n - 3."""
    x, w = np.polynomial.legendre.leggauss(n)
    x, w = (x + 1) / 2, w / 2
    a, b, c = np.meshgrid(x, x, x, indexing="ij")
    weights = np.einsum("i,j,k->ijk", w * (1 - x) ** 2, w * (1 - x), w)
    points = np.array([a, (1 - a) * b, (1 - a) * (1 - b) * c])
    return points.reshape(3, -1), weights.ravel()


@pytest.mark.parametrize("element", ELEMENTS)
@pytest.mark.parametrize("region", [0, 1])
def test_matrices_equal_skfem(element, region):
    space = bent_block(element)
    fast = tissue_matrices(space, region, reference_tensors(space), fibres=True)
    vector, _ = slow.bases(space, region)
    assert distance(fast.shear, slow.shear.assemble(vector)) < SAME
    assert distance(fast.fibres, slow.fibres.assemble(vector)) < SAME
    assert distance(fast.mass, slow.mass.assemble(vector)) < SAME


@pytest.mark.parametrize("element", ELEMENTS)
@pytest.mark.parametrize("region", [0, 1])
def test_compiled_kernels_equal_sorting(element, region, monkeypatch):
    """Values in canonical order, and of what scipy does not add up (it drops zeros then) the very same pattern."""
    space = bent_block(element)
    fast = tissue_matrices(space, region, reference_tensors(space), fibres=True)
    monkeypatch.setattr(assembly, "compiled", lambda _: None)
    monkeypatch.setattr(assembly, "_FIBRES_AT_ONCE", 7)
    obvious = tissue_matrices(space, region, reference_tensors(space), fibres=True)
    for name in ("shear", "fibres", "mass", "divergence", "pressure_mass"):
        mine, other = getattr(fast, name), getattr(obvious, name)
        assert mine.has_canonical_format
        assert distance(mine, other) < SAME
        if name != "divergence":
            np.testing.assert_array_equal(mine.indptr, other.indptr)
            np.testing.assert_array_equal(mine.indices, other.indices)


shapes = given(n=st.integers(1, 30), m=st.integers(1, 30), density=st.floats(0, 0.4), seed=st.integers(0, 99))


def sparse(shape, density, random):
    return csr_array(random_array(shape, density=density, rng=random))


@shapes
@settings(max_examples=60, deadline=None)
def test_products_equal_scipy(n, m, density, seed):
    """Several unknowns in a row, empty rows and columns included; columns ascend."""
    random = np.random.default_rng(seed)
    part, left, right = (
        sparse((n, n), density, random),
        sparse((n, 7), density, random),
        sparse((n, m), density, random),
    )
    symmetric = csr_array(part + part.T)
    for fast, obvious in (
        (congruent(symmetric, right), right.T @ symmetric @ right),
        (projected(left, part, right), left.T @ part @ right),
    ):
        assert fast.has_canonical_format
        np.testing.assert_allclose(fast.toarray(), obvious.toarray(), rtol=0, atol=SAME * max(1.0, abs(obvious).max()))


@shapes
@settings(max_examples=60, deadline=None)
def test_sums_equal_scipy(n, m, density, seed):
    random = np.random.default_rng(seed)
    parts = [sparse((n, m), density, random) for _ in range(3)]
    parts.append(-parts[0])
    for part in parts:
        part.sort_indices()
    total = added(parts)
    assert total.has_canonical_format
    assert abs(total - (parts[1] + parts[2])).max() < SAME  # values up to one


@pytest.mark.parametrize("element", ELEMENTS)
def test_pressure_matrices_equal_skfem_within_a_tissue(element):
    """One tissue, so that scikit-fem's pressure numbering is continuous like ours."""
    mesh = block_mesh((3, 2, 2), (0.02, 0.013, 0.007), facets={}, bend=0.1)
    space = mixed_space(mesh, element)
    fast = tissue_matrices(space, 0, reference_tensors(space))
    vector, scalar = slow.bases(space, 0)
    order = np.empty(space.n_pressures, dtype=int)
    order[space.pressures.ravel()] = scalar.element_dofs.T.ravel()
    assert distance(fast.pressure_mass, slow.pressure_mass.assemble(scalar)[order][:, order]) < SAME
    assert distance(fast.divergence, slow.divergence.assemble(vector, scalar)[order]) < SAME


@pytest.mark.parametrize("element", ELEMENTS)
def test_divergence_of_each_tissue_equals_skfem(element):
    """Pressures are torn between tissues: compare what they do on smooth fields, tissue by tissue."""
    space = bent_block(element)
    vector, scalar = slow.bases(space, 1)
    fast = tissue_matrices(space, 1, reference_tensors(space)).divergence
    theirs = slow.divergence.assemble(vector, scalar)
    mine = space.mesh.region == 1
    assert distance(fast[space.pressures[mine].ravel()], theirs[scalar.element_dofs[:, :].T.ravel()]) < SAME


@pytest.mark.parametrize("element", ELEMENTS)
def test_facet_matrices_equal_skfem(element):
    space = bent_block(element)
    facets = space.mesh.facets["end"]
    basis = slow.facet_basis(space, facets)
    for fast, form in (
        (boundary.facet_mass, slow.mass),
        (boundary.facet_gradients, slow.surface_gradients),
        (boundary.facet_membrane, slow.membrane),
    ):
        assert distance(fast(space, facets), form.assemble(basis)) < SAME, fast.__name__


@pytest.mark.parametrize("element", ELEMENTS)
def test_facet_load_equals_skfem(element):
    space = bent_block(element)
    facets, d = space.mesh.facets["end"], np.array([0.3, -0.5, 0.8])
    load = skfem.LinearForm(lambda v, w: sum(d[i] * v[i] for i in range(3)))
    expected = load.assemble(slow.facet_basis(space, facets))
    assert distance(boundary.facet_load(space, facets, d), expected) < SAME


def test_shear_matrix_does_not_resist_rigid_motion_or_growth():
    """Deviatoric: translations, rotations and uniform growth cost nothing."""
    space = bent_block("P2")
    stiffness = sum(tissue_matrices(space, r, reference_tensors(space)).shear for r in (0, 1))
    x = space.node_points
    turn = np.cross(x, [1.0, 2.0, -0.5])
    for field in (np.ones_like(x), turn, x):
        assert abs(stiffness @ field.ravel()).max() < 1e-13 * abs(stiffness).max() * abs(field).max() * 30


@pytest.mark.parametrize("element", ELEMENTS)
def test_nodes_carry_the_field(element):
    """Coefficients read off at ``node_points`` reproduce a polynomial of the element's degree."""
    space = bent_block(element)
    degree = {"P1": 1, "P2": 2, "P3": 3}[element]
    coefficients = polynomial(space.node_points.T * 100, degree)
    coefficients[space.nodes[:, 4]] *= element != "P1"  # the bubble's coefficient is not a value
    where = np.array([[0.1], [0.3], [0.25]])
    values, _ = tabulate(space.pair.displacement, where)
    corner = space.mesh.points[space.vertices[:, 0]]
    places = corner + np.einsum("eik,kq->ei", space.jacobians, where)
    found = coefficients[space.nodes] @ values[:, 0]
    assert found == pytest.approx(polynomial(places.T * 100, degree), rel=1e-12, abs=1e-12)


def polynomial(x, degree):
    return 0.3 + x[0] - 0.7 * x[1] + (x[2] * x[0] - x[1] ** 2) * (degree > 1) + x[0] * x[1] * x[2] * (degree > 2)


# --- third-order tetrahedron -----------------------------------------------------------------------------------------


def lattice():
    """Reference places of the 20 nodes in the element's order."""
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    edges = [(corners[a], corners[b]) for a, b in RefTet.edges]
    on_edges = [p + (q - p) * t for p, q in edges for t in (1 / 3, 2 / 3)]
    return np.array([*corners, *on_edges, *(corners[list(f)].mean(axis=0) for f in RefTet.facets)])


def test_cubic_orders_of_edges_and_facets_are_skfems():
    assert tuple(tuple(e) for e in RefTet.edges) == CUBIC_EDGES
    assert set(combinations(range(4), 3)) == set(CUBIC_FACES)


def test_cubic_lagrange_property():
    values, _ = tabulate(ElementTetP3(), lattice().T)
    assert values == pytest.approx(np.eye(20), abs=1e-14)


def test_cubic_partition_of_unity_and_gradients():
    points = np.random.default_rng(1).dirichlet(np.ones(4), 30)[:, 1:].T
    values, slopes = tabulate(ElementTetP3(), points)
    assert values.sum(axis=0) == pytest.approx(np.ones(30), abs=1e-14)
    assert slopes.sum(axis=0) == pytest.approx(np.zeros((3, 30)), abs=1e-13)
    step = 1e-6
    for d in range(3):
        shift = step * np.eye(3)[d][:, None]
        ahead, behind = (tabulate(ElementTetP3(), points + s * shift)[0] for s in (1, -1))
        assert (ahead - behind) / (2 * step) == pytest.approx(slopes[:, d], abs=1e-8)  # rounding / step


def cubic_interpolant(function):
    """(basis, coefficients) of scikit-fem's projection on a bent mesh with shuffled vertices."""
    space = mixed_space(block_mesh((2, 2, 2), (1.0, 1.0, 1.0), facets={}, bend=0.1), "P3")
    basis = skfem.Basis(slow.skfem_mesh(space), ElementTetP3(), intorder=7)
    return basis, basis.project(function)


def test_cubics_are_reproduced():
    """Projection onto the space returns any cubic polynomial to rounding."""
    basis, c = cubic_interpolant(lambda x: polynomial(x, 3))
    error = skfem.Functional(lambda w: (w["u"] - polynomial(w.x, 3)) ** 2).assemble(basis, u=basis.interpolate(c))
    assert np.sqrt(error) < 1e-12


def test_cubic_functions_are_continuous_across_facets():
    """Random coefficients: traces from both sides of every inner facet agree."""
    space = mixed_space(block_mesh((2, 2, 2), (1.0, 1.0, 1.0), facets={}, bend=0.1), "P3")
    mesh = slow.skfem_mesh(space)
    c = np.random.default_rng(2).normal(size=space.n_nodes)
    sides = [skfem.InteriorFacetBasis(mesh, ElementTetP3(), side=s, intorder=7) for s in (0, 1)]
    a, b = (np.asarray(side.interpolate(c)) for side in sides)
    assert np.abs(a - b).max() < 1e-12


def test_vector_numbering_is_three_per_node():
    for element in ELEMENTS:
        space = bent_block(element)
        vector = skfem.Dofs(slow.skfem_mesh(space), skfem.ElementVector(space.pair.displacement))
        ours = (3 * space.nodes[:, :, None] + np.arange(3)).reshape(len(space.nodes), -1)
        assert np.array_equal(np.asarray(vector.element_dofs).T, ours)


def test_bubble_and_facet_nodes():
    """Nodes on a face: 6 for P2, 10 for P3, 3 for MINI whose bubble vanishes there."""
    for element, count in (("P1", 3), ("P2", 6), ("P3", 10)):
        space = bent_block(element)
        assert len(space.facet_nodes(space.mesh.facets["end"][:1])) == count


@pytest.mark.parametrize("axis", [(0, 0, 1), (0.6, 0, 0.8), (0.48, 0.6, 0.64)])
def test_tangents_complete_a_frame(axis):
    frame = np.array([*tangents(np.array(axis, dtype=float)), axis])
    assert frame @ frame.T == pytest.approx(np.eye(3), abs=1e-15)
