"""Devices side by side: one row each, over the same points, and a verdict that leaves out points beside motors."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_figures_scene import folder  # noqa: F401

from forearm_fem.errors import DataError
from forearm_fem.results.draws import READINGS, DrawsFile, Outcome
from forearm_fem.show.answer import method_answers
from forearm_fem.show.data import Results
from forearm_fem.show.devices import (
    Device,
    Devices,
    _people_line,
    answer_lines,
    are_devices,
    compare_devices,
    devices_block,
    devices_page,
    ratios_block,
    same_arms,
)
from forearm_fem.show.judge import Strengths
from forearm_fem.store.record import save


def with_s(device: Device, name: str, values: list[list[float]], counted: list[bool]) -> Device:
    """The device with S as given and points that do not count."""
    value = np.array(values)
    data: Strengths = replace(
        device.data, values=value, low=value - 0.01, high=value + 0.01, counted=np.array(counted)
    )
    return replace(device, name=name, data=data, answers=method_answers(data))


@pytest.fixture(scope="module")
def one(folder: Path) -> Device:  # noqa: F811
    return compare_devices([folder, folder]).devices[0]


@pytest.fixture(scope="module")
def two(one: Device) -> Devices:
    wide = with_s(one, "wide", [[2.0] * 9, [1.5] * 9, [0.5] * 9], [True] * 9)
    near = with_s(one, "near", [[9.0, *[3.0] * 8]] * 3, [False, *[True] * 8])
    return Devices((near, wide), np.array([False, *[True] * 8]))


def test_means_are_over_the_points_that_count_in_all(two: Devices) -> None:
    """9 at a point beside a motor is in no mean."""
    assert [two.mean(d) for d in two.devices] == pytest.approx([3.0, 2.0])
    assert [d.name for d in two.ranked] == ["near", "wide"]  # both focus at the 8 points that count in both
    first, *others = answer_lines(two)
    assert first.startswith("near is better than wide")
    assert first.endswith("; point 1 counts for wide alone.")
    assert "Mean S over the 8 points that count in all (2, 3, 4, 5, 6, 7, 8, 9): 3.00 near, 2.00 wide." in others


def test_more_points_in_focus_come_before_a_larger_mean(one: Device) -> None:
    wide = with_s(one, "wide", [[2.0] * 9] * 3, [True] * 9)
    near = with_s(one, "near", [[0.5, *[9.0] * 8]] * 3, [True] * 9)
    found = Devices((near, wide), np.ones(9, dtype=bool))
    assert [d.name for d in found.ranked] == ["wide", "near"]
    assert "it focuses at 9 of the 9 points that count in both, not 8" in answer_lines(found)[0]


def test_intervals_that_overlap_are_called_a_draw(one: Device) -> None:
    pair = [with_s(one, n, [[s] * 9] * 3, [True] * 9) for n, s in (("a", 2.0), ("b", 2.015))]
    assert answer_lines(Devices(tuple(pair), np.ones(9, dtype=bool)))[0].startswith("A draw between b and a")
    barely = [with_s(one, n, [[s, *[2.0] * 8]] * 3, [True] * 9) for n, s in (("a", 1.005), ("b", 0.995))]
    found = Devices(tuple(barely), np.ones(9, dtype=bool))  # 9 points and 8, but the ninth is open in both
    assert answer_lines(found)[0].startswith("A draw between a and b")
    nobody = [replace(d, data=replace(d.data, low=d.data.low * np.nan)) for d in barely]
    assert answer_lines(Devices(tuple(nobody), found.shared))[0].startswith("Undecided between a and b")
    apart = Devices((pair[0], with_s(one, "c", [[2.5] * 9] * 3, [True] * 9)), np.ones(9, dtype=bool))
    assert answer_lines(apart)[0].startswith("c is better than a on this arm")


def drawn(device: Device, place: Path, values: list[float], stiffness: list[float]) -> Device:
    """The device with a prediction in ``place``: S of each arm, alike at all points."""
    shape = len(device.data.methods), len(device.data.targets)
    arms = [
        Outcome(k, "zener", np.full((len(READINGS), *shape), s), {"fat stiffness": mu}, problem="" if s else "ill")
        for k, (s, mu) in enumerate(zip(values, stiffness, strict=True))
    ]
    found = DrawsFile.of(arms, device.data.methods, device.data.targets, "q", np.array([100.0]))
    (place / "prediction").mkdir(parents=True)
    save(place / "prediction" / "draws.nc", found)
    return replace(device, results=Results(place))


def test_devices_meet_the_same_arms(one: Device, tmp_path: Path) -> None:
    """Arm by arm, those that gave S for both; predictions of other arms are not compared."""
    a = drawn(one, tmp_path / "a", [2.0, 4.0, 6.0, 1.0], [1.0, 2.0, 3.0, 4.0])
    b = drawn(one, tmp_path / "b", [3.0, 3.0, 3.0, 0.0], [1.0, 2.0, 3.0, 4.0])
    found = same_arms(Devices((a, b), np.ones(9, dtype=bool)), a, b)
    assert found is not None
    np.testing.assert_allclose(found.mean, [1.5, 0.75, 0.5])
    said = _people_line(Devices((a, b), np.ones(9, dtype=bool)), a, b)
    assert "larger mean S over the shared points on 67 % (21 to 94 % by their number)" in said  # Wilson's, 2 of 3
    np.testing.assert_allclose(found.ratio[:, 1, 4], found.mean)
    others = drawn(one, tmp_path / "others", [3.0, 3.0, 3.0, 3.0], [1.0, 2.0, 3.0, 5.0])
    apart = Devices((a, others), np.ones(9, dtype=bool))
    assert same_arms(apart, a, others) is None
    assert "drew other arms" in _people_line(apart, a, others)
    assert same_arms(Devices((a, one), np.ones(9, dtype=bool)), a, one) is None


def test_ratios_stand_with_their_intervals(two: Devices) -> None:
    rows = ratios_block(two, two.devices[1], two.devices[0]).rows
    assert rows[0][1:] == ["not counted for near"] * 3
    assert rows[1][1] == "×1.50 (1.49 to 1.51)"  # 3 +- .01 over 2 +- .01


def test_a_row_says_drive_clearance_and_error(folder: Path) -> None:  # noqa: F811
    """Volts for 1 um at the target: the largest drive over the largest motion of the target, as all is linear."""
    found = compare_devices([folder, folder])
    results, device = Results.open(folder), found.devices[0]
    m, t = 1, 4
    drive = np.abs(results.drives.values[m, t]).max()
    moved = np.abs(results.displacements.values[m, t, t]).max()
    assert device.drive[m, t] == pytest.approx(1e-6 * drive / moved)
    corner = np.hypot(9.2e-3, 9.2e-3) - 3.5e-3  # the point at 13.3 mm, the motor at 22.5
    assert device.gap == pytest.approx(corner, rel=1e-2)
    row = devices_block(found).rows[0]
    assert row[-2] == "9.5 mm"
    assert len(devices_block(found).rows) == 2


def test_runs_are_told_from_two_g_of_one_device(folder: Path, tmp_path: Path) -> None:  # noqa: F811
    assert not are_devices([folder, folder])
    assert are_devices([folder, folder, folder])
    assert not are_devices([folder, tmp_path])
    with pytest.raises(DataError, match="at least two"):
        compare_devices([folder])


def test_the_page_shows_a_map_of_differences(two: Devices) -> None:
    page = devices_page(two)
    assert "S of wide (dotted) over S of near" in page.html()
    assert page.html().count("data:image/png") == 5  # a map each, and the differences by three methods
    other = devices_page(Devices(two.devices, None))  # other grids: nothing to subtract
    assert other.html().count("data:image/png") == 2
