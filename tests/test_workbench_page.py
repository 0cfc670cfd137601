"""The workbench's page in a real browser: by clicks, keys and files, against Python's numbers."""

# ruff: noqa: E501  # scripts for the page stay in one piece

from __future__ import annotations

import csv
import io
import json
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import wavfile
from test_figures_scene import folder  # noqa: F401
from test_skin_model import solved  # noqa: F401
from test_workbench import LAYERED, content, drawn, flat  # noqa: F401

from forearm_fem.engines.simulation import render, simulate
from forearm_fem.engines.skin_model import load_skin_model
from forearm_fem.files.read import read
from forearm_fem.files.tables import write_csv
from forearm_fem.scenario import load_scenario, parse_scenario
from forearm_fem.show import Results
from forearm_fem.show.workbench import content_of, page_of
from forearm_fem.show.workbench.content import measured_content

METHODS = ("inverse filter", "funneling", "combination")


@pytest.fixture(scope="module")
def html(content: dict[str, Any], tmp_path_factory: pytest.TempPathFactory) -> Path:  # noqa: F811
    place = tmp_path_factory.mktemp("page") / "page.html"
    place.write_text(page_of(content), encoding="utf-8")
    return place


def opened(browser: Any, page: Path, **options: Any) -> tuple[Any, list[str]]:
    """The page, computed and still, and what its console complained of."""
    tab, problems = browser.new_page(**{"viewport": {"width": 1280, "height": 800}, **options}), []
    tab.on("pageerror", lambda e: problems.append(str(e)))
    tab.on(
        "console",
        lambda m: problems.append(m.text) if m.type in ("error", "warning") else None,
    )
    tab.on("request", lambda r: problems.append(f"asks for {r.url}") if r.url.startswith(("http", "ws", "ftp")) else None)
    tab.goto(page.as_uri())
    tab.locator("body[data-ready]").wait_for(state="attached")
    tab.evaluate("document.querySelectorAll('details.more').forEach(d => { d.open = true; })")
    return tab, problems


@pytest.fixture
def tab(browser: Any, html: Path) -> Iterator[Any]:
    tab, problems = opened(browser, html)
    yield tab
    assert problems == []
    tab.close()


def strength(tab: Any, method: str = "inverse filter") -> float:
    return float(tab.evaluate(f"workbench.experiment.outcome('{method}').strength"))


def test_it_opens_without_a_complaint_and_s_is_pythons(tab: Any, flat: Results) -> None:  # noqa: F811
    tab.locator("body[data-table]").wait_for(state="attached")
    known = flat.run.signal_strength.model_dump()["methods"]
    cells = {c.get_attribute("data-s"): float(c.get_attribute("data-value")) for c in tab.locator("[data-s]").all()}
    assert len(cells) == 27
    for method in METHODS:
        for target in "123456789":
            assert cells[f"{method} {target}"] == pytest.approx(known[method][target]["value"], rel=1e-4)
    said = tab.locator(".head .s").first.inner_text()
    assert float(said.split()[1]) == pytest.approx(known["inverse filter"]["5"]["value"], rel=5e-3)  # three digits
    assert tab.locator("#errors").inner_text().count("over the band") == 1


def test_the_arms_are_drawn_and_move(tab: Any) -> None:
    """Pixels of all three panels differ from their backdrop, and change with the instant."""
    shot = """t => { const {arms, app, experiment} = workbench, body = arms.parts.body; arms.time = t; arms.draw(experiment);
      const w = body.width, h = body.height, px = body.getContext("2d").getImageData(0, 0, w, h).data;
      return [0, 1, 2].map(k => { let n = 0, sum = 0; for (let y = 0; y < h; y += 3) for (let x = Math.round(k * w / 3); x < Math.round((k + 1) * w / 3); x += 3) { const i = 4 * (y * w + x); if (px[i + 3]) { n++; sum += px[i] - px[i + 2]; } } return [n / (w * h / 27), sum / n]; }); }"""
    before, after = tab.evaluate(shot, 0.0), tab.evaluate(shot, 0.006)
    for k in range(3):
        assert before[k][0] > 0.15
        assert before[k][1] != after[k][1]


