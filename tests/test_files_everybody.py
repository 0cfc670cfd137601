"""Files as labs, scanners and meshers really write them: read right, joined, or refused with the true reason."""

from __future__ import annotations

import shlex
import struct
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import pyvista
from bad_files import CORNERS, TETRA
from bad_meshes import NUMBERS, REST
from cli_runner import cli
from lab_files import tdms, uff
from scipy.io import savemat, wavfile
from test_measurement_scene import INPUTS, OUTPUTS, device_for, part, plan_for, wave_matrix

from forearm_fem import files
from forearm_fem.errors import AccuracyWarning, DataError, ForearmError, GeometryError, MeshError
from forearm_fem.files import Declaration, RecognitionWarning
from forearm_fem.geometry.device.layout import layout_of, planform_ports
from forearm_fem.geometry.mesh.files import read_quietly
from forearm_fem.geometry.mesh.quality import mesh_quality
from forearm_fem.geometry.user.meshes import user_mesh
from forearm_fem.geometry.user.surfaces import read_surfaces
from forearm_fem.geometry.user.triangles import read_triangles
from forearm_fem.measurement.calibrate import record
from forearm_fem.processes import _guarded
from forearm_fem.rendering.signals import filled_in
from forearm_fem.scenario import load_scenario, parse_scenario
from forearm_fem.store.text import text_of

PORTS = (OUTPUTS[:2], INPUTS[:2])
SAID = Declaration(unit="m/V", sign="+iwt", spectrum="one-sided")
G = part(wave_matrix(np.arange(20.0, 40.0)), 2, 2)


def rows(separator: str = ",", point: str = ".", header: bool = True) -> list[str]:
    head = [separator.join(["frequency_Hz", "output", "input", "real", "imag"])] if header else []
    return head + [
        separator.join([f"{f:g}", o.name, i.name, *(repr(float(v)).replace(".", point) for v in (g.real, g.imag))])
        for f, at in zip(G.frequency, G.values, strict=True)
        for o, line in zip(PORTS[0], at, strict=True) for i, g in zip(PORTS[1], line, strict=True)
    ]  # fmt: skip


def read(file: Path, said: Declaration = SAID) -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RecognitionWarning)
        return files.read(file, said, ports=PORTS)


TABLES = {
    "decimal commas": "\n".join(rows(";", ",")),
    "decimal commas, tabs": "\n".join(rows("\t", ",")),
    "a comma at each end": ",\n".join(rows()[:1]) + "\n" + ",\n".join(rows()[1:]) + ",",
    "sep=": "sep=;\n" + "\n".join(rows(";")),
    "quoted sep=": '"sep=;"\n' + "\n".join(rows(";")),
    "savetxt": "# " + "\n".join(rows()),
    "comments": "% by a lab\n! in May\n// twice\n# thrice\n" + "\n".join(rows()),
    "other names": "\n".join(rows()).replace("frequency_Hz", "Frequency (Hz)").replace("real,imag", "Re,Im"),
    "carriage returns": "\r".join(rows()),
}


@pytest.mark.parametrize("name", TABLES)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "cp1252"])
def test_tables_as_spreadsheets_and_programs_write_them(tmp_path, name, encoding):
    """Every digit of a double is in the table, so the values are the same to the last bit."""
    content = TABLES[name]
    if name == "comments":
        content = "# Maßstab µm\n" + content
    (tmp_path / "lab.csv").write_bytes(content.encode(encoding))
    assert np.array_equal(read(tmp_path / "lab.csv").values, G.values)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("\n".join(rows(",", ",")), "decimal commas cannot be told"),
        ("\n".join([*rows(";", ","), "50;1;A1;1.5;0"]), "has a decimal point, line 2"),
        ("\n".join(rows()).replace("frequency_Hz", "Frequency (kHz)"), "expected Hz"),
        ("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1234\n", "Git LFS pointer to 1234 bytes"),
        ("<!DOCTYPE html><html>", "is a web page"),
        ("", "is empty"),
        ("\0" * 100, "of nothing"),
    ],
)
def test_what_is_no_table_of_numbers_is_told_apart(tmp_path, text, said):
    (tmp_path / "lab.csv").write_text(text)
    with pytest.raises(DataError, match=said):
        read(tmp_path / "lab.csv")


def test_a_first_comment_of_json_says_what_a_declaration_says(tmp_path):
    """As our own tables say it; what it says need not be declared, and what it says wrongly is told with its line."""
    (tmp_path / "lab.csv").write_text('# {"unit": "mm/V", "sign": "+iwt", "lab": 3}\n' + "\n".join(rows()))
    back = read(tmp_path / "lab.csv", Declaration(spectrum="one-sided"))
    np.testing.assert_allclose(back.values, 1e-3 * G.values, rtol=1e-15)
    (tmp_path / "lab.csv").write_text("# {by hand}\n" + "\n".join(rows()))  # a comment like others
    assert np.array_equal(read(tmp_path / "lab.csv").values, G.values)
    (tmp_path / "lab.csv").write_text('# {"sign": "up"}\n' + "\n".join(rows()))
    with pytest.raises(DataError, match=r"lab\.csv, line 1: .*sign: input should be '\+iwt' or '-iwt', got 'up'"):
        read(tmp_path / "lab.csv")


