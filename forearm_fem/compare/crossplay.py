"""What a calibration is worth: renderers designed on one G and played through another."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import AccuracyWarning, DataError, ForearmError
from ..rendering import Renderer, Wavelet, Window, bridged, drives, place, ricker, strengths, thesis_renderers
from ..rendering.sharing import prepared
from ..scenario.rendering import SampledWavelet
from ..transfer import TransferMatrix
from ..typing import FloatArray
from .common import CommonGround

if TYPE_CHECKING:
    from ..scenario import Scenario

_PER_PEAK = 16.0  # samples per period of the wavelet's peak frequency


@dataclass(frozen=True, eq=False)
class CrossPlay:
    """S (n_method, n_target) [-] of drives made for the first-named G and played on the second.

    ``a_on_b`` is what a device gets that was calibrated on A when the arm is B; ``b_on_b`` the best it could get.
    ``how`` says whose renderers and which wavelet these are of.
    """

    methods: tuple[str, ...]
    targets: tuple[str, ...]
    a_on_a: FloatArray
    b_on_b: FloatArray
    a_on_b: FloatArray
    b_on_a: FloatArray
    how: str = ""

    @property
    def worth(self) -> FloatArray:
        """S of A's drives on B over S of B's own (n_method, n_target) [-]; 1 where A serves as well as B."""
        return np.asarray(self.a_on_b / self.b_on_b)


def cross_play(
    ground: CommonGround,
    *,
    targets: Sequence[str] | None = None,
    folders: Sequence[Path] = (),
) -> CrossPlay:
    """S at ``targets``, own and crossed, on the common frequencies.

    Renderers, wavelet, window and, without ``targets``, these are of the scenario in A's provenance, else of B's, so
    that A on A is the S that A's run printed; its wavelet's file is looked for in ``folders`` too. Where no scenario's
    bins are the common ones, its wavelet is set into a record whose bins they are, and S is not what its run printed;
    ``how`` says so. Without a scenario they are the thesis' three, its wavelet and all targets.
    Holes of either are bridged as in a run; bins that either still lacks are driven on neither, so that only the values
    differ. Raises ForearmError where a renderer cannot work on this geometry or the frequencies lie too far apart.
    """
    a, b = (bridged(g).transfer for g in sides(ground))
    every = tuple(p.name for p in ground.outputs)
    own = rendering_of(ground, folders) or _Own(
        thesis_renderers(), every, wavelet_for(ground.frequency), "wavelet", "the thesis' renderers"
    )
    shape, chosen, window = own.wavelet, own.methods, own.window
    aims = own.targets if targets is None else tuple(targets)
    ready = [prepared(place(g, shape.record), chosen, aims) for g in (a, b)]
    for_a, for_b = ([[drives(m, p, t, shape) for t in aims] for m in methods] for p, methods in ready)
    return CrossPlay(
        tuple(m.name for m in chosen),
        aims,
        a_on_a=strengths(a, aims, chosen, shape, fixed=for_a, window=window),
        b_on_b=strengths(b, aims, chosen, shape, fixed=for_b, window=window),
        a_on_b=strengths(b, aims, chosen, shape, fixed=for_a, window=window),
        b_on_a=strengths(a, aims, chosen, shape, fixed=for_b, window=window),
        how=f"{own.whose} with the wavelet {shape.name}{own.apart}",
    )


@dataclass(frozen=True, eq=False)
class _Own:
    """What a run rendered with."""

    methods: tuple[Renderer, ...]
    targets: tuple[str, ...]
    wavelet: Wavelet
    window: Window
    whose: str
    apart: str = ""


def rendering_of(ground: CommonGround, folders: Sequence[Path] = ()) -> _Own | None:
    """The rendering of the scenario that one side came from; None where neither names one, its wavelet's file is in
    none of ``folders`` and not in the current one (said by an AccuracyWarning).

    One whose bins are the common ones comes first; of another the wavelet is set into a record that fits them, which
    can be done with a Ricker wavelet alone."""
    from ..pipeline.renderers import renderers, unsuited
    from ..scenario import parse_scenario

    other: _Own | None = None
    for provenance in ground.provenance:
        known = provenance.get("scenario")
        if not isinstance(known, Mapping):
            continue
        try:
            scenario = parse_scenario(dict(known))
            options = scenario.rendering
            shape = _kept_wavelet(scenario, folders)
        except ForearmError as problem:
            warnings.warn(
                f"the renderers of scenario '{known.get('name', '')}' could not be used ({problem}): unless the other "
                "G names a scenario, S in this comparison is of the thesis' renderers and the 250 Hz Ricker wavelet, "
                "not what its run printed",
                AccuracyWarning,
                stacklevel=3,
            )
            continue
        place = ground.frequency / shape.record.df
        if not options.methods:
            continue
        whose, apart = f"the renderers of scenario '{scenario.name}'", ""
        on_bins = np.allclose(place, np.rint(place), rtol=0, atol=1e-3)
        if not on_bins:
            if other is not None or isinstance(options.wavelet, SampledWavelet) or len(ground.frequency) < 2:
                continue
            shape = wavelet_for(ground.frequency, options.wavelet.peak)
            apart = "; its bins are not the common frequencies, so that its run printed another S"
        targets = [p.name for p in ground.outputs] if options.targets == "all" else list(options.targets)
        left_out = frozenset(unsuited(options, ground.outputs, ground.inputs, targets))
        own = _Own(tuple(renderers(scenario, shape, left_out)), tuple(targets), shape, options.window, whose, apart)
        if on_bins:
            return own
        other = own
    return other


def _kept_wavelet(scenario: Scenario, folders: Sequence[Path]) -> Wavelet:
    """The scenario's wavelet; of a file the copy that a run keeps in its folder, else the file itself."""
    from ..pipeline.renderers import wavelet

    if not isinstance(given := scenario.rendering.wavelet, SampledWavelet):
        return wavelet(scenario.rendering, scenario.sweep, Path("."))
    file = given.file
    places = [p for folder in folders for p in (folder / f"wavelet{Path(file).suffix}", folder / file)]
    found = next((p for p in places if p.is_file()), Path(file))
    return wavelet(scenario.rendering.changed({"wavelet.file": str(found.resolve())}), scenario.sweep, Path("."))


