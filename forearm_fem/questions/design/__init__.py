"""Which device to build: variables, an objective and constraints, searched on a fast model of the arm."""

from .arm import ArmModel, TwinArm
from .candidate import Candidate, evaluate
from .front import pareto_front
from .model import Design, load_design
from .run import DesignResult, run_design

__all__ = [
    "ArmModel",
    "Candidate",
    "Design",
    "DesignResult",
    "TwinArm",
    "evaluate",
    "load_design",
    "pareto_front",
    "run_design",
]
