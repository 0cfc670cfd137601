"""The estimate from two meshes: its rule by itself; against true errors it is tested in verification and benchmarks."""

from __future__ import annotations

import numpy as np
import pytest

from forearm_fem.accuracy.discretisation import (
    COARSER,
    LOST,
    SECOND_ORDER,
    THIRD_ORDER,
    discretisation_of,
    estimated_errors,
    order_of,
    over_pairs,
    remaining_error,
)
from forearm_fem.ports import Port
from forearm_fem.scenario import parse_scenario
from forearm_fem.transfer import TransferMatrix


@pytest.mark.parametrize("ratio", [COARSER, 1.7, 1.3, 0.8, 2 / 3, 1.5])
def test_any_ratio_recovers_an_error_of_the_assumed_order(ratio):
    """C h^p changes by C h^p |ratio^p - 1|."""
    for order in (SECOND_ORDER, THIRD_ORDER):
        change = np.array([0.001 * abs(ratio**order - 1)])
        assert remaining_error(change, ratio, order) == pytest.approx(0.001)


def test_of_a_change_of_a_mesh_that_carries_no_waves_less_is_left():
    """Its G is another one, whose difference tells nothing of the first mesh's order: four times the change, twice the
    error. e_band is not e(f)'s: a lost frequency of little energy leaves the others' error as it is."""
    begins, more = remaining_error(LOST * np.array([1.0, 4.0]))
    assert more == pytest.approx(2 * begins)
    own = np.array([1.0, 0.1]).reshape(2, 1, 1) * np.ones((2, 2, 2), dtype=complex)
    other = own * np.array([1.1, 1 + 4 * LOST]).reshape(2, 1, 1)
    found = estimated_errors(other, own, np.array([100.0, 400.0]))
    assert found.error == pytest.approx(begins * np.array([0.1 / LOST, 2.0]))
    assert found.band == pytest.approx(np.hypot(found.error[0], 0.1 * found.error[1]) / np.hypot(1.0, 0.1))


@pytest.mark.parametrize(("element", "order"), [("P2", SECOND_ORDER), ("P2/P3", THIRD_ORDER), ("P3", THIRD_ORDER)])
def test_the_order_is_that_of_the_elements_around_the_ports(element, order):
    assert order_of(parse_scenario({"mesh": {"element": element}})) == order


@pytest.fixture
def two_meshes():
    """G_h = G + c h^2 on sizes h and COARSER h."""
    rng = np.random.default_rng(1)
    truth, c = (rng.normal(size=(5, 9, 4)) + 1j * rng.normal(size=(5, 9, 4)) for _ in range(2))
    return truth, truth + 1e-3 * COARSER**SECOND_ORDER * c, truth + 1e-3 * c


FAR_APART = np.array([10.0, 20.0, 40.0, 80.0, 160.0])


def test_exact_for_an_error_of_the_assumed_order(two_meshes):
    truth, coarse, fine = two_meshes
    found = estimated_errors(coarse, fine, FAR_APART)
    assert found.band == pytest.approx(np.linalg.norm(fine - truth) / np.linalg.norm(fine))
    assert found.error == pytest.approx(np.abs(fine - truth).max((1, 2)) / np.abs(fine).max((1, 2)))


def test_g_states_the_error_by_its_second_mesh_and_what_all_pairs_do_together(two_meshes):
    """Errors that lie along the change are as large as the error itself: C - e is the truth."""
    truth, coarse, fine = two_meshes
    points = tuple(Port(f"P{k}", "point", (0.01 * k, 0.0, 0.0)) for k in range(9))
    contacts = tuple(Port(f"A{k}", "contact", (0.01 * k, 0.02, 0.0)) for k in range(4))
    own, other = (
        TransferMatrix(FAR_APART, values, points, contacts, provenance={"ratio": COARSER}) for values in (fine, coarse)
    )
    found = discretisation_of(own, other, parse_scenario({"mesh": {"element": "P2"}}))
    assert found.band == pytest.approx(np.linalg.norm(fine - truth) / np.linalg.norm(fine))
    assert found.per_pair.max(axis=(1, 2)) == pytest.approx(np.array(found.per_frequency))
    size = np.abs(fine).max(axis=(1, 2), keepdims=True)
    assert found.together * size == pytest.approx((coarse - fine) / (COARSER**SECOND_ORDER - 1), rel=1e-2)  # of norms


def test_a_frequency_where_two_meshes_agree_by_chance_states_its_neighbours_change(two_meshes):
    """Three frequencies in one neighbourhood, no change at the middle one: the error of the three together."""
    _, coarse, fine = two_meshes
    coarse = coarse.copy()
    coarse[2] = fine[2]
    alone = estimated_errors(coarse, fine, FAR_APART).error
    error = estimated_errors(coarse, fine, np.array([10.0, 36.0, 40.0, 45.0, 160.0])).error
    size = np.abs(fine).max((1, 2))[1:4]
    assert alone[2] == 0.0
    assert error[2] == pytest.approx(np.linalg.norm(alone[1:4] * size) / np.linalg.norm(size))
    assert (error >= alone * (1 - 1e-12)).all()
    assert error[[0, 4]] == pytest.approx(alone[[0, 4]])


def test_what_is_stated_for_one_frequency_needs_no_neighbours(two_meshes):
    _, coarse, fine = two_meshes
    whole = estimated_errors(coarse, fine, FAR_APART).error
    assert estimated_errors(coarse[:1], fine[:1], FAR_APART[:1]).error == pytest.approx(whole[:1])


def test_pairs_share_an_error_as_they_change_and_the_largest_has_all_of_it():
    """Errors of the product of what two ports lack: each pair's is found to the scatter of a third of an octave of
    random phases, here 60 frequencies or more (their root mean square scatters by 1 / sqrt(2 60) = 9 %; four times)."""
    rng, frequency = np.random.default_rng(0), np.arange(140.0, 500.0)
    lacks = np.outer([1.0, 0.3, 0.02], [1.0, 0.5])
    phase = rng.normal(size=(360, 3, 2)) + 1j * rng.normal(size=(360, 3, 2))
    own, stated = np.ones((360, 3, 2), dtype=complex), np.linspace(0.01, 0.2, 360)
    pairs = over_pairs(stated, own + 1e-3 * lacks * phase, own, frequency)
    assert pairs.max(axis=(1, 2)) == pytest.approx(stated)
    assert np.abs(pairs[100:-100] / stated[100:-100, None, None] / lacks - 1).max() < 0.4


def test_a_pair_that_changes_by_chance_as_little_as_nothing_is_not_taken_to_be_known():
    """Its output and its input change by half and by all of the largest in the mean, so it has about half of that."""
    own, frequency = np.ones((50, 2, 2), dtype=complex), np.linspace(100.0, 500.0, 50)
    change = np.array([[1.0, 1.0], [0.7, 0.0]])
    pairs = over_pairs(np.full(50, 0.1), own + 0.01 * change, own, frequency)
    rows, columns, whole = (np.square(change).mean(axis=a) for a in (1, 0, None))
    assert pairs[:, 1, 1] == pytest.approx(0.1 * np.sqrt(rows[1] * columns[1] / whole))


def test_an_error_that_changes_nothing_is_shared_alike():
    own, error = np.ones((2, 3, 2), dtype=complex), np.array([0.1, 0.2])
    assert (over_pairs(error, own, own, np.array([100.0, 200.0])) == error[:, None, None]).all()
