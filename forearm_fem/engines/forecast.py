"""Cost of a solve before it begins, and what a stage took."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import psutil

from ..errors import SolverError
from ..fem.assembly.coefficients import is_polynomial
from ..fem.linear.factor import choose_backend
from ..fem.reduction.expansion import ROUNDED
from ..fem.space.orders import element_orders
from ..geometry.cache import cached_mesh
from ..geometry.device.layout import layout_of
from ..geometry.device.place import place_ports
from ..geometry.mesh.quality import Resolution, nodes_per_wavelength
from ..geometry.mesh.tissue_mesh import TissueMesh
from ..geometry.user.checks import turned_over
from ..ports import Port
from ..progress import Progress
from ..results.run import StageCost
from ..scenario import Scenario
from ..scenario.limb import MeshLimb, SurfacesLimb
from ..scenario.sweep import ReducedSolve, frequencies
from ..tissue import resolve_tissues
from .fem import reduction_tolerance

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
_ESTIMATE = 1.5  # with the coarser mesh's solve
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


def forecast(
    scenario: Scenario,
    *,
    base: Path = Path("."),
    mesh: TissueMesh | None = None,
    progress: Progress | None = None,
) -> Forecast:
    """Count unknowns on the scenario's mesh (made if need be) and estimate memory and time of the solve."""
    mesh = mesh or cached_mesh(scenario, base=base, progress=progress)
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
    one *= _ESTIMATE if scenario.solver.discretisation_estimate else 1.0
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
    passing = rate and scenario.solver.sweep == "reduced" and reduction_tolerance(scenario) >= ROUNDED
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
