"""One G from many files: one per actuator, per point or per entry, told apart by their names or by a table."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import AccuracyWarning, DataError
from ..transfer import TransferMatrix
from .declaration import FOI, Declaration, Ports, RecognitionWarning, declare
from .reader import RawMatrix, Reader, as_named, axes_by_length, understand
from .sweeps import channels_of, read_sweep, waveforms

if TYPE_CHECKING:
    from ..measurement.recording import Recording
    from ..scenario import Scenario
    from ..scenario.measurement import MeasurementOptions

_PLACES = {"output": "(?P<output>.+?)", "input": "(?P<input>.+?)"}


@dataclass(frozen=True)
class Named:
    """A file, and the point and the actuator that its name tells; None for what it does not tell."""

    file: Path
    output: str | None
    input: str | None


def named_files(
    files: Sequence[Path], said: Declaration, ports: Ports | None, entries: Mapping[str, Sequence[str]] | None = None
) -> list[Named]:
    """Point and actuator of each of ``files``: by a table ``entries`` (file -> point, actuator), by ``said.pattern``,
    else by the parts of their names that are names of ``ports``, with a warning; where there is one alone, it is it."""
    found = _told_by_names(files, said, ports, entries)
    if ports is None:
        return found
    one = [side[0].name if len(side) == 1 else None for side in ports]
    return [Named(n.file, n.output or one[0], n.input or one[1]) for n in found]


def _told_by_names(
    files: Sequence[Path], said: Declaration, ports: Ports | None, entries: Mapping[str, Sequence[str]] | None
) -> list[Named]:
    if entries is not None:
        return [_of_entries(f, entries) for f in files]
    if said.pattern is not None:
        return [_of_pattern(f, said.pattern, said, ports) for f in files]
    if ports is None:
        return [Named(f, None, None) for f in files]
    found = [_of_parts(f, said, ports) for f in files]
    if any(n.output or n.input for n in found):
        first = found[0]
        told = " <- ".join(n for n in (first.output, first.input) if n)
        chosen = f"{told} in {first.file.name}, and so on"
        warnings.warn(RecognitionWarning(str(first.file.parent), "entries of its files", chosen), stacklevel=5)
    return found


def _of_entries(file: Path, entries: Mapping[str, Sequence[str]]) -> Named:
    if file.name not in entries or len(entries[file.name]) != 2:
        raise DataError(f"{file}: join.entries has no '{file.name}' = [point, actuator]; add it")
    output, drive = entries[file.name]
    return Named(file, output, drive)


def _of_pattern(file: Path, pattern: str, said: Declaration, ports: Ports | None) -> Named:
    match = re.fullmatch(_as_expression(pattern), file.name if "." in pattern else file.stem)
    if match is None:
        raise DataError(
            f"{file}: its name does not fit the pattern '{pattern}', in which {{output}} stands for the point and "
            "{input} for the actuator; correct the pattern, or take the file away"
        )
    groups = match.groupdict()
    known = ([p.name for p in ports[0]], [p.name for p in ports[1]]) if ports else ([], [])
    output, drive = (
        None if (word := groups.get(key)) is None else _mapped(word, getattr(said, which), names)
        for key, which, names in zip(("output", "input"), ("points", "actuators"), known, strict=True)
    )
    return Named(file, output, drive)


def _as_expression(pattern: str) -> str:
    expression = re.escape(pattern)
    for key, group in _PLACES.items():
        expression = expression.replace(re.escape("{" + key + "}"), group, 1)
    if "(?P<" not in expression:
        raise DataError(f"pattern '{pattern}': expected {{output}} or {{input}} in it, as in 'P{{output}}_{{input}}'")
    return expression.replace(r"\*", ".*?")


def _mapped(word: str, given: Mapping[str, str] | None, known: Sequence[str]) -> str:
    if given is not None:
        return next((port for own, port in given.items() if as_named(word, [own]) == own), word)
    return as_named(word, known, numbered=True)


def _of_parts(file: Path, said: Declaration, ports: Ports) -> Named:
    """Point and actuator by the parts of a file's name that are, or end in, a port's name; each once."""
    words = [w for w in re.split(r"[^A-Za-z0-9]+", file.stem) if w]
    inputs, outputs = ([p.name for p in ports[k]] for k in (1, 0))
    drive = _only(words, lambda w: _told(w, said.actuators, inputs))
    rest = [w for w in words if drive is None or w != drive[0]]
    output = _only(rest, lambda w: _told(w, said.points, outputs) or _ending(w, outputs))
    return Named(file, output and output[1], drive and drive[1])


def _told(word: str, given: Mapping[str, str] | None, known: Sequence[str]) -> str | None:
    if given is not None:
        return next((port for own, port in given.items() if as_named(word, [own]) == own), None)
    found = as_named(word, known)
    return found if found in known else None


def _ending(word: str, known: Sequence[str]) -> str | None:
    """The point of "P05" or "point5" where points are called by their numbers."""
    match = re.fullmatch(r"[A-Za-z]+0*(\d+)", word)
    return match[1] if match and match[1] in known else None


def _only(words: Sequence[str], meant: Callable[[str], str | None]) -> tuple[str, str] | None:
    found = [(w, name) for w in words if (name := meant(w)) is not None]
    return found[0] if len({name for _, name in found}) == 1 else None


def joined(
    reader: Callable[[Path], Reader], named: Sequence[Named], said: Declaration, ports: Ports | None
) -> TransferMatrix:
    """G of files that each hold a part of it, on ``ports``."""
    plain = said.model_copy(update={"pattern": None})
    explicit = said.pattern is not None
    raws = [_part(reader(n.file).checked(n.file, plain), n, plain, ports, explicit) for n in named]
    told = all(n.output and n.input for n in named)  # maps have served
    served = ("pattern", "points", "actuators") if told else ("pattern",)
    return understand(raws, said.model_copy(update=dict.fromkeys(served)), ports)


def _part(raw: RawMatrix, name: Named, said: Declaration, ports: Ports | None, explicit: bool) -> RawMatrix:
    """``raw`` with the point and the actuator that its file's name tells."""
    if raw.names is not None:
        if not explicit:
            return raw
        names = [
            (told,) if told is not None and len(own) == 1 else own
            for own, told in zip(raw.names, (name.output, name.input), strict=True)
        ]
        return replace(raw, names=(names[0], names[1]), numbered=False)
    if raw.outputs is not None or ports is None:
        return raw
    sides = [
        (told,) if told is not None else tuple(p.name for p in own)
        for own, told in zip(ports, (name.output, name.input), strict=True)
    ]
    lengths = [len(side) for side in sides]
    axes = raw.axes or said.axes or axes_by_length(raw, *lengths)
    shape = raw.values.shape
    fits = axes is not None and len(axes) == 3 and [shape[axes.index(a)] for a in ("output", "input")] == lengths
    if not fits:
        missing = [what for what, told in (("point", name.output), ("actuator", name.input)) if told is None]
        if missing:
            raise DataError(
                f"{raw.name}: its name does not tell its {' and '.join(missing)}; add "
                f"{declare('pattern', repr('P{output}_{input}'))} as the files are named, or write join.entries"
            )
        raise DataError(
            f"{raw.name}: holds an array of shape {shape}, expected one entry with its frequencies; declare its axes"
        )
    assert axes is not None
    order = [axes.index(a) for a in FOI]
    arrays: dict[str, Any] = {
        k: None if (a := getattr(raw, k)) is None else np.transpose(a, order) for k in ("values", "valid", "deviation")
    }
    return replace(raw, **arrays, axes=FOI, names=(sides[0], sides[1]))


