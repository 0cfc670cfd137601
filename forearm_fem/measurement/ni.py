"""National Instruments hardware through nidaqmx: analogue output and input on one clock.

The clock follows the input module, for sigma-delta inputs (NI 9234, ...) make their own and take no other: the outputs
are updated by the input task's sample clock ("inputs"), or run on their own divider of the chassis' timebase from the
input task's start trigger on ("trigger", for inputs that the chassis clocks too). Any other ``clock`` is a terminal
from which the inputs take their ticks. The input task is reserved before its terminals are asked for: only then does
the driver know them, and the rate that the module really makes.

The output is streamed without regeneration behind two silent blocks; if the computer cannot keep up the driver stops
with an error instead of repeating old samples. Tested against nidaqmx's task interface; not yet on a chassis
(docs/howto/daq.md).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np

from ..errors import HardwareError, optional
from ..typing import FloatArray
from .daq import Wiring

T = TypeVar("T")
_QUEUED = 2  # silent blocks ahead of the signal
_SAME = 1e-6  # relative: rates closer than this are the same
FROM_INPUTS, FROM_TRIGGER = "inputs", "trigger"
_OTHER_CLOCK = "try measurement.daq.clock = 'trigger' or 'inputs'"
_NO_ROUTE = (-89120, -89136, -89137, -89138, -89139, -89140, -200368, -200369, -200370)
_ADVICE: Mapping[int, str] = MappingProxyType({  # on the errors that are met in practice
    -200279: "samples were lost because they were not read in time, use a larger daq.block; ",
    -200290: "the outputs ran dry because the computer was too slow, use a larger daq.block; ",
    -200220: "no such device, check daq.outputs and daq.sensor against NI MAX; ",
    -200170: "no such channel, check daq.outputs and daq.sensor against NI MAX; ",
    **dict.fromkeys(_NO_ROUTE, f"the chassis has no such route between the tasks, {_OTHER_CLOCK}; "),
    -200077: f"the module takes no such value; if that is the clock, {_OTHER_CLOCK}; ",
    -50103: "another program holds the channels, close it; ",
})  # fmt: skip


class NiDaq:
    """Implements :class:`~forearm_fem.measurement.daq.Daq` with nidaqmx; ``module`` stands in for it in tests."""

    def __init__(self, block: int, module: Any = None, bits: int = 16, input_range: float = 10.0) -> None:
        self._module = module or optional("nidaqmx", "daq", "measuring with NI hardware")
        self._block, self._bits, self._range = block, bits, input_range
        self._output: Any = None
        self._input: Any = None
        self._wiring: Wiring | None = None

    @property
    def name(self) -> str:
        """Products of the local system that answer, for the record."""
        with suppress(Exception):  # a missing driver is reported by open(), in words
            devices = self._module.system.System.local().devices
            return "NI " + ", ".join(f"{d.product_type} {d.name}" for d in devices)
        return "NI (no device answered)"

    @property
    def resolution(self) -> float:
        """Step of a ``bits`` converter over the input range [V]."""
        return 2 * self._range / float(2**self._bits)

    @property
    def ahead(self) -> int:
        """Two blocks of silence are queued before the signal."""
        return _QUEUED * self._block

    def aim(self, output: str) -> None:
        """The operator aims the laser; nothing to do here."""

    def open(self, wiring: Wiring) -> None:
        """Create both tasks on one clock and start them on the queued silence.

        HardwareError, with the channels free again, for what the driver refuses and for another rate than asked for.
        """
        self._wiring = wiring
        try:
            _named("opening the channels", lambda: self._configure(wiring))
        except HardwareError:
            self.close()
            raise

    def exchange(self, block: FloatArray) -> FloatArray:
        """Queue ``block`` (n_output, m) [V]; the inputs (n_input, m) [V] of the m ticks that have passed meanwhile."""
        if self._output is None or self._wiring is None:
            raise HardwareError("the NI device is not open; open it before playing")
        m, wait = block.shape[1], 10.0 + 4 * block.shape[1] / self._wiring.sample_rate
        _named("writing the outputs", lambda: self._output.write(_rows(block), auto_start=False, timeout=wait))
        got = _named("reading the inputs", lambda: self._input.read(number_of_samples_per_channel=m, timeout=wait))
        return np.asarray(got, dtype=float).reshape(len(self._wiring.inputs), -1)

    def close(self) -> None:
        """Stop at once, put 0 V on every output, free the channels. Never raises."""
        for task in (self._output, self._input):
            if task is not None:
                with suppress(Exception):
                    task.stop()
                with suppress(Exception):
                    task.close()
        self._output = self._input = None
        if self._wiring is not None:
            with suppress(Exception):
                self._silence(self._wiring)
        self._wiring = None

    def _configure(self, wiring: Wiring) -> None:
        constants = self._module.constants
        buffer = (_QUEUED + 2) * wiring.block
        self._output, self._input = self._module.Task(), self._module.Task()
        for channel in wiring.outputs:
            self._output.ao_channels.add_ao_voltage_chan(
                channel, min_val=-wiring.output_range, max_val=wiring.output_range
            )
        for channel in wiring.inputs:
            self._input.ai_channels.add_ai_voltage_chan(
                channel, min_val=-wiring.input_range, max_val=wiring.input_range
            )
        self._synchronise(wiring, buffer)
        self._output.out_stream.regen_mode = constants.RegenerationMode.DONT_ALLOW_REGENERATION
        self._output.out_stream.output_buf_size = buffer
        self._output.write(_rows(np.zeros((len(wiring.outputs), self.ahead))), auto_start=False, timeout=10.0)
        if wiring.clock in (FROM_INPUTS, FROM_TRIGGER):
            self._output.start()  # waits for the inputs' clock or trigger
            self._input.start()
        else:
            self._input.start()  # waits for the clock at the terminal
            self._output.start()

    def _synchronise(self, wiring: Wiring, buffer: int) -> None:
        """One clock, or one trigger and one timebase, for both tasks; HardwareError for another rate than asked for."""
        constants, rate = self._module.constants, wiring.sample_rate
        continuous = {"sample_mode": constants.AcquisitionType.CONTINUOUS}
        led = wiring.clock in (FROM_INPUTS, FROM_TRIGGER)
        source = {} if led else {"source": wiring.clock}
        self._input.timing.cfg_samp_clk_timing(rate, samps_per_chan=10 * buffer, **continuous, **source)
        if not led:
            self._output.timing.cfg_samp_clk_timing(rate, samps_per_chan=buffer, **continuous)
            self._check_rate(self._output, rate)
            return
        self._input.control(constants.TaskMode.TASK_RESERVE)
        self._check_rate(self._input, rate)
        source = {"source": self._input.timing.samp_clk_term} if wiring.clock == FROM_INPUTS else {}
        self._output.timing.cfg_samp_clk_timing(rate, samps_per_chan=buffer, **continuous, **source)
        if wiring.clock == FROM_TRIGGER:
            self._output.triggers.start_trigger.cfg_dig_edge_start_trig(self._input.triggers.start_trigger.term)
        self._output.control(constants.TaskMode.TASK_RESERVE)  # a route that the chassis lacks is refused here
        if abs(float(self._output.timing.samp_clk_rate) / rate - 1) > _SAME:
            raise HardwareError(
                f"the outputs run at {self._output.timing.samp_clk_rate:.9g} Hz where the inputs run at {rate:.9g} Hz, "
                f"so they would drift apart; set measurement.daq.clock = '{FROM_INPUTS}'"
            )

    def _check_rate(self, task: Any, wanted: float) -> None:
        actual = float(task.timing.samp_clk_rate)
        if abs(actual / wanted - 1) > _SAME:
            raise HardwareError(
                f"the device runs at {actual:.9g} Hz instead of {wanted:.6g} Hz; "
                f"set sweep.sample_rate = {actual:.9g} so that bins stay where they belong"
            )

    def _silence(self, wiring: Wiring) -> None:
        task = self._module.Task()
        try:
            for channel in wiring.outputs:
                task.ao_channels.add_ao_voltage_chan(channel, min_val=-wiring.output_range, max_val=wiring.output_range)
            task.write([0.0] * len(wiring.outputs) if len(wiring.outputs) > 1 else 0.0, auto_start=True)
        finally:
            task.close()


def _rows(block: FloatArray) -> Any:
    """Samples as nidaqmx wants them: 2-D for several channels, 1-D for one."""
    return np.ascontiguousarray(block if len(block) > 1 else block[0])


def _named(doing: str, call: Callable[[], T]) -> T:
    """``call()``, with what the driver raises turned into one sentence."""
    try:
        return call()
    except HardwareError:
        raise
    except Exception as problem:  # nidaqmx raises DaqError, and DaqNotFoundError without a driver
        text = " ".join(str(problem).split()) or type(problem).__name__
        raise HardwareError(
            f"NI device, {doing}: {_ADVICE.get(getattr(problem, 'error_code', 0), '')}{text[:300]}"
        ) from problem
