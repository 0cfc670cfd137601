"""A page made of an arm's library: what it knows between its places, and actuators that are dragged."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from test_workbench import asked, complex_of, needs_node
from test_workbench_page import opened, strength

from forearm_fem.device import close_loop
from forearm_fem.engines.fem import Solved
from forearm_fem.engines.layered import flat_ports
from forearm_fem.engines.library import make_library, save_library
from forearm_fem.errors import GeometryError
from forearm_fem.geometry.device.layout import layout_of
from forearm_fem.ports import Port
from forearm_fem.results.run import SolutionRecord
from forearm_fem.scenario import Scenario, parse_scenario
from forearm_fem.scenario.sweep import frequencies
from forearm_fem.show.workbench import anywhere as module
from forearm_fem.show.workbench import write_workbench
from forearm_fem.show.workbench.anywhere import places_of
from forearm_fem.show.workbench.bundle import page_of
from forearm_fem.show.workbench.content import library_content
from forearm_fem.transfer import Compliance

SCENE: dict[str, Any] = {
    "name": "patch", "engine": "layered", "sweep": {"duration": 0.2, "sample_rate": 2000.0, "f_max": 300.0},
    "device": {"cone": {"contact": "bonded"}}, "limb": {"shape": "slab", "length": 0.1, "width": 0.1, "depth": 0.03},
    "library": {"length": 0.08, "width": 0.07},
}  # fmt: skip


def sent(frequency: np.ndarray, away: np.ndarray, radius: float) -> np.ndarray:
    """Motion (n_frequency, ...) [m/N] at distances from a disc: a wave that a loss damps, as large as skin's."""
    k = 2 * np.pi * frequency / 6.0 * (1 - 0.3j)
    beyond = np.maximum(away, radius)
    return np.asarray(1e-4 * np.exp(-1j * np.multiply.outer(k, beyond)) / np.sqrt(1 + beyond / radius))


@dataclass(frozen=True)
class Stand:
    """An arm whose answers are a closed form: a damped wave, and a smooth difference from it that is not even."""

    scenario: Scenario

    @property
    def skin(self) -> Any:
        up = np.array([0.0, 0.0, 1.0])
        return SimpleNamespace(
            flat=lambda p: p[:, :2], places=lambda uv: (np.column_stack([uv, 0 * uv[:, 0]]), np.tile(up, (len(uv), 1)))
        )

    def ports(self, scenario: Scenario) -> tuple[Port, ...]:
        layout_of(scenario)
        half = 0.5 * np.array([self.scenario.library.length, self.scenario.library.width])
        for port in (found := flat_ports(scenario)):
            if (np.abs(port.position[:2]) + port.radius > half + 1e-9).any():
                raise GeometryError("off the patch")
        return found

    def holds(self, scenario: Scenario) -> str:
        return ""

    name = "stand"

    def compliance(self, scenario: Scenario, frequency: np.ndarray | None = None) -> Compliance:
        ports, f = self.ports(scenario), frequencies(scenario.sweep)
        at = np.array([p.position[:2] for p in ports])
        away = np.linalg.norm(at[:, None] - at[None], axis=2)
        smooth = np.cos(60 * at[:, 0] + 0.4) * np.cos(45 * at[:, 1] - 0.2)
        difference = 2e-5 * np.exp(-((f / 200) ** 2) - 1j * f / 100)[:, None, None] * np.outer(smooth, smooth)
        return Compliance(f, sent(f, away, scenario.device.cone.radius) + difference, ports)

    def solved(self, scenario: Scenario, frequency: np.ndarray | None = None) -> Solved:
        found = self.compliance(scenario)
        empty = np.zeros((0, 3, 0)), np.zeros((len(found.frequency), 0, 0), dtype=complex)
        return Solved(found, None, None, *empty, SolutionRecord(solver="library"), ())


@pytest.fixture
def arm(monkeypatch: pytest.MonkeyPatch) -> Stand:
    monkeypatch.setattr(module, "profile", lambda scenario, port, f, radii: sent(f, radii, port.radius))
    return Stand(parse_scenario(SCENE))


ELSEWHERE = [[-0.021, 0.014], [0.008, 0.019], [-0.018, -0.02], [0.024, -0.012]]


def exact_g(arm: Any, contacts: list[list[float]]) -> np.ndarray:
    """G of the arm itself with discs at ``contacts``."""
    scenario = arm.scenario.changed({"device.contacts": contacts})
    return close_loop(arm.compliance(scenario), scenario.device).values


def worst(found: np.ndarray, expected: np.ndarray) -> np.ndarray:
    return np.abs(found - expected).max(axis=(1, 2)) / np.abs(expected).max(axis=(1, 2))


