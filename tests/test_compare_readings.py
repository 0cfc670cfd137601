"""Ports matched by place, and the reading that would make two G agree: found where there is a mistake, never where two
limbs differ honestly."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import permutations, product

import numpy as np
import pytest
from test_measurement_scene import INPUTS, OUTPUTS, part, wave_matrix

from forearm_fem.errors import DataError
from forearm_fem.metrics.common_ground import common_ground
from forearm_fem.questions.compare.compare import compare, comparison_record
from forearm_fem.questions.compare.parameters import LayeredBetween, ScenarioModel
from forearm_fem.questions.compare.readings import best_reading, exchanged, explained
from forearm_fem.questions.compare.report import as_markdown
from forearm_fem.questions.compare.run import run_compare, run_fit
from forearm_fem.scenario import parse_scenario
from forearm_fem.transfer import TransferMatrix

F = np.linspace(10.0, 500.0, 40)
SCENARIO = parse_scenario({})
LIMBS = {
    "thesis": {},
    "stiff skin": {"tissues.override.skin.mu": 6e4},
    "soft skin": {"tissues.override.skin.mu": 5e3},
    "soft fat": {"tissues.override.fat.mu": 7e2},
    "viscous skin": {"tissues.override.skin.eta": 20.0},
    "heavy coil": {"device.coil.moving_mass": 1.2e-3},
    "low resonance": {"device.coil.resonance": 300.0},
    "thick fat": {"limb.layers.1.thickness": 0.012},
}


@cache
def limb(name):
    """The layered model of a limb."""
    g = ScenarioModel(SCENARIO, LayeredBetween(OUTPUTS, INPUTS, tolerance=1e-4), F)(LIMBS[name])
    return replace(g, contacts=None, errors=())


def noisy(g, seed=0):
    """30 dB below the matrix' rms."""
    sigma = 10 ** (-30 / 20) * np.sqrt(np.mean(np.abs(g.values) ** 2))
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal(g.values.shape) + 1j * rng.standard_normal(g.values.shape)
    return replace(g, values=g.values + sigma / np.sqrt(2) * noise)


def changed(g, factor=1.0, conjugate=False, output=None, source=None):
    values = (g.values.conj() if conjugate else g.values) * np.asarray(factor)
    signs = np.ones(values.shape[1:])
    if output is not None:
        signs[output] *= -1
    if source is not None:
        signs[:, source] *= -1
    return replace(g, values=values * signs)


