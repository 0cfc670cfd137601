"""The scenario that a given G is rendered by: the one asked for, the one that G names, or the thesis'."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..errors import DataError, ScenarioError
from ..ports import Port
from ..scenario import Scenario, load_scenario, parse_scenario
from ..scenario.load import read_overrides
from ..scenario.rendering import SampledWavelet
from ..transfer import UNITS, TransferMatrix
from .bridging import bridged
from .job import is_on_bins, wavelet_for
from .spectrum import Record, place

DEFAULT = "thesis"
UNASKED = (
    "no scenario is named, by --scenario or by this G: methods, wavelet, window and limits are the thesis', places are "
    "G's own; name the scenario that was measured"
)
_HIGHEST = 5000.0  # Hz, of a sweep


def scenario_for(
    g: TransferMatrix, asked: Scenario | None = None, overrides: Sequence[str] = ()
) -> tuple[Scenario, tuple[str, ...]]:
    """The scenario that renders ``g``, with ``overrides`` (``key.path=value``) set, and notes on its choice.

    It is ``asked`` or, failing that, the one in G's provenance, else the thesis' with the places of G. Where G cannot
    be placed on the bins of its record, it gets one whose bins G is on. DataError where G has other counts of ports.
    """
    notes = list[str]()
    if asked is not None:
        _refuse_other_counts(asked, g)
        scenario = asked
    elif (named := named_by(g)) is not None:
        scenario = named
    else:
        scenario = _thesis_with_places_of(g)
        notes.append(UNASKED)
    scenario = scenario.changed(read_overrides(overrides)) if overrides else scenario
    shape = scenario.rendering.wavelet
    if isinstance(shape, SampledWavelet) or _lies_on(g, scenario):
        return scenario, tuple(notes)
    own = wavelet_for(g.frequency, shape.peak).record
    if is_on_bins(g.frequency, 1 / own.df):
        sweep = {
            "sweep.f_min": float(g.frequency[0]), "sweep.f_max": float(min(g.frequency[-1], _HIGHEST)),
            "sweep.duration": 1 / own.df, "sweep.sample_rate": own.sample_rate,
        }  # fmt: skip
        notes.append(
            f"the record is {1 / own.df:.4g} s at {own.sample_rate:.6g} Hz, whose bins are this G's frequencies: it is "
            f"not known closely enough for the scenario's ({scenario.sweep.duration:g} s)"
        )
        scenario = scenario.changed(sweep)
    return scenario, tuple(notes)


def _lies_on(g: TransferMatrix, scenario: Scenario) -> bool:
    """Whether G is known on the bins of the scenario's record, or closely enough beside them."""
    try:
        place(bridged(g).transfer, Record.of(scenario.sweep.sample_rate, scenario.sweep.duration))
    except DataError:
        return False
    return True


def named_by(g: TransferMatrix) -> Scenario | None:
    """The scenario in G's provenance; None where there is none that this version reads."""
    known = g.provenance.get("scenario")
    try:
        return parse_scenario(known) if isinstance(known, Mapping) else None
    except ScenarioError:
        return None


def _refuse_other_counts(asked: Scenario, g: TransferMatrix) -> None:
    """DataError where the scenario measured has another number of points or actuators than G."""
    theirs = len(asked.grid.places), len(asked.device.centres)
    if theirs != (len(g.outputs), len(g.inputs)):
        raise DataError(
            f"G has {len(g.outputs)} points and {len(g.inputs)} actuators, scenario '{asked.name}' has {theirs[0]} and "
            f"{theirs[1]}; name the scenario that was measured, or none"
        )


def _thesis_with_places_of(g: TransferMatrix) -> Scenario:
    """The thesis' scenario, its device and grid where G's ports are."""
    centre = np.mean([p.position[:2] for p in g.inputs], axis=0)
    return load_scenario(DEFAULT).changed({
        "name": "measured", "description": "", "device.drive": next(k for k, u in UNITS.items() if u == g.unit),
        "device.contacts": _places(g.inputs, centre), "grid.points": _places(g.outputs, centre),
    })  # fmt: skip


def _places(ports: Sequence[Port], centre: np.ndarray) -> list[list[float]]:
    """Where ``ports`` are from ``centre``, in metres to the nanometre."""
    return [[round(float(v), 9) for v in np.array(p.position[:2]) - centre] for p in ports]
