"""Borders that a stranger found open: each mistake is one sentence before any work, or no mistake at all."""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
from cli_runner import SMALL, cli, leftovers
from test_compare import A

from forearm_fem.accuracy.estimates import accuracy_verdict
from forearm_fem.engines.simulation import render, simulate
from forearm_fem.errors import ForearmError, HardwareError, MeshError, ScenarioError
from forearm_fem.files.recipe import load_recipe
from forearm_fem.geometry.build import build_mesh
from forearm_fem.measurement.daq import Wiring
from forearm_fem.measurement.playback import LONGEST, play
from forearm_fem.measurement.virtual import VirtualDaq, VirtualOptions
from forearm_fem.metrics.common_ground import common_ground
from forearm_fem.ports import Port, distances
from forearm_fem.questions.calibrate import VirtualSetup
from forearm_fem.questions.campaign import load_campaign
from forearm_fem.questions.compare.compare import compare
from forearm_fem.questions.compare.readings import explained
from forearm_fem.questions.compare.report import picture
from forearm_fem.questions.design import load_design
from forearm_fem.questions.predict import run as runs
from forearm_fem.questions.predict.run import Question, predict
from forearm_fem.rendering import ricker
from forearm_fem.scenario import Scenario, apply_overrides, load_scenario, parse_scenario
from forearm_fem.scenario.measurement import DaqOptions
from forearm_fem.show.calibration import save_live
from forearm_fem.show.report import _layered, thesis_fit
from forearm_fem.study.plan import load_study
from forearm_fem.transfer import TransferMatrix

pytestmark = pytest.mark.drawn


def test_what_the_system_refuses_is_a_sentence_wherever_it_comes_up(tmp_path: Path) -> None:
    for arguments in (("run", "x" * 300), ("run", "thesis", "--dry-run", "--out", "y" * 300)):
        answer = cli(*arguments, "--set", "engine=layered", cwd=tmp_path)
        assert answer.code in (0, 2)  # a dry run writes nothing
    assert cli("run", "x" * 300, cwd=tmp_path).sentence.endswith("File name too long")
    (tmp_path / "small.toml").write_text(SMALL)
    assert cli("run", "small.toml", "--out", "y" * 300, cwd=tmp_path).sentence.endswith("File name too long")
    assert leftovers(tmp_path) == ["small.toml"]


def test_an_override_of_several_lines_is_no_value() -> None:
    with pytest.raises(ScenarioError, match=r"device\.spacing: input should be a valid number"):
        parse_overridden("device.spacing=0.04\ndevice.rows=9")


@pytest.mark.parametrize("text", [".04", "4.e-2", "+.04", "0.04"])
def test_a_number_is_read_as_people_write_it(text: str) -> None:
    """TOML has no .04; "input should be a valid number, got '.04'" was no help."""
    assert parse_overridden(f"device.spacing={text}").device.spacing == 0.04


def parse_overridden(item: str) -> Scenario:
    return parse_scenario(apply_overrides({}, [item]))


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (
            {"device": {"out_of_contact": "[A1, A2]"}},
            'device.out_of_contact: input should be a list, got \'[A1, A2]\'; write ["A1", "A2"], in a shell between ',
        ),
        ({"device": 3}, "device: input should be a table, got 3"),
        ({"rendering": {"window": "all"}}, "rendering.window: input should be 'wavelet' or 'record', or a list"),
        ({"device": {"columns": [1, 25]}}, "device.columns.1: expected 1 to 20, got 25"),
        ({"limb": {"shape": "mesh", "file": "x", "regions": {"1": 5}}}, "limb.regions.1: input should be a valid s"),
        ({"tissues": {"override": {"forearm": {"mu": "x"}}}}, "tissues.override.forearm.mu: input should be a valid n"),
        ({"tissues": {"override": {"a[b": {"mu": "x"}}}}, "tissues.override.a[b.mu: input should be a valid number"),
    ],
)
def test_sentences_name_keys_that_stand_in_the_file(data: Mapping[str, Any], says: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        parse_scenario(data)
    assert str(caught.value).startswith(f"scenario: {says}")


@pytest.mark.parametrize("read", [load_campaign, load_design, load_study, load_recipe])
@pytest.mark.parametrize("text", ["x = " + "[" * 4000, "x = " + "9" * 5000, "x = ", b"\xff"])
def test_every_file_in_toml_is_read_with_the_same_care(tmp_path: Path, read: Any, text: str | bytes) -> None:
    file = tmp_path / "file.toml"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ForearmError, match=r"file\.toml: "):
        read(file)
    with pytest.raises(ForearmError, match="no such"):
        read(tmp_path / "none.toml")


