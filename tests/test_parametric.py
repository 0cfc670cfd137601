"""One reduced model for many arms: draws that it has not seen against direct solves, its statements, its borders."""

from __future__ import annotations

import itertools
import sqlite3
from dataclasses import replace

import numpy as np
import pytest

from forearm_fem.device import close_loop
from forearm_fem.engines import parametric
from forearm_fem.engines.fem import fem_model
from forearm_fem.engines.layered import LayeredArm, flat_ports
from forearm_fem.engines.parametric import ParametricModel, Ranges, parametric_model
from forearm_fem.errors import DataError, ReductionError, ScenarioError, SolverError
from forearm_fem.fem.linear.direct import DirectSolver
from forearm_fem.fem.reduction.basis import Basis, rough_extension
from forearm_fem.fem.reduction.parametric_greedy import Growing, Growth, TrialSolve
from forearm_fem.fem.reduction.per_query_basis import Summed, _solved, quick_compliance, spanned
from forearm_fem.fem.reduction.rational import chebyshev_frequencies, rational
from forearm_fem.fem.reduction.sweep import direct_sweep
from forearm_fem.geometry.build import cached_mesh
from forearm_fem.geometry.device.place import GridPlaces
from forearm_fem.questions.compare.fit import fit
from forearm_fem.questions.compare.parameters import (
    ScenarioModel,
    common_parameters,
    fem_meshes_for,
    fem_model_for,
)
from forearm_fem.questions.compare.run import run_fit
from forearm_fem.questions.predict.arm import ReducedArm, _nearness, arm_model, with_scene_geometry
from forearm_fem.questions.predict.draws import draw_inputs, load_priors, scenario_of, tape_parameters
from forearm_fem.scenario import Scenario, load_scenario, parse_scenario
from forearm_fem.scenario.model import resolve_tissues
from forearm_fem.scenario.sweep import frequencies
from forearm_fem.store.record import load, save
from forearm_fem.store.shelf import Shelf
from forearm_fem.transfer import Compliance, band_error

SCENE = {
    "name": "small",
    "limb": {
        "shape": "slab", "length": 0.05, "width": 0.04, "depth": 0.012,
        "layers": [{"tissue": "skin", "thickness": 1.2e-3}, {"tissue": "fat", "thickness": 3e-3}],
    },
    "device": {"contacts": [[-0.012, 0.0], [0.012, 0.004]], "cone": {"contact": "pressure"}},
    "grid": {"points": [[0.0, 0.003], [0.002, -0.009]]},
    "mesh": {"size_contact": 4.5e-3, "size_grid": 8e-3, "size_far": 12e-3, "sublayers": {"skin": 1, "fat": 1}},
    "solver": {"discretisation_estimate": False},
    "sweep": {"f_min": 20.0, "f_max": 500.0},
}  # fmt: skip
THICK = {
    **SCENE,
    "limb": {**SCENE["limb"], "layers": [SCENE["limb"]["layers"][0], {"tissue": "fat", "thickness": 4.5e-3}]},
    "grid": {"points": [[0.0, 0.005], [0.002, -0.007]]},
}
COARSE = {"size_contact": 7.2e-3, "size_grid": 12.8e-3, "size_far": 19.2e-3, "sublayers": {"skin": 1, "fat": 1}}
_SOFT = (("skin", 13e3, 3.0), ("fat", 5e3, 1.5), ("muscle", 1e4, 4.0))
STIFF = {name: {"mu": 5 * mu, "eta": 5 * eta} for name, mu, eta in _SOFT}
LOW = np.array([40.0, 80.0, 130.0, 190.0])
PROBES = np.array([20.0, 80.0, 200.0, 330.0, 490.0])
CHECKS = (TrialSolve(0, 100.0, 0.01, 0.03),)
GROWTH = Growth(rate=20, solves=11, checks=5, of_points=4, parts=2, states=50)


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("FOREARM_FEM_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(scope="module")
def model(cache):
    return parametric_model(parse_scenario(SCENE), growth=GROWTH)


def solved(draw: Scenario, frequency: np.ndarray = PROBES) -> np.ndarray:
    """Compliance (n_frequency, n_point, n_contact) of a draw by direct solves."""
    model = fem_model(draw, cached_mesh(draw))
    return direct_sweep(model, frequency, draw.solver).values[:, 2:, :2]


def test_unseen_draws_are_as_right_as_stated(model):
    """One of each law, of a hypercube of another seed; asked is 2 %, and to be stated."""
    for draw in Ranges().draws(parse_scenario(SCENE), 3, seed=99):
        found = model.compliance(draw, PROBES)
        true = band_error(found.block("point", "contact"), solved(draw))
        assert true < 0.02
        assert true < found.errors[0].band < 0.2


def taped(scenario: Scenario, thickness: float, modulus: float) -> Scenario:
    return scenario.changed({f"tissues.patch.{k}": v for k, v in tape_parameters(thickness, modulus).items()})


@pytest.mark.slow
def test_unseen_tape_is_as_right_as_stated(cache):
    """Tape of other thickness and modulus on other tissue; it changes G by a third."""
    bare = parse_scenario({**SCENE, "mesh": {**COARSE, "element": "P2"}})
    kinds = itertools.product((1.1e-4, 2e-4), (1e8, 4.5e9))
    pool = [taped(d, *kind) for d, kind in zip(Ranges().draws(bare, 8), itertools.cycle(kinds), strict=False)]
    model = parametric_model(bare, draws=pool, growth=replace(SMALL, rate=10, parts=1))
    draw = Ranges().draws(bare, 1, seed=99)[0]
    on = taped(draw, 1.7e-4, 2e9)
    found = model.compliance(on, PROBES)
    true, without = (solved(s) for s in (on, draw))
    assert band_error(without, true) > 0.2
    assert band_error(found.block("point", "contact"), true) < found.errors[0].band < 0.2


@pytest.mark.slow
def test_far_outside_its_ranges_the_error_is_still_stated(model):
    """Tissue forty times softer than any draw: beyond what the space can do, and said."""
    far = Ranges(moduli=1.0, laws=("zener",)).draws(softer(40.0), 2, seed=3)[1]
    found = model.compliance(far, PROBES)
    true = band_error(found.block("point", "contact"), solved(far))
    assert true > 0.05
    assert found.errors[0].band > true


def softer(factor: float) -> Scenario:
    scenario = parse_scenario(SCENE)
    tissues = resolve_tissues(scenario)
    moduli = {n: {"mu": tissues[n].modulus.mu / factor} for n in ("skin", "fat", "muscle")}
    return parse_scenario({**SCENE, "tissues": {"override": moduli}})


def test_all_bins_follow_from_few(model):
    """The rational function between solved frequencies errs by less than it says."""
    scenario = parse_scenario(SCENE)
    for draw in Ranges().draws(scenario, 3, seed=5):
        band = frequencies(scenario.sweep)
        whole, some = model.compliance(draw, band), slice(None, None, 24)
        exact = model.compliance(draw, band[some])
        contact = whole.block("point", "contact")[some]
        assert np.abs(contact - exact.block("point", "contact")).max() < 5e-3 * np.abs(contact).max()
        values = np.nan_to_num(whole.values)
        assert np.array_equal(values, values.swapaxes(1, 2))  # a slab that is whole: reciprocal to the last digit


def test_draws_are_passive(model):
    """No force on the contacts gives energy: -Im C is positive semi-definite for every law."""
    for draw in Ranges().draws(parse_scenario(SCENE), 6, seed=7):
        under = model.compliance(draw, frequencies(draw.sweep)[::8]).block("contact", "contact")
        lost = -(under.imag + under.imag.swapaxes(1, 2)) / 2
        assert np.linalg.eigvalsh(lost).min() > -1e-3 * np.abs(under).max()  # what lies between solved frequencies


def test_springs_gains_and_coils_need_no_other_model(model):
    changed = parse_scenario({**SCENE, "device": {**SCENE["device"], "contact_springs": {"A1": 50.0}}})
    one, other = (close_loop(model.compliance(s, PROBES), s.device).values for s in (parse_scenario(SCENE), changed))
    assert np.linalg.norm(other - one) > 0.05 * np.linalg.norm(one)


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"limb": {**SCENE["limb"], "depth": 0.013}}, "limb"),
        ({"grid": {"points": [[0.0, 0.003]]}}, "grid"),
        ({"device": {**SCENE["device"], "rotation": 0.1}}, "device"),
        ({"tissues": {"override": {"fat": {"bulk": 1e8}}}}, "tissues.override.fat"),
        ({"tissues": {"membrane": {"mass": 0.1}}}, "tissues.membrane"),
    ],
)
def test_another_geometry_is_refused(model, change, key):
    with pytest.raises(ScenarioError, match=f"^{key}"):
        model.compliance(parse_scenario({**SCENE, **change}), PROBES)


