"""Damaged, truncated and mislabelled files, and bad recordings: the sentence each gets."""

from __future__ import annotations

import re
import sys
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from nptdms import ChannelObject, TdmsWriter
from scipy.io import savemat, wavfile

sys.path.insert(0, str(Path(__file__).parent))
from lab_files import mat73, uff
from test_measurement_scene import (
    INPUTS,
    OUTPUTS,
    RATE,
    SENSOR,
    SWEEP,
    collected,
    device_for,
    part,
    plan_for,
    wave_matrix,
)

from forearm_fem import files
from forearm_fem.errors import ForearmError
from forearm_fem.files import read_sweep
from forearm_fem.files.declaration import Declaration, RecognitionWarning
from forearm_fem.files.tables import write_csv
from forearm_fem.files.wav import read_wav_drives
from forearm_fem.measurement.calibrate import calibrate, record
from forearm_fem.measurement.diagnostics import diagnose
from forearm_fem.measurement.entry import entry
from forearm_fem.measurement.estimators import excited
from forearm_fem.measurement.playback import play
from forearm_fem.measurement.virtual import Faults, noise_for
from forearm_fem.results.files import write_transfer

PORTS = (OUTPUTS, INPUTS)
KNOWN = Declaration(unit="m/V", spectrum="one-sided", sign="+iwt", variable="G", frequency_variable="frequency_Hz")
AXES = ("output", "input", "frequency")
G = wave_matrix(np.arange(10.0, 100.5, 2.0))
SMALL = part(wave_matrix(), 1, 2)
BAND = excited(SWEEP.samples(), RATE, (10.0, 500.0), 0.02)

Case = Callable[[Path], str]
CASES: dict[str, tuple[Case, str]] = {}


def case(name: str, pattern: str) -> Callable[[Callable[[Path], object]], Callable[[Path], object]]:
    """Register ``make(tmp)``, which must raise a ForearmError or return findings, under ``name``."""

    def register(make: Callable[[Path], object]) -> Callable[[Path], object]:
        CASES[name] = (lambda tmp: sentence(make, tmp), pattern)
        return make

    return register


