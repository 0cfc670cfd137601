"""Files as a lab writes them: entries go where their names say, directions and units are the file's own words."""

from __future__ import annotations

import itertools
import warnings
from dataclasses import replace

import h5netcdf
import numpy as np
import pytest
import pyuff
from test_measurement_scene import INPUTS, OUTPUTS, wave_matrix

from forearm_fem import files
from forearm_fem.errors import AccuracyWarning, DataError
from forearm_fem.files.declaration import Declaration, RecognitionWarning

PORTS = (OUTPUTS, INPUTS)
SAID = Declaration(unit="m/V", sign="+iwt", spectrum="one-sided")
G = wave_matrix(np.arange(20.0, 30.0))
POINTS, ACTUATORS = ([p.name for p in ports] for ports in PORTS)
COLUMNS = ["frequency_Hz", "output", "input", "real", "imag"]


def lines(points=POINTS, actuators=ACTUATORS, separator=",") -> list[str]:
    """G as lines of a table, in the order of ``points`` and ``actuators``, which are names of G's ports."""
    rows = []
    for (k, f), o, i in itertools.product(enumerate(G.frequency), points, actuators):
        value = G.values[k, POINTS.index(o), ACTUATORS.index(i)]
        rows.append(separator.join([repr(float(f)), o, i, repr(float(value.real)), repr(float(value.imag))]))
    return [separator.join(COLUMNS), *rows]


def read(folder, rows, name="lab.csv"):
    (folder / name).write_text("\n".join(rows) + "\n")
    return files.read(folder / name, SAID, ports=PORTS)


@pytest.mark.parametrize("turn", ["points", "actuators", "lines"])
def test_a_table_is_read_by_its_names_whatever_the_order_of_its_lines(tmp_path, turn):
    points = POINTS[::-1] if turn == "points" else POINTS
    actuators = ACTUATORS[1:] + ACTUATORS[:1] if turn == "actuators" else ACTUATORS
    head, *rest = lines(points, actuators)
    back = read(tmp_path, [head, *(rest[::-1] if turn == "lines" else rest)])
    assert np.array_equal(back.values, G.values)  # every digit is in the table
    assert back.outputs == OUTPUTS


def test_a_point_that_was_not_measured_is_marked_and_the_others_stay_in_place(tmp_path):
    missing = 2
    back = read(tmp_path, lines([p for p in POINTS if p != POINTS[missing]]))
    there = np.arange(len(POINTS)) != missing
    assert np.array_equal(back.values[:, there], G.values[:, there])
    assert back.valid[:, there].all()
    assert not back.valid[:, missing].any()
    assert np.isnan(back.values[:, missing]).all()


def test_a_table_of_other_names_is_refused_with_both(tmp_path):
    rows = [r.replace(",A1,", ",left coil,") for r in lines()]
    with pytest.raises(DataError, match=r"names the inputs left coil, which are none of A1, "):
        read(tmp_path, rows)


@pytest.mark.parametrize(("separator", "name"), [("\t", "lab.tsv"), ("\t", "lab.txt"), (";", "lab.csv")])
def test_tables_of_tabs_and_semicolons_are_tables(tmp_path, separator, name):
    assert np.array_equal(read(tmp_path, lines(separator=separator), name).values, G.values)


def test_what_a_spreadsheet_adds_is_no_damage(tmp_path):
    """A mark of the byte order before the header, and empty lines at the end."""
    back = read(tmp_path, ["\ufeff" + lines()[0], *lines()[1:], "", ""])
    assert np.array_equal(back.values, G.values)


def test_an_infinite_entry_is_not_measured(tmp_path):
    rows = lines()
    rows[1] = ",".join([*rows[1].split(",")[:3], "inf", "0"])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        back = read(tmp_path, rows)
    assert not back.valid[0, 0, 0]
    assert back.valid.sum() == back.valid.size - 1


def test_a_page_under_the_name_of_a_table_is_one_sentence(tmp_path):
    (tmp_path / "page.csv").write_text('frequency_Hz,"' + "x" * 200_000)  # above the longest cell of Python's csv
    with pytest.raises(DataError, match="is no table"):
        files.read(tmp_path / "page.csv", SAID, ports=PORTS)


