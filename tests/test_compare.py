"""Comparison of two transfer matrices: known differences must come out as such, gaps must stay visible."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scenes import shows_itself
from test_measurement_scene import RATE, SENSOR, SWEEP, device_for, part, plan_for, wave_matrix

from forearm_fem.errors import DataError
from forearm_fem.files import save
from forearm_fem.measurement.calibrate import calibrate
from forearm_fem.measurement.virtual import noise_for
from forearm_fem.metrics import condition_number
from forearm_fem.metrics.common_ground import common_ground
from forearm_fem.ports import Port, distances
from forearm_fem.questions.compare.agreement import agreement, fdac_matrix, where, where_words
from forearm_fem.questions.compare.compare import compare, comparison_record, cross_play, wavelet_for
from forearm_fem.questions.compare.report import (
    answer_lines,
    as_csv,
    as_json,
    as_markdown,
    compared_targets,
    picture,
    plot_overlay,
    strength_words,
)
from forearm_fem.questions.compare.run import run_compare
from forearm_fem.transfer import TransferMatrix

A = wave_matrix()


def changed(g, factor=1.0, delay=0.0):
    turn = factor * np.exp(-1j * g.omega * delay)
    return replace(g, values=g.values * turn[:, None, None])


def test_a_matrix_agrees_with_itself():
    a = agreement(common_ground(A, A))
    assert a.band == 0
    assert a.overall_frac == pytest.approx(1)
    np.testing.assert_allclose(a.fdac, 1)
    np.testing.assert_allclose(a.delay, 0, atol=1e-15)
    assert np.isnan(a.misfit)  # no deviations: not said to be zero


def test_gain_and_delay_are_told_apart():
    a = agreement(common_ground(A, changed(A, 1.1, 2e-4)))
    np.testing.assert_allclose(a.bias_db, 20 * np.log10(1.1))
    np.testing.assert_allclose(a.magnitude_db, 20 * np.log10(1.1))
    np.testing.assert_allclose(a.delay, 2e-4, rtol=1e-9)
    np.testing.assert_allclose(a.fdac, 1)  # one number per frequency: the shape is the same
    assert np.all(a.frac < 0.999)  # along frequency the phase turns


def test_frac_ignores_a_constant_and_e_band_does_not():
    a = agreement(common_ground(A, changed(A, 0.8)))
    np.testing.assert_allclose(a.frac, 1)
    assert a.band == pytest.approx(0.2)
    np.testing.assert_allclose(a.per_frequency, 0.2)
    np.testing.assert_allclose(a.error, 0.2)


def test_misfit_of_two_noisy_measurements_is_one(tmp_path):
    scene = part(A, 2, 2)
    noise = noise_for(30.0, scene, SWEEP.samples(), RATE, SENSOR)
    both = [
        calibrate(plan_for(scene, repeats=8), device_for(scene, noise=noise, seed=s), tmp_path / str(s)).transfer
        for s in (1, 2)
    ]
    a = agreement(common_ground(*both))
    assert a.misfit == pytest.approx(1.0, abs=0.08)  # about 900 complex differences, and the floor keeps strong ones


def test_fdac_ridge_moves_with_a_resonance():
    f = np.arange(20.0, 400.0, 4.0)

    def two_modes(shift):
        k = (f[:, None, None] - shift) / 60
        return replace(wave_matrix(f), values=np.exp(1j * k * np.arange(9)[None, :, None]) * (1 + 0j * np.arange(4)))

    ridge = fdac_matrix(common_ground(two_modes(0.0), two_modes(20.0))).argmax(axis=1)
    assert np.all(ridge[:-6] - np.arange(len(f))[:-6] == 5)  # 20 Hz = 5 bins later


def test_finer_grid_is_copied_where_it_has_the_bins_and_splined_where_not():
    fine = wave_matrix(np.arange(10.0, 500.5, 0.5))
    exact = common_ground(A, fine)
    assert exact.interpolated == ""
    assert agreement(exact).band == 0
    offset = common_ground(wave_matrix(np.arange(11.3, 480.0, 7.0)), fine)
    assert offset.interpolated == "b"
    assert agreement(offset).band < 1e-4  # cubic spline through 0.5 Hz bins
    assert offset.only_b == ((10.0, 11.3), (pytest.approx(473.3), 500.0))


def test_gaps_are_not_bridged():
    fine = wave_matrix(np.arange(10.0, 500.5, 0.5))
    keep = (fine.frequency < 200) | (fine.frequency > 260)
    holed = replace(fine, frequency=fine.frequency[keep], values=fine.values[keep])
    coarse = wave_matrix(np.arange(11.3, 480.0, 7.0))
    ground = common_ground(coarse, holed)
    inside = (ground.frequency > 200) & (ground.frequency < 260)
    assert not ground.valid[inside].any()
    assert ground.valid[~inside].all()
    assert ground.covered == pytest.approx(np.mean(~inside))
    assert agreement(ground).band < 1e-4


def test_a_gap_in_one_is_a_part_of_the_band_that_only_the_other_has():
    fine = wave_matrix(np.arange(10.0, 500.5, 0.5))
    keep = (fine.frequency < 200) | (fine.frequency > 260)
    holed = replace(fine, frequency=fine.frequency[keep], values=fine.values[keep])
    assert common_ground(holed, fine).only_b == ((199.5, 260.5),)
    assert common_ground(fine, holed).only_a == ((199.5, 260.5),)
    assert common_ground(holed, fine).only_a == ()


@pytest.mark.parametrize(("step", "gaps"), [(2.5, ()), (3.5, ((200.0, 203.5),))])
def test_an_interval_is_a_gap_from_three_times_those_about_it(step, gaps):
    """Samples are 1 Hz apart but for one interval."""
    axis = np.concatenate([np.arange(10.0, 201.0), 200.0 + step + np.arange(290.0)])
    assert common_ground(wave_matrix(np.arange(20.25, 480.0, 0.5)), wave_matrix(axis)).only_a == gaps


def test_an_axis_that_grows_coarser_by_and_by_has_no_gaps():
    """Steps of a logarithmic axis are seven times its median at the end; all of it was left out as gaps."""
    uneven = wave_matrix(np.geomspace(10.0, 500.0, 600))
    ground = common_ground(wave_matrix(np.arange(20.0, 480.0, 7.0)), uneven)
    assert ground.interpolated == "b"
    assert ground.valid.all()
    assert agreement(ground).band < 1e-4
    assert ground.only_a == ground.only_b[1:-1] == ()


def test_what_interpolation_may_cost_is_said_where_it_counts():
    """A G compared with itself on samples too far apart for its waves differs by the spline alone, which is said to be
    no smaller; where samples are dense no word is lost."""
    for step in (16.0, 24.0, 32.0, 40.0):
        sparse, asked = wave_matrix(np.arange(10.0, 500.0, step)), wave_matrix(np.arange(21.3, 440.0, 1.7 * step))
        said = common_ground(asked, sparse)
        (note,) = said.notes
        assert f"B is interpolated between samples up to {step:g} Hz apart, which alone may make an e_band of" in note
        stated, true = float(note.partition("an e_band of ")[2].split(":")[0]), agreement(said).band
        assert true < stated < 7 * true
        assert compare(asked, sparse, render=False).notes[0] == note
    assert not common_ground(asked, wave_matrix(np.arange(10.0, 500.0, 4.0))).notes


def test_the_scale_of_an_arbitrary_gain_is_said_to_mean_nothing():
    b = replace(A, provenance={"gain": "arbitrary"})
    assert compare(A, b, render=False).notes[0].startswith("the gain of B is arbitrary, as was declared: FRAC, phases")
    assert compare(b, A, render=False).notes[0].startswith("the gain of A is arbitrary")
    assert compare(A, A, render=False).notes == ()
    assert "overall FRAC 1.00" in answer_lines(compare(A, b, render=False))[0]  # and no percentage of nothing


def test_masked_entries_stay_out_of_everything():
    valid = np.ones(A.values.shape, dtype=bool)
    valid[:, 4, 2] = False
    b = replace(A, values=np.where(valid, A.values, 1e3), valid=valid)
    c = compare(A, b, render=False)
    assert c.agreement.band == 0
    assert np.isnan(c.agreement.frac[4, 2])
    assert np.isnan(c.condition_b).all()
    assert c.ground.covered == pytest.approx(35 / 36)
    assert json.loads(as_json(c))["entries"][4 * 4 + 2]["e"] is None


def test_ports_are_matched_by_name():
    order = [3, 1, 0, 2]
    b = replace(A, values=A.values[:, :, order], inputs=tuple(A.inputs[i] for i in order))
    assert compare(A, b, render=False).agreement.band == 0
    with pytest.raises(DataError, match="B lacks A4 of A"):
        compare(A, part(A, 9, 3))
    with pytest.raises(DataError, match="cannot be compared"):
        compare(A, replace(A, unit="m/N"))
    with pytest.raises(DataError, match="share no frequency"):
        compare(A, wave_matrix(np.arange(600.0, 700.0, 2.0)))


def test_waves_by_the_thesis_estimator_on_both():
    c = compare(A, wave_matrix(speed=4.0), render=False)
    at = np.searchsorted(c.ground.frequency, 100.0)
    assert c.waves_a[0].speed[at] == pytest.approx(3.0, rel=1e-6)
    assert c.waves_b[0].speed[at] == pytest.approx(4.0, rel=1e-6)
    assert c.waves_a[0].attenuation[at] == pytest.approx(40 + 2 * np.pi * 100 / 20, rel=1e-6)
    np.testing.assert_allclose(c.condition_a, condition_number(A.values))


def test_points_under_a_cone_are_in_no_wave_fit():
    """They move with the cone; the figure of the same G left them out, and this table did not."""
    source = replace(A.inputs[0], radius=3.5e-3)
    x, y, z = source.position
    places = [(x + d, y, z) for d in (2e-3, 6e-3, 9e-3, 13e-3, 18e-3)]
    outputs = tuple(Port(str(k), "point", p) for k, p in enumerate(places))
    frequency = np.arange(20.0, 200.0, 10.0)
    k = (2 * np.pi * frequency / 3.0 - 40j)[:, None, None]
    values = 1e-5 * np.exp(-1j * k * distances(outputs, (source,)))
    values[:, 0] = 1e-4
    c = compare(*[TransferMatrix(frequency, values, outputs, (source,))] * 2, render=False)
    assert c.waves_a[0].speed == pytest.approx(3.0)
    assert c.waves_a[0].attenuation == pytest.approx(40.0)


def test_where_a_matrix_is_singular_is_counted_apart_from_its_condition_numbers():
    values = A.values.copy()
    values[3:5, :, 0] = 0.0
    told = comparison_record(compare(replace(A, values=values), A, render=False))["condition_number"]
    assert told["A"]["infinite_at"] == 2
    assert told["B"]["infinite_at"] == 0
    known = np.delete(condition_number(A.values), [3, 4])
    assert told["A"]["max"] == pytest.approx(known.max())
    assert told["A"]["median"] == pytest.approx(np.median(known))


def test_cross_play_with_itself_costs_nothing_and_with_another_arm_something():
    same = cross_play(common_ground(A, changed(A, 0.7)), targets=("5", "6"))
    np.testing.assert_allclose(same.worth, 1, rtol=1e-9)  # S does not know gain
    other = cross_play(common_ground(A, wave_matrix(stretch=1.4)), targets=("5",))
    inverse = other.methods.index("inverse filter")
    assert other.a_on_b[inverse, 0] < other.b_on_b[inverse, 0]


def test_s_on_other_bins_than_the_runs_keeps_its_renderers_and_says_so():
    """It took the thesis' 250 Hz in place of the scenario's wavelet without a word: S 4.3 for 3.0."""
    rendering = {"wavelet": {"peak": 120.0}, "methods": ["funneling"]}
    scene = {"name": "slow", "limb": {"shape": "slab"}, "rendering": rendering}
    whole = replace(A, provenance={"scenario": scene})
    own = cross_play(common_ground(whole, A), targets=("5",))
    assert own.how == "the renderers of scenario 'slow' with the wavelet Ricker 120 Hz"
    assert own.methods == ("funneling",)
    kept = slice(None, None, 3)
    odd = replace(A, frequency=A.frequency[kept] + 0.13, values=A.values[kept])
    other = compare(odd, replace(whole, frequency=odd.frequency, values=odd.values))
    assert other.crossed.how.startswith(f"{own.how}; its bins are not the common frequencies")
    assert other.crossed.methods == ("funneling",)
    assert f"S by {other.crossed.how}." in as_markdown(other)
    assert comparison_record(other)["rendered"] == other.crossed.how
    assert cross_play(common_ground(A, A), targets=("5",)).how.startswith("the thesis' renderers with the wavelet")


@pytest.mark.parametrize("speed", [5.0, 3.0, 2.0])
def test_speeds_are_told_where_phases_can_be_unwrapped(speed):
    """Points 11 mm apart are an alias' points beyond some frequency: -771 to 600 m/s were printed for 3 m/s."""
    away = distances(A.outputs, A.inputs)
    g = replace(A, values=np.exp(-(30 + 1j * A.omega[:, None, None] / speed) * away))
    found = comparison_record(compare(g, g, render=False))["waves"]
    for wave in (w["A"] for w in found if w["A"]):
        assert list(wave["speed_m_s"].values()) == pytest.approx([speed] * 3, rel=1e-9)
        assert A.frequency[0] < wave["speed_to_Hz"] < A.frequency[-1]


