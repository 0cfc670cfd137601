"""Hostile scenarios: keys of the schema with values that no one should give, and what the program makes of each.

    python tests/hostile.py --count 3000 --seed 0 [--fem 0.01]

Each gets one sentence (a ForearmError of one line and at most 300 characters) or a result whose unknown numbers are
named in a note. Anything else is a fault: another exception, a warning, more than :data:`PATIENCE` seconds.
"""

from __future__ import annotations

import argparse
import math
import random
import signal
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import date
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import numpy as np
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from forearm_fem.device import close_loop
from forearm_fem.engines.forecast import refuse_if_signals_too_large
from forearm_fem.engines.layered import solve_layered
from forearm_fem.engines.simulation import render_transfer, simulate
from forearm_fem.errors import LONGEST_SENTENCE, AccuracyWarning, ForearmError
from forearm_fem.questions.run import Run, unknown_strengths
from forearm_fem.scenario import Scenario, parse_scenario
from forearm_fem.scenario.base import Within
from forearm_fem.scenario.limb import Bone, LayerThickness, TissueOverride
from forearm_fem.scenario.sweep import frequencies

PATIENCE = 60  # s: a busy machine's worst scene that is not hostile takes ten
FEW = {"f_min": 100.0, "f_max": 140.0, "duration": 0.1, "sample_rate": 2000.0}
LAYERED: dict[str, Any] = {"engine": "layered", "sweep": FEW, "rendering": {"targets": ["5", "6"]}}
SLAB: dict[str, Any] = {
    "limb": {"shape": "slab", "length": 0.06, "width": 0.06, "depth": 0.02},
    "mesh": {"size_contact": 0.005, "size_grid": 0.008, "size_far": 0.015, "sublayers": {"skin": 1, "fat": 1}},
    "device": {"spacing": 0.03, "cone": {"contact": "pressure"}},
    "sweep": {"frequencies": [100.0]},
    "solver": {"sweep": "direct", "discretisation_estimate": False},
    "rendering": {"methods": []},
}
TEXTS = ("", " ", "..", "a/b", "\0", "\u202e", "é", "x" * 5000, "nan", "1", "skin", "A1", "1\n2", "%s{}", "all", "bone")
NUMBERS = (0, -0.0, 1, -1, 5e-324, 1e-310, 1e-30, 1e-9, 1e-3, 0.5, 2, 3.7, 1e3, 1e9, 1e30, 1e300, -1e300, 10**400)
ODD = (float("nan"), float("inf"), True, False, None, [], {}, [[]], [{}], [None], date(2020, 1, 1), [1e300] * 3)


@dataclass(frozen=True)
class Outcome:
    """What became of a scenario: "sentence", "ran", or the fault "traceback", "warning", "hang" or "silent"."""

    kind: str
    text: str = ""


def leaves() -> list[tuple[tuple[str, ...], FieldInfo]]:
    """Paths and fields of all keys of the schema, of all kinds of its parts."""
    found = dict(_below(Scenario, ()))
    for name in ("skin", "muscle", "gel"):
        found |= {("tissues", "override", name, key): field for key, field in TissueOverride.model_fields.items()}
    return list(found.items())


def _below(model: type[BaseModel], path: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], FieldInfo]]:
    for name, field in model.model_fields.items():
        if kinds := [kind for kind in _kinds(field.annotation) if kind not in (LayerThickness, Bone)]:
            for kind in kinds:
                yield from _below(kind, (*path, name))
        else:
            yield (*path, name), field


