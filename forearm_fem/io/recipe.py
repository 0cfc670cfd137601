"""Import recipes: a TOML file that says how somebody's raw arrays become a G, so that no product code need know them.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError, model_validator
from scipy.fft import rfft, rfftfreq

from ..errors import DataError, first_problem
from ..scenario.base import Part, Positive
from ..scenario.toml import read_toml
from ..transfer import TransferMatrix
from .declaration import Declaration, Ports, RawMatrix, declared_by, understand

Numbers = NDArray[np.inexact[Any]]  # real or complex
AxisName = Annotated[str, Field(pattern=r"^[a-z_]+$")]


class ArrayRecipe(Part):
    """Raw numbers on disk: one array per file, the files stacked along a further axis."""

    files: Annotated[tuple[str, ...], Field(min_length=1, description="in the order of the stacked axis")]
    format: Literal["raw", "npy"] = "raw"
    dtype: str = Field(default="<f4", description="numpy's name of the number format, with byte order")
    shape: Annotated[tuple[int, ...], Field(min_length=1)]
    order: Literal["C", "F"] = Field(default="C", description="F: the first index runs fastest (MATLAB, Fortran)")
    skip: Annotated[int, Field(ge=0)] = Field(default=0, description="bytes before the numbers")
    axes: tuple[AxisName, ...] = Field(
        description="names of the array's axes; 'time' or 'frequency', 'output', 'input'"
    )
    stack: AxisName | None = Field(default=None, description="axis along which the files are stacked, e.g. 'input'")
    select: dict[str, Annotated[tuple[int, ...], Field(min_length=1)]] = Field(
        default_factory=dict, description="indices to take along an axis, counted from 1, in the order wanted"
    )

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if len(self.shape) != len(self.axes):
            raise ValueError(f"shape has {len(self.shape)} axes, axes names {len(self.axes)}")
        if self.stack is None and len(self.files) > 1:
            raise ValueError("several files need a stack axis")
        names = [*self.axes, *([self.stack] if self.stack else [])]
        if unknown := set(self.select) - set(names):
            raise ValueError(f"select names {sorted(unknown)}, the axes are {names}")
        if len(set(names)) != len(names):
            raise ValueError(f"axes and stack name an axis twice: {names}")
        if self.format == "npy" and (idle := sorted(self.model_fields_set & {"dtype", "order", "skip"})):
            raise ValueError(f"{idle[0]} has no effect with format = 'npy': its files say it themselves; leave it out")
        return self


class TimeRecipe(Part):
    """The array holds impulse responses: what their time axis means."""

    sample_rate: Positive
    zero: Annotated[int, Field(ge=0)] = Field(default=0, description="samples before time zero")
    per_sample: bool = Field(
        default=True,
        description="response to a unit impulse one sample long (the sum over samples is G); False: times dt",
    )


class ImportRecipe(Part):
    """How to read a data set, what it means, and where it comes from."""

    name: str
    source: str = Field(default="", description="citation; ends up in the provenance")
    array: ArrayRecipe
    time: TimeRecipe | None = Field(default=None, description="given: the array is in time and is transformed")
    declaration: Declaration


def load_recipe(path: str | Path) -> ImportRecipe:
    """The recipe in a TOML file; DataError in one sentence for what is wrong with it."""
    file = Path(path)
    table = read_toml(file, "no such recipe", DataError)
    if not {"array", "declaration"} & set(table):
        raise DataError(
            f"{file}: is no recipe of a G, it has neither [array] nor [declaration]; name a file or folder that holds "
            "a G"
        )
    try:
        return ImportRecipe.model_validate(table)
    except ValidationError as problem:
        raise DataError(f"{file}: {first_problem(problem, 'recipe')}") from None


def import_by_recipe(recipe: ImportRecipe, folder: str | Path, ports: Ports | None = None) -> TransferMatrix:
    """G from the recipe's files in ``folder``; DataError for missing, short or contradictory ones.

    ``ports`` (outputs, inputs) serve where the recipe declares no places. An array in time is real, and its transform
    here is e^{+i omega t}; one in frequency keeps its imaginary part.
    """
    stack, arrays = recipe.array.stack, [_array(recipe.array, Path(folder) / name) for name in recipe.array.files]
    array, axes = arrays[0], list(recipe.array.axes)
    if stack is not None:
        array, axes = np.stack(arrays, axis=-1), [*axes, stack]
    array, axes = _selected(recipe, array, axes)
    domain = "frequency" if recipe.time is None else "time"
    if sorted(axes) != sorted((domain, "output", "input")):
        raise DataError(
            f"recipe '{recipe.name}': the axes left are {', '.join(axes)}, expected {domain}, output and input; select "
            "one index along every other axis"
        )
    ordered = np.transpose(array, [axes.index(a) for a in (domain, "output", "input")])
    values, frequency = ordered.astype(complex), None
    if (time := recipe.time) is not None:  # one-sided, phases referred to the sample ``zero``
        if np.iscomplexobj(ordered):
            raise DataError(
                f"recipe '{recipe.name}': the responses in time are complex; leave [time] out for spectra, or correct "
                "array.dtype"
            )
        if time.zero >= len(ordered):
            raise DataError(f"time.zero = {time.zero} lies outside the {len(ordered)} samples of the responses")
        values = rfft(np.roll(ordered, -time.zero, axis=0), axis=0)
        values = values if time.per_sample else values / time.sample_rate
        frequency = rfftfreq(len(ordered), 1 / time.sample_rate)
    raw = RawMatrix(
        recipe.name,
        values,
        frequency,
        ("frequency", "output", "input"),
        spectrum=None if recipe.time is None else "one-sided",
        sign=None if recipe.time is None else "+iwt",
        provenance={"recipe": recipe.name, "cite": recipe.source},
    )
    with declared_by("[declaration]"):
        return understand(raw, recipe.declaration, ports)


def _array(recipe: ArrayRecipe, file: Path) -> Numbers:
    if not file.is_file():
        raise DataError(f"{file}: no such file; the recipe expects it here")
    try:
        if recipe.format == "npy":
            numbers = np.load(file, allow_pickle=False)
        else:
            content = file.read_bytes()[recipe.skip :]
            if len(content) % np.dtype(recipe.dtype).itemsize:
                raise ValueError(f"{len(content)} bytes are no whole number of items")
            numbers = np.frombuffer(content, dtype=recipe.dtype)
        if numbers.dtype.kind not in "fciu":
            raise ValueError(f"{numbers.dtype} holds no numbers")
    except (ValueError, TypeError, EOFError, ZeroDivisionError) as problem:
        kind = "npy" if recipe.format == "npy" else f"raw {recipe.dtype}"
        raise DataError(f"{file}: cannot be read as {kind}: {problem}") from None
    expected = int(np.prod(recipe.shape))
    if numbers.size != expected:
        raise DataError(
            f"{file}: holds {numbers.size} numbers, the recipe's shape {list(recipe.shape)} needs {expected}; the file "
            "is cut short, or shape, dtype or skip are wrong"
        )
    if recipe.format == "npy" and numbers.shape != recipe.shape:
        raise DataError(
            f"{file}: has the shape {list(numbers.shape)}, array.shape says {list(recipe.shape)}; correct shape and "
            "axes, for an npy file keeps its own"
        )
    plain = numbers.reshape(recipe.shape, order=recipe.order) if recipe.format == "raw" else numbers
    return np.asarray(plain.astype(complex if np.iscomplexobj(plain) else float))


def _selected(recipe: ImportRecipe, array: Numbers, axes: list[str]) -> tuple[Numbers, list[str]]:
    """Indices taken; an axis of which one index is left, and which is no axis of G, disappears."""
    for name, wanted in recipe.array.select.items():
        at = axes.index(name)
        if min(wanted) < 1 or max(wanted) > array.shape[at]:
            raise DataError(
                f"recipe '{recipe.name}': select.{name} counts from 1 to {array.shape[at]}, got {list(wanted)}"
            )
        array = np.take(array, np.array(wanted) - 1, axis=at)
    extra = [k for k, a in enumerate(axes) if a not in ("time", "frequency", "output", "input") and array.shape[k] == 1]
    return np.squeeze(array, axis=tuple(extra)), [a for k, a in enumerate(axes) if k not in extra]
