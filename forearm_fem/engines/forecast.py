"""Forecast of a solve, notes on its scenario, and the account of what each stage took."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import psutil

from ..device import close_loop
from ..errors import DataError, ForearmError, ScenarioError, SolverError
from ..fem.assembly.coefficients import is_polynomial
from ..fem.linear.factor import choose_backend
from ..fem.reduction.expansion import ROUNDED
from ..fem.space.orders import element_orders
from ..geometry.build import cached_mesh
from ..geometry.device.layout import layout_of
from ..geometry.device.place import place_ports
from ..geometry.mesh.quality import Resolution, nodes_per_wavelength
from ..geometry.mesh.tissue_mesh import TissueMesh
from ..geometry.user.checks import turned_over
from ..ports import Port
from ..rendering import Record, bridged, on_record_bins
from ..results.run import SolutionRecord, StageCost
from ..scenario import Scenario
from ..scenario.actuators import ACTUATORS
from ..scenario.limb import MeshLimb, SlabLimb, SurfacesLimb
from ..scenario.model import for_elements_only, resolve_tissues
from ..scenario.sweep import FrequencyList, ReducedSolve, frequencies
from ..transfer import finite
from .layered import solve_layered, without_fibres

# Seconds and peak memory of each stage.


@dataclass
class Ledger:
    """Collects what each stage cost; the one mutable record of a run."""

    stages: dict[str, StageCost] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time a stage and watch the process's memory while it runs."""
        watch = _MemoryWatch()
        start = time.perf_counter()
        watch.start()
        try:
            yield
        finally:
            watch.stop()
            seconds = time.perf_counter() - start
            self.stages[name] = StageCost(seconds=round(seconds, 3), peak_memory_bytes=float(watch.peak))


class _MemoryWatch(threading.Thread):
    """Samples the resident set every 50 ms."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self._process = psutil.Process()
        self._done = threading.Event()
        self.peak = self._process.memory_info().rss

    def run(self) -> None:
        """See :class:`threading.Thread`."""
        while not self._done.wait(0.05):
            self.peak = max(self.peak, self._process.memory_info().rss)

    def stop(self) -> None:
        """End the sampling."""
        self._done.set()
        self.join()


# Forecast of a scenario's cost and of its mesh's resolution, before anything is solved.

NODES_NEEDED = 6.0  # per shear wavelength near the ports; below it the error of far entries passes 10 %

# Fitted to factorisations of limbs and slabs with 23 000 to 199 000 unknowns on 2 cores, double precision. Of whole
# runs (quick, the thesis' scene at 0.1 and 0.025) 1.02 to 1.16 times the peak is said.
_BYTES = 0.26e9, 22_700.0, 1.25
_SECONDS = 7.0, 131_000.0, 1.8
_GRADED = 1.4  # third order around the ports: as many unknowns lie closer together (forearm, 207 000 unknowns)
_FRONTS = 1.3  # the multifrontal solver stores zeros of its panels, and what fronts leave to others
_PASSING = 0.62  # of that, where certificates keep no factors: real ones, or an elimination's stack
_REST = 0.7e9  # bytes: libraries, and the operator of a scene of any size
_SMALL = 15.0  # seconds that evaluating and certifying a reduced model takes for a mesh of any size
_DERIVATIVES = 45  # about a rate, where 1e-4 is asked in 10-500 Hz
_FROM_RATE = 1.6  # a sweep from a rate costs as much as so many expansions and certificates; measured with AVX-512
_COPIES = 3  # of all signals: themselves, their spectra, and the array that is written
_ESTIMATE = 1.5  # with the coarser mesh's solve, where there is one
_WIDEST = 300.0  # mm across: a stout thigh
_OBLONG = 1.5  # times as long in y or z as in x: more likely turned than cut so short


@dataclass(frozen=True)
class Forecast:
    """Size, cost and resolution of a scenario's main solve."""

    tetrahedra: int
    unknowns: int
    memory_bytes: float
    seconds: float
    resolution: tuple[Resolution, ...]
    doubts: tuple[str, ...] = ()

    def sentences(self, f_max: float) -> tuple[str, ...]:
        """Doubts of the user's own limb, then a sentence per tissue with too few nodes per wavelength near the
        ports."""
        few = tuple(
            f"{r.tissue}: {r.per_wavelength_near_ports:.1f} nodes per shear wavelength near the device at {f_max:g} "
            f"Hz, where {NODES_NEEDED:g} are usual; the stated error of G includes it, but entries far from a cone may "
            "be a tenth off there. If they matter, lower mesh.size_grid and mesh.grading"
            for r in self.resolution
            if r.per_wavelength_near_ports < NODES_NEEDED
        )
        return (*self.doubts, *few)