def test_frequencies_beyond_the_band_are_refused(model):
    with pytest.raises(ReductionError, match="600 Hz is outside the band"):
        model.compliance(parse_scenario(SCENE), np.array([100.0, 600.0]))


def test_the_layered_model_needs_none():
    with pytest.raises(ScenarioError, match="engine"):
        parametric_model(parse_scenario({**SCENE, "engine": "layered"}))


def test_it_is_made_once_and_read_back(model, tmp_path, monkeypatch):
    monkeypatch.setattr(parametric, "united_model", None)  # whatever is made again ends here
    again = parametric_model(parse_scenario(SCENE), growth=GROWTH)
    draw = Ranges().draws(parse_scenario(SCENE), 2, seed=11)[1]
    first, second = (m.compliance(draw, PROBES) for m in (model, again))
    assert np.array_equal(np.nan_to_num(first.values), np.nan_to_num(second.values))
    assert first.errors == second.errors
    assert again.checks == model.checks
    with pytest.raises(TypeError):
        parametric_model(parse_scenario(SCENE), growth=Growth(solves=9))
    save(tmp_path / "parametric.nc", model)
    broken = bytearray((tmp_path / "parametric.nc").read_bytes())
    broken[len(broken) // 2] ^= 0xFF
    (tmp_path / "parametric.nc").write_bytes(broken)
    with pytest.raises(DataError):
        load(tmp_path / "parametric.nc", ParametricModel)


SMALL = Growth(rate=5, solves=3, checks=2, parts=2, states=15)
STEPS, FACTORISED = 1 + 3 + 2 + 2, 1 + 3 + 2


@pytest.mark.slow
def test_what_was_finished_before_an_interruption_is_not_made_again(tmp_path, monkeypatch):
    """Stopped after a solve, a piece and a check, and amid a solve: factorisations are counted, results are those of an
    uninterrupted making to the last digit."""
    counted, at, about = list[str](), DirectSolver.at, DirectSolver.about_rate
    monkeypatch.setattr(DirectSolver, "at", lambda *a: (counted.append("at"), at(*a))[1])
    monkeypatch.setattr(DirectSolver, "about_rate", lambda *a: (counted.append("rate"), about(*a))[1])
    scene, told = parse_scenario({**SCENE, "mesh": COARSE}), list[tuple[int, int]]()

    def made(stop: int = 99, amid: int = 99):
        def listen(stage: str, done: int, total: int) -> None:
            if stage == "arms solved":
                told.append((done, total))
                if total - done == stop:
                    raise KeyboardInterrupt
                if total - done == amid:
                    monkeypatch.setattr(Growing, "_added", interrupt)

        return parametric_model(scene, growth=SMALL, progress=listen)

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setenv("FOREARM_FEM_CACHE", str(tmp_path / "whole"))
    whole = made()
    assert len(counted) == FACTORISED
    counted.clear()
    monkeypatch.setenv("FOREARM_FEM_CACHE", str(tmp_path / "halting"))
    added = Growing._added
    for stop, amid in ((STEPS - 2, 99), (99, STEPS - 3), (3, 99), (1, 99)):  # steps that are left
        with pytest.raises(KeyboardInterrupt):
            made(stop, amid)
        monkeypatch.setattr(Growing, "_added", added)
    halting = made()
    assert len(counted) == FACTORISED + 1  # the solve that was under way
    assert (told[0], told[-1]) == ((0, STEPS), (1, 1))  # of what is left each time
    for draw in Ranges().draws(scene, 2, seed=4):
        one, other = (m.compliance(draw, PROBES) for m in (whole, halting))
        assert np.array_equal(np.nan_to_num(one.values), np.nan_to_num(other.values))
        assert one.errors == other.errors
    assert not list((tmp_path / "halting").rglob("*-parts.sqlite"))  # nothing is left beside the finished model


@pytest.mark.slow
def test_damaged_parts_are_made_again(tmp_path, monkeypatch):
    """Half of the columns of one step are gone: the space starts anew and comes out the same."""
    monkeypatch.setenv("FOREARM_FEM_CACHE", str(tmp_path))
    scene, growth = parse_scenario({**SCENE, "mesh": COARSE}), replace(SMALL, solves=1, checks=0, parts=1)

    def stopped(stage: str, done: int, _: int) -> None:
        if (stage, done) == ("arms solved", 2):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        parametric_model(scene, growth=growth, progress=stopped)
    (file,) = tmp_path.rglob("*-parts.sqlite")
    shelf = Shelf(file)
    columns = shelf.get("columns-1")
    halves = sqlite3.connect(file)
    halves.execute("update part set data = zeroblob(length(data)) where key = 'columns-1' and name = 'columns'")
    halves.commit()
    halves.close()
    assert columns is not None
    assert shelf.get("columns-1") is None
    found = parametric_model(scene, growth=growth).compliance(scene, PROBES)
    monkeypatch.setenv("FOREARM_FEM_CACHE", str(tmp_path / "whole"))
    whole = parametric_model(scene, growth=growth).compliance(scene, PROBES)
    assert np.array_equal(np.nan_to_num(found.values), np.nan_to_num(whole.values))


TWO_MESHES = parse_scenario({**SCENE, "mesh": COARSE, "solver": {}})


@pytest.fixture(scope="module")
def on_coarse_mesh(cache):
    """The arm on two coarse meshes, made for the scene and for one five times as stiff."""
    stiff = parse_scenario({**SCENE, "mesh": COARSE, "solver": {}, "tissues": {"override": STIFF}})
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(parametric, "Growth", lambda: replace(SMALL, rate=12, solves=4, checks=1, states=20))
        return arm_model(TWO_MESHES, draws=[TWO_MESHES, stiff])


def on_fine_mesh(draw: Scenario) -> Compliance:
    """By direct solves on a mesh of half the size."""
    whole = fem_model(draw, cached_mesh(draw, scale=0.5))
    return Compliance(LOW, direct_sweep(whole, LOW, draw.solver).values, whole.ports)


@pytest.fixture(scope="module")
def scene_on_fine_mesh(cache) -> Compliance:
    return on_fine_mesh(TWO_MESHES)


@pytest.mark.slow
def test_what_elements_err_by_is_estimated_for_each_arm(on_coarse_mesh, scene_on_fine_mesh):
    """Against a mesh of half the size: stated at least at three quarters (dispersion of two coarse meshes) and at most
    three times the truth, for the scene and for an arm five times as stiff, whose waves are longer."""
    arm, stated, true = on_coarse_mesh, [], []
    assert arm.unknown == ""
    stiff = parse_scenario({**SCENE, "mesh": COARSE, "solver": {}, "tissues": {"override": STIFF}})
    for draw, fine in ((TWO_MESHES, scene_on_fine_mesh), (stiff, on_fine_mesh(stiff))):
        found = arm.compliance(draw, LOW)
        stated.append({e.source: e.band for e in found.errors}["discretisation"])
        true.append(band_error(found.block("point", "contact"), fine.block("point", "contact")))
    assert true[0] > 1.3 * true[1]  # else there is nothing to tell
    assert stated[0] > 1.3 * stated[1]
    assert all(0.75 * t < s < 3 * t for s, t in zip(stated, true, strict=True))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(parametric, "Growth", lambda: replace(SMALL, solves=1, checks=0, parts=1))
        without = arm_model(parse_scenario({**SCENE, "mesh": COARSE}), draws=[TWO_MESHES])
    assert "discretisation_estimate is false" in without.unknown
    assert [e.source for e in without.compliance(TWO_MESHES, LOW[:1]).errors] == ["reduction"]


@pytest.mark.slow
def test_what_elements_err_by_is_known_for_each_pair(on_coarse_mesh):
    """Its largest pair is what is stated, or the whole band's; the answers that an arm may have differ by it, too."""
    arm = on_coarse_mesh
    found = arm.model.compliance(TWO_MESHES, LOW)
    estimate, missed = arm.meshes.missed(TWO_MESHES, found)
    pairs, size = missed.of(found)[:, 2:, :2], np.abs(found.block("point", "contact")).max(axis=(1, 2))
    stated = np.maximum(estimate.per_frequency, estimate.band)
    assert pairs.max(axis=(1, 2)) == pytest.approx(stated * size)
    assert (pairs.min(axis=(1, 2)) < 0.5 * pairs.max(axis=(1, 2))).any()

    def moved(model: ReducedArm) -> float:
        answer = model.answer(TWO_MESHES, LOW)
        own = answer.compliance.block("point", "contact")
        return float(np.mean([band_error(o.block("point", "contact"), own) for o in answer.others]))

    assert moved(arm) > 1.5 * moved(replace(arm, meshes=None))


@pytest.mark.slow
def test_intervals_of_a_fit_hold_what_the_elements_err_by(on_coarse_mesh, scene_on_fine_mesh, monkeypatch):
    """Data of a mesh of half the size without noise: without the mesh's error the intervals miss what made them."""
    arm, names = on_coarse_mesh, ("skin.mu", "fat.mu")
    fine = replace(close_loop(scene_on_fine_mesh, TWO_MESHES.device), errors=())
    data = replace(fine, deviation=np.full(fine.values.shape, 1e-3 * float(np.abs(fine.values).max())))
    monkeypatch.setattr("forearm_fem.questions.compare.run.fem_model_for", lambda *_, **__: arm.model)
    monkeypatch.setattr("forearm_fem.questions.compare.run.fem_meshes_for", lambda *_, **__: arm.meshes)
    with_it = run_fit(TWO_MESHES, data, names, fem=True)
    unsaid = parse_scenario({**SCENE, "mesh": COARSE})
    monkeypatch.setattr("forearm_fem.questions.compare.run.fem_meshes_for", fem_meshes_for)
    without = run_fit(unsaid, data, names, fem=True)
    true = {p.name: p.start for p in common_parameters(TWO_MESHES, names)}
    held, missed = (
        [r.fit.interval[n][0] <= v <= r.fit.interval[n][1] for n, v in true.items()] for r in (with_it, without)
    )
    assert all(held)
    assert not all(missed)
    assert with_it.fit.values == without.fit.values
    assert "the elements err by an e_band of" in with_it.text
    assert "what cutting the limb errs by is in none" in with_it.text
    assert "numerics: unknown; what the elements err by is in no interval (solver.disc" in without.text


@pytest.mark.slow
@pytest.mark.parametrize("names", [("fat.eta",), ("fat.mu", "skin.eta")])
def test_intervals_hold_what_the_elements_err_by_where_two_meshes_agree_by_chance(
    on_coarse_mesh, scene_on_fine_mesh, monkeypatch, names
):
    """What one change of mesh moves a value by may be nothing by chance; the fine mesh's values lay two such away."""
    fine = replace(close_loop(scene_on_fine_mesh, TWO_MESHES.device), errors=())
    data = replace(fine, deviation=np.full(fine.values.shape, 1e-3 * float(np.abs(fine.values).max())))
    monkeypatch.setattr("forearm_fem.questions.compare.run.fem_model_for", lambda *_, **__: on_coarse_mesh.model)
    monkeypatch.setattr("forearm_fem.questions.compare.run.fem_meshes_for", lambda *_, **__: on_coarse_mesh.meshes)
    found = run_fit(TWO_MESHES, data, names, fem=True).fit
    for p in common_parameters(TWO_MESHES, names):
        low, high = found.interval[p.name]
        assert low <= p.start <= high
    assert found.systematic is not None


def test_blocks_extend_a_space_in_turn():
    """Single precision: orthonormal to 1e-4; known directions give nothing, each block what those before it lack."""
    rng, n_u = np.random.default_rng(0), 700
    known = np.vstack([np.linalg.qr(rng.normal(size=(n_u, 40)))[0], rng.normal(size=(100, 40))]).astype(np.float32)
    fresh = rng.normal(size=(800, 9))
    blocks = [
        np.hstack([fresh[:, :4], known[:, :3]]) @ rng.normal(size=(7, 7)),
        1e-9 * fresh[:, :6] @ rng.normal(size=(6, 6)),
        1e-18 * (fresh[:, 6:] + 1e-4 * known[:, :3]),
    ]
    new = rough_extension(Basis((known[:, :15], known[:, 15:])), blocks, n_u, drop=1e-2)
    assert [x.shape[1] for x in new] == [4, 2, 3]
    whole = np.hstack([known, *new])[:n_u].astype(float)
    assert np.abs(whole.T @ whole - np.eye(49)).max() < 1e-4
    rest = fresh[:n_u] - whole @ (whole.T @ fresh[:n_u])
    assert np.abs(rest).max() < 1e-3  # and nothing of them is missing


def test_the_worst_check_decides_what_is_stated(model):
    """An estimate that was once ten times too small is taken ten times as large everywhere."""
    draw, worst = parse_scenario(SCENE), model.checks[0]
    wary = replace(model, checks=(replace(worst, estimated=worst.true / (10 * model.factor)), *model.checks[1:]))
    small, large = (m.compliance(draw, PROBES).errors[0].band for m in (model, wary))
    assert large == pytest.approx(10 * small, rel=1e-9)


def test_draws_stay_within_their_ranges():
    scenario = parse_scenario(SCENE)
    draws = Ranges(moduli=2.0, tension=(10.0, 20.0)).draws(scenario, 30, seed=2)
    own = resolve_tissues(scenario)
    for i, draw in enumerate(draws):
        assert 10.0 <= draw.tissues.membrane.tension <= 20.0
        for name in ("skin", "fat", "muscle"):
            modulus, before = resolve_tissues(draw)[name].modulus, own[name].modulus
            if i % 3 == 2:
                size = abs(modulus.at(200 * np.pi)) / abs(before.at(200 * np.pi))
            else:
                size = modulus.mu / before.mu
                assert 0.5 <= modulus.eta / before.eta <= 2.0
            assert 0.5 <= size <= 2.0 + 1e-12


def test_a_rational_function_is_found_and_a_wild_one_told():
    """Six damped modes come back from twenty values; three hundred within the band do not, and the misfit says so."""
    rng, f = np.random.default_rng(0), np.linspace(10.0, 500.0, 300)

    def modes(count: int, frequency: np.ndarray) -> np.ndarray:
        poles = 2 * np.pi * np.random.default_rng(1).uniform(30, 450, count) * (1j - 0.05)
        return (1 / (2j * np.pi * frequency[:, None] - poles)) @ shapes[:count]

    shapes = rng.normal(size=(300, 5))
    nodes = chebyshev_frequencies(f, 20)
    smooth, wild = (rational(nodes, modes(n, nodes), 1e-6) for n in (6, 300))
    assert smooth.misfit < 1e-6
    assert np.abs(smooth.at(f) - modes(6, f)).max() < 1e-5 * np.abs(modes(6, f)).max()
    assert wild.misfit > 1e-2


def test_small_reduced_models_answer_in_single_precision(model):
    """Three digits are asked; double precision of the same model tells what single leaves."""
    for piece in model.pieces:
        drawn = piece.whole.at(Ranges().draws(parse_scenario(SCENE), 3, seed=21)[1])
        f = PROBES[piece.high >= PROBES][-1:]
        exact, quick = drawn.compliance(f), quick_compliance(drawn, f)
        assert np.nanmax(np.abs(quick - exact)) < 1e-3 * np.nanmax(np.abs(exact))


WATCHED = np.ix_([2, 3], [0, 1])  # points under contacts


def test_a_draws_solutions_at_few_frequencies_carry_all_others(model):
    """Solves at every bin tell what the span of up to 15 leaves between them; fewer leave more, and say so."""
    for draw in Ranges().draws(parse_scenario(SCENE), 3, seed=22):
        low = 20.0
        for piece in model.pieces:
            system, band = Summed.of(piece.whole.at(draw)), np.arange(low, piece.high, 0.5)
            low, known, rough = piece.high, *(spanned(system, band, t, WATCHED) for t in (1e-3, 0.2))
            exact = quick_compliance(system.reduced, band[::7])
            size = np.abs(exact[(slice(None), *WATCHED)]).max(axis=(1, 2))
            for some, most in ((known, 1e-3), (rough, 0.2)):
                off = np.abs(some.span.compliance(band[::7]) - exact)[(slice(None), *WATCHED)].max(axis=(1, 2)) / size
                assert some.missed[WATCHED].max() <= most
                assert off.max() < 3 * most  # the last change is of where it is looked at, 17 frequencies
            assert len(rough.solved) < len(known.solved) < 15
            at = known.span.compliance(known.solved)
            assert np.allclose(at, quick_compliance(system.reduced, known.solved), rtol=0, atol=1e-4 * np.abs(at).max())


def test_a_span_that_is_singular_somewhere_is_a_named_error():
    with pytest.raises(SolverError, match="span of solutions is singular"):
        _solved(np.zeros((2, 3, 3), dtype=complex), np.ones((3, 2), dtype=complex))


def test_other_loads_are_solved_beside(model):
    """Points read elsewhere, at the ends and in the middle of the band, as from a model of their own."""
    drawn = model.pieces[0].whole.at(Ranges().draws(parse_scenario(SCENE), 1, seed=23)[0])
    others = drawn.functionals[:, ::-1] + 0.1 * drawn.functionals
    known = spanned(Summed.of(drawn), np.arange(20.0, model.pieces[0].high), 0.1, WATCHED, others)
    exact = quick_compliance(replace(drawn, functionals=others), known.solved[:3])
    assert np.allclose(known.beside, exact, rtol=0, atol=1e-4 * np.abs(exact).max())


def test_a_bare_answer_has_the_values_of_a_stated_one(model):
    draw = Ranges().draws(parse_scenario(SCENE), 1, seed=24)[0]
    assert np.array_equal(model.bare(draw, PROBES), model.compliance(draw, PROBES).values, equal_nan=True)


def test_what_geometry_changes_between_the_frequencies_asked_is_within_its_statement(model):
    """The layered model at every tenth bin tells what a rational function of 33 answers leaves there; its errors hold
    it."""
    scene = parse_scenario(SCENE)
    arm, drawn = ReducedArm(scene, model, LayeredArm()), parse_scenario(THICK)
    own, f = with_scene_geometry(scene, drawn), frequencies(scene.sweep)[::2]
    some = slice(3, None, 20)
    pair = drawn, own
    (change, error, _), (exact, *_) = arm._change(pair, pair, f), arm._change(pair, pair, f[some])
    off = np.abs(change[some] - exact)[:, 2:, :2]
    assert len(f) > 33 > len(f[some])
    assert np.abs(exact[:, 2:, :2]).max() > 30 * off.max() > 0
    assert (off.max(axis=(1, 2)) <= error[some, 2, 0]).all()
    far = laid_at(scene, [[0.0, 9.5e-3], [2e-3, -9e-3]])  # changes nothing under contacts
    moved, error, _ = arm._change((far, scene), (far, scene), f)
    assert not moved[:, :2, :2].any()
    assert np.isfinite(moved).all()
    assert np.isfinite(error).all()


def test_beside_tape_a_contacts_radius_changes_points_by_its_own_factor(model):
    """Layered arms in place of finite elements. Without tape a third is left at most; with tape a quarter up to 200 Hz,
    and above, as it reaches to the cones' rims, more than the change, within the statement of twice as much."""
    scene = parse_scenario({"device": {"cone": {"contact": "pressure"}}})
    arm, layered = ReducedArm(scene, model, LayeredArm()), LayeredArm()
    wide, some = scene.changed({"device.cone.radius": 1.2 * scene.device.cone.radius}), PROBES[1:4]
    for on, most in ((lambda s: s, 0.4), (lambda s: taped(s, 1.5e-4, 7e8), 2.0)):
        before, after = (layered.compliance(on(s), some) for s in (scene, wide))
        change, _, seen = arm._change_beside_tape(on(wide), on(scene), before, before)
        assert np.array_equal(change, seen)
        true = np.nan_to_num(after.values - before.values)
        off, size = (np.linalg.norm(x[:, 4:, :4], axis=(1, 2)) for x in (change - true, true))
        assert (off < most * size).all()
        assert (off[:2] < 0.4 * size[:2]).all()
        assert np.allclose(change[:, :4, :4], true[:, :4, :4], rtol=0, atol=0.05 * np.abs(true[:, :4, :4]).max())


def test_one_azimuthal_order_says_what_geometry_changes_within_its_statement(model):
    """Of rigid cones far apart, against five orders; what it leaves out is stated as a share of the change. A cone
    whose rim nearly reaches a point is asked with more orders. The arms' waves decay little: a springpot, a Zener."""
    scene, exact = load_scenario("thesis"), LayeredArm(True, 1e-4, 5, (5, 5))
    arm = ReducedArm(scene, model, LayeredArm(True, 1e-2, 3))
    for number in (3, 7):
        drawn = scenario_of(draw_inputs(load_priors(), scene, 0, number), scene)
        own = with_scene_geometry(scene, drawn)
        change, error, _ = arm._change((drawn, own), (drawn, own), PROBES)
        truth = np.subtract(*(np.nan_to_num(exact.compliance(s, PROBES).values) for s in (drawn, own)))
        kinds = np.array([port.kind for port in flat_ports(scene)])
        block = np.ix_(range(len(PROBES)), kinds == "point", kinds == "contact")
        off, size = (np.abs(x[block]).max(axis=(1, 2)) for x in (change - truth, truth))
        assert (off < error[block].max(axis=(1, 2))).all()
        assert (off < 0.06 * size).all()  # what is stated; 0.05 was the most of 44 arms at any frequency
        assert (off / size).max() > 1e-3  # one order is not five
        assert (0.06 * size < error[block].max(axis=(1, 2)) + off).all()
        assert (error[block].max(axis=(1, 2)) < 0.12 * size).all()
    cone = scene.device.cone.model_copy(update={"radius": 8e-3})
    wide = scene.model_copy(update={"device": scene.device.model_copy(update={"cone": cone})})
    assert 0 < _nearness(scene) < 0.5 < _nearness(wide)
    assert _nearness(parse_scenario(SCENE)) == 0  # pressure scatters nothing


@pytest.mark.slow  # 2 s; test_thickness has the mesh's own
def test_an_arm_of_other_thickness_is_nearer_with_the_layered_models_change(model):
    """Thicker fat and a grid laid 2 mm aside, against a mesh of that arm; the error stated covers what is left. Where
    the grid can be read as it lies, the layered model's change and half of it are of the fat alone."""
    scene = parse_scenario(SCENE)
    arm, still = (ReducedArm(scene, m, LayeredArm()) for m in (model, replace(model, around=None)))
    drawn = scenario_of(draw_inputs(load_priors(), scene, 0, 4), scene, ("contact area",))
    drawn = drawn.model_copy(update={"limb": parse_scenario(THICK).limb, "grid": parse_scenario(THICK).grid})
    answer = arm.answer(drawn, PROBES)
    found = answer.compliance
    truth, own = solved(drawn), model.compliance(with_scene_geometry(scene, drawn), PROBES).block("point", "contact")
    errors = {e.source: e.band for e in found.errors}
    left, held = (band_error(v, truth) for v in (found.block("point", "contact"), own))
    assert held > 0.1  # else there is nothing to mend
    assert left < held / 2
    assert left < np.linalg.norm(list(errors.values())) < 10 * left
    assert np.isnan(found.values[:, 2, 2]).all()  # a point on itself is unknown still
    laid = with_scene_geometry(scene, drawn).model_copy(update={"grid": drawn.grid})
    before, missed = model.answer(laid, PROBES)
    change = np.abs(np.nan_to_num(found.values - before.values))
    off = np.abs(np.nan_to_num(np.array([other.values for other in answer.others]) - found.values))
    _, numerics, _ = arm._change((drawn, laid), (drawn, laid), PROBES)
    # Half of the change and the layered model's errors, in any phase; reduction
    most = 0.5 * change + numerics + missed.of(before)
    off, most = off[..., :2], most[..., :2]  # points do not drive: of two, geometry is not asked
    assert len(off) == 6
    assert (off <= most * (1 + 1e-9) + 1e-20).all()
    assert (off.max(axis=(2, 3)) > 0.05 * change.max(axis=(1, 2))).all()
    assert all(np.allclose(o.values[:, 0, 1], o.values[:, 1, 0], rtol=1e-12) for o in answer.others)
    assert answer.shown == set(errors)
    all_by_layers = {e.source: e for e in still.compliance(drawn, PROBES).errors}["interpolation"]
    assert errors["interpolation"] < 0.8 * all_by_layers.band
    assert "thickness and place of the grid changes" in all_by_layers.method


@pytest.mark.parametrize("frequency", [PROBES, np.linspace(20, 500, 40)], ids=["few", "many"])
def test_points_seen_elsewhere_are_those_of_an_arm_of_that_grid(model, frequency):
    """By the solutions of the arm itself, whose span knows no load there: 1e-3, as a span may err by; and the layered
    model's part of a thicker fat at the points seen."""
    scene = parse_scenario(SCENE)
    arm = ReducedArm(scene, model, LayeredArm())
    drawn = scene.model_copy(update={"limb": parse_scenario(THICK).limb})
    seen = drawn.model_copy(update={"grid": scene.grid.changed({"points": [(0.001, 0.005), (0.0, -0.007)]})})
    answer, met = arm.answers(drawn, seen, frequency)
    alone, theirs = arm.compliance(drawn, frequency), arm.compliance(seen, frequency).block("point", "contact")
    assert np.allclose(np.nan_to_num(answer.compliance.values), np.nan_to_num(alone.values), rtol=1e-9, atol=1e-12)
    off = np.abs(met.block("point", "contact") - theirs).max(axis=(1, 2)) / np.abs(theirs).max(axis=(1, 2))
    assert off.max() < 1e-3
    assert band_error(met.block("point", "contact"), alone.block("point", "contact")) > 0.02  # they are elsewhere


class Unsure(LayeredArm):
    """The same answers, said to err by a fifth of the largest entry of a kind."""

    def compliance(self, scenario, frequency):
        found = super().compliance(scenario, frequency)
        said = replace(found.errors[0], per_frequency=(0.2,) * len(frequency))
        return replace(found, errors=(said,))


def test_an_answer_may_be_missed_alike_everywhere_or_at_each_pair(model):
    """Half of what an arm may be is off by its error at every pair in one phase with it: what too much decay does, and
    what changes S by more than the same size at each pair by chance. The other half is off at no two pairs alike."""
    answer = ReducedArm(parse_scenario(SCENE), model, LayeredArm()).answer(parse_scenario(SCENE), PROBES)
    found = answer.compliance.block("point", "contact")
    _, missed = model.answer(parse_scenario(SCENE), PROBES)
    size = missed.of(answer.compliance)[:, 2:, :2]
    for k, other in enumerate(answer.others):
        off = (other.block("point", "contact") - found) / found * np.abs(found) / size
        alike = np.allclose(off, off[:, :1, :1], rtol=1e-6)  # rounding of a difference a thousandth of its terms
        assert alike == (k % 2 == 0)
        assert np.allclose(np.abs(off), 1.0, rtol=1e-6) == alike


def test_what_the_layered_model_errs_by_in_its_change_is_in_the_arms_interval(model):
    """It was in e_band alone; and over the largest of a kind, so that points far away err by their own size."""
    scene, drawn = parse_scenario(SCENE), parse_scenario(THICK)
    drawn = parse_scenario(SCENE).model_copy(update={"limb": drawn.limb})
    sure, unsure = (ReducedArm(scene, model, layered).answer(drawn, PROBES) for layered in (LayeredArm(), Unsure()))
    found = sure.compliance.values
    points, contacts = sure.compliance.indices("point"), sure.compliance.indices("contact")
    for pair in ((points, contacts), (contacts, contacts)):
        block = np.ix_(range(len(PROBES)), *pair)
        small, large = (
            np.sqrt(np.mean([np.abs(o.values[block] - a.compliance.values[block]) ** 2 for o in a.others]))
            for a in (sure, unsure)
        )
        size = np.abs(found[block]).max()
        assert large > 2 * small
        # Two answers of the layered model, each a fifth of its own largest at most
        assert 0.02 * size < large < 0.4 * size
    bands = [{e.source: e.band for e in a.compliance.errors}["interpolation"] for a in (sure, unsure)]
    assert 0.1 < bands[1] - bands[0] < 0.8


def laid_at(arm: Scenario, points: list[list[float]]) -> Scenario:
    """The arm with its grid's points elsewhere."""
    return arm.model_copy(update={"grid": parse_scenario({**SCENE, "grid": {"points": points}}).grid})


ASIDE = ((0.0, 0.0), (1.5e-3, -1.0e-3), (-5.5e-3, 5.0e-3))


def moved_by(aside: tuple[float, float]) -> list[list[float]]:
    """Places of the scene's points, all moved."""
    return [[x + aside[0], y + aside[1]] for x, y in SCENE["grid"]["points"]]


@pytest.fixture(scope="module")
def two_draws(cache) -> list[tuple[Scenario, dict[tuple[float, float], np.ndarray]]]:
    """Draws, and the truth with the points at each of ASIDE: a direct sweep solves for all points at once."""
    draws = Ranges().draws(parse_scenario(SCENE), 2, seed=99)
    made = []
    for draw in draws:
        laid = laid_at(draw, [place for aside in ASIDE for place in moved_by(aside)])
        values = direct_sweep(fem_model(laid, cached_mesh(draw)), PROBES, draw.solver).values[:, 2:, :2]
        made.append((draw, dict(zip(ASIDE, np.split(values, len(ASIDE), axis=1), strict=True))))
    return made


@pytest.mark.slow
@pytest.mark.parametrize("aside", ASIDE[1:])
def test_a_grid_is_read_where_it_lies(model, two_draws, aside):
    """Against direct solves with the points there on the same mesh: half a per cent is what polynomials leave between
    elements of 8 mm. It is stated; the grid where it was is 15 % off at least."""
    for draw, truths in two_draws:
        laid, truth = laid_at(draw, moved_by(aside)), truths[aside]
        found, held = model.compliance(laid, PROBES), model.compliance(draw, PROBES)
        left = band_error(found.block("point", "contact"), truth)
        assert left < 0.02 < 0.15 < band_error(held.block("point", "contact"), truth)
        assert left < found.errors[0].band < 5 * left


def test_a_grid_too_far_away_is_the_layered_models(model):
    scene = parse_scenario(SCENE)
    far = laid_at(scene, [[0.0, 9.5e-3], [2e-3, -9e-3]])
    assert not model.follows(far)
    with pytest.raises(ScenarioError, match=r"^grid"):
        model.compliance(far, PROBES)
    stated = {e.source: e for e in ReducedArm(scene, model, LayeredArm()).compliance(far, PROBES).errors}
    assert "place of the grid changes" in stated["interpolation"].method


def test_places_around_a_point_give_polynomials_between():
    """Through all places to the degree they allow; a degree less, as the core has it, errs by the highest term."""
    around, scene = GridPlaces(((0.0, 0.003), (0.002, -0.009))), parse_scenario(SCENE)
    laid = laid_at(scene, [[1e-3, 7e-3], [-3e-3, -8e-3]])
    (x, y), (at_x, at_y) = 1e3 * around.places.T, 1e3 * np.array(laid.grid.places).T
    for power in range(7):
        seen = (x**power * (1 + y**6)).reshape(2, 49)
        whole, less = (np.einsum("pk,pk->p", around.shares(laid, d), seen) for d in (6, 5))
        assert whole == pytest.approx(at_x**power * (1 + at_y**6), rel=1e-9)
        assert less != pytest.approx(whole, rel=1e-3)
    assert not around.hold(parse_scenario(THICK | {"grid": {"points": [[0.0, 0.003]]}}))


@pytest.mark.slow
def test_what_is_missed_is_known_for_each_pair(model, two_draws):
    """The largest pair of a point and a contact is e(f); a pair that the reduction changes less has less to miss."""
    draw, truths = two_draws[1]
    found, missed = model.answer(draw, frequencies(draw.sweep))
    pairs, own = missed.of(found)[:, 2:, :2], found.block("point", "contact")
    some = np.abs(found.frequency[:, None] - PROBES).argmin(axis=0)
    assert missed.shares[:, 2:, :2].max(axis=(1, 2)) == pytest.approx(np.array(found.errors[0].per_frequency))
    at = np.abs(found.frequency - missed.probes[1]).argmin()
    stated = found.errors[0].per_frequency[1] * np.abs(own[at]).max()
    assert pairs[at].max() == pytest.approx(stated, rel=0.05)  # the probe lies between bins
    assert np.median(pairs.min(axis=(1, 2)) / pairs.max(axis=(1, 2))) < 0.8  # of only four pairs
    assert np.mean(np.abs(own[some] - truths[ASIDE[0]]) <= pairs[some]) > 0.9  # 97 % of six arms' pairs


def test_an_arm_that_differs_in_tissue_alone_is_the_models(model):
    scene = parse_scenario(SCENE)
    drawn = with_scene_geometry(scene, scenario_of(draw_inputs(load_priors(), scene, 0, 5), scene))
    one, other = ReducedArm(scene, model, LayeredArm()).compliance(drawn, PROBES), model.compliance(drawn, PROBES)
    assert np.array_equal(np.nan_to_num(one.values), np.nan_to_num(other.values))
    assert len(one.errors) == 1
    assert ReducedArm(scene, model, LayeredArm()).held == frozenset({"fascia"})  # the scene has no such layer


def test_a_fit_recovers_an_arm_of_finite_elements(model):
    """Data of full solves, not of the reduced model, with noise; three parameters within their 95 % intervals."""
    scene, names = parse_scenario(SCENE), ("skin.mu", "fat.mu", "muscle.eta")
    chosen = common_parameters(scene, names)
    true = {p.name: p.start * factor for p, factor in zip(chosen, (1.4, 0.7, 1.25), strict=True)}
    answer = ScenarioModel(scene, model, PROBES)
    arm = answer.scenario(true)
    clean = close_loop(model.compliance(arm, PROBES), arm.device)
    values = fem_transfer(arm)
    sigma = 0.02 * float(np.sqrt(np.mean(np.abs(values) ** 2)))
    noise = np.random.default_rng(3).standard_normal((2, *values.shape)) * sigma / np.sqrt(2)
    data = replace(clean, values=values + noise[0] + 1j * noise[1], deviation=np.full(values.shape, sigma), errors=())
    result = fit(answer, data, chosen)
    assert result.chi2 < 2  # reduction errs by less than the noise
    for p in chosen:
        assert (
            abs(np.log(result.values[p.name] / true[p.name]))
            < 3 * np.log(result.interval[p.name][1] / result.values[p.name]) / 1.96
        )
        assert result.interval[p.name][1] / result.interval[p.name][0] < 1.6  # and they say something


def test_intervals_of_a_fit_hold_what_the_reduction_errs_by(model, monkeypatch):
    """By hand: what a coarser model moves, times the checks' factor, is added to the half width in squares."""
    scene, names = parse_scenario(SCENE), ("skin.mu", "muscle.eta")
    clean = replace(close_loop(model.compliance(scene, PROBES), scene.device), errors=())
    data = replace(clean, deviation=np.full(clean.values.shape, 2e-4 * float(np.abs(clean.values).max())))
    chosen = common_parameters(scene, names)
    made = lambda *_, **__: replace(model, checks=CHECKS)  # noqa: E731
    monkeypatch.setattr("forearm_fem.questions.compare.run.fem_model_for", made)
    whole = run_fit(scene, data, names, fem=True)
    noise, coarse = (fit(ScenarioModel(scene, m, PROBES), data, chosen) for m in (model, model.coarser))
    for p in chosen:
        own, moved = np.log(noise.interval[p.name][1] / noise.values[p.name]), np.log(coarse.values[p.name] / p.start)
        half = np.log(whole.fit.interval[p.name][1] / whole.fit.values[p.name])
        assert half == pytest.approx(np.hypot(own, 3 * moved), rel=0.01)  # fits end within 1e-4 of their values
        assert abs(3 * moved) > 0.1 * own
    p = max(chosen, key=lambda p: np.log(whole.fit.interval[p.name][1] / whole.fit.values[p.name]) / p.span)
    own = np.log(noise.interval[p.name][1] / noise.values[p.name])
    assert own < 0.4 * np.log(whole.fit.interval[p.name][1] / whole.fit.values[p.name])  # the model's share is most
    assert np.diag(whole.fit.correlation) == pytest.approx(1.0)
    assert "what a coarser reduction finds" in whole.text
    assert "take a finer model" in whole.text  # without all noise .92 of the widest interval would be left at least


@pytest.mark.parametrize(
    ("names", "change", "said"),
    [
        (("skin.mu", "skin.mu"), {}, "skin.mu is named twice"),
        (("bone.mu",), {}, "no parameter is called bone.mu"),
        (("skin.mu",), {"sweep": {"f_min": 20.0, "f_max": 300.0}}, "the measured G has 330 Hz, the scene sweeps 20 to"),
        (("skin.mu",), {"grid": {"points": [[0.0, 0.003]]}}, "the outputs 2, the scene's grid the points 1 to 1"),
    ],
)
def test_a_fit_that_cannot_be_is_told_before_its_elements_are_reduced(model, names, change, said, monkeypatch):
    arm = parse_scenario(SCENE)
    data = replace(close_loop(model.compliance(arm, PROBES), arm.device), errors=())
    unasked = "forearm_fem.questions.compare.parameters.parametric_model"
    monkeypatch.setattr(unasked, lambda *_, **__: pytest.fail("reduced"))
    with pytest.raises((DataError, ScenarioError), match=said):
        run_fit(parse_scenario({**SCENE, **change}), data, names, fem=True)


def fem_transfer(draw: Scenario) -> np.ndarray:
    """G of a draw by direct solves (n_frequency, n_point, n_contact)."""
    whole = fem_model(draw, cached_mesh(draw))
    values = direct_sweep(whole, PROBES, draw.solver).values
    return close_loop(Compliance(PROBES, values, whole.ports), draw.device).values


def test_a_fit_on_one_mesh_looks_for_no_thickness():
    scene = parse_scenario(SCENE)
    with pytest.raises(ScenarioError, match=r"limb\.layers\.1\.thickness: a mesh has one geometry"):
        fem_model_for(scene, common_parameters(scene, ("fat.thickness",)))
