"""Engine: what answers for a scenario with the compliance between its ports."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from ..errors import ScenarioError
from ..progress import Progress
from ..scenario import Scenario
from ..transfer import Compliance
from ..typing import FloatArray
from ..usercode import is_code, named

if TYPE_CHECKING:
    from ..geometry.mesh.tissue_mesh import TissueMesh
    from .solved import Solved


class Engine(Protocol):
    """A model of limbs: finite elements, flat layers, tables, a reduced model, a library, or the user's own."""

    @property
    def name(self) -> str:
        """For reports, e.g. "layered"."""
        ...

    def holds(self, scenario: Scenario) -> str:
        """Reason, a sentence with the remedy, that it cannot answer for ``scenario``; empty where it can.

        What shows only while it works, such as ports beside the limb, is raised there.
        """
        ...

    def compliance(self, scenario: Scenario, frequency: FloatArray) -> Compliance:
        """Of the contacts and points of ``scenario`` at ``frequency`` (n,) [Hz], with an estimate per source of error.

        Entries between two points may be NaN: no device drives there.
        """
        ...


@runtime_checkable
class SolvingEngine(Engine, Protocol):
    """An engine that gives besides what errors by mesh and ends follow from, once the device is known."""

    def solved(self, scenario: Scenario, frequency: FloatArray) -> Solved:
        """The compliance, with those on a second mesh and with other ends."""
        ...


def engine_of(
    scenario: Scenario, *, base: Path = Path("."), mesh: TissueMesh | None = None, progress: Progress | None = None
) -> Engine:
    """The engine that the scenario names; ``mesh`` is the one that finite elements take, made where it is None.

    A class of the user's own is made by ``Class.of(scenario)`` where it has that, else by ``Class()``.
    """
    if is_code(scenario.engine):
        made = named(scenario.engine, "engine")
        found: Engine = made.of(scenario) if hasattr(made, "of") else made()
        if lacking := [what for what in ("name", "holds", "compliance") if not hasattr(found, what)]:
            raise ScenarioError(f"engine: {scenario.engine} has no {lacking[0]}; an engine has name, holds, compliance")
        return found
    if scenario.engine == "layered":
        from .layered import LayeredEngine

        return LayeredEngine(progress)
    from .solved import FemEngine

    return FemEngine(base, mesh, progress)


def refuse_unheld(engine: Engine, scenario: Scenario) -> None:
    """ScenarioError where ``engine`` cannot answer for ``scenario``."""
    if reason := engine.holds(scenario):
        raise ScenarioError(reason)