@needs_node
@pytest.mark.slow
def test_the_page_knows_discs_anywhere_within_what_it_states(arm: Stand) -> None:
    """An arrangement that none of its checks saw errs by no more than twice the worst of those five; the page's numbers
    are Python's own to the eight digits that it holds them with."""
    content = library_content(arm, arm.scenario, "a library")
    places, missed = places_of(arm, arm.scenario)
    assert 1e-6 < missed.band < 0.02
    jobs = [{"ask": "transfer", "settings": {"contacts": c}} for c in (content["model"]["home"], ELSEWHERE)]
    for answer, contacts in zip(asked(content, *jobs), (content["model"]["home"], ELSEWHERE), strict=True):
        expected = exact_g(arm, contacts)
        found = complex_of(answer).reshape(expected.shape)
        assert np.linalg.norm(found - expected) < 2 * missed.band * np.linalg.norm(expected)
        values = places.compliance(np.array(contacts))
        skin = arm.compliance(arm.scenario)
        n = len(contacts)
        whole = np.zeros_like(skin.values)
        whole[:, :, :n] = values
        whole[:, :n, :] = values.swapaxes(1, 2)
        ports = tuple(replace(p, position=(*contacts[k], 0.0)) if k < n else p for k, p in enumerate(skin.ports))
        own = close_loop(replace(skin, values=whole, ports=ports), arm.scenario.device).values
        assert worst(found, own).max() < 1e-5
    assert {e["source"] for e in content["errors"]} == {"interpolation"}


@needs_node
@pytest.mark.slow  # 2 s
def test_where_discs_cannot_stand_is_said(arm: Stand) -> None:
    content = library_content(arm, arm.scenario, "a library")
    off, close = [[0.2, 0.0], *ELSEWHERE[1:]], [ELSEWHERE[1], *ELSEWHERE[1:]]
    with pytest.raises(AssertionError, match="A1 would leave the library's patch of 80 x 70 mm"):
        asked(content, {"ask": "transfer", "settings": {"contacts": off}})
    with pytest.raises(AssertionError, match=r"A2 and A1 would stand 0\.0 mm apart"):
        asked(content, {"ask": "transfer", "settings": {"contacts": close}})


def test_actuators_are_dragged_and_walked(browser: Any, arm: Stand, tmp_path: Path) -> None:
    """By the mouse and by keys: drives and S follow, the scenario kept says where; off the patch nothing moves."""
    import tomllib

    page = tmp_path / "lib.html"
    page.write_text(page_of(library_content(arm, arm.scenario, "a library")), encoding="utf-8")
    tab, problems = opened(browser, page)
    assert "What a library cannot do" in tab.locator("#errors").inner_text()
    before, home = strength(tab), tab.evaluate("workbench.experiment.settings.contacts")
    mover = tab.locator("#pad .mover").first
    mover.focus()
    tab.keyboard.press("ArrowRight")
    tab.keyboard.press("Shift+ArrowUp")
    now = tab.evaluate("workbench.experiment.settings.contacts")
    assert now[0] == pytest.approx([home[0][0] + 1e-3, home[0][1] + 5e-3])
    assert strength(tab) != before
    assert tab.evaluate("document.activeElement.dataset.actuator") == "0"
    mover.hover()  # scrolls, and waits until it lies still
    box = mover.bounding_box()
    assert box is not None
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    tab.mouse.move(x, y)
    tab.mouse.down()
    tab.mouse.move(x + 12, y - 9)
    tab.mouse.up()
    moved = tab.evaluate("workbench.experiment.settings.contacts")[0]
    step = np.subtract(moved, now[0])
    assert step[0] / step[1] == pytest.approx(12 / 9, rel=0.02)  # one scale both ways, pixels of the screen
    assert step[0] > 1e-3
    table = tomllib.loads(tab.evaluate("workbench.exports.scenarioToml()"))
    assert table["device"]["contacts"][0] == pytest.approx(moved, abs=1e-6)
    s = strength(tab)
    tab.evaluate("workbench.app.set({contacts: [[0.2, 0], ...workbench.experiment.settings.contacts.slice(1)]})")
    assert "would leave the library's patch" in tab.locator("#say").inner_text()
    assert strength(tab) == s
    assert problems == []
    tab.close()


@pytest.mark.slow  # a library of a slab, 15 s
@needs_node
def test_a_librarys_file_becomes_a_page_within_its_errors(tmp_path: Path) -> None:
    """G of another arrangement against the library's own answer for it, scattering included."""
    import json
    import re

    scenario = parse_scenario({
        "name": "slab", "accuracy": 0.3, "limb": {"shape": "slab", "length": 0.06, "width": 0.05, "depth": 0.02},
        "device": {"contacts": [[-0.006, 0.0], [0.005, 0.002]], "cone": {"radius": 0.002}},
        "grid": {"points": [[0.0, 0.0], [0.001, -0.005]]}, "library": {"length": 0.022, "width": 0.016, "step": 0.005},
        "sweep": {"f_min": 60, "f_max": 300, "duration": 0.1, "sample_rate": 2000},
    })  # fmt: skip
    made = make_library(scenario)
    save_library(tmp_path / "slab.library.nc", made)
    page = write_workbench(tmp_path / "slab.library.nc", tmp_path / "slab.html").read_text(encoding="utf-8")
    found = re.search(r'<script id="content" type="application/json">(.*?)</script>', page, re.DOTALL)
    assert found is not None
    content = json.loads(found[1])
    contacts = [[-0.004, -0.003], [0.007, 0.004]]
    answer = asked(content, {"ask": "transfer", "settings": {"contacts": contacts}})[0]
    expected = exact_g(made, contacts)
    stated = next(e for e in content["errors"] if "the page's own" in e["method"])
    found_g = complex_of(answer).reshape(expected.shape)
    assert np.linalg.norm(found_g - expected) / np.linalg.norm(expected) < 2 * stated["band"]
    assert stated["band"] < 0.2  # bonded discs six radii apart scatter a tenth, which the page leaves out and states
