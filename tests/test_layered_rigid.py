"""Rigid discs in the layered model: static limits, an independent model, convergence, reciprocity, passivity."""

import itertools
import math

import numpy as np
import pytest
from alternatives import product_weights
from scipy import special

from forearm_fem.layered import (
    Disc,
    Layer,
    Surface,
    bonded_disc,
    layered_compliance,
    rigid_disc,
    surface_compliance,
    surface_kernel,
)
from forearm_fem.layered import discs as discs_of
from forearm_fem.layered.discs import galerkin
from forearm_fem.layered.hankel import _balls, bessels
from forearm_fem.layered.integrals import NODES, Rules

pytestmark = pytest.mark.integrated

BULK, A = 2.2e9, 3.5e-3
MU = 7860.0


def voigt(mu, eta):
    return lambda omega: mu + 1j * omega * eta


PRESET_O = [
    Layer(1.2e-3, 1100.0, voigt(13e3, 3.0), BULK),
    Layer(3e-3, 950.0, voigt(5e3, 1.5), BULK),
    Layer(math.inf, 1060.0, voigt(1e4, 4.0), BULK),
]
OMEGA = 2 * np.pi * np.array([20.0, 150.0, 500.0])


def solved(discs, outputs=None, omega=OMEGA, layers=PRESET_O, tolerance=1e-9, **options):
    return layered_compliance(layers, omega, discs, outputs or discs, tolerance=tolerance, **options)


def relative(a, b):
    """Largest difference over the largest value, per frequency."""
    return np.nanmax(np.abs(a - b), axis=(1, 2)) / np.nanmax(np.abs(b), axis=(1, 2))


def half_space(nu, loss=1e-3):
    bulk = math.inf if nu == 0.5 else 2 * MU * (1 + nu) / (3 * (1 - 2 * nu))
    return [Layer(math.inf, 1050.0, lambda omega: MU * (1 + 1j * loss) + 0 * omega, bulk)]


SLOW = np.array([2 * np.pi * 1e-3])  # k_s a = 1e-5


@pytest.mark.parametrize("contact", ["bonded", "frictionless"])
def test_static_incompressible_disc_is_8_mu_a(contact):
    """1e-5: the loss of 1e-3 enters the modulus of the compliance squared, inertia as k_s a."""
    u = solved([Disc(0, 0, A, contact)], omega=SLOW, layers=half_space(0.5)).values[0, 0, 0]
    assert abs(u) * 8 * MU * A == pytest.approx(1, abs=1.1e-5)


def test_static_frictionless_disc_on_a_compressible_body():
    """4 mu a/(1 - nu); the same 1e-5."""
    for nu in (0.0, 0.3):
        u = solved([Disc(0, 0, A, "frictionless")], omega=SLOW, layers=half_space(nu)).values[0, 0, 0]
        assert abs(u) == pytest.approx(rigid_disc(A, MU, nu), rel=1.5e-5)


@pytest.mark.parametrize("nu", [0.0, 0.3, 0.45])
def test_static_bonded_disc_is_mossakovskiis(nu):
    """Nears it with the square of the terms: the rim's oscillating singularity is not among them. States that."""
    errors = []
    for terms in (3, 6, 12):
        result = solved([Disc(0, 0, A, "bonded")], omega=SLOW, layers=half_space(nu), terms=terms)
        errors.append(abs(abs(result.values[0, 0, 0]) / bonded_disc(A, MU, nu) - 1))
        assert errors[-1] < result.error[0] + 1.5e-5
    assert errors[2] < 1e-4 * (1 + 2 * (nu == 0))  # 1.0e-4 at nu = 0
    assert errors[0] > 10 * errors[2] or errors[0] < 1e-4


def test_terms_converge_exponentially_on_layers():
    """Each two terms more take off a factor of 100 and more; what is stated is above what is missing."""
    for contact in ("bonded", "frictionless"):
        disc, point = Disc(0, 0, A, contact), Disc(0.01, 0)
        truth = solved([disc], [disc, point], terms=12).values
        results = [solved([disc], [disc, point], terms=terms) for terms in (2, 4, 6)]
        errors = np.array([relative(r.values, truth) for r in results])
        assert np.all(errors[1:] < 0.01 * errors[:-1])
        assert np.all(errors[2] < 1e-7)
        assert all(np.all(e < r.error) for e, r in zip(errors[1:], results[1:], strict=True))


