"""Motion of the skin: the volar patch seen from above, and a field over time or over phase."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from ..errors import DataError, NotApplicable
from ..geometry.mesh.tissue_mesh import TissueMesh
from ..ports import Port, positions
from ..rendering import to_spectrum
from ..results.files import Signals, Wavefield
from ..typing import ComplexArray, FloatArray, IntArray
from .data import Results, record_of

__all__ = ["Motion", "View", "motion"]

_STEEPEST = 0.35  # least n_z of a facet that still counts as volar


@dataclass(frozen=True, eq=False)
class VolarPatch:
    """Skin facets around the device that face upwards, so that (x, y) names one point of them.

    ``vertices`` (n,) are indices into the mesh, ``points`` (n, 3) [m], ``triangles`` (m, 3) index these, ``normals``
    (n, 3) point outwards.
    """

    vertices: IntArray
    points: FloatArray
    triangles: IntArray
    normals: FloatArray

    def weights(self, places: FloatArray) -> tuple[IntArray, FloatArray]:
        """Corners (k, 3), indices into the patch, and weights (k, 3) of points (k, 2) [m] seen from above.

        Raises DataError for a point off the patch.
        """
        flat = self.points[self.triangles][:, :, :2]
        edges = (flat[:, 1:] - flat[:, :1]).swapaxes(1, 2)
        inner = np.einsum("mab,kmb->kma", np.linalg.inv(edges), places[:, None] - flat[None, :, 0])
        shares = np.concatenate([1 - inner.sum(axis=2, keepdims=True), inner], axis=2)
        best = np.argmax(shares.min(axis=2), axis=1)
        weights = shares[np.arange(len(places)), best]
        if np.any(weights < -1e-6):
            x, y = places[(weights < -1e-6).any(axis=1)][0]
            raise DataError(f"the point ({x:g}, {y:g}) m is not on the volar skin of the mesh near the device")
        return self.triangles[best], weights

    def lift(self, places: FloatArray) -> FloatArray:
        """Points (k, 3) [m] of the skin under (x, y) (k, 2) [m]."""
        corners, weights = self.weights(places)
        return np.asarray(np.einsum("kcx,kc->kx", self.points[corners], weights))

    def normal_field(self, field: Wavefield) -> NormalField:
        """The field's modes on the patch, outward component only."""
        modes = np.einsum("pcr,pc->pr", field.modes[self.vertices], self.normals)
        return NormalField(field.frequency, modes, field.amplitudes)


@dataclass(frozen=True, eq=False)
class NormalField:
    """One scalar component of a wavefield: ``modes`` (n_point, r), ``amplitudes`` (n_frequency, r, n_input)."""

    frequency: FloatArray
    modes: FloatArray
    amplitudes: ComplexArray

    def response(self, source: int) -> ComplexArray:
        """Displacement per unit drive (n_frequency, n_point) of one input."""
        return np.asarray(self.amplitudes[:, :, source] @ self.modes.T)

    def in_time(self, spectrum: ComplexArray, times: FloatArray) -> FloatArray:
        """Normal motion over time (n_time, n_point) [m], as :meth:`Wavefield.in_time` has it."""
        as_field = Wavefield(self.frequency, self.modes[:, None, :], self.amplitudes)
        return as_field.in_time(spectrum, times)[:, :, 0]

    def between(self, corners: IntArray, weights: FloatArray) -> NormalField:
        """At points inside facets, interpolated from their corners."""
        return replace(self, modes=np.einsum("kcr,kc->kr", self.modes[corners], weights))


def volar_patch(mesh: TissueMesh, ports: Sequence[Port], margin: float = 0.014) -> VolarPatch:
    """The patch that reaches ``margin`` [m] beyond ``ports``; DataError if there are no facets."""
    facets = mesh.facets["skin"]
    corner = mesh.points[facets]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    away = mesh.points[facets].mean(axis=1) - mesh.points.mean(axis=0)
    away[:, 0] = 0
    normal *= np.sign(np.einsum("ij,ij->i", normal, away))[:, None]
    up = normal[:, 2] > _STEEPEST * np.linalg.norm(normal, axis=1)
    places = positions(tuple(ports))[:, :2]
    low, high = places.min(axis=0) - margin, places.max(axis=0) + margin
    middle = corner.mean(axis=1)[:, :2]
    chosen = up & np.all((middle > low) & (middle < high), axis=1)
    if not chosen.any():
        raise DataError("the mesh has no skin facing upwards near the ports; are its axes x along, z out of the skin?")
    vertices, flat = np.unique(facets[chosen], return_inverse=True)
    triangles = flat.reshape(facets[chosen].shape)
    normals = np.zeros((len(vertices), 3))
    for k in range(3):  # area-weighted mean of the facets that meet
        np.add.at(normals, triangles[:, k], normal[chosen])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return VolarPatch(vertices, mesh.points[vertices], triangles, normals)


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


_MISSED = 1e-6  # of the drives' energy: rounding leaves 1e-14 beside the bins of the field


def signal_of(signals: Signals, method: str, target: str) -> FloatArray:
    """Signals (n_channel, n_t) of a method towards a target."""
    return np.asarray(signals.values[signals.methods.index(method), signals.targets.index(target)])


def drive_series(drives: Signals, method: str, target: str, field: Wavefield, *, whole: bool = True) -> ComplexArray:
    """Fourier-series amplitudes (n_input, n_frequency) of the drives on the wavefield's bins.

    Raises NotApplicable unless these are bins of the drives, with ``whole`` all that they move anything on: the motion
    at some of them alone would be a fraction of it, and come again and again.
    """
    record = record_of(drives)
    index = np.rint(field.frequency / record.df).astype(int)
    spectrum = to_spectrum(signal_of(drives, method, target), record)
    off = np.abs(index * record.df - field.frequency) > 1e-3 * record.df
    inside = index[~off & (index < spectrum.shape[1])]
    left = np.delete(np.abs(spectrum) ** 2, inside, axis=1).sum()
    if off.any() or (whole and left > _MISSED * np.sum(np.abs(spectrum) ** 2)):
        raise NotApplicable(
            f"the field between the points is known at {len(index)} frequencies, and the drives lie on others between "
            "them; leave out sweep.frequencies, or `forearm-fem render` again where they are of another sweep"
        )
    return np.asarray(spectrum[:, index] * record.df)
