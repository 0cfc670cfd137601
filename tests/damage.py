"""Files of every format of ours, ways to damage them, and what reading a damaged one comes to."""

from __future__ import annotations

import dataclasses
import json
import signal
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from bad_files import CORNERS, TETRA
from test_measurement_scene import INPUTS, RATE, wave_matrix

from forearm_fem import files
from forearm_fem.engines.skin_model import SkinModel
from forearm_fem.errors import ForearmError
from forearm_fem.fem.reduction.affine import AffineReduced
from forearm_fem.files.declaration import RecognitionWarning
from forearm_fem.geometry.limb.filling import oriented
from forearm_fem.geometry.mesh.files import read_mesh, write_mesh
from forearm_fem.geometry.mesh.tissue_mesh import TissueMesh
from forearm_fem.geometry.user.checks import with_boundaries
from forearm_fem.measurement.recording import Recording, read_recording, write_recording
from forearm_fem.results import files as io
from forearm_fem.results.files import Wavefield
from forearm_fem.scenario import Scenario
from forearm_fem.store.record import load, save

RNG = np.random.default_rng(0)
G = dataclasses.replace(
    wave_matrix(np.arange(10.0, 40.5, 2.0)), deviation=1e-8 * (1 + RNG.random((16, 9, 4))), provenance={"seed": 3}
)
SIGNALS = io.Signals(RNG.standard_normal((1, 2, 4, 50)), ("a",), ("1", "5"), tuple("wxyz"), np.arange(50) * 1e-4, "V")
SMALL = AffineReduced(("k", "m"), np.stack([np.eye(6), 2 * np.eye(6)]), RNG.standard_normal((6, 4)), np.ones(4))
REDUCED = SkinModel(Scenario(), INPUTS, SMALL)
FIELD = Wavefield(
    np.arange(5.0) + 10, np.float64(np.float32(RNG.standard_normal((40, 3, 6)))), np.ones((5, 6, 4)) * (1 + 2j)
)
RECORDING = Recording("1", "A1", RATE, RNG.standard_normal(200), RNG.standard_normal((2, 200)))


def _block() -> TissueMesh:
    region = (CORNERS[TETRA].mean(axis=1)[:, 2] > -0.01).astype(np.int64)
    bare = TissueMesh(CORNERS, oriented(CORNERS, TETRA), region, ("muscle", "fat"), {})
    return with_boundaries(bare)


MESH = _block()


@dataclasses.dataclass(frozen=True)
class Format:
    """A kind of file: its name, how it is written, and how it is read."""

    name: str
    write: Callable[[Path], None]
    read: Callable[[Path], Any]


FORMATS = (
    Format("transfer.nc", lambda p: io.write_transfer(p, G), io.read_transfer),
    Format("drives.nc", lambda p: io.write_drives(p, SIGNALS), io.read_drives),
    Format("reduced.nc", lambda p: save(p, REDUCED), lambda p: load(p, SkinModel)),
    Format("wavefield.nc", lambda p: save(p, FIELD), lambda p: load(p, Wavefield)),
    Format("recording.nc", lambda p: write_recording(p, RECORDING, "setup"), read_recording),
    Format("mesh.vtu", lambda p: write_mesh(MESH, p), read_mesh),
    Format("mesh.msh", lambda p: write_mesh(MESH, p), read_mesh),
)

PLAIN = (
    Format("thesis.mat", lambda p: files.write_thesis_mat(p, G, 200.0, 1.0), files.read_thesis_mat),
    Format("own.mat", lambda p: files.save(p, G), files.read),
    Format("G.csv", lambda p: files.save(p, G), files.read),
)  # formats of other programs, without checksums


def flipped_bit(content: bytearray, rng: np.random.Generator) -> bytearray:
    content[int(rng.integers(len(content)))] ^= 1 << int(rng.integers(8))
    return content


def changed_bytes(content: bytearray, rng: np.random.Generator) -> bytearray:
    for at in rng.integers(len(content), size=int(rng.integers(2, 9))):
        content[int(at)] = int(rng.integers(256))
    return content


