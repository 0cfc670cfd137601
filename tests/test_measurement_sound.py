"""A sound card through a stand-in of known latency and gain: loopback, calibration and play, against truth."""

from __future__ import annotations

import json
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from cli_runner import SMALL, cli
from scipy.fft import irfft, rfft, rfftfreq
from scipy.signal import chirp

from forearm_fem.errors import DataError, HardwareError
from forearm_fem.measurement.daq import OpenDevice, Wiring
from forearm_fem.measurement.playback import delay_of, loopback, read_loopback
from forearm_fem.measurement.sound import SoundCard
from forearm_fem.measurement.virtual import VirtualDaq, VirtualOptions, VirtualSensor
from forearm_fem.results.files import read_drives, read_transfer
from forearm_fem.transfer import band_error

RATE = 48_000.0


class StandIn:
    """``sounddevice`` as far as it is used: what ``through`` makes of the outputs comes back on the inputs, later and
    scaled, in single precision. Without ``through`` a cable leads from output 1 to input 1."""

    def __init__(self, latency=137, gain=0.5, channels=4, lose_at=None, name="stand-in"):
        self.latency, self.gain, self.channels, self.lose_at, self.card = latency, gain, channels, lose_at, name
        self.through, self.open, self.heard = None, 0, []

    def query_devices(self, device):
        return {"name": self.card}

    def check_output_settings(self, device, channels, dtype, samplerate):
        if channels > self.channels:
            raise ValueError("Invalid number of channels")

    def Stream(self, *, samplerate, blocksize, device, channels, dtype, latency):
        owner = self
        state = SimpleNamespace(queue=np.zeros((owner.latency, channels[0]), np.float32), written=0)

        def write(frames):
            assert frames.dtype == np.float32
            owner.heard.append(frames.astype(float))
            back = np.zeros((len(frames), channels[0]), np.float32)
            back[:, 0] = owner.gain * (frames[:, 0] if owner.through is None else owner.through(frames))
            state.queue = np.concatenate([state.queue, back])
            state.written += len(frames)
            return owner.lose_at is not None and state.written > owner.lose_at

        def read(count):
            got, state.queue = state.queue[:count], state.queue[count:]
            return got, False

        def opened():
            owner.open += 1

        def closed():
            owner.open -= 1

        return SimpleNamespace(start=opened, write=write, read=read, abort=lambda: None, close=closed)


def card(**faults):
    stand_in = StandIn(**faults)
    return SoundCard(256, module=stand_in, volts_out=2.0, volts_in=4.0), stand_in


def wiring(outputs=("1", "2"), inputs=("1",)):
    return Wiring(RATE, outputs, inputs, output_range=2.0, block=256)


def test_loopback_tells_latency_and_gain():
    """137 samples, and 0.5 * 4 V / 2 V = 1 V/V. Single precision of the card leaves 1e-7."""
    device, stand_in = card()
    found = loopback(device, wiring())
    assert found.latency == pytest.approx(137, abs=1e-3)
    assert found.gain == pytest.approx(1.0, rel=1e-4)
    assert found.residual < 1e-3
    assert stand_in.open == 0


def test_no_cable_is_said():
    device, _ = card(gain=0.0)
    with pytest.raises(HardwareError, match="connect the first output to the first input"):
        loopback(device, wiring())


def test_lost_samples_stop_the_session():
    device, stand_in = card(lose_at=5000)
    with (
        pytest.raises(HardwareError, match=r"samples were lost.*larger daq.block"),
        OpenDevice(device, wiring()) as session,
    ):
        session.play(np.zeros((2, 48_000)), limit=1.0, fade=64)
    assert stand_in.open == 0


def test_too_many_channels_and_names_that_are_no_numbers():
    device, _ = card(channels=1)
    with pytest.raises(HardwareError, match=r"it cannot play 2 and record 1 channel"), OpenDevice(device, wiring()):
        pass
    device, _ = card()
    with pytest.raises(HardwareError, match="channels are numbers from '1'"), OpenDevice(device, wiring(("ao0",))):
        pass


def test_drives_beyond_full_scale_are_refused():
    device, _ = card()
    with OpenDevice(device, wiring()) as session, pytest.raises(HardwareError, match="full scale of 2 V"):
        session._daq.exchange(3.0 * np.ones((2, 256)))


@pytest.mark.parametrize(("delay", "gain"), [(137.37, 0.8), (12.0, -1.3)])
def test_delays_of_parts_of_a_sample_and_inverted_inputs(delay, gain):
    """A chirp shifted by its spectrum: exact for a pure delay but for what its fades leave outside of the record."""
    n = 8192
    sent = np.zeros(n)
    sent[1000:5000] = chirp(np.arange(4000) / RATE, 50, 4000 / RATE, 9000) * np.hanning(4000)
    got = gain * irfft(rfft(sent) * np.exp(-2j * np.pi * rfftfreq(n) * delay), n)
    found = delay_of(sent, got)
    assert found[0] == pytest.approx(delay, abs=1e-6)
    assert found[1] == pytest.approx(gain, rel=1e-6)
    assert found[2] < 1e-6


