"""The arm's library: flat skin, bells, what lies between them, tables of the layered model, answers against direct
solves."""

import json
from dataclasses import replace

import numpy as np
import pytest
from cli_runner import cli
from scipy.sparse.linalg import lsqr
from scipy.special import j1, spherical_jn

from forearm_fem.accuracy.estimates import moved_by_stretch
from forearm_fem.device import close_loop
from forearm_fem.engines.fem import fem_model
from forearm_fem.engines.layered import flat_layers
from forearm_fem.engines.library import (
    ArmLibrary,
    arm,
    is_library,
    load_library,
    make,
    make_library,
    save_library,
    side,
)
from forearm_fem.engines.library.arm import _Asked, _Part, library_skin
from forearm_fem.engines.library.between import Lattice, Prior, Shape, shape_of
from forearm_fem.engines.library.make import loaded_skin, meshed_scenario
from forearm_fem.engines.library.side import constrained_compliance, deviation_held, modal_compliance
from forearm_fem.engines.library.skin import (
    FlatSkin,
    GaussianLoads,
    bell_functionals,
    between_flat_bells,
    flat_compliance,
    flat_skin,
    pair_distances,
)
from forearm_fem.engines.simulation import render_transfer, simulate
from forearm_fem.errors import AccuracyWarning, DataError, ForearmError, GeometryError, ScenarioError
from forearm_fem.fem.linear.direct import make_solver
from forearm_fem.geometry.build import cached_mesh
from forearm_fem.geometry.device.place import parametric_skin
from forearm_fem.layered import Layer, Surface, surface_kernel
from forearm_fem.layered.discs import Disc
from forearm_fem.layered.integrals import Medium
from forearm_fem.layered.tables import tabulate
from forearm_fem.ports import Port, positions
from forearm_fem.scenario import Scenario, load_scenario, parse_scenario
from forearm_fem.store.shelf import WORK, Shelf

SLAB = {
    "accuracy": 0.3,
    "limb": {"shape": "slab", "length": 0.06, "width": 0.05, "depth": 0.02},
    "mesh": {"element": "P2"},  # a quarter of the unknowns of P2/P3, which slow tests solve
    "device": {"contacts": [[-0.006, 0.0], [0.005, 0.002]], "drive": "force", "cone": {"radius": 0.002}},
    "grid": {"points": [[0.0, 0.0], [0.001, -0.005]]},
    "library": {"length": 0.022, "width": 0.016, "step": 0.005},
    "sweep": {"f_min": 60, "f_max": 100, "duration": 0.1, "sample_rate": 1000},
    "solver": {"discretisation_estimate": False},
    "rendering": {"methods": []},
}


def medium(scenario):
    return Medium(tuple(flat_layers(scenario)), "halfspace", Surface())


@pytest.fixture(scope="module")
def slab():
    return parse_scenario(SLAB)


@pytest.fixture(scope="module")
def library(slab):
    return make_library(slab)


def test_a_cylinders_skin_is_laid_flat_by_its_arc():
    radius = 0.03
    scenario = parse_scenario({"limb": {"shape": "cylinder", "diameter": 2 * radius}})
    skin = flat_skin(parametric_skin(scenario), 0.04, 0.05)
    angle = np.array([-0.7, 0.0, 0.3, 0.8])
    points = np.column_stack([[0.0, 0.01, -0.015, 0.02], radius * np.sin(angle), radius * np.cos(angle)])
    flat = skin.flat(points)
    # chords of 0.25 mm, and straight lines between them: 1e-5 of a length
    assert flat == pytest.approx(np.column_stack([points[:, 0], radius * angle]), abs=1e-6)
    assert skin.places(flat)[0] == pytest.approx(points, abs=1e-6)
    assert np.isnan(skin.flat(points * [1, 1, -1])).any(axis=1).all()  # the other side is not on it


def test_a_cones_skin_is_laid_flat_with_its_lengths_and_angles():
    """Chords of 4 mm in all directions; sections laid straight, as on a cylinder, left 5 % of some."""
    rings = [[x, 2 * np.pi * (0.034 - 0.1 * x)] for x in np.linspace(-0.06, 0.06, 7).tolist()]
    limb = {"shape": "forearm", "length": 0.12, "circumference": rings, "bones": []}
    skin = flat_skin(parametric_skin(parse_scenario({"limb": limb})), 0.06, 0.05, margin=0.01)
    rng, length = np.random.default_rng(0), 4e-3
    flat, angle = rng.uniform(-1, 1, (200, 2)) * [0.027, 0.022], rng.uniform(0, 2 * np.pi, 200)
    along = length * np.column_stack([np.cos(angle), np.sin(angle)])
    chord = np.linalg.norm(skin.places(flat + along)[0] - skin.places(flat)[0], axis=1)
    # arcs are longer than chords by (l/R)^2/24, 6e-4; samples 2.5 mm apart along the limb add as much
    assert np.abs(chord / length - 1).max() < 3e-3
    assert skin.flat(skin.places(flat)[0]) == pytest.approx(flat, abs=1e-6)
    u, v = skin.tangents(flat)
    assert np.abs((u * v).sum(axis=1)).max() < 1e-12