def uff(path, *, sense=lambda o, i: (3, 3), unit=lambda o, i: "m", nodes=None, axis=(18, "Hz")):
    """G as an analyser exports it: a node per point, one per actuator, directions and units as given for each, and the
    kind and unit of the abscissa."""
    nodes = nodes or (range(1, len(POINTS) + 1), range(1, len(ACTUATORS) + 1))
    for (o, node), (i, drive) in itertools.product(enumerate(nodes[0]), enumerate(nodes[1])):
        response, reference = sense(o, i)
        sign = -1 if response * reference < 0 else 1
        block = pyuff.prepare_58(
            binary=0, func_type=4, rsp_node=node, rsp_dir=response, ref_node=drive, ref_dir=reference,
            data=sign * G.values[:, o, i], x=G.frequency, num_pts=len(G.frequency), ord_data_type=6,
            abscissa_spacing=0, abscissa_min=0.0, abscissa_inc=0.0, abscissa_spec_data_type=axis[0],
            abscissa_axis_units_lab=axis[1], ordinate_spec_data_type=8, ordinate_axis_units_lab=unit(o, i),
            orddenom_spec_data_type=0, orddenom_axis_units_lab="V",
        )  # fmt: skip
        pyuff.UFF(str(path)).write_sets(block, mode="add")


DIGITS = 1e-11  # a universal file in ASCII holds 12


@pytest.mark.parametrize("directions", [(-3, 3), (3, -3), (-3, -3)])
def test_uff_of_a_sensor_that_points_the_other_way_is_turned(tmp_path, directions):
    """The second point's sensor alone: response and reference along -z both give what +z and +z give."""
    uff(tmp_path / "lab.uff", sense=lambda o, i: directions if o == 1 else (3, 3))
    back = files.read(tmp_path / "lab.uff", Declaration(sign="+iwt"), ports=PORTS)
    assert np.abs(back.values - G.values).max() < DIGITS * np.abs(G.values).max()


@pytest.mark.parametrize("axis", [(18, "kHz"), (18, "rad/s"), (17, "s"), (16, "rpm")])
def test_uff_over_anything_but_hertz_is_refused(tmp_path, axis):
    """Kilohertz, seconds and revolutions were read as Hz."""
    uff(tmp_path / "lab.uff", axis=axis)
    with pytest.raises(DataError, match=rf"is of kind {axis[0]} in '{axis[1]}', expected frequencies \(18\) in Hz"):
        files.read(tmp_path / "lab.uff", Declaration(sign="+iwt"), ports=PORTS)


def test_uff_of_functions_in_two_units_is_refused(tmp_path):
    uff(tmp_path / "lab.uff", unit=lambda o, i: "mm" if o == 1 else "m")
    with pytest.raises(DataError, match=r"different units \(1 <- 1 is displacement in \(m\)/V; 2 <- 1"):
        files.read(tmp_path / "lab.uff", Declaration(sign="+iwt"), ports=PORTS)


def test_uff_nodes_are_points_by_their_numbers_else_in_their_order_with_a_warning(tmp_path):
    n_out, n_in = len(POINTS), len(ACTUATORS)
    uff(tmp_path / "lab.uff", nodes=(range(101, 101 + n_out), range(1, 1 + n_in)))
    with pytest.warns(RecognitionWarning, match="101 as 1") as caught:
        back = files.read(tmp_path / "lab.uff", Declaration(sign="+iwt"), ports=PORTS)
    assert len(caught) == 1
    assert np.abs(back.values - G.values).max() < DIGITS * np.abs(G.values).max()


def test_axes_that_differ_by_rounding_are_one(tmp_path):
    """Two files put together: 10 + 2.3 and 12.3 Hz are one frequency, else every other row would lack every entry."""
    rows = lines()
    turned = [r.replace(r.partition(",")[0], repr(float(r.partition(",")[0]) * (1 + 1e-13)), 1) for r in rows[1:]]
    own = [t if r.split(",")[1] == POINTS[1] else r for t, r in zip(turned, rows[1:], strict=True)]
    assert own != rows[1:]
    back = read(tmp_path, [rows[0], *own])
    assert len(back.frequency) == len(G.frequency)
    assert back.valid.all()
    assert np.abs(back.values - G.values).max() < 1e-12 * np.abs(G.values).max()
    with pytest.raises(DataError, match=r"20\.0 and 20\.0000000000\d+ Hz are one frequency.*keep one of them"):
        read(tmp_path, [*rows, turned[0]])


def test_uff_functions_of_their_own_even_axes_meet_on_one(tmp_path):
    whole = 10.0 + 0.1 * np.arange(50)
    for node, x in ((1, whole), (2, 12.3 + 0.1 * np.arange(27))):
        block = pyuff.prepare_58(
            binary=0, func_type=4, rsp_node=node, rsp_dir=3, ref_node=1, ref_dir=3, data=x * (1 + 1j), x=x,
            num_pts=len(x), ord_data_type=6, abscissa_spacing=1, abscissa_min=x[0], abscissa_inc=0.1,
            abscissa_spec_data_type=18, ordinate_spec_data_type=8, ordinate_axis_units_lab="m",
            orddenom_spec_data_type=0, orddenom_axis_units_lab="V",
        )  # fmt: skip
        pyuff.UFF(str(tmp_path / "lab.uff")).write_sets(block, mode="add")
    back = files.read(tmp_path / "lab.uff", Declaration(sign="+iwt"), ports=(OUTPUTS[:2], INPUTS[:1]))
    assert np.allclose(back.frequency, whole, rtol=1e-9, atol=0)
    assert back.valid[:, :, 0].sum(axis=0).tolist() == [50, 27]
    assert np.allclose(back.values[23:, 1, 0], whole[23:] * (1 + 1j), rtol=1e-9)


