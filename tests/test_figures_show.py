"""Waves in space: what moves, how it is drawn, films and ParaView."""

from __future__ import annotations

import shutil
import sys
from dataclasses import replace
from pathlib import Path
from unittest.mock import MagicMock

import numpy as np
import pytest
from PIL import Image
from test_figures_scene import folder  # noqa: F401

from forearm_fem.cli.look import figures
from forearm_fem.errors import DataError, MissingExtra, NotApplicable
from forearm_fem.scenario import parse_scenario
from forearm_fem.show import Results
from forearm_fem.show.film import (
    Look,
    Stage,
    amplification,
    animate,
    body_of,
    slow_words,
    staged,
    standing,
    wavefield,
)
from forearm_fem.show.motion import View, default_times, focus_time, motion, plotter_for
from forearm_fem.show.style import round_down_125

pytestmark = pytest.mark.drawn

SMALL = (320, 240)


@pytest.fixture(scope="module")
def run(folder: Path) -> Results:  # noqa: F811
    return Results.open(folder)


def nearest(run: Results, name: str) -> int:
    port = next(p for p in run.transfer.outputs if p.name == name)
    return int(np.argmin(np.linalg.norm(run.mesh.points - port.position, axis=1)))


def test_a_motion_through_time_is_the_wavefields_own(run: Results) -> None:
    times = np.array([0.0, 5e-3])
    moved = motion(run, View("funneling", "5"), times)
    from forearm_fem.show.motion import drive_series

    whole = run.wavefield.in_time(drive_series(run.drives, "funneling", "5", run.wavefield), times)
    np.testing.assert_allclose(moved.displacement(run.wavefield.modes, 1), whole[1], atol=1e-12 * np.abs(whole).max())


def test_a_field_on_some_of_the_drives_bins_is_not_shown_for_their_motion(run: Results) -> None:
    """Every other bin alone is half of the motion, twice in the record; it was drawn without a word."""
    from forearm_fem.show.motion import drive_series

    field = run.wavefield
    some = replace(field, frequency=field.frequency[::2], amplitudes=field.amplitudes[::2])
    for wrong in (some, replace(field, frequency=field.frequency * 1.01)):
        with pytest.raises(NotApplicable, match=r"known at \d+ frequencies, and the drives lie on others") as problem:
            drive_series(run.drives, "funneling", "5", wrong)
        assert len(str(problem.value)) <= 300
    one, other = (drive_series(run.drives, "funneling", "5", f, whole=False) for f in (field, some))
    assert np.array_equal(one[:, ::2], other)


def test_waves_leave_the_actuator_and_decay(run: Results) -> None:
    """At 100 Hz the phase falls and the size shrinks with the distance from the only actuator that moves."""
    view = View(frequency=100.0, actuator="A1")
    phasor = motion(run, view).phasor
    u = run.wavefield.modes[:, 2] @ phasor
    start = run.transfer.inputs[0].position
    top = run.mesh.points[:, 2] > -1e-9
    gap = np.linalg.norm(run.mesh.points - start, axis=1)
    near, far = top & (gap > 6e-3) & (gap < 9e-3), top & (gap > 11e-3) & (gap < 14e-3)
    assert np.abs(u[far]).mean() < 0.8 * np.abs(u[near]).mean()
    assert 0.3 < np.angle(u[near].mean() / u[far].mean()) < 3.0


def test_the_drawn_amplification_is_honest(run: Results) -> None:
    moved, skin = motion(run, View("funneling", "5")), body_of(run, "", "5")
    factor = amplification(moved, skin, Look())
    most = max(np.linalg.norm(moved.displacement(skin.modes, k), axis=1).max() for k in range(len(moved.steps)))
    assert 1.5e-3 < factor * most < 5.5e-3  # metres on the picture
    assert amplification(moved, skin, Look(amplification=7.0)) == 7.0
    assert [round_down_125(v) for v in (1.0, 1.9, 4.99, 5.0, 730.0)] == [1, 1, 2, 5, 500]


