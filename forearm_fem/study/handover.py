"""Stimuli and trials for PsychoPy, jsPsych or another player, and answers: theirs, and our own sessions'.

Each WAV holds one presentation, a channel per actuator, in 32-bit floating point: 1 is the stated full scale of the
card's output in volts. ``trials.csv`` is the whole order: what each trial plays, its strength at the target, and
hashes of its sources. Answers come back beside its columns, and are held against the planned order:
what is missing stays missing, what stands twice or is not as planned is refused.
"""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.io import wavfile
from scipy.signal import resample

from .. import __version__
from ..errors import DataError, ScenarioError
from ..measurement.daq import faded
from ..ports import Port
from ..store.folder import atomic_path, write_text
from ..store.text import text_of
from ..typing import FloatArray
from .plan import Trial, tasks_of, trials
from .run import Made, Prepared
from .stimuli import beyond
from .store import EVENTS, SOURCES, STIMULI, StudyStore

_ROOM = 0.01  # [s] of silence before and after, where a resampled fade rings out
_RESPONSES = ("response", "key_resp.keys", "mouse.clicked_name")  # ours, and what PsychoPy's Builder calls them
_FACTS = ("gain", "peak_um", "rms_um", "weighted_db", "drives", *SOURCES)
_NEEDED = ("participant", "task", "trial", "method", "target")
_NUMBERS = (
    "onset", "duration", "trial", "block", "repetition", "response_x", "response_y", "response_time", "presentations",
    "peak_voltage", "latency", "cable_gain", "session", "gain", "peak_um", "rms_um", "weighted_db",
)  # fmt: skip


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
    points, facts = " ".join(p.name for p in made.transfer.outputs), made.facts()
    rows = [
        {"participant": participant, "task": task.name, "answer": task.answer, "trial": t.number, "phase": t.phase,
         "block": t.block, "method": t.method, "target": t.target, "repetition": t.repetition,
         "wav": names[t.method, t.target], "points": points, **facts[t.method, t.target], **made.sources}
        for task in tasks_of(prepared.study, place) for t in trials(prepared.study, task, place)
    ]  # fmt: skip
    write_text(folder / "trials.csv", pd.DataFrame(rows).to_csv(index=False, float_format="%.6g", lineterminator="\n"))
    about = {
        "study": prepared.study.name, "participant": participant, "place": place, "sample_rate_hz": rate,
        "full_scale_v": full_scale, "channels": [p.name for p in made.transfer.inputs],
        "grid": [{"name": p.name, "x": p.position[0], "y": p.position[1]} for p in made.transfer.outputs],
        "break_seconds": {t.name: t.break_seconds for t in prepared.study.tasks},
        "program": f"forearm_fem {__version__}",
    }  # fmt: skip
    write_text(folder / "stimuli.json", json.dumps(about, indent=2))
    for source in ("psychopy_study.py.txt", "jspsych_study.html"):
        text = resources.files(__package__).joinpath(f"pages/{source}").read_text(encoding="utf-8")
        write_text(folder / source.removesuffix(".txt"), text)
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


def answers(store: StudyStore, files: Sequence[Path] = (), grid: Sequence[Port] = ()) -> dict[str, pd.DataFrame]:
    """Tables by task, with ``participant``: of our own sessions, or of ``files`` or folders of other programs.

    The ``grid`` tells where the points of the latter lie. Who withdrew is left out. DataError where there is none. Of
    foreign ones, too, for a file without such answers, an answer that is no grid point, and a trial not planned so or
    answered twice.
    """
    if files:
        rows = _foreign(store, files, grid)
    else:
        active = [p["participant_id"].removeprefix("sub-") for p in store.people() if p["status"] != "withdrawn"]
        rows = [
            {"participant": who, "task": task.name, **row}
            for task in store.study.tasks for who in active for row in store.answers(who, task.name)
        ]  # fmt: skip
    if not rows:
        raise DataError(f"{store.folder}: nobody has answered yet; `forearm-fem study run` asks")
    table = pd.DataFrame(rows).replace("n/a", np.nan)
    for name in _NUMBERS:
        try:
            table[name] = pd.to_numeric(table[name])
        except (ValueError, TypeError) as problem:
            raise DataError(f"column {name}: {str(problem)[:120]}; expected a number or n/a") from None
    names = [t.name for t in store.study.tasks if (table["task"] == t.name).any()]
    return {name: table[table["task"] == name].drop(columns="task").reset_index(drop=True) for name in names}


def _foreign(store: StudyStore, files: Sequence[Path], grid: Sequence[Port]) -> list[dict[str, Any]]:
    """Rows with the columns of our own events and ``task``, sorted by participant and trial."""
    found: dict[tuple[str, str, int], dict[str, Any]] = {}
    orders: dict[tuple[str, str], dict[str, Trial]] = {}
    each = [p for f in files for p in (sorted(q for q in f.iterdir() if q.suffix in (".csv", ".json"))
                                       if f.is_dir() else [f])]  # fmt: skip
    for file in each:
        for number, row in enumerate(_answered(file), start=1):
            made = _answer(f"{file}, answer {number}", row, store, grid, orders)
            key = (row["participant"], row["task"], made["trial"])
            if key in found:
                raise DataError(f"{file}: trial {key[2]} of {key[1]} by {key[0]} is answered twice; leave one out")
            found[key] = made
    for name in SOURCES:
        kinds: dict[str, set[str]] = {}
        for row in found.values():
            kinds.setdefault(row["participant"], set()).add(row[name])
        if twice := [who for who, made in kinds.items() if len(made) > 1]:
            raise DataError(f"participant {twice[0]} answered stimuli made from two versions of {name}; leave one "
                            "version's answers out")  # fmt: skip
    return [found[key] for key in sorted(found)]


