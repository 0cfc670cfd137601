"""The whole scenario: one frozen object from which everything follows, and its reading from TOML and ``--set``."""

from __future__ import annotations

import functools
import hashlib
import json
import math
import re
import tomllib
from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, ModelWrapValidatorHandler, TypeAdapter, model_validator
from pydantic_core import PydanticCustomError

from ..errors import ForearmError, ScenarioError
from ..tissue import PRESETS, Tissue, TissueRecord, parameters_of, tissue_of
from ..usercode import with_code_beside
from .base import Name, Part, UserCode, Within, as_given, changed_keys, copied, idle, put, remade, units_of
from .device import Device, Grid, GridRows, VoltageRows
from .limb import (
    AnySupports,
    CylinderLimb,
    Element,
    ForearmLimb,
    FreeUnderside,
    LibraryPatch,
    Limb,
    MeshLimb,
    MeshOptions,
    SlabLimb,
    TissueOverride,
    Tissues,
    forearm_length,
    has_bone,
    layer_tissues,
    limb_tissues,
    tissue_keys,
)
from .measurement import MeasurementOptions
from .rendering import RenderingOptions
from .sweep import Band, ReducedSolve, Solver, Sweep

# Accuracy of a slab under pressure discs; at 0.1 second order does in half the time (decision 0002). Under rigid
# ones it pays always: rims of small cones left 5 % of their receptance to second order.
_THIRD_ORDER_PAYS = 0.05
# [m] from the rim of a disc of pressure: nearer points err alike on two meshes of second order, and as little as a
# tenth of their error was stated; 9.5 mm away no frequency stated less than 0.7 of it (decision 0015).
_BESIDE = 8e-3


_ELEMENTS_ONLY = ("mesh", "supports", "solver", "limb.length", "limb.width", "limb.depth", "limb.symmetry",
                  "limb.circumference", "limb.aspect", "limb.diameter", "limb.bones")  # fmt: skip


def for_elements_only(key: str) -> bool:
    """True if finite elements alone read the dotted ``key``: the layered model has flat, endless layers and no mesh."""
    return key != "solver.memory_limit" and any(f"{key}.".startswith(f"{part}.") for part in _ELEMENTS_ONLY)


