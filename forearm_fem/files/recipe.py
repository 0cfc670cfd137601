"""Import recipes: a TOML file that says how somebody's raw arrays become a G, so that no product code need know them.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError, model_validator
from scipy.fft import rfft, rfftfreq

from ..errors import DataError, first_problem
from ..scenario.base import Part, Positive
from ..scenario.model import read_toml
from ..transfer import TransferMatrix
from .arrays import Hdf5Reader, numbers_in
from .declaration import FOI, Declaration, Ports, declared_by, refuse_stand_in
from .reader import RawMatrix, Reader, understand

if TYPE_CHECKING:
    from ..scenario import Scenario

Numbers = NDArray[np.inexact[Any]]  # real or complex
AxisName = Annotated[str, Field(pattern=r"^[a-z_]+$")]


class ArrayRecipe(Part):
    """Raw numbers on disk: one array per file, the files stacked along a further axis."""

    files: Annotated[tuple[str, ...], Field(min_length=1, description="in the order of the stacked axis")]
    format: Literal["raw", "npy", "hdf5"] = "raw"
    variable: str | None = Field(default=None, description="of HDF5 files: the array, as group/name")
    dtype: str = Field(default="<f4", description="numpy's name of the number format, with byte order")
    shape: Annotated[tuple[int, ...] | None, Field(min_length=1)] = Field(
        default=None, description="of one file's array; npy and hdf5 files say it themselves"
    )
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
        if self.shape is None and self.format == "raw":
            raise ValueError("raw files need a shape")
        if (self.variable is None) == (self.format == "hdf5"):
            raise ValueError("variable names the array of HDF5 files, and of these alone")
        if self.shape is not None and len(self.shape) != len(self.axes):
            raise ValueError(f"shape has {len(self.shape)} axes, axes names {len(self.axes)}")
        if self.stack is None and len(self.files) > 1:
            raise ValueError("several files need a stack axis")
        names = [*self.axes, *([self.stack] if self.stack else [])]
        if unknown := set(self.select) - set(names):
            raise ValueError(f"select names {sorted(unknown)}, the axes are {names}")
        if len(set(names)) != len(names):
            raise ValueError(f"axes and stack name an axis twice: {names}")
        if self.format != "raw" and (idle := sorted(self.model_fields_set & {"dtype", "order", "skip"})):
            raise ValueError(
                f"{idle[0]} has no effect with format = '{self.format}': its files say it themselves; leave it out"
            )
        return self


class TimeRecipe(Part):
    """The array holds impulse responses: what their time axis means."""

    sample_rate: Positive
    zero: Annotated[int, Field(ge=0)] = Field(default=0, description="samples before time zero")
    per_sample: bool = Field(
        default=True,
        description="response to a unit impulse one sample long (the sum over samples is G); False: times dt",
    )
    length: Annotated[int, Field(ge=2)] | None = Field(
        default=None, description="samples to which the responses are filled up with zeros: closer frequencies"
    )


class JoinRecipe(Part):
    """Files that hold parts of one G."""

    files: str | tuple[str, ...] = Field(description="a pattern such as 'sweeps/*.tdms', or a list of files")
    entries: dict[str, tuple[str, str]] | None = Field(
        default=None, description="file -> [point, actuator], where names do not tell; else declaration.pattern"
    )


class ImportRecipe(Part):
    """Recipe of a data set: how to read it, its meaning and its source."""

    name: str
    source: str = Field(default="", description="citation; ends up in the provenance")
    array: ArrayRecipe | None = None
    join: JoinRecipe | None = None
    time: TimeRecipe | None = Field(default=None, description="given: the array is in time and is transformed")
    declaration: Declaration

    @model_validator(mode="after")
    def _one(self) -> Self:
        if (self.array is None) == (self.join is None):
            raise ValueError("expected either [array] (raw numbers) or [join] (files of known kinds)")
        if self.join is not None and self.time is not None:
            raise ValueError("[time] is of [array] alone")
        return self


Together = Callable[..., Any]


class RecipeReader(Reader):
    """G by a recipe, which holds all that is declared."""

    kind: ClassVar[str] = "a recipe"
    endings: ClassVar[tuple[str, ...]] = (".toml",)

    def read_with(
        self, file: Path, said: Declaration, ports: Ports | None, scenario: Scenario | None, together: Together
    ) -> TransferMatrix:
        """G by the recipe in ``file``; files to be joined are read ``together``."""
        recipe = load_recipe(file)
        if said != Declaration():
            raise DataError(f"{file}: describes itself; leave the declaration out")
        if recipe.join is None:
            return import_by_recipe(recipe, file.parent, ports)
        with declared_by("[declaration]"):
            made: TransferMatrix = together(
                _listed(file, recipe.join), recipe.declaration, ports, scenario, recipe.join.entries
            )
        return made


def _listed(recipe: Path, join: JoinRecipe) -> list[Path]:
    """Files of a recipe, which lie relative to it."""
    if isinstance(join.files, str):
        found = sorted(recipe.parent.glob(join.files))
        if not found:
            raise DataError(f"{recipe}: no file has such a name as join.files = '{join.files}'")
        return found
    return [recipe.parent / name for name in join.files]


def load_recipe(path: str | Path) -> ImportRecipe:
    """The recipe in a TOML file; DataError in one sentence for what is wrong with it."""
    file = Path(path)
    table = read_toml(file, "no such recipe", DataError)
    if not {"array", "join", "declaration"} & set(table):
        raise DataError(
            f"{file}: is no recipe of a G, it has neither [array] nor [join] nor [declaration]; name a file or folder "
            "that holds a G"
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
    array_recipe = recipe.array
    assert array_recipe is not None
    stack, arrays = array_recipe.stack, [_array(array_recipe, Path(folder) / name) for name in array_recipe.files]
    array, axes = arrays[0], list(array_recipe.axes)
    if stack is not None:
        if any(a.shape != array.shape for a in arrays):
            raise DataError(f"recipe '{recipe.name}': its files have different shapes, and cannot be stacked")
        array, axes = np.stack(arrays, axis=-1), [*axes, stack]
    array, axes = _selected(recipe.name, array_recipe, array, axes)
    domain = "frequency" if recipe.time is None else "time"
    if sorted(axes) != sorted((domain, "output", "input")):
        raise DataError(
            f"recipe '{recipe.name}': the axes left are {', '.join(axes)}, expected {domain}, output and input; select "
            "one index along every other axis"
        )
    ordered = np.transpose(array, [axes.index(a) for a in (domain, "output", "input")])
    values, frequency = ordered.astype(complex), None
    if (beside := recipe.declaration.frequency_file) is not None:
        if recipe.time is not None:
            raise DataError(f"recipe '{recipe.name}': frequency_file has no effect on responses in time; leave it out")
        frequency = numbers_in(Path(folder) / beside)
    elif recipe.time is not None:
        values, frequency = _transformed(recipe.name, ordered, recipe.time)
    raw = RawMatrix(
        recipe.name,
        values,
        frequency,
        FOI,
        spectrum=None if recipe.time is None else "one-sided",
        sign=None if recipe.time is None else "+iwt",
        provenance={"recipe": recipe.name, "cite": recipe.source},
    )
    with declared_by("[declaration]"):
        _refuse_idle(recipe)
        return understand(raw, recipe.declaration, ports)


def _refuse_idle(recipe: ImportRecipe) -> None:
    """DataError for what a recipe declares and [array] says in another place."""
    said = recipe.declaration
    if said.frequency_variable is not None:
        raise DataError(
            f"recipe '{recipe.name}': frequency_variable has no effect, as its arrays have no names; give "
            "frequency_file"
        )
    known = recipe.time is not None or said.frequency_file is not None
    if known and said.sample_rate is not None:
        raise DataError(
            f"recipe '{recipe.name}': says that itself, so that sample_rate has no effect; leave it out of the "
            "declaration"
        )
    for key in ("variable", "imaginary_variable", "valid_variable", "direction", "estimator", "pattern", "axes"):
        if getattr(said, key) is not None:
            raise DataError(f"recipe '{recipe.name}': {key} has no effect on its arrays; leave it out")


def _transformed(name: str, ordered: Numbers, time: TimeRecipe) -> tuple[Any, Any]:
    """One-sided spectra of responses (n, output, input), phases referred to the sample ``zero``, and frequencies."""
    if np.iscomplexobj(ordered):
        raise DataError(
            f"recipe '{name}': the responses in time are complex; leave [time] out for spectra, or correct array.dtype"
        )
    n = len(ordered) if time.length is None else time.length
    if time.zero >= len(ordered):
        raise DataError(f"time.zero = {time.zero} lies outside the {len(ordered)} samples of the responses")
    if n < len(ordered):
        raise DataError(
            f"time.length = {n} is less than the {len(ordered)} samples of the responses; nothing is cut off"
        )
    filled = np.concatenate([ordered, np.zeros((n - len(ordered), *ordered.shape[1:]))])
    values = rfft(np.roll(filled, -time.zero, axis=0), axis=0)
    return values if time.per_sample else values / time.sample_rate, rfftfreq(n, 1 / time.sample_rate)


def _array(recipe: ArrayRecipe, file: Path) -> Numbers:
    if not file.is_file():
        raise DataError(f"{file}: no such file; the recipe expects it here")
    refuse_stand_in(file)
    try:
        if recipe.format == "npy":
            numbers = np.load(file, allow_pickle=False)
        elif recipe.format == "hdf5":
            found = Hdf5Reader().variables(file)
            if recipe.variable not in found:
                raise DataError(f"{file}: has no array '{recipe.variable}'; it has {', '.join(found)[:120]}")
            numbers = found[str(recipe.variable)]
        else:
            content = file.read_bytes()[recipe.skip :]
            if len(content) % np.dtype(recipe.dtype).itemsize:
                raise ValueError(f"{len(content)} bytes are no whole number of items")
            numbers = np.frombuffer(content, dtype=recipe.dtype)
        if numbers.dtype.kind not in "fciu":
            raise ValueError(f"{numbers.dtype} holds no numbers")
    except (ValueError, TypeError, EOFError, ZeroDivisionError) as problem:
        kind = f"raw {recipe.dtype}" if recipe.format == "raw" else recipe.format
        raise DataError(f"{file}: cannot be read as {kind}: {problem}") from None
    if recipe.shape is None:
        if numbers.ndim != len(recipe.axes):
            raise DataError(
                f"{file}: has {numbers.ndim} axes of lengths {list(numbers.shape)}, array.axes names {len(recipe.axes)}"
            )
        return np.asarray(numbers.astype(complex if np.iscomplexobj(numbers) else float))
    expected = int(np.prod(recipe.shape))
    if numbers.size != expected:
        raise DataError(
            f"{file}: holds {numbers.size} numbers, the recipe's shape {list(recipe.shape)} needs {expected}; the file "
            "is cut short, or shape, dtype or skip are wrong"
        )
    if recipe.format != "raw" and numbers.shape != recipe.shape:
        raise DataError(
            f"{file}: has the shape {list(numbers.shape)}, array.shape says {list(recipe.shape)}; correct shape and "
            "axes, for such a file keeps its own"
        )
    plain = numbers.reshape(recipe.shape, order=recipe.order) if recipe.format == "raw" else numbers
    return np.asarray(plain.astype(complex if np.iscomplexobj(plain) else float))


def _selected(name_of: str, recipe: ArrayRecipe, array: Numbers, axes: list[str]) -> tuple[Numbers, list[str]]:
    """Indices taken; an axis of which one index is left, and which is no axis of G, disappears."""
    for name, wanted in recipe.select.items():
        at = axes.index(name)
        if min(wanted) < 1 or max(wanted) > array.shape[at]:
            raise DataError(
                f"recipe '{name_of}': select.{name} counts from 1 to {array.shape[at]}, got {list(wanted)}"
            )
        array = np.take(array, np.array(wanted) - 1, axis=at)
    extra = [k for k, a in enumerate(axes) if a not in ("time", "frequency", "output", "input") and array.shape[k] == 1]
    return np.squeeze(array, axis=tuple(extra)), [a for k, a in enumerate(axes) if k not in extra]