@pytest.mark.parametrize("name", ["..", ".", "-", "a/b", "con", "x" * 101])
def test_a_campaign_stays_in_its_folder(tmp_path: Path, name: str) -> None:
    (tmp_path / "small.toml").write_text(SMALL)
    file = tmp_path / "c.toml"
    file.write_text(f'name = "{name}"\nscenario = "small.toml"\n')
    with pytest.raises(ScenarioError, match="name: expected a folder's name"):
        load_campaign(file)
    file.write_text(f'name = "c"\nscenario = "small.toml"\n[[members]]\nname = "{name}"\n')
    with pytest.raises(ScenarioError, match="name: expected a folder's name"):
        load_campaign(file)


@pytest.mark.parametrize(
    ("key", "values", "why"),
    [
        ("engine", '["fem", "layered"]', "no candidate changes with it, for no mesh is made"),
        ("name", '["a", "b"]', "no candidate changes with it"),
        ("mesh.size_grid", "[0.002, 0.004]", "no candidate changes with it, for no mesh is made"),
        ("supports.ends", '["free", "absorb"]', "no candidate changes with it"),
        ("grid.pitch", "[0.01, 0.012]", "no effect: grid.points is given"),
    ],
)
def test_a_design_refuses_to_vary_what_no_candidate_reads(tmp_path: Path, key: str, values: str, why: str) -> None:
    (tmp_path / "small.toml").write_text(SMALL + '[grid]\npoints = [[0.0, 0.0], [0.01, 0.0], [0.0, 0.01], [0.01, 0.01],'
                                         '[-0.01, 0.0], [-0.01, -0.01]]\n')  # fmt: skip
    file = tmp_path / "d.toml"
    file.write_text(f'name = "d"\nscenario = "small.toml"\n[[variables]]\nkey = "{key}"\nvalues = {values}\n')
    with pytest.raises(ScenarioError, match=f"{key}: {why}"):
        load_design(file)
    file.write_text(
        'name = "d"\nscenario = "small.toml"\n[[variables]]\nkey = "device.rotation"\nvalues = [0.0, 0.1]\n'
    )
    assert load_design(file).asked.variables[0].key == "device.rotation"


def test_a_prediction_that_ends_before_its_first_draw_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object) -> Any:
        raise KeyboardInterrupt

    monkeypatch.setattr(runs, "drawn", interrupted)
    scene = {"engine": "layered", "sweep": {"duration": 0.1}, "device": {"cone": {"contact": "pressure"}}}
    with pytest.raises(KeyboardInterrupt):
        predict(Question(parse_scenario(scene), Path()), tmp_path / "p", draws=20, workers=1)
    assert leftovers(tmp_path) == []


@pytest.mark.parametrize(("snr", "seed"), [(float("nan"), 0), (-500.0, 0), (-float("inf"), 0), (60.0, -1)])
def test_a_virtual_sensor_that_cannot_be_is_refused_before_it_records(snr: float, seed: int) -> None:
    with pytest.raises(ScenarioError, match=r"--snr: expected|--seed: expected"):
        VirtualSetup(A, snr, seed=seed)
    assert VirtualSetup(A, float("inf")).seed == 0


