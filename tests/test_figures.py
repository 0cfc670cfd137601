"""Figures: numbers beside them, names, formats, unfinished and read-only folders, notebooks."""

from __future__ import annotations

import csv
import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib import style
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from PIL import Image
from test_figures_scene import folder  # noqa: F401

from forearm_fem.errors import DataError, NotApplicable
from forearm_fem.layered.closed_forms import rayleigh_wavenumber
from forearm_fem.layered.kernel import Layer, surface_kernel
from forearm_fem.layered.root import trace_root
from forearm_fem.ports import Port
from forearm_fem.scenario import Scenario, parse_scenario
from forearm_fem.scenario.model import resolve_tissues
from forearm_fem.show import (
    Results,
    conditioning,
    conditioning_of,
    dispersion,
    kinds,
    make_figures,
    plot_conditioning,
    plot_errors,
    plot_table_one,
    plot_target,
    plot_transfer,
    strengths,
    table_one,
    target_waves,
    transfer_of,
)
from forearm_fem.show.device import drive_levels, moments, plot_drives
from forearm_fem.show.judge import errors
from forearm_fem.show.matrix import _row, kernel_root, line, travel
from forearm_fem.show.registry import _chosen
from forearm_fem.show.style import SHEET, arrange
from forearm_fem.store.text import write_json
from forearm_fem.tissue import KelvinVoigt
from forearm_fem.transfer import ErrorEstimate, entry_errors

pytestmark = pytest.mark.drawn


@pytest.fixture(scope="module")
def run(folder: Path) -> Results:  # noqa: F811
    return Results.open(folder)


