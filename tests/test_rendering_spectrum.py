"""Wavelets, spectra on bins and the interpolation between samples of G."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.io import wavfile

from forearm_fem.errors import DataError, ScenarioError
from forearm_fem.rendering import (
    Record,
    from_samples_file,
    place_on_bins,
    ricker,
    to_spectrum,
    to_time,
)

# ---------------------------------------------------------------- records and spectra


def signals(sizes=(16, 17)):
    rows = [arrays(float, (2, n), elements=st.floats(-1, 1, width=32)) for n in sizes]
    return st.one_of(rows)


@given(signals())
def test_spectrum_returns_to_the_same_real_signal(x):
    record = Record(100.0, x.shape[1])
    back = to_time(to_spectrum(x, record).T, np.arange(x.shape[1] // 2 + 1), record)
    assert np.allclose(back, x, atol=1e-14)  # two FFTs of 17 numbers below 1


@given(signals())
def test_parseval(x):
    record = Record(100.0, x.shape[1])
    energy = record.df * np.sum(record.weights * np.abs(to_spectrum(x, record)) ** 2, axis=1)
    assert np.allclose(energy, np.sum(x**2, axis=1) / 100, atol=1e-13)  # rounding


@given(signals())
def test_spectrum_is_the_positive_half_of_a_hermitian_one(x):
    """Against the two-sided definition dt sum x exp(-i omega t), t from -centre."""
    record = Record(100.0, x.shape[1])
    two_sided = np.fft.fftfreq(record.n, 1 / 100)
    full = x @ np.exp(-2j * np.pi * np.outer(record.time, two_sided)) / 100
    half = to_spectrum(x, record)
    assert np.allclose(half[:, : (record.n + 1) // 2], full[:, : (record.n + 1) // 2], atol=1e-13)
    mirror = -np.arange(1, (record.n + 1) // 2)
    assert np.allclose(full[:, mirror], half[:, 1 : (record.n + 1) // 2].conj(), atol=1e-13)


def test_time_zero_stands_in_the_middle():
    for n in (20000, 20001):
        record = Record(10000.0, n)
        assert record.time[record.centre] == 0
        assert record.time[0] == -(n // 2) / 10000


@pytest.mark.parametrize(("rate", "duration"), [(0.0, 1.0), (1000.0, -1.0), (1000.0, 0.0125001), (1.0, 2.0)])
def test_records_of_no_whole_number_of_samples_are_refused(rate, duration):
    with pytest.raises(ScenarioError, match="whole number"):
        Record.of(rate, duration)


# ---------------------------------------------------------------- Ricker


@given(st.floats(60, 1500))
def test_ricker_spectrum_is_the_analytic_one(peak_hz):
    """W(f) = 2 f^2 / (sqrt(pi) f_p^3) exp(-f^2 / f_p^2): real, with its maximum at f_p."""
    wavelet = ricker(peak_hz, duration=0.4)
    f = wavelet.record.frequency
    analytic = 2 * f**2 / (np.sqrt(np.pi) * peak_hz**3) * np.exp(-((f / peak_hz) ** 2))
    # sampling folds what lies beyond 5 kHz = 3.3 f_p at least: e^{-11} 11 / (e^{-1} 1) = 5e-4 of the peak
    assert np.allclose(wavelet.spectrum, analytic, atol=1e-3 * analytic.max())
    assert abs(f[np.argmax(np.abs(wavelet.spectrum))] - peak_hz) <= 1.5 * wavelet.record.df + 0.01 * peak_hz


def test_ricker_is_the_thesis_formula():
    wavelet = ricker(250.0, amplitude=3.0)
    assert wavelet.samples.shape == (20000,)
    sigma = 1 / (np.sqrt(2) * np.pi * 250)
    s = wavelet.time / sigma
    assert np.allclose(wavelet.samples, 3 * (1 - s**2) * np.exp(-(s**2) / 2), atol=1e-14)
    assert wavelet.samples[10000] == 3
    # 500 Hz: 4 e^-3 = 20 % of the peak's spectrum (physics_data.md 0)
    ratio = abs(wavelet.spectrum[1000]) / abs(wavelet.spectrum[500])
    assert ratio == pytest.approx(4 * np.exp(-3), rel=1e-9)


@pytest.mark.parametrize("wish", [{"peak_hz": 0.0}, {"peak_hz": 2000.0}, {"peak_hz": 250.0, "duration": 0.02}])
def test_ricker_that_does_not_fit_is_refused(wish):
    with pytest.raises(ScenarioError, match="Ricker wavelet"):
        ricker(**wish)


# ---------------------------------------------------------------- files

BURST = np.array([0.0, 1.0, -4.0, 2.0, 0.5])


def write(path, kind):
    if kind == "npy":
        np.save(path, BURST)
    elif kind == "wav":
        wavfile.write(path, 10000, (BURST * 1000).astype(np.int16))
    elif kind == "8bit.wav":  # unsigned, silence at 128
        wavfile.write(path, 10000, (BURST * 24 + 128).astype(np.uint8))
    elif kind == "csv":
        path.write_text("# burst\nvalue\n" + "\n".join(map(str, BURST)), encoding="utf-8")
    else:
        rows = "\n".join(f"{i * 1e-4},{v}" for i, v in enumerate(BURST))
        path.write_text("time,value\n" + rows, encoding="utf-8")


@pytest.mark.parametrize("kind", ["npy", "wav", "8bit.wav", "csv", "timed.csv"])
def test_samples_from_a_file_peak_at_time_zero(tmp_path, kind):
    path = tmp_path / f"burst.{kind}"
    write(path, kind)
    wavelet = from_samples_file(path, duration=0.1)
    c = wavelet.record.centre
    assert np.allclose(wavelet.samples[c - 2 : c + 3], BURST / 4, atol=1e-15)
    assert np.count_nonzero(wavelet.samples) == 4


def test_a_byte_order_mark_takes_no_sample_away(tmp_path):
    """Spreadsheets write one: the first sample was taken for a heading."""
    (tmp_path / "b.csv").write_text("\n".join(map(str, (4.0, -2.0, 1.0))), encoding="utf-8-sig")
    assert np.count_nonzero(from_samples_file(tmp_path / "b.csv").samples) == 3


def test_samples_keep_their_size_when_asked(tmp_path):
    write(tmp_path / "b.npy", "npy")
    assert np.abs(from_samples_file(tmp_path / "b.npy", normalise=False).samples).max() == 4


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.csv", "1\ntwo\n3", "cannot be read as CSV"),
        ("a.csv", "", "holds no numbers"),
        ("a.csv", "1,2,3\n4,5,6", "expected 1 or 2 columns"),
        ("a.csv", "0,1\n0.1,2\n0.15,3", "not an evenly increasing time"),
        ("a.csv", "0,1\n0.001,2\n0.002,3", "sampled at 1000 Hz, expected 10000 Hz"),
        ("a.csv", "1\nnan\n3", "not finite"),
        ("a.csv", "0\n0\n0", "all 3 samples are zero"),
        ("a.csv", "7", "at least 2 samples"),
        ("a.csv", "1,2\n3", "cannot be read"),
        ("a.csv", "\n".join(["1"] * 2000), "do not fit"),
        ("a.wav", "no wave", "cannot be read as WAV"),
        ("a.npy", "no array", "cannot be read as NPY"),
        ("a.mp3", "x", "expected a wavelet's file that ends in .csv"),
    ],
)
def test_bad_sample_files_are_named(tmp_path, name, content, message):
    (tmp_path / name).write_text(content, encoding="utf-8")
    with pytest.raises(DataError, match=message) as caught:
        from_samples_file(tmp_path / name, duration=0.1)
    assert name in str(caught.value)


@pytest.mark.parametrize("array", [np.zeros((3, 2)) + 1.0, np.array([1j, 2.0]), np.array(["a", "b"])])
def test_arrays_that_are_no_samples_are_refused(tmp_path, array):
    np.save(tmp_path / "a.npy", array)
    with pytest.raises(DataError, match=r"a\.npy"):
        from_samples_file(tmp_path / "a.npy")


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(DataError, match="no such file"):
        from_samples_file(tmp_path / "none.csv")


# ---------------------------------------------------------------- bins


def delayed(frequency, delay=0.005, decay=100.0):
    """A wave that took ``delay`` [s], two entries (n, 1, 2)."""
    f = np.asarray(frequency, dtype=float)
    one = np.exp(-2j * np.pi * f * delay - f / decay)
    return np.stack([one, (1 + 0.5j) * one], axis=1)[:, None, :]


def test_samples_on_bins_are_copied_bit_for_bit():
    f = np.arange(20, 1001) * 0.5
    bins = place_on_bins(f, delayed(f), 10000.0, 2.0)
    assert np.array_equal(bins.index, np.arange(20, 1001))
    assert np.array_equal(bins.values, delayed(f))
    assert bins.valid.all()


def test_bins_outside_the_band_and_from_nyquist_up_are_absent():
    f = np.arange(0.5, 60.1, 0.5)
    bins = place_on_bins(f, delayed(f), 100.0, 2.0)
    assert bins.index[0] == 1
    assert bins.frequency[-1] == 49.5


@pytest.mark.parametrize("step", [4.0, 8.0])
def test_interpolation_error_falls_with_the_fourth_power_and_stays_below_its_tolerance(step):
    errors = []
    for h in (step, step / 2):
        f = np.arange(10.3, 500.0, h)
        bins = place_on_bins(f, delayed(f), 10000.0, 2.0)
        truth = delayed(bins.frequency)
        inner = slice(40, -40)  # the ends of a spline are worse
        errors.append((np.abs(bins.values - truth).max(axis=(1, 2)) / np.abs(truth).max(axis=(1, 2)))[inner].max())
    assert errors[0] < 0.01
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4, abs=0.3)  # cubic spline, order 4


def test_samples_too_far_apart_are_refused_with_their_place():
    f = np.arange(10.0, 500.0, 60.0)
    with pytest.raises(DataError, match=r"60 Hz apart: interpolating them would err by about"):
        place_on_bins(f, delayed(f), 10000.0, 2.0)


def test_gaps_are_not_filled():
    f = np.concatenate([np.arange(10.2, 100, 1.0), np.arange(140.2, 300, 1.0)])
    bins = place_on_bins(f, delayed(f), 10000.0, 2.0)
    assert not np.any((bins.frequency > f[f < 100].max()) & (bins.frequency < 140.2))
    assert bins.frequency[0] == 10.5
    assert np.abs(bins.values - delayed(bins.frequency)).max() < 1e-3  # spline, 1 Hz steps, also at its ends


def test_invalid_samples_interrupt_only_their_own_entry():
    f = np.arange(10.2, 300, 1.0)
    valid = np.ones((len(f), 1, 2), dtype=bool)
    valid[100, 0, 1] = False
    values = np.where(valid, delayed(f), np.nan)
    bins = place_on_bins(f, values, 10000.0, 2.0, valid=valid)
    assert bins.valid[:, 0, 0].all()
    assert bins.values[:, 0, 0] == pytest.approx(place_on_bins(f, delayed(f), 10000.0, 2.0).values[:, 0, 0], rel=1e-12)
    masked = ~bins.valid[:, 0, 1]
    assert np.array_equal(masked, (bins.frequency > f[99]) & (bins.frequency < f[101]))
    assert np.all(bins.values[masked, 0, 1] == 0)


def test_few_samples_serve_only_their_own_bins():
    f = np.array([100.0, 101.0, 102.0])
    assert np.array_equal(place_on_bins(f, delayed(f), 10000.0, 2.0).frequency, f)


@pytest.mark.parametrize(
    ("f", "message"),
    [
        ([10.0, 10.0, 20.0], "must be positive and increase"),
        ([0.0, 10.0, 20.0], "must be positive and increase"),
        ([20.0, 10.0, 30.0], "must be positive and increase"),
        ([10.0, np.nan, 30.0], "must be positive and increase"),
        ([10.2, 11.2, 12.2], "no bin of the record"),
    ],
)
def test_frequencies_that_cannot_be_placed_are_refused(f, message):
    with pytest.raises(DataError, match=message):
        place_on_bins(np.array(f), delayed([10.0, 20.0, 30.0]), 10000.0, 2.0)


def test_masks_and_frequencies_of_another_shape_are_refused():
    f = np.array([10.0, 20.0])
    with pytest.raises(DataError, match="mask of G has shape"):
        place_on_bins(f, delayed(f), 10000.0, 2.0, valid=np.ones(2, dtype=bool))
    with pytest.raises(DataError, match="matrices for frequencies"):
        place_on_bins(f[:1], delayed(f), 10000.0, 2.0)
    with pytest.raises(DataError, match="holds no valid entry at any frequency"):
        place_on_bins(f, delayed(f), 10000.0, 2.0, valid=np.zeros(delayed(f).shape, dtype=bool))