def test_one_term_is_not_enough_and_says_so():
    """The static stress alone misses by a quarter at 500 Hz; the change of the last term is its size."""
    disc = Disc(0, 0, A, "bonded")
    two = solved([disc], terms=2)
    assert two.truncation[2] > 0.1


def test_two_discs_of_many_small_pressure_discs():
    """Frictionless discs 9 mm apart as rosettes of 2 x 61 pressure discs of equal displacement, solved as such.

    Their rims are jagged: the disc's own compliance and the cross term to 7 % (5 % with 91 each). The second disc's
    presence changes what reaches a point behind it by two thirds; of that, to 15 % (9 % seen; 7 % with 91 each).
    """
    omega, apart = np.array([2 * np.pi * 150.0]), 9e-3
    ring = [(0.0, 0.0)] + [
        (r * A / 4.5, 2 * math.pi * j / (6 * r) + 0.3 * r) for r in range(1, 5) for j in range(6 * r)
    ]
    places = [(r * math.cos(t), r * math.sin(t)) for r, t in ring]
    small = A / math.sqrt(61)
    spots = [Disc(x + s * apart / 2, y, small) for s in (-1, 1) for x, y in places]
    point = Disc(apart / 2 + 5.5e-3, 0.0)
    c = layered_compliance(PRESET_O, omega, spots, [*spots, point], tolerance=1e-6).values[0]
    both = np.kron(np.eye(2), np.ones((61, 1)))
    stiffness = np.linalg.solve(c[:-1], both)  # forces per unit displacement of each disc
    compliance = np.linalg.inv(both.T @ stiffness)
    at_point = c[-1] @ stiffness @ compliance

    alone = np.linalg.solve(c[:61, :61], np.ones(61))
    alone = alone / alone.sum()
    unscattered = c[-1, :61] @ alone  # at the point behind disc 2, from disc 1, as if disc 2 were not there
    discs = [Disc(s * apart / 2, 0.0, A, "frictionless") for s in (-1, 1)]
    exact = layered_compliance(PRESET_O, omega, discs, [*discs, point], tolerance=1e-8).values[0]
    assert abs(compliance[0, 0] / exact[0, 0] - 1) < 0.07
    assert abs(compliance[1, 0] / exact[1, 0] - 1) < 0.07
    ours = layered_compliance(PRESET_O, omega, discs[:1], [discs[0], point], tolerance=1e-8).values[0, 1, 0]
    shadow, found = at_point[0] / unscattered - 1, exact[2, 0] / ours - 1
    assert abs(found) > 0.5
    assert abs(shadow / found - 1) < 0.15


MIXED = [
    Disc(0.0, 0.0, A, "bonded"),
    Disc(0.011, 0.002, 2e-3, "frictionless"),
    Disc(-0.004, 0.012, 3e-3, "pressure"),
    Disc(-0.013, -0.006, 4e-3, "bonded"),
    Disc(0.006, 0.009),
]


def test_reciprocity():
    """Reversing the order swaps computed for mirrored entries: forces and places may be exchanged to 1e-10."""
    g = solved(MIXED, omega=OMEGA[1:2], orders=2).values
    h = solved(MIXED[::-1], omega=OMEGA[1:2], orders=2).values[:, ::-1, ::-1]
    assert np.all(relative(h, g) < 1e-10)
    assert np.all(relative(g.swapaxes(1, 2), g) < 1e-10)


def test_turning_and_mirroring_the_device_changes_nothing():
    """Azimuthal orders transform as they should; 1e-9 as the quadrature."""
    c, s = math.cos(0.7), math.sin(0.7)
    g = solved(MIXED, omega=OMEGA[1:2], orders=2).values
    for turn in ([[c, -s], [s, c]], [[c, s], [s, -c]]):
        places = [(np.array(turn) @ (d.x, d.y)).tolist() for d in MIXED]
        moved = [Disc(x, y, d.radius, d.contact) for (x, y), d in zip(places, MIXED, strict=True)]
        assert np.all(relative(solved(moved, omega=OMEGA[1:2], orders=2).values, g) < 1e-9)


def test_passivity():
    """-Im of the port matrix is positive semidefinite: no forces on any contacts draw energy out."""
    omega = 2 * np.pi * np.geomspace(10.0, 500.0, 6)
    g = solved(MIXED[:4], omega=omega, tolerance=1e-7, orders=2).values
    assert np.all(np.linalg.eigvalsh(-g.imag) > -1e-7 * np.abs(g).max(axis=(1, 2))[:, None])