def sides(ground: CommonGround) -> tuple[TransferMatrix, TransferMatrix]:
    """A and B as transfer matrices on the common frequencies, both with the common mask and A's ports."""
    first = TransferMatrix(ground.frequency, ground.a, ground.outputs, ground.inputs, ground.unit, valid=ground.valid)
    return first, replace(first, values=ground.b)


def wavelet_for(frequency: FloatArray, peak: float = 250.0) -> Wavelet:
    """A Ricker wavelet of ``peak`` [Hz] in a record whose bins hold ``frequency`` (n,) [Hz] where these are evenly
    spaced from 0; else the thesis' record of 2 s at 10 kHz, onto whose bins G is interpolated where that is safe."""
    if len(frequency) < 2:
        raise DataError("rendering needs at least two frequencies")
    df = float(np.median(np.diff(frequency)))
    k = frequency / df
    if not np.allclose(k, np.rint(k), atol=1e-6 * k.max()):
        return ricker(peak)
    n = 2 * math.ceil(max(_PER_PEAK * peak, 4 * float(frequency[-1])) / df / 2)
    return ricker(peak, sample_rate=n * df, duration=1 / df)


def try_cross_play(ground: CommonGround, folders: Sequence[Path] = ()) -> tuple[CrossPlay | None, str]:
    """:func:`cross_play`, or None and the sentence that says why there is none."""
    try:
        return cross_play(ground, folders=folders), ""
    except ForearmError as problem:
        return None, str(problem)
