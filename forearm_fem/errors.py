"""Named failures; each message says what was expected, what came and what to do.

The command line prints the message of a :class:`ForearmError` as one sentence and exits with code 2.
"""

__all__ = [
    "AccuracyWarning",
    "DataError",
    "ForearmError",
    "GeometryError",
    "HardwareError",
    "MeshError",
    "MeshTooLarge",
    "MissingExtra",
    "NotApplicable",
    "ReductionError",
    "ScenarioError",
    "SolverError",
    "first_problem",
    "one_sentence",
    "optional",
]

import re
from collections.abc import Mapping
from importlib import import_module
from typing import Any

LONGEST_SENTENCE = 300  # characters of a message


def one_sentence(text: str, longest: int = LONGEST_SENTENCE) -> str:
    """``text`` on one line of at most ``longest`` characters.

    What is too long loses its middle: the key stands at the beginning, the remedy at the end.
    """
    line = "".join(c for c in " ".join(text.split()) if c.isprintable())
    if len(line) <= longest:
        return line
    end = (longest - 5) // 2
    return f"{line[: longest - 5 - end]} ... {line[-end:]}"


class ForearmError(Exception):
    """Any failure that a user can act upon; its message is one line of at most 300 characters."""

    def __init__(self, message: object = "") -> None:
        super().__init__(one_sentence(str(message)))


class ScenarioError(ForearmError):
    """A scenario file or override is malformed, unknown or impossible."""


class GeometryError(ForearmError):
    """A limb, surface or contact cannot exist as described."""


class MeshError(ForearmError):
    """A mesh is open, inverted, of bad quality, or lacks a region."""


class MeshTooLarge(MeshError):
    """A mesh has more elements than the scenario allows: a finer one is no remedy."""


class SolverError(ForearmError):
    """A factorisation or a solve failed, or would not fit in memory."""


class ReductionError(ForearmError):
    """The reduced model cannot be certified to the accuracy asked for."""


class DataError(ForearmError):
    """A measured or stored file cannot be read, or says too little to be trusted."""


class NotApplicable(DataError):
    """Request that means nothing for this run, e.g. a figure of a method that was not rendered."""


class HardwareError(ForearmError):
    """A measurement device is missing or misbehaves."""


class MissingExtra(ForearmError):
    """An optional package is needed; the message names the extra to install."""

    def __init__(self, package: str, extra: str, purpose: str) -> None:
        super().__init__(
            f"{purpose} needs the package '{package}'; install it with: python3 -m pip install 'forearm-fem[{extra}]'"
        )


def first_problem(problem: Any, whole: str) -> str:
    """Key (else ``whole``), fault and what came of a pydantic ValidationError; an unknown key comes first, as it causes
    others. Lists and tables are called what TOML calls them."""
    first = min(problem.errors(), key=lambda e: e["type"] != "extra_forbidden")
    said = "unknown key" if first["type"] == "extra_forbidden" else first["msg"].removeprefix("Value error, ")
    said = in_tomls_words(said)
    of_table = first["type"] == "value_error" and isinstance(first["input"], Mapping)  # what its values are together
    silent = first["type"] in ("extra_forbidden", "missing") or of_table or "got" in said
    given = "a table" if isinstance(first["input"], Mapping) else repr(first["input"])
    came = "" if silent else f", got {given if len(given) <= 60 else f'{given[:40]} ...'}"
    return f"{'.'.join(map(str, first['loc'])) or whole}: {said[0].lower()}{said[1:]}{came}"


def in_tomls_words(message: str) -> str:
    """``message`` of pydantic with lists and tables called what TOML calls them."""
    length = r"(?i:tuple|list) should have at (\w+) (\d+ items?) after validation, not .*"
    message = re.sub(length, r"expected a list of at \1 \2", message)
    return (
        re.sub(r"valid dictionary( or (object|instance of \w+)( to extract fields from)?)?", "table", message)
        .replace("valid tuple", "list")
        .replace("valid list", "list")
    )


def optional(module: str, extra: str, purpose: str, *, package: str = "") -> Any:
    """The ``module`` that ``purpose`` needs; MissingExtra names ``package`` and its ``extra`` where it is missing."""
    try:
        return import_module(module)
    except ImportError:
        raise MissingExtra(package or module, extra, purpose) from None


class AccuracyWarning(UserWarning):
    """A number is less accurate than asked for; the text reaches the report."""