def _answered(file: Path) -> list[dict[str, str]]:
    """Answered trials of a file: rows with all columns needed and a response, as texts."""
    try:
        text = text_of(file.read_bytes())
        raw = json.loads(text) if file.suffix == ".json" else _table(text)
        table = [row for row in raw if all(str(row.get(k) or "") for k in _NEEDED)]
    except (OSError, ValueError, AttributeError, TypeError, csv.Error) as problem:
        raise DataError(f"{file}: cannot be read as PsychoPy's CSV or jsPsych's JSON or CSV "
                        f"({type(problem).__name__})") from None  # fmt: skip
    done = []
    for row in table:
        given = next((row[k] for k in _RESPONSES if row.get(k) not in (None, "", "None", "null")), None)
        if given is not None:  # 5, "5 6", ["5", "6"] or "['num_5']"
            names = given if isinstance(given, list) else re.split(r"[\s,;\[\]'\"]+", str(given))
            response = " ".join(str(n).removeprefix("num_").removesuffix(".0") for n in names if str(n))
            told = {k: str(row[k]).removesuffix(".0") for k in _NEEDED}
            done.append({**row, **told, "response": response, "response_time": _seconds(row)})
    if not done:
        columns = {str(k) for row in raw for k in row}
        lacks = [k for k in _NEEDED if k not in columns] or [f"one of {', '.join(_RESPONSES)} that is filled in"]
        raise DataError(
            f"{file}: holds no answer to a trial of trials.csv, by which answers are held against the plan; it lacks "
            f"{', '.join(lacks)}: keep the columns of trials.csv beside the response"
        )
    return done


def _table(text: str) -> list[dict[str, Any]]:
    """Rows of a CSV as programs and spreadsheets write it: commas, semicolons or tabs, which ``sep=;`` may say."""
    first, _, rest = text.partition("\n")
    if said := re.fullmatch(r'"?sep=(.)"?', first.strip(), re.IGNORECASE):
        return list(csv.DictReader(rest.splitlines(), delimiter=said[1]))
    mark = max(",;\t", key=first.count)
    return list(csv.DictReader(text.splitlines(), delimiter=mark))


def _seconds(row: Mapping[str, Any]) -> str:
    """Seconds from the end of the stimulus: ours, of PsychoPy's keyboard, or jsPsych's milliseconds."""
    for name, unit in (("response_time", 1.0), ("key_resp.rt", 1.0), ("rt", 1e-3)):
        try:
            return str(float(row[name]) * unit)
        except (KeyError, TypeError, ValueError):
            continue
    return "n/a"


def _answer(
    where: str, row: Mapping[str, str], store: StudyStore, grid: Sequence[Port],
    orders: dict[tuple[str, str], dict[str, Trial]],
) -> dict[str, Any]:  # fmt: skip
    """A row of the columns of our own events, with ``participant`` and ``task``; ``orders`` are kept between rows."""
    who, task = row["participant"], store.study.task(row["task"])
    if (who, task.name) not in orders:
        people = {p["participant_id"]: p["status"] for p in store.people()}
        if (status := people.get(f"sub-{who}", "")) in ("", "withdrawn"):
            is_who = "was withdrawn" if status else "is unknown; `forearm-fem study stimuli` invites one"
            raise DataError(f"{where}: participant {who[:40]} {is_who}")
        order = trials(store.study, task, store.place(who))
        orders[who, task.name] = {str(t.number): t for t in order}
    planned = orders[who, task.name].get(row["trial"])
    if planned is None or (planned.method, planned.target) != (row["method"], row["target"]):
        was = f"{planned.method} towards {planned.target}" if planned else "none"
        raise DataError(f"{where}: trial {row['trial']} is {row['method']} towards {row['target']}, planned was {was}; "
                        "trials.csv is of another study or seed")  # fmt: skip
    places, chosen = {p.name: p.position[:2] for p in grid}, row["response"].split()
    if unknown := [c for c in chosen if c not in places]:
        raise DataError(f"{where}: '{unknown[0][:20]}' is no grid point ({', '.join(places)})")
    x, y = np.mean([places[c] for c in chosen], axis=0)
    return dict.fromkeys(EVENTS, "n/a") | {
        "participant": who, "task": task.name, "trial": planned.number, "phase": planned.phase, "block": planned.block,
        "method": planned.method, "target": planned.target, "repetition": planned.repetition,
        "response": " ".join(chosen), "response_x": x, "response_y": y, "response_time": row["response_time"],
        "session": 1, "presentations": 1, **{k: str(row.get(k) or "n/a") for k in _FACTS},
    }  # fmt: skip
