"""How strong stimuli are, what they are made from, and what other programs are handed."""

from __future__ import annotations

import csv
import json
import shutil
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy.io import wavfile
from test_rendering import waves
from test_study_session import GRID

pytest.importorskip("pandas")

from forearm_fem.errors import DataError, HardwareError, ScenarioError
from forearm_fem.measurement.virtual import VirtualDaq, VirtualOptions
from forearm_fem.rendering import InverseFilter, drives, render_all, ricker
from forearm_fem.results.files import write_transfer
from forearm_fem.scenario import parse_scenario
from forearm_fem.scenario.measurement import DaqOptions
from forearm_fem.study.handover import answers, at_rate, export
from forearm_fem.study.plan import Stimuli
from forearm_fem.study.run import Prepared, sitting
from forearm_fem.study.stimuli import DevicePlayer, Motion, Stimulus, apart, motion, sensitivity, stimuli_for, told
from forearm_fem.transfer import TransferMatrix

SCENE = parse_scenario({"sweep": {"sample_rate": 5000.0, "duration": 0.2}})
SHAPE = ricker(sample_rate=5000.0, duration=0.2)
WAVES = waves(np.arange(10.0, 500.1, 5.0))
HOW = {"lead": 0.05, "tail": 0.09}
PEAK = 0.1  # um: these waves are so alike at the points that the filter needs 18 V for 1 um


def motions(**how):
    how = {"peak": PEAK, **how} if how.get("levels") != "as rendered" else how
    made = stimuli_for(WAVES, SCENE, Stimuli(**HOW, **how), SHAPE)
    return {k: s.moved for k, s in made.items()}


@pytest.fixture
def lab(tmp_path):
    """A study of three methods at nine targets on waves, one G for everybody."""
    write_transfer(tmp_path / "g.nc", WAVES)
    (tmp_path / "flat.toml").write_text("name = 'flat'\n[sweep]\nsample_rate = 5000.0\nduration = 0.2\n")
    text = "name = 'pilot'\nscenario = 'flat.toml'\ntransfer = 'g.nc'\n[stimuli]\nlead = 0.05\ntail = 0.09\n"
    text += f"peak = {PEAK}\n"
    (tmp_path / "pilot.toml").write_text(text)
    return tmp_path


def test_sensitivity_follows_verrillo():
    """12 dB per octave up to 220 Hz, 9 down above; the other channel is flat and crosses at 150 Hz."""
    pacinian, flat = 20 * np.log10(sensitivity(np.array([55.0, 110.0, 150.0, 220.0, 440.0])))
    assert pacinian[[3, 1, 0, 4]] == pytest.approx([0, -12, -24, -9], abs=1e-9)
    assert flat == pytest.approx(np.full(5, pacinian[2]), abs=1e-9)
    assert sensitivity(np.array([0.0])).tolist() == [[0.0], [0.0]]


def test_the_level_of_a_tone_is_its_weighted_rms():
    """2 um at 250 Hz over whole periods: exact by Parseval; a tone at half the amplitude is 6.02 dB less."""
    time = np.arange(2000) / 2000
    tone = 2e-6 * np.sin(2 * np.pi * 250 * time)
    found = motion(tone, 2000.0, 1.0)
    both = sensitivity(np.array([250.0]))[:, 0]
    assert (found.peak, found.rms) == (pytest.approx(2e-6), pytest.approx(2e-6 / np.sqrt(2)))
    assert found.weighted == pytest.approx(20 * np.log10(np.sqrt(2) * np.linalg.norm(both)), abs=1e-9)
    assert motion(tone, 2000.0, 0.5).weighted == pytest.approx(found.weighted + 3.0103, abs=1e-4)  # in half the time
    assert motion(tone / 2, 2000.0, 1.0).weighted == pytest.approx(found.weighted - 6.0206, abs=1e-4)