@pytest.mark.parametrize(("repeats", "pause"), [(10**9, 0.0), (1, 1e300), (1, float("nan"))])
def test_what_would_play_for_days_is_refused(repeats: int, pause: float) -> None:
    daq, options = VirtualDaq(A, 2000.0, 0.25, VirtualOptions()), DaqOptions(outputs=("a", "b", "c", "d"))
    with pytest.raises(HardwareError, match=f"expected at most {LONGEST:g} s"):
        play(daq, np.zeros((4, 500)), 2000.0, options, repeats=repeats, pause=pause)


@pytest.mark.parametrize(("rate", "outputs"), [(1000.0, ("a", "b", "c", "d")), (2000.0, ("a", "b", "c"))])
def test_a_virtual_device_is_opened_as_its_g_was_prepared(rate: float, outputs: tuple[str, ...]) -> None:
    daq = VirtualDaq(A, 2000.0, 0.25, VirtualOptions())
    daq.open(Wiring(2000.0, ("a", "b", "c", "d"), ("e",)))
    with pytest.raises(HardwareError, match=r"the virtual device has 4 outputs at 2000 Hz, asked for"):
        daq.open(Wiring(rate, outputs, ("e",)))


def test_pictures_of_no_difference_and_of_a_dead_channel_raise_no_warning(tmp_path: Path) -> None:
    picture(compare(A, A, render=False)).savefig(io.BytesIO(), format="png", dpi=20)
    dead = A.values.copy()
    dead[:, :, 0] = 0
    silent = replace(A, values=dead)
    picture(compare(silent, A, render=False)).savefig(io.BytesIO(), format="png", dpi=20)
    save_live(tmp_path / "live.png", replace(A, values=0 * dead), np.ones(dead.shape))
    assert (tmp_path / "live.png").stat().st_size > 0


def test_an_option_without_effect_is_refused(tmp_path: Path) -> None:
    answer = cli("new", "mine", "--arm", "small", "--length", 0.3, cwd=tmp_path)
    assert answer.code == 2
    assert "--length: has no effect with --arm" in answer.sentence
    assert "leave no muscle" in cli("new", "mine", "--arm", "small", "--skinfold", 0.2, cwd=tmp_path).sentence
    assert leftovers(tmp_path) == []


def test_a_sweep_that_misses_every_bin_is_refused_before_it_is_solved(tmp_path: Path) -> None:
    (tmp_path / "small.toml").write_text(SMALL)
    for command in ("run", "render"):
        answer = cli(command, "small.toml", "--set", "sweep.frequencies=[41.0]", cwd=tmp_path)
        assert "no bin of the record" in answer.sentence
        assert leftovers(tmp_path) == ["small.toml"]


def test_points_abreast_of_each_other_are_no_line_to_fit_waves_on(tmp_path: Path) -> None:
    (tmp_path / "small.toml").write_text(SMALL)
    sets = ("--set", "rendering.methods=[]", "--set", "rendering.targets='all'", "--set", "sweep.f_max=60")
    answer = cli("run", "small.toml", *sets, "--set", "device.rows=1", "--out", "out", cwd=tmp_path)
    assert answer.code == 0, answer.err
    assert not (tmp_path / "out" / "waves.csv").exists()
    line = "grid.points=[[0.01, 0.0], [0.015, 0.0], [0.02, 0.0], [0.025, 0.0], [0.03, 0.0]]"
    answer = cli("run", "small.toml", *sets, "--set", "device.contacts=[[0.0, 0.0]]", "--set", line, "--out", "line",
                 cwd=tmp_path)  # fmt: skip
    assert answer.code == 0, answer.err
    assert (tmp_path / "line" / "waves.csv").is_file()


