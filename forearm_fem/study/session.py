"""One participant at one task: what is presented next, what an answer does, and how a session goes on after a stop.

Nothing is kept in memory that is not on disk: the next trial is the first one without an answer. Pages only show
:meth:`Session.view` and call ``consent``, ``start``, ``present``, ``answer``, ``pause`` and ``repeat``.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from threading import RLock
from typing import Any, Literal

import numpy as np

from ..errors import DataError, ForearmError
from ..ports import Port
from .plan import Task, Trial, trials
from .store import StudyStore

Waiting = Literal["consent", "start", "stimulus", "playing", "answer", "break", "pause", "done"]


@dataclass(frozen=True)
class Presented:
    """Report of a player: ``seconds`` of stimulus and the largest drive ``peak_voltage`` [V]."""

    seconds: float
    peak_voltage: float


Player = Callable[[str, str], Presented]  # plays a method towards a target and returns when that is over


class Session:
    """A participant's session; safe to call from several threads.

    ``columns`` of each trial are the same in all: what its stimulus was made from, and what plays; ``facts``, by method
    and target, say how strong it is. To a text of ``consent`` the participant agrees before the first trial.
    """

    def __init__(
        self,
        store: StudyStore,
        participant: str,
        task: Task,
        grid: Sequence[Port],
        player: Player,
        clock: Callable[[], float] = time.monotonic,
        *,
        columns: Mapping[str, Any] | None = None,
        facts: Mapping[tuple[str, str], Mapping[str, Any]] | None = None,
        consent: str = "",
    ) -> None:
        self._store, self.participant, self.task, self._player = store, participant, task, player
        self._clock = clock
        self._places = {p.name: np.array(p.position[:2]) for p in grid}
        self._trials, self.consent_text = trials(store.study, task, store.place(participant)), consent
        self._columns, self._facts = columns or {}, facts or {}
        if missing := [t for t in store.study.stimuli.targets if t not in self._places]:
            raise DataError(f"stimuli.targets: '{missing[0]}' is no output of G; it has {', '.join(self._places)}")
        self._lock = RLock()
        done = store.answers(participant, task.name)
        for row, trial in zip(done, self._trials, strict=False):
            if (row["trial"], row["method"], row["target"]) != (str(trial.number), trial.method, trial.target):
                raise DataError(
                    f"sub-{self.participant}, {self.task.name}: trial {row['trial']} on disk is not the one of this "
                    "study's order; the study file or the seed was changed"
                )
        self._answered = len(done)
        self._number = 1 + max((int(r["session"]) for r in done), default=0)
        first: Waiting = "consent" if consent and not store.consented(participant) else "start"
        self._waiting: Waiting = "done" if self._answered == len(self._trials) else first
        played = max((float(r["onset"]) + float(r["duration"]) for r in done), default=0.0)
        self._begun, self._presented, self._last = self._clock() - played, 0, Presented(0.0, 0.0)
        self._onset = self._over = self._break_until = 0.0
        self.problem = ""

    @property
    def current(self) -> Trial | None:
        """The trial that waits for its stimulus or its answer; None when all are answered."""
        return self._trials[self._answered] if self._answered < len(self._trials) else None

    def view(self) -> dict[str, Any]:
        """State for both pages: no method, no target, no level."""
        with self._lock:
            left = max(0.0, self._break_until - self._clock())
            trial = self.current
            return {
                "waiting": self._waiting,
                "answered": self._answered,
                "total": len(self._trials),
                "phase": trial.phase if trial else "main",
                "block": trial.block if trial else self.task.blocks,
                "blocks": self.task.blocks,
                "answer": self.task.answer,
                "break_left": left if self._waiting == "break" else 0.0,
                "problem": self.problem,
            }

    def consent(self) -> None:
        """The participant agrees to the text shown: kept with today's date and the text's hash."""
        with self._lock:
            if self._waiting == "consent":
                self._store.consent(self.participant, _today(), self.consent_text)
                self._waiting = "start"

    def start(self) -> None:
        """Begin, go on after a pause, or end a break; a break cannot be ended before its time."""
        with self._lock:
            if self._waiting == "break" and self._clock() < self._break_until:
                raise DataError(f"the break lasts {self._break_until - self._clock():.0f} s longer")
            if self._waiting in ("start", "pause", "break"):
                self._waiting = "stimulus"

    def pause(self) -> None:
        """Hold the session before the next stimulus; a stimulus without an answer is presented anew."""
        with self._lock:
            if self._waiting in ("stimulus", "playing", "answer"):
                self._waiting = "pause"

    def repeat(self) -> None:
        """Present the current stimulus again (the experimenter's wish); counted in ``presentations``."""
        with self._lock:
            if self._waiting == "answer":
                self._waiting = "stimulus"

    def present(self) -> None:
        """Play the current stimulus. Where the device fails the session pauses, says why, and loses nothing.

        The state can be read and the session paused meanwhile: a stimulus paused over is presented anew.
        """
        with self._lock:
            trial = self.current
            if self._waiting != "stimulus" or trial is None:
                raise DataError("no stimulus is due now; press start, or answer the last one first")
            self._waiting, self._onset = "playing", self._clock()
        try:
            last = self._player(trial.method, trial.target)
        except ForearmError as problem:
            with self._lock:
                self._waiting, self.problem = "pause", str(problem)
            raise
        with self._lock:
            self._last, self._presented, self.problem = last, self._presented + 1, ""
            self._over = self._clock()
            if self._waiting == "playing":
                self._waiting = "answer"

    def answer(self, points: Sequence[str], answered: int | None = None) -> None:
        """Record grid points as the answer, on the disk when this returns; DataError for what was not asked.

        Where it cannot be written the trial still waits for it, and ``problem`` says why.

        ``answered`` is how many trials were over when the page asked; None where the asker cannot be out of date.
        """
        with self._lock:
            trial = self.current
            if self._waiting != "answer" or trial is None:
                raise DataError("no answer is due now: the stimulus has not been played, or was answered already")
            if answered not in (None, self._answered):
                raise DataError(f"that answer was to trial {answered + 1}, which is over; look at the page again")
            row = {
                "onset": self._onset - self._begun, "duration": self._last.seconds, "trial": trial.number,
                "phase": trial.phase, "block": trial.block, "method": trial.method, "target": trial.target,
                "repetition": trial.repetition, **self._response(points), "response_time": self._clock() - self._over,
                "presentations": self._presented, "peak_voltage": self._last.peak_voltage, "session": self._number,
                "date": _today(), **self._columns, **self._facts.get((trial.method, trial.target), {}),
            }  # fmt: skip
            try:
                self._store.add(self.participant, self.task.name, row)
            except ForearmError as problem:
                self.problem = str(problem)
                raise
            self.problem = ""
            self._answered, self._presented = self._answered + 1, 0
            following = self.current
            if following is None:
                self._waiting = "done"
            elif following.block == trial.block:
                self._waiting = "stimulus"
            else:
                self._waiting, self._break_until = "break", self._clock() + self.task.break_seconds

    def _response(self, points: Sequence[str]) -> dict[str, Any]:
        names, one = tuple(dict.fromkeys(points)), self.task.answer == "one point"
        if not names or (one and len(names) > 1):
            raise DataError("choose one point" if one else "choose one point or more")
        if unknown := [n for n in names if n not in self._places]:
            raise DataError(f"'{unknown[0][:20]}' is no grid point; choose among {', '.join(self._places)}")
        x, y = np.mean([self._places[n] for n in names], axis=0)
        return {"response": " ".join(names), "response_x": float(x), "response_y": float(y)}


def _today() -> str:
    return datetime.now(UTC).date().isoformat()