def test_text_is_text_in_any_usual_encoding():
    for encoding in ("utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "cp1252"):
        assert text_of("Größe, µm\r\n1,2\n".encode(encoding)) == "Größe, µm\n1,2\n"


# ---------------------------------------------------------------- UFF
def one_uff(file: Path, *more: dict[str, Any]) -> Path:
    for changes in more or ({},):
        uff(file, part(G, 1, 1), **changes)
    return file


def test_a_direction_is_chosen_and_an_estimator_is_said(tmp_path):
    value = G.values[:, 0, 0]
    ports = (OUTPUTS[:1], INPUTS[:1])
    triaxial = one_uff(tmp_path / "t.uff", *({"rsp_dir": k, "data": k * value} for k in (1, 2, 3)))
    with pytest.raises(DataError, match="directions 1, 2, 3; add --declare \"direction=3\""):
        files.read(triaxial, SAID, ports=ports)
    for k in (1, 2, 3):
        back = files.read(triaxial, SAID.model_copy(update={"direction": k}), ports=ports)
        assert np.allclose(back.values[:, 0, 0], k * value, rtol=1e-10)  # 12 digits of ASCII
    two = one_uff(tmp_path / "h.uff", {"id1": "FRF H2", "data": 2 * value}, {"id1": "FRF H1"})
    with pytest.warns(RecognitionWarning, match="recognised as H1"):
        assert np.allclose(files.read(two, SAID, ports=ports).values[:, 0, 0], value, rtol=1e-10)
    h2 = files.read(two, SAID.model_copy(update={"estimator": "H2"}), ports=ports)
    assert np.allclose(h2.values[:, 0, 0], 2 * value, rtol=1e-10)


def test_marks_with_blanks_behind_them_begin_datasets(tmp_path):
    file = uff(tmp_path / "b.uff", G)
    file.write_text(file.read_text().replace("    -1\n", "    -1  \n"))
    assert np.allclose(read(file, Declaration(sign="+iwt")).values, G.values, rtol=1e-10)


def test_a_roving_hammer_is_reciprocity_and_of_forces_alone(tmp_path):
    """Sensors at the actuators, blows on the points: the transposed matrix, by force."""
    g, ports = part(wave_matrix(np.arange(20.0, 40.0)), 3, 2), (OUTPUTS[:3], INPUTS[:2])
    swapped = np.ascontiguousarray(g.values.transpose(0, 2, 1))
    turned = replace(g, values=swapped, outputs=OUTPUTS[:2], inputs=INPUTS[:3])
    file = uff(tmp_path / "r.uff", turned, orddenom_spec_data_type=13, orddenom_axis_units_lab="N")
    said = Declaration(sign="+iwt", roving="hammer")
    assert np.allclose(files.read(file, said, ports=ports).values, g.values, rtol=1e-10)
    with pytest.raises(DataError, match="reciprocity"):
        read(uff(tmp_path / "v.uff", turned), said)


# ---------------------------------------------------------------- joining
def entries(folder: Path, name: str) -> Path:
    folder.mkdir()
    for (o, a), (i, b) in np.ndindex(2, 2) and [((o, p), (i, q)) for o, p in enumerate(PORTS[0])
                                               for i, q in enumerate(PORTS[1])]:  # fmt: skip
        lines = [f"{f:g},{v.real!r},{v.imag!r}" for f, v in zip(G.frequency.tolist(), G.values[:, o, i].tolist(),
                                                                  strict=True)]  # fmt: skip
        file = folder / name.format(o=a.name, i=b.name)
        file.write_text("\n".join(["frequency_Hz,real,imag", *lines]) + "\n")
    return folder


@pytest.mark.parametrize("name", ["G_{o}_{i}.csv", "P0{o}-{i}.csv", "{i} point{o}.csv"])
def test_a_folder_of_one_file_per_entry_is_one_g(tmp_path, name):
    assert np.array_equal(read(entries(tmp_path / "lab", name)).values, G.values)


def test_files_are_joined_by_a_pattern_a_map_and_a_table(tmp_path):
    folder = entries(tmp_path / "lab", "run7_{o}x{i}.csv")
    said = SAID.model_copy(update={"pattern": "run7_{output}x{input}"})
    assert np.array_equal(read(folder, said).values, G.values)
    assert np.array_equal(read(tmp_path / "lab" / "*.csv", said).values, G.values)
    swapped = {"A1": "A2", "A2": "A1"}
    back = read(folder, said.model_copy(update={"actuators": swapped}))
    assert np.array_equal(back.values, G.values[:, :, ::-1])
    (tmp_path / "join.toml").write_text(
        'name = "lab"\n[join]\nfiles = "lab/*.csv"\n[join.entries]\n'
        + "\n".join(f'"run7_{o.name}x{i.name}.csv" = ["{o.name}", "{i.name}"]' for o in PORTS[0] for i in PORTS[1])
        + "\n[declaration]\nunit = 'm/V'\nsign = '+iwt'\nspectrum = 'one-sided'\n"
    )
    assert np.array_equal(files.read(tmp_path / "join.toml", ports=PORTS).values, G.values)


def test_an_entry_in_two_files_and_a_file_without_a_name_are_refused(tmp_path):
    folder = entries(tmp_path / "lab", "G_{o}_{i}.csv")
    (folder / "again_1_A1.csv").write_text((folder / "G_1_A1.csv").read_text())
    with pytest.raises(DataError, match=r"is in .* too; keep one"):
        read(folder)
    (folder / "again_1_A1.csv").rename(folder / "again.csv")
    with pytest.raises(DataError, match="its name does not tell its point and actuator"):
        read(folder)


def test_one_file_per_actuator_and_nodes_by_a_map(tmp_path):
    (tmp_path / "lab").mkdir()
    for i, port in enumerate(PORTS[1]):
        np.savez(tmp_path / "lab" / f"run_{port.name}.npz", H=G.values[:, :, i : i + 1], f=G.frequency)
    said = SAID.model_copy(update={"axes": ("frequency", "output", "input")})
    assert np.array_equal(read(tmp_path / "lab", said).values, G.values)
    file = tmp_path / "n.uff"
    for o, i in np.ndindex(2, 2):
        uff(file, part(replace(G, values=G.values[:, o:, i:], outputs=OUTPUTS[o:2], inputs=INPUTS[i:2]), 1, 1),
            rsp_node=101 + o, ref_node=7 - i)  # fmt: skip
    mapped = Declaration(sign="+iwt", points={"101": "1", "102": "2"}, actuators={"7": "A1", "6": "A2"})
    assert np.allclose(read(file, mapped).values, G.values, rtol=1e-10)
    with pytest.raises(DataError, match="points maps '103', which the file does not have"):
        read(file, mapped.model_copy(update={"points": {"101": "1", "103": "2"}}))


# ---------------------------------------------------------------- arrays
@pytest.mark.filterwarnings("ignore::forearm_fem.files.declaration.RecognitionWarning")
def test_arrays_of_numpy_and_hdf5(tmp_path):
    axes = SAID.model_copy(update={"axes": ("frequency", "output", "input")})
    np.savez(tmp_path / "g.npz", G=G.values, frequency=G.frequency, pickled=np.array([{}], dtype=object))
    np.save(tmp_path / "g.npy", G.values)
    np.save(tmp_path / "f.npy", G.frequency)
    with h5py.File(tmp_path / "g.h5", "w") as file:
        file["lab/H_re"], file["lab/H_im"], file["lab/freq"] = G.values.real, G.values.imag, G.frequency
    split = {"variable": "lab/H_re", "imaginary_variable": "lab/H_im"}
    for name, more in (("g.npz", {}), ("g.npy", {"frequency_file": "f.npy"}), ("g.h5", split)):
        back = read(tmp_path / name, axes.model_copy(update=more))
        assert np.array_equal(back.values, G.values), name
        assert np.array_equal(back.frequency, G.frequency)
    np.save(tmp_path / "p.npy", np.array([{}], dtype=object))
    with pytest.raises(DataError, match="pickle"):
        read(tmp_path / "p.npy", axes)


def test_of_one_point_and_one_actuator_nothing_is_to_be_told(tmp_path):
    """A vector beside its frequencies, whatever the file is called; its two axes of length 1 are either way round."""
    ports = (OUTPUTS[:1], INPUTS[:1])
    savemat(tmp_path / "run.mat", {"Hf": G.values[:, 0, 0], "Coh": np.ones(20), "Freq_domain": G.frequency})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RecognitionWarning)
        assert np.array_equal(files.read(tmp_path / "run.mat", SAID, ports=ports).values[:, 0, 0], G.values[:, 0, 0])
    (tmp_path / "lab").mkdir()
    for port in INPUTS[:2]:
        np.savez(tmp_path / "lab" / f"{port.name}.npz", H=G.values[:, :1, :1], f=G.frequency)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RecognitionWarning)
        both = files.read(tmp_path / "lab", SAID, ports=(OUTPUTS[:1], INPUTS[:2]))
    assert both.valid is None


