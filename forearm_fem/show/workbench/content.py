"""Content of the page: the model between the ports, the device, the field, and their error estimates."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from ... import __version__
from ...accuracy.estimates import accuracy_verdict
from ...engines.library import ArmLibrary
from ...engines.simulation import simulate
from ...engines.skin_model import load_skin_model
from ...errors import DataError, GeometryError, ScenarioError
from ...files.declaration import arbitrary_gain
from ...geometry.device.layout import layout_of
from ...ports import Port
from ...progress import Progress
from ...rendering import (
    BinnedTransfer,
    Bridged,
    Record,
    Wavelet,
    bridged,
    from_samples_file,
    funneling_weights,
    on_record_bins,
    place_on_bins,
)
from ...rendering.interval import as_drawn
from ...rendering.job import least_error, wavelet
from ...results.draws import DRAWS_FILE, DrawsFile
from ...scenario import Scenario, parse_scenario
from ...scenario.actuators import beneath
from ...scenario.base import put
from ...scenario.device import Device, VoltageRows
from ...scenario.rendering import RickerWavelet, SampledWavelet
from ...scenario.sweep import frequencies
from ...store.record import load
from ...transfer import ErrorEstimate, TransferMatrix, error_of_pairs, relative_error_at
from ...typing import FloatArray
from ..data import PREDICTION, Results
from ..style import METHODS, TISSUES
from .anywhere import Anywhere, Places, anywhere_of, packed_anywhere, patch_field, places_of
from .field import (
    Field,
    amplitudes_in_half_precision,
    between_points,
    flat_field,
    in_half_precision,
    packed,
    solved_field,
)

FORMAT = 1  # of the content; the page's own files carry it too
_ARMS = 8  # drawn arms that a page holds: 1.5 MB of the thesis' scene
_SHORT = 2**16  # vertices that 16 bits count
_OF_LIBRARY = (
    "What a library cannot do: other tissues, another limb, discs of another size or contact, places off its patch, "
    "frequencies beyond its band, motion inside the limb; waves that one cone scatters from another are left out here"
)


def content_of(results: Results, progress: Progress | None = None) -> dict[str, Any]:
    """Content of the page of a finished run; ``progress`` counts the tables for moved actuators.

    Raises DataError where G cannot be placed on the bins of its record.
    """
    scenario, transfer = results.scenario, results.transfer
    record = Record.of(scenario.sweep.sample_rate, scenario.sweep.duration)
    if not results.has("compliance"):
        return measured_content(transfer, scenario, results.stamp)
    compliance = results.compliance
    holes = bridged(transfer)
    placed = on_record_bins(holes.transfer, record)
    frequency = compliance.frequency
    moved = anywhere_of(scenario, transfer, progress) if scenario.engine == "layered" else None
    field = flat_field(compliance.ports) if moved else _field(results, placed.bins.frequency)
    account = results.account
    return {
        **_anywhere(moved, results, placed.bins.frequency),
        **_common(scenario, holes, placed, field, record, _shape(results, scenario)),
        "name": scenario.name,
        "stamp": results.stamp,
        "model": _model(results, placed),
        "frequencies": packed(frequency, "f8"),
        "strength": account.signal_strength.model_dump(mode="json"),
        "arms": _arms(results.prediction),
        "draws": _draws(results, placed),
        "notes": [*account.notes, *account.warnings],
    }


def _anywhere(
    moved: tuple[Anywhere, ErrorEstimate] | None, results: Results, bins: FloatArray
) -> dict[str, Any]:
    """Tables for moved actuators, and the errors that G then has: the run's, pairs not told apart, and the tables'."""
    if moved is None:
        return {"anywhere": None}
    found, missed = moved
    errors = (*(replace(e, per_pair=None) for e in results.transfer.errors), missed)
    table = packed_anywhere(found, missed, results.compliance.ports)
    return {"anywhere": {**table, "errors": [_estimate(e, bins) for e in errors]}}


def library_content(
    arm: ArmLibrary, scenario: Scenario, stamp: str, progress: Progress | None = None, base: Path = Path()
) -> dict[str, Any]:
    """The page's content for an arm's library, whose actuators can be dragged; ``scenario`` is one on the same arm, its
    files seen from ``base``.

    The errors are the library's for the scenario's own arrangement, and what the page's few places add; pairs are not
    told apart, as actuators move.
    """
    record = Record.of(scenario.sweep.sample_rate, scenario.sweep.duration)
    places, missed = places_of(arm, scenario, progress)
    transfer = simulate(scenario, engine=arm).transfer
    errors = (*(replace(e, per_pair=None, together=None) for e in transfer.errors), missed)
    holes = bridged(replace(transfer, errors=errors))
    placed = on_record_bins(holes.transfer, record)
    found = np.searchsorted(placed.bins.frequency, places.frequency - 1e-6)
    if len(found) != len(placed.bins.frequency) or not np.allclose(placed.bins.frequency, places.frequency, atol=1e-6):
        raise DataError("sweep: a page of a library needs every bin of its record; leave sweep.frequencies out")
    field = patch_field(arm, places)
    return {
        **_common(scenario, holes, placed, field, record, wavelet(scenario.rendering, scenario.sweep, base)),
        "name": scenario.name,
        "stamp": stamp,
        "model": _packed_places(places, arm, scenario),
        "frequencies": packed(transfer.frequency, "f8"),
        "strength": {},
        "arms": None,
        "notes": [_OF_LIBRARY],
    }


def _packed_places(places: Places, arm: ArmLibrary, scenario: Scenario) -> dict[str, Any]:
    layout, patch, near = layout_of(scenario), arm.scenario.library, places.near
    assert near is not None
    real = {k: packed(getattr(places, k), "f8") for k in ("xy", "flat", "position", "axis", "points", "inverse")}
    return {
        "kind": "places", **real,
        "near": {
            "xy": packed(near.xy, "f8"), "left": packed(near.left, "c8"),
            "alpha": packed(near.alpha, "c16"),  # large and of both signs
            "scale": near.scale,
        },
        **{k: packed(getattr(places, k), "c8") for k in ("layered", "left", "right")},
        "home": layout.contacts.tolist(), "half": [patch.length / 2, patch.width / 2], "radius": places.radius,
        "reach": float(places.radii[-1]), "scale": places.scale, "pressed": scenario.device.cone.contact == "pressure",
    }  # fmt: skip


def measured_content(
    transfer: TransferMatrix, scenario: Scenario, stamp: str, base: Path = Path(), note: str = ""
) -> dict[str, Any]:
    """The page's content for a G without compliance: the device cannot be changed, nothing is known between the points.

    ``scenario`` gives the record, the wavelet (its file seen from ``base``), the limits and the renderers' options;
    ``note`` is one more to show.
    """
    record = Record.of(scenario.sweep.sample_rate, scenario.sweep.duration)
    holes = bridged(transfer)
    placed = on_record_bins(holes.transfer, record)
    shape = wavelet(scenario.rendering, scenario.sweep, base)
    gain = "the gain of this G is arbitrary, as was declared: S holds, micrometres, drives and limits mean nothing"
    gain = gain if arbitrary_gain(transfer.provenance) else ""
    notes = [n for n in (gain, holes.sentence, note) if n]
    return {
        **_common(scenario, holes, placed, between_points(transfer.outputs), record, shape),
        "name": scenario.name,
        "stamp": stamp,
        "model": {
            "kind": "transfer",
            "values": packed(placed.bins.values, "c16"),
            "valid": packed(placed.bins.valid, "u1"),
        },
        "frequencies": packed(transfer.frequency, "f8"),
        "strength": {},
        "arms": None,
        "notes": notes,
    }


def _common(
    scenario: Scenario, holes: Bridged, placed: BinnedTransfer, field: Field, record: Record, shape: Wavelet
) -> dict[str, Any]:
    transfer = holes.transfer
    errors = (*transfer.errors, *((holes.error,) if holes.error is not None else ()))
    return {
        "format": FORMAT,
        "program": __version__,
        "description": scenario.description,
        "engine": scenario.engine,
        "unit": transfer.unit,
        "record": {"rate": record.sample_rate, "n": record.n},
        "bins": packed(placed.bins.index, "i4"),
        "inputs": [_port(p) for p in transfer.inputs],
        "outputs": [_port(p) for p in transfer.outputs],
        "funneling": [_weights(transfer.inputs, p, scenario) for p in transfer.outputs],
        "error": packed(placed.error, "f8"),
        "least_error": least_error(scenario),
        "errors": [_estimate(e, placed.bins.frequency) for e in errors],
        "deviates": transfer.deviation is not None,
        "accuracy": accuracy_verdict(scenario, transfer.errors),
        "clearance": scenario.rendering.clearance,
        "device": {**_with_all_parts(scenario.device), "centres": scenario.device.centres},
        "rendering": beneath({"wavelet": RickerWavelet().model_dump()}, scenario.rendering.model_dump(mode="json")),
        "samples": packed(shape.samples, "f8") if isinstance(scenario.rendering.wavelet, SampledWavelet) else None,
        "scenario": short_scenario(scenario),
        "field": _packed_field(field),
        "colours": {"methods": dict(METHODS), "tissues": dict(TISSUES)},
    }


def _with_all_parts(device: Device) -> dict[str, Any]:
    """Keys of a device, under them the coils and the free housing that it may lack: the page's controls show them."""
    parts = VoltageRows().model_dump(mode="json", include={"coil", "housing", "cone", "max_voltage", "max_power"})
    return beneath(parts, device.model_dump(mode="json"))


