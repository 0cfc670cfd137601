"""Finite-element simulation of vibration in a layered human forearm, and the renderers that use it.

::

    scenario = load_scenario("quick")
    simulation = simulate(scenario)
    simulation.sel("5", "A1")          # G of a point by an actuator
    simulation.strength.plot()         # S with its interval
    render(read("lab.csv"), scenario)  # the same on a measured G
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

__version__ = "0.39.0"

if TYPE_CHECKING:
    from .api import calibrate as calibrate
    from .api import compare as compare
    from .api import design as design
    from .api import fit as fit
    from .api import predict as predict
    from .api import read as read
    from .api import render as render
    from .engines.library import ArmLibrary as ArmLibrary
    from .engines.library import load_library as load_library
    from .engines.simulation import Simulation as Simulation
    from .engines.simulation import simulate as simulate
    from .errors import ForearmError as ForearmError
    from .rendering import Rendering as Rendering
    from .rendering.interval import Strength as Strength
    from .rendering.job import RenderJob as RenderJob
    from .rendering.renderers import Aim as Aim
    from .rendering.renderers import Renderer as Renderer
    from .scenario import Scenario as Scenario
    from .scenario import load_scenario as load_scenario
    from .tissue import Law as Law
    from .transfer import Compliance as Compliance
    from .transfer import ErrorEstimate as ErrorEstimate
    from .transfer import TransferMatrix as TransferMatrix

_HOMES = {
    **dict.fromkeys(("calibrate", "compare", "design", "fit", "predict", "read", "render"), "api"),
    **dict.fromkeys(("Simulation", "simulate"), "engines.simulation"),
    **dict.fromkeys(("ArmLibrary", "load_library"), "engines.library"),
    **dict.fromkeys(("Aim", "Renderer"), "rendering.renderers"),
    **dict.fromkeys(("Scenario", "load_scenario"), "scenario"),
    **dict.fromkeys(("Compliance", "ErrorEstimate", "TransferMatrix"), "transfer"),
    "ForearmError": "errors",
    "Law": "tissue",
    "RenderJob": "rendering.job",
    "Rendering": "rendering",
    "Strength": "rendering.interval",
}

__all__ = [
    "Aim", "ArmLibrary", "Compliance", "ErrorEstimate", "ForearmError", "Law", "RenderJob", "Renderer", "Rendering",
    "Scenario", "Simulation", "Strength", "TransferMatrix", "__version__", "calibrate", "compare", "design", "fit",
    "load_library", "load_scenario", "predict", "read", "render", "simulate",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    """Load the public names on first use, so that importing the package stays quick."""
    if name in _HOMES:
        from importlib import import_module

        found = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
        globals()[name] = found  # a room of the same name would take its place when it is loaded
        return found
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    """The public names."""
    return __all__