def test_bells_between_each_other_are_a_plain_integral_of_the_kernel():
    scenario, width, k = Scenario(), 1.5e-3, np.linspace(1e-3, 5e3, 100_001)
    distance = np.array([0.0, 4e-3, 3e-2])
    found = between_flat_bells(medium(scenario), np.array([120.0]), width, distance)[0, 0]
    from scipy.special import j0

    kernel = surface_kernel(k[None], np.array([[2 * np.pi * 120.0]]), flat_layers(scenario))[0]
    plain = [np.trapezoid(kernel * np.exp(-((k * width) ** 2)) * j0(k * d) * k, k) / (2 * np.pi) for d in distance]
    assert found == pytest.approx(np.array(plain), rel=1e-5)  # of the trapezoidal rule


def test_a_pressed_disc_and_a_rigid_one_have_shapes_of_their_own():
    port = Port("A1", "contact", (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 3e-3, "bonded")
    assert shape_of(port) == Shape("rigid", 3e-3)
    assert shape_of(replace(port, contact="pressure")) == Shape("pressure", 3e-3)


def test_waves_between_the_lattice_are_found_and_their_uncertainty_holds():
    side = np.linspace(-0.02, 0.02, 9)
    centres = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    width, kappa, k = 2e-3, 500.0, 400.0
    lattice = Lattice.of(centres, width, Prior(kappa, 1e-6))
    places = np.array([[0.0026, -0.0074], [0.0111, 0.0012]])

    def wave(at):
        return np.exp(1j * (at @ np.array([0.6, 0.8])) * k)

    a, bell = 3.5e-3, np.exp(-((k * width) ** 2) / 2)
    seen_as = {"rigid": np.sin(k * a) / (k * a), "pressure": 2 * j1(k * a) / (k * a), "point": 1.0}  # closed forms
    for kind, share in seen_as.items():
        weights, (before, known) = lattice.weights(Shape(kind, 0.0 if kind == "point" else a), places)
        off = np.abs(weights.T @ wave(centres) * bell - wave(places) * share)
        assert (off < 0.05).all()  # of 1, with three loads a wave and bells that see it as .73; seen: .025 for points
        assert ((known > 0.9 * before) & (known <= before)).all()


@pytest.mark.parametrize("element", ["P2", pytest.param("P2/P3", marks=pytest.mark.slow)])
def test_bells_read_the_mean_of_what_they_cover(element):
    """A rigid motion along z, whatever the rule and the elements."""
    slab = parse_scenario({**SLAB, "mesh": {"element": element}})
    skin = library_skin(slab)
    meshed = meshed_scenario(slab, skin)
    model = fem_model(meshed, cached_mesh(meshed))
    bells = GaussianLoads(np.array([[0.001, 0.002], [-0.006, 0.003]]), np.array([[0.0, 0, 1], [0, 0, 1]]), 0.002)
    seen = bell_functionals(model, skin, bells)
    up = np.zeros((model.space.n_nodes, 3))
    up[:, 2] = 1.0
    free = model.constraints.transform  # the slab is held nowhere: every displacement is free
    motion = np.zeros(model.operator.n)
    motion[: free.shape[1]] = lsqr(free, up.ravel(), atol=1e-12, btol=1e-12)[0]
    assert seen.T @ motion == pytest.approx(np.ones(2), abs=1e-6)


def test_own_loads_are_answered_as_a_direct_solve_does(slab, library):
    """The reduced space of all loads, at a frequency in the middle, against solves of the same system."""
    skin, bells, meshed = library.skin, loaded_skin(slab).bells, meshed_scenario(slab, library.skin)
    model = fem_model(meshed, cached_mesh(meshed))
    seen = bell_functionals(model, skin, bells).toarray()
    some = [0, 7, 12, 24, 33]
    witness = replace(model, functionals=seen[:, some], shares=np.ones(5))
    truth = seen.T @ replace(make_solver(model, meshed.solver, 90.0), model=witness).at(90.0).values
    found = modal_compliance(library.fine, np.array([90.0]), np.eye(len(bells.centres)))[0]
    assert np.abs(found[:, some] - truth).max() < 0.01 * np.abs(truth).max()
    assert np.abs(found - found.T).max() < 1e-12 * np.abs(found).max()
    assert library.reduction[1].max() < 0.05


def test_the_limb_is_summed_alike_for_one_frequency_and_for_many(library):
    """Together most poles are carried by a Chebyshev rule; one frequency sums them as they were found."""
    limb, some = library.fine, np.random.default_rng(0).normal(size=(library.fine.left.shape[0], 5))
    for low, high in ((60.0, 100.0), (60.0, 400.0), (250.0, 400.0)):
        at = np.linspace(low, high, 60)
        together, left, right = modal_compliance(limb, at, some), some.T @ limb.left, limb.right @ some
        plain = np.array([(left / (2j * np.pi * f - limb.poles)) @ right for f in at])
        # Poles are carried from where the rule leaves 3e-7 of each; ten times that, as they are many.
        np.testing.assert_allclose(together, plain, rtol=0, atol=3e-6 * np.abs(plain).max())
    wanted = np.triu(np.ones((5, 5), dtype=bool), 3)
    found = modal_compliance(limb, at, some, wanted)
    kept = wanted | wanted.T
    np.testing.assert_allclose(found[:, kept], together[:, kept], rtol=1e-9, atol=0)
    assert not found[:, ~kept].any()


def test_between_its_loads_it_states_what_interpolation_costs(slab, library):
    """GaussianLoads at places that the library has not seen, on its own mesh, along the normal and along both
    tangents."""
    places = np.array([[0.0025, 0.0021], [-0.0049, -0.0018]])
    skin, meshed, n, s = library.skin, meshed_scenario(slab, library.skin), len(library.centres), len(library.sideways)
    model = fem_model(meshed, cached_mesh(meshed))
    axes = np.concatenate([skin.places(places)[1], *skin.tangents(places)])
    seen = bell_functionals(model, skin, GaussianLoads(np.tile(places, (3, 1)), axes, library.width)).toarray()
    witness = replace(model, functionals=seen, shares=np.ones(6))
    node = library.bands.nodes.shape[1] // 2
    at = library.bands.nodes[-1, node]
    truth = seen.T @ replace(make_solver(model, meshed.solver, at), model=witness).at(at).values
    shape = Shape("bell", library.width)
    (along_z, z), (along_t, t) = (of[-1].weights(shape, places) for of in library.lattices)
    weights = np.zeros((n + 2 * s, 6))
    for rows, columns, of in ((0, 0, along_z), (n, 2, along_t), (n + s, 4, along_t)):
        weights[rows : rows + len(of), columns : columns + 2] = of
    limb = weights.T @ modal_compliance(library.fine, np.array([at]), np.eye(n + 2 * s))[0] @ weights
    apart = pair_distances(places)
    integrals = between_flat_bells(medium(slab), np.array([at]), library.width, apart, sideways=True)[0]
    layered = flat_compliance(integrals, apart, places, places)
    found = limb - weights.T @ library._flat_bells[-1, node] @ weights + layered
    off = np.abs(found - truth)
    part = _Part(len(library.bands.edges) - 2, np.ones(1, dtype=bool), weights, layered[None], np.hstack([z, t, t]))
    ports = library.ports(slab)[:2]
    asked = _Asked(ports, np.array([at]), places, np.array([0, 1] * 3), np.array([0, 0, 1, 1, 1, 1]), None, (part,))
    stated = library._deviation(part, asked)
    assert (off < 3 * stated + 0.02 * np.abs(truth).max()).all()
    assert off.max() < 0.05 * np.abs(truth).max()
    held_truth, hold = constrained_compliance(truth[None], 2)  # both held sideways, as bonded discs are
    deviation = deviation_held(stated[None], hold)[0]
    assert (
        np.abs(constrained_compliance(found[None], 2)[0] - held_truth)[0] < 3 * deviation + 0.02 * np.abs(truth).max()
    ).all()
    assert np.abs(held_truth - truth[:2, :2]).max() > 1e-3 * np.abs(truth).max()  # so holding does count


def test_bells_of_a_slab_push_and_read_as_their_layered_models_in_every_direction(library):
    """Along the normal, u and v: signs and angles of what couples them, by finite elements of the slab."""
    n, s, node = len(library.centres), len(library.sideways), library.bands.nodes.shape[1] // 2
    limb = modal_compliance(library.fine, library.bands.nodes[-1, [node]], np.eye(n + 2 * s))[0]
    layered = library._flat_bells[-1, node]
    z, u, v = (slice(a, b) for a, b in ((0, n), (n, n + s), (n + s, n + 2 * s)))
    for i, j in ((z, z), (z, u), (z, v), (u, u), (u, v), (v, v)):
        share = np.vdot(layered[i, j], limb[i, j]) / np.linalg.norm(layered[i, j]) ** 2
        assert abs(share - 1) < 0.4  # the sides come back, .24 of the weakest coupling; turned round it were 2


def test_discs_that_are_held_again_are_those_that_were_never_let_go(slab, library):
    ports, frequency = library.ports(slab), np.array([70.0, 90.0])
    places = library.skin.flat(positions(ports))
    discs = [Disc(x, y, 0.002, "bonded") for x, y in places[:2].tolist()] + [Disc(x, y) for x, y in places[2:].tolist()]
    free = library.layered.compliance(2 * np.pi * frequency, discs, free=True).values
    direct = library.layered.compliance(2 * np.pi * frequency, discs).values
    assert free.shape == (2, 12, 12)  # four ports, two discs along u and v, and their tilts
    found, hold = constrained_compliance(free, len(ports))
    assert found[:, :, :2] == pytest.approx(direct[:, :, :2], rel=1e-10, abs=1e-12 * np.abs(direct[:, 0, 0]).max())
    # silent discs move nowhere: what is left of the free ones' motion under the forces that hold them
    forced = np.concatenate([np.tile(np.eye(4), (2, 1, 1)), hold.swapaxes(1, 2)], axis=1)[:, :, :2]
    left, scale = np.abs(free[:, 4:] @ np.nan_to_num(forced)), np.abs(direct[:, 0, 0]).max()
    assert left[:, :4].max() < 1e-12 * scale
    assert left[:, 4:].max() < 1e-12 * scale / 0.002  # tilts, over the radius
    between = flat_compliance(
        between_flat_bells(medium(slab), frequency, 1e-3, pair_distances(places[:2]), sideways=True),
        pair_distances(places[:2]), places[:2], places[:2],
    )  # fmt: skip
    for one, other in ((0, 3), (0, 5), (2, 3), (2, 5), (4, 5)):  # z, u, v of one disc and of the other
        share = free[:, [0, 1, 4, 5, 6, 7]][:, one, [0, 1, 4, 5, 6, 7]][:, other] / between[:, one, other]
        assert (np.abs(share - 1) < 0.3).all()  # a disc of 2 mm as a bell of 1 mm, 11 mm away; turned round it were 2
    # Mindlin 1949, incompressible: 8 mu a along the normal, 16/3 mu a along the skin; layers and skin make it softer
    assert 1.1 < abs(free[0, 4, 4] / free[0, 0, 0]) < 1.6


def test_a_slab_answers_nearly_as_its_layered_model(slab, library):
    found = library.compliance(slab)
    data = {**SLAB, "engine": "layered"}
    layered = simulate(parse_scenario(data)).compliance
    own, truth = found.values[:, :, :2], layered.values[:, :, :2]
    assert np.abs(own - truth)[:, :2].max() < 0.15 * np.abs(truth).max()  # the sides come back: 50 mm at 60 Hz
    assert np.abs(own - truth)[:, :2].max() > 1e-3 * np.abs(truth).max()  # so the limb does count
    assert np.abs(found.values - found.values.swapaxes(1, 2))[:, :2, :2].max() < 1e-15
    assert [e.source for e in found.errors] == ["interpolation", "quadrature", "contact", "reduction"]
    assert all(e.band > 0 for e in found.errors if e.source != "contact")  # of a flat slab that may be none


@pytest.mark.parametrize(("contact", "tension"), [("bonded", 0.0), ("frictionless", 0.0), ("frictionless", 2.0)])
def test_moments_of_discs_are_derivatives_of_their_forces(contact, tension):
    """Far from a small disc a moment's field is the derivative of a force's with the place; and Mindlin's own tilt.
    Where the skin is tense, rings on the rim would carry a part of the moment if they were let to."""
    mu, a, at = 5e3, 1e-3, np.array([2 * np.pi * 20.0])
    layer = Layer(np.inf, 1000.0, lambda omega: np.asarray(mu + 1j * omega, dtype=complex))
    surface = Surface(tension=tension)
    table = tabulate((layer,), (90.0, 150.0), a, contact, surface=surface, farthest=0.03, step=2e-3)
    point, h, t = Disc(0.021, -0.013), 1e-4, 4 if contact == "frictionless" else 6

    def free(x, y):
        return table.compliance(at, [Disc(x, y, a, contact), point], free=True).values[0]

    here = free(0.0, 0.0)
    assert here.shape == (t, t)
    for k, way in enumerate(np.eye(2) * h):
        slope = (free(*way)[1, 0] - free(*-way)[1, 0]) / (2 * h)
        # they differ by the square of the radius over the distance, and by what tables lack, over h
        assert here[1, t - 2 + k] == pytest.approx(slope, rel=0.02)
    # 3/16 mu a^3 of bonded discs and of smooth ones on incompressible tissue (Mindlin 1949), waves being long
    if not tension:
        assert here[t - 2, t - 2].real == pytest.approx(3 / (16 * mu * a**3), rel=0.01)


def test_discs_are_held_against_the_slope_of_what_the_limb_adds(slab, library, monkeypatch):
    """The limb adds a standing wave, of the place that pushes as of that which reads; held by hand, of closed forms."""
    asked, s = library._asked(slab), len(library.sideways)
    k, b, a = np.array([100.0, -75.0]), int(library.bands.number(asked.frequency)[0]), library.layered.radius
    assert (library.bands.number(asked.frequency) == b).all()
    size, x = 0.5 * np.abs(asked.layered.values[:, 0, 0]).max(), np.linalg.norm(k)
    bells = np.concatenate([np.sin(library.centres @ k) * np.exp(-((x * library.width) ** 2) / 2), np.zeros(2 * s)])

    def wave(limb, frequency, weights, wanted):
        layered = weights.T @ library._flat_bells[b] @ weights
        added = np.outer(weights.T @ bells, weights.T @ bells)
        return np.einsum("fn,nij->fij", library.bands.between(frequency), layered) + size * added

    monkeypatch.setattr(arm, "modal_compliance", wave)
    found, _ = library._answer(asked, library.fine)
    discs, points = asked.places[:2] @ k, asked.places[2:] @ k
    seen = [np.sin(discs) * np.sin(x * a) / (x * a), np.sin(points), np.zeros(4)]
    slope = 3 * spherical_jn(1, x * a) / (x * a) * np.outer(k, np.cos(discs)).ravel()
    truth, flat = (
        constrained_compliance(asked.layered.values + size * np.outer(moved, moved), len(asked.ports))[0][:, :, :2]
        for moved in (np.concatenate([*seen, of]) for of in (slope, 0 * slope))
    )
    off = np.abs(found.values[:, :, :2] - truth).max() / np.abs(truth).max()
    assert off < 2e-3  # 20 loads on a patch of a third of a wave: slopes are found to a tenth, and enter squared
    assert np.abs(flat - truth).max() > 3 * off * np.abs(truth).max()  # so tilts count


def test_what_the_space_misses_is_the_largest_of_as_far_or_farther():
    away = np.array([0.0, 5e-3, 11e-3, 14e-3])
    found = side._farther(np.array([4.0, 3.0, 1.0, 2.0]), away, np.arange(6) * side.BIN)
    assert found.tolist() == [4, 3, 2, 2, 2, 2]  # the second farthest misses less than one farther; the last is kept
    assert not side._farther(np.zeros(0), np.zeros(0), np.arange(3) * side.BIN).any()


def test_bells_that_were_no_witness_miss_what_is_told_for_their_distance(slab, library):
    """Along the skin half of the bells are no witness; direct solves at the band's end, which is checked."""
    bells, meshed = loaded_skin(slab).bells, meshed_scenario(slab, library.skin)
    model = fem_model(meshed, cached_mesh(meshed))
    seen = bell_functionals(model, library.skin, bells).toarray()
    some = np.arange(len(bells.centres))[::3]
    witness = replace(model, functionals=seen[:, some], shares=np.ones(len(some)))
    at = float(library.reduction[0, -1])
    truth = seen.T @ replace(make_solver(model, meshed.solver, at), model=witness).at(at).values
    off = np.abs(modal_compliance(library.fine, np.array([at]), np.eye(len(seen.T)))[0][:, some] - truth)
    away = np.linalg.norm(bells.centres[:, None] - bells.centres[some][None], axis=2)
    along = (np.arange(len(bells.centres)) >= len(library.centres)).astype(int)
    told = np.array([np.interp(away, library.bins, one) for one in library.missed[-1]])
    kind = (along[:, None] + along[some])[None]
    assert (off <= 2 * np.take_along_axis(told, kind, axis=0)[0]).mean() > 0.99  # the largest of other pairs, alike


def test_what_the_space_misses_reaches_g_entry_by_entry(slab, library):
    """A miss of one size at all places is a share of G that grows as entries fall. Between the frequencies checked its
    logarithm is linear: by hand, of one disc and one point, with nothing missed along the skin and little by tilts."""
    levels = 1e-7 * 10.0 ** np.arange(len(library.missed))
    along_z, along_skin = np.zeros_like(library.missed), np.zeros_like(library.missed)
    along_z[:, 0], along_skin[:, 1:] = levels[:, None], 1e-6
    device = {**SLAB["device"], "contacts": [[-0.008, 0.0]]}
    for x in (-0.002, 0.008):
        asked = parse_scenario({**SLAB, "device": device, "grid": {"points": [[x, 0.0]]}})
        stated = []
        for missed in (along_z, along_skin):
            found = replace(library, missed=missed).compliance(asked)
            stated.append(np.array({e.source: e for e in found.errors}["reduction"].per_frequency))
        between = np.exp(np.interp(found.frequency, library.reduction[0], np.log(levels)))
        alone = stated[0] / (between / np.abs(found.values[:, 1, 0]))
        assert ((alone >= 1 - 1e-9) & (alone < 1.02)).all()  # tilts see it too, on a disc a tenth of a wave wide
        assert (stated[1] > 0).all()  # discs are held sideways, with forces that see what is missed there
    assert not np.isin(found.frequency, library.reduction[0]).all()  # so one lies between


def test_a_cylinders_curvature_is_one_over_its_radius():
    scenario = parse_scenario({"limb": {"shape": "cylinder", "diameter": 0.06}})
    assert flat_skin(parametric_skin(scenario), 0.04, 0.04).curvature == pytest.approx(1 / 0.03, rel=1e-3)  # chords


def test_skin_stretches_where_no_plane_has_it():
    """Over chords of 4 mm a profile that bends along the limb; not at all on a cone or between a place and itself."""
    rings = {
        "cone": [[x, 2 * np.pi * (0.034 - 0.1 * x)] for x in np.linspace(-0.06, 0.06, 7).tolist()],
        "barrel": [[x, 2 * np.pi * (0.034 - 6 * x**2)] for x in np.linspace(-0.06, 0.06, 13).tolist()],
    }
    rng, most = np.random.default_rng(1), {}
    flat = rng.uniform(-1, 1, (12, 2)) * [0.027, 0.022]
    angle = rng.uniform(0, 2 * np.pi, 12)
    near = flat + 4e-3 * np.column_stack([np.cos(angle), np.sin(angle)])
    for name, circumference in rings.items():
        limb = {"shape": "forearm", "length": 0.12, "circumference": circumference, "bones": []}
        skin = flat_skin(parametric_skin(parse_scenario({"limb": limb})), 0.06, 0.05, margin=0.01)
        found = skin.stretch(np.vstack([flat, near]))
        chord = np.linalg.norm(skin.places(near)[0] - skin.places(flat)[0], axis=1) / 4e-3 - 1
        off = np.abs(np.diagonal(found[:12, 12:]) - chord)
        assert (off < 3e-3 + 0.1 * np.abs(chord)).all()  # as cones' chords above; a tenth, as it changes on the way
        assert (np.diagonal(found) == 0).all()
        most[name] = np.abs(chord).max()
    assert most["cone"] < 3e-3 < 0.01 < most["barrel"]


def test_what_stretched_skin_is_off_by_is_what_the_layered_model_changes():
    """A rigid disc on thick skin at 5 Hz: points 1 to 4 mm off its rim, 1 and 3 % nearer than they lie flat."""
    radius = 3.5e-3
    layer = Layer(np.inf, 1050.0, lambda omega: np.asarray(1e4 + 5j * omega, dtype=complex))
    ports = (Port("A1", "contact", (0.0,) * 3, (0.0, 0.0, 1.0), radius, "bonded"),
             *(Port(f"P{k}", "point", (0.0,) * 3, (0.0, 0.0, 1.0)) for k in range(3)))  # fmt: skip
    at = np.array([0.0, 4.5e-3, 5.5e-3, 7.5e-3])
    table = tabulate((layer,), (25.0, 40.0), radius, "bonded", farthest=0.03, step=2e-3)
    omega = np.array([2 * np.pi * 5.0])
    disc = Disc(0.0, 0.0, radius, "bonded")
    for share in (0.01, 0.03):
        fields = [
            table.compliance(omega, [disc, *(Disc(r, 0.0) for r in at[1:] * factor)]).values[0, 1:, 0]
            for factor in (1.0, 1 - share)
        ]
        change = np.abs(fields[1] - fields[0]) / np.abs(fields[0])
        stretch = share * (at[:, None] != at)
        stated = moved_by_stretch(ports, np.abs(at[:, None] - at), stretch, 5e-3)
        # a twentieth: waves of two metres, and a disc that is held, not pushed, along the skin
        assert stated[1:, 0] == pytest.approx(change, rel=0.05)
        assert (stated == stated.T).all()
        assert (stated[1:, 1:] == 0).all()  # points do not drive
        assert moved_by_stretch(ports, np.abs(at[:, None] - at), stretch, 2.5e-3)[3, 0] == 0  # interpolated


def test_a_library_states_what_stretched_skin_is_off_by(library, monkeypatch):
    """A point a millimetre off a rim: as a share of its own entry, which is not the largest where another is nearer."""
    device = {**SLAB["device"], "contacts": [[-0.008, 0.0]]}
    asked = parse_scenario({**SLAB, "device": device, "grid": {"points": [[-0.005, 0.0], [0.006, 0.002]]}})
    flat, *stretched = (
        (monkeypatch.setattr(FlatSkin, "stretch", lambda self, places, by=by: np.full((len(places),) * 2, by)),
         {e.source: e for e in library.compliance(asked).errors}["contact"])[1]
        for by in (0.0, 0.02)
    )  # fmt: skip
    (more,) = stretched
    added = np.array(more.per_frequency) - flat.per_frequency
    share = np.arcsin(2 / 3 / 0.98) / np.arcsin(2 / 3) - 1
    assert added == pytest.approx(np.full(len(added), share), rel=1e-6)
    assert more.band == pytest.approx(flat.band + share, rel=1e-6)


@pytest.mark.slow
def test_a_library_that_was_ended_goes_on_to_the_same_to_the_bit(slab, library, tmp_path, monkeypatch):
    """Ended after its first batch of loads: the rest is solved, the answer is that of one go, and then nothing is."""
    monkeypatch.setenv("FOREARM_FEM_CACHE", str(tmp_path))
    monkeypatch.setattr(side, "_AT_ONCE", 10)
    patch, meshed = loaded_skin(slab), meshed_scenario(slab, library.skin)
    told: list[tuple[str, int]] = []

    def ending(stage, done, total):
        told.append((stage, done))
        if (stage, done) == ("loads on the patch", 10):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        side.solved_side(meshed, patch, tmp_path, progress=ending)
    (space,) = tmp_path.glob("library-parts/*-space.sqlite")
    told.clear()
    resumed = side.solved_side(meshed, patch, tmp_path, progress=lambda *a: told.append(a[:2]))
    loads = [done for stage, done in told if stage == "loads on the patch"]
    assert loads == [10, 20, 30, 38]
    assert not space.exists()  # what is finished keeps no columns
    told.clear()
    again = side.solved_side(meshed, patch, tmp_path, progress=lambda *a: told.append(a[:2]))
    assert "assembly" not in [stage for stage, _ in told]
    every, at = np.eye(38), np.array([60.0, 100.0])
    assert np.array_equal(modal_compliance(again.limb, at, every), modal_compliance(resumed.limb, at, every))
    whole = modal_compliance(library.fine, at, every)
    # made in one batch of all: other directions are dropped
    assert np.abs(modal_compliance(resumed.limb, at, every) - whole).max() < 0.01 * np.abs(whole).max()


@pytest.mark.slow
def test_a_library_states_the_seconds_of_all_calls(slab, library, tmp_path, monkeypatch):
    """The second call finds its part in the cache; that took hours of the first one's."""
    monkeypatch.setenv("FOREARM_FEM_CACHE", str(tmp_path))

    facts = {**library.facts, "seconds_loads": 7200.0, "seconds_poles": 60.0}
    kept = side.MeshPart(library.fine, library.freed, library.reduction, library.missed, facts)
    monkeypatch.setattr(make, "solved_side", lambda *asked, **how: kept)
    assert 7260 <= make_library(slab).facts["seconds"] < 7260 + 600


def test_answers_agree_with_finite_elements_of_the_same_slab(slab, library):
    fem = close_loop(simulate(slab).compliance, slab.device).values
    own = close_loop(library.compliance(slab), slab.device).values
    assert np.linalg.norm(own - fem) < 0.1 * np.linalg.norm(fem)  # both meshes err by some per cent at accuracy 0.3


def test_simulate_takes_a_library_and_says_what_is_unknown(slab, library):
    result = simulate(slab, engine=library)
    assert result.mesh is None
    assert result.transfer.values.shape == (5, 2, 2)
    assert not np.isfinite(next(e.band for e in result.transfer.errors if e.source == "discretisation"))
    assert any(e.source == "truncation" and e.band > 0 for e in result.transfer.errors)
    second = replace(library, coarse=replace(library.fine, left=1.02 * library.fine.left))
    errors = {e.source: e for e in simulate(slab, engine=second).transfer.errors}
    assert 0.02 / 2 < errors["discretisation"].band < 0.05  # 2 % of the limb's part, by order 2 all of it is left


def test_a_library_comes_back_from_its_file_and_damage_is_told(slab, library, tmp_path, monkeypatch):
    file = tmp_path / "arm.library.nc"
    save_library(file, library)
    again = load_library(file).compliance(slab)
    assert np.array_equal(again.values, library.compliance(slab).values, equal_nan=True)
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(bytes(content))
    with pytest.raises(DataError, match=r"not match|damaged"):
        load_library(file)
    with monkeypatch.context() as older:
        older.setattr(ArmLibrary, "version", 0)
        save_library(file, library)
    with pytest.raises(DataError, match="make it again"):
        load_library(file)
    with pytest.raises(DataError, match="no such file"):
        load_library(tmp_path / "none.nc")


DESIGN = """name = "d"
scenario = "slab.toml"
[[variables]]
key = "device.contacts"
values = [[[-0.006, 0.0], [0.005, 0.002]], [[-0.004, 0.001], [0.004, -0.002]], [[-0.02, 0.0], [0.02, 0.0]]]
[objective]
targets = ["2"]
[constraints]
clearance = 0.0005
min_distance = 0.005
[search]
duration = 0.1
"""


def inline(value):
    """A value as TOML writes it in one line."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} = {inline(of)}" for key, of in value.items()) + "}"
    return json.dumps(value)


@pytest.fixture
def asked_design(library, tmp_path):
    """A design of two discs and three points on the library's slab: its file, and the library's."""
    points = [[0.0, 0.0], [0.0, 0.006], [0.0, -0.006]]
    rendering = {"methods": ["inverse filter"], "wavelet": {"peak": 80.0}, "window": [-0.03, 0.03]}
    data = {**SLAB, "grid": {"points": points}, "rendering": rendering}
    (tmp_path / "slab.toml").write_text("".join(f"{key} = {inline(value)}\n" for key, value in data.items()))
    (tmp_path / "design.toml").write_text(DESIGN)
    save_library(tmp_path / "arm.nc", library)
    return tmp_path / "design.toml", tmp_path / "arm.nc"


def candidates_of(folder):
    shelf = Shelf(folder / WORK)
    return [shelf.get(key) for key in shelf.known()]


def test_a_design_is_searched_on_a_library(library, asked_design, tmp_path):
    """S of each candidate is that of a run with the library; what lies off the patch cannot be."""
    file, arm = asked_design
    said = cli("design", file, "--library", arm, "--out", tmp_path / "out", "--no-confirm")
    assert said.code == 0, said
    rows = candidates_of(tmp_path / "out")
    off = [row for row in rows if row["problem"]]
    assert len(rows) == 3
    assert ["off the library's patch" in row["problem"] for row in off] == [True]
    best = max((row for row in rows if not row["problem"]), key=lambda row: row["score"])
    contacts = json.dumps(best["values"]["device.contacts"])
    scenario = load_scenario(tmp_path / "slab.toml", overrides=[f"device.contacts={contacts}"])
    transfer = simulate(scenario, engine=library).transfer
    with pytest.warns(AccuracyWarning, match="they are not driven"):  # five bins hold two thirds of a wavelet
        s = render_transfer(scenario, transfer).strengths[0]
    assert best["score"] == pytest.approx(s[1], rel=1e-6)  # the same G and renderer
    assert json.loads((tmp_path / "out/best.json").read_text())["values"] == best["values"]


@pytest.mark.slow  # two processes import and load; one process is tried above
def test_a_design_is_searched_on_a_library_by_two_processes(asked_design, tmp_path):
    file, arm = asked_design

    def candidates(workers):
        out = tmp_path / str(workers)
        said = cli("design", file, "--library", arm, "--out", out, "--no-confirm", "--workers", workers)
        assert said.code == 0, said
        return candidates_of(out)

    rows, others = candidates(1), candidates(2)
    assert len(rows) == len(others) == 3
    for row in rows:  # two processes end in any order
        (other,) = (o for o in others if o["values"] == row["values"])
        assert other["problem"] == row["problem"]
        if not row["problem"]:  # sums of as many threads as a process has
            assert other["strengths"] == pytest.approx(row["strengths"], rel=1e-9)
            assert other["error"] == pytest.approx(row["error"], rel=1e-9)


def test_a_dry_run_on_a_library_meshes_nothing_and_says_what_it_does_not_answer(asked_design, tmp_path, monkeypatch):
    file, arm = asked_design[0].parent / "slab.toml", asked_design[1]
    monkeypatch.setattr("forearm_fem.geometry.build.cached_mesh", lambda *_, **__: pytest.fail("meshed"))
    said = cli("run", file, "--library", arm, "--dry-run")
    assert (said.code, said.out) == (0, "library: no mesh and no solve; 5 frequencies in seconds\n")
    off = cli("run", file, "--library", arm, "--dry-run", "--set", "device.contacts=[[-0.02, 0], [0, 0]]")
    assert "lies off the library's patch" in off.sentence
    beyond = cli("run", file, "--library", arm, "--dry-run", "--set", "sweep.f_max=200")
    assert "the library holds 60 to 100 Hz" in beyond.sentence


def test_a_library_is_known_by_what_it_holds_and_by_no_name(asked_design):
    assert is_library(asked_design[1])
    assert not is_library(asked_design[0])
    said = cli("workbench", asked_design[1], "--declare", "unit='mm/V'")
    assert "a library says all of itself" in said.sentence


def test_what_no_candidate_can_change_is_no_matter_of_variables(asked_design, tmp_path):
    file, arm = asked_design
    scene = file.parent / "slab.toml"
    scene.write_text(f'engine = "layered"\n{scene.read_text()}')
    said = cli("design", file, "--library", arm, "--out", tmp_path / "out", "--no-confirm")
    assert "can be evaluated: engine: a library stands for finite elements" in said.sentence
    assert "widen" not in said.sentence


@pytest.mark.slow  # rims of 2 mm: 90 s
def test_a_librarys_winner_is_confirmed_by_finite_elements(asked_design, tmp_path):
    file, arm = asked_design
    said = cli("design", file, "--library", arm, "--out", tmp_path / "out")
    assert said.code == 0, said
    assert "Confirmed by a full run" in said.out
    assert "off the model" in said.out
    assert (tmp_path / "out/confirmed/signal_strength.csv").is_file()


@pytest.mark.parametrize(
    ("change", "error", "said"),
    [
        ({"device": {**SLAB["device"], "contacts": [[0.02, 0.0]]}}, GeometryError, "off the library's patch"),
        ({"grid": {"points": [[0.0, 0.009]]}}, GeometryError, "grid point 1 .* off the library's patch"),
        ({"device": {**SLAB["device"], "contacts": [[0.0, 0.0], [0.003, 0.0]]}}, GeometryError, "apart, but discs"),
        ({"device": {**SLAB["device"], "cone": {"radius": 0.003}}}, ScenarioError, "holds bonded discs of 2 mm"),
        ({"tissues": {"preset": "thesis"}}, ScenarioError, "tissues: .* another arm"),
        ({"limb": {**SLAB["limb"], "depth": 0.021}}, ScenarioError, "limb: .* another arm"),
        ({"sweep": {**SLAB["sweep"], "f_max": 120}}, ScenarioError, "the library holds 60 to 100 Hz"),
        ({"engine": "layered"}, ScenarioError, "stands for finite elements"),
    ],
)
def test_what_a_library_cannot_answer_is_one_sentence(library, change, error, said):
    with pytest.raises(error, match=said) as caught:
        library.compliance(parse_scenario({**SLAB, **change}))
    assert len(str(caught.value)) <= 300
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"library": {"length": 0.2, "width": 0.03}}, "reaches beyond the volar skin"),
        ({"limb": {**SLAB["limb"], "symmetry": ["x"]}}, "cut by limb.symmetry"),
        (
            {
                "limb": {"shape": "slab", "length": 0.1, "width": 0.1},
                "solver": {"memory_limit": 1e8},
                "library": {"length": 0.05, "width": 0.05, "step": 1e-3},
            },
            r"library: \d+ loads, 1 mm apart, need more than .* enlarge library.step",
        ),
        ({"tissues": {"override": {"fat": {"law": "springpot", "mu": 3e3, "exponent": 0.2}}}}, "needs Kelvin-Voigt"),
    ],
)
def test_arms_that_no_library_is_made_for_are_refused(change, said):
    data = json.loads(json.dumps({**SLAB, "limb": {"shape": "cylinder"}, "device": {}, "grid": {}}))
    with pytest.raises(ForearmError, match=said):
        make_library(parse_scenario({**data, **change}))
