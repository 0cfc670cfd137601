"""From a scenario to a results folder, stage by stage."""

from ..geometry.device.layout import planform_ports
from .folder import run_all, run_mesh, run_render, run_solve
from .simulation import Simulation, render, simulate

__all__ = ["Simulation", "planform_ports", "render", "run_all", "run_mesh", "run_render", "run_solve", "simulate"]