def forecast(scenario: Scenario, *, base: Path = Path("."), mesh: TissueMesh | None = None) -> Forecast:
    """Count unknowns on the scenario's mesh (made if need be) and estimate memory and time of the solve."""
    mesh = mesh or cached_mesh(scenario, base=base)
    ports = place_ports(scenario, mesh)
    orders = element_orders(mesh, ports, scenario.element)
    unknowns = 3 * orders.spread.shape[1] + orders.spread_pressures.shape[1]
    # as ``expansion.starts_from_rate`` finds on the assembled model
    tissues = resolve_tissues(scenario)
    polynomial = all(is_polynomial(tissues[name].modulus) for name in mesh.region_names)
    solve = scenario.solver
    rate = polynomial and isinstance(solve, ReducedSolve) and solve.start != "frequencies"
    if isinstance(solve, ReducedSolve):
        factorisations = _FROM_RATE if rate else solve.expansions + 1.0
    else:
        factorisations = len(frequencies(scenario.sweep))
    single = 1.0 if scenario.solver.precision == "double" else 0.5
    one = _power(_SECONDS, unknowns) * single * (_GRADED if scenario.element == "P2/P3" else 1.0)
    second = scenario.solver.discretisation_estimate and not isinstance(scenario.limb, SlabLimb)
    one *= _ESTIMATE if second else 1.0
    return Forecast(
        len(mesh.tetrahedra),
        unknowns,
        _factor_bytes(scenario, unknowns, rate=rate) + _REST + _basis_bytes(scenario, unknowns, ports, rate=rate),
        one * factorisations * 2.2 + _SMALL if scenario.solver.sweep == "reduced" else one * factorisations * 1.2,
        resolution_near_ports(scenario, mesh),
        doubts_of(scenario, mesh),
    )


def doubts_of(scenario: Scenario, mesh: TissueMesh) -> tuple[str, ...]:
    """Doubts that the user's own limb is the one meant: turned, not cut, upside down, two files exchanged."""
    limb, found = scenario.limb, list[str]()
    if not isinstance(limb, SurfacesLimb | MeshLimb):
        return ()
    size = 1e3 * np.ptp(mesh.points, axis=0)
    long = int(size.argmax())
    if size[long] > _OBLONG * size[0]:
        found.append(
            f"limb: is {size[long]:.0f} mm long in {'xyz'[long]}, but {size[0]:.0f} mm in x, which is taken for the "
            "way to the elbow (+z for the volar side); turn the files unless that is meant"
        )
    else:
        x = mesh.points[:, 0]
        at, middle = x[mesh.facets.get("end", np.zeros((0, 3), dtype=np.int64))[:, 0]], (x.min() + x.max()) / 2
        if uncut := [side for side, cut in (("smallest", at < middle), ("largest", at > middle)) if not cut.any()]:
            found.append(
                f"limb: no plane cut end across x was found at its {' and its '.join(uncut)} x, which is free skin "
                "where waves turn back; cut it across x, flat to a thousandth of its length, unless that is meant"
            )
    if (across := max(size[1:])) > _WIDEST and size[long] <= _OBLONG * size[0]:
        found.append(f"limb: is {across:.0f} mm across, which no limb is; correct limb.unit unless that is meant")
    if over := turned_over(mesh, layout_of(scenario).contacts):
        found.append(over)
    if isinstance(limb, SurfacesLimb):
        written = [name for name in limb.surfaces if name in mesh.region_names]
        found += [
            f"limb.surfaces: names {first} before {outer}, whose surface encloses it; write them from the outside "
            "inwards, or two files are exchanged"
            for first, outer in zip(written, mesh.region_names, strict=False)
            if first != outer
        ][:1]
    return tuple(found)


def _factor_bytes(scenario: Scenario, unknowns: int, *, rate: bool) -> float:
    """Factors and what their making needs; where resonances turn out to be sharp a certificate needs twice that."""
    double = 1.5 * _power(_BYTES, unknowns)
    if scenario.solver.precision == "double":
        return double
    if choose_backend(scenario.solver.backend, unknowns) != "multifrontal":
        return double / 2
    passing = rate and scenario.solver.sweep == "reduced" and scenario.reduction_tolerance >= ROUNDED
    return double / 2 * _FRONTS * (_PASSING if passing else 1.0)


