"""Files of other programs that say a thing by halves: what was meant, or a sentence; never a wrong G without a word."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lab_files import uff as uff_of
from scipy.io import savemat
from scipy.sparse import csr_matrix

from forearm_fem import files, load_scenario
from forearm_fem.errors import AccuracyWarning, DataError
from forearm_fem.files import Declaration, read_sweep
from forearm_fem.geometry.device.layout import planform_ports
from forearm_fem.transfer import TransferMatrix

PORTS = planform_ports(load_scenario("quick"))
F = np.arange(20.0, 250.0, 5.0)
LATE = np.random.default_rng(5).uniform(2e-3, 2e-2, (9, 4))
G = 1e-6 * np.exp(-2j * np.pi * F[:, None, None] * LATE) / (1 + (F[:, None, None] / 100) ** 2)
SAID = Declaration(unit="m/V", sign="+iwt", spectrum="one-sided")


def table(file: Path, header: str, columns: Any, *, text: Any = repr) -> Path:
    """CSV of all entries: frequency, names, and what ``columns`` makes of a value."""
    lines = [
        ",".join([text(float(f)), str(o + 1), f"A{i + 1}", *(text(float(c)) for c in columns(G[k, o, i]))])
        for k, f in enumerate(F)
        for o, i in np.ndindex(9, 4)
    ]
    file.write_text("\n".join([f"frequency_Hz,output,input,{header}", *lines]) + "\n")
    return file


def uff(file: Path, values: Any = G, **changes: Any) -> Path:
    """G as UFF of another program."""
    return uff_of(file, TransferMatrix(F, values, *PORTS, unit="m/V"), **changes)


def of_sweep(unit: str | None = None) -> Declaration:
    return SAID.model_copy(update={"unit": unit})


def test_a_function_without_phase_among_others_is_said(tmp_path: Path):
    sizes = G.copy()
    sizes[:, 1, 1] = np.abs(sizes[:, 1, 1])
    with pytest.warns(AccuracyWarning, match="of 1 entries, of 2 <- A2 first, is real"):
        files.read(uff(tmp_path / "G.uff", values=sizes), of_sweep(), ports=PORTS)


def test_labels_of_a_unit_that_say_none_are_declared(tmp_path: Path):
    """Analysers write EU, or what was typed in; a unit that is declared as the file says it contradicts nothing."""
    other = uff(tmp_path / "G.uff", ordinate_axis_units_lab="EU")
    with pytest.raises(DataError, match='add --declare "unit'):
        files.read(other, of_sweep(), ports=PORTS)
    for file in (
        other,
        uff(tmp_path / "H.uff"),
        uff(tmp_path / "I.uff", orddenom_axis_units_lab="Volts"),
    ):
        read = files.read(file, SAID, ports=PORTS)
        assert read.unit == "m/V"
        assert np.abs(read.values - G).max() < 1e-11 * np.abs(G).max()  # digits of ASCII
    with pytest.raises(DataError, match="the file says unit"):
        files.read(uff(tmp_path / "J.uff"), of_sweep("mm/V"), ports=PORTS)


def test_a_rotation_is_no_displacement(tmp_path: Path):
    turned = uff(tmp_path / "G.uff", rsp_dir=6)
    with pytest.raises(DataError, match="is a rotation"):
        files.read(turned, of_sweep(), ports=PORTS)


@pytest.mark.filterwarnings("ignore::forearm_fem.files.declaration.RecognitionWarning")
def test_arrays_in_structures_and_cells_of_matlab_are_read(tmp_path: Path):
    cube = np.moveaxis(G, 0, 2)
    cell = np.empty((1, 2), dtype=object)
    cell[0, 0], cell[0, 1] = np.ones(3), cube
    for made, name in (({"frf": {"H": cube, "f": F}}, "frf.H"), ({"c": cell, "f": F}, "c{2}")):
        savemat(tmp_path / "G.mat", made)
        back = files.read(tmp_path / "G.mat", SAID, ports=PORTS)
        assert np.array_equal(back.values, G)
        assert back.provenance["variable"] == name


@pytest.mark.filterwarnings("ignore::forearm_fem.files.declaration.RecognitionWarning")
@pytest.mark.parametrize("kind", ["sparse", "flat"])
def test_a_matlab_file_without_a_plain_cube_says_so(tmp_path: Path, kind: str):
    cube = np.moveaxis(G, 0, 2)
    made = {"sparse": csr_matrix(cube.reshape(36, -1)), "flat": cube.reshape(36, -1)}[kind]
    savemat(tmp_path / "G.mat", {"g": made, "f": F})
    with pytest.raises(DataError, match=r"no plain array has three axes|has two axes"):
        files.read(tmp_path / "G.mat", SAID, ports=PORTS)


@pytest.mark.filterwarnings("ignore::forearm_fem.files.declaration.RecognitionWarning")
def test_kilohertz_are_asked_about(tmp_path: Path):
    savemat(tmp_path / "G.mat", {"G": np.moveaxis(G, 0, 2), "f": F / 1e3})
    with pytest.warns(AccuracyWarning, match="end at 0.245 Hz; if they are kilohertz"):
        files.read(tmp_path / "G.mat", SAID, ports=PORTS)


def polar(degrees: bool) -> Any:
    def columns(value: Any) -> Any:
        return abs(value), np.angle(value, deg=degrees)

    return columns


def test_degrees_for_radians_and_the_other_way_are_asked_about(tmp_path: Path):
    file = tmp_path / "G.csv"
    with pytest.warns(AccuracyWarning, match="if it is in degrees, name the column phase_deg"):
        files.read(table(file, "magnitude,phase_rad", polar(True)), SAID, ports=PORTS)
    with pytest.warns(AccuracyWarning, match="if that is in radians, name the column phase_rad"):
        files.read(table(file, "magnitude,phase_deg", polar(False)), SAID, ports=PORTS)


@pytest.mark.parametrize("phase", ["wrapped", "unwrapped", "degrees"])
def test_phases_that_are_what_their_column_says_are_read_without_a_word(tmp_path: Path, phase: str):
    file = table(
        tmp_path / "G.csv",
        "magnitude,phase_deg" if phase == "degrees" else "magnitude,phase_rad",
        polar(phase == "degrees"),
    )
    if phase == "unwrapped":
        rows = [line.split(",") for line in file.read_text().splitlines()]
        course = np.unwrap(np.array([float(r[4]) for r in rows[1:]]).reshape(len(F), 36), axis=0).ravel()
        file.write_text(
            "\n".join(
                ",".join([*r[:4], x]) for r, x in zip(rows, ["phase_rad", *map(repr, course.tolist())], strict=True)
            )
        )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert np.abs(files.read(file, SAID, ports=PORTS).values - G).max() < 1e-20


def test_the_line_that_is_wrong_is_the_files_own(tmp_path: Path):
    file = table(tmp_path / "G.csv", "real,imag", lambda v: (v.real, v.imag))
    lines = file.read_text().splitlines()
    lines[200] = lines[200].rpartition(",")[0] + ","
    file.write_text("\n".join(["", "# a lab", *lines[:10], "", "", *lines[10:]]) + "\n")
    with pytest.raises(DataError, match=r"line 205: column imag is empty; write nan"):
        files.read(file, SAID, ports=PORTS)


def test_whole_numbers_of_a_converter_are_no_volts(tmp_path: Path):
    nptdms = pytest.importorskip("nptdms")
    clock = {"wf_increment": 1e-4, "unit_string": "V"}
    drive = np.tile(np.sin(np.arange(1000) * 2 * np.pi / 200), 2)
    scale = {
        "NI_Number_Of_Scales": 1,
        "NI_Scaling_Status": "unscaled",
        "NI_Scale[0]_Scale_Type": "Linear",
        "NI_Scale[0]_Linear_Slope": 1e-4,
        "NI_Scale[0]_Linear_Y_Intercept": 0.1,
        "NI_Scale[0]_Linear_Input_Source": 0xFFFFFFFF,
    }
    counts = np.round((drive * 0.5 - 0.1) / 1e-4).astype(np.int16)
    names = {"drive": "s/ao", "response": "s/ai", "output": "1", "input": "A1", "period": 1000}
    for properties in (clock, {**clock, **scale}):
        with nptdms.TdmsWriter(str(tmp_path / "s.tdms")) as writer:
            channels = [("ao", drive, clock), ("ai", counts, properties)]
            writer.write_segment([nptdms.ChannelObject("s", n, a, properties=p) for n, a, p in channels])
        if properties is clock:
            with pytest.raises(DataError, match="no volts"):
                read_sweep(tmp_path / "s.tdms", **names)
        else:
            read = read_sweep(tmp_path / "s.tdms", **names)
            assert np.abs(read.response.ravel() - drive * 0.5).max() < 6e-5
