"""The public rooms of the package: what their ``__all__`` names is public, all else may change without notice."""

from __future__ import annotations

import importlib

PUBLIC = {
    "forearm_fem": "The whole way in five names",
    "forearm_fem.engines.simulation": "From a scenario to G",
    "forearm_fem.questions.run": "From a scenario to a results folder, stage by stage",
    "forearm_fem.engines.skin_model": "A solved limb without its mesh",
    "forearm_fem.transfer": "What a solve or a measurement gives",
    "forearm_fem.ports": "Contacts and points",
    "forearm_fem.scenario": "Scenarios",
    "forearm_fem.rendering": "Renderers",
    "forearm_fem.metrics": "Numbers that judge a rendering or a matrix",
    "forearm_fem.questions.calibrate": "Calibration and playing",
    "forearm_fem.questions.compare.run": "Comparing and fitting",
    "forearm_fem.show": "Figures",
    "forearm_fem.show.motion": "Waves in space: which",
    "forearm_fem.show.film": "Waves in space: stills and films",
    "forearm_fem.show.workbench": "The workbench: a run as a page for the browser",
    "forearm_fem.results.files": "Files of a run",
    "forearm_fem.device": "The device's circuit and mechanics",
    "forearm_fem.layered": "The semi-analytic layered model",
    "forearm_fem.engines.library": "An arm's library: any arrangement without a solve",
    "forearm_fem.questions.campaign": "Campaigns",
    "forearm_fem.errors": "Named failures",
}


def public_names(room: str) -> list[str]:
    """The names of a public room: its ``__all__``."""
    return [n for n in importlib.import_module(room).__all__ if not n.startswith("__")]