def _arms(prediction: Mapping[str, Any] | None) -> dict[str, Any] | None:
    """S over arms at every target, where the folder holds a prediction of this scenario; levels are its quantiles'."""
    if prediction is None:
        return None
    table = {m: {t: cell["arms"] for t, cell in row.items()} for m, row in prediction["by_target"].items()}
    return {"levels": prediction["levels"], "draws": prediction["draws"], "methods": table}


def _draws(results: Results, placed: BinnedTransfer) -> list[dict[str, Any]]:
    """G of some arms that a prediction of this scenario drew, on the page's bins, and what arms they are."""
    file = results.folder / Path(PREDICTION).parent / DRAWS_FILE
    if results.prediction is None or not file.is_file():
        return []
    frequency, sweep = frequencies(results.scenario.sweep), results.scenario.sweep
    found = []
    for outcome in [o for o in load(file, DrawsFile).outcomes if o.transfer is not None][:_ARMS]:
        g = np.asarray(outcome.transfer, dtype=complex)
        on_bins = place_on_bins(frequency, g, sweep.sample_rate, sweep.duration)
        values = on_bins.values[np.searchsorted(on_bins.frequency, placed.bins.frequency - 1e-6)]
        stiffness = {n: v for n, v in outcome.drivers.items() if n.endswith(("stiffness", "thickness"))}
        packed_g = amplitudes_in_half_precision(values.reshape(len(values), -1, 1))
        found.append({"number": outcome.number, "law": outcome.law, "drivers": stiffness, "values": packed_g})
    return found


