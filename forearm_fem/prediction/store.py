"""``draws.nc``: every draw of a prediction with its inputs and its S, so that none is computed twice."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import xarray as xr

from ..errors import DataError
from ..io.dataset import labels, load, save, text
from ..typing import FloatArray
from .outcome import READINGS, Outcome

FILE = "draws.nc"
_CONTENT = "prediction"


def write_outcomes(
    path: Path, outcomes: Sequence[Outcome], methods: Sequence[str], targets: Sequence[str], digest: str,
    frequency: FloatArray, unit: str = "m/V",
) -> None:  # fmt: skip
    """All ``outcomes`` in the order of their numbers, whole or not at all; ``digest`` names the question.

    ``frequency`` (n,) [Hz] and ``unit`` are those of the G kept of some.
    """
    ordered = sorted(outcomes, key=lambda o: o.number)
    names = sorted({name for o in ordered for name in o.drivers})
    drivers = np.array([[o.drivers.get(name, np.nan) for name in names] for o in ordered]).reshape(len(ordered), -1)
    variables: dict[str, tuple[tuple[str, ...], Any, dict[str, str]]] = {
        "draw": (("draw",), np.array([o.number for o in ordered], dtype=np.int64), {"long_name": "number of the draw"}),
        "reading": (("reading",), labels(READINGS), {"long_name": "G that S is taken on, and over what"}),
        "method": (("method",), labels(tuple(methods)), {}),
        "target": (("target",), labels(tuple(targets)), {}),
        "driver": (("driver",), labels(tuple(names)), {}),
        "S": (
            ("draw", "reading", "method", "target"),
            np.array([o.strengths for o in ordered]).reshape(-1, len(READINGS), len(methods), len(targets)),
            {"units": "1", "long_name": "signal strength"},
        ),
        "drivers": (("draw", "driver"), drivers, {"long_name": "inputs of the draw, SI; NaN where it has none"}),
        "law": (("draw",), labels(tuple(o.law for o in ordered)), {}),
        "spread": (
            ("draw", "method", "target"),
            np.array([o.spread if o.spread.size else np.full((len(methods), len(targets)), np.nan) for o in ordered]),
            {"units": "1", "long_name": "half width of the interval of log S that the errors of the draw's G leave"},
        ),
        "numerics": (("draw",), np.array([o.numerics for o in ordered]), {"units": "1", "long_name": "e_band of G"}),
        "seconds": (("draw",), np.array([o.seconds for o in ordered]), {"units": "s"}),
        "problem": (("draw",), labels(tuple(o.problem for o in ordered)), {}),
    }
    if kept := [o for o in ordered if o.transfer is not None]:
        variables |= {
            "frequency": (("frequency",), np.asarray(frequency, dtype=float), {"units": "Hz"}),
            "kept": (("kept",), np.array([o.number for o in kept], dtype=np.int64), {"long_name": "draws with a G"}),
            "G": (
                ("kept", "frequency", "output", "input"), np.array([o.transfer for o in kept]),
                {"units": unit, "long_name": "true transfer matrix of the draw", "time_convention": "e^{+i omega t}"},
            ),
        }  # fmt: skip
    save(path, variables, {"content": _CONTENT, "question": digest})


def read_outcomes(path: Path, digest: str | None = None) -> list[Outcome]:
    """What :func:`write_outcomes` wrote; DataError if damaged, of an early version, or of another question than
    ``digest``."""

    def unpack(dataset: xr.Dataset) -> list[Outcome]:
        """Outcomes of the file; DataError where they are of another question or version."""
        if digest is not None and dataset.attrs["question"] != digest:
            raise DataError("holds draws of another question")
        if "spread" not in dataset:
            raise DataError("holds draws of a version before 0.16; run `forearm-fem predict` again")
        names, laws, problems = (text(dataset[k].values) for k in ("driver", "law", "problem"))
        drivers = [
            MappingProxyType({n: float(v) for n, v in zip(names, values, strict=True) if np.isfinite(v)})
            for values in dataset["drivers"].values
        ]
        rows = zip(
            dataset["draw"].values, laws, dataset["S"].values, drivers, dataset["numerics"].values,
            dataset["seconds"].values, problems, dataset["spread"].values, strict=True,
        )  # fmt: skip
        kept = dict(zip(dataset["kept"].values, dataset["G"].values, strict=True)) if "kept" in dataset else {}
        return [
            Outcome(int(n), law, s, driven, float(e), float(t), problem, kept.get(n), spread)
            for n, law, s, driven, e, t, problem, spread in rows
        ]

    return load(path, _CONTENT, unpack)