def _basis_bytes(scenario: Scenario, unknowns: int, ports: Sequence[Port], *, rate: bool) -> float:
    """Reduced basis, the columns that are added to it, and their snapshots: about 2.5 times an expansion's."""
    solver = scenario.solver
    if solver.sweep == "direct":
        return 0.0
    contacts = sum(p.kind == "contact" for p in ports)
    if rate:
        return 1.3 * 4 * unknowns * _DERIVATIVES * len(ports)  # kept in single precision
    columns = contacts * (solver.derivatives + 1) + (len(ports) - contacts) * (solver.point_derivatives + 1)
    return 2.5 * 8 * unknowns * 2 * columns * solver.expansions


def refuse_if_too_large(forecast: Forecast, scenario: Scenario) -> None:
    """Raise :class:`SolverError` with advice where the estimate exceeds ``solver.memory_limit``."""
    if forecast.memory_bytes > scenario.solver.memory_limit:
        raise SolverError(
            f"the solve of {forecast.unknowns} unknowns needs about {forecast.memory_bytes / 1e9:.1f} GB, more than "
            f"solver.memory_limit = {scenario.solver.memory_limit / 1e9:.1f} GB; raise the limit "
            "or ask for a larger accuracy"
        )


def refuse_if_signals_too_large(scenario: Scenario) -> None:
    """Raise :class:`SolverError` where drives and displacements of all targets would pass ``solver.memory_limit``."""
    wanted, points = scenario.rendering, len(scenario.grid.places)
    targets = points if wanted.targets == "all" else len(wanted.targets)
    records = len(wanted.methods) * targets * (points + len(scenario.device.centres))
    need = _COPIES * 8 * records * scenario.sweep.duration * scenario.sweep.sample_rate
    if need > scenario.solver.memory_limit:
        raise SolverError(
            f"drives and displacements of {len(wanted.methods)} methods at {targets} targets need about "
            f"{need / 1e9:.3g} GB, more than solver.memory_limit = {scenario.solver.memory_limit / 1e9:.3g} GB; name "
            "fewer rendering.targets or shorten sweep.duration"
        )


def resolution_near_ports(scenario: Scenario, mesh: TissueMesh) -> tuple[Resolution, ...]:
    """Nodes per shear wavelength and per decay length at the highest frequency, tissue by tissue."""
    f_max = float(frequencies(scenario.sweep)[-1])
    omega = np.array([2 * np.pi * f_max])
    tissues = {name: t for name, t in resolve_tissues(scenario).items() if name in mesh.region_names}
    speeds = {name: float(t.wave_speed(omega)[0]) for name, t in tissues.items()}
    decay = {name: 1 / max(float(t.attenuation(omega)[0]), 1e-9) for name, t in tissues.items()}
    ports = place_ports(scenario, mesh)
    return nodes_per_wavelength(mesh, scenario.element, speeds, decay, f_max, ports=ports)


def _power(fit: tuple[float, float, float], n: float) -> float:
    value, at, exponent = fit
    return float(value * (n / at) ** exponent)


# Notes of a run: sentences that belong in its report.

# Spacing of chosen frequencies, close enough or not to fill the bins between them, before anything is solved.

_ON_BIN = 1e-3  # of a bin: as for G's own samples


def check_samples(scenario: Scenario) -> None:
    """Raise :class:`ScenarioError` where ``sweep.frequencies`` are too far apart to render on the bins between them.

    Judged as G itself will be, on the layered model of the same layers and device; for the user's own limb, which has
    none, see :func:`sample_notes`.
    """
    if not _between(scenario) or isinstance(scenario.limb, MeshLimb | SurfacesLimb):
        return
    bare = without_fibres(scenario.changed({"tissues.patch": None}))
    try:
        g = finite(close_loop(solve_layered(bare, frequencies(scenario.sweep)), scenario.device))
    except ForearmError:  # in words of its own, when it is solved
        return
    try:
        on_record_bins(bridged(g).transfer, Record.of(scenario.sweep.sample_rate, scenario.sweep.duration))
    except DataError as problem:
        raise ScenarioError(
            f"sweep.frequencies: by the layered model, {problem}; for G alone set rendering.methods = []"
        ) from None


def sample_notes(scenario: Scenario) -> tuple[str, ...]:
    """Note that only the solve tells whether the user's own limb has frequencies close enough to render on."""
    if not _between(scenario) or not isinstance(scenario.limb, MeshLimb | SurfacesLimb):
        return ()
    return (
        "sweep.frequencies: bins between them are interpolated, and after the solve only it shows whether G allows it; "
        "leave the key out for every bin, or set rendering.methods = [] for G alone",
    )