W = (2j * np.pi * F)[:, None, None]
MISTAKES = {
    "millimetres": ({"factor": 1e3}, "1e-3 (millimetres for metres)"),
    "micrometres": ({"factor": 1e6}, "1e-6 (micrometres for metres)"),
    "A in millimetres": ({"factor": 1e-3}, "1e3 (A is in millimetres"),
    "velocity": ({"factor": W}, "divided by iw (velocity"),
    "acceleration": ({"factor": W**2}, "divided by (iw)^2 (acceleration"),
    "velocity in mm/s": ({"factor": 1e3 * W}, "divided by iw (velocity for displacement), multiplied by 1e-3"),
    "A is velocity": ({"factor": 1 / W}, "multiplied by iw (A is a velocity)"),
    "conjugate": ({"conjugate": True}, "conjugated"),
    "negated": ({"factor": -1.0}, "negated at every entry"),
    "output 4 negated": ({"output": 3}, "negated at output 4"),
    "input A2 negated": ({"source": 1}, "negated at input A2"),
    "late": ({"factor": np.exp(-W * 1e-3)}, "advanced by 1 ms"),
    "early": ({"factor": np.exp(W * 3e-4)}, "delayed by 0.3 ms"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_each_mistake_is_named_and_e_band_after_it_is_the_noise(mistake):
    how, said = MISTAKES[mistake]
    reading = best_reading(common_ground(limb("thesis"), changed(noisy(limb("thesis")), **how)))
    assert said in reading.sentence
    assert len(reading.sentence) <= 300
    # 30 dB of noise is 0.0316 of the norm; another 10 % for its scatter over 1,440 entries
    assert reading.after < 0.035 < reading.before


def rewired(g, outputs=None, inputs=None):
    """``g`` with its channels in another order under the old names."""
    rows, columns = outputs or range(len(g.outputs)), inputs or range(len(g.inputs))
    return replace(g, values=g.values[:, list(rows)][:, :, list(columns)])


REWIRED = {
    "two inputs": ({"inputs": (1, 0, 2, 3)}, "its inputs A1 and A2 are exchanged"),
    "three inputs": ({"inputs": (1, 2, 0, 3)}, "its inputs A1 and A3 and A2 are permuted"),
    "two outputs": ({"outputs": (0, 4, 2, 3, 1, 5, 6, 7, 8)}, "its outputs 2 and 5 are exchanged"),
    # on a symmetric device other orders of both sides do as well
    "both": ({"inputs": (0, 1, 3, 2), "outputs": (8, 1, 2, 3, 4, 5, 6, 7, 0)}, ", and its outputs"),
}


@pytest.mark.parametrize("which", REWIRED)
def test_exchanged_channels_are_named_and_nothing_is_changed(which):
    order, said = REWIRED[which]
    b = rewired(noisy(limb("thesis")), **order)
    kept = b.values.copy()
    assert said in explained(common_ground(limb("thesis"), b))
    assert exchanged(common_ground(limb("thesis"), b)).after < 0.035  # the noise, as above
    assert np.array_equal(b.values, kept)


def test_an_exchange_comes_with_what_it_would_bring():
    found = exchanged(common_ground(limb("thesis"), rewired(noisy(limb("thesis")), inputs=(1, 0, 2, 3))))
    assert found.after < 0.035 < 0.5 < found.before
    assert exchanged(common_ground(limb("thesis"), limb("thesis"))) is None


_PLAIN = ("millimetres", "velocity", "acceleration", "negated", "input A2 negated")


# the conjugate of soft fat's G is not told from an honest G of another limb: nothing is said then
@pytest.mark.parametrize(
    ("other", "mistake"), [*product(("stiff skin", "soft fat"), _PLAIN), ("stiff skin", "conjugate")]
)
def test_a_mistake_is_named_on_another_limb_too(other, mistake):
    how, said = MISTAKES[mistake]
    found = explained(common_ground(limb("thesis"), changed(noisy(limb(other)), **how)))
    assert said in found
    assert len(found) <= 300


def test_honest_pairs_are_told_nothing():
    """Every ordered pair of eight limbs, 30 dB of noise on one: e_band up to 9.8, and no mistake in any."""
    for seed, (a, b) in enumerate(permutations(LIMBS, 2)):
        assert explained(common_ground(limb(a), noisy(limb(b), seed))) == "", (a, b)


def test_a_g_of_zeros_has_no_channels_to_exchange():
    g = limb("thesis")
    nothing = replace(g, values=np.zeros_like(g.values))
    for pair, name in (((g, nothing), "B"), ((nothing, g), "A")):
        assert exchanged(common_ground(*pair)) is None
        assert explained(common_ground(*pair)).startswith(f"{name} is zero at every entry")


def test_a_ratio_that_nothing_explains_is_said():
    found = explained(common_ground(limb("thesis"), changed(noisy(limb("thesis")), factor=77.0)))
    assert found.startswith("B is 76.9 times as large as A")


def test_data_are_not_changed_and_the_note_comes_first():
    b = changed(limb("thesis"), factor=1e3)
    c = compare(limb("thesis"), b, render=False)
    assert c.agreement.band == pytest.approx(999)
    assert np.array_equal(c.ground.b, b.values)
    assert as_markdown(c).splitlines()[4].startswith("Likeliest cause: B agrees with A when it is multiplied by 1e-3")
    assert comparison_record(c)["notes"] == list(c.notes)
    assert compare(limb("thesis"), limb("thesis"), render=False).notes == ()


A = wave_matrix()


def placed(g, outputs=None, inputs=None):
    """``g`` with its ports at other places."""

    def put(ports, where):
        return tuple(replace(p, position=(*where(np.array(p.position[:2])).tolist(), 0.0)) for p in ports)

    keep = lambda x: x  # noqa: E731
    return replace(g, outputs=put(g.outputs, outputs or keep), inputs=put(g.inputs, inputs or keep))


@pytest.mark.parametrize(
    ("move", "said"),
    [
        (lambda x: x + np.array([0.02, 0.0]), "up to 20 mm apart in A and B (B is shifted by 20, 0 mm)"),
        (lambda x: 2 * x, "(B's layout is 2 times as wide)"),
        (lambda x: 1e3 * x, "(B's layout is 1e+03 times as wide)"),
    ],
)
def test_ports_elsewhere_are_said(move, said):
    notes = compare(A, placed(A, move, move), render=False).notes
    assert len(notes) == 2  # outputs and inputs
    assert all(said.split("(")[-1] in n for n in notes)
    assert said in notes[0]
    assert max(map(len, notes)) <= 300


def test_half_a_millimetre_is_not_worth_a_word():
    assert compare(A, placed(A, lambda x: x + 5e-4), render=False).notes == ()


def test_names_that_disagree_with_places_are_said():
    order = [2, 1, 0, *range(3, 9)]
    swapped = replace(
        A, outputs=tuple(replace(p, name=A.outputs[k].name) for p, k in zip(A.outputs, order, strict=True))
    )
    c = compare(A, swapped, render=False)
    assert c.agreement.band > 0.1  # by name: row 3 is held against row 1
    assert "A's 1 = B's 3, A's 3 = B's 1" in c.notes[0]
    assert len(c.notes[0]) <= 300


def test_other_names_are_matched_by_place():
    order = [3, 1, 0, 2]
    renamed = tuple(replace(A.inputs[k], name=f"coil {k}") for k in order)
    c = compare(A, replace(A, values=A.values[:, :, order], inputs=renamed), render=False)
    assert c.agreement.band == 0
    assert "matched by place, A = B: A1 = coil 0, A2 = coil 1" in c.notes[0]
    with pytest.raises(DataError, match="neither by name nor by place"):
        compare(A, placed(replace(A, inputs=renamed), inputs=lambda x: x + 0.02), render=False)


def test_unknown_places_are_not_judged():
    nowhere = placed(A, lambda x: 0 * x, lambda x: np.nan * x)
    assert compare(A, nowhere, render=False).notes == ()


def test_another_drive_names_its_key():
    with pytest.raises(DataError, match=r"device\.drive"):
        compare(A, replace(A, unit="m/N"))


def test_missing_data_are_named_and_nothing_shared_is_an_error():
    valid = np.ones(A.values.shape, dtype=bool)
    valid[:, 2, 1] = False
    assert "B knows nothing of 3 <- A2" in compare(A, replace(A, valid=valid), render=False).notes[0]
    with pytest.raises(DataError, match=r"A knows 100 % and B knows 0 %"):
        compare(A, replace(A, values=np.nan * A.values), render=False)
    assert run_compare(A, replace(A, valid=valid), render=False).text.count("B knows nothing of 3 <- A2") == 1


FIT_F = np.linspace(40.0, 450.0, 8)
FIXED = parse_scenario({"device": {"housing": {"fixed": True}}})


@cache
def measured():
    g = ScenarioModel(FIXED, LayeredBetween(OUTPUTS, INPUTS), FIT_F)({"tissues.override.skin.mu": 3e4})
    return noisy(replace(g, contacts=None, errors=()))


def fitted(g: TransferMatrix):
    return run_fit(FIXED, g, ["skin.mu", "coil.moving_mass"])


def test_one_measured_actuator_is_enough_for_a_fit():
    """The three others are on the skin all the same."""
    result = fitted(part(measured(), 9, 1))
    # one standard deviation is 0.3 % with 72 entries at 30 dB; four of these
    assert result.fit.values["tissues.override.skin.mu"] == pytest.approx(3e4, rel=0.012)
    assert result.model.values.shape == (8, 9, 1)
    assert "model A" not in result.text


@pytest.mark.parametrize(
    ("factor", "said"),
    [pytest.param(1e3, "millimetres for metres", marks=pytest.mark.slow),
     ((2j * np.pi * FIT_F)[:, None, None], "velocity for displacement")],
)  # fmt: skip
def test_a_fit_on_misread_data_says_how_to_read_them_and_that_it_is_at_its_bounds(factor, said):
    result = fitted(changed(measured(), factor=factor))
    assert said in result.text
    assert "ended on its bound" in result.text


def test_fits_without_a_result_are_refused():
    with pytest.raises(DataError, match=r"device\.drive = 'voltage' gives m/V; set device\.drive = 'force'"):
        fitted(replace(measured(), unit="m/N"))
    with pytest.raises(DataError, match="no valid entry"):
        fitted(replace(measured(), values=np.nan * measured().values))
    with pytest.raises(DataError, match="name each input after its actuator"):
        fitted(replace(measured(), inputs=tuple(replace(p, name=f"B{p.name}") for p in INPUTS)))


def test_a_part_of_the_ports_is_named_as_such():
    """Of a G with fewer actuators the names do pair; "rename them" was no remedy."""
    part = replace(A, values=A.values[:, :, :3], inputs=A.inputs[:3])
    name = A.inputs[3].name
    for pair, said in (((A, part), f"inputs: B lacks {name} of A"), ((part, A), f"inputs: A lacks {name} of B")):
        with pytest.raises(DataError, match=said):
            compare(*pair, render=False)
