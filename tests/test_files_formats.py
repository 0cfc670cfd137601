"""Files of measured G: exact round trips, what other people's files need, recipes; parsers under random
input.
"""

from __future__ import annotations

import struct
import tomllib
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import pyuff
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from lab_files import mat5, mat73, sweep_tdms
from lab_files import uff as uff_of
from scipy.io import loadmat, savemat, wavfile
from test_measurement_scene import INPUTS, OUTPUTS, RATE, SWEEP, device_for, part, plan_for, wave_matrix

from forearm_fem import files
from forearm_fem.errors import DataError, ForearmError
from forearm_fem.files import read_sweep
from forearm_fem.files.declaration import Declaration, RecognitionWarning
from forearm_fem.files.recipe import ImportRecipe, import_by_recipe, load_recipe
from forearm_fem.files.tables import TableReader
from forearm_fem.files.wav import read_wav_drives
from forearm_fem.measurement.calibrate import record
from forearm_fem.rendering import from_samples_file, ricker
from forearm_fem.scenario.measurement import parse_unit
from forearm_fem.transfer import ErrorEstimate, TransferMatrix

PORTS = (OUTPUTS, INPUTS)
FOREIGN = Declaration(
    unit="m/V",
    spectrum="one-sided",
    sign="+iwt",
    variable="G",
    frequency_variable="frequency_Hz",
    axes=("output", "input", "frequency"),
)
SKINSOURCE = Path(__file__).parents[1].parent / "shared" / "data" / "skinsource"


def measured(masked: bool = True) -> TransferMatrix:
    """A G with awkward digits, a mask, NaN where masked, and a deviation that is unknown in places."""
    g = wave_matrix(np.arange(10.0, 60.1, 1 / 3))
    valid = np.random.default_rng(3).random(g.values.shape) > 0.1
    values = np.where(valid, g.values, np.nan) if masked else g.values
    deviation = np.where(valid, np.abs(g.values) / 7, np.nan)
    return replace(g, values=values, valid=valid if masked else None, deviation=deviation)


def outcome(call):
    """What ``call`` returns, or the sentence of the ForearmError that it raises; anything else is a
    failure.
    """
    try:
        return call()
    except ForearmError as problem:
        return str(problem)


@pytest.mark.parametrize("masked", [True, False])
@pytest.mark.parametrize("suffix", ["nc", "csv", "mat"])
def test_our_files_come_back_exactly_and_need_no_declaration(tmp_path, suffix, masked):
    errors = (
        ErrorEstimate("discretisation", 0.02, "two meshes", (20.0, 30.0), (0.01, 0.03)),
        ErrorEstimate("truncation", float("nan"), "no second mesh"),
    )
    g = replace(measured(masked), errors=errors)
    files.save(tmp_path / f"G.{suffix}", g)
    back = files.read(tmp_path / f"G.{suffix}")
    np.testing.assert_array_equal(back.frequency, g.frequency)
    known = np.ones(g.values.shape, dtype=bool) if g.valid is None else g.valid
    np.testing.assert_array_equal(back.values[known], g.values[known])
    np.testing.assert_array_equal(known, np.ones_like(known) if back.valid is None else back.valid)
    np.testing.assert_array_equal(back.deviation, g.deviation)
    assert (back.outputs, back.inputs, back.unit) == (g.outputs, g.inputs, g.unit)
    assert repr(back.errors) == repr(errors)  # NaN, which could not be estimated, is no zero
    assert sorted(p.name for p in tmp_path.iterdir()) == [f"G.{suffix}"]  # nothing left beside it


@pytest.mark.parametrize("write", [mat5, mat73])
@pytest.mark.parametrize(
    "axes",
    [("output", "input", "frequency"), ("frequency", "output", "input"), ("input", "frequency", "output")],
)
def test_matlab_in_any_order_of_axes(tmp_path, write, axes):
    g = measured()
    write(tmp_path / "G.mat", g, axes)
    declared = files.read(tmp_path / "G.mat", FOREIGN.model_copy(update={"axes": axes}), ports=PORTS)
    np.testing.assert_array_equal(declared.values, g.values)
    np.testing.assert_array_equal(declared.valid, g.valid)
    with pytest.warns(RecognitionWarning, match="axes of shape") as caught:
        recognised = files.read(tmp_path / "G.mat", FOREIGN.model_copy(update={"axes": None}), ports=PORTS)
    np.testing.assert_array_equal(recognised.values, g.values)
    assert caught[0].message.chosen == ", ".join(axes)


