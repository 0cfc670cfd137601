"""The whole way through on a tiny block: files, reuse, resumption, physics of what comes out."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from forearm_fem.engines import fem
from forearm_fem.engines.fem import FemSolution, field_modes
from forearm_fem.errors import SolverError
from forearm_fem.fem.linear import direct
from forearm_fem.fem.linear.factor import available_backends
from forearm_fem.fem.reduction import expansion as expand
from forearm_fem.fem.reduction import rate_space as krylov
from forearm_fem.fem.reduction import sweep
from forearm_fem.fem.reduction.expansion import Expansion, Snapshots
from forearm_fem.files.mat import read_thesis_mat
from forearm_fem.geometry.mesh.tissue_mesh import with_finer_skin
from forearm_fem.questions.run import Run, run_all, run_render, run_solve
from forearm_fem.results.files import read_compliance, read_transfer
from forearm_fem.results.run import read_run
from forearm_fem.scenario import parse_scenario
from forearm_fem.scenario.sweep import ReducedSolve
from forearm_fem.store.shelf import Shelf
from forearm_fem.transfer import Compliance
from forearm_fem.verification.scenes import held_block

TINY = {
    "name": "tiny",
    "accuracy": 0.5,
    "limb": {"shape": "slab", "length": 0.05, "width": 0.05, "depth": 0.012},
    "mesh": {
        "size_contact": 0.008,
        "size_grid": 0.014,
        "size_far": 0.02,
        "sublayers": {"skin": 1, "fat": 1},
    },
    "device": {"cone": {"contact": "pressure"}, "spacing": 0.03},
    "sweep": {"f_min": 20, "f_max": 200, "duration": 0.2, "sample_rate": 2000},
    "solver": {"derivatives": 3, "expansions": 2},
    "rendering": {"wavelet": {"peak": 80}},
}


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    """A cache of its own, so that nothing made before counts."""
    patch = pytest.MonkeyPatch()
    where = tmp_path_factory.mktemp("cache")
    patch.setenv("FOREARM_FEM_CACHE", str(where))
    yield where
    patch.undo()


@pytest.fixture(scope="module")
def finished(home, tmp_path_factory):
    """Results of a complete run."""
    out = tmp_path_factory.mktemp("results") / "tiny"
    run_all(Run.start(parse_scenario(TINY), out, Path()))
    return out


def test_a_run_states_what_its_mesh_errs_by_at_each_pair_of_ports(finished):
    """Of the largest pair that is e(f), kept in single precision; far points move and err by less than half of it."""
    error = next(e for e in read_transfer(finished / "transfer.nc").errors if e.source == "discretisation")
    assert error.per_pair.max(axis=(1, 2)) == pytest.approx(error.per_frequency, rel=1e-6)
    assert np.median(error.per_pair.min(axis=(1, 2)) / error.per_frequency) < 0.5
    line = next(x for x in (finished / "report.html").read_text().splitlines() if "entries err by" in x)
    assert "←" in line


def test_a_run_leaves_every_file_that_is_promised(finished):
    promised = [
        "transfer.nc",
        "transfer.mat",
        "drives.nc",
        "displacements.nc",
        "signal_strength.csv",
        "mesh.vtu",
        "report.md",
        "report.html",
        "run.json",
        "scenario.json",
        "wavefield.nc",
    ]
    assert [name for name in promised if not (finished / name).is_file()] == []
    assert [p for p in finished.rglob("*") if p.name.startswith(".")] == []  # nothing half-written


def test_the_account_names_every_source_of_error(finished):
    account = json.loads((finished / "run.json").read_text())
    assert {e["source"] for e in account["errors"]} >= {"discretisation", "truncation", "reduction", "linear solve"}
    assert all(e["band"] > 0 for e in account["errors"])  # what is zero is no estimate
    assert account["mesh"]["sha256"]
    assert account["stages"]["solve"]["peak_memory_bytes"] > 1e6


def test_the_solver_that_was_used_is_on_record(finished):
    account = json.loads((finished / "run.json").read_text())
    used = account["solution"]["solver"]
    assert used in available_backends()
    assert read_transfer(finished / "transfer.nc").provenance["solver"] == used
    assert f"<td>direct solver</td><td>{used}</td>" in (finished / "report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("left", [0, 1000, 100_000])
def test_a_snapshot_that_was_cut_off_is_none(tmp_path, left):
    """A resumed solve is that of one go to the bit, so what is kept has all its digits."""
    store = Snapshots(Shelf(tmp_path / "parts.sqlite"))
    random = np.random.default_rng(0)
    series = tuple(random.normal(size=(20_000, 2)) + 1j for _ in range(2))
    store.put(Expansion(50.0, series, 1e-9, 1e-10))
    kept = store.get(50.0)
    assert np.array_equal(kept.series, series)
    assert (kept.residual, kept.solve_error) == (1e-9, 1e-10)
    file = next(tmp_path.rglob("*.sqlite"))
    file.write_bytes(file.read_bytes()[:left])
    assert store.get(50.0) is None


def test_compliance_is_reciprocal_and_passive(finished):
    c = read_compliance(finished / "transfer.nc").values
    off = ~np.eye(c.shape[1], dtype=bool)
    swapped = c.swapaxes(1, 2)
    # the reduced model is symmetric term by term: only rounding is left
    assert np.abs((c - swapped)[:, off]).max() < 1e-9 * np.abs(c[:, off]).max()
    driving = c[:, range(4), range(4)]
    assert np.all(driving.imag <= 0)  # e^{+i omega t}: a passive limb takes in power


def test_the_matlab_file_is_two_sided_and_hermitian(finished):
    g = read_thesis_mat(finished / "transfer.mat").values
    one = read_transfer(finished / "transfer.nc").values
    assert g.shape == one.shape


def test_a_second_run_solves_nothing(finished, home, monkeypatch):
    def forbidden(*_args, **_kwargs):
        raise AssertionError("a factorisation was made again")

    monkeypatch.setattr(direct, "make_factor", forbidden)
    run_render(Run.start(parse_scenario(TINY), finished, Path()))


def test_a_new_coil_needs_no_new_solve(finished, home, monkeypatch, tmp_path):
    monkeypatch.setattr(direct, "make_factor", lambda *_a, **_k: pytest.fail("a factorisation was made"))
    heavier = parse_scenario({**TINY, "device": {"cone": {"contact": "pressure", "mass": 0.002}, "spacing": 0.03}})
    other = run_solve(Run.start(heavier, tmp_path / "heavier", Path()))
    before = read_transfer(finished / "transfer.nc")
    assert np.abs(other.values - before.values).max() > 0.01 * np.abs(before.values).max()


def test_what_the_field_leaves_out_of_the_housing_is_said(finished, home, tmp_path):
    """Points follow a share of the housing, the field between them does not: films would show less in silence."""
    share = "device.housing.skin_share: pictures, films and wavefield.nc leave out"
    assert not any(note.startswith(share) for note in read_run(finished / "run.json").notes)
    for k, housing in enumerate(({"skin_share": 0.03}, {"fixed": True})):
        scenario = parse_scenario({**TINY, "device": {**TINY["device"], "housing": housing}})
        run_solve(Run.start(scenario, tmp_path / str(k), Path()))
        notes = read_run(tmp_path / str(k) / "run.json").notes
        assert any(note.startswith(share) for note in notes) == (k == 0)


def interrupted_then_resumed(monkeypatch, tmp_path, stage, done, **solver):
    """A run that is stopped at ``done`` of a ``stage``, then the whole one."""
    monkeypatch.setenv("FOREARM_FEM_CACHE", str(tmp_path / "cache"))
    options = {**TINY["solver"], "discretisation_estimate": False, **solver}
    scenario = parse_scenario({**TINY, "solver": options})

    def stop_there(*reported):
        if reported[:2] == (stage, done):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_solve(Run.start(scenario, tmp_path / "out", Path(), stop_there))
    assert not (tmp_path / "out" / "transfer.nc").exists()
    seen, original = [], direct.DirectSolver.at
    monkeypatch.setattr(direct.DirectSolver, "at", lambda self, f: (seen.append(f), original(self, f))[1])
    return scenario, seen, run_solve(Run.start(scenario, tmp_path / "out", Path()))


def test_an_interrupted_sweep_goes_on_where_it_stopped(monkeypatch, tmp_path):
    how = ("expansion frequencies", 1)
    scenario, seen, resumed = interrupted_then_resumed(monkeypatch, tmp_path, *how, start="frequencies")
    planned = expand.expansion_frequencies(resumed.frequency, scenario.solver)
    assert planned[0] not in seen  # stored by the first run
    assert planned[1] in seen


def test_a_field_read_from_the_cache_has_the_bits_of_the_one_solved(monkeypatch, tmp_path):
    monkeypatch.setenv("FOREARM_FEM_CACHE", str(tmp_path / "cache"))
    scenario = parse_scenario({**TINY, "solver": {**TINY["solver"], "discretisation_estimate": False}})
    solved, read = (Run.start(scenario, tmp_path / out, Path()) for out in ("solved", "read"))
    run_solve(solved)
    monkeypatch.setattr(fem, "solve_fem", None)  # nothing is solved again
    run_solve(read)
    fields = [run.known["wavefield"] for run in (solved, read)]
    assert fields[0].amplitudes.tobytes() == fields[1].amplitudes.tobytes()


@pytest.mark.slow  # 3 s; the sweep above is stored alike
def test_an_interrupted_space_about_a_rate_goes_on_where_it_stopped(monkeypatch, tmp_path, finished):
    """The same G as without the interruption, and only what was missing is solved again."""
    counted, original = [], krylov.RateSpace.more
    monkeypatch.setattr(krylov.RateSpace, "more", lambda self, n: (counted.append(n), original(self, n))[1])
    resumed = interrupted_then_resumed(monkeypatch, tmp_path, "reduced model", 10)[2]
    whole = read_transfer(finished / "transfer.nc")
    derivatives = json.loads((finished / "run.json").read_text())["solution"]["derivatives"]
    assert sum(counted) == derivatives > 10
    assert np.array_equal(resumed.values, whole.values)


def test_too_little_memory_is_refused_beforehand(home, tmp_path):
    scenario = parse_scenario({**TINY, "solver": {**TINY["solver"], "memory_limit": 1e6}})
    with pytest.raises(SolverError, match="memory_limit"):
        run_solve(Run.start(scenario, tmp_path / "out", Path()))


def test_modes_times_states_are_displacements_at_vertices_and_edges():
    """Against a direct solve, each place's node found by where it lies: all of them are nodes of P2."""
    model, band, options = held_block(2), np.linspace(20.0, 300.0, 57), ReducedSolve()
    result = sweep.reduced_sweep(model, band, options, tolerance=1e-6)
    modes = field_modes(FemSolution(Compliance(band, result.values, model.ports), result, model))
    found = modes @ result.states(np.array([150.0]), [0])[0, :, 0]
    nodes = model.displacements(direct.make_solver(model, options, 150.0).at(150.0).values[:, 0])
    distance, there = cKDTree(model.space.node_points).query(with_finer_skin(model.space.mesh).points)
    assert distance.max() < 1e-12
    # G is certified to 1e-6; its error is the product of two solutions' errors, so one of these may be 1e-3
    assert np.abs(found - nodes[there]).max() < 3e-4 * np.abs(nodes).max()