def test_g_at_twenty_frequencies_from_the_poles(browser: Any, solved: Any, tmp_path: Path) -> None:  # noqa: F811
    place, _ = solved
    page = tmp_path / "page.html"
    page.write_text(page_of(content_of(Results.open(place))), encoding="utf-8")
    tab, problems = opened(browser, page)
    frequency = np.linspace(40.3, 399.8, 20)
    g = tab.evaluate(
        "f => { const g = workbench.experiment.transferAt(f); return [[...g.re], [...g.im]]; }", frequency.tolist()
    )
    expected = load_skin_model(place / "reduced.nc").transfer(frequency).values
    found = (np.array(g[0]) + 1j * np.array(g[1])).reshape(expected.shape)
    assert (np.abs(found - expected).max(axis=(1, 2)) < 1e-5 * np.abs(expected).max(axis=(1, 2))).all()
    assert problems == []
    tab.close()


def test_a_click_on_an_arm_aims_there(tab: Any) -> None:
    """Point 2 on the second arm, then a place between the points, then a zero point with shift."""
    at = """i => { const {arms, experiment} = workbench, box = arms.boxes()[1], over = arms.parts.over.getBoundingClientRect();
      const m = arms.matrix(box), p = experiment.points[i].position.map(v => 1e3 * v), q = [0, 1, 3].map(r => m[r] * p[0] + m[4 + r] * p[1] + m[8 + r] * p[2] + m[12 + r]);
      return [over.left + box.x + (.5 + .5 * q[0] / q[2]) * box.w, over.top + box.y + (.5 - .5 * q[1] / q[2]) * box.h]; }"""
    before, sent = strength(tab), tab.evaluate("[...workbench.app.outcome.signals[0].slice(480, 520)]")
    x, y = tab.evaluate(at, 1)
    tab.mouse.click(x, y)
    assert tab.evaluate("workbench.experiment.settings.target") == 1
    assert strength(tab) != before
    assert tab.evaluate("[...workbench.app.outcome.signals[0].slice(480, 520)]") != sent
    tab.keyboard.down("Shift")
    tab.mouse.click(*tab.evaluate(at, 4))
    tab.keyboard.up("Shift")
    assert 4 in tab.evaluate("workbench.app.outcome.aim.zeros")
    corners = [tab.evaluate(at, row) for row in (4, 5, 7, 8)]
    tab.mouse.click(*np.mean(corners, axis=0))  # in the middle of four points
    assert tab.evaluate("workbench.experiment.outputs.length") == 10
    assert np.isfinite(strength(tab))


def test_a_free_place_has_drives_and_s_of_its_own(tab: Any) -> None:
    tab.evaluate("""() => { const {app, field, experiment} = workbench, {rest, normals} = field.skin; let best = 0, gap = 1e9;
      for (let v = 0; v < rest.length / 3; v++) { const d = Math.hypot(rest[3 * v] - 6, rest[3 * v + 1] - 7); if (d < gap) { gap = d; best = v; } }
      app.set({place: {vertex: best, position: [...rest.slice(3 * best, 3 * best + 3)].map(v => v / 1e3), normal: [...normals.slice(3 * best, 3 * best + 3)]}, target: 9, zeros: 'auto'}); }""")
    assert all(np.isfinite(strength(tab, m)) for m in METHODS)
    assert "being drawn" in tab.locator(".head .why").first.inner_text()
    tab.get_by_text("by the errors of G").first.wait_for()
    low, high = tab.evaluate("workbench.experiment.interval('inverse filter', 9)")
    assert low < strength(tab) < high
    table = tomllib.loads(tab.evaluate("workbench.exports.scenarioToml()"))
    assert len(table["grid"]["points"]) == 10
    assert table["rendering"]["targets"] == ["10"]
    assert table["grid"]["points"][0] == pytest.approx([-0.0133, -0.0133], abs=1e-6)


