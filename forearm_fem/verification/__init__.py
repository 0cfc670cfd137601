"""Verification that a user can run: every case states its reference, its tolerance and why."""

from .rows import HardRow, Row
from .run import run_hard_cases, run_verification

__all__ = ["HardRow", "Row", "run_hard_cases", "run_verification"]