def test_matlab_mask_is_read_where_it_is_declared(tmp_path):
    g = replace(measured(), values=measured(masked=False).values)  # masked entries keep a finite value
    mat73(tmp_path / "G.mat", g)
    blind = files.read(tmp_path / "G.mat", FOREIGN, ports=PORTS)
    assert blind.valid is None
    told = files.read(tmp_path / "G.mat", FOREIGN.model_copy(update={"valid_variable": "valid"}), ports=PORTS)
    np.testing.assert_array_equal(told.valid, g.valid)
    with pytest.raises(DataError, match="has no mask"):
        files.read(tmp_path / "G.mat", FOREIGN.model_copy(update={"valid_variable": "ok"}), ports=PORTS)


def test_matlab_names_are_recognised_with_a_warning_each(tmp_path):
    values = np.ones((9, 4, 5)) * np.array([1, 2, 3, 4, 5]) + 0.5j
    savemat(tmp_path / "G.mat", {"H": values, "freq": np.arange(5.0) + 10})
    with pytest.warns(RecognitionWarning) as caught:
        g = files.read(tmp_path / "G.mat", Declaration(unit="mm/V", spectrum="one-sided", sign="+iwt"), ports=PORTS)
    assert {w.message.what for w in caught} == {"G", "frequency", "axes of shape (9, 4, 5)"}
    assert g.values[2, 0, 0] == pytest.approx(3e-3 + 0.5e-3j, rel=1e-15)


def test_two_sided_array_of_the_thesis_shape(tmp_path):
    """[9, 4, 20000] as the thesis stores it, without a frequency vector: bins from the declared rate."""
    g = wave_matrix(np.arange(20, 1001) * 0.5)
    both = np.zeros((9, 4, 20000), dtype=complex)
    both[:, :, 20:1001] = g.values.transpose(1, 2, 0)
    both[:, :, -np.arange(20, 1001)] = g.values.transpose(1, 2, 0).conj()
    savemat(tmp_path / "G.mat", {"G": both * 1e3 * 2j * np.pi})
    said = FOREIGN.model_copy(
        update={
            "frequency_variable": None,
            "sample_rate": 1e4,
            "spectrum": "two-sided",
            "unit": "mm/V",
            "band": (10.0, 500.0),
        }
    )
    with pytest.raises(DataError, match="conjugate mirror"):  # times 2 pi i it is no real system's response
        files.read(tmp_path / "G.mat", said, ports=PORTS)
    savemat(tmp_path / "G.mat", {"G": both * 1e3})
    back = files.read(tmp_path / "G.mat", said, ports=PORTS)
    assert back.frequency.tolist() == g.frequency.tolist()
    np.testing.assert_allclose(back.values, g.values, rtol=1e-15)
    wider = files.read(tmp_path / "G.mat", said.model_copy(update={"band": None}), ports=PORTS)
    assert wider.valid.any(axis=(1, 2)).sum() == 981  # the silent bins are marked, not believed


@pytest.mark.parametrize(("unit", "power"), [("(mm/s)/V", 1), ("m/s^2/V", 2), ("um/mV", 0)])
@pytest.mark.parametrize("sign", ["+iwt", "-iwt"])
def test_units_and_signs_end_as_displacement(tmp_path, unit, power, sign):
    g = wave_matrix(np.arange(10.0, 60.0))
    stored = g.values * (2j * np.pi * g.frequency[:, None, None]) ** power / parse_unit(unit).factor
    stored = stored if sign == "+iwt" else stored.conj()
    savemat(tmp_path / "G.mat", {"G": stored.transpose(1, 2, 0), "frequency_Hz": g.frequency})
    back = files.read(tmp_path / "G.mat", FOREIGN.model_copy(update={"unit": unit, "sign": sign}), ports=PORTS)
    np.testing.assert_allclose(back.values, g.values, rtol=1e-13)
    assert back.unit == "m/V"


@pytest.mark.parametrize(
    ("text", "factor", "quantity"),
    [
        ("m/V", 1, "displacement"),
        ("mm/V", 1e-3, "displacement"),
        ("µm/mV", 1e-3, "displacement"),
        ("(mm/s)/V", 1e-3, "velocity"),
        ("m/s/N", 1, "velocity"),
        ("m/s²/N", 1, "acceleration"),
        ("g/N", 9.80665, "acceleration"),
        ("mg/mN", 9.80665, "acceleration"),
        ("m/m", 1, "displacement"),
        ("nm/kN", 1e-12, "displacement"),
    ],
)
def test_units_as_people_write_them(text, factor, quantity):
    unit = parse_unit(text)
    assert unit.factor == pytest.approx(factor, rel=1e-12)
    assert unit.quantity == quantity