def test_a_point_under_the_cone_is_in_no_wave_fit_of_a_report() -> None:
    """A line that starts under the cone, as scenarios/line.toml has one."""
    source = Port("A1", "contact", (0.0, 0.0, 0.0), radius=3.5e-3, contact="bonded")
    outputs = tuple(Port(str(k), "point", (2.5e-3 * (k + 1), 0.0, 0.0)) for k in range(8))
    frequency = np.array([60.0, 120.0])
    k = (2 * np.pi * frequency / 3.0 - 50j)[:, None, None]
    values = 1e-5 * np.exp(-1j * k * distances(outputs, (source,)))
    values[:, 0] = 1e-4
    fit = thesis_fit(TransferMatrix(frequency, values, outputs, (source,)))
    assert fit is not None
    assert fit.speed == pytest.approx(3.0)
    assert fit.attenuation == pytest.approx(50.0)


def test_the_layered_model_beside_a_report_has_the_same_gains() -> None:
    scene = {"engine": "layered", "limb": {"shape": "slab"}, "sweep": {"frequencies": [100.0]},
             "device": {"contacts": [[0.0, 0.0]], "drive": "force", "gains": {"A1": 0.5}},
             "grid": {"points": [[0.015, 0.0], [0.02, 0.0]]}, "rendering": {"methods": []}}  # fmt: skip
    scenario = parse_scenario(scene)
    assert "0.0000" in _layered(scenario, simulate(scenario).transfer).rows[-1]


def test_an_error_that_nobody_asked_for_is_unknown_not_zero() -> None:
    slab = {"shape": "slab", "length": 0.06, "width": 0.06, "depth": 0.02}
    coarse = {"size_contact": 0.006, "size_grid": 0.01, "size_far": 0.02, "sublayers": {"skin": 1, "fat": 1}}
    solver = {"sweep": "direct", "discretisation_estimate": False}
    scenario = parse_scenario(
        {"limb": slab, "mesh": coarse, "device": {"contacts": [[0.0, 0.0]], "cone": {"contact": "pressure"}},
         "grid": {"points": [[0.015, 0.0]]}, "sweep": {"frequencies": [100.0]}, "solver": solver, "accuracy": 0.5,
         "rendering": {"methods": []}}
    )  # fmt: skip
    found = simulate(scenario)
    assert {e.source for e in found.transfer.errors if not e.known} == {"discretisation", "truncation"}
    assert "UNKNOWN" in accuracy_verdict(scenario, found.transfer.errors)
    assert any("the error by discretisation is unknown" in note for note in found.notes)