def test_responses_in_time_are_filled_up_with_zeros(tmp_path):
    """Zeros behind a response that has died away are more frequencies of the same transform."""
    h = np.random.default_rng(0).standard_normal((50, 2, 2))
    np.save(tmp_path / "h.npy", h)
    text = ('name = "h"\n[array]\nfiles = ["h.npy"]\nformat = "npy"\naxes = ["time", "output", "input"]\n'
            "[time]\nsample_rate = 100\nlength = 200\n[declaration]\nunit = 'm/N'\n")  # fmt: skip
    (tmp_path / "r.toml").write_text(text)
    g = files.read(tmp_path / "r.toml", ports=PORTS)
    by_hand = np.einsum("tf,toi->foi", np.exp(-2j * np.pi * np.outer(np.arange(50) / 100, g.frequency)), h)
    assert g.frequency[0] == 0.5
    assert np.allclose(g.values, by_hand, rtol=0, atol=1e-12 * np.abs(by_hand).max())  # rounding of 50 terms


# ---------------------------------------------------------------- raw sweeps
SCENE = part(wave_matrix(), 2, 2)
LAB = parse_scenario({
    "device": {"contacts": [[0.0, 0.0], [0.03, 0.0]]}, "grid": {"points": [[0.01, 0.0], [0.02, 0.0]]},
    "sweep": {"f_min": 10.0, "f_max": 500.0, "duration": plan_for(SCENE).sweep.duration,
              "sample_rate": plan_for(SCENE).sweep.sample_rate},
    "measurement": plan_for(SCENE).options.model_dump(mode="json", include={"sensor", "repeats", "estimator"}),
})  # fmt: skip


def sweeps(folder: Path, kind: str) -> Path:
    """A lab's folder of raw sweeps of each entry, as one kind of file."""
    folder.mkdir()
    plan = plan_for(SCENE)
    names = planform_ports(LAB)
    for o, i in np.ndindex(2, 2):
        device = device_for(SCENE)
        device.aim(SCENE.outputs[o].name)
        taken = record(plan, device, (o, i))
        drive, response = np.tile(taken.sent, len(taken.response)), taken.response.ravel()
        file = folder / f"P{names[0][o].name}_{names[1][i].name}.{kind}"
        step = 1 / taken.sample_rate
        if kind == "tdms":
            tdms(file, {"drive": drive, "laser": response}, taken.sample_rate)
        elif kind == "mat":
            clock = np.arange(len(drive))[:, None] * step
            savemat(file, {"t": clock, "drive": drive[:, None], "laser": response, "note": "x"})
        elif kind == "wav":
            wavfile.write(file, round(taken.sample_rate), np.column_stack([drive, response]))
        elif kind == "csv":
            lines = [f"{k * step:.9g};{a!r};{b!r}".replace(".", ",") for k, (a, b) in enumerate(
                zip(drive.tolist(), response.tolist(), strict=True))]  # fmt: skip
            file.write_text("\n".join(["time;drive;laser", *lines]) + "\n")
        else:
            lvm = ["LabVIEW Measurement\t", "Separator\tTab", "Decimal_Separator\t,", "X_Columns\tNo",
                   "***End_of_Header***\t", "Channels\t2", f"Samples\t{len(drive)}\t{len(drive)}",
                   "Y_Unit_Label\tVolts\tVolts", "X0\t0\t0", f"Delta_X\t{step}\t{step}", "***End_of_Header***\t\t",
                   "X_Value\tdrive\tlaser\tComment"]  # fmt: skip
            lvm += [f"\t{a!r}\t{b!r}\t{'moved' * (k == 3)}".replace(".", ",") for k, (a, b) in enumerate(
                zip(drive.tolist(), response.tolist(), strict=True))]  # fmt: skip
            file.write_text("\n".join(lvm) + "\n")
    return folder


