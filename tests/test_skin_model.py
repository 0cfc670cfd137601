"""The saved reduced model: the same numbers from the file, other frequencies, other tissues."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import once

from forearm_fem.engines.skin_model import load_skin_model, save_skin_model
from forearm_fem.errors import AccuracyWarning, DataError, ReductionError, ScenarioError
from forearm_fem.questions.run import Run, run_solve
from forearm_fem.results.files import read_transfer
from forearm_fem.scenario import parse_scenario
from forearm_fem.transfer import relative_error

SCENE = {
    "name": "small",
    "limb": {
        "shape": "slab", "length": 0.05, "width": 0.04, "depth": 0.012,
        "layers": [{"tissue": "skin", "thickness": 1.2e-3}],
    },
    "device": {"contacts": [[0.0, 0.0]], "cone": {"contact": "pressure"}},
    "grid": {"points": [[0.012, 0.0]]},
    "mesh": {"size_contact": 4.5e-3, "size_grid": 8e-3, "size_far": 12e-3, "sublayers": {"skin": 1}},
    "solver": {"discretisation_estimate": False},
    "sweep": {"f_min": 40.0, "f_max": 400.0},
}  # fmt: skip


def solve(folder):
    """What a run of this scene leaves in ``folder``."""
    run_solve(Run.start(parse_scenario(SCENE), folder / "out", folder))


@pytest.fixture(scope="session")
def solved(tmp_path_factory):
    folder = once(tmp_path_factory, "skin_model", solve) / "out"
    return folder, read_transfer(folder / "transfer.nc")


def test_file_gives_the_run_again_at_its_bins(solved):
    folder, transfer = solved
    found = load_skin_model(folder / "reduced.nc").transfer(transfer.frequency)
    assert relative_error(found.values, transfer.values).max() < 1e-12  # the same poles and residues


def test_poles_of_the_file_are_those_of_its_matrices(solved):
    """Files of before 0.12.1 hold none: each evaluation then diagonalises anew, and so it is for other tissues."""
    folder, transfer = solved
    model = load_skin_model(folder / "reduced.nc")
    assert model.poles is not None
    anew = replace(model, poles=None).transfer(transfer.frequency)
    assert relative_error(anew.values, transfer.values).max() < 1e-9  # rounding of another diagonalisation
    assert model.changed(["tissues.override.muscle.mu=12000.0"]).poles is None


def test_file_is_small_and_gives_any_frequency(solved):
    folder, _ = solved
    assert (folder / "reduced.nc").stat().st_size < 5e6
    between = load_skin_model(folder / "reduced.nc").transfer(np.array([100.0, 100.25, 100.5])).values
    assert relative_error(between[1:2], between[[0, 2]].mean(axis=0)[None]).max() < 1e-4  # curvature over half a hertz


def test_other_moduli_follow_without_a_mesh(solved, tmp_path):
    """Against a solve made anew; 1e-2 of room because the space was made for the old modulus."""
    folder, _ = solved
    change = "tissues.override.muscle.mu=12000.0"
    anew = parse_scenario({**SCENE, "tissues": {"override": {"muscle": {"mu": 12000.0}}}})
    exact = run_solve(Run.start(anew, tmp_path / "out", tmp_path))
    model = load_skin_model(folder / "reduced.nc")
    assert relative_error(model.changed([change]).transfer(exact.frequency).values, exact.values).max() < 1e-2
    assert relative_error(model.transfer(exact.frequency).values, exact.values).max() > 2e-2


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ("limb.depth=0.02", "limb"),
        ("device.cone.radius=0.004", "device"),
        ("device.actuator='ERM'", "device.actuator"),
        ("tissues.override.muscle.bulk=1e8", "tissues.override.muscle"),
        ("tissues.membrane.tension=5.0", "tissues.membrane"),
    ],
)
def test_what_it_cannot_follow_is_refused(solved, change, key):
    with pytest.raises(ScenarioError, match=f"^{key}"):
        load_skin_model(solved[0] / "reduced.nc").changed([change])


def test_unstable_model_is_refused_outside_its_band(solved, tmp_path):
    """From the file alone: as of a version that kept pressures that were noise; 5 % beyond are allowed."""
    folder, _ = solved
    model = load_skin_model(folder / "reduced.nc")
    assert model.reduced.negative_directions() == 0
    with pytest.warns(AccuracyWarning, match=r"2 frequencies lie outside the band of this reduced model, 40 to 400 Hz"):
        assert np.isfinite(model.transfer(np.array([5.0, 100.0, 900.0])).values).all()  # stable
    matrices = model.reduced.matrices.copy()
    matrices[model.reduced.names.index("compression")][-1, -1] -= 10 * np.abs(matrices).max()
    save_skin_model(tmp_path / "bad.nc", replace(model, reduced=replace(model.reduced, matrices=matrices)))
    bad = load_skin_model(tmp_path / "bad.nc")
    bad.compliance(np.array([39.0, 200.0, 410.0]))
    for f in (30.0, 450.0):
        with pytest.raises(ReductionError, match=f"{f:g} Hz is outside the band .* unstable poles"):
            bad.compliance(np.array([200.0, f]))
        with pytest.raises(ReductionError):
            bad.changed(["tissues.override.muscle.mu=12000.0"]).transfer(np.array([f]))


@pytest.mark.parametrize("frequency", [[], [100.0, np.nan], [-50.0], [[100.0]]])
def test_what_is_no_frequency_is_refused(solved, frequency):
    with pytest.raises(DataError, match="expected a row of one or more, finite and not negative"):
        load_skin_model(solved[0] / "reduced.nc").transfer(np.array(frequency))


def test_damaged_file_is_refused(solved, tmp_path):
    broken = tmp_path / "reduced.nc"
    broken.write_bytes((solved[0] / "reduced.nc").read_bytes()[:2000])
    with pytest.raises(DataError, match=r"reduced\.nc"):
        load_skin_model(broken)
