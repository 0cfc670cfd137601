"""Motion in a picture: a field over time for a target and method, or over phase at one frequency."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from ..errors import DataError
from ..results.files import Wavefield
from ..typing import ComplexArray, FloatArray
from .data import Results
from .targets import drive_series

__all__ = ["Motion", "View", "motion"]

Quantity = Literal["normal", "magnitude", "phase"]


@dataclass(frozen=True)
class View:
    """Choice of the motion to show.

    ``method`` and ``target`` choose the drives; with ``frequency`` [Hz] only the bin nearest to it, scaled so that the
    largest drive is one unit; ``actuator`` replaces them by one unit on that actuator (needs a frequency).
    ``quantity``: the outward "normal" component, the "magnitude", or the "phase" of the normal component (at a
    frequency).
    """

    method: str = "inverse filter"
    target: str = "5"
    frequency: float | None = None
    actuator: str | None = None
    quantity: Quantity = "normal"

    @property
    def words(self) -> str:
        """In a few words, for the picture."""
        if self.actuator is not None:
            return f"{self.actuator} alone, {self.frequency:g} Hz, 1 unit of drive"
        where = f"{self.method}, target {self.target}"
        return where if self.frequency is None else f"{where}, {self.frequency:g} Hz, largest drive 1 unit"


@dataclass(frozen=True, eq=False)
class Motion:
    """Displacements of mesh vertices, at instants [s] or phases [rad]; made once, asked often.

    ``states`` (n_step, r) are real amplitudes of the wavefield's modes at ``steps`` (n_step,); ``phasor`` (r,) is set
    at a frequency.
    """

    view: View
    steps: FloatArray
    states: FloatArray
    phasor: ComplexArray | None

    def displacement(self, modes: FloatArray, step: int) -> FloatArray:
        """(n_point, 3) [m] for modes (n_point, 3, r)."""
        return np.asarray(modes @ self.states[step])

    def label(self, step: int) -> str:
        """The instant or the phase, in words."""
        if self.phasor is None:
            return f"t = {1e3 * self.steps[step]:+.1f} ms".replace("+0.0", "0.0").replace("-0.0 ", "0.0 ")
        return f"phase {np.degrees(self.steps[step]):.0f}°"


def motion(results: Results, view: View, steps: FloatArray | None = None) -> Motion:
    """The motion of a view at ``steps``: instants [s], or phases [rad] where the view has a frequency."""
    check_view(results, view)
    field = results.wavefield
    if view.frequency is not None:
        low, high = field.frequency[0], field.frequency[-1]
        if not low - 1 <= view.frequency <= high + 1:
            raise DataError(f"{view.frequency:g} Hz lies outside the sweep of {low:g} to {high:g} Hz")
        nearest = int(np.argmin(np.abs(field.frequency - view.frequency)))
        view = replace(view, frequency=float(field.frequency[nearest]))
        phasor = np.asarray(field.amplitudes[nearest] @ _unit_drives(results, view, field, nearest))
        at = np.linspace(0, 2 * np.pi, 24, endpoint=False) if steps is None else steps
        return Motion(view, at, (np.exp(1j * at)[:, None] * phasor).real, phasor)
    at = default_times() if steps is None else steps
    spectrum = drive_series(results.drives, view.method, view.target, field)
    amplitudes = np.einsum("fri,if->fr", field.amplitudes, spectrum)
    states = 2 * (np.exp(2j * np.pi * np.outer(at, field.frequency)) @ amplitudes).real
    return Motion(view, at, states, None)


def default_times() -> FloatArray:
    """60 instants from 12 ms before the wavelet's centre to 17.5 ms after it [s]."""
    return np.asarray(np.arange(-24, 36) * 0.5e-3, dtype=np.float64)


def focus_time(results: Results, view: View) -> float:
    """The instant [s] at which the target moves most; 0 for a view at a frequency."""
    if view.frequency is not None or not results.has("displacements.nc"):
        return 0.0
    check_view(results, view)
    moved = results.displacements
    m, t = moved.methods.index(view.method), moved.targets.index(view.target)
    return float(moved.time[np.argmax(np.abs(moved.values[m, t, moved.channels.index(view.target)]))])


def check_view(results: Results, view: View) -> None:
    """Raise DataError for a view that the results cannot give."""
    if not results.has_field:
        missing = "mesh.vtu" if not results.has("mesh.vtu") else "wavefield.nc"
        remedy = results.remedy(missing)
        layered = results.has("scenario.json") and results.scenario.engine == "layered"
        if layered or (results.has("run.json") and results.run.solution.solver == "library"):
            remedy = f"`forearm-fem workbench {results.folder}` shows its G"
        raise DataError(f"{results.folder}: no motion between the points is known, {missing} is missing "
                        f"(the layered model, a library and measured G have none); {remedy}")  # fmt: skip
    if view.actuator is None:
        for name, known in ((view.method, results.drives.methods), (view.target, results.drives.targets)):
            if name not in known:
                raise DataError(f"{results.folder}: nothing was rendered for '{name}'; there are {', '.join(known)}")
    elif view.frequency is None:
        raise DataError("one actuator alone is shown at a frequency; give one in Hz")
    if view.quantity == "phase" and view.frequency is None:
        raise DataError("a phase belongs to a frequency; give one in Hz, or show 'normal' or 'magnitude'")


def _unit_drives(results: Results, view: View, field: Wavefield, nearest: int) -> ComplexArray:
    """Drives (n_input,) of a view at a bin of the field, the largest of them one unit."""
    names = [p.name for p in results.transfer.inputs]
    if view.actuator is not None:
        if view.actuator not in names:
            raise DataError(f"no actuator is called '{view.actuator}'; known are {', '.join(names)}")
        return np.array([n == view.actuator for n in names], dtype=complex)
    drives = drive_series(results.drives, view.method, view.target, field, whole=False)[:, nearest]
    largest = drives[int(np.argmax(np.abs(drives)))]
    if largest == 0:
        raise DataError(f"the drives of {view.words} are zero at this frequency; choose another")
    return np.asarray(drives / largest)


def shown_values(displacement: FloatArray, normals: FloatArray, quantity: Quantity) -> FloatArray:
    """The scalar (n,) [m] in a picture: outward component or magnitude."""
    if quantity == "magnitude":
        return np.asarray(np.linalg.norm(displacement, axis=1))
    return np.asarray(np.einsum("ij,ij->i", displacement, normals))