@pytest.mark.parametrize("kind", ["tdms", "wav", "csv", "lvm", "mat"])
def test_a_folder_of_raw_sweeps_becomes_its_g(tmp_path, kind):
    """The virtual lab's own G, which the sweeps were played through; without noise an estimator is exact to rounding
    of the file's digits."""
    channels = {"tdms": ("sweep/drive", "sweep/laser"), "wav": ("1", "2")}.get(kind, ("drive", "laser"))
    said = Declaration(drive=channels[0], response=channels[1])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RecognitionWarning)
        g = files.read(sweeps(tmp_path / "lab", kind), said, scenario=LAB)
    truth = SCENE.values[np.isin(np.round(SCENE.frequency, 6), np.round(g.frequency, 6))]
    known = g.valid
    assert known.mean() > 0.9
    assert np.abs(g.values - truth)[known].max() < 2e-3 * np.abs(truth).max()  # the virtual converter has 16 bits
    # the repeats are alike to the bit, so that only the converter's step, told from the samples, can state this error
    assert np.all(np.abs(g.values - truth)[known] < 5 * g.deviation[known])


def test_sweeps_in_newtons_and_millimetres_a_second_need_no_sensor(tmp_path):
    """The same sweeps scaled by the lab: what a volt means is then the file's; a force makes m/N of m/V."""
    sensor = LAB.measurement.sensor
    assert sensor.quantity == "velocity"
    volts, scaled = sweeps(tmp_path / "volts", "tdms"), tmp_path / "scaled"
    scaled.mkdir()
    for file in volts.iterdir():
        channels = {c.split("/")[1]: w.samples for c, w in files.sweeps.waveforms(file, Declaration()).items()}
        clock = np.arange(len(channels["drive"])) / LAB.sweep.sample_rate
        columns = np.column_stack([clock, channels["drive"], channels["laser"] / sensor.sensitivity * 1e3])
        header = "time,force [N],laser (mm/s)"
        np.savetxt(scaled / f"{file.stem}.csv", columns, "%.17g", ",", header=header, comments="")
    bare = LAB.changed({"measurement.sensor.sensitivity": None, "measurement.sensor.quantity": None})
    said = Declaration(drive="sweep/drive", response="sweep/laser")
    own = Declaration(drive="force [N]", response="laser (mm/s)")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RecognitionWarning)
        expected, g = files.read(volts, said, scenario=LAB), files.read(scaled, own, scenario=bare)
        with pytest.raises(DataError, match="its response is velocity by its unit"):
            files.read(scaled, own, scenario=LAB.changed({"measurement.sensor.quantity": "displacement"}))
        with pytest.raises(DataError, match=r"'laser \(mm/s\)' is in 'mm/s', expected volts or newtons"):
            files.read(scaled, own.model_copy(update={"drive": "laser (mm/s)"}), scenario=bare)
    assert (expected.unit, g.unit) == ("m/V", "m/N")
    assert np.allclose(g.values, expected.values, rtol=1e-9, equal_nan=True)  # clocks are printed in 17 digits


def test_sweeps_that_begin_in_silence_say_so(tmp_path):
    n, step = 200, 1e-3
    tone = np.sin(2 * np.pi * np.arange(n) * 5 / n)
    file = tdms(tmp_path / "s.tdms", {"ao ": np.r_[np.zeros(n), tone, tone], "ai": np.ones(3 * n)}, 1 / step)
    names = {"drive": "sweep/ao", "response": "sweep/ai", "output": "1", "input": "A1", "period": n}
    with pytest.raises(DataError, match=r"silent in its first period of 200 samples; .*skip=0\.2"):
        files.read_sweep(file, **names)
    assert len(files.read_sweep(file, **names, skip=n * step).response) == 2


def test_sound_files_from_a_pipe_have_no_length(tmp_path):
    wavfile.write(tmp_path / "a.wav", 8000, np.arange(400, dtype=np.int16).reshape(-1, 2))
    content = bytearray((tmp_path / "a.wav").read_bytes())
    at = content.index(b"data") + 4
    for length in (0xFFFFFFFF, 0):
        content[at : at + 4] = struct.pack("<I", length)
        content[4:8] = struct.pack("<I", length)
        (tmp_path / "b.wav").write_bytes(content)
        signals, rate = files.wav.read_wav_drives(tmp_path / "b.wav", full_scale=1.0)
        assert (signals.shape, rate) == ((2, 200), 8000)


# ---------------------------------------------------------------- conversions
@pytest.mark.parametrize("kind", ["nc", "csv", "mat"])
def test_convert_there_and_back_changes_no_bit(tmp_path, kind):
    g = replace(G, valid=np.random.default_rng(0).random(G.values.shape) > 0.2, deviation=np.abs(G.values) / 9)
    g.save(tmp_path / "a.nc")
    assert cli("convert", "a.nc", f"b.{kind}", cwd=tmp_path).code == 0
    assert cli("convert", f"b.{kind}", "c.nc", cwd=tmp_path).code == 0
    back = files.read(tmp_path / "c.nc")
    for name in ("frequency", "values", "valid", "deviation"):
        assert np.array_equal(getattr(back, name), getattr(g, name)), name
    assert (back.outputs, back.inputs, back.unit) == (g.outputs, g.inputs, g.unit)


# ---------------------------------------------------------------- meshes
LIMB = {"shape": "mesh", "regions": {"1": "muscle", "2": "fat"}}


def taken(file: Path, **limb: Any) -> Any:
    rest = {**REST, "mesh": {"size_contact": 4e-3, "min_quality": 0.005}}
    scenario = parse_scenario({**rest, "limb": {**LIMB, "file": file.name, **limb}})
    return user_mesh(scenario.limb, file.parent, layout_of(scenario), 0.005, keep_bone=False)


def nastran(file: Path) -> None:
    text = [f"GRID    {k + 1:<8d}        {x:<8.5f}{y:<8.5f}{z:<8.5f}" for k, (x, y, z) in enumerate(CORNERS)]
    text += [f"CTETRA,{k + 1},{r},{','.join(str(c + 1) for c in cell)}" for k, (cell, r) in enumerate(
        zip(TETRA, NUMBERS, strict=True))]  # fmt: skip
    file.write_text("\n".join(line.rstrip() for line in text) + "\n")


