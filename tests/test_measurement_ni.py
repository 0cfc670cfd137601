"""The NI back end against nidaqmx's own task interface: a stand-in module with the same calls and a clock
of its own.
"""

from __future__ import annotations

import inspect
import sys
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import nidaqmx
import nidaqmx.constants
import numpy as np
import pytest
from nidaqmx.task import InStream, OutStream, Task, Timing
from nidaqmx.task.triggering import StartTrigger
from test_measurement_scene import RATE, SENSOR, SWEEP, device_for, part, plan_for, wave_matrix

from forearm_fem.errors import HardwareError, MissingExtra
from forearm_fem.measurement.calibrate import calibrate
from forearm_fem.measurement.daq import Wiring
from forearm_fem.measurement.ni import NiDaq
from forearm_fem.measurement.playback import play
from forearm_fem.measurement.virtual import noise_for
from forearm_fem.transfer import band_error


class DaqError(Exception):
    """As nidaqmx.errors.DaqError: a message and a code."""

    def __init__(self, message: str, error_code: int) -> None:
        super().__init__(message)
        self.error_code = error_code


NO_ROUTE, NOT_ALLOWED = -89136, -200077
AI_CLOCK, AI_START, AO_CLOCK = "/cDAQ1/ai/SampleClock", "/cDAQ1/ai/StartTrigger", "/cDAQ1/ao/SampleClock"


class Chassis:
    """What output tasks have been given plays on the clock, inputs answer through a virtual device.

    ``makes`` maps the rate asked for to the one that the input module makes; a ``sigma_delta`` module takes no other
    clock than its own (as cDAQ manuals have it); ``routes`` are the terminals that the outputs may be clocked from.
    """

    def __init__(self, virtual) -> None:
        self.virtual, self.sigma_delta = virtual, False
        self.makes = self.divides = lambda rate: rate
        self.routes = (AI_CLOCK, AI_START)
        self.log: list[str] = []
        self.queue = np.zeros((0, 0))
        self.at_rest: list[float] = []
        self.wiring: Any = None
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
        self.timing = FakeTiming(self)
        self.triggers = SimpleNamespace(start_trigger=FakeStartTrigger(self))
        self.out_stream = SimpleNamespace(regen_mode=None, output_buf_size=None)
        self.reserved, self.trigger = False, None

    def control(self, action):
        inspect.signature(Task.control).bind(None, action)
        assert action is nidaqmx.constants.TaskMode.TASK_RESERVE
        self._reserve()

    def _reserve(self):
        """What the driver checks when it programs the hardware."""
        source = self.timing.source
        if self.inputs and source and self.chassis.sigma_delta:
            raise DaqError("the module generates its own sample clock", NOT_ALLOWED)
        if self.outputs and any(t and t not in self.chassis.routes for t in (source, self.trigger)):
            raise DaqError("route not supported", NO_ROUTE)
        self.reserved = True

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
        self._reserve()
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


class FakeTiming:
    """Terminals and the rate really made are known once the task is reserved, not before."""

    def __init__(self, task) -> None:
        self.task, self.source, self.asked = task, "", None

    def cfg_samp_clk_timing(self, rate, **how):
        inspect.signature(Timing.cfg_samp_clk_timing).bind(None, rate, **how)
        self.asked, self.source = rate, how.get("source", "")
        assert how["sample_mode"] is nidaqmx.constants.AcquisitionType.CONTINUOUS

    @property
    def samp_clk_rate(self):
        if self.task.inputs and not self.source:
            return self.task.chassis.makes(self.asked)
        return self.asked if self.source else self.task.chassis.divides(self.asked)

    @property
    def samp_clk_term(self):
        if not self.task.reserved:
            raise DaqError("not reserved", -200983)
        return AI_CLOCK if self.task.inputs else AO_CLOCK


class FakeStartTrigger:
    def __init__(self, task) -> None:
        self.task = task

    def cfg_dig_edge_start_trig(self, trigger_source, **how):
        inspect.signature(StartTrigger.cfg_dig_edge_start_trig).bind(None, trigger_source, **how)
        self.task.trigger = trigger_source

    @property
    def term(self):
        if not self.task.reserved:
            raise DaqError("not reserved", -200983)
        return AI_START