@given(st.text(max_size=12))
def test_any_other_unit_is_one_sentence(text):
    said = outcome(lambda: parse_unit(text))
    assert not isinstance(said, str) or "not a motion over a drive" in said


def test_foreign_uff_in_ascii_with_gaps_and_velocity(tmp_path):
    """As an analyser exports it: ASCII, mm/s per V by labels, entries with their own abscissae, no ports."""
    f = np.arange(10.0, 20.0)
    for node in (1, 2):
        x = f if node == 1 else f[2:]
        block = pyuff.prepare_58(
            binary=0,
            func_type=4,
            rsp_node=node,
            rsp_dir=3,
            ref_node=1,
            ref_dir=3,
            data=x * (1 + 1j),
            x=x,
            id1="laser",
            rsp_ent_name="NONE",
            ref_ent_name="NONE",
            abscissa_spacing=1,
            abscissa_spec_data_type=18,
            ordinate_spec_data_type=11,
            ordinate_axis_units_lab="mm/s",
            orddenom_spec_data_type=0,
            orddenom_axis_units_lab="V",
        )
        pyuff.UFF(str(tmp_path / "G.uff")).write_sets(block, mode="add")
    ports = (OUTPUTS[:2], INPUTS[:1])
    with pytest.raises(DataError, match="--declare \"sign="):
        files.read(tmp_path / "G.uff", ports=ports)
    g = files.read(tmp_path / "G.uff", Declaration(sign="+iwt"), ports=ports)
    assert g.valid[:, :, 0].sum(axis=0).tolist() == [10, 8]
    np.testing.assert_allclose(
        g.values[:, 0, 0], 1e-3 * f * (1 + 1j) / (2j * np.pi * f), rtol=1e-11
    )  # 12 digits of ASCII


def test_raw_sweeps_through_tdms(tmp_path):
    scene = part(wave_matrix(), 1, 1)
    taken = record(plan_for(scene), device_for(scene, noise=1e-4), (0, 0))
    sweep_tdms(tmp_path / "s.tdms", taken)
    back = read_sweep(
        tmp_path / "s.tdms",
        drive="sweep/drive",
        response="sweep/response",
        output="1",
        input="A1",
        period=SWEEP.n,
    )
    np.testing.assert_array_equal(back.response, taken.response)
    np.testing.assert_array_equal(back.sent, taken.sent)
    assert back.sample_rate == RATE


def test_wav_drives_are_exact(tmp_path):
    signals = np.random.default_rng(0).standard_normal((4, 500)) / 3
    wavfile.write(tmp_path / "d.wav", 10_000, signals.T)
    back, rate = read_wav_drives(tmp_path / "d.wav")
    np.testing.assert_array_equal(back, signals)
    assert rate == 1e4


@pytest.mark.parametrize(("dtype", "one"), [(np.int16, 16384), (np.int32, 2**30), (np.uint8, 192)])
def test_integer_wav_with_a_declared_full_scale(tmp_path, dtype, one):
    wavfile.write(tmp_path / "d.wav", 8000, np.full((10, 2), one, dtype=dtype))
    back, _ = read_wav_drives(tmp_path / "d.wav", full_scale=2.0)
    assert back.shape == (2, 10)
    assert np.all(back == 1.0)  # half of full scale


