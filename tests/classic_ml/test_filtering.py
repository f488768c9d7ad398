"""The low-pass attenuates as Butterworth's formula says, and delays as it must."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import butter, sosfilt, sosfilt_zi, sosfiltfilt, sosfreqz

from classic_ml import filtering
from classic_ml.filters import (
    butterworth_gain,
    channel_filter,
    filter_channels,
    low_pass,
    period_average,
    phase_delay_s,
)
from classic_ml.records import Record
from surge_core.errors import InputError

RATE = 1000.0
TIME = np.arange(4000) / RATE


def amplitude(values: np.ndarray, frequency_hz: float) -> float:
    middle = slice(1000, 3000)
    carrier = np.exp(-2j * np.pi * frequency_hz * TIME[middle])
    return 2 * abs(np.mean(values[middle] * carrier))


@pytest.mark.parametrize(("order", "stall_db"), [(3, -14.3), (5, -23.5)])
def test_attenuation_at_48_and_82_5_hz(order: int, stall_db: float) -> None:
    gain = butterworth_gain(np.array([48.0, 82.5]), RATE, order=order, cutoff_hz=48.0)
    decibel = 20 * np.log10(gain)
    assert decibel[0] == pytest.approx(-3.01, abs=0.01)
    # The bilinear map of a filter at 1 kHz attenuates a little more than its analogue.
    assert stall_db - 1.2 < decibel[1] < stall_db


@pytest.mark.parametrize("order", [3, 5])
@pytest.mark.parametrize(("phase", "passes"), [("causal", 1), ("zero", 2)])
def test_a_sine_comes_out_with_that_gain(order: int, phase: str, passes: int) -> None:
    for frequency in (8.0, 48.0, 80.0):
        sine = np.sin(2 * np.pi * frequency * TIME)
        out = low_pass(sine, RATE, order=order, cutoff_hz=48.0, phase=phase)
        gain = butterworth_gain(np.array([frequency]), RATE, order=order, cutoff_hz=48.0)[0]
        assert amplitude(out, frequency) == pytest.approx(gain**passes, rel=2e-3)


def delay_of(order: int, phase: str, frequency: float = 7.0) -> float:
    sine = np.sin(2 * np.pi * frequency * TIME)
    out = low_pass(sine, RATE, order=order, cutoff_hz=48.0, phase=phase)
    middle = slice(1000, 3000)
    carrier = np.exp(-2j * np.pi * frequency * TIME[middle])
    turn = np.angle(np.mean(out[middle] * carrier) / np.mean(sine[middle] * carrier))
    return float(-turn / (2 * np.pi * frequency))


@pytest.mark.parametrize(("order", "delay_ms"), [(3, 6.6), (5, 10.7)])
def test_the_causal_filter_delays_surge_by_the_known_time(order: int, delay_ms: float) -> None:
    assert 1e3 * delay_of(order, "causal") == pytest.approx(delay_ms, abs=0.15)
    stated = phase_delay_s(7.0, RATE, order=order, cutoff_hz=48.0)
    assert stated == pytest.approx(delay_of(order, "causal"), abs=2e-5)
    assert abs(delay_of(order, "zero")) < 1e-6


@pytest.mark.parametrize("phase", ["zero", "causal", "none"])
def test_a_constant_passes_from_the_first_sample_on(phase: str) -> None:
    out = low_pass(np.full(300, 5.5e4), RATE, order=3, cutoff_hz=48.0, phase=phase)
    np.testing.assert_allclose(out, 5.5e4, rtol=1e-9)


def test_no_filter_is_the_identity() -> None:
    noise = np.random.default_rng(0).standard_normal(200)
    np.testing.assert_array_equal(
        low_pass(noise, RATE, order=3, cutoff_hz=48.0, phase="none"), noise
    )


@pytest.mark.parametrize("order", [3, 5])
@pytest.mark.parametrize("n", [19, 100, 70_001])
def test_the_filter_is_scipy_s(order: int, n: int) -> None:
    values = 5.5e4 + 300.0 * np.random.default_rng(n).standard_normal(n).cumsum()
    sections = butter(order, 48.0, fs=RATE, output="sos")
    once = sosfilt(sections, values, zi=sosfilt_zi(sections) * values[0])[0]
    settings = {"order": order, "cutoff_hz": 48.0}
    for phase, expected in (("causal", once), ("zero", sosfiltfilt(sections, values))):
        out = low_pass(values, RATE, phase=phase, **settings)
        assert np.abs(out - expected).max() <= 1e-12 * np.ptp(values)


@pytest.mark.parametrize(("order", "rows"), [(3, 12), (5, 18)])
def test_a_record_shorter_than_the_filter_s_start_is_refused(order: int, rows: int) -> None:
    with pytest.raises(ValueError, match=f"more than {rows} samples, found {rows}"):
        low_pass(TIME[:rows], RATE, order=order, cutoff_hz=48.0, phase="zero")
    low_pass(TIME[: rows + 1], RATE, order=order, cutoff_hz=48.0, phase="zero")


@pytest.mark.parametrize("n_channels", [1, 4, 5, 6, 11])
def test_each_of_several_channels_is_filtered_as_if_alone(n_channels: int) -> None:
    rng = np.random.default_rng(n_channels)
    arrays = {f"P{k}": (rng.standard_normal(300).cumsum(), "Pa") for k in range(n_channels)}
    record = Record.from_arrays(arrays, sample_rate_hz=RATE)
    out = filter_channels(record, tuple(arrays), order=3, cutoff_hz=48.0, phase="zero")
    for name, (values, _) in arrays.items():
        alone = low_pass(values, RATE, order=3, cutoff_hz=48.0, phase="zero")
        np.testing.assert_array_equal(out[name], alone)


@pytest.mark.parametrize("width", [0.4, 1.0, 1.7, 2.0, 12.12, 13.0, 150.0])
def test_the_moving_average_is_the_weighted_mean_of_what_there_is(width: float) -> None:
    values = np.random.default_rng(8).standard_normal(120)
    out = period_average(values, width / RATE, RATE)
    offset = np.abs(np.arange(120) - np.arange(120)[:, None])
    # Each sample stands for one period around it, of which a part is inside of the average.
    weights = np.clip(0.5 * width + 0.5 - offset, 0.0, 1.0)
    if width > 1.0:
        np.testing.assert_allclose(out, weights @ values / weights.sum(axis=1), rtol=0, atol=1e-13)
    else:
        np.testing.assert_array_equal(out, values)


@pytest.mark.parametrize("order", [1, 2, 3, 4, 5, 8])
@pytest.mark.parametrize("cutoff_hz", [2.0, 48.0, 300.0, 490.0])
def test_the_design_is_scipy_s(order: int, cutoff_hz: float) -> None:
    hz = np.linspace(0.0, 499.0, 400)
    sections = butter(order, cutoff_hz, fs=1000.0, output="sos")
    expected = np.abs(sosfreqz(sections, worN=hz, fs=1000.0)[1])
    got = butterworth_gain(hz, 1000.0, order=order, cutoff_hz=cutoff_hz)
    # A narrow filter is told from the unit circle by few digits, in scipy's design too.
    np.testing.assert_allclose(got, expected, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("phase", ["zero", "causal"])
@pytest.mark.parametrize("cutoff_hz", [3.0, 48.0, 200.0])
def test_pieces_filtered_by_themselves_are_those_of_the_whole(
    phase: str, cutoff_hz: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(11)
    values = 1e5 + 1e3 * rng.standard_normal(30_000).cumsum()
    whole = low_pass(values, 1000.0, order=3, cutoff_hz=cutoff_hz, phase=phase)
    monkeypatch.setattr(filtering, "PIECE_ROWS", 700)
    pieces = low_pass(values, 1000.0, order=3, cutoff_hz=cutoff_hz, phase=phase)
    # What a piece does not know of the others is far below the rounding of the recursion itself.
    np.testing.assert_allclose(pieces, whole, rtol=1e-12 * max(1.0, 48.0 / cutoff_hz), atol=0.0)


def test_rows_of_the_filter_depend_on_what_it_says_and_on_nothing_else(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(filtering, "PIECE_ROWS", 500)
    values = np.random.default_rng(4).standard_normal(5000)
    record = Record.from_arrays({"P": (values, "Pa")}, sample_rate_hz=1000.0)
    rows = slice(2100, 2300)

    def filtered(changed: slice) -> np.ndarray:
        other = values.copy()
        other[changed] += 1.0
        spoiled = Record.from_arrays({"P": (other, "Pa")}, sample_rate_hz=1000.0)
        return channel_filter(spoiled, ["P"], order=3, cutoff_hz=48.0, phase="zero")(rows)[0]

    run = channel_filter(record, ["P"], order=3, cutoff_hz=48.0, phase="zero")
    needed = run.needed(rows)
    assert needed.start < rows.start
    assert needed.stop > rows.stop
    for outside in (slice(0, needed.start), slice(needed.stop, None)):
        np.testing.assert_array_equal(filtered(outside), run(rows)[0])
    assert not np.array_equal(filtered(slice(2200, 2201)), run(rows)[0])


@pytest.mark.parametrize("cutoff", [0.0, -1.0, 500.0, 700.0])
def test_a_cutoff_that_the_sample_rate_cannot_hold_is_refused(cutoff: float) -> None:
    with pytest.raises(InputError, match=r"below half the sample rate \(500 Hz\)"):
        low_pass(TIME, RATE, order=3, cutoff_hz=cutoff, phase="zero")


def test_the_average_over_one_cell_period_has_nulls_at_the_cell_and_its_harmonics() -> None:
    surge = 30 + 20 * np.sin(2 * np.pi * 7.0 * TIME)
    for harmonic in (1, 2, 3):
        cells = 9.0 * np.sin(2 * np.pi * 82.5 * harmonic * TIME + 0.4)
        left = period_average(surge + cells, 1 / 82.5, RATE) - period_average(surge, 1 / 82.5, RATE)
        # Fractional end weights are linear interpolation of the integral: good to (f/rate)².
        assert np.abs(left[50:-50]).max() < 9.0 * 0.06 * harmonic**2
    kept = period_average(surge, 1 / 82.5, RATE)[50:-50] - surge[50:-50]
    assert np.abs(kept).max() < 20 * 0.013


def test_the_average_keeps_a_straight_line_and_does_not_delay() -> None:
    line = 3.0 + 2.0 * TIME
    for width in (1 / 82.5, 0.001, 0.0123):
        out = period_average(line, width, RATE)
        np.testing.assert_allclose(out[20:-20], line[20:-20], rtol=1e-12)


def test_every_channel_gets_the_same_filter_and_the_history_says_so() -> None:
    sine = np.sin(2 * np.pi * 7 * TIME)
    record = Record.from_arrays(
        {"P": (sine, "Pa"), "T": (2 * sine, "K"), "X": (sine, "1")}, sample_rate_hz=RATE
    )
    out = filter_channels(record, ("P", "T"), order=3, cutoff_hz=48.0, phase="causal")
    np.testing.assert_allclose(out["T"], 2 * out["P"], rtol=1e-12)
    np.testing.assert_array_equal(out["X"], record["X"])
    assert out.channel("T").unit == "K"
    entry = out.history[-1]
    assert entry.parameters == {"phase": "causal", "order": 3, "cutoff_hz": 48.0}
    assert "delays surge frequencies by 6.6 ms" in entry.did


@pytest.mark.parametrize("n_signals", [1, 2, 3])
def test_pieces_that_go_in_one_run_are_those_of_each_alone(
    n_signals: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("classic_ml.filters.PIECE_ROWS", 600)
    rng = np.random.default_rng(n_signals)
    signals = np.cumsum(rng.standard_normal((n_signals, 7000)), axis=1)

    def filtered(n_channels: int) -> Record:
        arrays = {f"P{k}": (signals[k % n_signals], "Pa") for k in range(n_channels)}
        record = Record.from_arrays(arrays, sample_rate_hz=RATE)
        return filter_channels(record, tuple(arrays), order=3, cutoff_hz=48.0, phase="zero")

    # With six signals no lane is left for another piece.
    few, many = filtered(n_signals), filtered(6)
    for k in range(n_signals):
        assert np.array_equal(few[f"P{k}"], many[f"P{k}"])