def test_scattering_fades_with_distance():
    """What a second disc changes of the first's compliance is of the order of the square of what reaches it: at 500 Hz
    2e-2 at 9 mm, 2e-7 at 30 mm."""
    changes, reached = [], []
    alone = solved([Disc(0, 0, A, "bonded")], omega=OMEGA[2:]).values[0, 0, 0]
    for apart in (0.009, 0.012, 0.03):
        discs = [Disc(0, 0, A, "bonded"), Disc(apart, 0, A, "bonded")]
        pair = solved(discs, omega=OMEGA[2:], tolerance=1e-8, orders=3).values[0]
        changes.append(abs(pair[0, 0] / alone - 1))
        reached.append(abs(pair[0, 1] / alone))
    assert changes[0] > 0.01
    assert changes[2] < 1e-6
    assert all(change < 5 * r**2 for change, r in zip(changes, reached, strict=True))


def test_far_field_is_that_of_pressure():
    """At 20 Hz and 60 mm only the second moment of the stress differs: k^2 a^2 (1/6 - 1/8)/... ~ 1e-3 (k a = 0.1)."""
    far = Disc(0.06, 0.0)
    rigid = solved([Disc(0, 0, A, "bonded")], [far], omega=OMEGA[:1]).values[0, 0, 0]
    pressure = solved([Disc(0, 0, A)], [far], omega=OMEGA[:1]).values[0, 0, 0]
    assert abs(rigid / pressure - 1) < 3e-3
    near = [solved([Disc(0, 0, A, c)], omega=OMEGA[:1]).values[0, 0, 0] for c in ("bonded", "pressure")]
    assert abs(near[0] / near[1] - 1) > 0.05


def test_a_point_under_a_rigid_disc_moves_with_it():
    disc = Disc(0.0, 0.0, A, "bonded")
    g = solved([disc], [disc, Disc(0.002, 0.001), Disc(0.0, 1.001 * A)]).values
    assert np.array_equal(g[:, 0], g[:, 1])
    assert np.all(
        np.abs(g[:, 2] / g[:, 0] - 1) < 0.1
    )  # the skin falls away from the rim like a root: 4 % at 0.1 % of a
    assert np.all(np.abs(g[:, 2] / g[:, 0] - 1) > 1e-3)


def test_sheet_is_the_limit_of_thin_stiff_layers():
    """mu h = 28 N/m, eta h = 1.6 mN s/m under a bonded disc and under pressure: bending, thickness fade with h. The
    sheet without its viscosity would miss more than the layer's thickness does (pressure, 500 Hz, 20 um)."""
    omega, points = 2 * np.pi * np.array([100.0, 500.0]), [Disc(0.008, 0.0), Disc(0.012, 0.0)]
    sheet = Surface(membrane=4 * 28.0, viscosity=4 * 1.6e-3, mass=0.088)
    for contact, terms in (("bonded", 4), ("pressure", 1)):
        disc = Disc(0, 0, A, contact)
        options = {"omega": omega, "tolerance": 1e-6, "terms": terms}
        thin = solved([disc], [disc, *points], surface=sheet, **options).values
        errors = []
        for h in (4e-5, 2e-5):
            layer = Layer(h, 0.088 / h, voigt(28 / h, 1.6e-3 / h), BULK)
            thick = solved([disc], [disc, *points], layers=[layer, *PRESET_O], **options).values
            errors.append(relative(thin, thick))
        assert np.all(errors[1] < 0.6 * errors[0])
        assert np.all(errors[1] < 0.02)
    elastic = solved([disc], [disc, *points], surface=Surface(membrane=4 * 28.0, mass=0.088), **options).values
    assert relative(elastic, thick)[1] > 1.5 * errors[1][1]


def test_terms_converge_under_a_sheet():
    """Line forces on the rim are among the tractions: 1e-6 with six terms, as stated; without they would miss 1e-3."""
    sheet = Surface(tension=40.0, membrane=112.0, mass=0.088)
    disc, point = Disc(0, 0, A, "bonded"), Disc(0.006, 0)
    truth = solved([disc], [disc, point], terms=10, surface=sheet).values
    result = solved([disc], [disc, point], surface=sheet)
    assert np.all(relative(result.values, truth) < np.minimum(1e-6, result.error))