@pytest.fixture(scope="module")
def made(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:  # noqa: F811
    """Every figure once, except for all but one of the targets."""
    out = tmp_path_factory.mktemp("figures")
    names = [n for n in kinds(Results.open(folder)) if not n.startswith(("target", "figure-6", "figure-7"))]
    make_figures(folder, out, only=[*names, "figure-6"])
    return out


def rows(path: Path) -> tuple[str, list[dict[str, str]]]:
    source, *lines = path.read_text(encoding="utf-8").splitlines()
    return source, list(csv.DictReader(lines))


def test_every_figure_has_a_picture_and_its_numbers(made: Path) -> None:
    pictures = {p.stem for p in made.glob("*.png")}
    assert pictures == {p.stem for p in made.glob("*.csv")} & pictures
    assert {"figure-2", "figure-4", "figure-a2", "table-1", "figure-6", "mesh", "transfer"} <= pictures
    assert all(p.read_bytes()[:4] == b"\x89PNG" for p in made.glob("*.png"))
    assert not [p for p in made.iterdir() if p.name.startswith(".")]


def test_the_numbers_beside_a_figure_are_those_of_the_run(made: Path, run: Results) -> None:
    source, lines = rows(made / "transfer.csv")
    assert source.startswith("# scene tiny · mesh ")
    assert source.endswith("forearm_fem 0.0.test")
    entry = [line for line in lines if (line["output"], line["input"]) == ("5", "A2")]
    for name, truth in (("size", np.abs(run.transfer.values)), ("error", entry_errors(run.transfer))):
        np.testing.assert_allclose([float(line[f"{name}_m/V"]) for line in entry], truth[:, 4, 1], rtol=1e-9)


def test_entries_of_g_are_solid_where_they_are_known_and_pale_where_they_may_be_nothing(run: Results) -> None:
    """What is off by twice the largest entry may be nothing everywhere, by a millionth of the smallest nowhere."""
    g = run.transfer
    small = 1e-6 * float(np.abs(g.values).min() / np.abs(g.values).max())
    for size, solid in ((2.0, False), (small, True)):
        figure = plot_transfer(transfer_of(replace(g, errors=(ErrorEstimate("truncation", size, "stated here"),))))
        pale, known = (figure.axes[0].lines[k::2] for k in (0, 1))
        assert {line.get_alpha() for line in pale} == {0.35}
        assert all(np.isfinite(line.get_ydata()).all() == solid for line in known)
        assert all(np.isnan(line.get_ydata()).all() != solid for line in known)


def test_table_one_beside_the_thesis(made: Path, run: Results) -> None:
    _, lines = rows(made / "table-1.csv")
    middle = {x["side"]: x for x in lines if (x["group"], x["method"]) == ("Middle (5)", "funneling")}
    assert float(middle["here"]["mean"]) == pytest.approx(
        next(r.S for r in run.strengths if (r.target, r.method) == ("5", "funneling"))
    )
    assert float(middle["thesis"]["mean"]) == 0.63
    assert "| Middle (5) |" in (made / "table-1-table.md").read_text(encoding="utf-8")
    latex = (made / "table-1-table.tex").read_text(encoding="utf-8")  # a float that says what its numbers are
    assert latex.index(r"\begin{table}") < latex.index(r"\caption{") < latex.index(r"\begin{tabular}")


@pytest.mark.parametrize("width", [88, 181])
@pytest.mark.parametrize("people", [False, True])
def test_numbers_of_table_one_do_not_run_into_each_other(run: Results, people: bool, width: int) -> None:
    data = strengths(run)
    if people:  # the widest cells: with what a prediction says of arms
        groups = data.table().groups
        band = {"arms": [10.25, 11.75]}
        by_group = {m: dict.fromkeys(groups, band) for m in data.methods}
        data = replace(data, arms={"by_group": by_group, "groups": dict.fromkeys(groups, data.targets)})
    if people and width == 88:
        with pytest.raises(NotApplicable, match="need 181 mm"):
            plot_table_one(table_one(data), width=width)
        return
    figure = plot_table_one(table_one(data), width=width)
    FigureCanvasAgg(figure).draw()
    renderer = figure.canvas.get_renderer()
    (table,) = figure.axes[1].tables
    assert len(table.get_celld()) == 5 * (1 + 3 * len(data.methods))
    for cell in table.get_celld().values():
        box, words = cell.get_window_extent(renderer), cell.get_text().get_window_extent(renderer)
        assert not words.width or (box.x0 <= words.x0 and words.x1 <= box.x1), cell.get_text().get_text()


def test_the_target_figure_holds_the_nine_displacements(made: Path, run: Results) -> None:
    _, lines = rows(made / "figure-6.csv")
    mine = (x for x in lines if (x["method"], x["output"]) == ("inverse filter", "5") and x["u_m"] != "nan")
    own = sorted({float(x["time_s"]): float(x["u_m"]) for x in mine}.items())
    whole = run.displacements.values[0, 4, 4]
    at = np.searchsorted(run.displacements.time, [t for t, _ in own])
    np.testing.assert_allclose([u for _, u in own], whole[at], rtol=1e-8, atol=1e-20)


@pytest.mark.parametrize("width", [88, 181])
def test_maps_can_be_read_in_print_and_times_lie_below_each_other(run: Results, width: int) -> None:
    """Maps were 6 mm wide in a column, and 0 ms stood at another place for each method."""
    figure = plot_target(target_waves(run, "5"), width=width)
    figure.draw_without_rendering()
    maps = [ax for ax in figure.axes if ax.collections and len(ax.lines) >= 3]
    times = [ax for ax in figure.axes if len(ax.lines) > 4 and not ax.collections]
    assert len(maps) == 3 * 2 * (4 if width == 88 else 6)
    assert min(ax.get_position().width for ax in maps) * width > 15.0
    assert len({(ax.get_position().x0, ax.get_position().x1, *ax.get_xlim()) for ax in times}) == 1


def test_instants_surround_the_targets_peak() -> None:
    time = (np.arange(2000) - 1000) * 1e-4
    values = np.exp(-((time - 5e-3) ** 2) / (2 * 2e-3**2)) * np.ones((2, 1))
    found = moments(time, values, 0)
    assert len(found) == 6
    assert found[3] == pytest.approx(5e-3)
    assert np.ptp(np.diff(found)) < 1e-12


def test_the_inverse_filter_delivers_the_wavelet_at_the_end_of_the_line(run: Results) -> None:
    data = travel(run)
    last = data.u.values[0, -1]
    assert data.time.values[int(np.argmax(last))] == pytest.approx(0, abs=1e-4)
    spectrum, f = run.wavelet.spectrum.real, run.record.frequency
    left = spectrum[(f > 9) & (f < 401)].sum() / spectrum.sum()  # of the wavelet's peak, by G's band
    assert last.max() == pytest.approx(1e-6 * left, rel=1e-3)
    assert np.abs(data.u.values[0, 0]).max() > 5 * last.max()  # the cone must move more than the target


def test_the_traced_root_of_a_half_space_is_rayleighs() -> None:
    layer = Layer(np.inf, 1050.0, KelvinVoigt(7860.0, 5.03).at)
    omega = 2 * np.pi * np.array([50.0, 200.0, 500.0])
    root = trace_root(lambda k, w: surface_kernel(k, w, [layer]), [layer], omega)
    np.testing.assert_allclose(root, rayleigh_wavenumber(omega, layer.modulus(omega), 1050.0), rtol=1e-6)


def test_the_root_of_a_loaded_skin_is_that_of_layers_and_sheet() -> None:
    """A sheet of mass m on one tissue: (mu p r - m w^2)(mu q r - m w^2) = (mu k d)^2, docs/theory/layered_model.md."""
    muscle = {"layers": [{"tissue": "muscle", "thickness": 0.01}], "core": "muscle"}
    scene = Scenario.model_validate(
        {"name": "loaded", "limb": {"shape": "slab", **muscle}, "tissues": {"membrane": {"mass": 0.5}}}
    )
    f = np.array([50.0, 200.0])
    k, w, tissue = kernel_root(scene, f), 2 * np.pi * f, resolve_tissues(scene)["muscle"]
    mu = tissue.modulus.at(w)
    ks2 = tissue.density * w**2 / mu
    p, q = np.sqrt(k**2 - ks2 * mu / (tissue.bulk + 4 * mu / 3)), np.sqrt(k**2 - ks2)
    r = ks2 / (k**2 - p * q)
    load, across = 0.5 * w**2, (mu * k * (2 - r)) ** 2
    np.testing.assert_allclose((mu * p * r - load) * (mu * q * r - load), across, rtol=1e-6)  # differences of Newton's
    bare = rayleigh_wavenumber(w, mu, tissue.density)
    assert np.all(k.real > bare.real)  # mass slows the wave


def test_the_estimator_on_the_surface_wave_alone_finds_its_speed(run: Results) -> None:
    data = dispersion(run)
    alone = data.sel(wave="surface wave")
    speed = 2 * np.pi * data.frequency / data.root.real
    np.testing.assert_allclose(alone.speed, speed, rtol=0.07)  # 1/sqrt(r) and near field shift the phase
    assert np.all(alone.attenuation > -data.root.imag)  # spreading counts as attenuation in the thesis' fit


def test_a_line_of_grid_points_lies_on_one_side_of_its_source() -> None:
    """Under the middle of a row two points are as far away, which is no line that a wave travels along."""
    points = tuple(Port(str(k + 1), "point", (6e-3 * (k - 2), 0.0, 0.0)) for k in range(6))
    source = Port("A1", "contact", (0.0, 0.0, 0.0))
    assert _row(points, source) == [2, 3, 4, 5]
    assert _row(points, replace(source, position=(0.012, 0.03, 0.0))) == [4, 3, 2, 1, 0]


def test_drives_that_are_no_voltages_have_no_power_to_draw(run: Results) -> None:
    data = drive_levels(run)
    unknown = data.assign(power=data.power * np.nan).assign_attrs(max_peak=np.nan, max_power=np.nan)
    figure = plot_drives(unknown)
    FigureCanvasAgg(figure).draw()
    assert [ax.get_yscale() for ax in figure.axes[-2:]] == ["log", "linear"]


def test_a_scene_that_renders_nothing_has_the_figures_of_its_matrix(folder: Path, tmp_path: Path) -> None:  # noqa: F811
    for name in ("transfer.nc", "run.json"):
        shutil.copy(folder / name, tmp_path)
    text = (folder / "scenario.json").read_text()
    silent = {**json.loads(text), "rendering": {"methods": []}}
    (tmp_path / "scenario.json").write_text(json.dumps(silent))
    names = {k.name for k in _chosen(Results.open(tmp_path), None)}
    assert {"transfer", "figure-a2", "impedance"} <= names
    assert not names & {"drives", "strength", "figure-4", "figure-6"}
    with pytest.raises(DataError, match="its scene renders nothing"):
        make_figures(tmp_path, tmp_path, only=["drives"])
    (tmp_path / "transfer.nc").unlink()
    with pytest.raises(DataError, match=r"transfer\.nc is missing"):
        make_figures(tmp_path, tmp_path)


def test_conditioning_holds_control_rows_of_each_target(run: Results) -> None:
    data = conditioning(run)
    assert data.control.shape == (9, len(run.transfer.frequency))
    np.testing.assert_allclose(data.condition, data.singular[:, 0] / data.singular[:, -1])


def test_conditioning_is_of_the_rows_that_the_run_held(run: Results, folder: Path, tmp_path: Path) -> None:  # noqa: F811
    """It showed the default zero points, whichever the scenario named."""
    account = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    account["signal_strength"] = {"zeros": {"funneling": {"5": []}, "combination": {"5": ["2", "6"], "4": ["9"]}}}
    (tmp_path / "transfer.nc").write_bytes((folder / "transfer.nc").read_bytes())
    write_json(tmp_path / "run.json", {k: v for k, v in account.items() if k != "sha256"})
    data = conditioning(Results.open(tmp_path))
    assert data.target.values.tolist() == ["5", "4"]
    np.testing.assert_allclose(data.control[0], np.linalg.cond(run.transfer.values[:, [4, 1, 5]]))


def test_waves_are_looked_at_from_an_actuator_that_touches(folder: Path) -> None:  # noqa: F811
    """From one that does not there are none: the curves were empty, or those of the shell's motion."""
    results = Results.open(folder)
    out = {"device": {"out_of_contact": ["A1"]}}
    results.__dict__["scenario"] = parse_scenario({**results.scenario.model_dump(), **out})
    found = line(results, (4e-3, 8e-3, 12e-3))
    assert found.actuator == "A2"
    assert np.array_equal(found.cone, results.transfer.contacts[:, 1, 1])
    assert not np.allclose(found.response, line(Results.open(folder), (4e-3, 8e-3, 12e-3)).response, rtol=1e-3)


def test_a_figure_leaves_a_notebooks_style_alone(run: Results) -> None:
    before = dict(mpl.rcParams)
    assert isinstance(plot_errors(errors(run)), Figure)
    assert isinstance(plot_conditioning(conditioning_of(run.transfer)), Figure)
    assert dict(mpl.rcParams) == before


@pytest.mark.parametrize(
    ("missing", "stage"), [("drives.nc", "render"), ("transfer.nc", "run"), ("scenario.json", "run")]
)
def test_a_half_finished_folder_names_the_missing_stage(folder: Path, tmp_path: Path, missing: str, stage: str) -> None:  # noqa: F811
    part = tmp_path / "part"
    part.mkdir()
    for file in folder.iterdir():
        if file.name != missing:
            os.symlink(file, part / file.name)
    with pytest.raises(DataError, match=f"{missing}.*`forearm-fem {stage} SCENARIO --out {part}`"):
        make_figures(part, only=["figure-4"])


@pytest.mark.slow
def test_a_run_without_mesh_or_field_leaves_their_figures_out(folder: Path, tmp_path: Path) -> None:  # noqa: F811
    part = tmp_path / "part"
    part.mkdir()
    for file in folder.iterdir():
        if file.name not in ("mesh.vtu", "wavefield.nc"):
            os.symlink(file, part / file.name)
    from forearm_fem.show.registry import applies

    run = Results.open(part)
    left_out = {n for n, k in kinds(run).items() if applies(k, run)}
    assert left_out == {"mesh", "wavefield"}
    assert "field" not in target_waves(run, "5")
    written = make_figures(part, tmp_path / "out", only=["figure-2", "figure-a2"])
    assert {p.name for p in written} == {
        "figure-2.png", "figure-2.csv", "figure-2-spectrum.csv", "figure-a2.png", "figure-a2.csv",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("call", "words"),
    [
        ({"only": ["figure-9"]}, "no figure is called 'figure-9'; known are figure-2"),
        ({"formats": ("bmp",)}, "'bmp' is no format"),
        ({"out_dir": "/proc/nowhere"}, "cannot be written there"),
    ],
)
def test_wrong_requests_are_refused_in_one_sentence(folder: Path, call: dict[str, object], words: str) -> None:  # noqa: F811
    with pytest.raises(DataError, match=words):
        make_figures(folder, **call)


def test_no_folder_no_figures(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="no such results folder"):
        make_figures(tmp_path / "nothing")


@pytest.mark.slow
def test_vector_formats_and_any_back_end(folder: Path, tmp_path: Path) -> None:  # noqa: F811
    """A back end that needs a display is the user's; we draw without it."""
    code = (
        "import sys; from forearm_fem.show import make_figures\n"
        f"make_figures({str(folder)!r}, {str(tmp_path)!r}, only=['errors'], formats=('pdf', 'svg'))\n"
        "assert 'matplotlib.pyplot' not in sys.modules"
    )
    environment = {k: v for k, v in os.environ.items() if k != "DISPLAY"} | {"MPLBACKEND": "TkAgg"}
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "errors.pdf").read_bytes()[:5] == b"%PDF-"
    assert "reduced model" in (tmp_path / "errors.svg").read_text(encoding="utf-8")  # text, not outlines


