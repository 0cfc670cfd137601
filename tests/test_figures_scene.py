"""A small synthetic run for the tests of figures and report: layered model, coarse block, a field that equals G."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scenes import once

from forearm_fem.device import close_loop, contact_state
from forearm_fem.engines.layered import flat_layers
from forearm_fem.geometry.build import build_mesh
from forearm_fem.geometry.device.place import place_ports
from forearm_fem.geometry.mesh.files import write_mesh
from forearm_fem.geometry.mesh.tissue_mesh import TissueMesh
from forearm_fem.layered import Disc, layered_compliance
from forearm_fem.ports import positions
from forearm_fem.rendering import render_all, ricker
from forearm_fem.results.files import (
    Wavefield,
    stack,
    strength_rows,
    write_displacements,
    write_drives,
    write_signal_strength_csv,
    write_transfer,
)
from forearm_fem.scenario import Scenario, parse_scenario
from forearm_fem.show import Results
from forearm_fem.show.patch import volar_patch
from forearm_fem.store.record import save
from forearm_fem.transfer import Compliance, ErrorEstimate, TransferMatrix

RADII = np.concatenate([[0.0], np.geomspace(1e-3, 0.1, 40)])
SCENE = {
    "name": "tiny",
    "limb": {"shape": "slab", "length": 0.1, "width": 0.09, "depth": 0.02},
    "sweep": {"duration": 0.2, "f_max": 400.0},
    "mesh": {"size_contact": 0.003, "size_grid": 0.004, "size_far": 0.012, "sublayers": {"skin": 1, "fat": 1}},
    "device": {"cone": {"contact": "pressure"}},
}


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run, made once a session for all files that import this; do not write into it."""
    return once(tmp_path_factory, "finished_run", write_run)


def write_run(place: Path) -> None:
    """Everything that a run leaves behind."""
    scenario = parse_scenario(SCENE)
    mesh = build_mesh(scenario)
    compliance, radial = layered(scenario, mesh)
    transfer = close_loop(compliance, scenario.device)
    write_mesh(mesh, place / "mesh.vtu")
    write_transfer(place / "transfer.nc", transfer, compliance)
    write_signals(place, transfer)
    save(place / "wavefield.nc", field(scenario, mesh, compliance, radial))
    (place / "scenario.json").write_text(scenario.model_dump_json())
    account = {
        "program": "0.0.test",
        "mesh": {"sha256": mesh.digest},
        "stages": {"solve": {"seconds": 1.0, "peak_memory_bytes": 2e8}},
        "notes": ["the numbers <b>are</b> synthetic"],
        "accuracy": "asked e_band <= 0.05, estimated 0.02: met",
    }
    (place / "run.json").write_text(json.dumps(account))


def layered(scenario: Scenario, mesh: TissueMesh) -> tuple[Compliance, np.ndarray]:
    """The layered model between the ports, and the field of one contact over the radius."""
    ports = place_ports(scenario, mesh)
    f = np.arange(2, 81) * 5.0
    discs = [Disc(p.position[0], p.position[1], p.radius if p.kind == "contact" else 0.0) for p in ports]
    layers, omega = flat_layers(scenario), 2 * np.pi * f
    values = np.full((len(f), len(ports), len(ports)), np.nan + 0j)
    values[:, :, :4] = layered_compliance(layers, omega, discs[:4], discs, tolerance=1e-4).values
    values[:, :4] = values[:, :, :4].swapaxes(1, 2)
    errors = (
        ErrorEstimate("discretisation", 0.02, "two meshes", (10.0, 400.0), (0.01, 0.03)),
        ErrorEstimate("reduction", 1e-6, "residual"),
    )
    here, parts = discs[0], np.split(RADII, range(7, len(RADII), 7))  # few at once: each is computed with each
    along = [[Disc(here.x + r, here.y) for r in part] for part in parts]
    radial = [layered_compliance(layers, omega, [here], [here, *a], tolerance=1e-4).values[:, 1:, 0] for a in along]
    return Compliance(f, values, ports, errors), np.concatenate(radial, axis=1)


def field(scenario: Scenario, mesh: TissueMesh, compliance: Compliance, radial: np.ndarray) -> Wavefield:
    """Upward motion by the distance from each contact, fading with depth."""
    contacts = [p for p in compliance.ports if p.kind == "contact"]
    n = len(RADII)
    modes = np.zeros((len(mesh.points), 3, n * len(contacts)))
    for k, port in enumerate(contacts):
        gap = np.hypot(*(mesh.points[:, :2] - port.position[:2]).T)
        hats = np.array([np.interp(gap, RADII, e) for e in np.eye(n)]).T
        modes[:, 2, k * n : (k + 1) * n] = hats * np.exp(mesh.points[:, 2:] / 6e-3)
    force = contact_state(compliance, scenario.device).force
    amplitudes = np.einsum("fr,fci->fcri", radial, force).reshape(len(radial), -1, force.shape[2])
    return Wavefield(compliance.frequency, modes, amplitudes)


def write_signals(place: Path, transfer: TransferMatrix) -> None:
    """Drives, displacements and S of the thesis' three methods."""
    done = render_all(transfer, wavelet=ricker(duration=0.2))
    time = next(iter(done.values())).drives.time
    sent = stack({k: v.drives.signals for k, v in done.items()}, tuple(p.name for p in transfer.inputs), time, "V")
    moved = {k: v.displacements.values for k, v in done.items()}
    reached = stack(moved, tuple(p.name for p in transfer.outputs), time, "m")
    write_drives(place / "drives.nc", sent)
    write_displacements(place / "displacements.nc", replace(reached, positions=positions(transfer.outputs)))
    rows = strength_rows(done.methods, done.targets, done.strengths)
    write_signal_strength_csv(place / "signal_strength.csv", rows)


def test_the_field_between_the_points_passes_through_the_points(folder: Path) -> None:
    """Interpolated linearly on facets of 4 mm, so 12 % of the largest entry at the worst is the mesh's, not a bug."""
    run = Results.open(folder)
    g = run.transfer
    patch = volar_patch(run.mesh, (*g.inputs, *g.outputs))
    corners, weights = patch.weights(positions(g.outputs)[:, :2])
    there = patch.normal_field(run.wavefield).between(corners, weights).response(0)
    low = g.frequency < 200
    assert np.abs(there - g.values[:, :, 0])[low].max() < 0.12 * np.abs(g.values[low]).max()
