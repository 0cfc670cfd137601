"""One draw from arm to S: its G, the G that is calibrated, drives designed on that, and S on both."""

from __future__ import annotations

import time
from collections.abc import Collection
from dataclasses import replace

import numpy as np

from ...device import close_loop
from ...errors import ReductionError
from ...laws import REFERENCE
from ...measurement.chain import reported
from ...rendering.interval import interval
from ...rendering.job import RenderJob
from ...results.draws import KEPT, READINGS, Outcome
from ...scenario import Scenario
from ...scenario.sweep import frequencies
from ...tissue import resolve_tissues
from ...transfer import finite, total_error
from .arm import ArmModel
from .draws import SOFT, Draw, idle_inputs, measured_of, scenario_of, soft_tissues

_MOST = 1.0  # e_band: nothing is known of a G that may be wrong by as much as it is
_DRAWS = 6  # of an arm's errors, for the interval of its S; all targets of a method are pooled


def outcome_of(draw: Draw, scene: Scenario, held: Collection[str], job: RenderJob, arm: ArmModel) -> Outcome:
    """S of ``draw`` of the ``scene``, whose inputs ``held`` keep its values, by the renderers of ``job``.

    Raises the :class:`ForearmError` of an arm that cannot be, or whose error is too large to say.
    """
    began = time.perf_counter()
    held = {*held, *arm.held}
    scenario = scenario_of(draw, scene, held)
    values = {name: value for name, value in draw.values.items() if name not in held}
    seen, at = measured_of(replace(draw, values=values), scenario), frequencies(scenario.sweep)
    answer, met = arm.answers(scenario, seen, at) if seen.grid != scenario.grid else (arm.answer(scenario, at), None)
    true, *others = (
        job.on_nominal_ports(finite(close_loop(c, scenario.device))) for c in (answer.compliance, *answer.others)
    )
    if not total_error(true.errors) < _MOST:
        raise ReductionError(f"G of the arm may be wrong by as much as it is: e_band is {_MOST:g} or more, or unknown")
    under = true if met is None else job.on_nominal_ports(finite(close_loop(met, seen.device)))
    measured = reported(under, seen, draw.generator("rig"))
    found = job.strengths(measured, true, measured, windows=(job.window, "record"))
    noise = tuple(e for e in true.errors if e.source not in answer.shown)
    spread = interval(true, noise, job.targets, job.span, job.methods, job.wavelet, draws=_DRAWS, others=others)
    return Outcome(
        draw.number, draw.law, found.reshape(len(READINGS), *found.shape[2:]), drivers_of(draw, scenario, held),
        total_error(true.errors), time.perf_counter() - began, spread=spread,
        transfer=true.values.astype(np.complex64) if draw.number < KEPT else None,
    )  # fmt: skip


def drivers_of(draw: Draw, scenario: Scenario, held: Collection[str]) -> dict[str, float]:
    """Candidate drivers of S: inputs, and of each drawn tissue its size |mu*| [Pa] and loss tangent at 150 Hz.

    Nothing of a tissue or layer that the limb has not, or of a part that the drive leaves out: chance would make
    it a driver.
    """
    tissue_input = {f"{t}." for t in SOFT}
    own, layers = soft_tissues(scenario), {layer.tissue for layer in getattr(scenario.limb, "layers", ())}
    absent = {f"{t} thickness" for t in SOFT if t not in layers} | idle_inputs(scenario)
    found = {
        name: value
        for name, value in draw.values.items()
        if name not in held and name not in absent and not any(name.startswith(t) for t in tissue_input)
    }
    if "tissue" not in held:
        for name, tissue in resolve_tissues(scenario).items():
            if name in own:
                modulus = complex(tissue.modulus.at(2 * np.pi * REFERENCE))
                found |= {f"{name} stiffness": abs(modulus), f"{name} loss": modulus.imag / modulus.real}
    return found
