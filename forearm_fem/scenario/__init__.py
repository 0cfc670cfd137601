"""Scenario files: what the user asks for."""

from .load import apply_overrides, load_scenario, parse_scenario, scenario_schema
from .model import Scenario

__all__ = ["Scenario", "apply_overrides", "load_scenario", "parse_scenario", "scenario_schema"]
