"""`forearm-fem verify`: its rows, its table, its verdict; and the blocks and shells that it solves."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from cli_runner import cli

from forearm_fem.geometry.mesh.tissue_mesh import true_volumes
from forearm_fem.verification import Row, run
from forearm_fem.verification.scenes import block_mesh, shell_mesh

GOOD = Row("a", "exact", "u", 1e-4, 1e-3, "because")
BAD = Row("b", "exact | other", "u", 2e-3, 1e-3, "because")


def test_a_row_is_met_within_its_tolerance_only():
    assert GOOD.met
    assert not BAD.met
    assert not replace(GOOD, error=math.nan).met
    assert run.weakest([GOOD, BAD]) is BAD
    assert run.weakest([BAD, broken := replace(GOOD, error=math.nan)]) is broken


def test_the_command_prints_and_keeps_every_row_and_fails_for_one(tmp_path, monkeypatch):
    monkeypatch.setattr(run.run_verification, "__kwdefaults__", {"cases": {"one": lambda: iter([GOOD])}})
    answer = cli("verify", "--out", tmp_path / "out")
    assert answer.code == 0
    assert "1 of 1 rows met" in answer.out
    assert "MISSED" not in answer.out
    monkeypatch.setattr(run.run_verification, "__kwdefaults__", {"cases": {"one": lambda: iter([GOOD, BAD])}})
    answer = cli("verify", "--out", tmp_path / "out")
    assert answer.code == 1
    assert "1 of 2 rows met" in answer.out
    assert "MISSED: b, u: 0.002 of 0.001 allowed." in answer.out
    page, short = ((tmp_path / "out" / f"verification.{kind}").read_text() for kind in ("html", "md"))
    assert page.index("MISSED: b") < page.index("<table")  # the answer first
    assert "exact \\| other" in short
    assert page.count("because") > 2


def test_rows_are_timed_and_progress_is_told():
    told = []
    rows = run.run_verification(lambda *x: told.append(x), cases={"one": lambda: iter([GOOD, BAD])})
    assert all(r.seconds > 0 for r in rows)
    assert told == [("one", 1, 1)]


def test_blocks_and_shells_fill_their_volume():
    block = block_mesh((3, 2, 4), (0.3, 0.2, 0.4), facets={"end": ("x0", "y1")}, bend=0.1)
    assert block.volumes.min() > 0
    assert block.volumes.sum() == pytest.approx(0.3 * 0.2 * 0.4, rel=1e-12)
    shell = shell_mesh(np.array([1.0, 1.5, 2.0]), 4)
    assert shell.volumes.min() > 0
    assert shell.volumes.sum() == pytest.approx(np.pi / 3 * 7, rel=1e-12)  # equal-volume polyhedra
    assert {"symmetry x", "symmetry y", "contact A1", "end"} <= set(shell.facets)
    round_ones = (shell_mesh(np.array([1.0, 1.5, 2.0]), n, curved=True) for n in (4, 8))
    coarse, fine = (abs(true_volumes(m).sum() / (np.pi / 3 * 7) - 1) for m in round_ones)
    assert coarse < 2e-3
    assert coarse / fine == pytest.approx(16, rel=0.1)  # parabolas for arcs: fourth order


# punch and sphere at other sizes in test_fem_physics, the slab in test_slabs
SLOW = ("rigid punch", "oscillating sphere", "slab against the layered model")


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.slow) if n in SLOW else n for n in run.CASES])
def test_rows_are_met(name):
    assert [row for row in run.CASES[name]() if not row.met] == []