def changed_digit(content: bytearray, rng: np.random.Generator) -> bytearray:
    """One decimal digit for another: the damage that text formats cannot see."""
    digits = [k for k, c in enumerate(content) if chr(c) in "0123456789"]
    if digits:
        at = int(rng.choice(digits))
        content[at] = ord("0") + (content[at] - ord("0") + 1 + int(rng.integers(8))) % 10
    return content


def cut(content: bytearray, rng: np.random.Generator) -> bytearray:
    return content[: int(rng.integers(len(content)))]


def zeroed(content: bytearray, rng: np.random.Generator) -> bytearray:
    length = int(min(rng.choice([16, 64, 512]), len(content) // 2))
    at = int(rng.integers(len(content) - length))
    content[at : at + length] = bytes(length)
    return content


def swapped(content: bytearray, rng: np.random.Generator) -> bytearray:
    length = int(min(rng.choice([8, 64, 256]), len(content) // 4))
    a, b = sorted(int(k) for k in rng.choice(len(content) // length, 2, replace=False) * length)
    content[a : a + length], content[b : b + length] = content[b : b + length], content[a : a + length]
    return content


def lost_bytes(content: bytearray, rng: np.random.Generator) -> bytearray:
    at = int(rng.integers(len(content)))
    del content[at : at + int(rng.choice([1, 8, 16]))]
    return content


KINDS = (flipped_bit, changed_bytes, changed_digit, cut, zeroed, swapped, lost_bytes)
OUTCOMES = ("refused", "read unchanged", "silently changed", "traceback", "hang or crash")


def damaged(content: bytes, number: int, rng: np.random.Generator) -> bytes:
    """``content`` after the ``number``-th kind of damage, different from what it was."""
    while True:
        found = bytes(KINDS[number % len(KINDS)](bytearray(content), rng))
        if found != content:
            return found


def outcome(form: Format, file: Path, whole: Any) -> tuple[str, str]:
    """One of :data:`OUTCOMES`, and what was said."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RecognitionWarning)
            found = form.read(file)
    except ForearmError as problem:
        said = str(problem).replace(f"{file.parent}/", "")
        return ("traceback" if "\n" in said or len(said) > 300 else "refused"), said
    except Exception as problem:
        return "traceback", f"{type(problem).__name__}: {problem}"
    return ("read unchanged" if same(found, whole) else "silently changed"), ""


def same(a: Any, b: Any) -> bool:
    """Equal to the last bit, NaN equal to NaN; names of files apart."""
    if isinstance(a, TissueMesh):
        return (a.digest, a.region_names, list(a.facets)) == (b.digest, b.region_names, list(b.facets))
    if isinstance(a, np.ndarray):
        return np.array_equal(a, b, equal_nan=a.dtype.kind in "fc")
    if dataclasses.is_dataclass(a) and not isinstance(a, type):
        names = [f.name for f in dataclasses.fields(a) if f.name != "provenance"]
        kin = isinstance(a, type(b)) or isinstance(b, type(a))
        return kin and all(same(getattr(a, n), getattr(b, n)) for n in names)
    if isinstance(a, tuple | list):
        return len(a) == len(b) and all(same(x, y) for x, y in zip(a, b, strict=True))
    if isinstance(a, dict):
        return list(a) == list(b) and all(same(a[k], b[k]) for k in a)
    return bool(a == b)


def campaign(form: Format, folder: Path, count: int, *, limit: int = 20) -> list[tuple[str, str]]:
    """Outcomes of ``count`` damaged files, each read in a process of its own that may take ``limit`` seconds."""
    import os

    file = folder / form.name
    form.write(file)
    whole, content = form.read(file), file.read_bytes()
    rng, found = np.random.default_rng(29), []
    for number in range(count):
        file.write_bytes(damaged(content, number, rng))
        ends = folder / "outcome.json"
        ends.unlink(missing_ok=True)
        child = os.fork()
        if child == 0:
            signal.signal(signal.SIGALRM, signal.SIG_DFL)
            signal.alarm(limit)
            ends.write_text(json.dumps(outcome(form, file, whole)))
            os._exit(0)
        status = os.waitpid(child, 0)[1]
        kind = KINDS[number % len(KINDS)].__name__
        what, said = json.loads(ends.read_text()) if status == 0 else ("hang or crash", f"status {status}")
        found.append((what, f"{kind}: {said}"))
    return found
