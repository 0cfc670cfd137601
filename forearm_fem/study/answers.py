"""Answers that PsychoPy (CSV) or jsPsych (JSON or CSV) took to the trials of an exported ``trials.csv``.

Both keep the columns of ``trials.csv`` beside the response, so that nothing has to be declared. Each answer is held
against the planned order: what is missing stays missing, what stands twice or is not as planned is refused.
"""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ..errors import DataError
from ..ports import Port
from .order import trials
from .run import typed
from .store import EVENTS, SOURCES, StudyStore

_RESPONSES = ("response", "key_resp.keys", "mouse.clicked_name")  # ours, and what PsychoPy's Builder calls them
_FACTS = ("gain", "peak_um", "rms_um", "weighted_db", "drives", *SOURCES)
_NEEDED = ("participant", "task", "trial", "method", "target")


def read_answers(files: Sequence[Path], store: StudyStore, grid: Sequence[Port]) -> dict[str, pd.DataFrame]:
    """Tables by task, as :func:`forearm_fem.study.run.answers_of` gives them, of files or folders of files.

    DataError in one sentence for a file without such answers, an answer that is no grid point, a trial that was not
    planned so, or one that was answered twice.
    """
    found: dict[tuple[str, str, str], dict[str, Any]] = {}
    for file in _each(files):
        for number, row in enumerate(_rows(file), start=1):
            key = (row["participant"], row["task"], row["trial"])
            if key in found:
                raise DataError(
                    f"{file}: trial {row['trial']} of {row['task']} by {row['participant']} is answered twice; leave "
                    "one out"
                )
            found[key] = _answer(f"{file}, answer {number}", row, store, grid)
    for name in SOURCES:
        made = {(row["participant"], row[name]) for row in found.values()}
        if len(made) > len({who for who, _ in made}):
            twice = sorted(who for who, _ in made)
            who = next(a for a, b in pairwise(twice) if a == b)
            raise DataError(f"participant {who} answered stimuli made from two versions of {name}; leave one version's "
                            "answers out")  # fmt: skip
    tables = {}
    for task in store.study.tasks:
        rows = [row for (_, name, _), row in found.items() if name == task.name]
        if rows:
            tables[task.name] = typed(pd.DataFrame(rows).sort_values(["participant", "trial"], ignore_index=True))
    return tables


def _each(files: Sequence[Path]) -> list[Path]:
    kinds = (".csv", ".json")
    return [f for file in files for f in (sorted(p for p in file.iterdir() if p.suffix in kinds) if file.is_dir() else
                                          [file])]  # fmt: skip


def _rows(file: Path) -> list[dict[str, str]]:
    """Answered trials of a file: rows with all columns needed and a response, as texts."""
    try:
        text = file.read_text(encoding="utf-8-sig")
        raw = json.loads(text) if file.suffix == ".json" else list(csv.DictReader(text.splitlines()))
        table = [row for row in raw if all(str(row.get(k) or "") for k in _NEEDED)]
    except (OSError, ValueError, AttributeError, TypeError, csv.Error) as problem:
        raise DataError(f"{file}: cannot be read as PsychoPy's CSV or jsPsych's JSON or CSV "
                        f"({type(problem).__name__})") from None  # fmt: skip
    answered = []
    for row in table:
        given = next((row[k] for k in _RESPONSES if row.get(k) not in (None, "", "None", "null")), None)
        if given is not None:
            clean = {k: str(row[k]).removesuffix(".0") for k in _NEEDED}
            clean |= {k: str(row.get(k) or "n/a") for k in _FACTS}
            answered.append({**clean, "response": _words(given), "response_time": _seconds(row)})
    if not answered:
        raise DataError(
            f"{file}: holds no answer to a trial of trials.csv; expected the columns {', '.join(_NEEDED)} and one of "
            f"{', '.join(_RESPONSES)}"
        )
    return answered


def _words(given: Any) -> str:
    """Names in a response: 5, "5 6", ["5", "6"] or "['num_5']"."""
    names = given if isinstance(given, list) else re.split(r"[\s,;\[\]'\"]+", str(given))
    return " ".join(str(n).removeprefix("num_").removesuffix(".0") for n in names if str(n))


def _seconds(row: Mapping[str, Any]) -> str:
    """Seconds from the end of the stimulus: ours, of PsychoPy's keyboard, or jsPsych's milliseconds."""
    for name, unit in (("response_time", 1.0), ("key_resp.rt", 1.0), ("rt", 1e-3)):
        try:
            return str(float(row[name]) * unit)
        except (KeyError, TypeError, ValueError):
            continue
    return "n/a"


def _answer(where: str, row: Mapping[str, str], store: StudyStore, grid: Sequence[Port]) -> dict[str, Any]:
    """A row of the columns of our own events."""
    people = {p["participant_id"]: p["status"] for p in store.people()}
    if (status := people.get(f"sub-{row['participant']}", "")) in ("", "withdrawn"):
        is_who = "was withdrawn" if status else "is unknown; `forearm-fem study stimuli` invites one"
        raise DataError(f"{where}: participant {row['participant'][:40]} {is_who}")
    task = store.study.task(row["task"])
    order = {str(t.number): t for t in trials(store.study, task, store.place(row["participant"]))}
    planned = order.get(row["trial"])
    if planned is None or (planned.method, planned.target) != (row["method"], row["target"]):
        was = f"{planned.method} towards {planned.target}" if planned else "none"
        raise DataError(f"{where}: trial {row['trial']} is {row['method']} towards {row['target']}, planned was {was}; "
                        "trials.csv is of another study or seed")  # fmt: skip
    places, chosen = {p.name: p.position[:2] for p in grid}, row["response"].split()
    if unknown := [c for c in chosen if c not in places]:
        raise DataError(f"{where}: '{unknown[0][:20]}' is no grid point ({', '.join(places)})")
    x, y = np.mean([places[c] for c in chosen], axis=0)
    return dict.fromkeys(EVENTS, "n/a") | {
        "participant": row["participant"], "trial": planned.number, "phase": planned.phase, "block": planned.block,
        "method": planned.method, "target": planned.target, "repetition": planned.repetition,
        "response": " ".join(chosen), "response_x": x, "response_y": y, "response_time": row["response_time"],
        "late": 0, "session": 1, "presentations": 1, **{k: row[k] for k in _FACTS},
    }  # fmt: skip
