"""Wall time and memory against true error: every method on the same scene, against its exact solution."""

from .run import PARTS, run_bench

__all__ = ["PARTS", "run_bench"]
