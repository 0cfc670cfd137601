"""Hard cases of finite elements and solvers: right within a stated error, or refused by name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg

from forearm_fem.accuracy.discretisation import COARSER, remaining_error
from forearm_fem.errors import GeometryError, MeshError, SolverError
from forearm_fem.fem.assembly.model import ForearmModel, build_model
from forearm_fem.fem.reduction.sweep import direct_sweep, reduced_sweep
from forearm_fem.geometry.build import build_mesh
from forearm_fem.geometry.mesh.tissue_mesh import TissueMesh
from forearm_fem.layered import Disc, Layer, layered_compliance
from forearm_fem.ports import Port
from forearm_fem.scenario import Scenario, parse_scenario
from forearm_fem.scenario.limb import FreeUnderside, Membrane
from forearm_fem.scenario.sweep import DirectSolve, ReducedSolve
from forearm_fem.tissue import Hysteretic, KelvinVoigt, Tissue
from forearm_fem.transfer import relative_error
from forearm_fem.typing import ComplexArray, FloatArray
from forearm_fem.verification.scenes import (
    DIRECT,
    RADIUS,
    block_mesh,
    flesh,
    held_block,
    layered_truth,
    quarter_slab,
    slab_model,
    slab_response,
)

COARSE = {"size_grid": 3e-3, "size_contact": 1.2e-3, "size_far": 9e-3}


def gap(found: ComplexArray, truth: ComplexArray) -> float:
    return float(np.nanmax(np.abs(found - truth)) / np.nanmax(np.abs(truth)))


def slab_gap(scenario: Scenario, frequency: float) -> float:
    return gap(slab_response(slab_model(scenario), [frequency])[0], layered_truth(scenario, [frequency])[0])


# --- materials -------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("bulk", [1e4, 1e6, 1e8, 1e10, 1e12, "incompressible"])
def test_any_bulk_modulus(bulk):
    """The 3 mm mesh leaves 0.4 % at 200 Hz whatever the bulk modulus."""
    override = {"muscle": {"bulk": bulk}}
    assert slab_gap(quarter_slab((0.01, 0.02), depth=0.05, mesh=COARSE, override=override), 200.0) < 0.02


def modes(model: ForearmModel) -> tuple[FloatArray, FloatArray]:
    """Squared angular frequencies (m,) and mass-normalised port shapes (n_port, m), pressure condensed by hand."""
    operator, n = model.operator, model.operator.n_displacements
    stiff = operator.multiply(operator.data(0.0), np.eye(operator.n)).real
    both = operator.multiply(operator.data(1.0), np.eye(operator.n)).real
    condensed = stiff[:n, :n] - stiff[:n, n:] @ np.linalg.solve(stiff[n:, n:], stiff[n:, :n])
    values, vectors = scipy.linalg.eigh(condensed, (stiff - both)[:n, :n])
    return values, model.functionals[:n].T @ vectors


def test_beside_a_resonance_without_loss_the_modal_sum_is_met_and_at_it_the_solve_is_refused():
    """Resonances from a dense eigensolver, which carries 1e-10, enlarged by 1 / detuning."""
    model = held_block(1, tissue=flesh(eta=0.0, bulk=2.2e6))
    values, shapes = modes(model)
    first = float(np.sqrt(values[0]) / (2 * np.pi))
    for detuning in (1e-2, 1e-4, 1e-6):
        f = first * (1 + detuning)
        truth = (shapes / (values - (2 * np.pi * f) ** 2)) @ shapes.T
        found = direct_sweep(model, np.array([f]), DIRECT).values[0]
        assert gap(found, truth.astype(complex)) < 1e-9 / detuning
    with pytest.raises(SolverError, match="undamped resonance"):
        direct_sweep(model, np.array([first]), DIRECT)


@pytest.mark.parametrize(("frequency", "allowed"), [(0.0, 1e-9), (1e-3, 1e-7), (0.5, 5e-3)])
def test_low_frequencies_and_static(frequency, allowed):
    """C = C0/(1 + i w eta/mu) for a homogeneous block, up to inertia (w/w0)^2."""
    still = direct_sweep(held_block(2, tissue=flesh(eta=0.0)), np.array([1e-6]), DIRECT).values[0]
    found = direct_sweep(held_block(2), np.array([frequency]), DIRECT).values[0]
    assert gap(found, still / (1 + 2j * np.pi * frequency * 5.03 / 7860.0)) < allowed


@pytest.mark.slow
def test_far_above_the_band():
    """2 kHz: waves of 2-4 mm in skin, 0.7 % seen."""
    mesh = {"size_grid": 1.5e-3, "size_contact": 0.8e-3, "size_far": 4e-3}
    scenario = quarter_slab((0.006,), side=0.05, depth=0.02, mesh=mesh, frequencies=(2000.0,))
    assert slab_gap(scenario, 2000.0) < 0.03


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["membrane", "tetrahedra"])
def test_a_stiff_thin_epidermis(kind):
    """1 MPa x 80 um on fat of 1 kPa: as a membrane, and as tetrahedra twelve times flatter than wide; 2 % seen."""
    override = {
        "muscle": {"density": 950.0, "mu": 1e3, "eta": 0.5, "bulk": 2.2e9},
        "skin": {"density": 1100.0, "mu": 1e6, "eta": 20.0, "bulk": 2.2e9},
    }
    layers = [
        Layer(8e-5, 1100.0, KelvinVoigt(1e6, 20.0).at, 2.2e9),
        Layer(np.inf, 950.0, KelvinVoigt(1e3, 0.5).at, 2.2e9),
    ]
    discs = [Disc(0, 0, RADIUS), Disc(0.01, 0)]
    truth = layered_compliance(layers, np.array([2 * np.pi * 100.0]), discs[:1], discs).values[0, :, 0]
    if kind == "membrane":
        del override["skin"]
    scenario = quarter_slab(
        (0.01,), side=0.1, override=override, mesh={"size_grid": 2e-3, "size_contact": 1e-3, "size_far": 6e-3},
        layers=(("skin", 8e-5),) if kind == "tetrahedra" else (),
        membrane={"stiffness": 80.0, "viscosity": 1.6e-3, "mass": 0.088} if kind == "membrane" else None,
    )  # fmt: skip
    assert gap(slab_response(slab_model(scenario), [100.0])[0], truth) < 0.03


def test_elastic_bone_is_as_good_as_held_still():
    """Flesh on half a block of bone (17 GPa) held at its far end, against flesh held at the joint, 5-500 Hz."""
    bone = Tissue("bone", 1860.0, Hysteretic(6.5e9, 0.02), 1.4e10)
    both = block_mesh((6, 2, 2), (0.024, 0.008, 0.008), facets={"end": ("x0",)}, regions=("bone", "block"))
    flesh_only = block_mesh((3, 2, 2), (0.012, 0.008, 0.008), facets={"end": ("x0",)})
    values = []
    for mesh, shift in ((both, 0.012), (flesh_only, 0.0)):
        places = ((0.009, 0.003), (0.011, 0.006))
        ports = tuple(Port(str(i), "point", (shift + x, y, 0.008)) for i, (x, y) in enumerate(places))
        model = build_model(mesh, ports, {"bone": bone, "block": flesh()}, FreeUnderside(ends="fixed"), Membrane())
        values.append(direct_sweep(model, np.array([5.0, 100.0, 500.0]), DIRECT).values)
    assert relative_error(*values).max() < 1e-4


# --- supports and contacts -------------------------------------------------------------------------------------------


def test_a_free_block_is_a_mass_and_has_no_static_position():
    """Against -1/(m w^2); the elastic part leaves m w^2 C_elastic = 4.4e-4 (f / Hz)^2."""
    model, mass = held_block(2, ends="free"), 1050 * 0.024 * 0.016 * 0.008
    for f in (5.0, 0.5, 0.05, 0.01):
        found = direct_sweep(model, np.array([f]), DIRECT).values[0, 0, 0]
        assert abs(-found * (2 * np.pi * f) ** 2 * mass - 1) < 6e-4 * f**2 + 1e-6
    with pytest.raises(SolverError, match="hold the limb"):
        direct_sweep(model, np.array([0.0]), DIRECT)


@pytest.mark.slow
def test_a_contact_smaller_than_an_element():
    """A disc of 0.4 mm radius on a mesh of 4 mm: sized by its radius where no size is asked, refused where 5 mm are."""

    def tiny(size: float | None, quality: float) -> Scenario:
        mesh = {"size_grid": 4e-3, "size_contact": size, "size_far": 12e-3, "min_quality": quality}
        scenario = quarter_slab((0.01,), depth=0.06, mesh=mesh)
        cone = scenario.device.cone.model_copy(update={"radius": 4e-4})
        return scenario.model_copy(update={"device": scenario.device.model_copy(update={"cone": cone})})

    assert slab_gap(tiny(None, 0.001), 100.0) < 0.03  # 1 % seen
    with pytest.raises(MeshError, match="quality"):
        slab_model(tiny(5e-3, 0.02))


def test_a_cone_wider_than_the_limb_is_refused():
    data = {"limb": {"shape": "cylinder", "diameter": 0.012}, "grid": {"points": [[0.02, 0.0]]}}
    with pytest.raises(GeometryError, match="reaches beyond the limb"):
        build_mesh(parse_scenario({**data, "device": {"contacts": [[0.0, 0.0]], "cone": {"radius": 7e-3}}}))


@pytest.mark.parametrize(
    ("contacts", "says"),
    [(((0.0, 0.0), (0.007, 0.0)), "need 7.35 mm"), (((0.028, 0.0),), "beside the symmetry plane")],
)
def test_contacts_that_touch_or_hang_over_an_edge_are_refused(contacts, says):
    scenario = quarter_slab((0.02,), side=0.06)
    device = scenario.device.model_copy(update={"contacts": contacts})
    with pytest.raises(GeometryError, match=says):
        slab_model(scenario.model_copy(update={"device": device}))


# --- meshes ----------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_layer_twenty_times_thinner_than_elements_are_wide():
    """Skin of 0.15 mm on elements of 3 mm: 0.2 % seen."""
    layers = (("skin", 1.5e-4), ("fat", 3e-3))
    assert slab_gap(quarter_slab((0.01, 0.02), depth=0.05, layers=layers, preset="default", mesh=COARSE), 100.0) < 0.02


@pytest.mark.parametrize("left", [1e-2, 1e-4])
def test_slivers_do_no_harm(left):
    """20 inner vertices pushed until their flattest tetrahedron keeps ``left`` of its height; they change the mesh's
    own error of about 1 %."""
    model = held_block(3)
    bad = build_model(
        flattened(model.space.mesh, left), model.ports, {"block": flesh()}, FreeUnderside(ends="fixed"), Membrane()
    )
    found, truth = (direct_sweep(m, np.array([150.0]), DIRECT).values[:, :, :1] for m in (bad, model))
    assert gap(found, truth) < 0.01


def flattened(mesh: TissueMesh, left: float) -> TissueMesh:
    """Every tenth inner vertex moved along a height of one of its tetrahedra, all volumes kept positive."""
    points = mesh.points.copy()
    low, high = points.min(axis=0), points.max(axis=0)
    inner = np.flatnonzero(((points > low + 1e-9) & (points < high - 1e-9)).all(axis=1))
    worst = 1.0
    for vertex in inner[:: max(1, len(inner) // 20)]:
        tet = mesh.tetrahedra[(mesh.tetrahedra == vertex).any(axis=1)][0]
        base = mesh.points[tet[tet != vertex]]
        normal = np.cross(base[1] - base[0], base[2] - base[0])
        normal /= np.linalg.norm(normal)
        trial = points.copy()
        trial[vertex] -= (1 - left) * ((mesh.points[vertex] - base[0]) @ normal) * normal
        moved = replace(mesh, points=trial)
        if (moved.volumes > 0).all():
            points, worst = trial, min(worst, float((moved.volumes / mesh.volumes).min()))
    assert worst < left
    return replace(mesh, points=points)


@pytest.mark.parametrize("how", ["turned", "5 m away", "scaled"])
def test_a_mesh_that_is_moved_has_the_same_compliance(how):
    """The larger one is driven slower and with more viscosity, which keeps every dimensionless group; the coordinates'
    rounding leaves 2e-12."""
    c, s, eye = np.cos(0.7), np.sin(0.7), np.eye(3)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    q, shift, size = {"turned": (turn, 0.0, 1.0), "5 m away": (eye, 5.0, 1.0), "scaled": (eye, 0.0, 2.5)}[how]
    model, band = held_block(2), np.array([1.0, 40.0, 500.0])
    mesh = replace(model.space.mesh, points=size * model.space.mesh.points @ q.T + shift)
    ports = tuple(
        replace(p, position=tuple(size * q @ np.array(p.position) + shift), axis=tuple(q @ np.array(p.axis)))
        for p in model.ports
    )
    there = build_model(mesh, ports, {"block": flesh(eta=5.03 * size)}, FreeUnderside(ends="fixed"), Membrane())
    found = size * direct_sweep(there, band / size, DIRECT).values
    assert gap(found, direct_sweep(model, band, DIRECT).values) < 1e-9


@pytest.mark.slow
def test_a_strongly_curved_limb_states_its_error():
    """Against a finer mesh, its facets nearer to the round skin; allowed is twice what is stated."""
    scenario = parse_scenario(
        {
            "limb": {"shape": "cylinder", "diameter": 0.02, "length": 0.05},
            "supports": {"ends": "fixed"},
            "device": {"contacts": [[0.0, 0.0]], "cone": {"contact": "bonded", "radius": RADIUS}},
            "grid": {"points": [[0.008, 0.0], [0.012, 0.004]]},
            "sweep": {"frequencies": [150.0]},
            "mesh": {"size_grid": 3e-3, "size_contact": 1.8e-3, "size_far": 6e-3},
        }
    )
    coarse, own, fine = (slab_response(slab_model(scenario, scale=s), [150.0])[0, 1:] for s in (COARSER, 1.0, 0.75))
    assert gap(own, fine) < 2 * float(remaining_error(np.array(gap(coarse, own))))


# --- solvers and the reduced sweep -----------------------------------------------------------------------------------


def test_single_precision_where_the_bulk_modulus_is_stiffest():
    model, band = held_block(3, tissue=flesh(bulk=1e12)), np.array([0.5, 150.0, 2000.0])
    single, double = (direct_sweep(model, band, DirectSolve(precision=p)) for p in ("single", "double"))
    assert relative_error(single.values, double.values).max() < 1e-7


@pytest.mark.parametrize(
    ("options", "band"),
    [
        pytest.param(ReducedSolve(), (10.0, 500.0, 491), marks=pytest.mark.slow),
        pytest.param(ReducedSolve(expansions=1, max_expansions=1), (10.0, 500.0, 491), marks=pytest.mark.slow),
        pytest.param(ReducedSolve(expansions=12, max_expansions=12), (10.0, 500.0, 491), marks=pytest.mark.slow),
        pytest.param(ReducedSolve(expansions=12, max_expansions=40), (10.0, 500.0, 491), marks=pytest.mark.slow),
        # 0.2 Hz apart: solutions and derivatives span nearly the same space
        (ReducedSolve(start="frequencies", expansions=12, max_expansions=13), (99.0, 101.0, 41)),
    ],
)
def test_a_reduced_model_at_sharp_resonances(options, band):
    """Loss of 0.3 % at 100 Hz: true e(f) at seven bins, the peak and its neighbours among them; allowed is five times
    what was stated."""
    model, band = held_block(2, tissue=flesh(eta=0.04, bulk=2.2e9)), np.linspace(*band)
    swept = reduced_sweep(model, band, options, tolerance=1e-4)
    peak = int(np.argmax(np.abs(swept.values[:, 0, 0])))
    shares = (np.array([0.0, 0.5, 0.8, 1.0]) * (len(band) - 1)).astype(int)
    where = np.unique(np.clip([*shares, peak - 1, peak, peak + 1], 0, len(band) - 1))
    truth = direct_sweep(model, band[where], DIRECT).values
    error = relative_error(swept.values[where][:, 1:, :1], truth[:, 1:, :1]).max()
    assert error < max(1e-4, 5 * (swept.reduction_error if swept.certificates else 0.0))


@pytest.mark.slow
def test_ways_to_solve_agree():
    """Single with double precision, the reduced sweep with direct solves, poles and residues with dense solves."""
    model, band = held_block(3, tissue=flesh(bulk=2.2e9)), np.linspace(10.0, 500.0, 197)
    checks = np.array([10.0, 33.0, 80.0, 140.0, 210.0, 333.0, 470.0, 500.0])
    truth = direct_sweep(model, checks, DIRECT).values
    single = direct_sweep(model, checks, DirectSolve(precision="single")).values
    assert relative_error(single, truth).max() < 1e-7  # refined to a residual of 1e-9
    swept = reduced_sweep(model, band, ReducedSolve(), tolerance=1e-6)
    assert relative_error(swept.reduced.compliance(checks), truth).max() < 1e-5  # asked for 1e-6 where least certain
    fast = swept.reduced.modes()
    assert relative_error(fast.compliance(band), swept.reduced.compliance(band)).max() < 1e-8  # its own limit
