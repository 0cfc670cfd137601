"""The run that pages of the gallery draw: ``results/quick`` beside them, as readers of a downloaded page have it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

from forearm_fem.questions.run import Run, run_render
from forearm_fem.scenario import load_scenario, scenario_file

FOLDER = Path(__file__).parents[1] / "gallery" / "results" / "quick"


def solved(_: Sphinx) -> None:
    """Solve the quick scene where it was not (some twenty seconds)."""
    run_render(Run.start(load_scenario("quick"), FOLDER, scenario_file("quick").parent))


def setup(app: Sphinx) -> dict[str, Any]:
    """Solve before the gallery runs, which waits for the same event."""
    app.connect("builder-inited", solved, priority=1)
    return {"parallel_read_safe": True}
