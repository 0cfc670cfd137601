"""From a scenario to a results folder, stage by stage."""

from .folder import run_all, run_mesh, run_render, run_solve
from .simulation import Simulation, render, simulate

__all__ = ["Simulation", "render", "run_all", "run_mesh", "run_render", "run_solve", "simulate"]