@pytest.mark.parametrize("suffix", ["nc", "csv", "mat"])
def test_an_arbitrary_gain_stays_arbitrary_in_every_format(tmp_path, suffix):
    """Micrometres of such a G mean nothing: a file that forgets it states them."""
    rows = lines()
    (tmp_path / "lab.csv").write_text("\n".join(rows) + "\n")
    declared = SAID.model_copy(update={"arbitrary_gain": True})
    g = files.read(tmp_path / "lab.csv", declared, ports=PORTS)
    files.save(tmp_path / f"G.{suffix}", g)
    assert files.read(tmp_path / f"G.{suffix}").provenance["gain"] == "arbitrary"
    files.save(tmp_path / f"plain.{suffix}", replace(g, provenance={}))
    assert "gain" not in files.read(tmp_path / f"plain.{suffix}").provenance


def test_netcdf_of_another_program_is_said_to_be_one(tmp_path):
    with h5netcdf.File(tmp_path / "lab.nc", "w") as file:
        file.dimensions = {"frequency": 3}
        file.create_variable("H", ("frequency",), float, data=np.ones(3))
    for declared in (Declaration(), SAID):
        with pytest.raises(DataError, match="netCDF of another program"):
            files.read(tmp_path / "lab.nc", declared, ports=PORTS)


def test_blanks_and_columns_of_the_labs_own_are_left_out(tmp_path):
    head, *rest = lines(separator=" , ")
    rows = [f"{head} , remark", *(f"{r} , moved" for r in rest)]
    assert np.array_equal(read(tmp_path, rows).values, G.values)


def test_a_results_folder_stands_for_its_g(tmp_path):
    """As with every command that takes a G, also where a study file or a line of Python names it."""
    files.save(tmp_path / "transfer.nc", G)
    assert np.array_equal(files.read(tmp_path).values, G.values)
    (tmp_path / "empty").mkdir()
    with pytest.raises(DataError, match=r"empty: no transfer\.nc"):
        files.read(tmp_path / "empty")


def test_names_of_ours_keep_their_blanks(tmp_path):
    named = replace(G, inputs=tuple(replace(p, name=f" {p.name} ") for p in G.inputs))
    files.save(tmp_path / "ours.csv", named)
    assert files.read(tmp_path / "ours.csv").inputs == named.inputs
    for end in ("\nA", "\n", "\r"):
        broken = replace(G, inputs=tuple(replace(p, name=f"{p.name}{end}") for p in G.inputs))
        with pytest.raises(DataError, match="has a line break"):
            files.save(tmp_path / "broken.csv", broken)
    assert not (tmp_path / "broken.csv").exists()


@pytest.mark.parametrize(
    ("columns", "cells", "said"),
    [
        ("magnitude,phase_deg", "-96.2,10", "line 2: magnitude is -96.2, expected 0 or more in G's unit, not decibels"),
        ("magnitude,phase_deg,real,imag", "1,0,1,0", "has the columns real and imag and magnitude and phase_deg"),
        ("magnitude,phase_deg,phase_rad", "1,0,0", "has the columns magnitude and phase_rad and phase_deg"),
        ("real,imag,imag", "1,0,2", "has the columns imag twice"),
        ("real,imag,deviation", "1,0,-0.1", "line 2: deviation is -0.1, expected 0 or more"),
        ("real,imag,valid", "1,0,2", "line 2: valid is 2, expected 1 or 0"),
        ("real,imag,valid", "1,0,nan", "line 2: valid is nan, expected 1 or 0"),
    ],
)
def test_a_table_that_contradicts_itself_is_refused(tmp_path, columns, cells, said):
    """Decibels in `magnitude` were read as negative sizes, one of two pairs of columns was taken, a validity of 2 or
    NaN counted as valid."""
    with pytest.raises(DataError, match=said):
        read(tmp_path, [f"frequency_Hz,output,input,{columns}", f"20,{POINTS[0]},{ACTUATORS[0]},{cells}"])


