"""One page per run: what was asked, what came out, how far to trust it."""

from .write import strengths_by_target, write_report

__all__ = ["strengths_by_target", "write_report"]
