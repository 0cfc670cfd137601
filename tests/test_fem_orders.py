"""Third order in some tetrahedra, second in the others: continuity, exactness, limits and stability."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csr_array, eye_array
from slabs import Slab

from forearm_fem.fem.assembly.boundary import edge_middles
from forearm_fem.fem.assembly.tissues import constrained_matrices, reference_tensors, tissue_matrices
from forearm_fem.fem.space.numbering import tabulate
from forearm_fem.fem.space.orders import Orders, graded_orders, uniform_orders
from forearm_fem.geometry.device.place import facet_area
from forearm_fem.geometry.device.sizing import (
    DEPTH,
    REACH,
    element_sizes,
    tetrahedron_orders,
    tissue_depths,
    usual_edge,
)
from forearm_fem.geometry.mesh.refinement import refine
from forearm_fem.geometry.mesh.tissue_mesh import TissueMesh, skin_edges, with_finer_skin
from forearm_fem.ports import Port
from forearm_fem.scenario import Scenario, parse_scenario
from forearm_fem.verification.scenes import block_mesh, layered_truth, slab_model, slab_response

FACES = ("x0", "x1", "y0", "y1", "z0", "z1")


def bent(n: int = 3) -> TissueMesh:
    return block_mesh((n, n, n), (1.0, 1.0, 1.0), facets={"walls": FACES}, bend=0.1)


def some(mesh: TissueMesh, share: float, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).random(len(mesh.region)) < share


def free(orders: Orders) -> csr_array:
    return csr_array(eye_array(3 * orders.spread.shape[1], format="csr"))


@given(share=st.floats(0, 0.3), seed=st.integers(0, 99))
@settings(max_examples=20, deadline=None)
def test_quadratic_fields_are_kept_whatever_is_raised(share: float, seed: int) -> None:
    orders = graded_orders(bent(), some(bent(), share, seed))
    exact = quadratic(orders.high.node_points)
    kept = np.linalg.lstsq(orders.spread.toarray(), exact, rcond=None)[0]
    assert np.abs(orders.spread @ kept - exact).max() < 1e-12  # rounding


def quadratic(x: np.ndarray) -> np.ndarray:
    return 1 + x @ [1.0, -2, 3] + x[:, 0] * x[:, 1] - 2 * x[:, 2] ** 2 + x[:, 1] * x[:, 2]


def test_displacements_are_continuous_across_faces() -> None:
    """The field of random unknowns, evaluated from both sides of every inner face."""
    mesh = bent()
    orders = graded_orders(mesh, some(mesh, 0.05))
    assert 0 < orders.raised.sum() < len(mesh.region), "both kinds must be there"
    kept = np.random.default_rng(1).normal(size=orders.spread.shape[1])
    whole, inside = orders.spread @ kept, np.array([0.2, 0.3, 0.5])
    seen: dict[tuple[int, ...], list[float]] = {}
    for t, corners in enumerate(orders.high.vertices):
        for left in range(4):
            face = np.delete(np.arange(4), left)
            bary = np.zeros(4)
            bary[face] = inside
            space, values = (orders.high, whole) if orders.raised[t] else (orders.low, kept)
            basis, _ = tabulate(space.pair.displacement, bary[1:, None])
            seen.setdefault(tuple(corners[face]), []).append(float(basis[:, 0] @ values[space.nodes[t]]))
    pairs = np.array([v for v in seen.values() if len(v) == 2])
    assert len(pairs) > 50
    assert np.abs(pairs[:, 0] - pairs[:, 1]).max() < 1e-12  # rounding


@pytest.mark.parametrize(("share", "element"), [(0.0, "P2"), (1.0, "P3")])
def test_all_or_none_raised_are_the_uniform_pairs(share: float, element: str) -> None:
    mesh = bent()
    graded, plain = graded_orders(mesh, np.full(len(mesh.region), share > 0)), uniform_orders(mesh, element)
    ours, theirs = (constrained_matrices(o, 0, free(o)) for o in (graded, plain))
    for name in ("shear", "mass", "divergence", "pressure_mass"):
        a, b = getattr(ours, name), getattr(theirs, name)
        assert a.shape == b.shape
        stored = max(a.nnz, b.nnz)  # scipy drops zeros in sums
        mine, other = (np.sort(np.pad(m.data, (0, stored - m.nnz))) for m in (a, b))
        assert np.allclose(mine, other, rtol=0, atol=1e-12 * np.abs(other).max())


def test_matrices_are_those_of_the_cubic_space_seen_through_the_spread() -> None:
    """The slow way: everything integrated as P3, then projected."""
    mesh = bent()
    orders = graded_orders(mesh, some(mesh, 0.05))
    fast = constrained_matrices(orders, 0, free(orders))
    slow = tissue_matrices(orders.high, 0, reference_tensors(orders.high))
    u, p = orders.carried(free(orders)), orders.spread_pressures
    for a, b in (
        (fast.shear, u.T @ slow.shear @ u),
        (fast.mass, u.T @ slow.mass @ u),
        (fast.divergence, p.T @ slow.divergence @ u),
        (fast.pressure_mass, p.T @ slow.pressure_mass @ p),
    ):
        assert abs(a - b).max() < 1e-13 * abs(b).max()


def test_pressures_stay_stable_where_orders_meet() -> None:
    """The inf-sup constant of random mixtures is at least a third of the uniform pair's: no spurious pressure."""
    mesh = bent(3)
    plain = inf_sup(uniform_orders(mesh, "P2"))
    mixed = [inf_sup(graded_orders(mesh, some(mesh, share, seed))) for share, seed in ((0.02, 1), (0.1, 2), (0.4, 3))]
    assert min(mixed) > plain / 3


