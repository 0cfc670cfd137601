"""A prediction in numbers: ``prediction.json``, which reports and tables of the same scene quote."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ... import __version__
from ...laws import REFERENCE
from ...store.text import write_json
from ...tissue import resolve_tissues
from ...typing import FloatArray
from .draws import kept_tissues
from .run import Prediction
from .statistics import LEVELS, Draws, IntervalSamples, quantiles, rank_correlations, sobol_indices, winners

FOLDER, FILE = "prediction", "prediction.json"
READING = "played"  # what a builder asks for; "reported" is what Table I is compared with


def summary(prediction: Prediction, sobol: bool = True) -> dict[str, Any]:
    """All that is said of a prediction, in plain numbers; quantiles are at ``levels``. NaN becomes None.

    ``failed`` says of how many arms there is no S, and why; ``numerics`` are e_band of the arms' G and what it leaves
    their S, as a factor to either side.
    """
    draws, nominal, asked = prediction.draws, prediction.nominal, prediction.question
    played, reported, record = (draws.enclosed(name) for name in ("played", "reported", "played, record"))
    groups = draws.groups
    grouped = played.of_groups(groups)
    return {
        "program": __version__, "scenario": asked.scenario.model_dump(mode="json"), "question": asked.digest,
        "seed": asked.seed, "laws": list(asked.laws), "held": list(prediction.held), "model": prediction.model,
        "left_out": prediction.left_out,
        "kept_tissues": list(kept_tissues(asked.scenario)),
        "draws": len(grouped.value),
        "failed": dict(draws.problems),
        "numerics": {
            "median": float(np.median(draws.numerics)), "largest": float(draws.numerics.max()),
            "factor": float(np.exp(np.median(draws.spread))), "largest factor": float(np.exp(draws.spread.max())),
        },
        "shorter_waves": shorter_waves(prediction),
        "unknown": prediction.unknown,
        "levels": list(LEVELS),
        "reading": READING,
        "methods": list(draws.methods),
        "targets": list(draws.targets),
        "groups": {g: [draws.targets[i] for i in c] for g, c in groups.items()},
        "by_target": _table(draws.methods, draws.targets, {
            "value": _aligned(nominal.value, prediction), "low": _aligned(nominal.low, prediction),
            "high": _aligned(nominal.high, prediction), **_spread(played), "reported": reported.quantiles(),
            "record": record.quantiles(), "wins": winners(played.value),
        }),
        "by_group": _table(draws.methods, tuple(groups), {
            **_spread(grouped), "reported": reported.of_groups(groups).quantiles(),
            "record": record.of_groups(groups).quantiles(), "wins": winners(grouped.value),
        }),
        "drivers": _drivers(draws, grouped.value, sobol),
        "seconds_per_draw": float(np.median(draws.seconds)),
    }  # fmt: skip


def shorter_waves(prediction: Prediction) -> dict[str, float] | None:
    """Of arms on a mesh: the ``share`` whose shear waves at 150 Hz are shorter in some tissue than the scene's own, for
    which the mesh was made, and the ``factor`` that one in twenty exceeds; None where arms have no mesh."""
    question, draws = prediction.question, prediction.draws
    if question.scenario.engine != "fem" or question.layered:
        return None
    own = {f"{n} stiffness": abs(complex(t.modulus.at(2 * np.pi * REFERENCE)))
           for n, t in resolve_tissues(question.scenario).items()}  # fmt: skip
    columns = [(draws.drivers[:, k], own[n]) for k, n in enumerate(draws.names) if n in own]
    if not columns:
        return None
    factor = np.sqrt(np.max([scene / drawn for drawn, scene in columns], axis=0))
    return {"share": float((factor > 1).mean()), "factor": float(np.quantile(factor, LEVELS[-1]))}


def _spread(arms: IntervalSamples) -> dict[str, FloatArray]:
    """Bands with what the arms' own numerics leave them and ``bare``, without; shares of arms with S above 1."""
    sure, shown, possible = arms.above(1.0)
    return {"arms": arms.quantiles(), "bare": quantiles(arms.value), "above_one": shown,
            "above_one_range": np.stack([sure, possible])}  # fmt: skip


def _drivers(draws: Draws, means: FloatArray, sobol: bool) -> list[dict[str, Any]]:
    """Influence of each input on the groups' ``means`` (n, n_method, n_group) of S."""
    found = {"rank": rank_correlations(draws.drivers, means)}
    if sobol:
        found["sobol"] = sobol_indices(draws.drivers, draws.names, means)
    return [
        {"name": name, **{what: _table(draws.methods, tuple(draws.groups), {"": values[k]}, flat=True)
                          for what, values in found.items()}}
        for k, name in enumerate(draws.names)
    ]  # fmt: skip


def _aligned(values: FloatArray, prediction: Prediction) -> FloatArray:
    """The scene's own numbers in the order of the draws' methods and targets."""
    nominal, draws = prediction.nominal, prediction.draws
    rows = [nominal.methods.index(m) for m in draws.methods]
    return np.asarray(values[np.ix_(rows, [nominal.targets.index(t) for t in draws.targets])])


def _table(
    methods: tuple[str, ...], columns: tuple[str, ...], parts: Mapping[str, FloatArray], flat: bool = False
) -> dict[str, Any]:
    """{method: {column: {part: number or list}}}; the last two axes of each part are method and column."""

    def cell(m: int, c: int) -> Any:
        """The parts of one method and column."""
        found = {name: _plain(values[..., m, c]) for name, values in parts.items()}
        return found[""] if flat else found

    return {method: {column: cell(m, c) for c, column in enumerate(columns)} for m, method in enumerate(methods)}


def _plain(values: Any) -> Any:
    if np.ndim(values):
        return [_plain(v) for v in values]
    return round(float(values), 6) if np.isfinite(values) else None


def write_summary(folder: str | Path, content: Mapping[str, Any]) -> Path:
    """``prediction.json`` in ``folder``."""
    file = Path(folder) / FILE
    write_json(file, content)
    return file
