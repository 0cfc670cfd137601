"""Keys of a scenario that were set and that nothing reads: each is named in a note, so that no key is silent."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from pydantic import BaseModel

from ..geometry.device.layout import layers_of
from ..scenario import Scenario
from ..scenario.limb import ForearmLimb, MeshLimb, SurfacesLimb, forearm_length
from ..scenario.sweep import SolverOptions
from ..tissue import KelvinVoigt, limb_tissue_keys, resolve_tissues

_EXPANSIONS = ("solver.expansions", "solver.derivatives", "solver.point_derivatives", "solver.max_expansions")
_SOLVER = tuple(key for key in SolverOptions.model_fields if key != "memory_limit")  # signals have a limit too
_MOVING = ("mass", "gyration", "strap_stiffness", "strap_loss", "strap_radius", "skin_share")
_SHAPE = ("length", "width", "depth", "symmetry", "circumference", "aspect", "diameter", "bones")


@dataclass(frozen=True)
class _Unread:
    """``keys`` (or all below them) have no effect on a scenario for which ``when`` holds; ``why`` is the reason."""

    keys: tuple[str, ...]
    when: Callable[[Scenario], bool]
    why: str


# Which part of the pipeline reads which keys, as far as that hangs on other keys: first the engine, then the device,
# the sweep, the mesh, the supports, the solver and the renderers.
_RULES = (
    _Unread(("library",), lambda s: True, "`forearm-fem library` alone reads them"),
    _Unread(
        ("mesh", "supports", *(f"limb.{key}" for key in _SHAPE), *(f"solver.{key}" for key in _SOLVER)),
        lambda s: s.engine == "layered",
        "engine = 'layered' has flat, endless layers and no mesh",
    ),
    _Unread(
        tuple(f"device.{key}" for key in ("rows", "columns", "spacing", "spacing_y", "stagger")),
        lambda s: s.device.contacts is not None, "device.contacts is given",
    ),
    _Unread(
        ("device.spacing_y",), lambda s: s.device.columns in {1, (1,) * s.device.rows} and not s.device.stagger,
        "no row has two actuators",
    ),
    _Unread(
        ("device.coil", "device.housing", "device.cone.mass", "device.max_voltage", "device.max_power"),
        lambda s: s.device.drive != "voltage",
        "device.drive is not 'voltage'",
    ),
    _Unread(
        tuple(f"device.housing.{key}" for key in _MOVING), lambda s: s.device.housing.fixed,
        "device.housing.fixed holds it still",
    ),
    _Unread(
        ("device.contact_springs",), lambda s: set(s.device.contact_springs) <= set(s.device.out_of_contact),
        "device.out_of_contact names the same actuators",
    ),
    _Unread(
        ("tissues.patch.length", "tissues.patch.width"), lambda s: not s.tissues.patch.is_on,
        "tissues.patch has neither mass nor stiffness",
    ),
    _Unread(
        ("grid.rows", "grid.columns", "grid.pitch", "grid.pitch_y"), lambda s: s.grid.points is not None,
        "grid.points is given",
    ),
    _Unread(("grid.pitch_y",), lambda s: s.grid.columns == 1, "no row has two points"),
    _Unread(("sweep.f_min", "sweep.f_max"), lambda s: s.sweep.frequencies is not None, "sweep.frequencies is given"),
    _Unread(
        ("sweep.duration", "sweep.sample_rate"),
        lambda s: s.sweep.frequencies is not None and not s.rendering.methods,
        "sweep.frequencies is given and nothing is rendered",
    ),
    _Unread(
        ("mesh.size_grid", "mesh.size_far", "mesh.grading", "mesh.sublayers"),
        lambda s: isinstance(s.limb, MeshLimb),
        "limb.shape = 'mesh' keeps the file's elements, and refines them only at contacts (mesh.size_contact)",
    ),
    _Unread(("mesh.sublayers",), lambda s: isinstance(s.limb, SurfacesLimb), "limb.shape = 'surfaces' has no layers"),
    _Unread(
        ("supports.foam_stiffness", "supports.foam_damping"), lambda s: s.supports.underside != "foam",
        "supports.underside is not 'foam'",
    ),
    _Unread(("supports.bone",), lambda s: not _has_bone(s), "the limb has no bone"),
    _Unread(
        ("solver.start", "solver.rate_derivatives", *_EXPANSIONS), lambda s: s.solver.sweep == "direct",
        "solver.sweep = 'direct'",
    ),
    _Unread(_EXPANSIONS, lambda s: _from_rate(s), "they count only where a start from a rate fails (solver.start)"),
    _Unread(
        ("solver.rate_derivatives",), lambda s: s.solver.sweep == "reduced" and not _from_rate(s),
        "the reduced model starts from frequencies",
    ),
    _Unread(
        ("rendering", "device.max_voltage", "device.max_power"), lambda s: not s.rendering.methods,
        "rendering.methods is empty",
    ),
    _Unread(
        ("rendering.zeros", "rendering.regularisation", "rendering.regularisation_value"),
        lambda s: not {"inverse filter", "combination"} & set(s.rendering.methods),
        "no method of rendering.methods inverts",
    ),
    _Unread(
        ("rendering.wavelet.peak",), lambda s: s.rendering.wavelet.file is not None,
        "rendering.wavelet.file is given",
    ),
)  # fmt: skip


def unread_notes(scenario: Scenario) -> tuple[str, ...]:
    """A sentence per reason and its keys: those that differ from their defaults and have no effect here."""
    changed = changed_keys(scenario)
    notes, told = list[str](), set[str]()
    for rule in _RULES:
        if not rule.when(scenario):
            continue
        keys = [k for k in changed if k not in told and any(f"{k}.".startswith(f"{r}.") for r in rule.keys)]
        keys = [k for k in keys if k != "rendering.methods"]
        told |= set(keys)
        notes += [_sentence(keys, rule.why)] if keys else []
    # tables by tissue that name one which the limb does not have
    if unknown := [f"tissues.override.{n}" for n in scenario.tissues.override if n not in _met(scenario)]:
        notes.append(_sentence(unknown, "no wave passes through this tissue in this limb"))
    layers = {layer.tissue for layer in layers_of(scenario.limb)}
    if layers and (unknown := [f"mesh.sublayers.{n}" for n in scenario.mesh.sublayers if n not in layers]):
        notes.append(_sentence(unknown, "the limb has no such layer"))
    return tuple(notes)


def unread_because(scenario: Scenario, key: str) -> str | None:
    """Why nothing reads ``key`` in ``scenario``, whatever its value; None where something does."""
    rules = (rule for rule in _RULES if any(f"{key}.".startswith(f"{r}.") for r in rule.keys))
    return next((rule.why for rule in rules if rule.when(scenario)), None)


def changed_keys(scenario: Scenario) -> tuple[str, ...]:
    """Dotted paths of all keys that differ from their defaults; lists and free tables count as one key."""
    return tuple(_changed(scenario, scenario, ""))


def _changed(scenario: Scenario, part: BaseModel, path: str) -> Iterator[str]:
    for name, field in type(part).model_fields.items():
        value, key = getattr(part, name), f"{path}{name}"
        if isinstance(value, BaseModel):
            yield from _changed(scenario, value, f"{key}.")
        elif name != "shape":
            follows = isinstance(part, ForearmLimb) and name == "length"  # the accuracy asked for
            usual = forearm_length(scenario.accuracy) if follows else field.get_default(call_default_factory=True)
            if value != usual:
                yield key


def _has_bone(scenario: Scenario) -> bool:
    limb = scenario.limb
    return bool(getattr(limb, "bones", ())) or "bone" in limb_tissue_keys(limb).values()


def _from_rate(scenario: Scenario) -> bool:
    """Whether the reduced sweep starts from a rate: all moduli met are polynomials of it."""
    if scenario.solver.sweep == "direct" or scenario.solver.start == "frequencies":
        return False
    tissues = resolve_tissues(scenario)
    return all(isinstance(tissues[name].modulus, KelvinVoigt) for name in _met(scenario))


def _met(scenario: Scenario) -> set[str]:
    """Tissues that waves pass through."""
    elastic = _has_bone(scenario) and scenario.supports.bone == "elastic" and scenario.engine == "fem"
    return (set(limb_tissue_keys(scenario.limb).values()) - {"bone"}) | ({"bone"} if elastic else set())


def _sentence(keys: list[str], why: str) -> str:
    return f"{', '.join(keys)}: no effect here, {why}"