def test_a_free_place_is_aimed_at_by_numbers(tab: Any) -> None:
    """Without a pointer; where no skin was kept nothing changes."""
    tab.locator("#placex").fill("6")
    tab.locator("#placex").press("Enter")
    assert tab.evaluate("workbench.experiment.settings.target") == 9
    place = tab.evaluate("workbench.experiment.settings.place.position")
    assert place[:2] == pytest.approx([6e-3, 0.0], abs=3e-3)  # a vertex of the picture, of a few mm
    assert float(tab.locator("#placex").input_value()) == pytest.approx(1e3 * place[0], rel=1e-4)
    s = strength(tab)
    tab.locator("#placey").fill("1e9")
    tab.locator("#placey").press("Enter")
    assert "expected" in tab.locator("#say").inner_text()
    assert strength(tab) == s


@pytest.mark.slow  # 6 s of keys
def test_it_is_walked_by_keys_alone(tab: Any) -> None:
    tab.keyboard.press("7")
    assert tab.evaluate("workbench.experiment.settings.target") == 6
    held = tab.evaluate("workbench.app.outcome.aim.zeros")
    tab.keyboard.press("Shift+Digit2")
    assert tab.evaluate("workbench.app.outcome.aim.zeros") == sorted([*held, 1])
    time = tab.evaluate("workbench.arms.time")
    tab.keyboard.press("ArrowRight")
    assert tab.evaluate("workbench.arms.time") > time
    tab.keyboard.press("Space")
    assert tab.evaluate("workbench.app.playing") is True
    tab.keyboard.press("m")
    assert tab.evaluate("workbench.app.focus") == "funneling"
    turn = tab.evaluate("workbench.arms.view.turn")
    tab.keyboard.press("Shift+ArrowLeft")
    assert tab.evaluate("workbench.arms.view.turn") != turn
    theme = tab.evaluate("document.documentElement.dataset.theme")
    tab.keyboard.press("t")
    assert tab.evaluate("document.documentElement.dataset.theme") != theme
    tab.keyboard.press("?")
    assert tab.locator("#keys").is_visible()
    tab.keyboard.press("Escape")
    tab.locator("#pad g[data-row='3']").focus()
    tab.keyboard.press("Enter")
    assert tab.evaluate("workbench.experiment.settings.target") == 3
    seen = set()
    for _ in range(110):
        tab.keyboard.press("Tab")
        seen.add(
            tab.evaluate(
                "document.activeElement.id || document.activeElement.closest('details, section, header')?.className || document.activeElement.closest('[id]')?.id || ''"
            )
        )
    assert {"play", "scrub", "speed", "over", "zeros", "peak"} <= seen


def test_controls_change_what_they_say(tab: Any) -> None:
    before = strength(tab)
    tab.locator("#zeros").select_option("others")
    assert len(tab.evaluate("workbench.app.outcome.aim.zeros")) == 8
    assert strength(tab) != before
    tab.locator("#peak").fill("150")
    tab.locator("#peak").press("Enter")
    assert tab.evaluate("workbench.experiment.settings.wavelet.name") == "Ricker 150 Hz"
    tab.locator("#peak").fill("1e9")
    tab.locator("#peak").press("Enter")
    assert "expected" in tab.locator("#say").inner_text()
    assert tab.locator("#peak").input_value() == "150"
    tab.evaluate("document.querySelectorAll('#controls details').forEach(d => { d.open = true; })")
    now = strength(tab, "funneling")
    tab.locator("#moving_mass").fill("1.2")
    tab.locator("#moving_mass").press("Enter")
    assert tab.locator("#say").inner_text() == ""  # the refusal was of another value
    assert tab.evaluate("workbench.experiment.settings.device.coil.moving_mass") == pytest.approx(1.2e-3)
    assert strength(tab, "funneling") != now
    tab.get_by_label("contact of A1").select_option("lifted off")
    assert tab.evaluate("workbench.experiment.settings.device.touching") == [False, True, True, True]
    tab.get_by_label("contact of A1").select_option("partial: 1 N/mm")
    assert tab.evaluate("workbench.experiment.settings.device.spring[0]") == 1000
    tab.locator("#rule").select_option("tikhonov")
    tab.locator("#value").fill("0.3")
    tab.locator("#value").press("Enter")
    assert tab.evaluate("workbench.experiment.settings.rule") == {"kind": "tikhonov", "value": 0.3}
    assert tomllib.loads(tab.evaluate("workbench.exports.scenarioToml()"))["device"]["contact_springs"] == {"A1": 1000}
    tab.evaluate("workbench.app.set({calibrated: false})")
    with pytest.raises(Exception, match="not measured again"):
        tab.evaluate("workbench.exports.scenarioToml()")
    tab.get_by_text("device as in the run").click()
    assert tab.evaluate("workbench.experiment.settings.device.touching") == [True] * 4