def inf_sup(orders: Orders) -> float:
    """Smallest positive beta with B A^-1 B^T p = beta^2 M p, displacements held on the block's surface."""
    held = orders.kept_on(orders.high.mesh.facets["walls"])
    inner = np.setdiff1d(np.arange(orders.spread.shape[1]), held)
    pick = csr_array(free(orders)[:, (3 * inner[:, None] + np.arange(3)).ravel()])
    m = constrained_matrices(orders, 0, pick)
    b = m.divergence.toarray()
    schur = b @ np.linalg.solve((m.shear + m.mass).toarray(), b.T)
    inverse = np.linalg.inv(np.linalg.cholesky(m.pressure_mass.toarray()))
    values = np.linalg.eigvalsh(inverse @ schur @ inverse.T)
    return float(np.sqrt(max(values[1], 0.0)))  # the first is that of a constant pressure


def test_fields_are_known_in_the_middles_of_the_skins_edges() -> None:
    """Cubic fields exactly where elements are cubic, and the skin cut in four has its own area."""
    mesh = bent()
    space = uniform_orders(mesh, "P3").high
    edges, finer = skin_edges(mesh), with_finer_skin(mesh)
    middles = finer.points[len(mesh.points) :]
    found = edge_middles(space, edges) @ (quadratic(space.node_points) + space.node_points[:, 0] ** 3)
    assert np.abs(found - quadratic(middles) - middles[:, 0] ** 3).max() < 1e-12  # rounding
    assert len(finer.facets["skin"]) == 4 * len(mesh.facets["skin"])
    assert facet_area(finer.points, finer.facets["skin"]) == pytest.approx(facet_area(mesh.points, mesh.facets["skin"]))


def test_third_order_is_around_the_ports_only() -> None:
    mesh = block_mesh((8, 8, 4), (0.16, 0.16, 0.08), facets={})
    contact = Port("A1", "contact", (0.05, 0.08, 0.08), radius=5e-3)
    point = Port("1", "point", (0.09, 0.08, 0.08))
    found = tetrahedron_orders(mesh, (contact, point), "P2/P3")
    centre = mesh.points[mesh.tetrahedra].mean(axis=1)
    between = np.abs(centre[:, 0] - 0.07) < 0.02
    near = between & (np.abs(centre[:, 1] - 0.08) < 0.02) & (centre[:, 2] > 0.08 - DEPTH)
    beside = np.abs(centre - [0.07, 0.08, 0.08]).max(axis=1) > 0.02 + 5e-3 + REACH
    assert near.any()
    assert beside.any()
    assert (found[near] == 3).all()
    assert (found[beside] == 2).all()
    assert (found[centre[:, 2] < 0.08 - DEPTH] == 2).all()
    assert (tetrahedron_orders(mesh, (contact,), "P3") == 3).all()


