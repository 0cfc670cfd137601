"""Public functions given lists, whole numbers, text and things of another kind: the right answer, or one sentence."""

from __future__ import annotations

import inspect
import math
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from test_measurement_scene import INPUTS, OUTPUTS, part, wave_matrix

from forearm_fem import device, layered, metrics, rendering, transfer
from forearm_fem.arguments import checked
from forearm_fem.errors import DataError, ForearmError
from forearm_fem.scenario.device import device_of
from forearm_fem.store.results import strength_rows
from forearm_fem.transfer import Compliance, ErrorEstimate
from forearm_fem.typing import BoolArray, ComplexArray, FloatArray, IntArray

G = part(wave_matrix(np.arange(50.0, 460.0, 10.0)), 9, 4)
WAVELET = rendering.ricker(150.0, sample_rate=2000.0, duration=0.1)
RECORD = WAVELET.record
PLACED = rendering.place(G, RECORD)
SENT = rendering.drives(rendering.Funneling(), PLACED, "5", WAVELET)
TIME = np.linspace(-1, 1, 40)
MOVED = np.arange(1.0, 4.0)[:, None] * np.sin(20 * TIME)
F = np.arange(10.0, 14.0)
MATRIX = np.arange(1.0, 25.0).reshape(4, 3, 2) ** 2 + 1j
ERROR = ErrorEstimate("measurement", 0.1, "told", (10.0, 20.0), (0.1, 0.2))
PORTS = (*INPUTS, *OUTPUTS)
SKIN = Compliance(F, np.full((4, 13, 13), 1e-4 - 1e-5j) + 1e-3 * np.eye(13), PORTS)
LAYERS = (layered.Layer(math.inf, 1000.0, lambda omega: np.asarray(5000 + 5j * omega, dtype=complex)),)

CASES: dict[str, tuple[Callable[..., Any], dict[str, Any]]] = {
    "area": (metrics.area, {"displacement": MOVED, "time": TIME, "window": (-0.5, 0.5)}),
    "signal_strength": (metrics.signal_strength, {"displacement": MOVED, "target": 1}),
    "signal_strength_table": (
        metrics.signal_strength_table, {"methods": ("a", "b"), "targets": ("5", "2"), "strengths": np.ones((2, 2))},
    ),
    "contrast": (metrics.contrast, {"areas": np.array([1.0, 2.0, 3.0]), "target": 2}),
    "spot_radius": (
        metrics.spot_radius, {"areas": np.array([1.0, 2.0]), "positions": np.eye(2), "target": 0},
    ),
    "fwhm": (metrics.fwhm, {"position": np.arange(5.0), "value": np.array([0.0, 1, 4, 1, 0])}),
    "condition_number": (metrics.condition_number, {"values": MATRIX}),
    "singular_values": (metrics.singular_values, {"values": MATRIX}),
    "condition_summary": (metrics.condition_summary, {"condition": np.array([2.0, 3.0, np.inf])}),
    "fit_waves": (
        metrics.fit_waves,
        {"frequency": F, "distance": np.arange(1.0, 6.0), "response": np.exp(-(0.3 + 0.2j) * np.ones((4, 1))
         * np.arange(1.0, 6.0))},
    ),
    "relative_error_at": (metrics.relative_error_at, {"estimate": ERROR, "frequency": F}),
    "smooth_noise": (
        metrics.smooth_noise, {"frequency": F, "shape": (2, 2), "rng": np.random.default_rng(0), "correlation": 5.0},
    ),
    "relative_error": (transfer.relative_error, {"estimate": 1.1 * MATRIX, "truth": MATRIX}),
    "band_error": (transfer.band_error, {"estimate": 1.1 * MATRIX, "truth": MATRIX}),
    "entry_errors": (transfer.entry_errors, {"transfer": G}),
    "finite": (transfer.finite, {"transfer": G}),
    "ricker": (rendering.ricker, {"peak_hz": 100.0, "amplitude": 2.0, "sample_rate": 2000.0, "duration": 0.5}),
    "to_spectrum": (rendering.to_spectrum, {"signals": WAVELET.samples, "record": RECORD}),
    "to_time": (
        rendering.to_time, {"spectrum": np.ones((3, 2)) + 1j, "index": np.array([5, 6, 7]), "record": RECORD},
    ),
    "place": (rendering.place, {"transfer": G, "record": RECORD}),
    "place_on_bins": (
        rendering.place_on_bins, {"frequency": G.frequency, "values": G.values, "sample_rate": 2000.0, "duration": 0.1},
    ),
    "drives": (rendering.drives, {"renderer": rendering.Funneling(), "transfer": G, "target": "5", "wavelet": WAVELET}),
    "displacements": (rendering.displacements, {"transfer": G, "drives": SENT}),
    "respond": (rendering.respond, {"placed": PLACED, "spectrum": np.ones((len(PLACED.bins.index), 4)) + 0j}),
    "scaled": (rendering.scaled, {"drives": SENT, "factor": 2.0}),
    "scale_to": (rendering.scale_to, {"drives": SENT, "transfer": G, "target_peak": 1e-6}),
    "check": (rendering.check, {"drives": SENT, "limits": rendering.Limits()}),
    "bridged": (rendering.bridged, {"transfer": G}),
    "funneling_weights": (rendering.funneling_weights, {"inputs": INPUTS, "target": OUTPUTS[4]}),
    "invert": (
        rendering.invert,
        {"matrix": MATRIX, "wanted": np.ones((4, 3)) + 0j, "regularisation": rendering.Regularisation(),
         "frequency": F},
    ),
    "render_all": (rendering.render_all, {"transfer": G, "targets": ["5"], "wavelet": WAVELET}),
    "strengths": (
        rendering.strengths,
        {"transfer": G, "targets": ["5"], "methods": [rendering.Funneling()], "wavelet": WAVELET},
    ),
    "close_loop": (device.close_loop, {"compliance": SKIN, "device": device_of()}),
    "power": (device.power, {"compliance": SKIN, "device": device_of(), "drives": np.ones((4, 4)) + 0j}),
    "driving_point_impedance": (device.driving_point_impedance, {"compliance": SKIN}),
    "boussinesq": (layered.boussinesq, {"r": np.array([0.01, 0.02]), "mu": 5e3, "nu": 0.5}),
    "rayleigh_wavenumber": (
        layered.rayleigh_wavenumber, {"omega": F, "mu": 5e3 + 5j * F, "rho": 1000.0},
    ),
    "bonded_disc": (layered.bonded_disc, {"radius": 0.01, "mu": 5e3, "nu": 0.3}),
    "layered_compliance": (
        layered.layered_compliance,
        {"layers": LAYERS, "omega": np.array([300.0, 600.0]), "discs_in": (layered.Disc(0.0, 0.0, 0.003),),
         "discs_out": (layered.Disc(0.02, 0.0),)},
    ),
    "surface_kernel": (layered.surface_kernel, {"k": np.array([100.0, 200.0]), "omega": 300.0, "layers": LAYERS}),
    "strength_rows": (
        strength_rows, {"methods": ("a",), "targets": ("5", "2"), "strengths": np.array([[1.0, 2.0]])},
    ),
}  # fmt: skip


