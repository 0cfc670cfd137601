"""Scenario files: what the user asks for."""

from .load import apply_overrides, load_scenario, parse_scenario, scenario_schema
from .model import Scenario
from .shipped import scenario_file, shipped_scenarios
from .template import scenario_template

__all__ = [
    "Scenario",
    "apply_overrides",
    "load_scenario",
    "parse_scenario",
    "scenario_file",
    "scenario_schema",
    "scenario_template",
    "shipped_scenarios",
]
