"""A window to walk around in: sliders for the instant or phase, the target and the method."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from .data import Results
from .film import Look, Stage, default_view, staged
from .motion import View, motion
from .scene import plotter_for


def interact(
    results: Results | str | Path, *, view: View | None = None, look: Look | None = None, off_screen: bool = False
) -> None:
    """Open a window with sliders; returns when it is closed. ForearmError where there is no display.

    At a frequency the first slider is the phase and a fourth one the frequency. ``off_screen`` is for tests.
    """
    found = results if isinstance(results, Results) else Results.open(results)
    look = look or Look(size=(1300, 950))
    with plotter_for(look.size, off_screen=off_screen) as plotter:
        room = Room(found, plotter, view or default_view(found), look)
        room.furnish()
        plotter.show(auto_close=False)


class Room:
    """The window's state: which motion, which step."""

    def __init__(self, results: Results, plotter: Any, view: View, look: Look) -> None:
        self.results, self.plotter, self.view, self.look = results, plotter, view, look
        self.step = 0
        self.stage: Stage | None = None

    def furnish(self) -> None:
        """Scene and sliders; the scene is built anew when the motion changes."""
        self._rebuild()
        drives = self.results.drives
        assert self.stage is not None
        if (steps := len(self.stage.moved.steps)) > 1:
            self.plotter.add_slider_widget(
                lambda step: self._to_step(round(step)), (0, steps - 1), value=0,
                title="phase" if self.view.frequency else "instant", fmt="%.0f", **_place(0),
            )  # fmt: skip
        self._choice("target", drives.targets, self.view.target, 1, self._to_target)
        self._choice("method", drives.methods, self.view.method, 2, self._to_method)
        if self.view.frequency is not None:
            band = self.results.transfer.frequency
            ends = (float(band[0]), float(band[-1]))
            self.plotter.add_slider_widget(self._to_frequency, ends, value=self.view.frequency,
                                           title="Hz", fmt="%.0f", **_place(3))  # fmt: skip

    def _choice(self, title: str, names: tuple[str, ...], now: str, row: int, act: Callable[[int], None]) -> None:
        """A slider that shows names, for their numbers are not those of points."""
        words = [f"{title} {name}" if name.isdigit() else name for name in names]
        if len(names) > 1:
            place = {key: value for key, value in _place(row).items() if key != "title_height"}
            slider = self.plotter.add_text_slider_widget(
                lambda word: act(words.index(word)), words, value=names.index(now) if now in names else 0, **place
            )
            slider.GetRepresentation().SetTitleHeight(_place(row)["title_height"])

    def _rebuild(self) -> None:
        camera = self.plotter.camera_position if self.stage is not None else None
        self.plotter.clear_actors()
        self.stage = staged(self.results, self.plotter, motion(self.results, self.view), self.look)
        if camera is not None:
            self.plotter.camera_position = camera
        self.stage.show(min(self.step, len(self.stage.moved.steps) - 1))

    def _to_step(self, step: int) -> None:
        self.step = step
        assert self.stage is not None
        self.stage.show(step)

    def _to_target(self, index: int) -> None:
        self._to(replace(self.view, target=self.results.drives.targets[index]))

    def _to_method(self, index: int) -> None:
        self._to(replace(self.view, method=self.results.drives.methods[index]))

    def _to_frequency(self, frequency: float) -> None:
        self._to(replace(self.view, frequency=frequency))

    def _to(self, view: View) -> None:
        if view != self.view:
            self.view = view
            self._rebuild()


def _place(row: int) -> dict[str, Any]:
    """Sliders below each other at the lower left."""
    y = 0.32 - 0.085 * row
    return {"pointa": (0.02, y), "pointb": (0.22, y), "style": "modern", "title_height": 0.018}
