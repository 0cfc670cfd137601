"""The NI back end against nidaqmx's own task interface: a stand-in module with the same calls and a clock
of its own.
"""

from __future__ import annotations

import inspect
import sys
from types import SimpleNamespace

import nidaqmx
import nidaqmx.constants
import numpy as np
import pytest
from nidaqmx.task import InStream, OutStream, Task, Timing
from test_measurement_scene import RATE, SENSOR, SWEEP, device_for, part, plan_for, wave_matrix

from forearm_fem.errors import HardwareError, MissingExtra
from forearm_fem.measurement.calibrate import calibrate
from forearm_fem.measurement.daq import Wiring
from forearm_fem.measurement.ni import NiDaq
from forearm_fem.measurement.play import play
from forearm_fem.measurement.virtual import noise_for
from forearm_fem.transfer import band_error


class DaqError(Exception):
    """As nidaqmx.errors.DaqError: a message and a code."""

    def __init__(self, message: str, error_code: int) -> None:
        super().__init__(message)
        self.error_code = error_code


class Chassis:
    """One clock: what output tasks have been given plays on, inputs answer through a virtual device."""

    def __init__(self, virtual, rate: float | None = None) -> None:
        self.virtual, self.rate = virtual, rate
        self.log: list[str] = []
        self.queue = np.zeros((0, 0))
        self.at_rest: list[float] = []
        self.fail: tuple[str, int] | None = None
        self.constants = nidaqmx.constants
        device = SimpleNamespace(product_type="cDAQ-9174", name="cDAQ1")
        self.system = SimpleNamespace(System=SimpleNamespace(local=lambda: SimpleNamespace(devices=[device])))

    def Task(self):
        return FakeTask(self)


class FakeTask:
    def __init__(self, chassis: Chassis) -> None:
        self.chassis, self.outputs, self.inputs, self.started, self.written = chassis, [], [], False, False
        self.ao_channels = SimpleNamespace(add_ao_voltage_chan=self._output)
        self.ai_channels = SimpleNamespace(add_ai_voltage_chan=self._input)
        self.timing = SimpleNamespace(cfg_samp_clk_timing=self._clock, samp_clk_rate=chassis.rate)
        self.out_stream = SimpleNamespace(regen_mode=None, output_buf_size=None)

    def _output(self, channel, min_val, max_val):
        inspect.signature(nidaqmx.task.collections.AOChannelCollection.add_ao_voltage_chan).bind(
            None, channel, min_val=min_val, max_val=max_val
        )
        self.outputs.append(channel)

    def _input(self, channel, min_val, max_val):
        inspect.signature(nidaqmx.task.collections.AIChannelCollection.add_ai_voltage_chan).bind(
            None, channel, min_val=min_val, max_val=max_val
        )
        self.inputs.append(channel)

    def _clock(self, rate, **how):
        inspect.signature(Timing.cfg_samp_clk_timing).bind(None, rate, **how)
        self.timing.samp_clk_rate = self.chassis.rate or rate
        self.clock = how.get("source", "")

    def write(self, data, auto_start=False, timeout=10.0):
        inspect.signature(Task.write).bind(None, data, auto_start=auto_start, timeout=timeout)
        self._perhaps("write")
        if auto_start:
            self.chassis.at_rest = list(np.atleast_1d(data))
            return
        assert self.out_stream.regen_mode is nidaqmx.constants.RegenerationMode.DONT_ALLOW_REGENERATION
        block = np.atleast_2d(data)
        old = self.chassis.queue if self.written else block[:, :0]
        self.written = True
        self.chassis.queue = np.concatenate([old, block], axis=1)

    def read(self, number_of_samples_per_channel, timeout):
        inspect.signature(Task.read).bind(
            None, number_of_samples_per_channel=number_of_samples_per_channel, timeout=timeout
        )
        self._perhaps("read")
        assert self.started
        n = number_of_samples_per_channel
        if self.chassis.queue.shape[1] < n:
            raise DaqError("output buffer underflow", -200290)
        played, self.chassis.queue = self.chassis.queue[:, :n], self.chassis.queue[:, n:]
        got = self.chassis.virtual.exchange(played)
        return got[0].tolist() if len(got) == 1 else got.tolist()

    def start(self):
        self.started = True
        self.chassis.log.append("start output" if self.outputs else "start input")
        if self.outputs:
            self.chassis.virtual.open(self.chassis.wiring)

    def stop(self):
        self.chassis.log.append("stop")

    def close(self):
        self.chassis.log.append("close")

    def _perhaps(self, call):
        if self.chassis.fail and self.chassis.fail[0] == call:
            raise DaqError("from the driver\nin two lines", self.chassis.fail[1])


