"""The pages for what a person has in hand: files are written, commands run, and G held against the truth."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import pyvista
from bad_meshes import PLAIN
from cli_runner import cli
from lab_files import tdms, uff
from scipy.io import savemat
from test_files_everybody import LAB, SCENE, sweeps
from test_measurement_scene import INPUTS, OUTPUTS, part, wave_matrix

from forearm_fem import files
from forearm_fem.files import Declaration
from forearm_fem.typing import ComplexArray

PAGES = Path(__file__).parents[1] / "docs" / "howto" / "files"
G = part(wave_matrix(np.arange(20.0, 40.0)), 2, 2)
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```", re.MULTILINE | re.DOTALL)


def of_sweeps(folder: Path, kind: str) -> None:
    made = sweeps(folder / "made", kind)
    (folder / "sweeps").mkdir()
    for file in made.iterdir():
        target = folder / "sweeps" / (file.name if kind == "tdms" else file.name.removeprefix("P"))
        if kind == "tdms":
            channels = files.sweeps.waveforms(file, Declaration())
            tdms(target, {c.split("/")[1]: w.samples for c, w in channels.items()}, LAB.sweep.sample_rate)
        else:
            file.rename(target)


def of_matlab(folder: Path) -> None:
    acceleration = -((2 * np.pi * G.frequency) ** 2)[:, None, None] * G.values
    savemat(folder / "lab.mat", {"FRF": {"H": acceleration, "f": G.frequency, "who": "me"}, "other": np.eye(3)})


def of_uff(folder: Path) -> None:
    for o, i in np.ndindex(2, 2):
        one = part(replace(G, values=G.values[:, o:, i:], outputs=OUTPUTS[o:2], inputs=INPUTS[i:2]), 1, 1)
        uff(folder / "lab.uff", one, rsp_node=101 + o, ref_node=7 - i)


SIZES = np.array([[1.0, 2.0], [3.0, 4.0]])


def of_impulses(folder: Path) -> None:
    for i, name in enumerate("ab"):
        h = np.zeros((64, 2), "<f4")
        h[8] = SIZES[:, i]
        (folder / f"{name}.f32").write_bytes(h.tobytes(order="F"))


def of_scan(folder: Path) -> None:
    pyvista.Box((-24, 24, -18, 18, -16, 0)).triangulate().save(folder / "skin.stl")


def of_mesh(folder: Path) -> None:
    """A block in millimetres, its upper half skin."""
    nodes, cells = PLAIN.replace("lower", "MUSCLE").replace("upper", "SKIN").split("*ELEMENT", 1)
    rows = [line.split(",") for line in nodes.strip().split("\n")[1:]]
    scaled = "\n".join(", ".join([row[0], *(repr(1e3 * float(v)) for v in row[1:])]) for row in rows)
    (folder / "arm.inp").write_text(f"*NODE\n{scaled}\n*ELEMENT{cells}")


def table() -> ComplexArray:
    return np.asarray(np.array([[3.10 - 0.42j, 0.91 - 0.11j], [2.75 - 0.61j, 1.03 - 0.15j]]) * 1e-6, complex)


def impulses() -> ComplexArray:
    return np.asarray(SIZES / -((2 * np.pi * 20.0) ** 2), complex)


TABLE = np.array([[3.10 - 0.42j, 0.91 - 0.11j], [2.75 - 0.61j, 1.03 - 0.15j]]) * 1e-6
OF_SWEEPS = 2e-3  # of the largest entry: the virtual lab's converter has 16 bits
EXACT = 1e-6  # single precision on disk, twelve digits of UFF
CASES: dict[str, tuple[Callable[[Path], None], ComplexArray | None, float]] = {
    "table": (lambda folder: None, TABLE, EXACT),
    "tdms": (lambda folder: of_sweeps(folder, "tdms"), SCENE.values, OF_SWEEPS),
    "wav": (lambda folder: of_sweeps(folder, "wav"), SCENE.values, OF_SWEEPS),
    "matlab": (of_matlab, G.values, EXACT),
    "uff": (of_uff, G.values, EXACT),
    "impulses": (of_impulses, SIZES / -((2 * np.pi * 20.0) ** 2) + 0j, EXACT),
    "scan": (of_scan, None, 0.0),
    "mesh": (of_mesh, None, 0.0),
}


@pytest.mark.parametrize("page", [pytest.param(p, marks=pytest.mark.slow) if p == "scan" else p for p in CASES])
def test_the_page_runs_as_printed_and_its_g_is_right(tmp_path, page):
    """The first frequency that is known throughout is held against what went in; of a limb the elements are counted."""
    make, truth, off = CASES[page]
    make(tmp_path)
    commands = list[str]()
    for kind, body in BLOCK.findall((PAGES / f"{page}.md").read_text(encoding="utf-8")):
        if kind in ("toml", "text"):
            (tmp_path / body.split("\n")[0].removeprefix("# ")).write_text(body)
        else:
            commands += [line for line in body.split("\n") if line]
    assert commands
    for line in commands:
        answer = cli(*shlex.split(line)[1:], cwd=tmp_path)
        assert answer.code == 0, answer.err
    if truth is None:
        assert "tetrahedra" in answer.out
        return
    g = files.read(tmp_path / "G.nc")
    at = 0 if g.valid is None else int(np.argmax(g.valid.all(axis=(1, 2))))
    if truth is SCENE.values:
        truth = truth[int(np.argmin(np.abs(SCENE.frequency - g.frequency[at])))]
    expected = truth if truth.ndim == 2 else truth[0]
    assert np.abs(g.values[at] - expected).max() < off * np.abs(expected).max()


def test_the_index_lists_every_page():
    index = (PAGES / "index.md").read_text(encoding="utf-8")
    listed = set(re.findall(r"\]\((\w+)\.md\)", index))
    assert {f.stem for f in PAGES.glob("*.md")} - {"index"} == listed == set(CASES)