@pytest.mark.parametrize(("kind", "bits"), [(1, 24), (3, 32), (3, 64)])
def test_wav_of_other_programs_with_chunks_of_their_own(tmp_path, kind, bits):
    """Extensible headers, and chunks of peaks and dates, which were taken for damage; one that is cut short is not."""
    count, channels = 100, 3
    wanted = np.random.default_rng(0).integers(-100, 100, (count, channels)) / 128
    rate = 8000 * channels * bits // 8, channels * bits // 8
    guid = struct.pack("<H", kind) + b"\x00\x00\x00\x00\x10\x00\x80\x00\x00\xaa\x00\x38\x9b\x71"
    form = struct.pack("<HHIIHHHHI", 0xFFFE, channels, 8000, *rate, bits, 22, bits, 0) + guid
    if kind == 3:
        data = wanted.astype(f"<f{bits // 8}").tobytes()
    else:
        data = b"".join(int(v * 2**23).to_bytes(3, "little", signed=True) for v in wanted.ravel())
    chunks = [(b"fmt ", form), (b"PEAK", bytes(8 + 8 * channels)), (b"bext", bytes(602)), (b"data", data)]
    body = b"WAVE" + b"".join(name + struct.pack("<I", len(c)) + c for name, c in chunks)
    whole = b"RIFF" + struct.pack("<I", len(body)) + body
    (tmp_path / "d.wav").write_bytes(whole)
    scale = {"full_scale": 1.0} if kind == 1 else {}
    back, sampled = read_wav_drives(tmp_path / "d.wav", **scale)
    assert sampled == 8000
    assert np.array_equal(back, wanted.T)
    with pytest.raises(DataError, match=r"full.scale"):
        read_wav_drives(tmp_path / "d.wav", **({} if scale else {"full_scale": 1.0}))
    (tmp_path / "d.wav").write_bytes(whole[:-100])
    with pytest.raises(DataError, match="cut short"):
        read_wav_drives(tmp_path / "d.wav", **scale)


def test_a_wavelet_of_another_programs_wav_is_read_whole_or_not_at_all(tmp_path):
    wavfile.write(tmp_path / "w.wav", 10000, ricker(100.0, duration=0.2).samples)
    whole = (tmp_path / "w.wav").read_bytes()
    at = whole.index(b"data")
    more = whole[:at] + b"PEAK" + struct.pack("<I", 16) + bytes(16) + whole[at:]
    (tmp_path / "w.wav").write_bytes(more)
    assert from_samples_file(tmp_path / "w.wav").samples.max() == 1.0
    (tmp_path / "w.wav").write_bytes(more[:-400])
    with pytest.raises(DataError, match="cannot be read as WAV"):
        from_samples_file(tmp_path / "w.wav")


def test_a_type_that_no_element_of_matlab_has_is_one_sentence(tmp_path):
    """scipy ended the program there."""
    file = mat5(tmp_path / "G.mat", part(wave_matrix(np.arange(10.0, 30.0)), 2, 2)) or tmp_path / "G.mat"
    content = bytearray(file.read_bytes())
    at = content.index(struct.pack("<II", 9, 640))  # the first array's numbers
    content[at : at + 4] = struct.pack("<I", 17)
    file.write_bytes(content)
    with pytest.raises(DataError, match="damaged, cut short"):
        files.read(file, FOREIGN)


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    suffix=st.sampled_from(["csv", "uff", "tdms", "mat", "nc", "toml"]),
    at=st.floats(0, 1),
    junk=st.binary(min_size=1, max_size=40),
)
def test_a_mangled_file_is_one_sentence_or_still_right(tmp_path, suffix, at, junk):
    """Bytes overwritten anywhere: a ForearmError, or a G; never another exception, never a crash."""
    file = tmp_path / f"G.{suffix}"
    g = part(wave_matrix(np.arange(10.0, 30.0)), 2, 2)
    made = {
        "toml": lambda: file.write_text("name = 'x'\n"), "uff": lambda: uff_of(file, g), "mat": lambda: mat5(file, g),
        "tdms": lambda: sweep_tdms(file, record(plan_for(part(g, 1, 1)), device_for(part(g, 1, 1)), (0, 0))),
    }  # fmt: skip
    made.get(suffix, lambda: files.save(file, g))()
    content = bytearray(file.read_bytes())
    start = int(at * len(content))
    content[start : start + len(junk)] = junk
    file.write_bytes(content)
    declaration = FOREIGN if suffix == "mat" else None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RecognitionWarning)
        back = outcome(lambda: files.read(file, declaration, ports=(g.outputs, g.inputs)))
    assert back
    assert isinstance(back, str) or back.values.shape[1:] == (2, 2)


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    values=st.lists(st.complex_numbers(max_magnitude=1e300, allow_subnormal=True), min_size=3, max_size=3),
    suffix=st.sampled_from(["csv", "mat"]),
)
def test_any_number_survives_any_format(tmp_path, values, suffix):
    g = TransferMatrix(np.array([10.0, 11.1, 1e3]), np.array(values).reshape(3, 1, 1), OUTPUTS[:1], INPUTS[:1])
    g = replace(g, valid=np.ones((3, 1, 1), dtype=bool))
    file = tmp_path / f"G.{suffix}"
    files.save(file, g)
    stored = TableReader().raw(file, Declaration()).values if suffix == "csv" else files.read(file).values
    np.testing.assert_array_equal(stored.ravel(), np.array(values))


