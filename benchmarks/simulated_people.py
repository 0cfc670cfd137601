"""Simulated participants, to try a study's machinery and analysis with: nothing in them predicts people.

Each has an own bias, an own effect of each method and of each target, and errs by a normal scatter.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from forearm_fem.ports import Port

TRIAL, OWN, METHOD, TARGET = 8e-3, 2e-3, 2e-3, 2e-3  # [m] standard deviations, about those of the thesis' answers


class Person:
    """Answers with the grid points nearest to where a stimulus is felt."""

    def __init__(self, grid: Sequence[Port], seed: int, worse: dict[str, float] | None = None) -> None:
        self._rng, self._worse = np.random.default_rng([11, seed]), worse or {}
        self._names = [p.name for p in grid]
        self._grid = np.array([p.position[:2] for p in grid])
        self._bias = OWN * self._rng.standard_normal(2)
        self._own: dict[str, np.ndarray] = {}

    def felt(self, method: str, target: str) -> np.ndarray:
        """Where it is felt (2,) [m] in one trial; a method's ``worse`` adds to its scatter."""
        for key, scale in ((f"m {method}", METHOD), (f"t {target}", TARGET)):
            if key not in self._own:
                self._own[key] = scale * self._rng.standard_normal(2)
        scatter = TRIAL + self._worse.get(method, 0.0)
        at = self._grid[self._names.index(target)] + self._own[f"m {method}"] + self._own[f"t {target}"]
        return np.asarray(at + self._bias + scatter * self._rng.standard_normal(2))

    def answer(self, method: str, target: str, *, several: bool = False) -> tuple[str, ...]:
        """The nearest point; or all less than 1.3 times as far, and always the nearest."""
        away = np.linalg.norm(self._grid - self.felt(method, target), axis=1)
        if not several:
            return (self._names[int(np.argmin(away))],)
        return tuple(n for n, d in zip(self._names, away, strict=True) if d <= 1.3 * away.min() + 2e-3)
