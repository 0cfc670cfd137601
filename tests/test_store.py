"""The store's promises: what was written comes back or is told as damaged, and what is finished is not made again."""

from __future__ import annotations

import logging
import os
import signal
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from forearm_fem.errors import DataError
from forearm_fem.ports import Port
from forearm_fem.store.folder import SUMS, check_kind, locked, set_kind, write_text
from forearm_fem.store.record import dims, from_parts, load, save, to_parts
from forearm_fem.store.shelf import Shelf
from forearm_fem.store.work import LOST, done_once, spread

posix = pytest.mark.skipif(os.name == "nt", reason="kill -9 and limits on files")


@dataclass(frozen=True, eq=False)
class Part:
    a: Any = field(metadata=dims("frequency"))
    note: str = ""


@dataclass(frozen=True, eq=False)
class Whole:
    kind: ClassVar[str] = "test"
    version: ClassVar[int] = 1

    frequency: Any = field(metadata=dims("frequency", units="Hz"))
    values: np.ndarray = field(metadata=dims("frequency output input", name="G", units="=unit"))
    outputs: tuple[Port, ...] = field(metadata=dims("output"))
    names: tuple[str, ...] = field(metadata=dims("term"))
    matrices: np.ndarray = field(metadata=dims("term row", upper=True))
    tables: dict[str, Any] = field(metadata=dims("*"))
    parts: tuple[Part, ...] = ()
    one: Part | None = None
    valid: np.ndarray | None = field(default=None, metadata=dims("frequency output input"))
    unit: str = "m/V"
    levels: tuple[tuple[float, float], ...] = ()
    provenance: dict[str, Any] = field(default_factory=dict)


NUMBERS = st.one_of(
    arrays(np.float64, array_shapes(min_dims=1, max_dims=3, min_side=0, max_side=4), elements=st.floats()),
    arrays(np.int64, array_shapes(min_dims=1, max_dims=2, min_side=0, max_side=4)),
    arrays(np.complex128, array_shapes(min_dims=1, max_dims=2, max_side=4), elements=st.complex_numbers()),
)
NAMES = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=6)
PLAIN = st.dictionaries(NAMES, st.one_of(st.none(), st.booleans(), st.integers(-99, 99), st.floats(), NAMES))


@st.composite
def wholes(draw: Any) -> Whole:
    n, outputs, terms, size = (draw(st.integers(*ends)) for ends in ((1, 4), (0, 3), (1, 3), (1, 3)))
    random = np.random.default_rng(draw(st.integers(0, 99)))
    values = random.normal(size=(n, outputs, 2)) * 1j
    matrices = random.normal(size=(terms, size, size))
    ports = tuple(Port(f"{draw(NAMES)}{k}", "point", (0.1, float(k), -0.0)) for k in range(outputs))
    lengths = draw(st.lists(st.integers(0, 4), max_size=3))
    return Whole(
        random.normal(size=n), values, ports, tuple(draw(NAMES) + "." for _ in range(terms)),
        matrices + matrices.swapaxes(1, 2), draw(st.dictionaries(st.sampled_from(["t", "keys", "x"]), NUMBERS)),
        tuple(Part(random.normal(size=m), draw(NAMES)) for m in lengths),
        draw(st.sampled_from([None, Part(np.arange(n))])), draw(st.sampled_from([None, values.real > 0])),
        draw(st.sampled_from(["m/V", "m/N"])), tuple(draw(st.lists(st.tuples(st.floats(0), st.floats(0)), max_size=2))),
        draw(PLAIN),
    )  # fmt: skip


def same(a: Any, b: Any) -> bool:
    """Equal to the bit and in kind, NaN equal to NaN."""
    if isinstance(a, np.ndarray):
        return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
    if isinstance(a, Whole | Part):
        return all(same(getattr(a, n), getattr(b, n)) for n in a.__dataclass_fields__)
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[k], b[k]) for k in a)
    if isinstance(a, tuple) and a and not isinstance(a[0], float):
        return len(a) == len(b) and all(same(x, y) for x, y in zip(a, b, strict=True))
    return bool(a == b) or (a != a and b != b)


@settings(max_examples=20, deadline=None)
@given(wholes())
def test_a_record_comes_back_from_a_file_and_from_a_shelf(tmp_path_factory: Any, whole: Whole) -> None:
    folder = tmp_path_factory.getbasetemp() / "round"
    save(folder / "w.nc", whole)
    assert same(load(folder / "w.nc", Whole), whole)
    assert same(from_parts(Whole, to_parts(whole)), whole)
    shelf = Shelf(folder / "s.sqlite")
    assert shelf.keep("k", whole)
    assert same(shelf.record("k", Whole), whole)


SOME = Whole(
    np.arange(3.0), np.ones((3, 2, 2)) * 1j, (Port("1", "point", (0.0, 1.0, 2.0)), Port("ü", "point", (0.0, 1.0, 2.0))),
    ("k", "mass"), np.ones((2, 3, 3)), {"t": np.arange(4)}, (Part(np.arange(2.0), "n"),), provenance={"seed": [1, 2]},
)  # fmt: skip


