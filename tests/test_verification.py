"""The verification's own machinery, its quick rows, and the proof that bugs do not pass."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from forearm_fem.errors import GeometryError
from forearm_fem.geometry.mesh.curved import true_volumes
from forearm_fem.verification import cases, hard, slabs, twin
from forearm_fem.verification.blocks import block_mesh, shell_mesh
from forearm_fem.verification.mutations import BUGS, mutation_table, run_mutations
from forearm_fem.verification.report import effectivity_section, stability_page, verification_page
from forearm_fem.verification.rows import HardCase, HardResult, HardRow, Row, weakest
from forearm_fem.verification.run import Case, run_hard_cases, run_verification

GOOD = Row("a", "exact", "u", 1e-4, 1e-3, "because")
BAD = Row("b", "exact | other", "u", 2e-3, 1e-3, "because")


# --- machinery -------------------------------------------------------------------------------------------------------


def test_a_row_is_met_within_its_tolerance_only():
    assert GOOD.met
    assert not BAD.met
    assert not replace(GOOD, error=math.nan).met
    assert weakest([GOOD, BAD]) is BAD
    assert weakest([BAD, broken := replace(GOOD, error=math.nan)]) is broken


def test_runner_times_rows_and_tells_progress():
    told = []
    chosen = (Case("one", lambda: iter([GOOD, BAD])), Case("two", lambda: iter([GOOD]), quick=False))
    rows = run_verification(progress=lambda *x: told.append(x), chosen=chosen)
    assert [r.case for r in rows] == ["a", "b"]
    assert all(r.seconds > 0 for r in rows)
    assert told == [("one", 1, 1)]
    assert len(run_verification(True, chosen=chosen)) == 3


def test_pages_carry_every_row():
    page = verification_page([GOOD, BAD])
    assert "1 of 2 rows met" in page
    assert "exact \\| other" in page
    assert page.count("| NO |") == 2  # in the table, and above it as the weakest
    assert all(text in page for text in ("why this tolerance", "because"))
    nearest, _, every = page.partition("Nearest to its tolerance")[2].partition("All of them")
    assert ("| a |" in nearest, "| b |" in nearest) == (False, True)
    assert "| a |" in every
    assert "| b |" in every
    hard_page = stability_page([HardRow("c", "w", "r", "e", "WRONG")])
    assert "| WRONG | 1 |" in hard_page


def test_effectivity_section_names_what_is_outside(tmp_path):
    file = tmp_path / "benchmarks" / "results" / "effectivity.csv"
    assert effectivity_section(file) == ""
    file.parent.mkdir(parents=True)
    names = "scene,scale,unknowns,estimated_band,true_band,estimated_single,true_single,"
    rows = ("a,1.0,9,0.02,0.01,0.02,0.01,2.0,2.0", "b,1.5,8,0.07,0.01,0.02,0.01,7.0,2.0")
    file.write_text("\n".join([names + "effectivity_band,effectivity_single", *rows]))
    page = effectivity_section(file)
    assert "| 2 | 2 | 2 | 7 | 1 of 2 |" in page
    assert "Outside: b x1.5 (7)." in page
    assert "(../benchmarks/results/effectivity.png)" in page


def test_verdicts():
    def refuse():
        raise GeometryError("no room")
        yield

    def crash():
        yield HardResult("", "first", 0.1, 1.0)
        raise ValueError("bug")

    assert [r.verdict for r in hard.hard_rows(HardCase("n", "w", refuse))] == ["named error"]
    assert [r.verdict for r in hard.hard_rows(HardCase("n", "w", crash))] == ["right", "WRONG"]
    for error in (2.0, np.nan):
        case = HardCase("n", "w", partial(iter, [HardResult("", "r", error, 1.0)]))
        assert hard.hard_rows(case)[0].verdict == "WRONG"


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


# --- quick rows ------------------------------------------------------------------------------------------------------

FAST = {
    "tables": twin.table_rows,
    "miller-pursey": twin.miller_pursey_rows,
    "limits": twin.limit_rows,
    "rigid discs": twin.rigid_rows,
    "bar": cases.shear_bar_rows,
    "structure": cases.structure_rows,
}


@pytest.mark.parametrize("name", FAST)
def test_quick_rows_are_met(name):
    missed = [r for r in FAST[name]() if not r.met]
    assert not missed


def test_fe_meets_the_twin_on_a_coarse_slab():
    """Preset O at 300 Hz on 18 000 unknowns: 2.1 % at the points, 1 % under the disc, seen; half as much again."""
    slab = slabs.CONVERGENCE
    disc, points = slabs.errors_of(slabs.solve_level(slab, 1.5).values, slabs.exact(slab))
    assert disc < 0.015
    assert points < 0.03


def test_three_levels_converge_to_the_twin_and_state_their_error():
    """What `verify` asks of order, error and estimate, so that it does not fail first at a user's."""
    missed = [r for r in slabs.convergence_rows() if not r.met]
    assert not missed


def test_quick_hard_cases():
    names = {"two contacts touching", "contact over an edge", "held by nothing, static", "rotated, translated, scaled"}
    rows = [r for case in hard.HARD if case.name in names for r in hard.hard_rows(case)]
    assert {r.case for r in rows} == names
    assert all(r.verdict != "WRONG" for r in rows)


# --- studies ---------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_all_quick_rows_are_met():
    missed = [r for r in run_verification() if not r.met]
    assert not missed


@pytest.mark.slow
def test_no_hard_case_is_silently_wrong():
    wrong = [r for r in run_hard_cases() if r.verdict == "WRONG"]
    assert not wrong


@pytest.mark.slow
def test_every_deliberate_bug_is_caught():
    found = run_mutations()
    assert [c.bug for c in found] == list(BUGS)
    assert all(c.rows or c.raised for c in found)
    assert "none" not in mutation_table(found)
