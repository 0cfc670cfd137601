"""Finite elements on slabs against Miller and Pursey's half-space and the layered model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from slabs import CONVERGENCE, LEVELS, REFERENCE, SCENES, effectivities, errors_of, exact, scene_name, solve_level

from forearm_fem.accuracy.discretisation import COARSER, remaining_error


def test_a_coarse_slab_meets_the_layered_model():
    """Preset O at 300 Hz on 18 000 unknowns: 2.1 % at the points, 1 % under the disc, seen; half as much again."""
    coarse = replace(CONVERGENCE, grading=CONVERGENCE.grading / 1.5)  # its growth follows the scale, as sizes do
    disc, points = errors_of(solve_level(coarse, 1.5), exact(CONVERGENCE))
    assert disc < 0.015
    assert points < 0.03


@pytest.mark.slow
def test_three_levels_converge_and_state_their_error():
    """Order 2 at least: below 3, as sizes grow away from the ports and the coarsest mesh has 3 elements a wave."""
    truth, scales = exact(LEVELS), (2.0, COARSER, 1.0)
    levels = [solve_level(LEVELS, scale) for scale in scales]
    found = [errors_of(level, truth)[1] for level in levels]
    assert np.log(found[0] / found[-1]) / np.log(scales[0] / scales[-1]) > 2
    assert found[-1] < 0.02
    change = np.abs(levels[1] - levels[-1])[1:].max() / np.abs(levels[-1][1:]).max()
    assert 0.5 < float(remaining_error(change)) / found[-1] < 5


@pytest.mark.slow
@pytest.mark.parametrize("slab", REFERENCE, ids=scene_name)
def test_reference_scenes_are_met(slab):
    """1 % under the disc, of which the rim's polygon takes half, and e(f) of 2 % over r = 10-31.8 mm."""
    disc, points = errors_of(solve_level(slab), exact(slab))
    assert disc < 0.01
    assert points < 0.02


@pytest.mark.slow
@pytest.mark.parametrize("slab", SCENES, ids=scene_name)
def test_estimated_errors_are_half_to_five_times_the_true_ones(slab):
    """Over three frequencies, on two meshes a scene; 0.54 to 4.9 seen. The last five scenes had no part in the rule."""
    for found in effectivities([slab]):
        assert 0.5 < found.band < 5, found
