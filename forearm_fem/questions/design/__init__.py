"""Design of a device: variables, an objective and constraints, searched on a fast model of the arm."""

from .candidate import Candidate, TabulatedArm, evaluate
from .model import Design, load_design
from .run import DesignResult, pareto_front, run_design

__all__ = [
    "Candidate",
    "Design",
    "DesignResult",
    "TabulatedArm",
    "evaluate",
    "load_design",
    "pareto_front",
    "run_design",
]