def test_the_scenario_it_keeps_gives_the_same_s(tab: Any, tmp_path: Path) -> None:
    """Through the command line's own reading, solving and rendering, for everything a scenario can say."""
    tab.evaluate("""() => { const {app, experiment} = workbench, d = experiment.settings.device;
      app.set({target: 3, zeros: [0, 2, 7], rule: {kind: 'tikhonov', value: 0.02}, amplitude: 1.5, window: [-0.03, 0.06],
        device: {...d, coil: {...d.coil, moving_mass: 5e-4, resistance: 6.5}, cone: {mass: 6e-4}, housing: {...d.housing, fixed: true}, touching: [true, true, true, false], gain: [0.8, 1, 1, 1], spring: [Infinity, 1500, Infinity, Infinity]}});
      experiment.stimulate({kind: 'ricker', peak: 180}); app.refresh(); }""")
    file = tmp_path / "kept.toml"
    file.write_text(tab.evaluate("workbench.exports.scenarioToml()"), encoding="utf-8")
    scenario = load_scenario(file)
    assert scenario.name == "flat-workbench"
    found = render(simulate(scenario))
    for method in METHODS:
        assert found[method, "4"].strength == pytest.approx(strength(tab, method), rel=1e-6)


def test_actuators_are_moved_added_and_removed_beside_a_kept_device(tab: Any, tmp_path: Path) -> None:
    """By the pitch and two buttons; S of five actuators is that of the engine for the scenario that the page keeps."""
    before = strength(tab)
    tab.locator("#keep").click()
    tab.locator("#pitch").fill("36")
    tab.locator("#pitch").press("Enter")
    assert tab.evaluate("workbench.experiment.pitch") == pytest.approx(0.036)
    tab.locator("#more").click()
    assert tab.evaluate("workbench.experiment.inputs.map(p => p.name)") == ["A1", "A2", "A3", "A4", "A5"]
    assert "tables in this page" in tab.locator("#engine").inner_text()
    assert tab.locator(".head button").all_inner_texts() == ["kept device: inverse filter", "device now: inverse filter"]
    assert tab.evaluate("workbench.app.kept.strength('inverse filter', 4)") == pytest.approx(before)
    file = tmp_path / "five.toml"
    file.write_text(tab.evaluate("workbench.exports.scenarioToml()"), encoding="utf-8")
    found = render(simulate(load_scenario(file)))
    for method in ("inverse filter", "combination"):  # G errs by what the page states, .1 %, and S by a few times that
        assert found[method, "5"].strength == pytest.approx(strength(tab, method), rel=0.01)
    tab.locator("#which").select_option("A5")
    tab.locator("#fewer").click()
    tab.locator("#home").click()
    assert strength(tab) == pytest.approx(before)
    assert "as run" in tab.locator("#engine").inner_text()


def kept(tab: Any, button: str) -> Path:
    """The file that a button of "Keep" gives."""
    if not tab.locator(f"#{button}").is_visible():
        tab.get_by_text("Keep", exact=True).click()
    with tab.expect_download() as download:
        tab.locator(f"#{button}").click()
    return Path(download.value.path())