_TWO_POINTS = SMALL + """
[grid]
points = [[0.0, 0.0], [0.01, 0.0]]
[measurement]
lead_in = 2  # at 4 periods a second the first one still rings 68 ms late into the second
[measurement.sensor]
quantity = "velocity"
sensitivity = 200.0
"""


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """A folder with a scenario of two points, its G and drives."""
    folder = tmp_path_factory.mktemp("sound")
    scene = _TWO_POINTS.replace('["5", "6"]', '["1"]\nmethods = ["funneling"]')
    (folder / "small.toml").write_text(scene)
    assert cli("render", "small.toml", cwd=folder).code == 0
    return folder


def arm(truth, rate, duration, *, volts_out, volts_in):
    """What the skin and a vibrometer answer to a card's samples, both full scales being those at its terminals."""
    device = VirtualDaq(truth, rate, duration, VirtualOptions(bits=0, sensor=VirtualSensor("velocity", 200.0)))
    device.aim(truth.outputs[0].name)
    device.open(Wiring(rate, tuple("abcd"), ("s",), 10.0, 10.0, 1000))
    return device, lambda frames: device.exchange(volts_out * frames.T.astype(float))[0] / volts_in


def test_a_calibration_through_a_sound_card_finds_g(lab, monkeypatch):
    """Latency 137 samples (68 ms) and an output 7 % weaker than stated: measured by the cable and taken off, G is found
    to the card's single precision over the quarter-second record; 137 samples more would turn it by many periods."""
    card = StandIn(latency=137, gain=1.0)
    monkeypatch.setitem(sys.modules, "sounddevice", card)
    answer = cli("calibrate", "small.toml", "--daq", "sound", "--yes", "--out", "unknown", cwd=lab)
    assert answer.code == 2
    assert "a sound card's latency is unknown" in answer.sentence
    card.gain = 0.93
    done = cli("daq", "loopback", "small.toml", cwd=lab)
    assert done.code == 0, done.err
    assert "latency 137.00 samples" in done.out
    truth = read_transfer(lab / "results/small/transfer.nc")
    device, card.through = arm(truth, 2000.0, 0.25, volts_out=10.0, volts_in=10.0)
    points = iter(truth.outputs)
    monkeypatch.setattr("builtins.input", lambda: device.aim(next(points).name) or "")  # the operator aims the laser
    done = cli("calibrate", "small.toml", "--daq", "sound", "--loopback", "loopback.json", "--out", "g", cwd=lab)
    assert done.code == 0, done.err
    assert "latency of the device: measured by a cable" in done.out
    found = read_transfer(lab / "g/transfer.nc")
    inside = np.isin(truth.frequency, found.frequency)
    assert band_error(found.values, truth.values[inside]) < 1e-5
    card.card = "another card"
    asked = ("calibrate", "small.toml", "--daq", "sound", "--loopback", "loopback.json", "--yes", "--out", "h")
    other = cli(*asked, cwd=lab)
    assert other.code == 2
    assert "run `forearm-fem daq loopback` again" in other.sentence


def test_play_sends_the_drives_to_the_cards_channels(lab, monkeypatch):
    """Volts over the full scale that the scenario states, on channels 1 to 4, faded, twice with silence between."""
    card = StandIn()
    monkeypatch.setitem(sys.modules, "sounddevice", card)
    options = ("--method", "funneling", "--target", "1", "--repeats", "2", "--pause", "0.1")
    done = cli("daq", "play", "small.toml", "results/small/drives.nc", "--daq", "sound", *options, cwd=lab)
    assert done.code == 0, done.err
    drives = read_drives(lab / "results/small/drives.nc").values[0, 0]
    sent = 10.0 * np.concatenate(card.heard)[2000:]  # two silent blocks of 1000 samples first
    assert sent.shape[1] == 4
    n = drives.shape[1]
    assert sent[10 : n - 10] == pytest.approx(drives.T[10:-10], abs=1e-6 * np.abs(drives).max() + 1e-9)
    assert np.all(sent[n : n + 200] == 0)
    assert sent[n + 210 : 2 * n + 190] == pytest.approx(drives.T[10:-10], abs=1e-6 * np.abs(drives).max() + 1e-9)


@pytest.mark.parametrize(
    ("content", "words"), [({"latency": 3}, "no record of a loopback"), ({"gain": 0.0}, "must be finite and not zero")]
)
def test_records_that_are_none_are_refused(tmp_path, content, words):
    whole = {"latency": 1.0, "gain": 1.0, "residual": 0.0, "device": "x", "sample_rate": 1.0, "taken": "now"}
    file = tmp_path / "loopback.json"
    file.write_text(json.dumps(content if "gain" not in content else whole | content))
    with pytest.raises(DataError, match=words):
        read_loopback(file)