def test_widths_that_cannot_be_are_refused_and_nothing_is_drawn(run: Results, tmp_path: Path) -> None:
    with pytest.raises(DataError, match="88 or 181 mm wide"):
        make_figures(run, tmp_path / "out", only=["errors"], width=90)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("wide", [88, pytest.param(181, marks=pytest.mark.slow)])
def test_a_journals_width_is_that_of_the_picture_and_nothing_is_cut(run: Results, tmp_path: Path, wide: int) -> None:
    """Figures 4 and 6, Table I and the transfer matrix once came out as wide as they liked."""
    for name in ("figure-6", "table-1"):
        make_figures(run, tmp_path, only=[name], formats=["png", "svg"], width=wide, footer=False)
        with Image.open(tmp_path / f"{name}.png") as picture:
            dpi = picture.info["dpi"][0]
            assert dpi >= 300
            assert picture.width / dpi * 25.4 == pytest.approx(wide, abs=0.01)  # a tenth of a pixel
            edge = np.asarray(picture.convert("L"))[:, [0, -1]]
        assert (edge == 255).all(), f"{name}: something is cut at the side"
        text = (tmp_path / f"{name}.svg").read_text(encoding="utf-8")
        assert "forearm_fem" not in text.partition("</metadata>")[2]  # no footer


