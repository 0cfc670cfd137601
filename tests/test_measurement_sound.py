"""A sound card through a stand-in of known latency and gain; and a calibration through it."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from forearm_fem.errors import HardwareError
from forearm_fem.measurement.daq import Session, Wiring
from forearm_fem.measurement.sound import SoundCard, loopback

RATE = 48_000.0


class StandIn:
    """``sounddevice`` as far as it is used: output 1 comes back on input 1, later and scaled, in single precision."""

    def __init__(self, latency=137, gain=0.5, channels=4, lose_at=None):
        self.latency, self.gain, self.channels, self.lose_at = latency, gain, channels, lose_at
        self.open = 0

    def query_devices(self, device):
        return {"name": "stand-in"}

    def check_output_settings(self, device, channels, dtype, samplerate):
        if channels > self.channels:
            raise ValueError("Invalid number of channels")

    def Stream(self, *, samplerate, blocksize, device, channels, dtype, latency):
        owner, heard = self, [np.zeros((owner_latency, channels[0]), np.float32) for owner_latency in (self.latency,)]
        state = SimpleNamespace(queue=heard[0], written=0)

        def write(frames):
            assert frames.dtype == np.float32
            back = np.zeros((len(frames), channels[0]), np.float32)
            back[:, 0] = owner.gain * frames[:, 0]
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
        Session(device, wiring()) as session,
    ):
        session.play(np.zeros((2, 48_000)), limit=1.0, fade=64)
    assert stand_in.open == 0


def test_too_many_channels_and_names_that_are_no_numbers():
    device, _ = card(channels=1)
    with pytest.raises(HardwareError, match=r"it cannot play 2 and record 1 channel"), Session(device, wiring()):
        pass
    device, _ = card()
    with pytest.raises(HardwareError, match="channels are numbers from '1'"), Session(device, wiring(("ao0",))):
        pass


def test_drives_beyond_full_scale_are_refused():
    device, _ = card()
    with Session(device, wiring()) as session, pytest.raises(HardwareError, match="full scale of 2 V"):
        session._daq.exchange(3.0 * np.ones((2, 256)))