def rig(scene, clock="inputs", **changes):
    """A chassis with a virtual arm behind it, and the NI device on it."""
    virtual = device_for(scene, **changes)
    plan = plan_for(scene)
    daq = plan.options.daq.model_copy(update={"clock": clock})
    plan = replace(plan, options=plan.options.model_copy(update={"daq": daq}))
    chassis = Chassis(virtual)
    chassis.wiring = plan.wiring
    return chassis, NiDaq(plan.options.daq.block, module=chassis), plan


def test_stand_in_speaks_the_real_interface():
    for name in ("read", "write", "start", "stop", "close"):
        assert callable(getattr(Task, name))
    assert isinstance(OutStream.regen_mode, property)
    assert isinstance(OutStream.output_buf_size, property)
    assert isinstance(Timing.samp_clk_rate, property)
    assert isinstance(Timing.samp_clk_term, property)
    assert isinstance(StartTrigger.term, property)
    assert inspect.isclass(InStream)


def test_calibration_through_the_task_interface(tmp_path):
    scene = part(wave_matrix(), 1, 2)
    chassis, daq, plan = rig(scene, noise=noise_for(60, scene, SWEEP.samples(), RATE, SENSOR))
    measured = calibrate(plan, daq, tmp_path)
    assert band_error(measured.transfer.values, scene.values) < 3e-3  # 60 dB, 4 repeats
    assert chassis.at_rest == [0.0, 0.0]
    first = chassis.log.index("start output")
    assert chassis.log[first + 1] == "start input"  # the outputs wait for the inputs' clock
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


@pytest.mark.parametrize("clock", ["inputs", "trigger", AO_CLOCK])
def test_each_way_of_keeping_time_measures_the_same(tmp_path, clock):
    scene = part(wave_matrix(), 1, 2)
    chassis, daq, plan = rig(scene, clock)
    measured = calibrate(plan, daq, tmp_path)
    assert band_error(measured.transfer.values, scene.values) < 1e-3  # 16 bits; the arm has no noise
    led, first = ("input", "output") if clock == AO_CLOCK else ("output", "input")
    assert chassis.log[:2] == [f"start {led}", f"start {first}"]  # who waits is started first


def opened(scene, clock, **chassis_has):
    """The two tasks of an open device."""
    chassis, daq, plan = rig(scene, clock)
    vars(chassis).update(chassis_has)
    daq.open(plan.wiring)
    return daq._output, daq._input


def test_sigma_delta_inputs_lead_and_the_outputs_take_their_clock():
    output, source = opened(part(wave_matrix(), 1, 2), "inputs", sigma_delta=True)
    assert (output.timing.source, output.trigger) == (AI_CLOCK, None)
    assert source.timing.source == ""


def test_by_trigger_the_outputs_run_on_their_own_clock_from_the_inputs_start():
    output, source = opened(part(wave_matrix(), 1, 2), "trigger", sigma_delta=True)
    assert (output.timing.source, output.trigger) == ("", AI_START)
    assert source.timing.source == ""


@pytest.mark.parametrize(
    ("clock", "has", "said"),
    [
        (AO_CLOCK, {"sigma_delta": True}, r"measurement\.daq\.clock = 'trigger' or 'inputs'"),
        (
            "inputs",
            {"routes": (AI_START,)},
            r"no such route between the tasks, try .*clock = 'trigger'",
        ),
        (
            "trigger",
            {"divides": lambda rate: rate * (1 + 6e-5)},
            r"drift apart; set .*clock = 'inputs'",
        ),
        ("inputs", {"makes": lambda rate: 51200 / 25}, r"sweep\.sample_rate = 2048 "),
        ("trigger", {"makes": lambda rate: 51200 / 25}, r"sweep\.sample_rate = 2048 "),
        (AO_CLOCK, {"divides": lambda rate: 2010.05}, r"sweep\.sample_rate = 2010\.05"),
    ],
)
def test_clocks_that_cannot_be_are_refused_with_the_way_out_and_the_channels_freed(tmp_path, clock, has, said):
    scene = part(wave_matrix(), 1, 2)
    chassis, daq, plan = rig(scene, clock)
    vars(chassis).update(has)
    with pytest.raises(HardwareError, match=said) as caught:
        calibrate(plan, daq, tmp_path)
    assert len(str(caught.value)) <= 300
    assert chassis.log.count("close") >= 2


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
