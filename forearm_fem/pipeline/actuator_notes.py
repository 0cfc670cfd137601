"""What a reader of the results should know of the actuator behind them."""

from __future__ import annotations

from ..scenario import Scenario
from ..scenario.actuators import ACTUATORS


def actuator_notes(scenario: Scenario) -> tuple[str, ...]:
    """What a preset other than the thesis' can be used for, what its source does not say, and a band beyond its own."""
    device, sweep = scenario.device, scenario.sweep
    known = ACTUATORS[device.actuator]
    if not known.keys:
        return ()
    notes = [f"device.actuator = '{known.name}' ({known.kind}): {known.use}; not seen: {known.unseen}"]
    asked = sweep.frequencies or (sweep.f_min, sweep.f_max)
    low, high = min(asked), max(asked)
    if known.band is not None and not known.band[0] <= low <= high <= known.band[1]:
        notes.append(
            f"sweep: {low:g} to {high:g} Hz reaches beyond the {known.band[0]:g} to {known.band[1]:g} Hz of "
            f"{known.name}; set sweep.f_min and sweep.f_max within, or take what is rendered there as its wish"
        )
    return tuple(notes)
