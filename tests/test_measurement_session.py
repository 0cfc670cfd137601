"""A calibration interrupted at any moment loses nothing that was measured; playing; the command's
functions.
"""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scenes import shows_itself
from scipy.io import wavfile
from test_measurement_scene import (
    INPUTS,
    OUTPUTS,
    RATE,
    SENSOR,
    SWEEP,
    collected,
    device_for,
    options,
    part,
    plan_for,
    wave_matrix,
)

from forearm_fem.errors import AccuracyWarning, DataError, HardwareError, ScenarioError
from forearm_fem.measurement.calibrate import calibrate
from forearm_fem.measurement.playback import play
from forearm_fem.measurement.recording import read_recording
from forearm_fem.measurement.virtual import Faults, VirtualDaq, VirtualOptions
from forearm_fem.questions.calibrate import VirtualSetup, calibration_plan, run_calibration, run_play
from forearm_fem.results.files import read_transfer
from forearm_fem.scenario import parse_scenario

SCENE = part(wave_matrix(), 3, 2)
PERIODS = 5 * SWEEP.n  # samples per entry: lead-in and 4 repeats


class Dying(VirtualDaq):
    """Raises after a number of samples, counted over all sessions."""

    def __init__(self, limit: int) -> None:
        super().__init__(SCENE, RATE, 0.5, VirtualOptions(noise=1e-4, sensor=SENSOR))
        self.left = limit

    def exchange(self, block):
        self.left -= block.shape[1]
        if self.left < 0:
            raise KeyboardInterrupt
        return super().exchange(block)


@pytest.mark.parametrize("moment", random.Random(7).sample(range(250, 6 * PERIODS), 10))
def test_killed_at_a_random_moment_nothing_measured_is_lost(tmp_path, moment):
    with pytest.raises(KeyboardInterrupt):
        calibrate(plan_for(SCENE), Dying(moment), tmp_path)
    whole = moment // PERIODS
    kept = {f.name: f.read_bytes() for f in tmp_path.glob("G_*.nc")}
    assert len(kept) == whole
    seen = []
    resumed = calibrate(plan_for(SCENE), Dying(10**9), tmp_path, after=seen.append)
    assert [p.reused for p in seen] == [True] * whole + [False] * (6 - whole)
    assert resumed.missing == ()
    assert all((tmp_path / name).read_bytes() == content for name, content in kept.items())


RUN = """
import sys
sys.path[:0] = [{tests!r}, {root!r}]
from test_measurement_session import SCENE, device_for, plan_for
from forearm_fem.measurement.calibrate import calibrate
calibrate(plan_for(SCENE), device_for(SCENE, noise=1e-4), {folder!r}, after=lambda p:
print(len(p.entries), flush=True))
"""


@pytest.mark.skipif(os.name == "nt", reason="SIGKILL is POSIX")
def test_sigkill_leaves_whole_recordings_only(tmp_path):
    tests = Path(__file__).parent
    code = RUN.format(tests=str(tests), root=str(tests.parent), folder=str(tmp_path))
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as process:
        for _ in range(2):
            process.stdout.readline()
        time.sleep(0.01)
        process.send_signal(signal.SIGKILL)
    saved = collected(plan_for(SCENE), tmp_path)
    assert len(saved.missing) <= 4
    assert not [f for f in saved.findings if f.kind == "damaged"]
    assert calibrate(plan_for(SCENE), device_for(SCENE, noise=1e-4), tmp_path).missing == ()


def test_an_entry_that_was_bad_is_taken_again_once(tmp_path):
    seen = []
    faulty = device_for(SCENE, noise=1e-3, faults=Faults(dead_inputs=(1,)))
    measured = calibrate(plan_for(SCENE), faulty, tmp_path, after=seen.append)
    assert len(seen) == 6
    assert sum(1 + n for n in faulty._times.values()) == 3 + 3 * 2  # three good entries once, three dead ones twice
    assert measured.transfer.valid[:, :, 0].mean() > 0.8  # the rest lies below the floor
    assert not measured.transfer.valid[:, :, 1].any()


