"""The benchmark's own machinery: fits, choices, tables that go on, pages; one tiny run of every method."""

from __future__ import annotations

import csv
import os
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest

from bench import asked, error, isolated, plots, reduced, run, scene, size, text
from bench.run import Table, run_bench
from bench.tables import Row, read_rows, record_machine, write_csv
from forearm_fem import __version__
from forearm_fem.errors import AccuracyWarning, DataError, SolverError
from forearm_fem.fem.reduction.certificate import Certificate
from forearm_fem.fem.reduction.sweep import SweepResult
from forearm_fem.scenario.sweep import ReducedSolve


@dataclass(frozen=True)
class Point:
    """A row as a measurement returns it."""

    name: str
    seconds_all: float
    peak_bytes: float
    runs: int = 1


def timed(method: str, element: str, unknowns: int, seconds: float, worst: float, **more: Any) -> error.Timed:
    precision = "auto" if method == "reduced" else "double"
    return error.Timed(method, element, precision, 1.0, unknowns, seconds, seconds, 1e9, worst, worst / 2, **more)


ERRORS = [
    timed("direct", "P2", 1000, 50.0, 0.15),
    timed("direct", "P2", 9000, 900.0, 0.04),
    timed("reduced", "P2", 1000, 2.0, 0.15),
    timed("reduced", "P2", 9000, 20.0, 0.04),
    timed("reduced", "P3", 4000, 12.0, 0.06),
    timed("twin", "-", 0, 0.1, 1e-6),
]


def rows_of(folder: Path, name: str, rows: list[Any]) -> list[Row]:
    write_csv(folder / f"{name}.csv", rows)
    return read_rows(folder / f"{name}.csv")


# --- numbers ---------------------------------------------------------------------------------------------------------


def test_exponents_leave_out_the_smallest_sizes() -> None:
    def sized(n: int, cost: float) -> size.Sized:
        return size.Sized("double", 1.0, n, n**1.0, n**1.2, cost, n**1.3, n**1.1, 1e-14)

    rows = [sized(n, n**2.0) for n in (80_000, 40_000, 20_000)] + [sized(10_000, 5.0)]
    found = size.exponents(rows)
    assert found["seconds_factorisation"] == pytest.approx(2.0, rel=1e-9)
    assert found["seconds_solve"] == pytest.approx(1.3, rel=1e-9)
    assert found["peak_bytes"] == pytest.approx(1.1, rel=1e-9)
    assert size.exponents(rows[:1]) == {}


def test_interpolation_is_exact_for_polynomials_of_its_degree() -> None:
    nodes, band = error.nodes(), scene.BAND

    def curve(f: np.ndarray) -> np.ndarray:
        x = (f - 240) / 160
        return np.asarray((x**10 - 1j * x**3 + 2)[:, None, None])

    assert (nodes[0], nodes[-1], len(nodes)) == (band[0], band[-1], error.NODES)
    assert error.interpolated(nodes, curve(nodes), band) == pytest.approx(curve(band), abs=1e-12)