def rig(scene, **changes):
    """A chassis with a virtual arm behind it, and the NI device on it."""
    virtual = device_for(scene, **changes)
    plan = plan_for(scene)
    chassis = Chassis(virtual)
    chassis.wiring = plan.wiring
    return chassis, NiDaq(plan.options.daq.block, module=chassis), plan


def test_stand_in_speaks_the_real_interface():
    for name in ("read", "write", "start", "stop", "close"):
        assert callable(getattr(Task, name))
    assert isinstance(OutStream.regen_mode, property)
    assert isinstance(OutStream.output_buf_size, property)
    assert isinstance(Timing.samp_clk_rate, property)
    assert inspect.isclass(InStream)


def test_calibration_through_the_task_interface(tmp_path):
    scene = part(wave_matrix(), 1, 2)
    chassis, daq, plan = rig(scene, noise=noise_for(60, scene, SWEEP.samples(), RATE, SENSOR))
    measured = calibrate(plan, daq, tmp_path)
    assert band_error(measured.transfer.values, scene.values) < 3e-3  # 60 dB, 4 repeats
    assert chassis.at_rest == [0.0, 0.0]
    first = chassis.log.index("start input")
    assert chassis.log[first + 1] == "start output"  # the inputs wait for the outputs' clock
    assert "cDAQ-9174" in measured.transfer.provenance["device"]


@pytest.mark.parametrize(
    ("call", "code", "said"),
    [
        ("read", -200279, "use a larger daq.block"),
        ("read", -200290, "too slow"),
        ("write", -200220, "NI MAX"),
        ("write", -1, "from the driver in two lines"),
    ],
)
def test_driver_errors_become_one_sentence_and_outputs_rest_at_zero(tmp_path, call, code, said):
    scene = part(wave_matrix(), 1, 2)
    chassis, daq, plan = rig(scene)
    chassis.fail = (call, code)
    with pytest.raises(HardwareError, match=said) as caught:
        calibrate(plan, daq, tmp_path)
    assert "\n" not in str(caught.value)
    assert chassis.log[-1] == "close"


def test_another_rate_than_asked_for_is_refused(tmp_path):
    scene = part(wave_matrix(), 1, 2)
    chassis, daq, plan = rig(scene)
    chassis.rate = 2010.05
    with pytest.raises(HardwareError, match=r"sweep\.sample_rate = 2010\.05"):
        calibrate(plan, daq, tmp_path)


def test_emergency_stop_fades_and_silences():
    scene = part(wave_matrix(), 1, 2)
    chassis, daq, plan = rig(scene)
    calls = iter([False, False, False, True])
    loud = np.ones((2, 5000))
    done = play(daq, loud, RATE, plan.options.daq, stop=lambda: next(calls))
    assert done.stopped
    assert done.seconds < 1000 / RATE
    assert chassis.at_rest == [0.0, 0.0]
    assert np.all(np.abs(np.diff(chassis.queue[0])) < 0.35)  # a ramp over 10 samples, no step


def test_without_the_driver_it_says_so(tmp_path):
    daq = NiDaq(250)
    assert daq.name == "NI (no device answered)"
    with pytest.raises(HardwareError, match="NI-DAQmx"):
        daq.open(Wiring(RATE, ("ao0",), ("ai0",)))
    with pytest.raises(HardwareError, match="open it before"):
        daq.exchange(np.zeros((1, 10)))


def test_without_the_package_it_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "nidaqmx", None)
    with pytest.raises(MissingExtra, match=r"forearm-fem\[daq\]"):
        NiDaq(250)