@pytest.mark.parametrize("wide", [88, pytest.param(181, marks=pytest.mark.slow)])  # the narrower is the harder
@pytest.mark.parametrize("name", ["figure-4", "figure-6", "transfer"])
def test_words_of_a_figure_do_not_run_into_each_other(run: Results, name: str, wide: int) -> None:
    figure = kinds(run)[name].draw(kinds(run)[name].compute(run), width=wide)
    arrange(figure)
    FigureCanvasAgg(figure).draw()
    ticks = {label for ax in figure.findobj(Axes) for axis in (ax.xaxis, ax.yaxis) for label in axis.findobj(Text)}
    labels = {axis.label for ax in figure.findobj(Axes) for axis in (ax.xaxis, ax.yaxis)}
    words = {t for t in figure.findobj(Text) if t.get_text().strip() and t.axes is not figure} - (ticks - labels)
    boxes = [(t.get_text(), t.get_window_extent()) for t in words]
    hit = [(a, b) for k, (a, x) in enumerate(boxes) for b, y in boxes[:k] if x.overlaps(y) and a != b]
    assert not [(a, b) for a, b in hit if len(a + b) > 4], hit  # names of points lie in small discs
    width = figure.get_window_extent().width
    assert all(x.x0 > -1 and x.x1 < width + 1 for _, x in boxes)


def test_waves_that_the_thesis_shows_bear_its_numbers(run: Results, tmp_path: Path) -> None:
    assert {"figure-6", "figure-7", "target-1"} <= set(kinds(run))
    assert [k.name for k in _chosen(run, ["target-5"])] == ["figure-6"]


def test_a_figure_is_laid_out_once_and_as_saving_would():
    """Boxes of axes as after a draw, and no layout engine is left that would find them anew for each file."""
    figures = [Figure(figsize=(4, 3), layout="constrained") for _ in range(2)]
    for figure in figures:
        left, right = figure.subplots(1, 2)
        left.set(ylabel="a long label", title="two\nlines")
        right.plot([0, 1e6])
    with style.context(SHEET):
        figures[0].draw_without_rendering()
    arrange(figures[1])
    boxes = [np.array([ax.get_position().extents for ax in f.axes]) for f in figures]
    assert np.array_equal(*boxes)
    assert figures[1].get_layout_engine() is None