def test_what_it_keeps_can_be_read(tab: Any, flat: Results, tmp_path: Path) -> None:  # noqa: F811
    rate, samples = wavfile.read(io.BytesIO(kept(tab, "wav").read_bytes()))
    sent = np.array(tab.evaluate("workbench.app.outcome.signals.map(s => [...s])"))
    assert rate == 4000
    np.testing.assert_allclose(samples.T, sent, atol=1e-6 * np.abs(sent).max())
    lines = [line for line in kept(tab, "csv").read_text().splitlines() if not line.startswith("#")]
    rows = list(csv.DictReader(lines))
    assert float(rows[0]["time_s"]) < 0 < float(rows[-1]["time_s"])
    assert {"inverse_filter_u_5_m", "funneling_drive_A4_V"} <= set(rows[0])
    g = tmp_path / "g.csv"
    g.write_bytes(kept(tab, "gcsv").read_bytes())
    back = read(g)
    np.testing.assert_allclose(back.values, flat.transfer.values, rtol=1e-12, atol=1e-18)
    assert back.outputs == flat.transfer.outputs
    assert json.loads(kept(tab, "gjson").read_text())["unit"] == "m/V"
    assert kept(tab, "png").read_bytes()[:4] == b"\x89PNG"
    from xml.etree import ElementTree

    drawing = ElementTree.fromstring(kept(tab, "svg").read_text(encoding="utf-8"))
    assert len(drawing.findall("{http://www.w3.org/2000/svg}svg")) == 9
    words = [text.text for text in drawing.findall("{http://www.w3.org/2000/svg}text")]
    assert words.count("A4") == 5  # in the legends of drives, G and drive spectra
    assert words.count("zero points") == 3
    assert "var(--" not in kept(tab, "svg").read_text(encoding="utf-8")


def test_paper_has_the_arms_as_seen(tab: Any) -> None:
    """A picture of all three, in the colours of paper and with the screen's proportions; nothing of it stays."""
    tab.evaluate("document.getElementById('theme').click()")
    theme = tab.evaluate("document.documentElement.dataset.theme")
    stage = tab.locator("#stage").bounding_box()
    tab.evaluate("dispatchEvent(new Event('beforeprint'))")
    tab.emulate_media(media="print")
    assert not tab.locator("#stage").is_visible()
    assert not tab.locator("#controls").is_visible()
    assert tab.evaluate("document.documentElement.dataset.theme") == "light"
    width, height, inked = tab.evaluate(
        """() => { const c = document.querySelector("#printed canvas"), {width, height} = c, px = c.getContext("2d").getImageData(0, 0, width, height).data;
      return [width, height, [0, 1, 2].map(k => { const seen = new Set(); for (let y = 0; y < height; y += 7) for (let x = Math.round(k * width / 3); x < (k + 1) * width / 3; x += 7) { const i = 4 * (y * width + x); seen.add(px[i] >> 4 << 8 | px[i + 1] >> 4 << 4 | px[i + 2] >> 4); } return seen.size; })]; }"""
    )
    assert width == pytest.approx(2 * stage["width"], rel=0.01)
    assert height == pytest.approx(2 * stage["height"] + 52, rel=0.01)  # and a line of words
    assert min(inked) > 12  # shades: bare paper with labels has fewer
    tab.emulate_media(media="screen")
    tab.evaluate("dispatchEvent(new Event('afterprint'))")
    assert tab.locator("#printed canvas").count() == 0
    assert tab.evaluate("document.documentElement.dataset.theme") == theme


@pytest.mark.slow  # records for 3 s
def test_a_film_is_kept(tab: Any) -> None:
    tab.locator("#speed").select_option("10 times slower")
    film = kept(tab, "film").read_bytes()
    assert film[:4] == b"\x1a\x45\xdf\xa3"  # EBML, which WebM is
    assert len(film) > 5000  # an empty one has 110 bytes
    assert tab.locator("#wait").inner_text() == ""


def test_a_wav_becomes_the_stimulus(tab: Any, tmp_path: Path) -> None:
    samples = (2e4 * np.sin(np.arange(80) * 0.3) * np.hanning(80)).astype(np.int16)
    wavfile.write(tmp_path / "own.wav", 4000, samples)
    before = strength(tab)
    tab.locator("#own").set_input_files(tmp_path / "own.wav")
    tab.get_by_text("own.wav: 80 samples are the stimulus now").wait_for()
    assert strength(tab) != before
    np.savetxt(tmp_path / "own.csv", samples.astype(float))
    wave = strength(tab)
    tab.locator("#own").set_input_files(tmp_path / "own.csv")
    tab.get_by_text("own.csv: 80 samples").wait_for()
    assert strength(tab) == pytest.approx(wave, rel=1e-9)  # the same samples