def test_methods_are_equal_at_every_target_where_they_were_20_db_apart():
    """The default. Half a decibel is promised and exact scaling keeps 1e-9; the level is that of the wavelet."""
    assert max(apart(motions(levels="as rendered")).values()) > 10
    equal = motions()
    assert max(apart(equal).values()) < 1e-9
    levels = [m.weighted for m in equal.values()]
    kept = np.where((SHAPE.time >= -0.05) & (SHAPE.time <= 0.09), SHAPE.samples, 0.0)
    own = motion(1e-6 * PEAK * kept, 5000.0, 0.1402)  # 701 samples
    assert np.ptp(levels) < 1e-9
    assert levels[0] == pytest.approx(own.weighted, abs=1e-9)
    assert [m.weighted for m in motions(peak=PEAK / 2).values()] == pytest.approx(
        [v - 6.0206 for v in levels], abs=1e-4
    )


def test_a_level_is_the_motion_of_what_is_played():
    """The motion told is G times the faded, cut drives, by a sum of sines for every bin."""
    made = stimuli_for(WAVES, SCENE, Stimuli(**HOW, peak=PEAK), SHAPE)["funneling", "6"]
    n, rate = made.signals.shape[1], 5000.0
    fade = round(0.005 * rate)
    ramp = (1 - np.cos(np.pi * (np.arange(fade) + 0.5) / fade)) / 2
    whole = np.zeros((4, 1000))
    whole[:, :n] = made.signals
    whole[:, :fade] *= ramp
    whole[:, n - fade : n] *= ramp[::-1]
    row = [p.name for p in WAVES.outputs].index("6")
    spectrum = np.fft.rfft(whole, axis=1)[:, 2:101]
    moved = np.zeros(1000)
    for f, g, s in zip(WAVES.frequency, WAVES.values[:, row], spectrum.T, strict=True):
        moved += 2 / 1000 * np.real(g @ s * np.exp(2j * np.pi * f * np.arange(1000) / rate))
    assert made.moved.peak == pytest.approx(np.abs(moved).max(), rel=1e-9)
    assert made.moved.rms == pytest.approx(np.sqrt(np.sum(moved**2) / n), rel=1e-9)


def test_tables_and_files_of_levels_are_added_to_equal_ones(lab):
    """A matching task's result, by its file; a participant's own line goes before the one for all."""
    text = (lab / "pilot.toml").read_text()
    (lab / "pilot.toml").write_text(text.replace("[stimuli]", "[stimuli]\nlevels = 'matched.csv'"))
    lines = ["participant,method,target,level_db"]
    lines += [f",{m},{t},0.0" for m in ("inverse filter", "combination", "funneling") for t in range(1, 10)]
    (lab / "matched.csv").write_text("\n".join([*lines, "01,funneling,5,-3.5"]))
    prepared = Prepared.of(lab / "pilot.toml")
    for who, wanted in (("01", -3.5), ("02", 0.0)):
        made = prepared.made(who).stimuli
        apart_by = made["funneling", "5"].moved.weighted - made["inverse filter", "5"].moved.weighted
        assert apart_by == pytest.approx(wanted, abs=1e-9)
    assert "not equally strong" in told({k: s.moved for k, s in prepared.made("01").stimuli.items()})
    (lab / "matched.csv").write_text("\n".join(lines[:-1]))
    with pytest.raises(ScenarioError, match="no level_db for funneling at target 9"):
        prepared.made("01")
    (lab / "matched.csv").unlink()
    with pytest.raises(ScenarioError, match="neither 'equal at target' nor 'as rendered' nor a CSV"):
        prepared.made("01")


def test_levels_out_of_reach_say_what_is_reached_and_that_is():
    with pytest.raises(ScenarioError, match=r"V, the limit is 2\.5 V.*set stimuli\.peak = ") as problem:
        motions(peak=500.0)
    reached = float(str(problem.value).rpartition("= ")[2])
    assert max(apart(motions(peak=reached)).values()) < 1e-9
    made = stimuli_for(WAVES, SCENE, Stimuli(**HOW, peak=reached), SHAPE)
    assert 2.4 < max(np.abs(s.signals).max() for s in made.values()) <= 2.5  # a tenth of a decibel below, at most


