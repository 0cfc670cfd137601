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
from typing import Any, Literal, Protocol

import numpy as np

from ..errors import DataError, ForearmError
from ..ports import Port
from ..typing import FloatArray
from .devices import BackEnd
from .order import Trial, trials
from .plan import Task
from .store import StudyStore

_MOST_DRAWN = 200  # points of a line that are kept, evenly chosen
Waiting = Literal["consent", "start", "stimulus", "playing", "answer", "break", "pause", "done"]


@dataclass(frozen=True)
class Presented:
    """What a player reports: ``seconds`` of stimulus and the largest drive ``peak_voltage`` [V]."""

    seconds: float
    peak_voltage: float


class Player(Protocol):
    """Plays a stimulus and returns when it is over; HardwareError where the device fails."""

    def __call__(self, method: str, target: str) -> Presented:
        """Play ``method`` towards ``target``."""
        ...


@dataclass(frozen=True)
class Given:
    """An answer: names of grid points, or ``strokes`` (n, 2) [m] drawn as one closed outline.

    ``answered`` is how many trials were answered when the page asked; None where the asker cannot be out of date.
    """

    points: tuple[str, ...] = ()
    strokes: FloatArray | None = None
    answered: int | None = None


class Session:
    """A participant's session; safe to call from several threads.

    ``sources`` and ``facts``, the latter by method and target, are columns of each trial: what its stimulus was made
    from, and how strong it is. To a text of ``consent`` the participant agrees before the first trial.
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
        back_end: BackEnd | None = None,
        sources: Mapping[str, str] | None = None,
        facts: Mapping[tuple[str, str], Mapping[str, Any]] | None = None,
        consent: str = "",
    ) -> None:
        self._store, self.participant, self.task, self._player = store, participant, task, player
        self._clock = clock
        self._places = {p.name: np.array(p.position[:2]) for p in grid}
        self._trials, self.consent_text = trials(store.study, task, store.place(participant)), consent
        self._sources, self._facts = sources or {}, facts or {}
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
        self.back_end, self._told = back_end or BackEnd("unknown", float("nan")), False
        self._onset = self._over = self._break_until = 0.0
        self.problem = ""

    @property
    def current(self) -> Trial | None:
        """The trial that waits for its stimulus or its answer; None when all are answered."""
        return self._trials[self._answered] if self._answered < len(self._trials) else None

    def view(self) -> dict[str, Any]:
        """What both pages may know: no method, no target, no level."""
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

    def answer(self, given: Given) -> None:
        """Record an answer to what was presented, on the disk when this returns; DataError for what was not asked."""
        with self._lock:
            trial = self.current
            if self._waiting != "answer" or trial is None:
                raise DataError("no answer is due now: the stimulus has not been played, or was answered already")
            if given.answered not in (None, self._answered):
                raise DataError(f"that answer was to trial {given.answered + 1}, which is over; look at the page again")
            seconds = self._clock() - self._over
            limit = self.task.answer_seconds
            row = {
                "onset": self._onset - self._begun, "duration": self._last.seconds, "trial": trial.number,
                "phase": trial.phase, "block": trial.block, "method": trial.method, "target": trial.target,
                "repetition": trial.repetition, **self._response(given),
                "response_time": seconds, "late": int(limit is not None and seconds > limit),
                "presentations": self._presented, "peak_voltage": self._last.peak_voltage, "session": self._number,
                "date": _today(), **self._sources, **self._facts.get((trial.method, trial.target), {}),
            }  # fmt: skip
            if not self._told:
                who = {"participant_id": f"sub-{self.participant}", "task": self.task.name, "session": self._number}
                self._store.add_device(who | self.back_end.row)
                self._told = True
            self._store.add(self.participant, self.task.name, row)
            self._answered, self._presented = self._answered + 1, 0
            following = self.current
            if following is None:
                self._waiting = "done"
            elif following.block == trial.block:
                self._waiting = "stimulus"
            else:
                self._waiting, self._break_until = "break", self._clock() + self.task.break_seconds

    def _response(self, given: Given) -> dict[str, Any]:
        kind = self.task.answer
        if kind == "drawing":
            centre, area = _outline(given.strokes)
            points = np.asarray(given.strokes, dtype=float)
            some = np.unique(np.linspace(0, len(points) - 1, min(len(points), _MOST_DRAWN)).round().astype(int))
            drawn = " ".join(f"{1e3 * x:.2f},{1e3 * y:.2f}" for x, y in points[some])
            return {"response_x": float(centre[0]), "response_y": float(centre[1]), "response_area": area,
                    "response_outline": drawn}  # fmt: skip
        names = tuple(dict.fromkeys(given.points))
        if not names or (kind == "one point" and len(names) > 1):
            raise DataError("choose one point" if kind == "one point" else "choose one point or more")
        if unknown := [n for n in names if n not in self._places]:
            raise DataError(f"'{unknown[0][:20]}' is no grid point; choose among {', '.join(self._places)}")
        x, y = np.mean([self._places[n] for n in names], axis=0)
        return {"response": " ".join(names), "response_x": float(x), "response_y": float(y)}


def _today() -> str:
    return datetime.now(UTC).date().isoformat()


def _outline(strokes: FloatArray | None) -> tuple[FloatArray, float]:
    """Centroid [m] and area [m2] of a closed outline (n, 2), by the shoelace formula."""
    points = np.asarray(strokes if strokes is not None else (), dtype=float)
    if points.ndim != 2 or points.shape[1] != 2 or not 3 <= len(points) <= 10_000 or not np.all(np.isfinite(points)):
        raise DataError("draw an outline around where you felt it")
    origin = points.mean(axis=0)
    p, q = points - origin, np.roll(points - origin, -1, axis=0)
    cross = p[:, 0] * q[:, 1] - q[:, 0] * p[:, 1]
    area = cross.sum() / 2
    if abs(area) < 1e-9:  # a square of 0.03 mm: a dot or a line
        return origin, 0.0
    return origin + ((p + q) * cross[:, None]).sum(axis=0) / (6 * area), float(abs(area))
