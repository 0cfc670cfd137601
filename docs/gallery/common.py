"""The quick scene's results, made once: what every page of the gallery starts from."""

from __future__ import annotations

from pathlib import Path

from forearm_fem.figures import Results

ROOT = Path(__file__).resolve().parents[2]
RUN = ROOT / "results" / "quick"


def quick() -> Results:
    """Results of scenarios/quick.toml; solved first if they are not there (some twenty seconds)."""
    if not (RUN / "signal_strength.csv").is_file():
        from forearm_fem.pipeline.folder import Run, run_render
        from forearm_fem.scenario import load_scenario

        scene = ROOT / "scenarios" / "quick.toml"
        run_render(Run.start(load_scenario(scene), RUN, scene.parent))
    return Results.open(RUN)