def test_a_damaged_recording_is_measured_again(tmp_path):
    calibrate(plan_for(SCENE), device_for(SCENE, noise=1e-4), tmp_path)
    victim = next(tmp_path.glob("G_2_A1*.nc"))
    victim.write_bytes(victim.read_bytes()[:500])
    seen = []
    calibrate(plan_for(SCENE), device_for(SCENE, noise=1e-4), tmp_path, after=seen.append)
    assert [p.reused for p in seen].count(False) == 1
    assert collected(plan_for(SCENE), tmp_path).missing == ()


def test_a_recording_whose_numbers_were_changed_is_measured_again(tmp_path):
    """A byte amid the samples: every chunk has a checksum."""
    calibrate(plan_for(SCENE), device_for(SCENE, noise=1e-4), tmp_path)
    victim = next(tmp_path.glob("G_2_A1*.nc"))
    content = victim.read_bytes()
    at = content.index(read_recording(victim).response[0, 7:9].tobytes())
    victim.write_bytes(content[:at] + bytes([content[at] ^ 1]) + content[at + 1 :])
    with pytest.raises(DataError, match="measured again"):
        read_recording(victim)
    seen = []
    calibrate(plan_for(SCENE), device_for(SCENE, noise=1e-4), tmp_path, after=seen.append)
    assert [p.reused for p in seen].count(False) == 1


def test_operator_is_asked_once_per_point_still_to_measure(tmp_path):
    told = []
    calibrate(plan_for(SCENE), device_for(SCENE), tmp_path, operator=lambda s: told.append(s) or True)
    assert len(told) == 3
    assert "point 2 (x = -13.3 mm, y = 0.0 mm)" in told[1]
    calibrate(plan_for(SCENE), device_for(SCENE), tmp_path, operator=lambda s: pytest.fail("nothing to do"))