def _kinds(annotation: Any) -> Iterator[type[BaseModel]]:
    """Parts that a key of this annotation may be."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    elif get_origin(annotation) in (Annotated, Union, UnionType):
        for inside in get_args(annotation):
            yield from _kinds(inside)


def value(rng: random.Random, depth: int = 0) -> Any:
    """Anything: numbers at the borders, near them, text, lists, tables, dates."""
    kind = rng.randrange(9 if depth < 2 else 5)
    if kind < 2:
        return rng.choice(NUMBERS)
    if kind == 2:
        return rng.choice((1, -1)) * 10 ** rng.uniform(-8, 8)
    if kind == 3:
        return rng.choice(TEXTS)
    if kind == 4:
        return rng.choice(ODD)
    if kind == 5:
        return [value(rng, depth + 1) for _ in range(rng.randrange(4))]
    if kind == 6:
        return [[rng.uniform(-0.05, 0.05), rng.uniform(-0.05, 0.05)] for _ in range(rng.randrange(1, 6))]
    if kind == 7:
        model = rng.choice((LayerThickness, Bone, TissueOverride))
        return [{key: value(rng, depth + 1) for key in model.model_fields} for _ in range(rng.randrange(3))]
    return {rng.choice(TEXTS): value(rng, depth + 1) for _ in range(rng.randrange(3))}


def legal(rng: random.Random, annotation: Any, metadata: Sequence[Any] = ()) -> Any:
    """A value that the schema lets pass, often at the border of its range."""
    if ranges := [m for m in metadata if isinstance(m, Within)]:
        return _within(rng, ranges[0], whole=annotation is int)
    arguments = get_args(annotation)
    if hasattr(annotation, "__metadata__"):
        return legal(rng, arguments[0], annotation.__metadata__)
    if get_origin(annotation) is Literal:
        return rng.choice(arguments)
    if get_origin(annotation) in (Union, UnionType):
        return legal(rng, rng.choice([a for a in arguments if a is not type(None)]))
    if get_origin(annotation) is tuple:
        kinds = [arguments[0]] * rng.randrange(1, 5) if arguments[-1] is Ellipsis else arguments
        return [legal(rng, kind) for kind in kinds]
    if get_origin(annotation) is dict:
        return {rng.choice(("skin", "fat", "muscle", "bone", "gel")): legal(rng, arguments[1])}
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return {name: legal(rng, f.annotation, f.metadata) for name, f in annotation.model_fields.items()}
    if annotation is bool:
        return rng.random() < 0.5
    if annotation is str:
        return rng.choice(("skin", "fat", "muscle", "bone", "A1", "5", "1", "thing"))
    return rng.uniform(0.01, 0.9)


def _within(rng: random.Random, found: Within, *, whole: bool) -> float:
    low, high = found.low, found.high
    if whole:
        return rng.choice((int(low), rng.randint(int(low), int(min(high, low + 5))), int(high)))
    if low <= 0:
        return rng.choice((low, high, 0.0, rng.uniform(low, high), rng.uniform(-0.03, 0.03)))
    between = math.exp(rng.uniform(math.log(low), math.log(high)))
    return rng.choice((low, high, between, between, 0.0 if found.zero else between))


def scenario_data(seed: int, base: dict[str, Any]) -> dict[str, Any]:
    """``base`` with one to three keys replaced, by anything or by what the schema lets pass."""
    rng, data = random.Random(seed), _copied(base)
    keys = leaves()
    wild = rng.random() < 0.4
    for _ in range(rng.choice((1, 1, 2, 3))):
        path, field = rng.choice(keys)
        path = path[: rng.randrange(1, len(path) + 1)] if wild and rng.random() < 0.1 else path
        path = (*path[:-1], path[-1] + "x") if wild and rng.random() < 0.03 else path
        place = data
        for key in path[:-1]:
            inside = place.setdefault(key, {})
            place = inside if isinstance(inside, dict) else place
        place[path[-1]] = value(rng) if wild else legal(rng, field.annotation, field.metadata)
    return data


def _copied(data: Any) -> Any:
    return {k: _copied(v) for k, v in data.items()} if isinstance(data, dict) else data


def outcome(data: dict[str, Any], *, render: bool = True) -> Outcome:
    """Parse, solve and render; the fault if there is one."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            warnings.simplefilter("ignore", AccuracyWarning)
            with alarm(PATIENCE):
                return _judged(data, render)
    except ForearmError as problem:
        text = str(problem)
        fine = 0 < len(text) <= LONGEST_SENTENCE and text.isprintable()
        return Outcome("sentence" if fine else "traceback", text)
    except TimeoutError:
        return Outcome("hang", traceback.format_exc(limit=-4))
    except Warning as problem:
        return Outcome("warning", f"{problem!r}\n{traceback.format_exc(limit=-3)}")
    except Exception as problem:
        return Outcome("traceback", f"{problem!r}\n{traceback.format_exc(limit=-3)}")


def _judged(data: dict[str, Any], render: bool) -> Outcome:
    scenario = parse_scenario(data)
    notes = Run.start(scenario, None, None).notes  # nothing is written
    refuse_if_signals_too_large(scenario)
    band = frequencies(scenario.sweep)
    if scenario.engine == "fem":
        if len(scenario.grid.places) > 100 or len(band) > 4:
            return Outcome("ran", "parsed: large")
        transfer = simulate(scenario).transfer
    else:
        if len(scenario.grid.places) > 100:
            return Outcome("ran", "parsed: large")
        some = band[np.unique(np.linspace(0, len(band) - 1, 3).astype(int))] if len(band) > 6 else band
        transfer = close_loop(solve_layered(scenario, some), scenario.device)
    if not np.isfinite(transfer.values).all() and not notes and not transfer.errors:
        return Outcome("silent", "G is not finite")
    samples = scenario.sweep.duration * scenario.sweep.sample_rate
    if render and scenario.rendering.methods and samples * len(scenario.grid.places) < 2e6:
        rendering = render_transfer(scenario, replace(transfer, valid=None))
        if not np.isfinite(rendering.strengths).all() and not unknown_strengths(rendering):
            return Outcome("silent", "S is not finite")
    if not np.isfinite(transfer.values).all():
        return Outcome("silent", f"G is not finite: {transfer.values.ravel()[:3]}")
    return Outcome("ran")


class alarm:  # noqa: N801  # reads as a word: with alarm(60)
    """TimeoutError in the main thread after some seconds (POSIX; elsewhere nothing)."""

    def __init__(self, seconds: int) -> None:
        self.seconds = seconds

    def __enter__(self) -> None:
        if hasattr(signal, "SIGALRM"):
            signal.signal(signal.SIGALRM, _ring)
            signal.alarm(self.seconds)

    def __exit__(self, *_: object) -> None:
        if hasattr(signal, "SIGALRM"):
            signal.alarm(0)


def _ring(*_: object) -> None:
    raise TimeoutError


def main() -> None:
    """Counts, and every fault."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--seed", type=int, default=0, help="of the first; the others follow")
    parser.add_argument("--fem", type=float, default=0.0, help="share solved on a small slab with finite elements")
    asked = parser.parse_args()
    counts, start = Counter[str](), time.perf_counter()
    for seed in range(asked.seed, asked.seed + asked.count):
        base = SLAB if random.Random(-seed).random() < asked.fem else LAYERED
        begun = time.perf_counter()
        found = outcome(scenario_data(seed, base))
        counts[found.kind] += 1
        if found.kind not in ("sentence", "ran"):
            print(f"seed {seed}: {found.kind}: {found.text}", flush=True)
        if (took := time.perf_counter() - begun) > 10:
            print(f"seed {seed}: {took:.0f} s, {found.kind}", flush=True)
    print(f"{dict(counts)} in {time.perf_counter() - start:.0f} s")


if __name__ == "__main__":
    main()