@pytest.mark.parametrize(
    ("factor", "said"),
    [(2.5, "motion drawn 2.5 times larger"), (0.2, "motion drawn 5 times smaller"), (1.0, "drawn true to scale"),
     (20000.0, "motion drawn 20,000 times larger"), (0.0, "motion not drawn, only coloured")],
)  # fmt: skip
def test_the_amplification_is_said_as_it_is_drawn(run: Results, factor: float, said: str) -> None:
    """To whole numbers, as it was, a bulge of a fifth was drawn "0 times larger", one of 2.5 "2 times"."""
    stage = Stage(MagicMock(), body_of(run, "", "5"), motion(run, View("funneling", "5")), factor, 1e-6)
    assert stage.words(0)[-1] == said


def test_a_picture_says_what_it_leaves_out_of_the_housing(folder: Path) -> None:  # noqa: F811
    results = Results.open(folder)
    with plotter_for(SMALL) as plotter:
        whole = staged(results, plotter, motion(results, View()), Look(size=SMALL))
    assert "housing" not in " ".join(whole.words(0))
    shared = {**results.scenario.model_dump(), "device": {**results.scenario.device.model_dump()}}
    shared["device"]["housing"]["skin_share"] = 0.03
    results.__dict__["scenario"] = parse_scenario(shared)
    with plotter_for(SMALL) as plotter:
        told = staged(results, plotter, motion(results, View()), Look(size=SMALL))
    assert told.words(0)[-1] == "without what the skin follows of the housing"


def test_the_frequency_said_is_the_one_that_is_shown(run: Results) -> None:
    """The field has bins: what is asked for between them is the nearest one's, and is called so."""
    own = run.wavefield.frequency
    between = motion(run, View(frequency=float(own[9] + 0.3 * (own[10] - own[9]))))
    exact = motion(run, View(frequency=float(own[9])))
    assert np.array_equal(between.states, exact.states)
    assert between.view.words == exact.view.words
    assert f", {own[9]:g} Hz, " in between.view.words


def test_a_picture_shows_the_wave_and_where_names_stand(run: Results) -> None:
    look = Look(size=SMALL, camera="top")
    now, before = (wavefield(run, view=View("funneling", "5"), look=look, at=t) for t in (2e-3, -0.09))
    rows, columns = (min(now.sizes[d], before.sizes[d]) for d in ("row", "column"))
    apart = now.picture.values[:rows, :columns].astype(int) - before.picture.values[:rows, :columns]
    assert np.abs(apart).max(axis=2).mean() > 5  # before the wavelet nothing moves
    at = {str(n): p for n, p in zip(now.name.values, now["at"].values, strict=True)}
    assert at["1"][0] < at["4"][0] < at["7"][0]  # from above x goes to the right and y upwards
    assert at["1"][1] > at["2"][1] > at["3"][1]


def test_a_film_says_how_slow_it_is(run: Results) -> None:
    """.5 ms a frame at 12 frames a second: 6 ms of motion a second; 24 frames a period of 1/100 s likewise."""
    assert slow_words(motion(run, View("funneling", "5")), 12.0) == "167 times slower than real"
    f = float(run.wavefield.frequency[9])
    assert slow_words(motion(run, View(frequency=f)), 12.0) == f"{2 * f:.3g} times slower than real"


def test_the_picture_is_of_the_moment_at_which_the_target_moves_most(run: Results) -> None:
    """It was of the wavelet's centre, at which little had arrived."""
    view = View("combination", "5")
    at = focus_time(run, view)
    assert abs(at) > 1e-3  # the inverse filter's focus is the wavelet's centre
    moved, spot = motion(run, view, np.append(default_times(), at)), nearest(run, "5")
    there = np.array([moved.displacement(run.wavefield.modes[[spot]], k)[0, 2] for k in range(len(moved.steps))])
    assert abs(there[-1]) > 0.98 * np.abs(there).max()  # the nearest node is not the point itself
    assert f"t = {1e3 * at:+.1f} ms" in wavefield(run, view=view, look=Look(size=SMALL)).words


@pytest.mark.parametrize("cut", ["", "xy"])
def test_the_body_is_lit_from_outside_and_as_it_bends(run: Results, cut: str) -> None:
    """Until 0.12.0 normals pointed inwards, so that white was drawn grey, and stayed as they were at rest."""
    moved, body = motion(run, View("funneling", "5")), body_of(run, cut, "5")
    top = int(np.argmax(body.rest[:, 2]))
    at_rest, bent = (Stage(MagicMock(), body, moved, factor, 1e-6) for factor in (0.0, 2e3))
    at_rest.show(0)
    flat = np.array(body.dataset.point_data["Normals"])
    assert flat[top, 2] > 0.9
    bent.show(int(np.argmin(np.abs(moved.steps - 2e-3))))
    assert np.abs(body.dataset.point_data["Normals"] - flat).max() > 0.05