def _field(results: Results, bins: FloatArray) -> Field:
    """The field on the record's ``bins`` [Hz]."""
    scenario = results.scenario
    if results.has_field:
        return _on_bins(solved_field(results), results.wavefield.frequency, scenario, bins)
    return between_points(results.transfer.outputs)


def _on_bins(field: Field, frequency: FloatArray, scenario: Scenario, bins: FloatArray) -> Field:
    if field.amplitudes is None or (len(bins) == len(frequency) and np.allclose(bins, frequency, atol=1e-6)):
        return field
    found = place_on_bins(frequency, field.amplitudes, scenario.sweep.sample_rate, scenario.sweep.duration)
    rows = np.searchsorted(found.frequency, bins - 1e-6)
    return Field(field.surfaces, found.values[rows], field.error, field.words)


def _model(results: Results, placed: BinnedTransfer) -> dict[str, Any]:
    """Poles and residues where the sweep found them, else the compliance's contact columns on the bins."""
    compliance = results.compliance
    contacts, points = compliance.indices("contact"), compliance.indices("point")
    order = [*contacts, *points]
    if results.has("reduced.nc"):
        found = load_skin_model(results.path("reduced.nc"))
        if (modes := found.poles) is not None and _same_ports(found.ports, compliance.ports):
            return {
                "kind": "poles",
                "poles": packed(modes.poles, "c16"),
                "left": packed(modes.left[order], "c16"),
                "right": packed(modes.right[:, order], "c16"),
                "shares": packed(modes.shares[order], "f8"),
            }
    values = compliance.values[:, order][:, :, contacts]
    bins = place_on_bins(
        compliance.frequency, values, placed.record.sample_rate, placed.record.n / placed.record.sample_rate
    )
    rows = np.searchsorted(bins.index, placed.bins.index)
    return {"kind": "samples", "values": packed(bins.values[rows], "c16")}


