"""Scenario files: what the user asks for."""

from .limb import BODIES, Tape
from .load import (
    apply_overrides,
    load_scenario,
    parse_scenario,
    scenario_beside,
    scenario_file,
    scenario_schema,
    scenario_template,
    shipped_scenarios,
)
from .model import Scenario

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
