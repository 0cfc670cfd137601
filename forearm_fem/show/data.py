"""A results folder, read as it is needed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

from .. import __version__
from ..errors import DataError
from ..geometry.limb.tube import with_bends
from ..geometry.mesh.files import read_mesh
from ..geometry.mesh.tissue_mesh import TissueMesh, with_finer_skin
from ..ports import Port, positions
from ..rendering import Record, Wavelet, from_samples_file, ricker
from ..rendering.limits import counted_points
from ..results.files import (
    Signals,
    StrengthRow,
    Wavefield,
    read_compliance,
    read_displacements,
    read_drives,
    read_signal_strength_csv,
    read_transfer,
)
from ..results.run import RunRecord, read_run
from ..scenario import Scenario, parse_scenario
from ..scenario.rendering import SampledWavelet
from ..store.record import load
from ..store.text import read_json
from ..transfer import Compliance, TransferMatrix
from ..typing import BoolArray

T = TypeVar("T")

# file -> the stage (sub-command) that writes it
STAGES: Mapping[str, str] = MappingProxyType(
    {
        "scenario.json": "run",
        "run.json": "run",
        "mesh.vtu": "run",
        "transfer.nc": "run",
        "wavefield.nc": "run",
        "drives.nc": "render",
        "displacements.nc": "render",
        "signal_strength.csv": "render",
    }
)
PREDICTION = "prediction/prediction.json"


@dataclass(frozen=True)
class Results:
    """Files of one run in ``folder``; every property reads its file once, when first asked.

    A missing file raises DataError with the command that makes it. ``compliance``, ``mesh`` and
    ``wavefield`` exist for some runs only: ask :meth:`has` first.
    """

    folder: Path

    @classmethod
    def open(cls, folder: str | Path) -> Results:
        """The results in ``folder``; DataError if there is no such folder."""
        place = Path(folder)
        if not place.is_dir():
            raise DataError(f"{place}: no such results folder; `forearm-fem run SCENARIO --out {place}` makes it")
        return cls(place)

    @classmethod
    def holding(cls, folder: str | Path, **known: object) -> Results:
        """The results in ``folder`` of which some properties are ``known`` by name: what wrote them need not read."""
        found = cls.open(folder)
        found.__dict__.update({name: value for name, value in known.items() if value is not None or name[0] == "_"})
        return found

    def has(self, name: str) -> bool:
        """True if the file ``name`` is there; "compliance" asks inside transfer.nc."""
        if name == "compliance":
            return self.has("transfer.nc") and self._compliance is not None
        return (self.folder / name).is_file()

    def path(self, name: str) -> Path:
        """The path of a file that must be there."""
        if not self.has(name):
            begun = self.has("scenario.json") or self.has("run.json")
            g = self.folder / "transfer.nc"
            page = f", or `forearm-fem workbench {g}` for its G" if g.is_file() else ""
            other = f"no run's folder, unless one works there now; name one of `forearm-fem run SCENARIO`{page}"
            remedy = self.remedy(name) if begun else other
            raise DataError(f"{self.folder}: unfinished, {name} is missing; {remedy}")
        return self.folder / name

    def remedy(self, name: str) -> str:
        """Half a sentence: the command that makes the file ``name``."""
        return f"`forearm-fem {STAGES.get(name, 'run')} SCENARIO --out {self.folder}` makes it"

    @cached_property
    def scenario(self) -> Scenario:
        """The scenario with all defaults filled in."""
        return parse_scenario(self._read("scenario.json", read_json), origin=str(self.folder / "scenario.json"))

    @cached_property
    def run(self) -> RunRecord:
        """Versions, times, memory, errors, warnings and mesh statistics of the run."""
        return self._read("run.json", read_run)

    @cached_property
    def transfer(self) -> TransferMatrix:
        """G."""
        return read_transfer(self.path("transfer.nc"))

    @property
    def touching(self) -> tuple[Port, ...]:
        """The contacts that touch the skin."""
        lifted = self.scenario.device.out_of_contact
        return tuple(p for p in self.transfer.inputs if p.name not in lifted)

    def counted(self, targets: Sequence[str]) -> BoolArray:
        """True where S towards each of ``targets`` counts: not under or beside a motor."""
        points = {p.name: p for p in self.transfer.outputs}
        return counted_points([points[t] for t in targets], self.touching, self.scenario.rendering.clearance)

    @cached_property
    def compliance(self) -> Compliance:
        """The skin's compliance; DataError for measured G, which has none."""
        if self._compliance is None:
            raise DataError(f"{self.folder / 'transfer.nc'}: holds no compliance; G was measured or imported")
        return self._compliance

    @cached_property
    def _compliance(self) -> Compliance | None:
        try:
            return read_compliance(self.path("transfer.nc"))
        except DataError as problem:
            if "no compliance" in str(problem):
                return None
            raise

    @cached_property
    def prediction(self) -> Mapping[str, Any] | None:
        """S over arms (``forearm-fem predict``), where the folder holds one of this very scenario."""
        try:
            found = read_json(self.folder / PREDICTION)
        except DataError:
            return None
        return found if found.get("scenario") == self.scenario.model_dump(mode="json") else None

    @cached_property
    def drives(self) -> Signals:
        """Drives (method, target, actuator, time)."""
        return read_drives(self.path("drives.nc"))

    @cached_property
    def displacements(self) -> Signals:
        """Displacements (method, target, point, time) [m]."""
        return read_displacements(self.path("displacements.nc"))

    @cached_property
    def strengths(self) -> tuple[StrengthRow, ...]:
        """S of every method and target."""
        return read_signal_strength_csv(self.path("signal_strength.csv"))

    @cached_property
    def mesh(self) -> TissueMesh:
        """The tetrahedra, edges bent as they were when they were solved for."""
        return with_bends(self.scenario, read_mesh(self.path("mesh.vtu")))

    @cached_property
    def field_mesh(self) -> TissueMesh:
        """The mesh with the points where the wavefield is known; the mesh itself in folders written before 0.6.0."""
        older = len(self._read("wavefield.nc", lambda file: load(file, Wavefield)).modes) == len(self.mesh.points)
        return self.mesh if older else with_finer_skin(self.mesh)

    @cached_property
    def wavefield(self) -> Wavefield:
        """Displacement of every point of :attr:`field_mesh`, the mesh's vertices first, for any drive; DataError if it
        belongs to another mesh."""
        field = self._read("wavefield.nc", lambda file: load(file, Wavefield))
        if len(field.modes) != len(self.field_mesh.points):
            raise DataError(
                f"{self.folder}: wavefield.nc has {len(field.modes)} points, mesh.vtu {len(self.field_mesh.points)} "
                f"with its skin's middles; they are of different runs, {self.remedy('wavefield.nc')} anew"
            )
        return field

    @property
    def has_field(self) -> bool:
        """True if the motion between the ports is known."""
        return self.has("wavefield.nc") and self.has("mesh.vtu")

    @cached_property
    def record(self) -> Record:
        """The record all signals live on."""
        return record_of(self.drives)

    @cached_property
    def wavelet(self) -> Wavelet:
        """The scenario's wavelet on that record."""
        options, record = self.scenario.rendering.wavelet, self.record
        duration = record.n / record.sample_rate
        if isinstance(options, SampledWavelet):
            kept = self.folder / f"wavelet{Path(options.file).suffix}"  # as the run found it in the scenario's folder
            return from_samples_file(kept if kept.is_file() else options.file, record.sample_rate, duration)
        return ricker(options.peak, 1.0, record.sample_rate, duration)

    @cached_property
    def stamp(self) -> str:
        """Scene, mesh and version in one line, for the foot of each figure."""
        mesh = "layered model, no mesh" if self.scenario.engine == "layered" else "no mesh"
        mesh = mesh if "scenario" in self.transfer.provenance else "measured G"
        if self.mesh_hash:
            mesh = f"mesh {self.mesh_hash[:10]}"
        return " · ".join((f"scene {self.scenario.name}", mesh, f"forearm_fem {self.version}"))

    @property
    def account(self) -> RunRecord:
        """run.json, or an empty record while the run is not finished."""
        return self.run if self.has("run.json") else RunRecord.empty()

    @property
    def version(self) -> str:
        """The version that made the results, or failing that the one reading them."""
        return self.account.program or __version__

    @cached_property
    def mesh_hash(self) -> str:
        """SHA-256 of the mesh; empty where there is none."""
        known = self.account.mesh.sha256 or self.transfer.provenance.get("mesh_sha256")
        if known:
            return str(known)
        return self.mesh.digest if self.has("mesh.vtu") else ""

    def _read(self, name: str, reader: Callable[[Path], T]) -> T:
        file = self.path(name)
        try:
            return reader(file)
        except DataError as problem:
            raise DataError(f"{problem}; {self.remedy(name)} anew") from None


def record_of(signals: Signals) -> Record:
    """The record that ``signals`` live on."""
    return Record(round(1 / float(signals.time[1] - signals.time[0]), 6), len(signals.time))


def places(outputs: Sequence[Port], inputs: Sequence[Port]) -> dict[str, Any]:
    """Coordinates of grid points and actuators: names, places (x, y, z) [m], and radii [m] of the contacts."""
    return {
        "output": [p.name for p in outputs], "input": [p.name for p in inputs],
        "output_place": (("output", "xyz"), positions(tuple(outputs))),
        "input_place": (("input", "xyz"), positions(tuple(inputs))),
        "radius": ("input", [p.radius for p in inputs]),
    }  # fmt: skip
