"""Verification that a user can run: every row states its reference, its tolerance and why."""

from .run import run_verification
from .scenes import Row

__all__ = ["Row", "run_verification"]
