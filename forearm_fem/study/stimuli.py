"""Stimuli of one participant: drives on that participant's G, levelled as the study says, played within limits."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import AccuracyWarning, HardwareError, ScenarioError
from ..io.declaration import Declaration, Ports, arbitrary_gain
from ..io.recognise import read_measured
from ..measurement.daq import Daq
from ..measurement.play import play
from ..rendering.bridging import bridged
from ..rendering.drives import displacements as reached
from ..rendering.drives import drives, scale_to
from ..rendering.job import renderers
from ..rendering.spectrum import place
from ..rendering.wavelet import Wavelet
from ..scenario import Scenario
from ..scenario.measurement import DaqOptions
from ..transfer import TransferMatrix
from ..typing import FloatArray
from .plan import Stimuli, Study
from .session import Presented

_MICROMETRE = 1e-6


@dataclass(frozen=True, eq=False)
class Stimulus:
    """``signals`` (n_actuator, n) [V] for one wavelet and ``moved`` (n_point, n) [m], the skin's answer by G."""

    signals: FloatArray
    moved: FloatArray


def transfer_of(
    study: Study, base: Path, participant: str, ports: Ports, declaration: Declaration | None = None
) -> TransferMatrix:
    """G of a participant as the study file says; ScenarioError naming the file and what makes it.

    ``ports`` (outputs, inputs) are those of the scenario, for files that name no places; ``declaration`` is what the
    file does not say of itself.
    """
    file = base / study.transfer.replace("{participant}", participant)
    if not file.exists():
        raise ScenarioError(
            f"{file}: no G for participant {participant}; `forearm-fem calibrate SCENARIO --out {file.parent}` "
            "measures it, or name a simulated one in the study's `transfer`"
        )
    return read_measured(file, declaration, ports=ports)


def stimuli_for(
    transfer: TransferMatrix,
    scenario: Scenario,
    options: Stimuli,
    wavelet: Wavelet,
) -> dict[tuple[str, str], Stimulus]:
    """A stimulus for each method and target of ``options``.

    Signals keep ``options.lead`` seconds before the wavelet's centre and ``options.tail`` after. Holes of G are bridged
    as in a run, and warned of (AccuracyWarning) where they are not safe to. Raises ScenarioError for a G that is not in
    m/V or of arbitrary gain without a peak of the drives, and as the renderers do.
    """
    if transfer.unit != "m/V":
        raise ScenarioError(f"stimuli need a G in m/V, got {transfer.unit}; set device.drive = 'voltage'")
    if arbitrary_gain(transfer.provenance) and options.level.rule != "drive peak":
        raise ScenarioError(
            "the gain of this G is arbitrary, as was declared, so that no drive follows from micrometres; set "
            "stimuli.level.rule = 'drive peak'"
        )
    wanted = scenario.rendering.changed({"methods": options.methods})
    chosen = {r.name: r for r in renderers(scenario.changed({"rendering": wanted}), wavelet)}
    holes = bridged(transfer)
    if holes.left or holes.absent:
        warnings.warn(holes.sentence, AccuracyWarning, stacklevel=2)
    placed = place(holes.transfer, wavelet.record)
    time = wavelet.record.time
    kept = (time >= -options.lead) & (time <= options.tail)
    result: dict[tuple[str, str], Stimulus] = {}
    for method in options.methods:
        for target in options.targets:
            sent, peak = drives(chosen[method], placed, target, wavelet), options.level.value
            if options.level.rule == "drive peak" and peak is not None:
                sent = scale_to(sent, drive_peak=peak)
            elif options.level.rule == "target peak" and peak is not None:
                sent = scale_to(sent, placed, target_peak=peak * _MICROMETRE)
            result[method, target] = Stimulus(sent.signals[:, kept], reached(placed, sent).values[:, kept])
    return result


class DevicePlayer:
    """Plays stimuli through a device within its limits; the session calls it."""

    def __init__(
        self, daq: Daq, stimuli: Mapping[tuple[str, str], Stimulus], rate: float, options: DaqOptions, how: Stimuli,
        *, loudest: float = 0.0,
    ) -> None:  # fmt: skip
        self._daq, self._stimuli, self._rate, self._options, self._how = daq, stimuli, rate, options, how
        # at the highest level that a task may ask for, before a session and not in the middle of it
        peaks = {key: 10 ** (loudest / 20) * float(np.abs(s.signals).max()) for key, s in stimuli.items()}
        method, target = max(peaks, key=peaks.__getitem__)
        if peaks[method, target] > options.max_voltage:
            raise HardwareError(
                f"{method} towards {target} needs {peaks[method, target]:.3g} V, the limit is "
                f"{options.max_voltage:g} V; lower stimuli.level, adaptive.high or rendering.amplitude"
            )

    def __call__(self, method: str, target: str, level: float) -> Presented:
        """Play ``how.repeats`` wavelets at ``level`` [dB]; HardwareError where the device fails."""
        signals = 10 ** (level / 20) * self._stimuli[method, target].signals
        done = play(self._daq, signals, self._rate, self._options, repeats=self._how.repeats, pause=self._how.pause)
        if done.stopped:
            raise HardwareError("the stimulus was cut short; press start to present it again")
        return Presented(done.seconds, float(done.peak.max()))