class Scenario(Part):
    """A limb, its tissues, a device, a sweep and what to render; SI units throughout.

    Frozen: :meth:`changed` makes another one, checked like a file's. A key that would have no effect is refused.
    ``engine`` is a switch on the same scenario: what finite elements alone read stays for them, see
    :func:`.for_elements_only`.
    """

    schema_version: Literal[2] = Field(2, description="of this file's format; only 2 is known")
    name: Name = Field("scenario", description="letters, digits, dot, dash, underscore; results go to results/NAME")
    description: str = Field("", description="a sentence for the report")
    engine: Literal["fem", "layered"] | UserCode = Field(
        "fem",
        description="finite elements, or the semi-analytic layered model, which reads neither mesh nor supports; your "
        "own as module:Name of a file beside the scenario",
    )
    accuracy: Annotated[float, Within(1e-5, 0.5)] = Field(
        0.05, description="asked e_band of G; sets mesh sizes, truncation and reduction where left out"
    )
    limb: Limb = ForearmLimb()
    tissues: Tissues = Tissues()
    supports: AnySupports = FreeUnderside()
    device: Device = VoltageRows()
    grid: Grid = GridRows()
    sweep: Sweep = Band()
    mesh: MeshOptions = MeshOptions()
    solver: Solver = ReducedSolve()
    rendering: RenderingOptions = RenderingOptions()
    library: LibraryPatch = LibraryPatch()
    measurement: MeasurementOptions = MeasurementOptions()

    def changed(self, changes: Mapping[str, Any]) -> Self:
        """A checked copy with ``changes`` by dotted key: ``scenario.changed({"device.spacing": 0.04})``.

        As if the file had said so: what was left out follows anew, and None leaves a key out. Keys that the changes
        leave without effect fall away, such as ``device.spacing`` where ``device.contacts`` are set. ScenarioError for
        what a file would be refused.
        """
        table = self.model_dump(exclude_unset=True)
        for key in changes:  # an entry of a list that was left out
            before, _, _ = re.sub(r"\.\d+(?=\.|$)", "\0", key).partition("\0")
            if before != key:
                put(table, before, functools.reduce(getattr, before.split("."), self), key)
        return remade(TypeAdapter(type(self)), table, changes, "scenario")

    @property
    def digest(self) -> str:
        """SHA-256 of all keys but ``name`` and ``description``, defaults included; files count by their names."""
        keys = self.model_dump(mode="json", exclude={"name", "description"})
        return hashlib.sha256(json.dumps(keys, sort_keys=True).encode()).hexdigest()

    def changed_keys(self) -> tuple[str, ...]:
        """Dotted keys whose values are not their defaults; lists and free tables count as one key each."""
        usual = type(self)()
        forearm = type(self)(accuracy=self.accuracy).limb if isinstance(self.limb, ForearmLimb) else None
        limb = (key for key in changed_keys(self.limb, forearm, "limb.") if key != "limb.shape")
        rest = [key for key in changed_keys(self, usual) if not key.startswith("limb.")]
        return (*rest, *limb)

    @model_validator(mode="wrap")
    @classmethod
    def _settled(cls, data: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        """Scenario with defaults filled in, which count as left out: a limb without a shape is a forearm,
        ``accuracy`` sets a length left out, an actuator brings its own keys."""
        if not isinstance(data, Mapping):
            return handler(data)
        _refuse_version(data)
        made = handler(_with_limb(data, cls.model_fields["accuracy"].default))
        as_given(made, data)
        return made

    @model_validator(mode="after")
    def _no_idle_key(self) -> Self:
        limb, usual = self.limb, MeshOptions()
        sizes = [k for k in ("size_grid", "size_far", "grading") if getattr(self.mesh, k) != getattr(usual, k)]
        if isinstance(limb, MeshLimb) and sizes:
            raise idle([f"mesh.{key}" for key in sizes], "limb.shape = 'mesh' keeps the file's elements, and refines "
                       "them only at contacts (mesh.size_contact); leave it out")  # fmt: skip
        if isinstance(limb, SlabLimb) and self.grid.direction == "vertical":
            raise idle(["grid.direction"], "a slab's normal is vertical; leave it out")
        if isinstance(limb, SlabLimb) and self.supports.underside != "free":
            raise idle(["supports.underside"], "a slab's bottom is a cut end (supports.ends); leave it out")
        tissues, layers = limb_tissues(limb), layer_tissues(limb)
        if unknown := sorted(set(self.mesh.sublayers) - layers):
            raise idle([f"mesh.sublayers.{name}" for name in unknown], "the limb has no such layer; leave it out")
        if self.supports.bone == "elastic" and not has_bone(limb):
            raise idle(["supports.bone"], "the limb has no bone; leave it out, or give it one")
        met = (tissues - {"bone"}) | ({"bone"} if self.supports.bone == "elastic" else set())
        if unknown := sorted(set(self.tissues.override) - met):
            raise idle([f"tissues.override.{name}" for name in unknown], "no wave passes through this tissue in this "
                       "limb; leave it out, or name it in a layer")  # fmt: skip
        return self

    @property
    def element(self) -> Element:
        """The element pair: that of ``mesh``, or what suits the limb."""
        if self.mesh.element != "auto":
            return self.mesh.element
        if isinstance(self.limb, SlabLimb):  # sizes given were given for P2
            asks = self.accuracy <= _THIRD_ORDER_PAYS or self.device.cone.contact != "pressure" or self.beside_discs
            return "P2/P3" if self.mesh.size_grid is None and asks else "P2"
        return "P2/P3" if isinstance(self.limb, ForearmLimb | CylinderLimb) else "P2"

    @property
    def beside_discs(self) -> tuple[str, ...]:
        """Names of the points less than 8 mm from the rim of a disc of pressure; none under rigid cones."""
        device = self.device
        if device.cone.contact != "pressure":
            return ()
        reach = device.cone.radius + _BESIDE
        gaps = (min(math.dist(place, centre) for centre in device.centres) for place in self.grid.places)
        return tuple(str(i) for i, gap in enumerate(gaps, start=1) if gap < reach)

    @property
    def tissue_keys(self) -> dict[str, str]:
        """Dotted key -> tissue named there, for any shape of the limb."""
        return tissue_keys(self.limb)

    @property
    def reduction_tolerance(self) -> float:
        """e(f) that a reduced model may cost [-]: a hundredth of the accuracy asked for."""
        return self.accuracy / 100

    @model_validator(mode="after")
    def _targets_exist(self) -> Self:
        names = {str(i + 1) for i in range(len(self.grid.places))}
        wanted = set() if self.rendering.targets == "all" else set(self.rendering.targets)
        zeros = self.rendering.zeros if isinstance(self.rendering.zeros, tuple) else ()
        if unknown := (wanted | set(zeros)) - names:
            raise ValueError(f"rendering names the points {sorted(unknown)}, but the grid has 1..{len(names)}")
        holding = {"inverse filter", "combination"} & set(self.rendering.methods)
        if self.rendering.targets == "all" and zeros and holding:
            raise ValueError(
                f"rendering.zeros names point {zeros[0]}, but targets = 'all' aims at it, too; name the targets"
            )
        window, half = self.rendering.window, self.sweep.duration / 2
        if not isinstance(window, str) and not (-half <= window[0] and window[1] <= half):
            raise ValueError(f"rendering.window {list(window)} s reaches beyond the record of {-half:g} to {half:g} s")
        if not isinstance(window, str) and not _holds_a_sample(window, self.sweep):
            raise ValueError(
                f"rendering.window {list(window)} s holds no sample of {self.sweep.sample_rate:g} Hz; widen it"
            )
        return self

    @model_validator(mode="after")
    def _something_moves(self) -> Self:
        if len(set(self.device.out_of_contact)) == len(self.device.centres):
            raise ValueError("device.out_of_contact names every actuator: nothing would move; leave one in contact")
        return self


def _with_limb(data: Mapping[str, Any], accuracy: float) -> Mapping[str, Any]:
    limb, accuracy = data.get("limb", {}), data.get("accuracy", accuracy)
    if not isinstance(limb, Mapping):
        return data
    limb = {"shape": "forearm", **limb}
    if limb["shape"] == "forearm" and isinstance(accuracy, int | float) and 0 < accuracy < 1:  # else refused below
        limb = {"length": forearm_length(accuracy), **limb}
    return {**data, "limb": limb}


def _refuse_version(data: Mapping[str, Any]) -> None:
    """One sentence for a scenario of before version 1.0, with the keys in it that are called otherwise now."""
    if data.get("schema_version") != 1:
        return
    table = data.get("tissues")
    override = table.get("override") if isinstance(table, Mapping) else None
    laws = [f"tissues.override.{k}" for k, v in (override or {}).items() if isinstance(v, Mapping) and "model" in v]
    renamed = "".join(f"; {key}.model is called {key}.law" for key in laws)
    raise PydanticCustomError(
        "choice", "{said}",
        {"key": "schema_version", "said": "1 is the format of before version 1.0; write 2 and leave out keys without "
         f"effect, which are refused by name{renamed}"},
    )  # fmt: skip


def _holds_a_sample(window: tuple[float, float], sweep: Sweep) -> bool:
    """True if a sample k / sample_rate of the record, whose t = 0 is its middle, lies in ``window`` [s]."""
    last = math.ceil(round(sweep.duration * sweep.sample_rate) / 2) - 1
    return min(math.floor(window[1] * sweep.sample_rate + 1e-9), last) >= math.ceil(
        window[0] * sweep.sample_rate - 1e-9
    )

# Reading TOML files: whatever is wrong with one is a sentence.

_BACKSLASH = "within double quotes \\ begins an escape: write paths with /, or in single quotes"


def _line(file: Path, problem: Exception) -> str:
    """The line of ``file`` that a ``problem`` names; all of it where it names none."""
    lines = file.read_text(encoding="utf-8-sig").splitlines()
    named = re.search(r"at line (\d+)", str(problem))
    return "\n".join(lines) if named is None else "".join(lines[int(named[1]) - 1 : int(named[1])])


def read_toml(file: Path, missing: str, error: type[ForearmError] = ScenarioError) -> dict[str, Any]:
    """The table in ``file``, user code beside it named in full (:mod:`forearm_fem.usercode`).

    ``error`` with the sentence ``missing`` where there is no file, or with why it cannot be read.
    """
    if file.is_dir():
        raise error(f"{file}: is a folder, expected a TOML file")
    try:
        table = tomllib.loads(file.read_text(encoding="utf-8-sig"))
    except FileNotFoundError:
        raise error(f"{file}: {missing}") from None
    except (OSError, UnicodeDecodeError) as problem:
        raise error(f"{file}: cannot be read as a text file ({problem})") from None
    except RecursionError:
        raise error(f"{file}: not valid TOML: nested too deeply") from None
    except tomllib.TOMLDecodeError as problem:
        more = f"; {_BACKSLASH}" if "\\" in _line(file, problem) else ""
        raise error(f"{file}: not valid TOML: {problem}{more}") from None
    except ValueError:  # Python reads no more
        raise error(f"{file}: a number has more than 4300 digits") from None
    beside: dict[str, Any] = with_code_beside(table, file.parent)
    return beside


# Files: scenarios that come with the program, and what a scenario names.

_PACKAGE = Path(__file__).resolve().parents[1]


def shipped_folder(kind: str) -> Path:
    """Folder of the "scenarios" or "meshes" that come with the program: inside a wheel, else beside the package."""
    inside = _PACKAGE / "_data" / kind
    return inside if inside.is_dir() else _PACKAGE.parent / kind


def shipped_scenarios() -> tuple[str, ...]:
    """Names of the scenarios that come with the program, e.g. "thesis"."""
    return tuple(sorted(file.stem for file in shipped_folder("scenarios").glob("*.toml")))


def scenario_file(given: str | Path) -> Path:
    """``given`` where it is a file or looks like one, else the file of the shipped scenario of that name."""
    file = Path(given)
    if file.is_file() or file.suffix or len(file.parts) != 1 or file.name not in shipped_scenarios():
        return file
    return shipped_folder("scenarios") / f"{file.name}.toml"


def scenario_beside(folder: Path, named: str) -> Path:
    """The scenario that a file in ``folder`` names: the file there, else the shipped scenario of that name."""
    beside = folder / named
    if beside.is_file() or named not in shipped_scenarios():
        return beside
    return shipped_folder("scenarios") / f"{named}.toml"
_SCENARIO = TypeAdapter(Scenario)


def load_scenario(path: str | Path, *, overrides: Sequence[str] = ()) -> Scenario:
    """Scenario from a TOML file, or from one that comes with the program by its name, e.g. "thesis".

    ``overrides`` are ``key.path=value``: TOML, or a number with its unit (``device.spacing=40mm``). Keys of the file
    that they leave without effect fall away. Files that a scenario names are seen from the folder of
    :func:`scenario_file`. Raises :class:`ScenarioError` for a missing or malformed file and for unknown or impossible
    keys.
    """
    if not isinstance(path, str | Path):
        raise ScenarioError(
            f"expected a scenario's file or name, got a {type(path).__name__}; parse_scenario takes tables"
        )
    file = scenario_file(path)
    known = shipped_scenarios()
    meant = "".join(f"; did you mean {name}?" for name in get_close_matches(str(path), known, 1))
    table = read_toml(file, f"no such file{meant}; by name there are {', '.join(known)}")
    if "scenario" in table:
        raise ScenarioError(
            f"{file}: names a scenario, so it is a file for `forearm-fem design`, `campaign` or `study`; give it to "
            "that command, or give the scenario here"
        )
    return remade(_SCENARIO, table, read_overrides(overrides), str(file), "--set ")


def parse_scenario(
    data: Mapping[str, Any], *, origin: str = "scenario", changes: Mapping[str, Any] | None = None
) -> Scenario:
    """Scenario from plain data, with ``changes`` by dotted key; see :func:`load_scenario` for the errors."""
    return remade(_SCENARIO, data, changes or {}, origin)


def read_overrides(overrides: Sequence[str], option: str = "--set") -> dict[str, Any]:
    """Values by dotted key from ``key.path=value``: TOML, ".01", a number with a unit of the key's kind, or plain text.

    ScenarioError about the ``option`` where one is none.
    """
    if isinstance(overrides, str):  # whose letters would be taken for overrides
        raise ScenarioError(f"overrides: expected a list of texts, got the text '{overrides}'; put it into brackets")
    result: dict[str, Any] = {}
    for item in overrides:
        key, separator, text = item.partition("=")
        if not separator or not key.strip():
            example = "device.spacing=40mm" if option == "--set" else "unit='mm/V'"
            raise ScenarioError(f"{option} expects key.path=value, got '{item}'; e.g. {option} \"{example}\"")
        result[key.strip()] = _value(key.strip(), text.strip())
    return result


def apply_overrides(data: Mapping[str, Any], overrides: Sequence[str], option: str = "--set") -> dict[str, Any]:
    """A copy of ``data`` with each ``key.path=value`` put in place; see :func:`read_overrides`."""
    result: dict[str, Any] = copied(data)
    for key, value in read_overrides(overrides, option).items():
        put(result, key, value, f"{option} {key}")
    return result


_PREFIX = {"": 1.0, "n": 1e-9, "u": 1e-6, "µ": 1e-6, "m": 1e-3, "c": 1e-2, "k": 1e3, "M": 1e6, "G": 1e9}
_QUANTITY = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*([a-zA-Zµ][a-zA-Zµ0-9/^* ]*)")


def _value(key: str, text: str) -> Any:
    """``text`` as TOML, or in SI where it is a number with a unit and the ``key`` has that unit; else as it is."""
    value, unit = _toml_value(text), unit_of(key)
    if isinstance(value, str) and unit and (found := _QUANTITY.fullmatch(text)):
        number, given = found.groups()
        for prefix, factor in _PREFIX.items():
            if given == prefix + unit and unit != "kg":
                return float(f"{float(number) * factor:.15g}")
        if unit == "kg" and given in _MASS:
            return float(f"{float(number) * _MASS[given]:.15g}")
        if unit == "rad" and given == "deg":
            return math.radians(float(number))
        example = "0.04 or 40mm" if unit == "m" else f"5 or 5{unit}"
        raise ScenarioError(f"{key}: expected a number in {unit}, e.g. {example}, got '{text}'")
    return value


_MASS = {"kg": 1.0, "g": 1e-3, "mg": 1e-6}


@cache
def _units() -> dict[str, str]:
    return dict(units_of(Scenario.model_json_schema()))


def unit_of(key: str) -> str | None:
    """SI unit of the number under a dotted ``key``; None where it has none."""
    return _units().get(re.sub(r"^tissues\.override\.[^.]+", "tissues.override.*", key))


def _toml_value(text: str) -> Any:
    if re.fullmatch(r"[+-]?(\d+\.|\.\d+)(e[+-]?\d+)?", text.lower()):  # ".01" and "1.", which TOML has not
        return float(text)
    try:
        read = tomllib.loads(f"value = {text}")
        return read["value"] if len(read) == 1 else text
    except (ValueError, RecursionError):  # the first is also what numbers of thousands of digits raise
        return text


def resolve_tissues(scenario: Scenario) -> Mapping[str, Tissue]:
    """The scenario's tissues by name: its preset with the overrides applied, bone included.

    Raises :class:`ScenarioError`, with the key's path, for an incomplete new tissue, for a value that
    would have no effect, and for a limb that names a tissue which does not exist.
    """
    records = PRESETS[scenario.tissues.preset]
    tissues = {name: record.tissue() for name, record in records.items()}
    changed = {
        name: _overridden(name, records.get(name), override) for name, override in scenario.tissues.override.items()
    }
    result = {**tissues, **changed}
    for path, name in scenario.tissue_keys.items():
        if name not in result:
            raise ScenarioError(
                f"{path}: no tissue is called '{name}'; known are {', '.join(sorted(result))}, "
                f"or define it under [tissues.override.{name}]"
            )
    return result


def _overridden(name: str, record: TissueRecord | None, override: TissueOverride) -> Tissue:
    """Preset with single values replaced; a change of model keeps only density and bulk modulus."""
    path = f"tissues.override.{name}"
    stated = {**override.model_dump(exclude={"law", "parameters"}, exclude_none=True), **override.parameters}
    given = {key: math.inf if value == "incompressible" else float(value) for key, value in stated.items()}
    model = override.law or (record.model if record else "kelvin-voigt")
    kept = dict(record.values) if record else {}
    if record and model != record.model:
        kept = {key: kept[key] for key in ("density", "bulk")}
    needed, taken = parameters_of(model)
    for key in given:
        if key not in {"density", "bulk", "fibres", *taken}:
            raise ScenarioError(f"{path}.{key}: has no effect with the {model} law; remove it or set {path}.law")
    v = {**kept, **given}
    if missing := [key for key in ("density", "bulk", *needed) if key not in v]:
        raise ScenarioError(f"{path}: a {model} tissue stated anew also needs {', '.join(missing)}")
    found = tissue_of(name, model, v)
    if found.modulus.problem:
        raise ScenarioError(f"{path}.{found.modulus.problem}")
    return found