def unv(file: Path) -> None:
    text = ["    -1", "  2411"]
    for k, p in enumerate(CORNERS):
        text += [f"{k + 1:10d}{1:10d}{1:10d}{11:10d}", "".join(f"{c:25.16E}".replace("E", "D") for c in p)]
    text += ["    -1", "    -1", "  2412"]
    for k, cell in enumerate(TETRA):
        text += [f"{k + 1:10d}{111:10d}{1:10d}{1:10d}{7:10d}{4:10d}", "".join(f"{c + 1:10d}" for c in cell)]
    text += ["    -1", "    -1", "  2467"]
    for number, name in ((1, "1"), (2, "2")):
        members = np.flatnonzero(number == NUMBERS) + 1
        text += [f"{number:10d}" + f"{0:10d}" * 6 + f"{len(members):10d}", name]
        pairs = [members[k : k + 2] for k in range(0, len(members), 2)]
        text += ["".join(f"{8:10d}{m:10d}{0:10d}{0:10d}" for m in pair) for pair in pairs]
    file.write_text("\n".join([*text, "    -1"]) + "\n")


def febio(file: Path) -> None:
    nodes = "".join(f'<node id="{k + 1}">{",".join(map(repr, p))}</node>' for k, p in enumerate(CORNERS.tolist()))
    parts = "".join(
        f'<Elements type="tet4" name="{n}">' + "".join(
            f'<elem id="{k + 1}">{",".join(str(c + 1) for c in TETRA[k])}</elem>' for k in np.flatnonzero(n == NUMBERS)
        ) + "</Elements>" for n in (1, 2)
    )  # fmt: skip
    mesh = f"<Mesh><Nodes>{nodes}</Nodes>{parts}</Mesh>"
    file.write_text(f'<?xml version="1.0"?><febio_spec version="4.0">{mesh}</febio_spec>')


def xdmf(file: Path) -> None:
    """As FEniCSx writes a mesh and its tags: two grids, the second with its cells in another order."""
    order = np.random.default_rng(0).permutation(len(TETRA))
    with h5py.File(file.with_suffix(".h5"), "w") as content:
        content["x"], content["t"], content["u"], content["v"] = CORNERS, TETRA, TETRA[order], NUMBERS[order]
    item = '<DataItem Dimensions="{}" Format="HDF">limb.h5:/{}</DataItem>'

    def topology(name: str) -> str:
        n = len(TETRA)
        return (f'<Topology TopologyType="Tetrahedron" NumberOfElements="{n}" NodesPerElement="4">'
                f'{item.format(f"{n} 4", name)}</Topology>')  # fmt: skip

    geometry = f'<Geometry GeometryType="XYZ">{item.format(f"{len(CORNERS)} 3", "x")}</Geometry>'
    tags = f'<Attribute Name="cell_tags" Center="Cell">{item.format(f"{len(TETRA)} 1", "v")}</Attribute>'
    file.write_text(f'<?xml version="1.0"?><Xdmf><Domain><Grid Name="mesh">{topology("t")}{geometry}</Grid>'
                    f'<Grid Name="cell_tags">{topology("u")}{tags}</Grid></Domain></Xdmf>')  # fmt: skip


@pytest.mark.parametrize(("write", "name"), [(nastran, "limb.bdf"), (unv, "limb.unv"), (febio, "limb.feb"),
                                             (xdmf, "limb.xdmf")])  # fmt: skip
def test_meshes_of_other_programs_are_the_same_body(tmp_path, write, name):
    """A block of 80 x 80 x 20 mm, its upper half fat."""
    write(tmp_path / name)
    volume = 0.08 * 0.08 * 0.01
    # a small field of Nastran holds five decimals of a metre, and the corners lie on whole millimetres
    assert mesh_quality(taken(tmp_path / name)).volumes == pytest.approx({"muscle": volume, "fat": volume}, rel=1e-9)


def test_a_frame_that_nastran_states_is_applied_or_refused(tmp_path):
    nastran(tmp_path / "limb.bdf")
    plain = (tmp_path / "limb.bdf").read_text()
    moved = plain.replace("GRID    1               ", "GRID    1       5       ").split("\n")
    place = CORNERS[0]
    moved[0] = f"GRID,1,5,{place[1]:.5f},{-place[0]:.5f},{place[2]:.5f}"  # in a frame turned by a right angle about z
    frame = "CORD2R,5,,0.,0.,0.,0.,0.,1.,+\n+,0.,1.,0."
    (tmp_path / "limb.bdf").write_text("\n".join([*moved, frame]))
    volume = 0.08 * 0.08 * 0.01
    assert mesh_quality(taken(tmp_path / "limb.bdf")).volumes["fat"] == pytest.approx(volume, rel=1e-9)
    (tmp_path / "limb.bdf").write_text("\n".join([*moved, frame.replace("CORD2R", "CORD2C")]))
    with pytest.raises(MeshError, match="coordinate system 5, of the kind CORD2C"):
        taken(tmp_path / "limb.bdf")


BRICK = np.array([[0, 0, 0], [30, 0, 0], [0, 20, 0], [0, 0, 10], [30, 20, 10]], float)
HALVES = ((1, 2, 3, 4), (2, 4, 3, 5))  # 1000 mm3 and 2000 mm3


