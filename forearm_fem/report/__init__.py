"""One page per run: what was asked, what came out, how far to trust it."""

from .write import write_report

__all__ = ["write_report"]