def test_power_of_a_coil_limits_levels_too():
    """Repeated at 2.5 V the continuous rating allows; at a hundredth of it the power binds before the voltage."""
    weak = SCENE.model_copy(update={"device": SCENE.device.model_copy(update={"max_power": 1e-5})})
    with pytest.raises(ScenarioError, match=r"W, the limit is 1e-05 W"):
        stimuli_for(WAVES, weak, Stimuli(**HOW), SHAPE)


def test_a_g_of_arbitrary_gain_is_levelled_by_the_strongest_drive():
    """No drive follows from micrometres; equal levels need none, and the strongest drive is what is asked."""
    g = replace(WAVES, provenance={"gain": "arbitrary"})
    with pytest.raises(ScenarioError, match=r"set stimuli\.drive"):
        stimuli_for(g, SCENE, Stimuli(**HOW), SHAPE)
    made = stimuli_for(g, SCENE, Stimuli(**HOW, drive=0.5), SHAPE)
    assert max(np.abs(s.signals).max() for s in made.values()) == pytest.approx(0.5)
    assert max(apart({k: s.moved for k, s in made.items()}).values()) < 1e-9


def test_stimuli_on_a_g_with_holes_are_those_of_a_run():
    """Bins that were not measured are bridged before anything is aimed, as `render` does: undriven, a hole of three of
    123 rings through the record and moves the drives by per cents."""
    g, shape = waves(np.arange(12.0, 500.1, 4.0)), ricker(duration=0.25)
    valid = np.ones(g.values.shape, dtype=bool)
    valid[[20, 45, 70]] = False
    holed = replace(g, valid=valid, values=np.where(valid, g.values, np.nan))
    scenario = parse_scenario({"sweep": {"duration": 0.25}})
    wanted = Stimuli(methods=("inverse filter",), targets=("5",), lead=0.1, tail=0.1, levels="as rendered")
    expected = render_all(holed, ("5",), (InverseFilter(),), shape)["inverse filter", "5"].drives.signals
    kept = np.abs(shape.record.time) <= 0.1
    found = stimuli_for(holed, scenario, wanted, shape)["inverse filter", "5"]
    np.testing.assert_allclose(found.signals, expected[:, kept], atol=1e-9 * np.abs(expected).max())
    undriven = drives(InverseFilter(), holed, "5", shape).signals[:, kept]
    assert np.abs(undriven - found.signals).max() > 0.01 * np.abs(found.signals).max()


@pytest.mark.parametrize(("repeats", "lasts"), [(1, 0.1), (3, 0.9)])
def test_what_is_played_ends_with_its_last_wavelet_and_keeps_the_limit(repeats, lasts):
    """Wavelets of 0.1 s, 0.3 s of silence between them and none after."""
    g = TransferMatrix(np.array([50.0, 100.0]), np.ones((2, 1, 1), dtype=complex), GRID[:1], (GRID[0],))
    daq, options = VirtualDaq(g, 1000.0, 0.1, VirtualOptions()), DaqOptions(outputs=("a",))
    stimuli = {("funneling", "5"): Stimulus(np.ones((1, 100)), Motion(1.0, 1.0, 0.0))}
    player = DevicePlayer(daq, stimuli, 1000.0, options, Stimuli(repeats=repeats, pause=0.3))
    assert player("funneling", "5").seconds == pytest.approx(lasts)
    loud = {("funneling", "5"): Stimulus(4 * np.ones((1, 100)), Motion(1.0, 1.0, 0.0))}
    with pytest.raises(HardwareError, match=r"needs 4 V, the limit is 2\.5 V"):
        DevicePlayer(daq, loud, 1000.0, options, Stimuli())


def _sit(lab, who="01", task="identification"):
    with sitting(Prepared.of(lab / "pilot.toml"), who, task, consent="2026-11-24") as (session, *_):
        session.start()
        session.present()
        session.answer(("5",))
        return session._store.answers(who, session.task.name)[-1]