def test_surface_compliance_across_the_wave():
    """Love's problem: tanh(qh)/(mu q) on rigid ground, 1/(mu q) without end; and zz as :func:`surface_kernel`."""
    k, omega, h = np.array([50.0, 400.0, 3e3]), np.array(2 * np.pi * 100.0), 2e-3
    mu = voigt(5e3, 1.5)(omega)
    q = np.sqrt(k**2 - 950.0 * omega**2 / mu)
    layer = Layer(h, 950.0, voigt(5e3, 1.5), BULK)
    assert np.allclose(surface_compliance(k, omega, [layer], "rigid").yy, np.tanh(q * h) / (mu * q), rtol=1e-12)
    deep = Layer(math.inf, 950.0, voigt(5e3, 1.5), BULK)
    assert np.allclose(surface_compliance(k, omega, [layer, deep]).yy, 1 / (mu * q), rtol=1e-12)
    assert np.allclose(surface_compliance(k, omega, PRESET_O).zz, surface_kernel(k, omega, PRESET_O), rtol=1e-13)
    static = surface_compliance(k, np.array(1e-3), half_space(0.3, loss=0.0))
    assert np.allclose(static.xx / static.yy, 1 - 0.3, rtol=1e-6)  # Cerruti: 1/(mu k) across, (1 - nu)/(mu k) along
    assert np.allclose(static.zx / static.zz, -(1 - 2 * 0.3) / (2 * (1 - 0.3)), rtol=1e-6)


def test_few_frequencies_carry_a_sweep():
    """400 bins from 97: each within its stated error of the bin computed for itself."""
    discs = [Disc(0, 0, A, "frictionless"), Disc(0.02, 0.0), Disc(0.035, 0.01)]
    omega = 2 * np.pi * np.linspace(10.0, 500.0, 400)
    sweep = solved(discs, omega=omega, tolerance=1e-7)
    some = np.arange(3, 400, 20)
    each = solved(discs, omega=omega[some], tolerance=1e-9)
    error = relative(sweep.values[some], each.values)
    assert np.all(error <= 3 * sweep.error[some])
    assert np.all(error < 1e-6)
    assert 0 < sweep.interpolation.max() < 1e-7
    assert np.all(each.interpolation == 0)


def test_overlapping_rigid_discs_are_refused():
    for a, b in itertools.product(("bonded", "frictionless", "pressure"), ("bonded", "frictionless")):
        with pytest.raises(ValueError, match="may not touch"):
            solved([Disc(0, 0, A, a), Disc(A, 0, A, b)])
    with pytest.raises(ValueError, match="radii"):
        solved([Disc(0, 0, 0.0, "bonded")])


def test_bessel_functions_of_all_orders_are_scipys():
    """Upwards above their order and by Miller's algorithm below: to rounding of the largest, and of tiny ones too."""
    x = np.concatenate([[0.0], np.logspace(-9, 0, 200), np.linspace(0.01, 60.0, 3000)]).reshape(-1, 1)
    for top in (1, 2, 3, 6, 13):
        for found, plain in ((bessels(top, x), special.jv), (_balls(top, x), special.spherical_jn)):
            exact = [plain(n, x) for n in range(top + 1)]
            assert np.allclose(found, exact, rtol=0, atol=3e-15)
            small = x[:, 0] < 1e-3
            assert np.allclose(np.array(found)[:, small], np.array(exact)[:, small], rtol=1e-6, atol=1e-250)


def test_weights_of_many_panels_at_once_are_those_of_a_plain_rule():
    """Two bonded discs and a point on a sheet (balls, rings, a point), from panels of a tenth of a radian to many."""
    discs = [Disc(0.0, 0.0, 4e-3, "bonded"), Disc(0.02, 5e-3, 3e-3, "bonded"), Disc(-0.03, 0.01)]
    table = galerkin(discs, Surface(tension=50.0, membrane=400.0), 3, 2).table
    panels = [(0.0, 4.0), (4.0, 8.0), (512.0, 1024.0), (2048.0, 4096.0)]
    rules = Rules(table)
    weights = rules.weights([*panels, panels[0]])
    for i, panel in enumerate(panels):
        exact = product_weights(table, panel, rules.nodes([panel]))
        assert np.allclose(weights[i * NODES : (i + 1) * NODES], exact, rtol=0, atol=1e-12 * np.abs(exact).max())
    assert np.array_equal(weights[-NODES:], weights[:NODES])


