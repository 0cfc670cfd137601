"""Worth of a calibration: renderers designed on one G and played through another."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...errors import AccuracyWarning, ForearmError
from ...metrics.common_ground import CommonGround
from ...rendering import Wavelet, bridged, thesis_renderers
from ...rendering.job import RenderJob, wavelet, wavelet_for
from ...scenario.rendering import SampledWavelet
from ...transfer import TransferMatrix
from ...typing import FloatArray

if TYPE_CHECKING:
    from ...scenario import Scenario


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
    differ. Points of which one knows nothing from some actuator are left out of both. Raises ForearmError where a
    renderer cannot work on this geometry or the frequencies lie too far apart.
    """
    ground = of_known_outputs(ground)
    a, b = (bridged(g).transfer for g in sides(ground))
    every = tuple(p.name for p in ground.outputs)
    found = rendering_of(ground, folders) or (
        RenderJob(thesis_renderers(), wavelet_for(ground.frequency), every),
        "the thesis' renderers",
        "",
    )
    job, whose, apart = found
    job = job if targets is None else replace(job, targets=tuple(targets))
    (a_on_a, a_on_b), (b_on_a, b_on_b) = (job.strengths(g, a, b)[0] for g in (a, b))
    how = f"{whose} with the wavelet {job.wavelet.name}{apart}"
    return CrossPlay(job.names, job.targets, a_on_a, b_on_b, a_on_b, b_on_a, how)


def of_known_outputs(ground: CommonGround) -> CommonGround:
    """The ground of the outputs that both know from every input, the others left out; whole where too few are left."""
    known = ground.whole_outputs
    if known.all() or np.count_nonzero(known) < 2:
        return ground
    deviations = [None if d is None else d[:, known] for d in (ground.deviation_a, ground.deviation_b)]
    return replace(
        ground, a=ground.a[:, known], b=ground.b[:, known], valid=ground.valid[:, known],
        deviation_a=deviations[0], deviation_b=deviations[1],
        outputs=tuple(p for p, k in zip(ground.outputs, known, strict=True) if k),
    )  # fmt: skip


def rendering_of(ground: CommonGround, folders: Sequence[Path] = ()) -> tuple[RenderJob, str, str] | None:
    """The rendering of the scenario that one side came from, whose it is, and how it differs from its run's.

    None where neither names one, its wavelet's file is in none of ``folders`` and not in the current one (said by an
    AccuracyWarning).

    One whose bins are the common ones comes first; of another the wavelet is set into a record that fits them, which
    can be done with a Ricker wavelet alone."""
    from ...scenario import parse_scenario

    other: tuple[RenderJob, str, str] | None = None
    own_ports, _ = sides(ground)
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
        own = RenderJob.of(scenario, own_ports, shape=shape), whose, apart
        if on_bins:
            return own
        other = own
    return other


def _kept_wavelet(scenario: Scenario, folders: Sequence[Path]) -> Wavelet:
    """The scenario's wavelet; of a file the copy that a run keeps in its folder, else the file itself."""
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


def try_cross_play(ground: CommonGround, folders: Sequence[Path] = ()) -> tuple[CrossPlay | None, str]:
    """:func:`cross_play`, or None and the sentence that says why there is none."""
    try:
        return cross_play(ground, folders=folders), ""
    except ForearmError as problem:
        return None, str(problem)
