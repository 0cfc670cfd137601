"""Safe writing: damaged copies are refused, other programs read the files, a full disk leaves nothing behind."""

from __future__ import annotations

import csv
import subprocess
import sys
from pathlib import Path

import h5py
import meshio
import numpy as np
import pytest
from scipy.io import loadmat

sys.path.insert(0, str(Path(__file__).parent))
from damage import FORMATS, KINDS, MESH, PLAIN, G, damaged, outcome


@pytest.mark.parametrize("form", [f for f in FORMATS if not f.name.startswith("mesh")], ids=lambda form: form.name)
def test_damage_is_refused_or_harmless(form, tmp_path):
    """Every kind of damage once, on a file of each format; benchmarks/damage.py takes 60 files each."""
    file = tmp_path / form.name
    form.write(file)
    whole, content = form.read(file), file.read_bytes()
    rng = np.random.default_rng(1)
    for number in range(len(KINDS)):
        file.write_bytes(damaged(content, number, rng))
        what, said = outcome(form, file, whole)
        assert what in ("refused", "read unchanged"), (KINDS[number].__name__, what, said)


def test_other_programs_read_what_is_written(tmp_path):
    """MATLAB readers, csv and meshio find what was written."""
    for form in (*FORMATS, *PLAIN):
        form.write(tmp_path / form.name)
    np.testing.assert_array_equal(loadmat(tmp_path / "own.mat")["G"], G.values.transpose(1, 2, 0))
    assert loadmat(tmp_path / "thesis.mat")["G"].shape == (9, 4, 200)
    with open(tmp_path / "G.csv", newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(line for line in stream if not line.startswith("#")))
    assert float(rows[0]["real"]) == G.values[0, 0, 0].real
    for name in ("mesh.vtu", "mesh.msh"):
        assert len(meshio.read(tmp_path / name).points) == len(MESH.points)
    with h5py.File(tmp_path / "wavefield.nc") as store:
        assert store["modes"].shape == (40, 3, 6)


_FULL = """
import resource, signal, sys
from pathlib import Path
sys.path.insert(0, {tests!r})
from damage import FORMATS, PLAIN
from forearm_fem.errors import ForearmError
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)  # writes fail then, as on a full disk
resource.setrlimit(resource.RLIMIT_FSIZE, (60, 60))
for form in (*FORMATS, *PLAIN):
    try:
        form.write(Path({folder!r}, form.name))
        print(form.name, "written")
    except ForearmError as problem:
        if "cannot be written" not in str(problem) or chr(10) in str(problem) or len(str(problem)) > 300:
            print(form.name, problem)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="needs a limit on the size of files")
def test_a_full_disk_ends_in_one_sentence_and_leaves_nothing(tmp_path):
    """All writers in one process that may write 60 bytes a file; HDF5 crashed when such a process ended."""
    script = _FULL.format(tests=str(Path(__file__).parent), folder=str(tmp_path))
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=120, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert list(tmp_path.iterdir()) == []