def test_instances_of_abaqus_stand_where_the_assembly_places_them(tmp_path):
    """One part twice, shifted, then turned about an axis that lies elsewhere; sets of the assembly, and in capitals."""
    nodes = "".join(f"{k}, {x}, {y}, {z}\n" for k, (x, y, z) in enumerate(BRICK.tolist(), start=1))
    cells = "".join(f"{k}, {', '.join(map(str, c))}\n" for k, c in enumerate(HALVES, start=1))
    (tmp_path / "two.inp").write_text(
        f"*HEADING\n*PART, NAME=Tissue\n*NODE\n{nodes}*ELEMENT, TYPE=C3D4, ELSET=all\n{cells}*ELSET, ELSET=First\n1,\n"
        "*END PART\n*ASSEMBLY, NAME=a\n*INSTANCE, NAME=near, PART=TISSUE\n*END INSTANCE\n"
        "*INSTANCE, NAME=far, PART=Tissue\n100., 0., 0.\n100., 50., 0., 100., 50., 7., 90.\n*END INSTANCE\n"
        "*NODE\n1, 9., 9., 9.\n*ELSET, ELSET=skin, INSTANCE=far\n2,\n*ELSET, ELSET=skin, INSTANCE=near\nfirst\n"
        "*ELSET, ELSET=both\nskin\n*END ASSEMBLY\n"
    )
    mesh = read_quietly(tmp_path / "two.inp")
    x, y, z = BRICK.T
    turned = np.column_stack([100 - (y - 50), 50 + x, z])  # by a right angle about (100, 50): (dx, dy) -> (-dy, dx)
    assert np.allclose(mesh.points, np.vstack([BRICK, turned]), atol=1e-12)
    found = {name: np.concatenate(list(members)).tolist() for name, members in mesh.cell_sets.items()}
    assert found == {"all": [0, 1, 2, 3], "First": [0, 2], "near": [0, 1], "far": [2, 3], "skin": [0, 3],
                     "both": [0, 3]}  # fmt: skip
    assert [c.tolist() for c in mesh.cells[0].data[2:]] == [[n + 4 for n in c] for c in HALVES]


def test_gmsh_in_binary_keeps_all_groups_of_a_volume(tmp_path):
    """Version 4.1 with two volumes, both in the group "all"; meshio alone keeps the first group."""
    four, box = struct.Struct("<i").pack, struct.pack("<6d", 0, 0, 0, 1, 1, 1)

    def many(*numbers: int) -> bytes:
        return struct.pack(f"<Q{len(numbers)}i", len(numbers), *numbers)

    def volume(number: int, *groups: int) -> bytes:
        return four(number) + box + many(*groups) + many(5)

    entities = struct.pack("<4Q", 1, 0, 1, 2) + four(1) + box[:24] + many() + four(5) + box + many(9) + many()
    entities += volume(1, 3, 1) + volume(2, 3, 2)
    counts, nodes = struct.Struct("<4Q").pack, np.arange(1, len(CORNERS) + 1)
    block = struct.pack("<3iQ", 3, 1, 0, len(nodes)) + nodes.astype("<u8").tobytes()
    block += CORNERS.astype("<f8").tobytes()
    cells, start = b"", 1
    for region in (1, 2):
        own = TETRA[region == NUMBERS] + 1
        rows = np.column_stack([np.arange(start, start + len(own)), own]).astype("<u8")
        cells, start = cells + struct.pack("<3iQ", 3, region, 4, len(own)) + rows.tobytes(), start + len(own)
    names = '4\n2 9 "skin"\n3 3 "all"\n3 1 "lower"\n3 2 "upper"\n'
    sections = {
        "MeshFormat": b"4.1 1 8\n" + four(1), "PhysicalNames": names.encode(), "Entities": entities,
        "Nodes": counts(1, len(nodes), 1, len(nodes)) + block, "Elements": counts(2, len(TETRA), 1, len(TETRA)) + cells,
    }  # fmt: skip
    (tmp_path / "limb.msh").write_bytes(b"".join(
        f"${k}\n".encode() + v + (b"" if k == "PhysicalNames" else b"\n") + f"$End{k}\n".encode()
        for k, v in sections.items()))  # fmt: skip
    found = taken(tmp_path / "limb.msh", regions={"lower": "muscle", "upper": "fat"})
    assert mesh_quality(found).volumes == pytest.approx({"muscle": 64e-6, "fat": 64e-6}, rel=1e-9)
    one = taken(tmp_path / "limb.msh", regions={"all": "muscle"})
    assert mesh_quality(one).volumes == pytest.approx({"muscle": 128e-6}, rel=1e-9)


def vtu(file: Path, **data: Any) -> Path:
    grid = pyvista.UnstructuredGrid({10: TETRA}, CORNERS)
    for name, values in data.items():
        grid.cell_data[name] = values
    grid.save(file)
    return file


def test_regions_by_an_array_by_its_name_and_one_tissue_for_all(tmp_path):
    file = vtu(tmp_path / "limb.vtu", MaterialIds=NUMBERS, other=NUMBERS[::-1].copy())
    for limb in ({"region_array": "MaterialIds"},):
        assert mesh_quality(taken(file, **limb)).volumes == pytest.approx({"muscle": 64e-6, "fat": 64e-6}, rel=1e-9)
    with pytest.raises(MeshError, match="has no cell data 'x'"):
        taken(file, region_array="x")
    alone = vtu(tmp_path / "one.vtu", CellEntityIds=NUMBERS)
    with pytest.warns(AccuracyWarning, match="taken from the cell data 'CellEntityIds'"):
        taken(alone)
    bare = vtu(tmp_path / "bare.vtu")
    assert mesh_quality(taken(bare, regions={"*": "muscle"})).volumes == pytest.approx({"muscle": 128e-6}, rel=1e-9)
    named = taken(vtu(tmp_path / "rest.vtu", region=NUMBERS), regions={"2": "fat", "*": "muscle"})
    assert mesh_quality(named).volumes == pytest.approx({"muscle": 64e-6, "fat": 64e-6}, rel=1e-9)


