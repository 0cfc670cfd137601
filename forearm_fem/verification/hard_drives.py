"""Hard cases of inversion: what renderers do with degenerate transfer matrices."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache

import numpy as np

from ..device import close_loop
from ..pipeline.layered_engine import solve_layered
from ..rendering import InverseFilter, displacements, drives, ricker
from ..rendering.inversion import Regularisation
from ..scenario import Scenario, parse_scenario
from ..transfer import TransferMatrix
from .rows import HardCase, HardResult

_BAND = np.arange(10.0, 500.1, 5.0)


def _scenario(**device: object) -> Scenario:
    return parse_scenario({"engine": "layered", "device": {"drive": "force", **device}})


@lru_cache(maxsize=1)
def _transfer() -> TransferMatrix:
    """G [m/N] of the default layers, every 5 Hz."""
    scenario = _scenario()
    return close_loop(solve_layered(scenario, _BAND), scenario.device)


def _reached(transfer: TransferMatrix, renderer: InverseFilter) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    return np.asarray(displacements(transfer, drives(renderer, transfer, "5", ricker(duration=0.2))).values)


def identical_actuators() -> Iterator[HardResult]:
    """A4 a copy of A3: the best that three actuators can do is still reached."""
    g = _transfer()
    twice = replace(g, values=g.values[:, :, [0, 1, 2, 2]], contacts=None)
    three = replace(g, values=g.values[:, :, :3], inputs=g.inputs[:3], contacts=None)
    renderer = InverseFilter(zeros=("1", "3", "7", "9"), regularisation=Regularisation(value=1e-9))
    a, b = _reached(twice, renderer), _reached(three, renderer)
    gap = float(np.abs(a - b).max() / np.abs(b).max())
    yield HardResult("", f"peak {np.abs(a).max():.3g} m at rank 3 of 4", gap, 1e-6)


def out_of_contact() -> Iterator[HardResult]:
    """A1 exerts no force: its column is zero and its drive must be, too."""
    scenario = _scenario(out_of_contact=("A1",))
    g = close_loop(solve_layered(scenario, _BAND), scenario.device)
    sent = drives(InverseFilter(zeros=("1", "3", "7", "9")), g, "5", ricker(duration=0.2))
    loudest = float(np.abs(sent.signals[0]).max())
    yield HardResult("", f"drive of A1 {loudest:.1e} N", loudest, 1e-12)


def target_is_zero() -> Iterator[HardResult]:
    """The target is one of the points to be kept still: to be refused."""
    drives(InverseFilter(zeros=("5", "1")), _transfer(), "5", ricker(duration=0.2))
    yield HardResult("", "rendered", np.inf, 0.0)


def missing_bins() -> Iterator[HardResult]:
    """Every seventh bin is NaN: the drive must be finite, and the loss no larger than the bins' share."""
    g = _transfer()
    values = g.values.copy()
    values[::7] = np.nan
    holes = replace(g, values=values, valid=np.isfinite(values.real), contacts=None)
    renderer, wavelet = InverseFilter(zeros=("1", "3", "7", "9")), ricker(duration=0.2)
    full, part = (displacements(g, drives(renderer, x, "5", wavelet)).values for x in (g, holes))
    loss = float(np.abs(full - part).max() / np.abs(full).max())
    yield HardResult("", f"finite; peak {np.abs(part).max():.3g} m", loss if np.isfinite(part).all() else np.inf, 0.3)


def noise() -> Iterator[HardResult]:
    """Drives from a noisy G, judged on the true one: the loss follows the noise until 0 dB ruins it, visibly."""
    g, rng = _transfer(), np.random.default_rng(1)
    # Tikhonov at the noise's own size; amplification by the condition number is then about 1 to 2
    for decibel in (60, 40, 20, 0):
        size = 10 ** (-decibel / 20)
        rms = np.sqrt(np.mean(np.abs(g.values) ** 2, axis=(1, 2), keepdims=True) / 2)
        dirty = g.values + size * rms * (rng.normal(size=g.values.shape) + 1j * rng.normal(size=g.values.shape))
        renderer = InverseFilter(("1", "3", "7", "9"), Regularisation("tikhonov", max(1e-3, min(size, 0.9))))
        wavelet = ricker(duration=0.2)
        noisy = replace(g, values=dirty, contacts=None)
        clean, real = (displacements(g, drives(renderer, x, "5", wavelet)).values for x in (g, noisy))
        loss = float(np.abs(clean - real).max() / np.abs(clean).max())
        yield HardResult(f"noise {decibel} dB below G, Tikhonov", f"displacements off by {loss:.1%}", loss, 3 * size)


DRIVES: tuple[HardCase, ...] = (
    HardCase("two identical actuators", "rank-deficient H against three actuators", identical_actuators),
    HardCase("actuator out of contact", "zero column in H", out_of_contact),
    HardCase("target equal to a zero point", "impossible wish", target_is_zero),
    HardCase("bins missing", "every seventh bin NaN and masked", missing_bins),
    HardCase("noise 0-60 dB", "inverse filter on a noisy G", noise),
)