@pytest.mark.slow
def test_another_file_of_the_same_name_is_another_stimulus(tab: Any, tmp_path: Path) -> None:
    """Its interval is drawn anew, and the scenario brings its own samples."""
    known: list[float] = []
    for rate in (0.2, 0.5):
        np.savetxt(tmp_path / "own.csv", np.sin(rate * np.arange(80)) * np.hanning(80))
        tab.locator("#own").set_input_files(tmp_path / "own.csv")
        tab.wait_for_function("before => workbench.experiment.outcome('inverse filter').strength !== before", arg=(known or [0])[-1])
        assert "being drawn" in tab.locator(".head .why").first.inner_text()
        known.append(strength(tab))
        tab.get_by_text("by the errors of G").first.wait_for()
    tab.evaluate("workbench.experiment.content.rendering.wavelet.file = 'own.csv'")  # as if the run had one of this name
    assert not tab.evaluate("workbench.experiment.asRun")
    table = tomllib.loads(tab.evaluate("workbench.exports.scenarioToml()"))
    assert table["rendering"]["wavelet"]["file"] == "flat-stimulus.csv"


def test_a_measured_g_is_laid_over(tab: Any, flat: Results, tmp_path: Path) -> None:  # noqa: F811
    from dataclasses import replace

    write_csv(tmp_path / "lab.csv", replace(flat.transfer, values=1.1 * flat.transfer.values))
    tab.evaluate("document.querySelectorAll('#controls details').forEach(d => { d.open = true; })")
    tab.locator("#measured").set_input_files(tmp_path / "lab.csv")
    tab.locator("#played").wait_for()
    assert "differs from it by 9.09 %" in tab.locator("#played").inner_text()  # 0.1 of 1.1
    assert tab.locator("#spectra .chart").first.locator("path[stroke-dasharray]").count() == 4
    (tmp_path / "own.json").write_text(tab.evaluate("workbench.exports.gAsJson()"))
    tab.locator("#measured").set_input_files(tmp_path / "own.json")
    tab.get_by_text("own.json: ").first.wait_for()
    assert "differs from it by 0 %" in tab.locator("#played").inner_text()
    tab.get_by_text("take away").click()
    assert tab.locator("#played").count() == 0


DAMAGED = {
    "a.json": b"{", "b.json": b'{"content": "other"}', "c.csv": b"frequency_Hz,output,input,real,imag\n1,1,A1,x,0\n",
    "d.csv": b"\x00\x01\x02", "e.wav": b"RIFF", "f.csv": b"", "g.csv": b"<script>alert(1)</script>\n1\nx\n",
}  # fmt: skip


def test_a_damaged_file_is_one_sentence_and_nothing_is_lost(tab: Any, tmp_path: Path) -> None:
    tab.evaluate("workbench.app.set({target: 2})")
    before = strength(tab)
    for name, data in DAMAGED.items():
        (tmp_path / name).write_bytes(data)
        tab.locator("#own").set_input_files(tmp_path / name)
        tab.locator("#say.bad").filter(has_text=name).wait_for()
        said = tab.locator("#say").inner_text()
        assert said.startswith(name)
        assert len(said) < 300
        assert "\n" not in said
        assert strength(tab) == before
        assert tab.evaluate("workbench.app.overlay") is None


@pytest.mark.parametrize(("width", "scheme"), [(1440, "light"), (820, "dark"), (390, "light")])
def test_it_fits_every_width(browser: Any, html: Path, width: int, scheme: str) -> None:
    tab, problems = opened(browser, html, viewport={"width": width, "height": 800}, color_scheme=scheme)
    assert tab.evaluate("document.documentElement.scrollWidth") <= width
    assert tab.evaluate("document.documentElement.dataset.theme") == scheme
    assert all(b["w"] > 200 for b in tab.evaluate("workbench.arms.boxes()"))
    finger = tab.evaluate("getComputedStyle(document.getElementById('over')).touchAction")
    assert finger == ("pan-y" if width == 390 else "none")  # arms as tall as a phone must not hold the page
    assert problems == []
    tab.close()


