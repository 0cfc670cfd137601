"""Stimuli and trials of a participant as a folder that PsychoPy, jsPsych or another player of WAV files takes as it is.

Each WAV holds one presentation, a channel per actuator, in 32-bit floating point: 1 is the stated full scale of the
card's output in volts. ``trials.csv`` is the whole order with what each trial plays, how strong it is at the target,
and the hashes of what it was made from.
"""

from __future__ import annotations

import csv
import io
import json
from importlib import resources
from pathlib import Path

import numpy as np
from scipy.io import wavfile
from scipy.signal import resample

from .. import __version__
from ..errors import ScenarioError
from ..measurement.daq import faded
from ..store.folder import atomic_path, write_text
from ..typing import FloatArray
from .order import tasks_of, trials
from .run import Made, Prepared
from .stimuli import beyond
from .store import SOURCES, STIMULI

COLUMNS = (
    "participant", "task", "answer", "trial", "phase", "block", "method", "target", "repetition", "wav", "points",
    "gain", "peak_um", "rms_um", "weighted_db", "drives", *SOURCES,
)  # fmt: skip
_ROOM = 0.01  # [s] of silence before and after, where a resampled fade rings out


def export(prepared: Prepared, participant: str, made: Made, *, rate: float, full_scale: float) -> Path:
    """``stimuli/sub-ID`` in the study's folder, for a card of that ``rate`` [Hz] and ``full_scale`` [V]; its path.

    The participant is invited where not enrolled yet, which fixes the place in the study and so the order. Raises
    ScenarioError where a stimulus does not fit below full scale, or the rate is too low for the band.
    """
    store, options = prepared.store(begin=True), prepared.scenario.measurement.daq
    record, stimuli = prepared.wavelet.record, prepared.study.stimuli
    if rate < 2.5 * (top := float(made.transfer.frequency[-1])):
        raise ScenarioError(f"--rate {rate:g}: expected at least {2.5 * top:g} Hz for a band up to {top:g} Hz")
    for (method, target), stimulus in made.stimuli.items():  # as rendered; equal levels are within reach
        excess, said = beyond(stimulus, prepared.scenario)
        if excess > 1:
            raise ScenarioError(f"{method} towards {target} needs {said} lower rendering.amplitude or equalise levels")
    peaks = {k: float(np.abs(s.signals).max()) / options.amplifier_gain for k, s in made.stimuli.items()}
    loudest = max(peaks, key=peaks.__getitem__)
    if peaks[loudest] > full_scale:
        raise ScenarioError(
            f"{loudest[0]} towards {loudest[1]} needs {peaks[loudest]:.3g} V at the output, full scale is "
            f"{full_scale:g} V; lower stimuli.peak, or raise measurement.daq.amplifier_gain with the amplifier's knob"
        )
    store.enrol(participant, invited=True)
    folder, place = store.folder / STIMULI / f"sub-{participant}", store.place(participant)
    names = {}
    for (method, target), stimulus in made.stimuli.items():
        names[method, target] = f"wav/{method.replace(' ', '-')}_{target}.wav"
        volts = faded(stimulus.signals, round(options.fade * record.sample_rate)) / options.amplifier_gain
        once = at_rate(volts, record.sample_rate, rate)
        silence = np.zeros((len(once), max(0, round((stimuli.pause - 2 * _ROOM) * rate))))
        whole = np.hstack([part for _ in range(stimuli.repeats) for part in (once, silence)][:-1])
        with atomic_path(folder / names[method, target]) as file:
            wavfile.write(file, round(rate), np.ascontiguousarray((whole / full_scale).T.astype(np.float32)))
    points = " ".join(p.name for p in made.transfer.outputs)
    rows = [
        {"participant": participant, "task": task.name, "answer": task.answer, "trial": t.number, "phase": t.phase,
         "block": t.block, "method": t.method, "target": t.target, "repetition": t.repetition,
         "wav": names[t.method, t.target], "points": points, **made.facts()[t.method, t.target], **made.sources}
        for task in tasks_of(prepared.study, place) for t in trials(prepared.study, task, place)
    ]  # fmt: skip
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows({k: f"{v:.6g}" if isinstance(v, float) else v for k, v in row.items()} for row in rows)
    write_text(folder / "trials.csv", text.getvalue())
    grid = [{"name": p.name, "x": p.position[0], "y": p.position[1]} for p in made.transfer.outputs]
    about = {
        "study": prepared.study.name, "participant": participant, "place": place, "sample_rate_hz": rate,
        "full_scale_v": full_scale, "channels": [p.name for p in made.transfer.inputs], "grid": grid,
        "break_seconds": {t.name: t.break_seconds for t in prepared.study.tasks},
        "program": f"forearm_fem {__version__}",
    }  # fmt: skip
    write_text(folder / "stimuli.json", json.dumps(about, indent=2))
    for source in ("psychopy_study.py.txt", "jspsych_study.html"):
        text_of = resources.files(__package__).joinpath(f"pages/{source}").read_text(encoding="utf-8")
        write_text(folder / source.removesuffix(".txt"), text_of)
    return folder


def at_rate(signals: FloatArray, own: float, rate: float) -> FloatArray:
    """``signals`` (n_in, n), which begin and end at zero, at another sampling ``rate`` [Hz], with 10 ms around them.

    By Fourier interpolation of a record padded to a whole number of samples at both rates: exact up to the lower of
    the Nyquist frequencies.
    """
    room = round(_ROOM * own)
    n = signals.shape[1] + 2 * room
    step = round(own) // np.gcd(round(own), round(rate))
    padded = step * -(-2 * n // step)
    whole = np.zeros((len(signals), padded))
    whole[:, room : room + signals.shape[1]] = signals
    return np.asarray(resample(whole, round(padded * rate / own), axis=1)[:, : round(n * rate / own)])
