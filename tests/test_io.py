"""Files: what is written comes back bit for bit, damage is named, and nothing half-written is left."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import xarray as xr
from scipy.io import loadmat

from forearm_fem import files
from forearm_fem.errors import DataError
from forearm_fem.ports import Port
from forearm_fem.results import files as io
from forearm_fem.store.folder import atomic_path, write_text
from forearm_fem.store.record import save
from forearm_fem.transfer import Compliance, ErrorEstimate, TransferMatrix

BINS = np.arange(20, 1001, dtype=float) * 0.5
CONTACTS = tuple(
    Port(f"A{i + 1}", "contact", (0.02, i / 3, -1e-3), (0.0, 0.6, 0.8), 3.5e-3, "bonded") for i in range(4)
)
POINTS = tuple(Port(str(i + 1), "point", (i / 7, 0.0, 1e-9)) for i in range(9))
ERRORS = (
    ErrorEstimate("discretisation", 1 / 3, "coarser mesh, h^3.5", (10.0, 100.0), (0.1, np.inf)),
    ErrorEstimate("linear solve", 1e-14, "residual"),
    ErrorEstimate("reduction", 1e-4, "residual — greedy", (10.0, 20.0, 500.0), (1e-5, 2e-5, 1e-4)),
)


def noise(*shape: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.normal(size=shape) + 1j * rng.normal(size=shape)


def compliance(frequency: np.ndarray = BINS) -> Compliance:
    values = noise(len(frequency), 13, 13)
    points = np.arange(4, 13)
    values[:, points, points] = np.nan
    provenance = {"mesh": "sha", "size": 1.5e-3, "list": [1, None, True], "µ": {"ω": "long" * 30000}}
    return Compliance(frequency, values, (*CONTACTS, *POINTS), ERRORS, provenance)


def transfer(frequency: np.ndarray = BINS) -> TransferMatrix:
    n, rng = len(frequency), np.random.default_rng(1)
    return TransferMatrix(
        frequency=frequency,
        values=noise(n, 9, 4, seed=2) * 1e-6,
        outputs=POINTS,
        inputs=CONTACTS,
        contacts=noise(n, 4, 4, seed=3),
        valid=rng.uniform(size=(n, 9, 4)) > 0.2,
        deviation=rng.uniform(size=(n, 9, 4)),
        errors=ERRORS[::-1],
        provenance={"device": {"cone": 4e-4}, "seed": 3},
    )


def same(ours: Any, other: Any) -> None:
    """Every field equal, arrays bit for bit (NaN included) and of the same type."""
    assert isinstance(ours, type(other))
    for name in other.__dataclass_fields__:
        a, b = getattr(ours, name), getattr(other, name)
        if isinstance(a, np.ndarray):
            assert a.dtype == b.dtype
            np.testing.assert_array_equal(a, b, err_msg=name)
        else:
            assert a == b, name


def test_transfer_and_compliance_round_trip(tmp_path: Path) -> None:
    file = tmp_path / "new" / "transfer.nc"
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        io.write_transfer(file, transfer(), compliance())
        same(io.read_transfer(file), transfer())
        same(io.read_compliance(file), compliance())
    assert [p.name for p in file.parent.iterdir()] == ["transfer.nc"]


def test_errors_of_pairs_come_back_in_single_precision_and_alone_for_the_source_that_has_them(tmp_path: Path) -> None:
    g = transfer()
    shape = (2, *g.values.shape[1:])
    pairs = np.random.default_rng(0).random(shape)
    apart = ErrorEstimate("discretisation", 0.05, "two meshes", (20.0, 300.0), (0.02, 0.1), pairs, pairs * (1 - 2j))
    io.write_transfer(tmp_path / "g.nc", replace(g, errors=(*g.errors, apart)))
    *others, found = io.read_transfer(tmp_path / "g.nc").errors
    assert tuple(others) == g.errors
    assert all(e.per_pair is None for e in others)
    assert found == apart
    assert found.per_pair == pytest.approx(pairs, rel=6e-8)  # half a unit in the last place of single precision
    assert found.together == pytest.approx(pairs * (1 - 2j), rel=2e-7)


def test_optional_parts_stay_absent(tmp_path: Path) -> None:
    bare = replace(transfer(), contacts=None, valid=None, deviation=None, errors=(), provenance={}, unit="m/N")
    io.write_transfer(tmp_path / "g.nc", bare)
    same(io.read_transfer(tmp_path / "g.nc"), bare)
    with pytest.raises(DataError, match=r"g\.nc: .*no compliance"):
        io.read_compliance(tmp_path / "g.nc")


def test_compliance_alone(tmp_path: Path) -> None:
    one = compliance(np.array([100.0]))
    save(tmp_path / "c.nc", io.TransferFile(None, one))
    same(io.read_compliance(tmp_path / "c.nc"), one)
    with pytest.raises(DataError, match=r"c\.nc: .*no G"):
        io.read_transfer(tmp_path / "c.nc")


def test_layout_for_other_readers(tmp_path: Path) -> None:
    file = tmp_path / "transfer.nc"
    io.write_transfer(file, transfer(), compliance())
    dataset = xr.load_dataset(file, engine="h5netcdf")
    assert dataset["G"].dims == ("frequency", "output", "input")
    assert dataset["G"].dtype == np.complex128
    assert dataset["G"].attrs["units"] == "m/V"
    assert dataset["frequency"].attrs["units"] == "Hz"
    assert dataset["output_position"].attrs["units"] == "m"
    assert dataset["compliance"].attrs["units"] == "m/N"
    assert dataset.attrs["time_convention"] == "e^{+i omega t}"
    at_100 = dataset["G"].sel(frequency=100.0, output="5", input="A2").item()
    assert at_100 == transfer().values[180, 4, 1]
    with h5py.File(file) as plain:  # no xarray, no h5netcdf
        np.testing.assert_array_equal(plain["G"][:], transfer().values)
        assert plain["G"].fletcher32
        assert plain["output"][4].tobytes() == b"5"


def test_different_frequencies_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="different frequencies"):
        io.write_transfer(tmp_path / "x.nc", transfer(), compliance(BINS[:5]))


def signals() -> io.Signals:
    values = np.random.default_rng(0).normal(size=(3, 2, 4, 50))
    values[0, 0, 0] = np.nan
    methods = ("inverse filter", "funneling", "combination")
    time = np.arange(50) * 1e-4 - 1e-3
    return io.Signals(values, methods, ("1", "5"), ("A1", "A2", "A3", "A4"), time, "V", np.eye(4)[:, :3], {"a": 1})


@pytest.mark.parametrize(
    ("write", "read", "dims"),
    [
        (io.write_drives, io.read_drives, ("method", "target", "actuator", "time")),
        (io.write_displacements, io.read_displacements, ("method", "target", "point", "time")),
    ],
)
def test_signals_round_trip(tmp_path: Path, write: Callable, read: Callable, dims: tuple[str, ...]) -> None:
    for s in (signals(), replace(signals(), positions=None)):
        write(tmp_path / "s.nc", s)
        same(read(tmp_path / "s.nc"), s)
    stored = xr.load_dataset(tmp_path / "s.nc", engine="h5netcdf")
    assert next(v for v in stored.data_vars.values() if v.ndim == 4).dims == dims


def test_signals_of_another_kind_or_shape_are_refused(tmp_path: Path) -> None:
    io.write_drives(tmp_path / "drives.nc", signals())
    with pytest.raises(DataError, match=r"drives\.nc: holds drives, expected displacements"):
        io.read_displacements(tmp_path / "drives.nc")
    with pytest.raises(DataError, match="labels say"):
        io.write_drives(tmp_path / "x.nc", replace(signals(), methods=("a",)))


def test_stack_orders_results_and_names_gaps() -> None:
    results = {(m, t): np.full((2, 5), i + 10.0 * j) for i, m in enumerate("ab") for j, t in enumerate("xyz")}
    stacked = io.stack(results, ("A1", "A2"), np.arange(5.0), "V")
    assert stacked.values.shape == (2, 3, 2, 5)
    assert stacked.values[1, 2, 0, 0] == 21.0
    del results["b", "y"]
    with pytest.raises(DataError, match="'b' at target 'y'"):
        io.stack(results, ("A1", "A2"), np.arange(5.0), "V")


def test_matlab_export_is_the_thesis_array(tmp_path: Path) -> None:
    file = tmp_path / "G.mat"
    g = replace(transfer(), valid=None)
    files.write_thesis_mat(file, g)
    content = loadmat(file)
    full = content["G"]
    assert full.shape == (9, 4, 20000)
    assert full.dtype == np.complex128
    np.testing.assert_array_equal(full[:, :, 20:1001], np.moveaxis(g.values, 0, 2))
    np.testing.assert_array_equal(full[:, :, 1:], full[:, :, :0:-1].conj())  # Hermitian, exactly
    assert np.count_nonzero(full[0, 0]) == 2 * 981
    assert np.abs(np.fft.ifft(full, axis=2).imag).max() < 1e-15 * np.abs(full).max()
    frequency = content["frequency_Hz"].ravel()
    assert frequency[[0, 20, 1000, -1]].tolist() == [0.0, 10.0, 500.0, 9999.5]
    np.testing.assert_array_equal(content["excited"].ravel() != 0, full[0, 0] != 0)
    np.testing.assert_array_equal(content["grid_positions_m"], [p.position for p in POINTS])
    np.testing.assert_array_equal(content["actuator_positions_m"], [p.position for p in CONTACTS])
    assert content["units"][0] == "m/V"
    assert content["sample_rate_Hz"].item() == 1e4


def test_matlab_round_trip(tmp_path: Path) -> None:
    g = transfer()
    files.write_thesis_mat(tmp_path / "G.mat", g)
    kept = replace(g, values=np.where(g.valid, g.values, 0), contacts=None, deviation=None)
    same(files.read_thesis_mat(tmp_path / "G.mat"), kept)


def test_matlab_keeps_the_last_bin_of_odd_records(tmp_path: Path) -> None:
    """Of 9 bins 1 to 4 are positive, and the band may reach to the last of them."""
    g = replace(transfer(np.arange(1.0, 5.0)), valid=None)
    files.write_thesis_mat(tmp_path / "G.mat", g, 9.0, 1.0)
    back = files.read_thesis_mat(tmp_path / "G.mat")
    np.testing.assert_array_equal(back.frequency, g.frequency)
    np.testing.assert_array_equal(back.values, g.values)


@pytest.mark.parametrize(
    ("frequency", "message"),
    [
        (10.25, r"10\.25 Hz is no multiple"),
        (5000.0, "between 0 and 5000 Hz"),
        (6000.0, "between 0 and 5000 Hz"),
    ],
)
def test_matlab_refuses_frequencies_off_its_bins(tmp_path: Path, frequency: float, message: str) -> None:
    with pytest.raises(DataError, match=message):
        files.write_thesis_mat(tmp_path / "G.mat", transfer(np.array([5.0, frequency])))
    assert not list(tmp_path.iterdir())


def test_signal_strength_csv(tmp_path: Path) -> None:
    values = np.array([[1 / 3, 1.31, np.inf], [0.63, 1e-17, 2.0]])
    low, high, record = (np.repeat([[s], [s + 0.3]], 3, axis=1) for s in (0.3, 0.4, 0.5))
    beside = ((low, high), record, (-0.1, 0.2))
    rows = io.strength_rows(("inverse filter", "funneling"), ("5", "1", "8"), values, *beside)
    file = tmp_path / "signal_strength.csv"
    io.write_signal_strength_csv(file, rows)
    lines = file.read_text().splitlines()
    assert lines[:3] == [
        "target,group,method,S,S_low,S_high,S_record,window",
        "5,middle,inverse filter,0.3333333333333333,0.3,0.4,0.5,-0.1 to 0.2 s",
        "5,middle,funneling,0.63,0.6,0.7,0.8,-0.1 to 0.2 s",
    ]
    assert [r.group for r in rows] == ["middle"] * 2 + ["corners"] * 2 + ["edges"] * 2
    assert io.read_signal_strength_csv(file) == rows
    assert b"\r" not in file.read_bytes()


@pytest.mark.parametrize(
    "text", ["", "target,S\n", "target,group,method,S\n5,middle,x\n", "target,group,method,S\n5,,x,y\n"]
)
def test_bad_csv_is_a_data_error(tmp_path: Path, text: str) -> None:
    file = tmp_path / "s.csv"
    file.write_text(text)
    with pytest.raises(DataError, match=r"s\.csv"):
        io.read_signal_strength_csv(file)


READERS = {
    "transfer.nc": (
        lambda p: io.write_transfer(p, transfer(BINS[:40]), compliance(BINS[:40])),
        io.read_transfer,
    ),
    "drives.nc": (lambda p: io.write_drives(p, signals()), io.read_drives),
    "G.mat": (lambda p: files.write_thesis_mat(p, transfer(BINS[:40])), files.read_thesis_mat),
}


@pytest.mark.parametrize("name", READERS)
@pytest.mark.parametrize("kept", [0.0, 0.02, 0.5, 0.9, 0.999])
def test_truncated_files_are_named(tmp_path: Path, name: str, kept: float) -> None:
    write, read = READERS[name]
    file = tmp_path / name
    write(file)
    whole = file.read_bytes()
    file.write_bytes(whole[: int(kept * len(whole))])
    with pytest.raises(DataError, match=name) as failure:
        read(file)
    assert "\n" not in str(failure.value)


@pytest.mark.parametrize("name", READERS)
def test_missing_files_are_named(tmp_path: Path, name: str) -> None:
    with pytest.raises(DataError, match=f"{name}: no such file"):
        READERS[name][1](tmp_path / name)


def test_a_changed_byte_in_G_is_noticed(tmp_path: Path) -> None:
    file = tmp_path / "transfer.nc"
    io.write_transfer(file, transfer())
    content = bytearray(file.read_bytes())
    start = content.find(transfer().values.tobytes()[:64])
    assert start > 0
    content[start + 40] ^= 1
    file.write_bytes(bytes(content))
    with pytest.raises(DataError, match="damaged"):
        io.read_transfer(file)


def test_random_damage_never_escapes_as_another_error(tmp_path: Path) -> None:
    rng, file = np.random.default_rng(0), tmp_path / "drives.nc"
    io.write_drives(file, signals())
    whole = np.frombuffer(file.read_bytes(), dtype=np.uint8)
    for _ in range(40):
        damaged = whole.copy()
        damaged[rng.integers(len(whole), size=20)] = rng.integers(256, size=20)
        file.write_bytes(damaged.tobytes())
        with contextlib.suppress(DataError):  # any other failure, or a warning, is an error here
            io.read_drives(file)


def test_a_failed_write_leaves_the_old_file(tmp_path: Path) -> None:
    file = tmp_path / "a.txt"
    write_text(file, "old\n")
    with pytest.raises(RuntimeError, match="stop"):
        _write_half(file)
    assert file.read_text() == "old\n"
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]


def _write_half(file: Path) -> None:
    with atomic_path(file) as beside:
        beside.write_text("half")
        raise RuntimeError("stop")


def test_an_impossible_place_is_a_data_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match="cannot be written"):
        write_text(tmp_path / "file" / "a.txt", "x")
    with pytest.raises(DataError, match="cannot be written"):
        io.write_transfer(tmp_path / "file" / "a.nc", transfer(BINS[:2]))