def test_wavelet_sits_on_the_common_bins():
    shape = wavelet_for(np.arange(10.0, 500.5, 0.5))
    assert (shape.record.sample_rate, shape.record.n) == (4000.0, 8000)
    odd = wavelet_for(np.arange(9, 201) * 1300 / 522)
    assert odd.record.df == pytest.approx(1300 / 522)
    assert wavelet_for(np.array([10.0, 17.0, 19.0])).record.n == 20000


def test_two_files_of_one_name_are_told_apart_by_their_folders(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for folder, factor in (("one", 1.0), ("two", 1.05)):
        Path(folder).mkdir()
        save(Path(folder) / "G.nc", changed(A, factor))
    text = run_compare("one/G.nc", "two/G.nc").text
    assert "two/G.nc differs from one/G.nc" in text
    assert "forearm-fem render two/G.nc" in text


def test_run_compare_writes_table_csv_json_and_figure(tmp_path):
    save(tmp_path / "a.nc", A)
    save(tmp_path / "b.csv", changed(A, 1.05))
    result = run_compare(tmp_path / "a.nc", tmp_path / "b.csv", folder=tmp_path / "out")
    shows_itself(result)
    assert result.sel("5", "A1") == pytest.approx(0.05, rel=1e-6)
    assert sorted(f.name for f in result.files) == [
        "comparison.csv",
        "comparison.html",
        "comparison.json",
        "comparison.md",
        "comparison.png",
    ]
    content = json.loads((tmp_path / "out" / "comparison.json").read_text())
    assert content["overall"]["e_band"] == pytest.approx(0.05)
    assert content["A"] == "a.nc"
    assert "| inverse filter |" in result.text
    assert len(as_csv(result.comparison).splitlines()) == 37


def test_what_cannot_be_rendered_is_said_not_raised():
    line = part(A, 9, 1)
    c = compare(line, line)
    assert c.crossed is None
    assert c.not_crossed in as_markdown(c)
    assert comparison_record(c)["signal_strength"]["missing"]


def test_picture_names_its_axes_and_keeps_gaps():
    valid = np.ones(A.values.shape, dtype=bool)
    valid[10:20] = False
    c = compare(A, replace(changed(A, 1.2), valid=valid), names=("first", "second"), render=False)
    figure = picture(c)
    drawn = [ax for ax in figure.axes if ax.axison and ax.get_title()]
    assert [ax.get_title(loc="left") for ax in drawn] == ["a", "b", "c"]
    assert all(ax.get_xlabel() and ax.get_ylabel() for ax in drawn)
    a, b = (np.asarray(line.get_ydata()) for line in drawn[0].lines)
    assert np.isnan(a[10:20]).all()
    assert np.isfinite(np.delete(b, range(10, 20))).all()
    assert any("first" in t.get_text() and "second" in t.get_text() for t in figure.texts)


def test_the_picture_shows_micrometres_as_all_figures_do():
    panel = plot_overlay(common_ground(A, A), 0, 0)
    assert panel.get_ylabel() == "|G| [µm/V]"
    np.testing.assert_allclose(panel.lines[0].get_ydata(), 1e6 * np.abs(A.values[:, 0, 0]))


def test_the_place_and_the_band_of_a_difference_are_found():
    """Point 3 from the second actuator, in the upper half of the band alone."""
    values = A.values.copy()
    values[len(values) // 2 :, 2, 1] *= 1.5
    ground = common_ground(A, replace(A, values=values))
    found = where(ground)
    band, output, source = found.worst()
    assert (band, ground.outputs[output].name, ground.inputs[source].name) == (3, "3", "A2")
    assert found.share.sum() == pytest.approx(1)
    assert found.share[:, 2, 1].sum() == pytest.approx(1)
    assert np.nanmax(np.delete(found.error.reshape(len(found.bands), -1), 2 * 4 + 1, axis=1)) == 0
    assert where_words(found, ground).startswith("They differ most at point 3 from A2 at ")
    assert where_words(where(common_ground(A, A)), ground) == "They do not differ"


@pytest.mark.parametrize(
    ("gain", "said"),
    [
        (0.8 * np.ones((9, 4)), "one gain explains most: B times 1.25"),
        (np.array([1, 1, 0.5, 1]) * np.ones((9, 1)), "a gain of each actuator explains most: B's A3 times 2, the"),
        (np.array([[1], [1.6], *[[1]] * 7]) * np.ones(4), "a gain of each point explains most: B's 2 times 0.625, the"),
    ],
)
def test_a_gain_that_explains_the_difference_is_the_likeliest_cause(gain, said):
    assert where(common_ground(A, replace(A, values=A.values * gain))).cause.startswith(said)


def test_scenarios_that_differ_are_the_likeliest_cause():
    """ "One gain explains most; check calibration" was said of two simulations of different limbs."""
    limbs = {"limb": {"shape": "slab", "length": 0.2}, "name": "a"}, {"limb": {"shape": "forearm"}, "name": "b"}
    ours, theirs = (replace(A, provenance={"scenario": s}) for s in limbs)
    cause = where(common_ground(ours, replace(theirs, values=0.8 * A.values))).cause
    assert cause == "the two were simulated by scenarios that differ in limb.shape"
    assert where(common_ground(ours, replace(ours, values=0.8 * A.values))).cause.startswith("one gain")


def test_one_bad_actuator_is_the_likeliest_cause():
    """Its own delay is no gain, and no delay of the whole."""
    turn = np.exp(-1j * A.omega * 2e-3)[:, None] * np.array([1, 0, 0, 0]) + np.array([0, 1, 1, 1])
    cause = where(common_ground(A, replace(A, values=A.values * turn[:, None]))).cause
    assert cause.startswith("actuator A1 alone holds 100%")


def test_s_is_of_the_same_points_for_both_and_says_which_are_left_out():
    """2.94 became 4.05 as one G lacked points, and the page said nothing."""
    valid = np.ones(A.values.shape, dtype=bool)
    valid[:, 2] = False
    c = compare(A, replace(A, valid=valid))
    kept, said = compared_targets(c)
    assert "3" not in c.crossed.targets
    assert len(c.crossed.targets) == 8
    assert "point 3" in said
    assert "over the same 8 points for both" in strength_words(c)
    np.testing.assert_allclose(c.crossed.a_on_a[:, kept], c.crossed.b_on_b[:, kept])