@pytest.mark.parametrize("contact", ["frictionless", pytest.param("bonded", marks=pytest.mark.slow)])
def test_points_beside_rims_state_their_truncation_error_within_a_factor(contact, monkeypatch):
    """Stated over true, against series twice as long: at least one half, as everywhere, and less than 15."""
    radius, half = 5e-3, 22.5e-3
    cones = [Disc(x, y, radius, contact) for x in (-half, half) for y in (-half, half)]
    points = [Disc(half + radius + 1.5e-3, half), Disc(0.0, 0.0)]
    layers = [
        Layer(1.5e-3, 1100.0, lambda w: np.asarray(13e3 + 10j * w, dtype=complex)),
        Layer(4e-3, 950.0, lambda w: np.asarray(1.5e3 + 3j * w, dtype=complex)),
        Layer(math.inf, 1060.0, lambda w: np.asarray(8e3 + 8j * w, dtype=complex)),
    ]
    omega = 2 * np.pi * np.array([60.0, 250.0, 500.0])
    found = layered_compliance(layers, omega, cones, [*points, *cones])
    monkeypatch.setattr(discs_of, "_BESIDE", 14)
    truth = layered_compliance(layers, omega, cones, [*points, *cones], terms=24, orders=8)
    off, n = np.abs(found.values - truth.values), len(points)
    kinds = slice(n), slice(n, None)  # from cones to points, among cones: each over its own largest
    true = [off[:, k].max(axis=(1, 2)) / np.abs(truth.values[:, k]).max(axis=(1, 2)) for k in kinds]
    ratio = found.truncation / np.max(true, axis=0)
    assert ratio.min() > 0.5
    assert ratio.max() < 15


def test_an_azimuthal_order_that_vanishes_at_a_point_hides_no_error():
    """A point .37 mm from a rim lies where the last order taken does little: from its change alone .16 to .38 of the
    error was stated at these frequencies, and 12 to 60 times it elsewhere."""
    radius, half = 5.783e-3, 16.144e-3
    cones = [Disc(x, y, radius, "frictionless") for x in (-half, half) for y in (-half, half)]
    points, omega = [Disc(18.192e-3, 10.344e-3), Disc(0.0, 0.0)], 2 * np.pi * np.array([80.0, 200.0])
    body = [Layer(math.inf, 1060.0, lambda w: np.asarray(10e3 + 4j * w, dtype=complex))]
    found, truth = (layered_compliance(body, omega, cones, points, orders=orders) for orders in (None, 9))
    off, size = (np.abs(x).max(axis=(1, 2)) for x in (found.values - truth.values, truth.values))
    assert (found.truncation > 0.5 * off / size).all()
    assert (found.truncation < 5 * off / size).all()


def test_points_beside_each_other_cost_no_more_than_those_apart():
    """Two points .05 mm apart, as a rig's aim lays them: only what drives is integrated, and G stays what it was."""
    discs, near = [Disc(-9e-3, 0.0, A, "bonded"), Disc(9e-3, 0.0, A, "bonded")], Disc(2e-3, 6e-3)
    close, apart = Disc(2.05e-3, 6e-3), Disc(-5e-3, -7e-3)
    one, other = (solved(discs, [*discs, near, p], OMEGA[1:2], tolerance=1e-6) for p in (close, apart))
    assert one.n_kernel <= other.n_kernel
    finest = [galerkin([*discs, near, close], Surface(), 4, 2, silent=s).table.smallest for s in ((), (2, 3))]
    assert finest == pytest.approx([0.05e-3, A])
    driven = solved([*discs, near], [*discs, near, close], OMEGA[1:2], tolerance=1e-6)
    assert relative(one.values, driven.values[:, :, :2]).max() < 1e-6
    assert np.allclose(driven.values[:, 2, :2], driven.values[:, :2, 2], rtol=1e-12)


def test_truncation_judged_at_few_frequencies_is_the_larger_of_their_neighbours():
    discs = [Disc(-9e-3, 0.0, A, "bonded"), Disc(9e-3, 0.0, A, "bonded")]
    omega = 2 * np.pi * np.array([300.0, 60.0, 500.0, 130.0, 400.0])  # rising: 1, 3, 0, 4, 2
    every, some = (solved(discs[:1], discs, omega, tolerance=1e-6, judged=n) for n in (1, 2))
    assert np.array_equal(every.values.shape, some.values.shape)
    assert relative(some.values, every.values).max() < 1e-10  # eliminated at once, or order by order
    full = every.truncation
    assert np.allclose(some.truncation[[1, 0, 2]], full[[1, 0, 2]], rtol=1e-6)
    assert np.allclose(some.truncation[[3, 4]], [max(full[1], full[0]), max(full[0], full[2])], rtol=1e-6)
