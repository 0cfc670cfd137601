"""Scenario files: what the user asks for."""

from .limb import BODIES, Tape
from .model import (
    Scenario,
    apply_overrides,
    load_scenario,
    parse_scenario,
    scenario_beside,
    scenario_file,
    shipped_scenarios,
)
from .text import scenario_schema, scenario_template

__all__ = [
    "BODIES",
    "Scenario",
    "Tape",
    "apply_overrides",
    "load_scenario",
    "parse_scenario",
    "scenario_beside",
    "scenario_file",
    "scenario_schema",
    "scenario_template",
    "shipped_scenarios",
]