def test_tasks_in_balanced_order_come_in_that_order_without_being_named(lab):
    text = (lab / "pilot.toml").read_text() + "[order]\ntasks = 'balanced'\n"
    (lab / "pilot.toml").write_text(text)
    _sit(lab, "01", None)
    store = Prepared.of(lab / "pilot.toml").store()
    assert len(store.answers("01", "identification")) == 1
    with pytest.raises(DataError, match="confidence comes before identification by the balanced order"):
        _sit(lab, "02", "identification")
    assert store.people()[-1]["participant_id"] == "sub-01"  # who was refused is not enrolled
    _sit(lab, "02", None)
    assert len(store.answers("02", "confidence")) == 1


CHANGES = {
    "G": lambda lab: write_transfer(lab / "g.nc", replace(WAVES, values=1.01 * WAVES.values)),
    "the scenario": lambda lab: (lab / "flat.toml").write_text((lab / "flat.toml").read_text() + "[tissues]\n"
                                                               "override = { skin = { density = 1101.0 } }\n"),
    "the levels": lambda lab: (lab / "pilot.toml").write_text((lab / "pilot.toml").read_text().replace("0.1", "0.11")),
}  # fmt: skip


@pytest.mark.parametrize("what", CHANGES)
def test_what_changed_between_two_sittings_is_refused_by_name(lab, what):
    """Also in another task; another participant may get what is new, but for a study file that binds everybody."""
    row = _sit(lab)
    made = Prepared.of(lab / "pilot.toml").made("01")
    stimulus = made.stimuli[row["method"], row["target"]]
    assert {k: row[k] for k in made.sources} == made.sources
    assert (row["drives"], float(row["weighted_db"])) == (stimulus.digest, pytest.approx(stimulus.moved.weighted, 1e-4))
    _sit(lab)
    CHANGES[what](lab)
    said = (
        "the study file was changed" if what == "the levels" else f"{what} changed since 20.* when trial 1 was answered"
    )
    with pytest.raises(DataError, match=said):
        _sit(lab, task="confidence")
    if what != "the levels":
        _sit(lab, who="02")


def test_a_wav_plays_the_drives_at_the_cards_rate(lab):
    """Against the drives' Fourier series at the card's instants; a 32-bit float keeps 1e-7 of full scale."""
    prepared = Prepared.of(lab / "pilot.toml")
    made = prepared.made("01")
    folder = export(prepared, "01", made, rate=44100.0, full_scale=5.0)
    rate, samples = wavfile.read(folder / "wav/inverse-filter_5.wav")
    assert (rate, samples.dtype, samples.shape[1]) == (44100, np.float32, 4)
    volts, n = made.stimuli["inverse filter", "5"].signals, made.stimuli["inverse filter", "5"].signals.shape[1]
    fade = 25
    ramp = (1 - np.cos(np.pi * (np.arange(fade) + 0.5) / fade)) / 2
    whole = np.zeros((4, 2000))
    whole[:, 50 : 50 + n] = volts * np.concatenate([ramp, np.ones(n - 2 * fade), ramp[::-1]])
    spectrum, k = np.fft.rfft(whole, axis=1) / 2000, np.arange(1001)
    weight = np.where((k == 0) | (k == 1000), 1.0, 2.0)
    at = np.arange(len(samples)) / 44100
    expected = np.real((spectrum * weight) @ np.exp(2j * np.pi * 5000 / 2000 * np.outer(k, at)))
    assert np.abs(5.0 * samples.T - expected).max() < 1e-6 * np.abs(volts).max() + 5e-7
    assert len(samples) == round((n + 100) * 44100 / 5000)


@pytest.mark.parametrize("rate", [8000.0, 44100.0, 48000.0, 96000.0])
def test_resampling_keeps_a_tone(rate):
    """200 Hz under a slow window: its samples at any rate are those of the formula, to the window's leakage."""

    def shape(t):
        return np.where((t > 0) & (t < 0.2), np.sin(np.pi * t / 0.2) ** 4 * np.sin(2 * np.pi * 200 * t), 0.0)

    found = at_rate(shape(np.arange(2001) / 1e4)[None], 1e4, rate)[0]
    assert found == pytest.approx(shape(np.arange(len(found)) / rate - 0.01), abs=1e-6)