VTK = b"# vtk DataFile Version 3.0\nx\nASCII\nDATASET UNSTRUCTURED_GRID\n"


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("limb.msh", b"$NOD\n1\n1 0 0 0\n$ENDNOD\n", "gmsh's version 1"),
        ("limb.msh", b'$MeshFormat\n2.0 0 8\n$EndMeshFormat\n$PhysicalNames\n1\n1 "fat"\n$EndPhysicalNames\n',
         "format 2.0, whose names have no dimension"),
        ("limb.stl", b"solid\nendsolid\n", "is a surface"),
        ("limb.step", b"ISO-10303-21;", "CAD"),
        ("limb.vtu", b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n", "Git LFS pointer"),
        ("limb.bdf", b"GRID,1,,x,0.,0.\n", "'x' in field 4"),
        ("limb.e", b"../meshes/limb.e\n", "a symbolic link that git wrote as text"),
        ("limb.g", b"facet 1 2 3\n", "'.g' is no kind of mesh that is known"),
        ("limb.msh", b"*HEADING\n*NODE\n1, 0., 0.\n*ELEMENT, TYPE=C3D8\n1,1,1,1,1,1,1,1,1\n", "of the type C3D8"),
        ("limb.vtk", VTK + b"POINTS 3 float\n0 0 0 1 0 0 0 1 0\nCELLS 1 4\n3 0 1 2\nCELL_TYPES 1\n7\n",
         "no tetrahedra, but lines or surfaces"),
        ("limb.vtk", VTK + b"POINTS 4 float\n0 0 0 1 0 0 0 1 0 0 0 1\nCELLS 1 5\n4 0 1 2 3\nCELL_TYPES 1\n71\n",
         "contains lagrange tetrahedron cells"),
    ],
)
def test_what_is_no_mesh_is_told_apart(tmp_path, name, content, said):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(MeshError, match=said):
        taken(tmp_path / name)


# ---------------------------------------------------------------- surfaces
BOX = pyvista.Box((-1, 1, -1, 1, -1, 1)).triangulate()
BOX_POINTS, BOX_FACES = np.asarray(BOX.points, float), np.asarray(BOX.faces).reshape(-1, 4)[:, 1:]


def solid(offset: float, end: str = "endsolid") -> str:
    lines = ["solid a"]
    for face in BOX_FACES:
        lines += ["facet normal 0 0 0", "outer loop"]
        lines += ["vertex {} {} {}".format(*(BOX_POINTS[k] + [offset, 0, 0])) for k in face]
        lines += ["endloop", "endfacet"]
    return "\n".join([*lines, end]) + "\n"


def test_every_solid_of_an_stl_file_counts(tmp_path):
    """The second bone vanished where its end was spelled otherwise; stray bytes around made all 'empty'."""
    for end in ("endsolid", "end solid a", ""):
        (tmp_path / "b.stl").write_text(solid(0, end) + solid(4, end))
        assert len(read_triangles(tmp_path / "b.stl")[1]) == 24
    header = b"solid exported by a scanner".ljust(80)
    record = b"".join(struct.pack("<12fH", *([0.0] * 3), *BOX_POINTS[f].ravel(), 0) for f in BOX_FACES)
    (tmp_path / "c.stl").write_bytes(header + struct.pack("<I", 12) + record + b"stray bytes")
    assert len(read_triangles(tmp_path / "c.stl")[1]) == 12
    (tmp_path / "d.stl").write_bytes(header + struct.pack("<I", 12) + record[:-50])
    with pytest.raises(GeometryError, match="says it holds 12 triangles, and has bytes of 11"):
        read_triangles(tmp_path / "d.stl")
    (tmp_path / "e.stl").write_text(solid(0)[:-300])
    with pytest.raises(GeometryError, match="cut short"):
        read_triangles(tmp_path / "e.stl")


def test_relative_indices_of_obj_count_back_from_where_they_stand(tmp_path):
    text = []
    for offset in (0, 4):
        text += [f"v {x + offset} {y} {z}" for x, y, z in BOX_POINTS.tolist()]
        text += ["f " + " ".join(str(int(k) - len(BOX_POINTS)) for k in face) for face in BOX_FACES]
    (tmp_path / "b.obj").write_text("\n".join(text))
    vertices, faces = read_triangles(tmp_path / "b.obj")
    a, b, c = vertices[faces].transpose(1, 0, 2)
    assert abs(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6) == pytest.approx(16)  # two boxes of 2 x 2 x 2


def test_surfaces_of_vtk(tmp_path):
    BOX.save(tmp_path / "b.vtp")
    assert len(read_triangles(tmp_path / "b.vtp")[1]) == 12


@pytest.mark.slow  # fTetWild
def test_a_few_crossing_triangles_are_repaired_and_said(tmp_path):
    ball = pyvista.Sphere(radius=0.03, theta_resolution=24, phi_resolution=24)
    points = np.array(ball.points, dtype=float)
    top = int(points[:, 2].argmax())
    far = np.linalg.norm(points - points[top], axis=1)
    ring = np.flatnonzero(np.abs(far - np.sort(far)[1]) < 1e-6)
    near = ring[np.argsort(np.arctan2(points[ring, 1], points[ring, 0]))][:2]  # neighbours, whatever rounding orders
    points[near] = points[near[::-1]]
    pyvista.PolyData(points, ball.faces).save(tmp_path / "skin.stl")
    limb = parse_scenario({**REST, "limb": {"shape": "surfaces", "surfaces": {"skin": "skin.stl"}}}).limb
    with pytest.warns(AccuracyWarning, match="which moved it by .* mm at most"):
        (found,) = read_surfaces(limb, tmp_path)
    assert found.volume == pytest.approx(4 / 3 * np.pi * 0.03**3, rel=0.03)  # 24 sides lack 2 %


# ---------------------------------------------------------------- doors
def test_a_script_without_a_guard_is_told_by_its_line(tmp_path):
    file = tmp_path / "s.py"
    file.write_text("import a\nrun()\nif __name__ == '__main__':\n    run()\n")
    assert [_guarded(file, line) for line in (2, 4)] == [False, True]


def test_a_path_with_backslashes_in_double_quotes_gets_the_cure(tmp_path):
    for path in (r"C:\Users\anna\arm.msh", r"C:\temp\new\arm.msh"):
        (tmp_path / "s.toml").write_text(f'[limb]\nshape = "mesh"\nfile = "{path}"\nregions = {{"1" = "skin"}}\n')
        with pytest.raises(ForearmError, match="write paths with /, or in single quotes"):
            load_scenario(tmp_path / "s.toml")