def _between(scenario: Scenario) -> bool:
    """True if something is rendered on bins that lie between chosen frequencies."""
    sweep = scenario.sweep
    if not isinstance(sweep, FrequencyList) or not scenario.rendering.methods:
        return False
    at = np.array(sweep.frequencies) * sweep.duration
    bins = np.arange(np.ceil(at[0]), np.floor(at[-1]) + 1)
    beside = np.clip(np.searchsorted(at, bins), 1, len(at) - 1) if len(at) > 1 else np.zeros(len(bins), dtype=int)
    nearest = np.minimum(np.abs(bins - at[beside]), np.abs(bins - at[beside - 1]))
    return bool((nearest > _ON_BIN).any())


# Remarks on the model and the actuator for a reader of the results.


def scene_notes(scenario: Scenario) -> tuple[str, ...]:
    """Notes on a scenario before it is meshed or solved."""
    kinds = (engine_notes, actuator_notes, lifted_notes, covered_notes, sample_notes)
    return tuple(note for notes in kinds for note in notes(scenario))


def model_notes(solution: SolutionRecord) -> tuple[str, ...]:
    """Note that a reduced model with unstable poles is good for frequencies of the band only.

    That takes incompressible tissue and single precision; outside the band such a model refuses (:mod:`.skin_model`).
    """
    if not solution.unstable_poles:
        return ()
    return (
        f"the reduced model has {solution.unstable_poles} unstable poles far outside the band: use it (reduced.nc) at "
        "frequencies of the band only, not beyond and not in time; solver.precision = 'double' makes one without",
    )


def engine_notes(scenario: Scenario) -> tuple[str, ...]:
    """Keys that the layered model leaves to finite elements."""
    kept = [key for key in scenario.changed_keys() if for_elements_only(key)] if scenario.engine == "layered" else []
    if not kept:
        return ()
    return (f"{', '.join(kept)}: for finite elements; engine = 'layered' has flat, endless layers and no mesh",)


def lifted_notes(scenario: Scenario) -> tuple[str, ...]:
    """Note that funneling drives actuators that do not touch the skin: its shares follow from places alone."""
    lifted, shared = scenario.device.out_of_contact, {"funneling", "combination"} & set(scenario.rendering.methods)
    if not lifted or not shared:
        return ()
    return (
        f"device.out_of_contact: no skin moves under {', '.join(lifted)}, but shares of "
        f"{' and '.join(sorted(shared, reverse=True))} follow from places alone and drive there all the same; judge by "
        "the inverse filter, or leave such actuators out of device.contacts",
    )


def covered_notes(scenario: Scenario) -> tuple[str, ...]:
    """Points that move with a cone that touches: under it, or nearer to its rim than ``rendering.clearance``."""
    device = scenario.device
    feet = [c for k, c in enumerate(device.centres, start=1) if f"A{k}" not in device.out_of_contact]
    gaps = (min(math.dist(place, foot) for foot in feet) for place in scenario.grid.places)
    clear = device.cone.radius + scenario.rendering.clearance * (1 - 1e-9)
    under = [str(i) for i, gap in enumerate(gaps, start=1) if gap < clear]
    if not under or not scenario.rendering.methods:
        return ()
    return (
        f"grid: {_lie(under)} under a cone or within {1e3 * scenario.rendering.clearance:g} mm of its rim "
        "(rendering.clearance), moving with the motor: S there is no focus; judge by the other points, or move it "
        "(grid.pitch, grid.points) or the cones",
    )


def _lie(points: Sequence[str]) -> str:
    named = ", ".join(points[:6]) + (", ..." if len(points) > 6 else "")
    return f"point {named} lies" if len(points) == 1 else f"points {named} lie"


def actuator_notes(scenario: Scenario) -> tuple[str, ...]:
    """Notes on an actuator preset other than the thesis': its use, gaps of its source, and a band beyond its own."""
    device, sweep = scenario.device, scenario.sweep
    known = ACTUATORS[device.actuator]
    if not known.keys:
        return ()
    notes = [f"device.actuator = '{known.name}' ({known.kind}): {known.use}; not seen: {known.unseen}"]
    asked = sweep.span
    low, high = min(asked), max(asked)
    if known.band is not None and not known.band[0] <= low <= high <= known.band[1]:
        notes.append(
            f"sweep: {low:g} to {high:g} Hz reaches beyond the {known.band[0]:g} to {known.band[1]:g} Hz of "
            f"{known.name}; set sweep.f_min and sweep.f_max within, or take what is rendered there as its wish"
        )
    return tuple(notes)