def estimated(named: Sequence[Named], said: Declaration, scenario: Scenario, ports: Ports) -> TransferMatrix:
    """G of raw sweeps by the estimators of a calibration, as the scenario's ``measurement`` and ``sweep`` have them.

    What a calibration says of its recordings is said as warnings.
    """
    from ..measurement.entry import assemble, entry  # of hardware, which few need
    from ..measurement.estimators import ExponentialSweep

    options, band = scenario.measurement, ExponentialSweep.of(scenario)
    drives = set[str]()
    entries, known = [], ({p.name for p in ports[0]}, {p.name for p in ports[1]})
    for name in named:
        drive, response = channels_of(name.file, said)
        for output, channel in _responses(name, response, said, ports):
            if output not in known[0] or name.input not in known[1]:
                raise DataError(
                    f"{name.file}: its name does not tell which point and actuator it is of (it says "
                    f"{output or 'none'} "
                    f"and {name.input or 'none'}); add {declare('pattern', repr('P{output}_{input}'))} as the files "
                    "are "
                    "named"
                )
            assert name.input is not None
            taken = read_sweep(
                name.file, drive=drive, response=channel, output=output, input=name.input,
                period=_period(name.file, said, drive, band.duration), drive_is_measured=said.drive_is_measured,
                skip=said.skip, said=said,
            )  # fmt: skip
            own = _options_for(taken, options)
            if not said.drive_is_measured:
                taken = replace(taken, sent=taken.sent * own.daq.amplifier_gain)
            drives.add(taken.provenance.get("drive", "V"))
            entries.append(entry(taken, (band.f_min, band.f_max), own))
    if len(drives) > 1:
        raise DataError(f"{named[0].file.parent}: some drives are in N, others in V; join files of one kind of drive")
    twice = [(e.output, e.input) for e in entries]
    if len(set(twice)) < len(twice):
        o, i = next(pair for pair in twice if twice.count(pair) > 1)
        raise DataError(f"{named[0].file.parent}: {o} <- {i} is in two files; keep one of them, or correct the pattern")
    where = {
        "source": "measured", "device": "files of another program", "files": [str(n.file) for n in named],
        "measurement": options.model_dump(mode="json"), "latency_basis": "declared" if options.daq.latency else "none",
        "sweep": {k: getattr(band, k) for k in ("f_min", "f_max", "duration", "sample_rate")},
    }  # fmt: skip
    found = assemble(entries, *ports, where)
    for finding in found.findings:
        warnings.warn(finding.sentence, AccuracyWarning, stacklevel=3)
    if found.missing:
        o, i = found.missing[0]
        warnings.warn(
            f"{named[0].file.parent}: no file is of {len(found.missing)} of the entries, {o} <- {i} first; they are "
            "marked as not measured",
            AccuracyWarning, stacklevel=3,
        )  # fmt: skip
    return replace(found.transfer, unit="m/N") if drives == {"N"} else found.transfer