def test_frequencies_printed_in_six_digits_are_on_their_bins():
    """1 / 3 Hz of six digits are up to half a digit off; a spline between noisy samples would refuse them."""
    df = 1 / 3
    bins = np.arange(300, 900)
    printed = np.array([float(f"{k * df:.6g}") for k in bins])
    rng = np.random.default_rng(0)
    values = rng.standard_normal((len(bins), 1)) + 1j * rng.standard_normal((len(bins), 1))
    out, on = filled_in(printed / df, values, np.ones(values.shape, bool), bins, df)
    assert on.all()
    assert np.array_equal(out, values)


# ---------------------------------------------------------------- extras
def exodus(file: Path, kind: str = "TETRA4") -> None:
    """Two blocks as Cubit writes them, with names."""
    netcdf = pytest.importorskip("netCDF4")
    with netcdf.Dataset(file, "w", format="NETCDF3_64BIT_OFFSET") as out:
        for name, size in (("num_nodes", len(CORNERS)), ("num_el_blk", 2), ("len_name", 33), ("four", 4)):
            out.createDimension(name, size)
        for k, axis in enumerate("xyz"):
            out.createVariable(f"coord{axis}", "f8", ("num_nodes",))[:] = CORNERS[:, k]
        out.createVariable("eb_prop1", "i4", ("num_el_blk",))[:] = [10, 20]
        names = out.createVariable("eb_names", "S1", ("num_el_blk", "len_name"))
        for k, name in enumerate(("lower", "upper")):
            names[k] = netcdf.stringtochar(np.array(name, dtype="S33"))
            cells = TETRA[k + 1 == NUMBERS]
            out.createDimension(f"n{k}", len(cells))
            block = out.createVariable(f"connect{k + 1}", "i4", (f"n{k}", "four"))
            block.elem_type = kind
            block[:] = cells + 1


@pytest.mark.parametrize(("kind", "said"), [("HEX8", "contains hex8 cells"), ("SHELL4", "only shell4")])
def test_blocks_of_exodus_that_are_no_tetrahedra_are_named(tmp_path, kind, said):
    exodus(tmp_path / "limb.g", kind)
    with pytest.raises(MeshError, match=said):
        taken(tmp_path / "limb.g")


@pytest.mark.parametrize("regions", [{"lower": "muscle", "upper": "fat"}, {"10": "muscle", "20": "fat"}])
def test_blocks_of_exodus_go_by_their_names_and_numbers(tmp_path, regions):
    exodus(tmp_path / "limb.e")
    found = mesh_quality(taken(tmp_path / "limb.e", regions=regions)).volumes
    assert found == pytest.approx({"muscle": 64e-6, "fat": 64e-6}, rel=1e-9)


@pytest.mark.filterwarnings("ignore")  # of sofar, on its own conventions
def test_sofa_is_read_through_sofar(tmp_path):
    """Impulse responses of two measurements (drives) at two receivers (points)."""
    sofar = pytest.importorskip("sofar")
    sofa = sofar.Sofa("GeneralFIR")
    h = np.random.default_rng(1).standard_normal((2, 2, 64))
    sofa.Data_IR, sofa.Data_SamplingRate = h, 1000.0
    sofa.ReceiverPosition, sofa.Data_Delay = np.zeros((2, 3)), np.zeros((1, 2))
    sofar.write_sofa(str(tmp_path / "g.sofa"), sofa)
    g = read(tmp_path / "g.sofa", Declaration(unit="m/V"))
    assert np.allclose(g.values, np.fft.rfft(h, axis=2)[:, :, 1:].transpose(2, 1, 0), rtol=1e-12)
    assert g.frequency[0] == 1000 / 64


def test_the_page_on_lab_files_runs_as_printed(tmp_path):
    """Its commands and its table, on small files of our own."""
    page = (Path(__file__).parents[1] / "docs" / "howto" / "lab_files.md").read_text(encoding="utf-8")
    lines = [line for line in page.splitlines() if line.startswith("forearm-fem convert")]
    assert len(lines) == 2
    (tmp_path / "lab.toml").write_text(
        'name = "lab"\n[device]\ncontacts = [[0.0, 0.0], [0.03, 0.0]]\n[grid]\npoints = [[0.01, 0.0], [0.02, 0.0]]\n'
    )
    entries(tmp_path / "lab", "G_{o}_{i}.csv")
    entries(tmp_path / "may", "run7_{o}x{i}.csv")
    for line in lines:
        answer = cli(*shlex.split(line)[1:], cwd=tmp_path)
        assert answer.code == 0, answer.err
        assert files.read(tmp_path / shlex.split(line)[3]).values.shape[1:] == (2, 2)
    (tmp_path / "may" / "run7_1xA1.csv").rename(tmp_path / "may" / "scan 3.csv")
    table = page.split("```toml")[1].split("```")[0]
    (tmp_path / "may.toml").write_text(table)
    answer = cli("convert", "may.toml", "may.nc", "--scenario", "lab.toml", cwd=tmp_path)
    assert answer.code == 0, answer.err
    assert files.read(tmp_path / "may.nc").valid.any(axis=0).sum() == 1


def test_noise_is_no_error_of_interpolation_and_what_is_sampled_too_seldom_is():
    """Smooth responses with noise of 3 %, and delays of which the samples see less than two a turn."""
    f = np.arange(50.0, 250.0)
    bins = np.arange(100, 499)
    rng = np.random.default_rng(0)
    noise = 0.03 * (rng.standard_normal(len(f)) + 1j * rng.standard_normal(len(f)))

    def filled(delay: float, noisy: bool) -> Any:
        values = np.exp(-2j * np.pi * f * delay) / (1 + (f / 100) ** 2) * (1 + noisy * noise)
        return filled_in(2 * f, values[:, None], np.ones((len(f), 1), bool), bins, 0.5)

    for noisy in (False, True):
        _, on = filled(0.01, noisy)
        assert on.all()
        for delay in (0.15, 0.3, 0.45):
            with pytest.raises(DataError, match=r"sweep\.duration = 1,"):
                filled(delay, noisy)