@pytest.mark.parametrize("cut", ["y", "xy"])
def test_a_cut_limb_keeps_the_field_on_its_faces(run: Results, cut: str) -> None:
    body = body_of(run, cut, "5")
    rest = 1e3 * run.mesh.points
    assert body.rest[:, 1].max() == pytest.approx(rest[:, 1].max(), abs=1e-3)
    inside = np.abs(body.rest[:, 1]) < 1e-3
    assert inside.sum() > 20  # the face itself
    same = np.linalg.norm(rest[:, None] - body.rest[None, ::50], axis=2).argmin(axis=0)
    exact = np.linalg.norm(rest[same] - body.rest[::50], axis=1) < 1e-4
    np.testing.assert_allclose(body.modes[::50][exact], run.wavefield.modes[same[exact]], atol=1e-6)


def test_nothing_stands_on_what_is_cut_away(run: Results) -> None:
    ports = (*run.transfer.inputs, *run.transfer.outputs)
    middle = next(p for p in run.transfer.outputs if p.name == "5").position
    assert standing(ports, "", middle) == ports
    for cut, gone in (("y", {"A1", "A3", "1", "4", "7"}), ("xy", {"A1", "1"})):
        assert {p.name for p in ports} - {p.name for p in standing(ports, cut, middle)} == gone


def test_a_film_has_all_its_frames(run: Results, tmp_path: Path) -> None:
    told: list[tuple[str, int, int]] = []
    path = animate(run, tmp_path / "film.gif", look=Look(size=(160, 120)), steps=np.array([0.0, 2e-3, 4e-3]),
                   progress=lambda *step: told.append(step))  # fmt: skip
    with Image.open(path) as film:
        assert getattr(film, "n_frames", 1) == 3
        right = np.asarray(film.convert("RGB"), dtype=int)[24:96, 139:158]
    assert told == [("frames", k, 3) for k in (1, 2, 3)]
    assert (right[:, :, 0] - right[:, :, 2]).max() > 60  # red and blue of the colour bar
    assert (right[:, :, 2] - right[:, :, 0]).max() > 60


def test_mp4_names_its_extra(run: Results, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "imageio", None)
    with pytest.raises(MissingExtra, match=r"forearm-fem\[movie\]"):
        animate(run, tmp_path / "film.mp4")
    flat = tmp_path / "flat"  # no motion between the points: both reasons are told at once, before anything is loaded
    flat.mkdir()
    (flat / "scenario.json").write_bytes((run.folder / "scenario.json").read_bytes())
    with pytest.raises(DataError, match=r"forearm-fem\[movie\].*no motion between the points"):
        figures(flat, film=tmp_path / "film.mp4")


def test_a_picture_and_a_film_of_one_view_are_drawn_alike(run: Results) -> None:
    """The picture was magnified by its own instant, and looked like another motion."""
    film = motion(run, View())
    with plotter_for(SMALL) as plotter:
        whole = staged(run, plotter, film, Look(size=SMALL))
    with plotter_for(SMALL) as plotter:
        still = staged(run, plotter, motion(run, View(), np.array([-5e-3])), Look(size=SMALL), film)
    assert (still.factor, still.limit) == (whole.factor, whole.limit)


@pytest.mark.parametrize(
    ("view", "words"),
    [
        (View(method="magic"), "nothing was rendered for 'magic'"),
        (View(frequency=4000.0), "outside the sweep"),
        (View(quantity="phase"), "a phase belongs to a frequency"),
        (View(actuator="A1"), "give one in Hz"),
        (View(frequency=100.0, actuator="B7"), "no actuator is called 'B7'"),
    ],
)
def test_impossible_views_are_refused(run: Results, view: View, words: str) -> None:
    with pytest.raises(DataError, match=words):
        motion(run, view)


def test_without_a_field_it_says_so(folder: Path, tmp_path: Path) -> None:  # noqa: F811
    for file in folder.iterdir():
        if file.name != "wavefield.nc":
            shutil.copy(file, tmp_path / file.name)
    with pytest.raises(DataError, match=r"wavefield\.nc is missing.*forearm-fem run"):
        wavefield(tmp_path)