RECIPE = """
name = "impulse"
[array]
files = ["a.f32", "b.f32"]
shape = [64, 3, 2]
order = "F"
axes = ["time", "output", "direction"]
stack = "input"
select = {output = [3, 1], direction = [2]}
[time]
sample_rate = 1000.0
zero = 8
per_sample = false
[declaration]
unit = "m/s^2/N"
sign = "+iwt"
arbitrary_gain = true
band = [40.0, 400.0]
outputs = [{name = "1", position = [0, 0, 0]}, {name = "2", position = [0.01, 0, 0]}]
inputs = [{name = "A1", position = [0, 0.02, 0]}, {name = "A2", position = [0.01, 0.02, 0]}]
"""


def test_recipe_for_raw_impulse_responses(tmp_path):
    """Column-major files, one per input; a chosen order of sensors; time zero inside the record."""
    (tmp_path / "set.toml").write_text(RECIPE)
    arrays = np.random.default_rng(0).standard_normal((2, 64, 3, 2)).astype("<f4")
    for name, array in zip("ab", arrays, strict=True):
        (tmp_path / f"{name}.f32").write_bytes(array.tobytes(order="F"))
    g = import_by_recipe(load_recipe(tmp_path / "set.toml"), tmp_path)
    f = g.frequency
    assert f[0] >= 40
    assert f[-1] <= 400
    t = (np.arange(64) - 8) / 1000
    by_hand = np.exp(-2j * np.pi * f[:, None] * t) @ arrays[1, :, 2, 1] / 1000 / -((2 * np.pi * f) ** 2)
    np.testing.assert_allclose(g.values[:, 0, 1], by_hand, rtol=1e-6)  # single precision on disk
    assert g.unit == "m/N"
    assert g.provenance["gain"] == "arbitrary"
    again = files.read(tmp_path / "set.toml")
    np.testing.assert_array_equal(again.values, g.values)


def test_thesis_file_of_ours_needs_no_declaration(tmp_path):
    from forearm_fem.files.mat import write_thesis_mat

    g = wave_matrix(np.arange(10.0, 60.0, 0.5))
    write_thesis_mat(tmp_path / "G.mat", g)
    assert loadmat(tmp_path / "G.mat")["G"].shape == (9, 4, 20000)
    np.testing.assert_array_equal(files.read(tmp_path / "G.mat").values, g.values)
    with pytest.raises(DataError, match="describes itself"):
        files.read(tmp_path / "G.mat", Declaration(quantity="velocity"))


@pytest.mark.skipif(not SKINSOURCE.is_dir(), reason="no files of SkinSource in ../shared/data/skinsource")
def test_skinsource_by_the_recipe_in_the_docs():
    g = import_by_recipe(recipe_in_docs(), SKINSOURCE)
    assert g.values.shape == (961, 9, 4)
    files = [np.fromfile(SKINSOURCE / f"model-1-location-{k}.f32", "<f4") for k in (17, 18, 19, 20)]
    z = np.stack([f[522 * 72 * 2 :].reshape(72, 522)[[34, 25, 16, 33, 24, 15, 35, 26, 17]] for f in files])
    by_hand = np.fft.fft(z, n=2600, axis=2)[:, :, 40:1001].transpose(2, 1, 0)
    turn = np.exp(2j * np.pi * g.frequency * 65 / 1300) / -((2 * np.pi * g.frequency) ** 2)
    np.testing.assert_allclose(g.values, by_hand * turn[:, None, None], rtol=1e-5, atol=1e-12)
    assert 2.9 < np.linalg.cond(g.values).min() < np.linalg.cond(g.values).max() < 11.7


def recipe_in_docs():
    """The recipe as docs/howto/recipes.md prints it."""
    text = (Path(__file__).parents[1] / "docs" / "howto" / "recipes.md").read_text(encoding="utf-8")
    return ImportRecipe.model_validate(tomllib.loads(text.split("# recipe: skinsource")[1].split("```")[0]))


def test_recipe_in_the_docs_is_valid():
    assert recipe_in_docs().array.select["output"] == (35, 26, 17, 34, 25, 16, 36, 27, 18)