def test_too_little_full_scale_is_a_sentence(lab):
    prepared = Prepared.of(lab / "pilot.toml")
    with pytest.raises(ScenarioError, match=r"V at the output, full scale is 0\.01 V"):
        export(prepared, "01", prepared.made("01"), rate=48e3, full_scale=0.01)
    with pytest.raises(ScenarioError, match=r"--rate 1000: expected at least 1250 Hz"):
        export(prepared, "01", prepared.made("01"), rate=1e3, full_scale=10.0)


def test_drives_as_rendered_beyond_the_limits_are_not_handed_over(lab):
    text = (lab / "pilot.toml").read_text().replace("peak = 0.1", "levels = 'as rendered'")
    (lab / "pilot.toml").write_text(text)
    (lab / "flat.toml").write_text((lab / "flat.toml").read_text() + "[rendering]\namplitude = 3.0\n")
    prepared = Prepared.of(lab / "pilot.toml")
    with pytest.raises(ScenarioError, match=r"V, the limit is 2\.5 V, lower rendering\.amplitude"):
        export(prepared, "01", prepared.made("01"), rate=48e3, full_scale=100.0)


@pytest.fixture
def handed(lab):
    """Exported trials of participant 01, as rows, with the study's store and grid."""
    prepared = Prepared.of(lab / "pilot.toml")
    folder = export(prepared, "01", prepared.made("01"), rate=8000.0, full_scale=10.0)
    with (folder / "trials.csv").open() as stream:
        rows = [r for r in csv.DictReader(stream) if r["task"] == "identification"]
    assert len(rows) == 108
    assert all((folder / r["wav"]).exists() for r in rows)
    assert {"psychopy_study.py", "jspsych_study.html", "stimuli.json"} <= {p.name for p in folder.iterdir()}
    return lab, rows, prepared


def _written(lab, rows, kind):
    """The rows as the program of that kind writes them, each answered with its target."""
    file = lab / f"answers.{'json' if kind == 'jspsych' else 'csv'}"
    if kind == "jspsych":
        told = [
            {**r, "response": [r["target"]], "rt": 1500, "trial_type": "choose-points", "time_elapsed": 1} for r in rows
        ]
        file.write_text(json.dumps([{"trial_type": "page", "rt": 3}, *told]))
        return file
    name, time, answer = {
        "psychopy": ("response", "response_time", "{}"), "builder": ("key_resp.keys", "key_resp.rt", "num_{}"),
        "mouse": ("mouse.clicked_name", "response_time", "['{}']"), "excel": ("response", "response_time", "{}"),
    }[kind]  # fmt: skip
    told = [{**r, name: answer.format(r["target"]), time: 1.5, "expName": "pilot"} for r in rows]
    with file.open("w", newline="", encoding="utf-8-sig") as stream:
        stream.write("sep=;\n" if kind == "excel" else "")
        writer = csv.DictWriter(stream, list(told[0]), delimiter=";" if kind == "excel" else ",")
        writer.writeheader()
        writer.writerows(told)
    return file


@pytest.mark.parametrize("kind", ["psychopy", "builder", "mouse", "jspsych", "excel"])
def test_answers_of_other_programs_become_our_own_table(handed, kind):
    lab, rows, prepared = handed
    table = answers(prepared.store(), [_written(lab, rows, kind)], prepared.grid())["identification"]
    assert table["trial"].tolist() == list(range(1, 109))
    assert table["response"].tolist() == [r["target"] for r in rows]
    assert table["response_time"].tolist() == [1.5] * 108
    places = {p.name: p.position for p in prepared.grid()}
    assert table["response_x"].tolist() == [places[r["target"]][0] for r in rows]
    assert set(table["phase"]) == {"training", "main"}
    assert table["weighted_db"].tolist() == pytest.approx([float(r["weighted_db"]) for r in rows])
    assert table["drives"].tolist() == [r["drives"] for r in rows]


