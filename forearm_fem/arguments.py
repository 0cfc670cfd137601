"""What a public function is given, made what its signature says, or refused in one sentence.

A list becomes an array, 4.0 an index; text for a number, a row of another length than its neighbours, a complex number
where a real one is asked for, or a thing of another kind is a DataError that names function, argument and what came.
Shapes and ranges are the functions' own to check.
"""

from __future__ import annotations

import typing
from collections.abc import Callable, Sequence
from functools import cache, wraps
from inspect import signature
from types import NoneType, UnionType
from typing import Any, ParamSpec, TypeVar

import numpy as np

from .errors import DataError
from .typing import BoolArray, ComplexArray, FloatArray, IntArray

__all__ = ["checked"]

P = ParamSpec("P")
T = TypeVar("T")
Convert = Callable[[Any], Any]

_ARRAYS: tuple[tuple[Any, type, str, str], ...] = (  # annotation, kind of number, dtypes that serve, words
    (FloatArray, float, "fiu", "an array of real numbers"),
    (ComplexArray, complex, "cfiu", "an array of numbers"),
    (BoolArray, bool, "b", "an array of true and false"),
    (IntArray, int, "iu", "an array of whole numbers"),
)


def checked(function: Callable[P, T]) -> Callable[P, T]:
    """``function`` with its arguments as its signature has them; DataError for one that cannot be made so.

    Looked at are arrays, numbers, text, the package's own classes and lists of these, each also as ``| None``; all else
    passes as it comes, such as renderers.
    """

    @wraps(function)
    def bordered(*args: P.args, **kwargs: P.kwargs) -> T:
        """``function`` behind its rules."""
        names, rules = _rules(function)
        told = [rules[n](a) if n in rules else a for n, a in zip(names, args, strict=False)]
        named = {n: rules[n](a) if n in rules else a for n, a in kwargs.items()}
        return function(*told, *args[len(names) :], **named)  # type: ignore[arg-type]

    return bordered


@cache
def _rules(function: Callable[..., Any]) -> tuple[tuple[str, ...], dict[str, Convert]]:
    """Names of the arguments that may come by position, and what to do with each that is looked at."""
    hints = typing.get_type_hints(function)
    parameters = signature(function).parameters
    found = {n: _rule(f"{function.__name__}: {n}", hints[n]) for n in parameters if n in hints}
    positional = tuple(n for n, p in parameters.items() if p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD))
    return positional, {n: rule for n, rule in found.items() if rule is not None}


def _rule(where: str, hint: Any) -> Convert | None:
    """What makes a value one of ``hint``; None where that is not looked at."""
    union = typing.get_origin(hint) in (typing.Union, UnionType)
    options = [o for o in (typing.get_args(hint) if union else (hint,)) if o is not NoneType]
    optional = union and NoneType in typing.get_args(hint)
    if len(options) == 1 and (element := _element(options[0])) is not None:
        return _list_of(where, element, optional)
    arrays = [a for a in _ARRAYS if a[0] in options]
    plain = (o for o in options if isinstance(o, type) and typing.get_origin(o) is None)
    classes = tuple(o for o in plain if not getattr(o, "_is_protocol", False))
    if bool in classes or len(arrays) + len(classes) < len(options):
        return None
    words = [a[3] for a in arrays] + [_WORDS.get(c, f"a {c.__name__}") for c in classes]
    expected = " or ".join(words) + (" or None" if optional else "")

    def convert(value: Any) -> Any:
        """The ``value`` as the first of the options that it can be made; DataError where it can be none."""
        if value is None and optional:
            return None
        if classes and isinstance(value, classes) and not isinstance(value, bool):
            return value
        for kind in (int, float):
            if kind in classes and (number := _number(value, kind)) is not None:
                return number
        for _, number_type, dtypes, _ in arrays:
            if (array := _array(value, number_type, dtypes)) is not None:
                return array
        raise DataError(f"{where}: expected {expected}, got {_came(value)}")

    return convert


def _came(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return f"an array {value.shape} of {value.dtype}"
    plain = isinstance(value, str | int | float | complex | list | tuple)
    return repr(value)[:60] if plain else f"a {type(value).__name__}"


def _element(hint: Any) -> type | None:
    """The class of what a list of one kind holds; None where it is no such list, or holds what is not looked at."""
    inner = [a for a in typing.get_args(hint) if a is not Ellipsis]
    listed = typing.get_origin(hint) in (tuple, Sequence) and len(inner) == 1
    known = listed and isinstance(inner[0], type) and typing.get_origin(inner[0]) is None
    return inner[0] if known and not getattr(inner[0], "_is_protocol", False) and inner[0] is not float else None


def _list_of(where: str, element: type, optional: bool) -> Convert:
    """What passes lists of one ``element`` as they are."""
    expected = ("a list of names" if element is str else f"a list of {element.__name__}") + " or None" * optional

    def convert(value: Any) -> Any:
        """The ``value`` itself; DataError where it is no such list."""
        if value is None and optional:
            return None
        listed = isinstance(value, Sequence | np.ndarray) and not isinstance(value, bytes)
        if not listed or not all(isinstance(v, element) for v in value):
            raise DataError(f"{where}: expected {expected}, got {_came(value)}")
        return value

    return convert


_WORDS: dict[Any, str] = {int: "a whole number", float: "a number", str: "text"}


def _number(value: Any, kind: type) -> Any:
    """A number of ``kind``, None for what is none."""
    value = value.item() if isinstance(value, np.ndarray) and value.ndim == 0 else value
    if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    return number if kind is float else int(number) if number.is_integer() else None


def _array(value: Any, kind: type, dtypes: str) -> Any:
    """An array of ``kind``, masked entries as NaN; None for what is none of ``dtypes``."""
    if isinstance(value, np.ma.MaskedArray):
        value = np.ma.filled(value.astype(kind), np.nan) if kind in (float, complex) else None
    try:
        array = np.asarray(value)
    except ValueError:  # rows of different lengths
        return None
    if array.dtype.kind not in dtypes and array.size:
        return None
    return np.asarray(array, dtype=kind)