def test_incomplete_calibration_marks_what_is_missing(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        calibrate(plan_for(SCENE), Dying(3 * PERIODS + 10), tmp_path)
    g = collected(plan_for(SCENE), tmp_path)
    assert g.missing == (("2", "A2"), ("3", "A1"), ("3", "A2"))
    assert not g.transfer.valid[:, 2].any()
    assert np.isnan(g.transfer.values[:, 2]).all()


def scenario(**extra):
    return parse_scenario(
        {
            "sweep": {"sample_rate": RATE, "duration": 0.5},
            "measurement": {"repeats": 2, "daq": {"block": 250}, **extra.pop("measurement", {})},
            **extra,
        }
    )


def test_run_calibration_writes_transfer_and_live_figure(tmp_path):
    seen = []
    setup = VirtualSetup(SCENE, latency=3)
    with pytest.warns(AccuracyWarning, match="3 points and 2 actuators, the scenario 9 points and 4 actuators"):
        result = run_calibration(scenario(), tmp_path, virtual=setup, progress=lambda *step: seen.append(step))
    assert [step[1:] for step in seen] == [(k, 6) for k in range(1, 7)]
    back = read_transfer(result.transfer_file)
    assert np.nanmax(np.abs(back.values - SCENE.values)) < 0.02 * np.abs(SCENE.values).max()
    assert result.figure_file.read_bytes().startswith(b"\x89PNG")
    shows_itself(result)
    assert np.array_equal(result.sel("2", "A1"), back.sel("2", "A1"), equal_nan=True)
    assert back.provenance["source"] == "measured"
    assert back.errors[0].source == "measurement"


def test_run_calibration_asks_for_what_is_not_declared(tmp_path):
    with pytest.raises(ScenarioError, match=r"measurement\.sensor"):
        run_calibration(scenario(), tmp_path, daq="ni")
    with pytest.raises(ScenarioError, match="needs a G to play through"):
        run_calibration(scenario(measurement={"sensor": {"quantity": "velocity", "sensitivity": 100.0}}), tmp_path)
    with pytest.raises(ScenarioError, match="virtual, ni or sound"):
        run_calibration(
            scenario(measurement={"sensor": {"quantity": "velocity", "sensitivity": 100.0}}),
            tmp_path,
            daq="ni9",
        )


def test_run_play_sends_wav_drives_and_reports(tmp_path):
    signals = 0.5 * np.sin(np.arange(1000) / 5) * np.array([[1.0], [-1.0]])
    wavfile.write(tmp_path / "d.wav", int(RATE), signals.T)
    done = run_play(scenario(), tmp_path / "d.wav", virtual=VirtualSetup(SCENE), repeats=2, pause=0.1)
    assert done.seconds == pytest.approx(0.5 + 0.1 + 0.5)  # no silence after the last
    assert not done.stopped
    np.testing.assert_allclose(done.peak, 0.5, atol=1e-3)
    with pytest.raises(HardwareError, match=r"the limit is 2\.5 V"):
        run_play(scenario(), tmp_path / "d.wav", virtual=VirtualSetup(SCENE), scale=6.0)
    wavfile.write(tmp_path / "e.wav", 8000, signals.T)
    with pytest.raises(HardwareError, match="sampled at 8000 Hz"):
        run_play(scenario(), tmp_path / "e.wav", virtual=VirtualSetup(SCENE))
    with pytest.raises(DataError, match="so --method and --target have no effect"):
        run_play(scenario(), tmp_path / "d.wav", virtual=VirtualSetup(SCENE), method="funneling")


def test_play_fades_both_ends_and_stays_within_the_limit():
    played = []

    class Listening(VirtualDaq):
        def exchange(self, block):
            played.append(block)
            return super().exchange(block)

    daq = Listening(SCENE, RATE, 0.5, VirtualOptions())
    play(daq, np.full((2, 1000), 2.5), RATE, options(2).daq)
    heard = np.concatenate(played, axis=1)[0]
    assert heard.max() <= 2.5
    assert heard[0] < 0.1
    assert heard[-1] < 0.1
    assert np.abs(np.diff(heard)).max() < 0.5  # 10 samples of half a cosine


def test_amplifier_gain_scales_what_leaves_the_terminals(tmp_path):
    scene = part(wave_matrix(), 1, 1)
    plan = plan_for(scene, amplifier_gain=2.0)
    g = calibrate(plan, device_for(scene, bits=0), tmp_path).transfer
    np.testing.assert_allclose(g.values, scene.values / 2, rtol=1e-9)  # the virtual device has no amplifier


def test_a_folder_serves_one_calibration(tmp_path):
    calibrate(plan_for(SCENE), device_for(SCENE), tmp_path)
    with pytest.raises(DataError, match="another sweep"):
        calibrate(plan_for(SCENE, amplifier_gain=3.0), device_for(SCENE), tmp_path)
    assert len(OUTPUTS) == 9
    assert len(INPUTS) == 4


@pytest.mark.filterwarnings("ignore::forearm_fem.errors.AccuracyWarning")  # three points of the scenario's nine
@pytest.mark.parametrize(
    "other",
    [
        {"snr_db": 30.0},
        {"bits": 12},
        {"latency": 7},
        {"seed": 1},
        {"transfer": replace(SCENE, values=SCENE.values.conj())},
        {"transfer": replace(SCENE, values=1.001 * SCENE.values)},
    ],
    ids=lambda other: next(iter(other)),
)
def test_a_folder_serves_one_virtual_device(tmp_path, other):
    """Recordings through two G, or read with another latency than they were taken with, are no measurement."""
    setup = VirtualSetup(SCENE)
    plan = calibration_plan(scenario(), setup)
    with pytest.raises(KeyboardInterrupt):
        calibrate(plan, Dying(2 * PERIODS + 10), tmp_path)
    with pytest.raises(DataError, match="another virtual device"):
        run_calibration(scenario(), tmp_path, virtual=replace(setup, **other), figure=False)
    again = VirtualSetup(replace(SCENE, values=(1 + 1e-9) * SCENE.values))  # another machine's rounding
    assert run_calibration(scenario(), tmp_path, virtual=again, figure=False).measured.missing == ()