def test_answers_that_do_not_fit_the_plan_are_refused(handed):
    lab, rows, prepared = handed
    file = _written(lab, rows, "psychopy")
    shutil.copy(file, lab / "twice.csv")
    for change, words in (
        ({"method": "funneling" if rows[0]["method"] != "funneling" else "combination"}, "planned was"),
        ({"trial": "999"}, "planned was none"), ({"participant": "07"}, "participant 07 is unknown"),
    ):  # fmt: skip
        with pytest.raises(DataError, match=words):
            answers(prepared.store(), [_written(lab, [{**rows[0], **change}], "psychopy")], prepared.grid())
    other = [{**r, "transfer": "0123456789ab"} if int(r["trial"]) > 50 else r for r in rows]
    with pytest.raises(DataError, match="participant 01 answered stimuli made from two versions of transfer"):
        answers(prepared.store(), [_written(lab, other, "psychopy")], prepared.grid())
    file = _written(lab, rows, "psychopy")
    with pytest.raises(DataError, match="trial 1 of identification by 01 is answered twice"):
        answers(prepared.store(), [file, lab / "twice.csv"], prepared.grid())
    file.write_text("a,b\n1,2\n")
    with pytest.raises(DataError, match=r"holds no answer to a trial of trials\.csv"):
        answers(prepared.store(), [file], prepared.grid())
    file.write_text("not json")
    with pytest.raises(DataError, match="cannot be read as PsychoPy's CSV or jsPsych's"):
        answers(prepared.store(), [file.rename(lab / "x.json")], prepared.grid())


_PSYCHOPY = """
import csv, itertools, pathlib, sys, types
class Any:
    def __init__(self, *_, **__): pass
    def __getattr__(self, name): return lambda *_, **__: None
class Handler:
    def __init__(self, name, dataFileName, savePickle): self.file, self.rows, self.row = dataFileName + ".csv", [], {}
    def addData(self, name, value): self.row[name] = value
    def nextEntry(self): self.rows.append(self.row); self.row = {}
    def close(self):
        pathlib.Path(self.file).parent.mkdir(exist_ok=True)
        with open(self.file, "w", newline="", encoding="utf-8-sig") as stream:
            writer = csv.DictWriter(stream, list(self.rows[0])); writer.writeheader(); writer.writerows(self.rows)
keys, played = itertools.cycle([["num_5"], ["5"], ["6"], ["return"]]), []
class Mouse(Any):
    def isPressedIn(self, shape): return False
    def getPressed(self): return [0, 0, 0]
class Clock:
    def reset(self): pass
    def getTime(self): return 1.25
make = lambda **parts: types.SimpleNamespace(**parts)
core = make(Clock=Clock, wait=lambda _: None, quit=sys.exit)
event = make(Mouse=Mouse, waitKeys=lambda **_: None, clearEvents=lambda: None, getKeys=lambda: next(keys))
sys.modules["psychopy"] = make(core=core, event=event, data=make(ExperimentHandler=Handler), visual=make(
    Window=Any, TextStim=Any, Circle=Any))
play = lambda samples, rate, blocking: played.append((samples.shape[1], rate, blocking))
sys.modules["sounddevice"] = make(play=play)
sys.argv = [sys.argv[1], sys.argv[2]]
exec(compile(open(sys.argv[0]).read(), sys.argv[0], "exec"), {"__file__": sys.argv[0], "__name__": "__main__"})
assert len(played) > 100 and set(played) == {(4, 8000, True)}
"""


@pytest.mark.parametrize("task", ["identification", "confidence"])
def test_the_psychopy_script_plays_every_trial_and_its_answers_are_read(handed, task):
    """Run as it is exported, on a stand-in for PsychoPy's modules that presses keys and writes its CSV."""
    _, _, prepared = handed
    script = prepared.folder / "stimuli" / "sub-01" / "psychopy_study.py"
    command = [sys.executable, "-c", _PSYCHOPY, str(script), task]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    table = answers(prepared.store(), [script.parent / "data"], prepared.grid())[task]
    assert table["trial"].tolist() == list(range(1, 109))
    assert table["response_time"].eq(1.25).all()
    assert set(table["response"]) == ({"5", "6"} if task == "identification" else {"6"})