def test_a_mesh_too_coarse_for_its_contacts_is_told_where_and_how_fine(tmp_path: Path) -> None:
    n = (8, 8, 4)
    axes = [
        np.linspace(low, high, k + 1) for low, high, k in zip((-0.04, -0.04, -0.02), (0.04, 0.04, 0.0), n, strict=True)
    ]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    number = np.arange(len(points)).reshape([k + 1 for k in n])
    corners = [number[i : n[0] + i, j : n[1] + j, k : n[2] + k].ravel() for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    kuhn = [(0, 1, 3, 7), (0, 5, 1, 7), (0, 3, 2, 7), (0, 2, 6, 7), (0, 4, 5, 7), (0, 6, 4, 7)]
    cells = np.vstack([np.stack([corners[c] for c in cell], axis=1) for cell in kuhn])
    region = np.ones(len(cells), dtype=int)
    meshio.Mesh(points, [("tetra", cells)], cell_data={"region": [region]}).write(tmp_path / "block.vtu")
    limb = {"shape": "mesh", "file": "block.vtu", "regions": {"1": "muscle"}}
    scene = {"limb": limb, "device": {"spacing": 0.03, "cone": {"contact": "pressure"}}, "grid": {"pitch": 0.008}}
    with pytest.raises(MeshError, match=r"edges under contact A1 are 10 mm and longer, its radius is 3\.5 mm: remesh"):
        build_mesh(parse_scenario(scene), base=tmp_path)


@pytest.mark.parametrize(
    ("dead", "says"), [(slice(None), "B is zero at every entry"), (1, "B is zero at A2: a dead c")]
)
def test_a_dead_channel_is_said_when_two_matrices_are_compared(dead: Any, says: str) -> None:
    values = A.values.copy()
    values[:, :, dead] = 0
    assert explained(common_ground(A, replace(A, values=values))).startswith(says)
    assert "A is zero" in explained(common_ground(replace(A, values=values), A))
    assert explained(common_ground(A, A)) == ""


@pytest.mark.parametrize(
    ("built", "says"),
    [
        (lambda: Scenario(accuracy=7), "Scenario: accuracy: expected 1e-05 to 0.5, got 7"),
        (lambda: Scenario(device={"spacng": 0.04}), "Scenario: device.spacng: unknown key; did you mean "
                                                    "device.spacing?"),
        (lambda: Scenario(tissues={"muscle": {"mu": 9e3}}), "Scenario: tissues.muscle: unknown key; did you mean "
                                                            "tissues.override.muscle?"),
        (lambda: Scenario(limb={"length": "l"}), "Scenario: limb.length: input should be a valid number, got 'l'"),
        (lambda: Scenario(limb={"shape": "mesh", "depth": 0.02, "file": "a.vtu", "regions": {"1": "fat"}}),
         "Scenario: limb.depth: has no meaning where limb.shape is 'mesh'; leave it out"),
    ],
)  # fmt: skip
def test_a_scenario_built_in_python_is_told_what_a_file_is_told(built: Any, says: str) -> None:
    with pytest.raises(ScenarioError) as said:
        built()
    assert str(said.value) == says


def test_a_scenarios_name_where_a_scenario_is_wanted_is_told_how_to_read_it() -> None:
    with pytest.raises(ScenarioError, match=r"got 'quick'; read it first: load_scenario"):
        simulate("quick")  # type: ignore[arg-type]


def test_a_wavelets_file_is_seen_from_where_simulate_was_told(tmp_path: Path) -> None:
    samples = ricker(120.0, sample_rate=2000.0, duration=0.25).samples  # within the scene's band
    np.savetxt(tmp_path / "here.csv", samples)
    (tmp_path / "small.toml").write_text(SMALL + 'wavelet = { file = "here.csv" }\n')
    scene = load_scenario(tmp_path / "small.toml")
    assert render(simulate(scene, base=tmp_path))["funneling", "5"].strength > 0
    with pytest.raises(ForearmError, match=r"here\.csv: no such file"):
        render(simulate(scene))


def test_a_notebooks_slips_are_sentences() -> None:
    small = {"engine": "layered", "limb": {"shape": "slab"}, "sweep": {"frequencies": [100.0]}}
    g = simulate(parse_scenario(small)).transfer
    slips: Mapping[str, Any] = {
        r"put it into brackets": lambda: load_scenario("quick", overrides="accuracy=.3"),
        r"a scenario's file or name, got a dict": lambda: load_scenario({"accuracy": 0.3}),  # type: ignore[arg-type]
        r"what simulate\(\) gives, got a TransferMatrix": lambda: render(g),  # type: ignore[arg-type]
        r"positive and increasing ones, got nan Hz as number 1": lambda: replace(g, frequency=np.array([np.nan])),
        r"finite size": lambda: ricker(float("nan")),
    }
    for says, slip in slips.items():
        with pytest.raises(ForearmError, match=says):
            slip()


def test_g_of_a_simulation_says_its_scenario_so_that_it_is_compared_with_its_own_renderers() -> None:
    scenario = parse_scenario(
        {"engine": "layered", "limb": {"shape": "slab"}, "rendering": {"wavelet": {"peak": 100.0}},
         "device": {"cone": {"contact": "pressure"}}, "sweep": {"f_min": 20, "f_max": 200, "duration": 0.2}}
    )  # fmt: skip
    own = simulate(scenario)
    crossed = compare(own.transfer, own.transfer).crossed
    assert crossed is not None
    assert np.array_equal(crossed.a_on_a, render(own).strengths)