def _same_ports(a: tuple[Port, ...], b: tuple[Port, ...]) -> bool:
    return len(a) == len(b) and all(
        p.name == q.name and np.allclose(p.position, q.position) for p, q in zip(a, b, strict=True)
    )


def _shape(results: Results, scenario: Scenario) -> Wavelet:
    """The scenario's wavelet, its samples from the copy that the run left in the folder."""
    given = scenario.rendering.wavelet
    if not isinstance(given, SampledWavelet):
        return wavelet(scenario.rendering, scenario.sweep, results.folder)
    kept = results.folder / f"wavelet{Path(given.file).suffix}"
    if not kept.is_file():
        raise DataError(f"{kept}: missing; `forearm-fem render SCENARIO --out {results.folder}` makes it")
    return from_samples_file(kept, scenario.sweep.sample_rate, scenario.sweep.duration)


def short_scenario(scenario: Scenario) -> dict[str, Any]:
    """The scenario without its defaults where it says the same, for a file that a reader may check."""
    whole: dict[str, Any] = scenario.model_dump(mode="json")
    short: dict[str, Any] = {"name": scenario.name, "limb": {"shape": scenario.limb.shape}}
    for key in scenario.changed_keys():
        put(short, key, functools.reduce(lambda part, name: part[name], key.split("."), whole), key)
    try:
        same = parse_scenario(_without_none(short)).model_dump(mode="json") == whole
    except ScenarioError:
        same = False
    kept: dict[str, Any] = _without_none(short if same else whole)
    return kept


def _without_none(table: Any) -> Any:
    """TOML has no null: a key that is None is left out."""
    if isinstance(table, dict):
        return {k: _without_none(v) for k, v in table.items() if v is not None}
    return [_without_none(v) for v in table] if isinstance(table, list) else table


def _weights(inputs: tuple[Port, ...], target: Port, scenario: Scenario) -> list[float] | None:
    """Funneling's weights, None where it does not reach."""
    try:
        return [float(w) for w in funneling_weights(inputs, target, scenario.rendering.funneling_distance)]
    except GeometryError:
        return None


def _port(port: Port) -> dict[str, Any]:
    return asdict(port)


def _estimate(error: ErrorEstimate, frequency: FloatArray) -> dict[str, Any]:
    """An estimate, and e(f) at ``frequency`` as draws of G take it, of each pair where it tells pairs apart."""
    known = {"band": error.band, "worst": error.worst} if error.known else {"band": None, "worst": None}
    drawn = as_drawn(error, frequency) if error.source == "discretisation" else error
    size, pairs = relative_error_at(drawn, frequency), error_of_pairs(drawn, frequency)
    of_pairs = None if pairs is None else packed(pairs, "f4")
    return {"source": error.source, **known, "method": error.method, "size": packed(size, "f8"), "pairs": of_pairs}


def _packed_field(field: Field) -> dict[str, Any]:
    return {
        "words": field.words,
        "error": field.error,
        "amplitudes": None if field.amplitudes is None else amplitudes_in_half_precision(field.amplitudes),
        "surfaces": [
            {
                "name": s.name,
                "rest": packed(s.rest, "f4"),
                "normals": packed(s.normals, "f4"),
                "faces": packed(s.faces, "u2" if len(s.rest) < _SHORT else "u4"),
                "shapes": in_half_precision(s.shapes),
                "tissue": None if s.tissue is None else packed(s.tissue, "u1"),
                "tissues": list(s.tissues),
            }
            for s in field.surfaces
        ],
    }