def test_a_damaged_file_is_told_and_never_read_as_something_else(tmp_path: Path) -> None:
    """A bit anywhere: arrays and names have HDF5's checksums, and so has what says where they stand."""
    file = tmp_path / "w.nc"
    save(file, SOME)
    content, random = file.read_bytes(), np.random.default_rng(0)
    refused = 0
    for at in random.integers(len(content), size=150):
        changed = bytearray(content)
        changed[at] ^= 1 << int(random.integers(8))
        file.write_bytes(changed)
        try:
            assert same(load(file, Whole), SOME), at
        except DataError:
            refused += 1
    assert refused > 30
    for kept in (0, 100, len(content) // 2, len(content) - 1):
        file.write_bytes(content[:kept])
        with pytest.raises(DataError, match=r"w\.nc: damaged"):
            load(file, Whole)


def test_another_kind_version_or_program_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "w.nc"
    save(file, SOME)
    shelf = Shelf(tmp_path / "s.sqlite")
    shelf.keep("k", SOME)
    with monkeypatch.context() as newer:
        newer.setattr(Whole, "version", 2)
        with pytest.raises(DataError, match="make it again"):
            load(file, Whole)
        assert shelf.record("k", Whole) is None
    with monkeypatch.context() as other:
        other.setattr(Whole, "kind", "another")
        with pytest.raises(DataError, match="holds test, expected another"):
            load(file, Whole)
    with pytest.raises(DataError, match="no such file"):
        load(tmp_path / "none.nc", Whole)


def test_two_rows_of_ports_of_one_name_are_no_record() -> None:
    @dataclass(frozen=True)
    class Two:
        kind: ClassVar[str] = "two"
        version: ClassVar[int] = 1
        some: tuple[Port, ...] = field(metadata=dims("port"))
        others: tuple[Port, ...] = field(metadata=dims("port"))

    with pytest.raises(ValueError, match="two rows of ports are called port"):
        to_parts(Two(SOME.outputs[:1], SOME.outputs[1:]))


def test_a_damaged_part_or_shelf_was_never_there(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    shelf = Shelf(tmp_path / "s.sqlite", "a test")
    shelf.put("a", {"x": np.arange(1000.0)})
    shelf.put("b", {"n": 1})
    content = shelf.file.read_bytes()
    at = content.index(np.arange(1000.0)[500:510].tobytes())
    shelf.file.write_bytes(content[:at] + b"\xff" + content[at + 1 :])
    assert (shelf.get("a"), shelf.get("b")) == (None, {"n": 1})
    for damage in (b"", b"no database at all" * 99, content[: len(content) // 2]):
        again = Shelf(tmp_path / "s.sqlite", "a test")
        shelf.file.write_bytes(damage)
        assert again.known() == ()
        shelf.file.write_bytes(damage)
        assert again.get("a") is None
        assert again.put("c", {"n": 2})
        assert again.get("c") == {"n": 2}


@posix
@pytest.mark.skipif(os.name != "nt" and os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_that_cannot_be_written_costs_the_reuse(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    tmp_path.chmod(0o500)
    shelf = Shelf(tmp_path / "a" / "s.sqlite", "a test")
    with caplog.at_level(logging.WARNING):
        assert dict(done_once(shelf, {"k": 2}, lambda n: {"n": n})) == {"k": {"n": 2}}
    assert "a test could not be kept" in caplog.text


def test_a_place_that_is_a_file_costs_the_reuse_and_is_told_once(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "file").write_text("")
    shelf = Shelf(tmp_path / "file" / "s.sqlite", "a test")
    with caplog.at_level(logging.WARNING):
        found = dict(done_once(shelf, {"k": 2, "m": 3}, lambda n: {"n": n}))
    assert found == {"k": {"n": 2}, "m": {"n": 3}}
    assert caplog.text.count("a test could not be kept") == 1


FULL = """
import resource, signal, sys
import numpy as np
from forearm_fem.store.shelf import Shelf
from forearm_fem.store.work import done_once
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)  # writes fail then, as on a full disk
shelf = Shelf(sys.argv[1], "a test")
shelf.put("before", {"n": 1})
resource.setrlimit(resource.RLIMIT_FSIZE, (40_000, 40_000))
found = dict(done_once(shelf, {"k": 2, "m": 3}, lambda n: {"x": np.full(9000, n)}))
assert all((found[k]["x"] == n).all() for k, n in (("k", 2), ("m", 3)))
"""


@posix
def test_a_full_disk_costs_the_reuse_and_nothing_that_was_there(tmp_path: Path) -> None:
    run = subprocess.run(
        [sys.executable, "-c", FULL, str(tmp_path / "s.sqlite")], capture_output=True, text=True, check=False
    )
    assert (run.returncode, run.stderr.count("a test could not be kept")) == (0, 1), run.stderr
    shelf = Shelf(tmp_path / "s.sqlite")
    assert (shelf.get("before"), shelf.get("k")) == ({"n": 1}, None)


def test_work_goes_on_where_it_was_interrupted_and_failures_are_tried_again(tmp_path: Path) -> None:
    shelf, jobs, made = Shelf(tmp_path / "s.sqlite"), {f"k{n}": n for n in range(20)}, list[int]()

    def work(n: int) -> dict[str, Any]:
        if n == 7 and len(made) < 8:
            made.append(n)
            raise KeyboardInterrupt
        made.append(n)
        return {LOST: "no"} if n == 3 else {"x": np.full(3, n)}

    with pytest.raises(KeyboardInterrupt):
        list(done_once(shelf, jobs, work))
    assert shelf.known() == tuple(f"k{n}" for n in (0, 1, 2, 4, 5, 6))
    made.clear()
    told: list[tuple[int, int]] = []

    def rest(n: int) -> dict[str, Any]:
        made.append(n)
        return {"x": np.full(3, n)}

    again = dict(done_once(shelf, jobs, rest, tell=lambda *a: told.append(a)))
    assert made == [3, *range(7, 20)]
    assert (told[0], told[-1]) == ((6, 20), (20, 20))
    assert all(np.array_equal(again[f"k{n}"]["x"], np.full(3, n)) for n in range(20))


KILLED = """
import sys, time
import numpy as np
from forearm_fem.store.shelf import Shelf
from forearm_fem.store.work import done_once
def work(n):
    print(n, flush=True)
    time.sleep(0.002)
    return {"x": np.full(20_000, n), "n": n}
list(done_once(Shelf(sys.argv[1]), {f"k{n}": n for n in range(int(sys.argv[2]))}, work))
"""


@posix
def test_a_killed_process_loses_the_job_under_way_only(tmp_path: Path) -> None:
    """kill -9 at whatever moment, amid a write too; what was told as begun before the last one is there."""
    file = tmp_path / "s.sqlite"
    for begun in (3, 10, 25):
        line = [sys.executable, "-c", KILLED, str(file), "1000"]
        with subprocess.Popen(line, stdout=subprocess.PIPE, text=True) as run:
            assert run.stdout is not None
            first = [int(run.stdout.readline()) for _ in range(begun)]
            run.send_signal(signal.SIGKILL)
        shelf = Shelf(file)
        for n in range(first[-1]):
            found = shelf.get(f"k{n}")
            assert found is not None, n
            assert np.array_equal(found["x"], np.full(20_000, n))


@posix
def test_two_processes_share_a_shelf(tmp_path: Path) -> None:
    file = tmp_path / "s.sqlite"
    runs = [subprocess.Popen([sys.executable, "-c", KILLED, str(file), "30"], stdout=subprocess.DEVNULL) for _ in "ab"]
    assert [run.wait(60) for run in runs] == [0, 0]
    shelf = Shelf(file)
    assert sorted(shelf.known()) == sorted(f"k{n}" for n in range(30))
    assert all((shelf.get(f"k{n}") or {})["n"] == n for n in range(30))


def test_who_asks_for_one_process_gets_none_besides(monkeypatch: pytest.MonkeyPatch) -> None:
    assert spread(1, None, "a test") is None
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert spread(lambda: 4, None, "a test", asked=False) is None
    assert spread(2, None, "a test") is not None


def test_sums_vouch_for_what_was_written_under_the_lock(tmp_path: Path) -> None:
    (tmp_path / "theirs.txt").write_text("not ours")
    with locked(tmp_path):
        write_text(tmp_path / "a.txt", "a")
        write_text(tmp_path / "figures" / "b.txt", "b")
    lines = (tmp_path / SUMS).read_text().splitlines()
    assert [line.split("  ")[1] for line in lines] == ["a.txt", "figures/b.txt"]
    (tmp_path / "figures/b.txt").write_text("damaged")
    with locked(tmp_path):
        write_text(tmp_path / "a.txt", "anew")
    check = subprocess.run(["sha256sum", "-c", SUMS], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert check.stdout.splitlines() == ["a.txt: OK", "figures/b.txt: FAILED"]


def test_a_folder_says_its_kind(tmp_path: Path) -> None:
    set_kind(tmp_path, "run")
    check_kind(tmp_path, "run")
    check_kind(tmp_path, "fit", {"a": 1}, ("fit.json",))  # a fit may lie in a run's folder
    with pytest.raises(DataError, match="holds a run"):
        check_kind(tmp_path, "study")
    (tmp_path / "fit.json").write_text("{}")
    with pytest.raises(DataError, match="is no earlier result"):
        check_kind(tmp_path, "fit", {"a": 1}, ("fit.json",))
    set_kind(tmp_path, "fit", {"a": (1,)})
    check_kind(tmp_path, "fit", {"a": (1,)}, ("fit.json",))
    with pytest.warns(UserWarning, match="answered another question"):
        check_kind(tmp_path, "fit", {"a": (2,)}, ("fit.json",))
    set_kind(tmp_path, "fit", {"a": (2,)}, ("fit.json",))
    assert not (tmp_path / "fit.json").exists()