def layered_block(contact: str) -> tuple[TissueMesh, tuple[Port, ...]]:
    """Three tissues of 4 mm each with elements of 4 mm, halved and quartered beneath one of two contacts at the top."""
    mesh = block_mesh((12, 12, 3), (0.048, 0.048, 0.012), facets={})
    height = mesh.points[mesh.tetrahedra].mean(axis=1)[:, 2]
    region = (2 - np.floor(height / 0.004)).astype(np.int64)
    top = np.flatnonzero(mesh.points[:, 2] > 0.012 - 1e-9)
    faces = mesh.tetrahedra[:, [[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]]].reshape(-1, 3)
    skin = faces[np.isin(faces, top).all(axis=1)]
    layered = replace(mesh, region=region, region_names=("skin", "fat", "muscle"), facets={"skin": skin})
    ports = tuple(
        Port(f"A{i}", "contact", (x, 0.024, 0.012), radius=2e-3, contact=contact) for i, x in enumerate((0.006, 0.042))
    )
    for _ in range(6):  # bisections
        centre = layered.points[layered.tetrahedra].mean(axis=1)
        layered = refine(layered, np.linalg.norm((centre - ports[0].position)[:, :2], axis=1) < 0.003)
    return layered, ports


def test_second_order_is_enough_where_rigid_contacts_made_deep_elements_small() -> None:
    mesh, ports = layered_block("bonded")
    assert list(tissue_depths(mesh)) == [0, 1, 2]
    edges = mesh.points[mesh.tetrahedra]
    longest = np.linalg.norm(edges[:, :, None] - edges[:, None], axis=3).max(axis=(1, 2))
    usual, order = usual_edge(mesh, ports), tetrahedron_orders(mesh, ports, "P2/P3")
    assert 0.0039 < usual < 0.0057  # the block's edges and their diagonals
    assert (order[mesh.region == 0] == 3).all()
    for tissue, share in ((1, 0.5), (2, 0.7)):
        here = mesh.region == tissue
        assert np.array_equal(order[here] == 2, longest[here] < share * usual)
        assert len(set(order[here])) == 2
    assert (tetrahedron_orders(mesh, layered_block("pressure")[1], "P2/P3") == 3).all()


def test_limbs_have_third_order_around_the_ports_unless_told_otherwise() -> None:
    assert Scenario().element == "P2/P3"
    assert parse_scenario({"limb": {"shape": "slab"}}).element == "P2/P3"
    assert parse_scenario({"limb": {"shape": "slab"}, "accuracy": 0.1}).element == "P2/P3"  # rims of rigid cones
    pressure = {"cone": {"contact": "pressure"}}
    assert parse_scenario({"limb": {"shape": "slab"}, "accuracy": 0.1, "device": pressure}).element == "P2"
    assert parse_scenario({"limb": {"shape": "slab"}, "mesh": {"size_grid": 2e-3}}).element == "P2"
    assert parse_scenario({"mesh": {"element": "P2"}}).element == "P2"
    assert element_sizes(Scenario()).grid > 2 * element_sizes(parse_scenario({"mesh": {"element": "P2"}})).grid


@pytest.mark.slow
def test_a_slab_with_both_orders_agrees_with_the_layered_model() -> None:
    """300 Hz, elements of 3.6 mm (two a wave) between the ports: 0.0078 off, second order alone 0.19."""
    errors = {}
    for element in ("P2", "P2/P3"):
        slab = Slab("default", 300.0, 0.08, 0.03, 3.6e-3, 8e-3, element=element)
        truth = layered_truth(slab.scenario, [300.0])[0, 1:]
        found = slab_response(slab_model(slab.scenario), [300.0])[0, 1:]
        errors[element] = float(np.abs(found - truth).max() / np.abs(truth).max())
    assert errors["P2/P3"] < 0.012
    assert errors["P2/P3"] < errors["P2"] / 10
