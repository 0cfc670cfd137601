"""The program from Python: a function for each question, an object for each answer."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .errors import ScenarioError
from .scenario import Scenario
from .transfer import TransferMatrix

if TYPE_CHECKING:
    from .engines.simulation import Simulation
    from .questions.calibrate import CalibrationResult
    from .questions.compare.run import CompareResult, FitCommandResult
    from .questions.design.run import DesignResult
    from .questions.predict.run import Prediction
    from .rendering import Rendering


def read(path: str | Path, *, scenario: Scenario | None = None, **declared: Any) -> TransferMatrix:
    """G of a file of any known kind, or of a results folder.

    ``scenario`` is the one measured: its points and actuators are those of files that name none. What a file does not
    say of itself is ``declared``: ``read("lab.csv", scenario=s, unit="um/V", sign="+iwt")``. DataError asks for it.
    """
    from .files import Declaration
    from .files import read as read_file

    return read_file(path, Declaration(**declared) if declared else None, scenario=scenario)


def render(
    what: Simulation | TransferMatrix, scenario: Scenario | None = None, *, base: str | Path = "."
) -> Rendering:
    """Drives, displacements and S, with its interval, on a simulation or on any G.

    ``scenario`` says by which methods, with which wavelet and at which targets a G is rendered: without it the one that
    G names, or the thesis' at G's own places. ``base`` is the folder that its files are seen from.
    """
    from .engines.simulation import Simulation
    from .engines.simulation import render as render_simulation
    from .rendering.job import render_transfer, scenario_for

    if isinstance(what, Simulation) and scenario is None:
        return render_simulation(what)
    g = what.transfer if isinstance(what, Simulation) else what
    if not isinstance(g, TransferMatrix):
        raise ScenarioError(f"expected what simulate() or read() give, got a {type(what).__name__}")
    return render_transfer(scenario_for(g, scenario)[0], g, base=base)


def compare(
    a: str | Path | TransferMatrix, b: str | Path | TransferMatrix, *, scenario: Scenario | None = None, **options: Any
) -> CompareResult:
    """Distance of two G: per entry, over the band, in S and in dispersion (:func:`.run_compare`)."""
    from .questions.compare.run import run_compare

    return run_compare(a, b, scenario=scenario, **options)


def fit(
    scenario: Scenario, measured: str | Path | TransferMatrix, parameters: Sequence[str], **options: Any
) -> FitCommandResult:
    """Parameters of a scenario for which its G is nearest to a measured one (:func:`.run_fit`)."""
    from .questions.compare.run import run_fit

    return run_fit(scenario, measured, parameters, **options)


def predict(
    scenario: Scenario, *, draws: int = 200, folder: str | Path | None = None, base: str | Path = ".",
    workers: int | None = None, **options: Any,
) -> Prediction:  # fmt: skip
    """S over ``draws`` arms that differ as people do.

    What is done is kept in ``folder``, so that a prediction goes on where it was stopped; without one in none that
    stays. ``workers`` processes share the work (1: this one); ``options`` are those of
    :class:`.Question`: ``seed``, ``laws``, ``held``, ``layered``.
    """
    from .questions.predict.run import Question
    from .questions.predict.run import predict as predict_question

    question = Question(scenario, Path(base), **options)
    if folder is not None:
        return predict_question(question, folder, draws=draws, workers=workers)
    with tempfile.TemporaryDirectory() as place:
        return predict_question(question, place, draws=draws, workers=workers)


def design(file: str | Path, folder: str | Path, **options: Any) -> DesignResult:
    """The best device by a design file; ``folder`` keeps every candidate (:func:`.run_design`)."""
    from .questions.design.model import load_design
    from .questions.design.run import run_design

    return run_design(load_design(file), folder, **options)


def calibrate(
    scenario: Scenario, folder: str | Path, *, through: TransferMatrix | None = None, **options: Any
) -> CalibrationResult:
    """G measured with a device, or ``through`` a given G in its place; the same call resumes.

    ``options`` are ``daq``, ``card``, ``cable`` and the others of :func:`.run_calibration`.
    """
    from .questions.calibrate import VirtualSetup, run_calibration

    if through is not None:
        options = {"daq": "virtual", "virtual": VirtualSetup(through), **options}
    return run_calibration(scenario, folder, **options)