@pytest.mark.parametrize(("seconds", "runs"), [(8.0, 3), (12.0, 2), (20.0, 1)])
def test_long_runs_are_not_repeated(seconds: float, runs: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """All runs together fit into the 30 s of patience, the first included, which is always made."""
    clock = [0.0]

    def run(work: Any, argument: str) -> str:
        clock[0] += seconds
        return argument

    monkeypatch.setattr(isolated, "isolated", run)
    monkeypatch.setattr(isolated.time, "perf_counter", lambda: clock[0])
    assert isolated.repeated(len, "made") == ("made",) * runs


def test_medians_per_column() -> None:
    runs = [Point("a", s, b) for s, b in ((3.0, 1.0), (1.0, 9.0), (2.0, 5.0))]
    assert isolated.median(runs) == Point("a", 2.0, 5.0, 3)


def test_held_out_bins_are_bins_that_nothing_used() -> None:
    bins = np.arange(10.0, 60.0, 0.5)
    sweep = SweepResult(np.zeros((0, 1, 1)), 0.0, 0.0, None, (10.0, 30.0), (Certificate(20.0, 1e-5),))
    found = reduced.held_out_bins(bins, sweep, 12)
    assert len(found) == 12
    assert set(found) <= set(bins) - {10.0, 20.0, 30.0}
    assert (found[0], found[-1]) == (10.5, 59.5)
    assert len(reduced.held_out_bins(bins, sweep, 1000)) == len(bins) - 3


def test_cheapest_is_the_fastest_that_is_right(tmp_path: Path) -> None:
    rows = rows_of(tmp_path, "error", ERRORS)
    assert text.cheapest(rows, 0.2)["seconds_cpu"] == "2"
    assert text.cheapest(rows, 0.1)["element"] == "P3"
    assert text.cheapest(rows, 0.05)["unknowns"] == "9000"
    assert text.cheapest(rows, 0.05, method="direct")["seconds_cpu"] == "900"
    assert text.cheapest(rows, 0.01) is None  # the twin has no limb


# --- processes and files ---------------------------------------------------------------------------------------------


def killed(_: str) -> None:
    os._exit(9)


def test_a_killed_run_is_a_named_error() -> None:
    with pytest.raises(SolverError, match="killed, most likely for memory"):
        isolated.isolated(killed, "this")


def test_threads_are_set_and_put_back(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    with isolated.threads(1):
        assert os.environ["OMP_NUM_THREADS"] == os.environ["MKL_NUM_THREADS"] == "1"
    assert os.environ["OMP_NUM_THREADS"] == "7"
    assert "MKL_NUM_THREADS" not in os.environ


def test_rows_survive_the_file(tmp_path: Path) -> None:
    (row,) = rows_of(tmp_path, "x", [Point("a, b", 1.25, 3e9)])
    assert row == {"name": "a, b", "seconds_all": "1.25", "peak_bytes": "3e+09", "runs": "1"}
    assert read_rows(tmp_path / "none.csv") == []


def test_an_interrupted_table_goes_on_and_a_finished_one_starts_anew(tmp_path: Path) -> None:
    Table(tmp_path, "x", ("name", "seconds_all")).add(Point("a", 2.0, 1.0))
    again = Table(tmp_path, "x", ("name", "seconds_all"))
    assert again.has("a", 2.0)
    assert not again.has("a", 3.0)
    again.add(Point("b", 3.0, 1.0))
    with again.finish().open(newline="") as stream:
        assert [r["name"] for r in csv.DictReader(stream)] == ["a", "b"]
    assert not Table(tmp_path, "x", ("name", "seconds_all")).has("a", 2.0)


# --- whole runs ------------------------------------------------------------------------------------------------------


def test_an_unknown_part_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"'sizes'; known are error, size, asked, reduced"):
        run_bench(tmp_path, only=["sizes"])
    script = Path(run.__file__).parents[1] / "speed.py"
    command = [sys.executable, str(script), "--only", "sizes", "--out", str(tmp_path / "out")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert "'sizes'" in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "out").exists()


def test_a_case_that_fails_loses_its_row_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def sized(case: tuple[str, float]) -> size.Sized:
        if case[1] == 2.0:
            raise SolverError("no room")
        return size.Sized(case[0], case[1], int(1e4 / case[1]), 1.0, 1.0, 2.0, 0.5, 1e9, 1e-14)

    monkeypatch.setattr(run, "repeated", lambda work, case: (work(case),))
    monkeypatch.setattr(run.size, "sized", sized)
    with pytest.warns(AccuracyWarning, match="no room"):
        run_bench(tmp_path, only=["size"])
    assert [r["part"] for r in read_rows(tmp_path / "machine.csv")] == ["size"]
    rows = [(r["precision"], r["scale"]) for r in read_rows(tmp_path / "size.csv")]
    assert rows == [(precision, scale) for scale in ("3", "1.5", "1.2") for precision in ("double", "single")]


PEER = {
    "scale": "2", "program": "forearm_fem", "solver": "double", "version": "1", "unknowns": 14000,
    "seconds_single": 1.0, "seconds_full": 6.0, "peak_bytes": 1e9, "error_exact": 0.01, "difference": 0.0,
    "single_ratio": 1.0, "full_ratio": 1.0, "note": "",
}  # fmt: skip
OTHERS = [
    {**PEER, "program": "NGSolve", "solver": "pardiso", "single_ratio": 1.7, "full_ratio": 210.0},
    {
        **PEER,
        "program": "NGSolve",
        "solver": "umfpack",
        "single_ratio": "",
        "full_ratio": "",
        "note": "not done in 9 s",
    },
]


def test_the_page_says_what_to_choose(tmp_path: Path) -> None:
    two = size.Sized("double", 1.0, 10_000, 1.0, 0.5, 8.0, 0.5, 2e9, 1e-14)
    alone = replace(two, scale=0.5, unknowns=50_000, seconds_factorisation=400.0)  # not there in single precision
    held = reduced.Reduced(9000, 13, 981, 4, 150, 2.0, 2.5, 20.0, 2450.0, 0.5, 40, 3e-5, 1e-6)
    met = asked.Asked(0.1, 3e-3, 9000, 4.0, 4.0, 1.0, 1e9, 0.02, 0.014, 0.06, 0.03)
    tables: MappingProxyType[str, list[Any]] = MappingProxyType({
        "error": ERRORS, "size": [two, replace(two, precision="single", seconds_factorisation=4.0), alone],
        "asked": [met, replace(met, accuracy=0.01)],
        "reduced": [{**held.__dict__, "speed_ratio": held.speed_ratio, "in_factorisations": held.in_factorisations}],
        "peers": [PEER, *OTHERS],
        "assembly": [{"program": "NGSolve", "tetrahedra": 5, "what": "one", "seconds": 2.0, "seconds_operator": ""}],
    })  # fmt: skip
    for name, rows in tables.items():
        write_csv(tmp_path / f"{name}.csv", rows)
    for part in ("size", "error", "size"):
        record_machine(tmp_path, part)
    drawn = plots.draw_all(tmp_path)
    page = text.write_page(tmp_path).read_text()
    assert [p.name for p in drawn] == ["error.png", "size.png", "asked.png", "reduced.png"]
    assert all(p.stat().st_size > 10_000 for p in drawn)
    assert all(f"]({p.name})" in page for p in drawn)
    assert page.count("**Choose**") == len(tables)
    assert [r["part"] for r in read_rows(tmp_path / "machine.csv")] == ["error", "size"]
    assert page.count(f"*forearm_fem {__version__}, ") == 2
    assert "| 0.1 | reduced, P3 | 4000 | 12 | 1 | 900 | 75 |" in page
    assert "with the points alone missed at 0.01" in page
    assert "| 50000 | double | " in page
    assert "At 10000 unknowns its factorisation takes\n0.5 of the time" in page
    assert "| not done in 9 s |" in page
    assert "210 to 210 times as long" in page


@pytest.mark.parametrize("method", ["reduced", "direct"])
def test_every_method_runs_on_a_tiny_slab(method: str) -> None:
    rows = error._WORK[method](error.Case(method, "P2", "double", 5.0))
    assert rows[0].method == method
    assert len({r.unknowns for r in rows}) == 1
    assert all(0 < r.error_band < 0.2 for r in rows)  # element sizes of 7 mm: seen 0.05
    if method == "direct":
        assert rows[0].seconds > rows[1].seconds


def test_the_twin_is_as_exact_as_asked() -> None:
    (row,) = error._twin(error.Case("twin", "-", "double", 1e-4))
    assert row.error_worst < 1e-4


def test_one_size_in_both_precisions() -> None:
    double, single = (size.sized((p, 5.0)) for p in ("double", "single"))
    assert double.unknowns == single.unknowns > 2000
    assert max(double.residual, single.residual) < 1e-8


def test_the_knob_chooses_the_mesh(monkeypatch: pytest.MonkeyPatch) -> None:
    """One expansion about 200 Hz is enough for three frequencies; at accuracy 1 the elements are 6 mm large."""
    few = ReducedSolve(expansions=1, derivatives=3, max_expansions=1)
    monkeypatch.setattr(asked, "BAND", np.array([190.0, 200.0, 210.0]))
    monkeypatch.setattr(asked, "options", lambda _: few)
    coarse = asked.asked(1.0)
    assert coarse.size > 1.7 * asked.element_sizes(scene.knob(0.01)).grid  # 100^(1/4), held at 6 mm
    assert coarse.error_band < coarse.error_points < 1.0
    assert 0 < coarse.estimated_band < 1.0