def called(function: Callable[..., Any], arguments: dict[str, Any]) -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return function(**arguments)


def alike(one: Any, other: Any) -> bool:
    """Whether two results say the same, whatever holds them."""
    if isinstance(one, np.ndarray | float | complex | int):
        return bool(np.allclose(one, other, equal_nan=True))
    if isinstance(one, tuple):
        return all(alike(a, b) for a, b in zip(one, other, strict=True))
    if hasattr(one, "__dict__"):
        return all(alike(v, vars(other)[k]) for k, v in vars(one).items())
    return type(one) is type(other)


def rng_again(arguments: dict[str, Any]) -> dict[str, Any]:
    return {k: np.random.default_rng(0) if k == "rng" else v for k, v in arguments.items()}


@pytest.mark.parametrize("name", CASES)
def test_lists_and_whole_numbers_do_as_well_as_arrays_and_decimals(name):
    """``signal_strength`` of a list ended in an AttributeError."""
    function, given = CASES[name]
    listed = {
        k: v.tolist() if isinstance(v, np.ndarray) else int(v) if isinstance(v, float) and v.is_integer()
        else float(v) if isinstance(v, int) else v
        for k, v in given.items()
    }  # fmt: skip
    assert alike(called(function, rng_again(given)), called(function, rng_again(listed)))


TWIN = "forearm_fem.layered"
WRONG = ("x", b"x", [1.0, [2.0, 3.0]], object(), {}, np.nan, -1, 1j, [], np.zeros((2, 0)), np.ones((2, 2, 2, 2)), True)


@pytest.mark.parametrize("name", CASES)
def test_anything_else_is_an_answer_or_one_sentence(name):
    function, given = CASES[name]
    for key in given:
        for wrong in (*WRONG, None):
            # the layered twin documents its ValueError
            allowed = (ForearmError, ValueError) if function.__module__.startswith(TWIN) else ForearmError
            try:
                called(function, rng_again({**given, key: wrong}))
            except allowed:
                continue
            except Exception as problem:
                pytest.fail(f"{key} = {wrong!r}: {problem!r}")


def test_what_is_refused_names_function_argument_and_what_came():
    with pytest.raises(DataError, match="signal_strength: displacement: expected an array of real numbers, got 'x'"):
        metrics.signal_strength("x", 0)
    with pytest.raises(DataError, match=r"signal_strength: target: expected a whole number, got 0\.5"):
        metrics.signal_strength([[1.0], [2.0]], 0.5)
    with pytest.raises(DataError, match=r"displacements: transfer: expected a TransferMatrix or a Placed, got \[1"):
        rendering.displacements([1.0], SENT)
    with pytest.raises(DataError, match=r"of real numbers, got an array \(3, 40\) of complex128"):
        metrics.signal_strength(MOVED + 1j, 0)


def test_masked_entries_are_unknown_and_not_what_lies_under_the_mask():
    masked = np.ma.masked_array(MOVED, mask=np.zeros(MOVED.shape, dtype=bool))
    masked[2] = np.ma.masked
    with pytest.warns(UserWarning, match="leaves out 1 of 2"):
        assert metrics.signal_strength(masked, 1) == pytest.approx(2.0)


def test_a_checked_function_is_itself_for_readers_and_right_arguments():
    def plain(
        a: FloatArray, *, b: ComplexArray | None = None, c: IntArray | BoolArray | None = None, d: int | None = None,
        e: str = "",
    ) -> tuple[Any, ...]:  # fmt: skip
        """What it does."""
        return a, b, c, d, e

    bordered = checked(plain)
    array = np.ones(3)
    assert bordered(array)[0] is array
    assert bordered.__doc__ == plain.__doc__
    assert inspect.signature(bordered) == inspect.signature(plain)
    a, b, c, d, e = bordered([1, 2], b=[1j], c=[1, 2], d=3.0, e="x")
    assert (a.dtype, b.dtype, c.dtype.kind, d, e) == (float, complex, "i", 3, "x")
    assert bordered([1], c=[True])[2].dtype == bool
    assert type(d) is int
    for wrong in ({"d": 2.5}, {"d": True}, {"e": 1}, {"c": [0.5]}, {"b": ["1"]}):
        with pytest.raises(DataError, match=f"plain: {next(iter(wrong))}: expected"):
            bordered([1], **wrong)
