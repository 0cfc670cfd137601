"""Finite-element simulation of vibration in a layered human forearm, and the renderers that use it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

__version__ = "0.33.0"

if TYPE_CHECKING:
    from .pipeline import Simulation as Simulation
    from .pipeline import render as render
    from .pipeline import simulate as simulate
    from .scenario import Scenario as Scenario
    from .scenario import load_scenario as load_scenario

__all__ = ["Scenario", "Simulation", "__version__", "load_scenario", "render", "simulate"]

_HOMES = {
    "load_scenario": "scenario",
    "Scenario": "scenario",
    "simulate": "pipeline",
    "render": "pipeline",
    "Simulation": "pipeline",
}


def __getattr__(name: str) -> Any:
    """Load the public names on first use, so that importing the package stays quick."""
    if name in _HOMES:
        from importlib import import_module

        return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
