"""Verification that a user can run: every case states its reference, its tolerance and why."""

from .rows import HardRow, Row


__all__ = ["HardRow", "Row"]