def test_a_sentence_about_a_row_names_the_line_of_the_file(tmp_path):
    """Blank lines were left out and not counted, so that people looked at another row."""
    good, bad = (f"{f},{POINTS[0]},{ACTUATORS[0]},1,{cell}" for f, cell in ((20, "0"), (30, "x")))
    with pytest.raises(DataError, match="line 6: 'x' in column imag is no number"):
        read(tmp_path, ["", "frequency_Hz,output,input,real,imag", "", good, ",,,,", bad])


def test_names_that_a_spreadsheet_made_numbers_are_the_points_all_the_same(tmp_path):
    """1.0 is point 1; a table that has both is of two points, of which one is unknown."""
    head, *rest = lines()
    numbers = [",".join([f, f"{o}.0", *more]) for f, o, *more in (r.split(",") for r in rest)]
    assert np.array_equal(read(tmp_path, [head, *numbers]).values, G.values)
    with pytest.raises(DataError, match=r"names the outputs 1\.0, which are none of"):
        read(tmp_path, [head, *rest, numbers[0]])


def test_a_minus_one_among_the_fields_of_other_datasets_is_no_end_mark(tmp_path):
    """Datasets of nodes and units beside the functions are passed over."""
    uff(tmp_path / "lab.uff")
    others = ["    -1", "    15", "         1         0         0        -1  0.0  0.0  0.0", "    -1"]
    (tmp_path / "both.uff").write_text("\n".join(others) + "\n" + (tmp_path / "lab.uff").read_text())
    back = files.read(tmp_path / "both.uff", Declaration(sign="+iwt"), ports=PORTS)
    assert np.abs(back.values - G.values).max() < DIGITS * np.abs(G.values).max()


def test_a_g_without_a_phase_is_said_to_be_one(tmp_path):
    rows = [lines()[0]]
    for r in lines()[1:]:
        *place, real, imag = r.split(",")
        rows.append(",".join([*place, repr(abs(complex(float(real), float(imag)))), "0"]))
    with pytest.warns(AccuracyWarning, match="every value is real"):
        read(tmp_path, rows)


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"variable": "G"}, "variable has no effect on a table"),
        ({"sample_rate": 1e4}, "sample_rate has no effect on a table"),
    ],
)
def test_what_is_declared_of_a_table_and_changes_nothing_is_refused(tmp_path, more, said):
    (tmp_path / "lab.csv").write_text("\n".join(lines()) + "\n")
    with pytest.raises(DataError, match=said):
        files.read(tmp_path / "lab.csv", SAID.model_copy(update=more), ports=PORTS)


SPECTRA = """
name = "spectra"
[array]
files = ["g.npy"]
format = "npy"
shape = [10, 9, 4]
axes = ["frequency", "output", "input"]
[declaration]
unit = "m/V"
sign = "+iwt"
spectrum = "one-sided"
sample_rate = 58.0
band = [20.0, 29.0]
"""
IN_TIME = (
    SPECTRA.replace('"frequency", ', '"time", ').replace("sample_rate = 58.0\n", "")
    .replace("[declaration]", "[time]\nsample_rate = 100\n[declaration]")
)  # fmt: skip


def test_a_recipe_of_spectra_keeps_their_imaginary_part_and_takes_the_scenarios_places(tmp_path):
    """The parts were cut to real ones with a warning that nobody saw."""
    (tmp_path / "set.toml").write_text(SPECTRA.replace("[10, 9, 4]", "[30, 9, 4]"))
    np.save(tmp_path / "g.npy", np.concatenate([np.zeros((20, 9, 4)), G.values]))
    back = files.read(tmp_path / "set.toml", ports=PORTS)
    assert np.array_equal(back.values, G.values)
    assert back.outputs == OUTPUTS
    with pytest.raises(DataError, match="--scenario FILE"):
        files.read(tmp_path / "set.toml")


@pytest.mark.parametrize(
    ("text", "array", "said"),
    [
        (SPECTRA, np.moveaxis(G.values, 0, 2), r"has the shape \[9, 4, 10\], array\.shape says \[10, 9, 4\]"),
        (SPECTRA.replace('format = "npy"', 'format = "npy"\norder = "F"'), G.values, "order has no effect"),
        (SPECTRA.replace("[declaration]", "select = { output = [] }\n[declaration]"), G.values, r"select\.output"),
        (SPECTRA, np.full(G.values.shape, "x"), "holds no numbers"),
        (IN_TIME, G.values, "responses in time are complex"),
        (IN_TIME.replace("+iwt", "-iwt"), G.values.real, r"the file says sign = \+iwt"),
    ],
)  # fmt: skip
def test_recipes_that_say_something_else_than_their_files_are_one_sentence(tmp_path, text, array, said):
    (tmp_path / "set.toml").write_text(text)
    np.save(tmp_path / "g.npy", array)
    with pytest.raises(DataError, match=said):
        files.read(tmp_path / "set.toml", ports=PORTS)