def sentence(make: Callable[[Path], object], tmp: Path) -> str:
    """What the user is told."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RecognitionWarning)
            found = make(tmp)
    except ForearmError as problem:
        return str(problem).replace(f"{tmp}/", "")
    assert isinstance(found, tuple), found
    assert found, "nothing was found"
    return str(found[0].sentence).replace(f"{tmp}/", "")


def cut(file: Path, share: float = 0.6) -> Path:
    content = file.read_bytes()
    file.write_bytes(content[: int(share * len(content))])
    return file


def mat(tmp: Path, **changes: object) -> Path:
    """A MATLAB 5 file of somebody else, with arrays replaced; None leaves one out."""
    content = {"G": np.transpose(G.values, (1, 2, 0)), "frequency_Hz": G.frequency, **changes}
    savemat(tmp / "G.mat", {k: v for k, v in content.items() if v is not None})
    return tmp / "G.mat"


def declared(**changes: object) -> Declaration:
    return KNOWN.model_copy(update={"axes": AXES, **changes})


def read(file: Path, declaration: Declaration | None = None) -> object:
    return files.read(file, declaration, ports=PORTS)


# ---------------------------------------------------------------- netCDF and MATLAB
@case("netCDF: missing", "no such file")
def _(tmp):
    return read(tmp / "G.nc")


@case("netCDF: cut short", "damaged")
def _(tmp):
    write_transfer(tmp / "G.nc", G)
    return read(cut(tmp / "G.nc"))


@case("netCDF: a flipped byte", "damaged")
def _(tmp):
    write_transfer(tmp / "G.nc", G)
    with h5py.File(tmp / "G.nc") as f:
        at = f["G"].id.get_chunk_info(0).byte_offset
    content = bytearray((tmp / "G.nc").read_bytes())
    content[at + 100] ^= 0xFF
    (tmp / "G.nc").write_bytes(content)
    return read(tmp / "G.nc")


@case("netCDF: declared by hand although it says all itself", "leave the declaration out")
def _(tmp):
    write_transfer(tmp / "G.nc", G)
    return read(tmp / "G.nc", KNOWN)


@case("MATLAB 5: cut short", "damaged")
def _(tmp):
    return read(cut(mat(tmp)), declared())


@case("MATLAB 7.3: cut short", "damaged")
def _(tmp):
    mat73(tmp / "G.mat", G)
    return read(cut(tmp / "G.mat"), declared())


@case("MATLAB: a text file with that name", "damaged|not a MATLAB")
def _(tmp):
    (tmp / "G.mat").write_text("G = [1 2 3]\n")
    return read(tmp / "G.mat", declared())


@case("MATLAB: G inside a structure", "it has result.G")
def _(tmp):
    savemat(tmp / "G.mat", {"result": {"G": np.ones((9, 4, 3))}})
    return read(tmp / "G.mat", declared())


@case("MATLAB: one- or two-sided not declared", "spectrum=")
def _(tmp):
    return read(mat(tmp), declared(spectrum=None))


@case("MATLAB: sign convention not declared", "sign=")
def _(tmp):
    return read(mat(tmp), declared(sign=None))


@case("MATLAB: unit not declared", "unit=")
def _(tmp):
    return read(mat(tmp), declared(unit=None))


@case("MATLAB: a velocity in metres", "cannot have the unit")
def _(tmp):
    return read(mat(tmp), declared(quantity="velocity"))


@case("any file: a unit that is none", "not a motion over a drive")
def _(tmp):
    return read(mat(tmp), declared(unit="dB re 1 um"))


@case("MATLAB: one-sided data declared two-sided", "not the conjugate mirror")
def _(tmp):
    return read(mat(tmp), declared(spectrum="two-sided"))


@case("MATLAB: two-sided data declared one-sided", "--declare \"spectrum='two-sided'\"")
def _(tmp):
    half = np.concatenate([np.ones((1, 9, 4)), G.values])
    both = np.concatenate([half, half[:0:-1].conj()])
    file = mat(tmp, G=np.transpose(both, (1, 2, 0)), frequency_Hz=np.arange(len(both)) * 2.0)
    return read(file, declared())


@case("MATLAB: axes that cannot be told apart", "axes=.*output")
def _(tmp):
    file = mat(tmp, G=np.ones((4, 4, 46)) + 0j)
    return files.read(file, declared(axes=None), ports=(OUTPUTS[:4], INPUTS))


@case("MATLAB: axes declared in the wrong order", "expected 9 and 4")
def _(tmp):
    return read(mat(tmp), declared(axes=("input", "output", "frequency")))


@case("MATLAB: two arrays could be G", "variable=.G")
def _(tmp):
    return read(mat(tmp, H=np.ones((9, 4, 46))), declared(variable=None))


@case("MATLAB: the variable named is not there", "has no array 'Gxy'")
def _(tmp):
    return read(mat(tmp), declared(variable="Gxy"))


@case("MATLAB: no frequency vector", "sample_rate=.*frequency_variable")
def _(tmp):
    return read(mat(tmp, frequency_Hz=None), declared(frequency_variable=None))


@case("MATLAB: frequency vector cut short", "40 frequencies for 46 matrices")
def _(tmp):
    return read(mat(tmp, frequency_Hz=G.frequency[:40]), declared())


@case("MATLAB: frequencies not sorted", "must be positive and increase")
def _(tmp):
    return read(mat(tmp, frequency_Hz=G.frequency[::-1]), declared())


@case("MATLAB: nothing but NaN", "holds no measurement")
def _(tmp):
    return read(mat(tmp, G=np.full((9, 4, 46), np.nan + 0j)), declared())


@case("MATLAB: band declared where there are no data", "no frequency lies in the declared band")
def _(tmp):
    return read(mat(tmp), declared(band=(200.0, 400.0)))


@case("any file: ports neither in the file nor declared", "--scenario FILE")
def _(tmp):
    return files.read(mat(tmp), declared())


@case("any file: unknown kind", "none of the known kinds")
def _(tmp):
    return read(tmp / "G.xyz")


# ---------------------------------------------------------------- UFF, TDMS, CSV, WAV, recipes
@case("UFF: cut short", "cut short")
def _(tmp):
    uff(tmp / "G.uff", G)
    return read(cut(tmp / "G.uff"))


@case("UFF: fewer values than its header says", "header says")
def _(tmp):
    uff(tmp / "G.uff", G)
    content = (tmp / "G.uff").read_bytes()
    (tmp / "G.uff").write_bytes(content.replace(b"%10i%10i" % (6, 46), b"%10d%10d" % (6, 99)))
    return read(tmp / "G.uff")


@case("UFF: no frequency response functions", "holds no frequency response")
def _(tmp):
    (tmp / "G.uff").write_text("    -1\n   151\nmodel\n    -1\n")
    return read(tmp / "G.uff")


@case("UFF: the same function twice", "occurs twice")
def _(tmp):
    uff(tmp / "G.uff", part(G, 1, 1))
    content = (tmp / "G.uff").read_bytes()
    (tmp / "G.uff").write_bytes(content + content)
    return read(tmp / "G.uff")


@case("TDMS: cut short", "damaged|cut short")
def _(tmp):
    return read(cut(sweep_tdms(tmp, ao=(4000, 5e-4), laser=(4000, 5e-4)), 0.9))


@case("TDMS: another kind of file", "not a TDMS file")
def _(tmp):
    (tmp / "G.tdms").write_bytes(b"RIFF" + bytes(100))
    return read(tmp / "G.tdms")


def sweep_tdms(tmp: Path, **channels: tuple[int, float]) -> Path:
    with TdmsWriter(str(tmp / "sweep.tdms")) as writer:
        parts = [
            ChannelObject("sweep", k, np.zeros(n), properties={"wf_increment": dt} if dt else {})
            for k, (n, dt) in channels.items()
        ]
        writer.write_segment(parts)
    return tmp / "sweep.tdms"


def sweep_of(file: Path, response: str = "sweep/laser", period: int = 1000) -> object:
    return read_sweep(file, drive="sweep/ao", response=response, output="1", input="A1", period=period)


@case("TDMS: a raw sweep read as G", "forearm-fem convert")
def _(tmp):
    return read(sweep_tdms(tmp, ao=(2000, 5e-4), laser=(2000, 5e-4)))


@case("TDMS sweep: channel not there", "has no channel 'sweep/ldv'")
def _(tmp):
    return sweep_of(sweep_tdms(tmp, ao=(2000, 5e-4), laser=(2000, 5e-4)), "sweep/ldv")


@case("TDMS sweep: no sample rate", "wf_increment")
def _(tmp):
    return sweep_of(sweep_tdms(tmp, ao=(2000, 5e-4), laser=(2000, 0.0)))


@case("TDMS sweep: two clocks", "on one clock")
def _(tmp):
    return sweep_of(sweep_tdms(tmp, ao=(2000, 5e-4), laser=(2000, 1e-4)))


@case("TDMS sweep: shorter than one sweep", "no whole period")
def _(tmp):
    return sweep_of(sweep_tdms(tmp, ao=(900, 5e-4), laser=(900, 5e-4)))


def written_sweep(tmp: Path, ao: np.ndarray, laser: np.ndarray, **of_laser: object) -> Path:
    with TdmsWriter(str(tmp / "sweep.tdms")) as writer:
        writer.write_segment([
            ChannelObject("sweep", "ao", ao, properties={"wf_increment": 5e-4}),
            ChannelObject("sweep", "laser", laser, properties={"wf_increment": 5e-4, **of_laser}),
        ])  # fmt: skip
    return tmp / "sweep.tdms"


@case("TDMS sweep: channels that begin apart", "turn every phase")
def _(tmp):
    return sweep_of(written_sweep(tmp, np.ones(2000), np.ones(2000), wf_start_offset=2e-3))


@case("TDMS sweep: a period that is not the drive's", "does not repeat itself every 1000 samples")
def _(tmp):
    drive = np.sin(2 * np.pi * np.arange(2000) / 999)
    return sweep_of(written_sweep(tmp, drive, np.ones(2000)))


@case("TDMS sweep: a channel in pascals", "expected volts")
def _(tmp):
    return sweep_of(written_sweep(tmp, np.ones(2000), np.ones(2000), unit_string="Pa"))


@case("TDMS sweep: cut short", "cut short")
def _(tmp):
    return sweep_of(cut(sweep_tdms(tmp, ao=(4000, 5e-4), laser=(4000, 5e-4)), 0.9))


@case("CSV: columns missing", "expected the columns")
def _(tmp):
    (tmp / "G.csv").write_text("f,G11\n10,1\n")
    return read(tmp / "G.csv")


@case("CSV: decimal commas", "line 2")
def _(tmp):
    (tmp / "G.csv").write_text('frequency_Hz,output,input,real,imag\n10,1,A1,"1,5",0\n')
    return read(tmp / "G.csv")


@case("CSV: cut in the middle of a line", "cut short")
def _(tmp):
    write_csv(tmp / "G.csv", G)
    text = (tmp / "G.csv").read_text()
    (tmp / "G.csv").write_text(text[: text.rindex(",") - 30])
    return read(tmp / "G.csv")


@case("CSV: an entry on two lines", "occurs on two lines")
def _(tmp):
    write_csv(tmp / "G.csv", G)
    text = (tmp / "G.csv").read_text()
    (tmp / "G.csv").write_text(text + text.splitlines()[-1] + "\n")
    return read(tmp / "G.csv")


@case("CSV: really a spreadsheet", "save the sheet as CSV")
def _(tmp):
    (tmp / "G.csv").write_bytes(b"PK\x03\x04\xff\xfe\x80\x81")
    return read(tmp / "G.csv")


@case("WAV: cut short", "cut short")
def _(tmp):
    wavfile.write(tmp / "d.wav", 10000, np.ones((100, 4)))
    return read_wav_drives(cut(tmp / "d.wav"))


@case("WAV: integers without a full scale", "full scale")
def _(tmp):
    wavfile.write(tmp / "d.wav", 10000, np.ones((100, 4), dtype=np.int16))
    return read_wav_drives(tmp / "d.wav")


@case("WAV: samples that are not numbers", "must not be played")
def _(tmp):
    wavfile.write(tmp / "d.wav", 10000, np.full((100, 4), np.nan))
    return read_wav_drives(tmp / "d.wav")


RECIPE = """
name = "set"
[array]
files = ["a.f32"]
shape = [8, 2, 2]
axes = ["time", "output", "input"]
[time]
sample_rate = 1000.0
[declaration]
unit = "m/N"
sign = "+iwt"
outputs = [{name = "1", position = [0, 0, 0]}, {name = "2", position = [0.01, 0, 0]}]
inputs = [{name = "A1", position = [0, 0, 0]}, {name = "A2", position = [0.01, 0, 0]}]
"""


def recipe(tmp: Path, text: str = RECIPE, count: int | None = 32) -> object:
    (tmp / "set.toml").write_text(text)
    if count is not None:
        np.arange(count, dtype="<f4").tofile(tmp / "a.f32")
    return files.read(tmp / "set.toml")


@case("recipe: data file missing", "the recipe expects it here")
def _(tmp):
    return recipe(tmp, count=None)


@case("recipe: data file cut short", "holds 30 numbers")
def _(tmp):
    return recipe(tmp, count=30)


@case("recipe: misspelt key", r"array\.shpe: unknown key")
def _(tmp):
    return recipe(tmp, RECIPE.replace("shape", "shpe"))


@case("recipe: index beyond the array", "counts from 1 to 2")
def _(tmp):
    return recipe(tmp, RECIPE.replace("[time]", "select = {output = [0, 1]}\n[time]"))


@case("recipe: an axis left over", "select one index along every other axis")
def _(tmp):
    text = RECIPE.replace("shape = [8, 2, 2]", "shape = [4, 2, 2, 2]").replace('"input"]', '"input", "xyz"]')
    return recipe(tmp, text)


# ---------------------------------------------------------------- recordings
def taken(change: dict[str, object] | None = None, repeats: int = 4, noise: float = 1e-4, **faults: object) -> object:
    """Findings on one recording of a virtual device with ``faults``."""
    plan = plan_for(SMALL, repeats=repeats)
    recording = record(plan, device_for(SMALL, noise=noise, faults=Faults(**faults)), (0, 0))
    return diagnose(replace(recording, **(change or {})), BAND)


@case("recording: clipped", "touch the end of the range")
def _(tmp):
    plan = plan_for(SMALL, input_range=0.5)
    return diagnose(record(plan, device_for(SMALL), (0, 0)), BAND)


@case("recording: clipped before the converter", "touch the end of the range")
def _(tmp):
    daq = device_for(SMALL, bits=0, sensor=replace(SENSOR, saturation=0.3))
    return diagnose(replace(record(plan_for(SMALL), daq, (0, 0)), full_scale=np.inf), BAND)


@case("recording: the sensor saturates within the converter's range", "touch the end of the range")
def _(tmp):
    daq = device_for(SMALL, noise=1e-4, sensor=replace(SENSOR, saturation=0.3))
    return diagnose(record(plan_for(SMALL), daq, (0, 0)), BAND)


@case("recording: samples dropped", "7 sample")
def _(tmp):
    return taken(drop=(2600, 7))


@case("recording: one sample dropped late in the last repeat", "1 sample")
def _(tmp):
    return taken(drop=(4600, 1))


@case("recording: sensor unplugged", "stands still")
def _(tmp):
    return taken(blind=True, noise=0.0)


@case("recording: laser misses the arm", "does not follow the drive")
def _(tmp):
    return taken(blind=True, noise=1e-3)


@case("recording: actuator dead", "does not follow the drive")
def _(tmp):
    return taken(dead_inputs=(0,), noise=1e-3)


@case("recording: actuator dead, a single sweep", "does not follow the drive")
def _(tmp):
    return taken(dead_inputs=(0,), noise=1e-3, repeats=1)


@case("recording: the arm moves", "arm or the laser moved")
def _(tmp):
    return taken(moved_at=2500)


@case("recording: the response drifts by 5 % per second", "arm or the laser moved")
def _(tmp):
    return taken(drift=0.05)


@case("recording: not a number", "are not numbers")
def _(tmp):
    return taken(nan_at=3000)


@case("recording: no drive", "nothing can be divided by it")
def _(tmp):
    return taken({"sent": np.zeros(SWEEP.n)})


@case("recording: loopback unplugged", "loopback channel stands still")
def _(tmp):
    return taken({"loopback": np.zeros((4, SWEEP.n))})


@case("recording: loopback on another output", "is it wired to this output")
def _(tmp):
    return taken({"loopback": np.random.default_rng(0).standard_normal((4, SWEEP.n))})


@case("recording: periods of another sweep", "whole periods of the sweep")
def _(tmp):
    return taken({"sent": SWEEP.samples()[:900]})


# ---------------------------------------------------------------- sessions and devices
def session(tmp: Path) -> Path:
    plan = plan_for(SMALL)
    calibrate(plan, device_for(SMALL, noise=1e-4), tmp)
    return next(tmp.glob("G_1_A1*.nc"))


@case("session: a recording cut short", "to be measured again")
def _(tmp):
    cut(session(tmp))
    return collected(plan_for(SMALL), tmp).findings


@case("session: a recording altered", "damaged|checksum")
def _(tmp):
    file = session(tmp)
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(content)
    return collected(plan_for(SMALL), tmp).findings


@case("session: a recording renamed", "renamed by hand")
def _(tmp):
    file = session(tmp)
    file.rename(next(tmp.glob("G_1_A2*.nc")))
    return collected(plan_for(SMALL), tmp).findings


@case("session: a recording saved twice", "identical to|renamed")
def _(tmp):
    plan = plan_for(SMALL)
    first = record(plan, device_for(SMALL, noise=1e-4), (0, 0))
    from forearm_fem.measurement.entry import assemble

    band = (10.0, 500.0)
    twice = [entry(r, band, plan.options) for r in (first, replace(first, input="A2"))]
    return assemble(twice, SMALL.outputs, SMALL.inputs, {}).findings


@case("session: folder of another sweep", "choose an empty folder")
def _(tmp):
    session(tmp)
    return collected(plan_for(SMALL, repeats=8), tmp)


@case("session: session.json damaged", "delete this one file")
def _(tmp):
    session(tmp)
    (tmp / "session.json").write_text("{")
    return collected(plan_for(SMALL), tmp)


@case("session: nothing measured yet", "nothing has been measured yet")
def _(tmp):
    return collected(plan_for(SMALL), tmp)


@case("session: the operator stops", "run the same command to go on")
def _(tmp):
    return calibrate(plan_for(SMALL), device_for(SMALL), tmp, operator=lambda what: False)


@case("device: emergency stop", "emergency stop")
def _(tmp):
    return calibrate(plan_for(SMALL), device_for(SMALL), tmp, stop=lambda: True)


@case("device: stops answering", "stopped answering")
def _(tmp):
    return calibrate(plan_for(SMALL), device_for(SMALL, faults=Faults(fail_at=700)), tmp)


@case("device: drive above the limit", "the limit is 2.5 V")
def _(tmp):
    return play(device_for(SMALL), np.full((2, 100), 3.0), RATE, plan_for(SMALL).options.daq)


@case("device: drive not finite", "not finite")
def _(tmp):
    return play(device_for(SMALL), np.full((2, 100), np.nan), RATE, plan_for(SMALL).options.daq)


@case("device: wrong number of drives", "expected 2 drive signals")
def _(tmp):
    return play(device_for(SMALL), np.zeros((4, 100)), RATE, plan_for(SMALL).options.daq)


@case("device: fewer channels wired than actuators", "name one each")
def _(tmp):
    return plan_for(SMALL).__class__(SMALL.outputs, INPUTS, SWEEP, plan_for(SMALL).options)


@pytest.mark.parametrize("name", CASES)
def test_each_gets_its_sentence(name, tmp_path):
    make, pattern = CASES[name]
    said = make(tmp_path)
    assert re.search(pattern, said), said
    assert "\n" not in said
    assert len(said) < 330


def test_there_are_enough_cases():
    assert len(CASES) >= 30


def test_a_sound_recording_gets_none():
    assert taken() == ()
    assert taken(repeats=1) == ()
    noise = noise_for(20.0, SMALL, SWEEP.samples(), RATE, SENSOR)
    assert [taken(noise=noise, repeats=8) for _ in range(5)] == [()] * 5