def _options_for(taken: Recording, options: MeasurementOptions) -> MeasurementOptions:
    """``options`` of a recording whose file states motion or force: no sensor's volts, no amplifier."""
    if (quantity := taken.provenance.get("response")) is not None:
        if options.sensor.quantity not in (None, quantity):
            raise DataError(
                f"{taken.provenance['file']}: its response is {quantity} by its unit, and measurement.sensor.quantity "
                f"is '{options.sensor.quantity}'; correct one of them"
            )
        stated = options.sensor.model_copy(update={"quantity": quantity, "sensitivity": 1.0})
        options = options.model_copy(update={"sensor": stated})
    if taken.provenance.get("drive") == "N":
        options = options.model_copy(update={"daq": options.daq.model_copy(update={"amplifier_gain": 1.0})})
    return options


def _period(file: Path, said: Declaration, drive: str, duration: float) -> int:
    """Samples of one period of the scenario's sweep at the file's rate."""
    channels = waveforms(file, said)
    if drive not in channels or channels[drive].step <= 0:
        return 1  # said when the channel is read
    return round(duration / channels[drive].step)


def _responses(
    name: Named, response: str, said: Declaration, ports: Ports
) -> list[tuple[str, str]]:
    """Points and their channels: one by the file's name, or all channels that a ``response`` with {output} fits."""
    if "{output}" not in response:
        return [(name.output or "", response)]
    expression = re.escape(response).replace(re.escape("{output}"), "(.+?)")
    known = [p.name for p in ports[0]]
    found = [(_mapped(m[1], said.points, known), c) for c in waveforms(name.file, said)
             if (m := re.fullmatch(expression, c))]  # fmt: skip
    if not found:
        raise DataError(
            f"{name.file}: no channel fits response = '{response}'; it has {', '.join(waveforms(name.file, said))}"
        )
    return [(o, c) for o, c in found if o in known] or found