def test_a_hostile_name_stays_text(browser: Any, content: dict[str, Any], tmp_path: Path) -> None:  # noqa: F811
    bad = "<script>alert(1)</script><img src=x onerror=alert(2)>"
    page = tmp_path / "bad.html"
    port = {**content["outputs"][0], "name": "<b>1</b>"}
    page.write_text(
        page_of(
            {
                **content,
                "name": bad,
                "description": bad,
                "stamp": bad,
                "notes": [bad],
                "outputs": [port, *content["outputs"][1:]],
            }
        ),
        encoding="utf-8",
    )
    tab, problems = opened(browser, page)
    tab.on("dialog", lambda d: problems.append(d.message))
    assert tab.locator("#name").inner_text() == bad
    assert tab.locator("img, b").count() == 0
    assert tomllib.loads(tab.evaluate("workbench.exports.scenarioToml()"))["name"] == f"{bad}-workbench"
    assert problems == []
    tab.close()


def test_a_measured_page_offers_no_device_and_no_place_between(browser: Any, flat: Results, tmp_path: Path) -> None:  # noqa: F811
    page = tmp_path / "g.html"
    page.write_text(page_of(measured_content(flat.transfer, parse_scenario(LAYERED), "measured G")), encoding="utf-8")
    tab, problems = opened(browser, page)
    tab.get_by_text("Device", exact=True).click()
    assert tab.get_by_text("cannot be changed here").is_visible()
    assert "nothing was measured" in tab.locator("#errors").inner_text()
    tab.evaluate("workbench.app.set({place: null})")
    with pytest.raises(Exception, match="a G that was given"):
        tab.evaluate("workbench.exports.scenarioToml()")
    assert strength(tab) == pytest.approx(
        flat.run.signal_strength.model_dump()["methods"]["inverse filter"]["5"]["value"], rel=1e-6
    )
    assert problems == []
    tab.close()


@pytest.mark.slow
def test_drawn_arms_are_stepped_through(browser: Any, drawn: tuple[Path, Any], tmp_path: Path) -> None:  # noqa: F811
    """By keys and buttons; points move, S changes, the skin between is said to be unknown."""
    page = tmp_path / "arms.html"
    page.write_text(page_of(content_of(Results.open(drawn[0]))), encoding="utf-8")
    tab, problems = opened(browser, page)
    own = strength(tab)
    tab.keyboard.press("a")
    assert tab.evaluate("workbench.experiment.settings.arm") == 1
    first = strength(tab)
    assert first != own
    assert "a drawn arm" in tab.locator(".head .why").first.inner_text()
    tab.get_by_text("Drawn arms", exact=True).click()
    tab.locator("#armnext").click()
    assert tab.locator("#arm").inner_text() == "draw 1, zener"
    tab.wait_for_function("document.querySelectorAll('#armtable tbody tr').length === 3")
    assert tab.locator("#armtable tr.now td").nth(1).inner_text().startswith(f"{strength(tab):.2f}"[:3])
    tab.keyboard.press("A")
    assert strength(tab) == first
    with pytest.raises(Exception, match="drawn arm"):
        tab.evaluate("workbench.exports.scenarioToml()")
    tab.keyboard.press("A")
    assert strength(tab) == own
    assert problems == []
    tab.close()


def test_a_limb_is_cut_open(browser: Any, folder: Path, tmp_path: Path) -> None:  # noqa: F811
    page = tmp_path / "limb.html"
    page.write_text(page_of(content_of(Results.open(folder))), encoding="utf-8")
    tab, problems = opened(browser, page)
    whole = tab.evaluate("(() => { workbench.app.rescale(); return workbench.arms.parts.body.toDataURL().length; })()")
    tab.locator("#section").select_option("along")
    cut = tab.evaluate("(() => { workbench.app.rescale(); return workbench.arms.parts.body.toDataURL().length; })()")
    assert cut != whole
    assert tab.locator("#section").is_enabled()
    assert problems == []
    tab.close()
