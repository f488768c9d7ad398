"""Readings cut off at an end of the range are found in channels of any unit, and no others."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from raw_data import make_test, pascals_of, to_toml, write_csv

from classic_ml.description import COUNT_KEYS
from classic_ml.faults.plateaus import range_ends
from classic_ml.faults.search import CLIPPED, inspect_readings
from classic_ml.io import TestDescription, read_raw
from classic_ml.records import Record
from comparisons.rig import SensorSettings, simulate, write_run
from surge_core.types import FloatArray

PSI = 6894.757


def ends_of(values: FloatArray) -> tuple[float, ...]:
    return range_ends(np.ascontiguousarray(values, dtype=np.float64))


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A surge whose inlet pressures clip at the blowdown, as counts and as psia and degF."""
    folder = tmp_path_factory.mktemp("rig")
    write_run(simulate("985", seed=2), folder)
    return folder


def in_other_units(folder: Path, *, limits: dict[str, list[float]] | None = None) -> Path:
    """The record as a test cell writes it: four digits of psia, two of degF, no converter."""
    raw = np.genfromtxt(folder / "raw.csv", delimiter=",", names=True, deletechars="")
    tables = tomllib.loads((folder / "test.toml").read_text("utf-8"))
    columns = {"time_s": raw["time_s"]}
    for name, values in pascals_of(raw, tables["channels"]).items():
        table = tables["channels"][name]
        is_pressure = table["kind"] == "pressure"
        columns[name] = (values / PSI).round(4) if is_pressure else (1.8 * values - 459.67).round(2)
        table["unit"] = "psia" if is_pressure else "degF"
        for key in COUNT_KEYS:
            table.pop(key, None)
    del tables["adc"]
    tables["limits"] = limits or {}
    cell = folder / f"cell-{len(limits or ())}"
    cell.mkdir(exist_ok=True)
    write_csv(cell / "raw.csv", columns)
    (cell / "test.toml").write_text(to_toml(tables), "utf-8")
    return cell


def read(folder: Path, **more: Any) -> tuple[Record, TestDescription]:
    return read_raw(folder / "raw.csv", folder / "test.toml", **more)


def test_what_clips_in_counts_clips_in_any_unit(rig: Path) -> None:
    """Where the converter says which readings are cut off, the channel itself says the same."""
    counted = inspect_readings(*read(rig))
    found = inspect_readings(*read(in_other_units(rig)))
    clipped = [n for n in counted.channels if n.startswith("fault_P25")]
    assert len(clipped) == 8
    for name in clipped:
        np.testing.assert_array_equal(found[name] == CLIPPED, counted[name] == CLIPPED, name)
    # The exit temperatures end at what their limits say in the other description.
    for name in ("fault_T31_A", "fault_T31_B"):
        np.testing.assert_array_equal(found[name] == CLIPPED, counted[name] > 0.0, name)
    assert {n for n in found.channels if n.startswith("fault_")} == {
        n for n in counted.channels if n.startswith("fault_")
    }
    assert "looked for clipped readings, " in found.history[-1].did


def test_stated_limits_are_believed(rig: Path) -> None:
    """Of one channel the end is known, another is said to go on beyond its end."""
    known, wider = "P25_A_tip_forward", "P25_B_tip_aft"
    limits = {known: [2e4, 1.42e5], wider: [2e4, 3e5], "T31_A": [200.0, 600.0]}
    found = inspect_readings(*read(in_other_units(rig, limits=limits)))
    assert f"fault_{wider}" not in found
    assert set(np.unique(found[f"fault_{known}"])) == {0.0, 4.0}
    assert np.max(found["fault_P25_A_tip_aft"]) == CLIPPED


@cache
def sound(noise_percent: float) -> dict[str, FloatArray]:
    """Channels of three rigs in SI, exact: no converter, and nothing that ends their range."""
    sensors = SensorSettings(
        noise_percent=noise_percent,
        thermocouple_noise_k=2.0 * noise_percent,
        bits=None,
        acquisition_limits=False,
    )
    out = {}
    for case in ("985", "90", "75-stall"):
        run = simulate(case, seed=3, duration_s=3.0, sensors=sensors)
        for name, channel in run.raw.channels.items():
            if "_A" in name:
                out[f"{case} {name}"] = channel.values
    return out


@cache
def periodic() -> dict[str, FloatArray]:
    """A surge that repeats itself to the last digit, sampled at the same phases each time."""
    made = make_test(seconds=2.4, quantise=False)
    return {name: v for name, v in made.columns.items() if name != "time_s"}


def coarse(values: FloatArray, bits: int) -> FloatArray:
    step = float(np.ptp(values)) / 2**bits
    return np.asarray(np.floor(values / step + 0.3) * step)


def recorded(values: FloatArray) -> Iterator[tuple[str, FloatArray]]:
    """Yield the ways in which a sound signal may be recorded."""
    yield "as it is", values
    yield "single precision", values.astype(np.float32).astype(np.float64)
    rows = np.arange(values.size)
    for bits in (3, 4, 6, 8, 10, 12, 16):
        read_off = coarse(values, bits)
        yield f"{bits} bits", read_off
        yield f"{bits} bits in psi", (read_off / PSI).round(4)
        for held in (2, 4, 10):
            yield f"{bits} bits held {held}", np.repeat(read_off[::held], held)[: rows.size]
        yield f"{bits} bits, lines between", np.interp(rows, rows[::4], read_off[::4])
    smooth = np.convolve(values, np.hanning(33) / 16.0, "valid")
    for bits in (4, 6, 8, 10):
        yield f"smooth, {bits} bits", coarse(smooth, bits)
        often = np.interp(np.arange(0, smooth.size - 1, 0.1), np.arange(smooth.size), smooth)
        yield f"smooth, often, {bits} bits", coarse(often, bits)


@pytest.mark.parametrize("noise_percent", [0.0, 0.02, 0.2, None])
def test_no_sound_channel_is_cut_off_however_it_is_recorded(noise_percent: float | None) -> None:
    for name, values in (periodic() if noise_percent is None else sound(noise_percent)).items():
        for way, read_off in recorded(values):
            assert ends_of(read_off) == (), f"{name}, {way}"


@pytest.mark.parametrize("seed", range(3))
def test_noise_of_any_colour_and_resolution_is_not_cut_off(seed: int) -> None:
    rng = np.random.default_rng(seed)
    white = rng.standard_normal(40_000)
    slow = np.cumsum(white) / 30.0 + 0.2 * rng.standard_normal(white.size)
    for step in (1e-6, 0.01, 0.1, 0.5, 1.0, 2.0, 5.0):
        for values in (white, slow, np.tanh(slow) * 3.0 + 0.3 * white):
            assert ends_of(np.round(values / step) * step) == (), step


@pytest.mark.parametrize("share", [0.01, 0.03])
def test_an_amplifier_that_saturates_below_its_own_noise_is_found(share: float) -> None:
    """Noise behind the clipping brings readings down from the end again: single rows stand there.

    A record in psia, of which 40 readings or so are bit-equal at their top.
    """
    rng = np.random.default_rng(7)
    n = 4000
    wave = np.cumsum(rng.normal(0.0, 20.0, n)) + 300.0 * np.sin(np.arange(n) / 25.0)
    top = np.quantile(wave, 1.0 - share)
    codes = np.minimum(np.round(np.minimum(wave, top) + rng.normal(0.0, 6.0, n)), np.floor(top))
    for gain in (1.0, 4.813e-3):
        read_off = np.round(gain * codes, 6)
        assert ends_of(read_off) == (read_off.max(),)


def test_constant_and_switching_channels_are_not_cut_off() -> None:
    rng = np.random.default_rng(5)
    n = 5000
    assert ends_of(np.full(n, 7.0)) == ()
    flicker = 288.0 - (rng.random(n) < 0.02)
    assert ends_of(flicker) == ()
    # Two values for long, as a valve has.
    assert ends_of(np.where(np.arange(n) // 250 % 2, 3.0, 1.0)) == ()
    # A channel that rests, and has a spike now and then: it rests at its largest reading.
    spikes = np.full(n, 288.0)
    spikes[rng.integers(10, n - 10, 40)] -= rng.uniform(1.0, 30.0, 40)
    assert ends_of(spikes) == ()


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_channel_without_noise_may_rest_at_its_extreme(sign: float) -> None:
    """A simulation pumps and rests at one level to the last bit; a noisy one that does is cut."""
    time_s = np.arange(4000) / 1000.0
    pumps = 2e5 + 1e5 * np.maximum(np.sin(2.0 * np.pi * 3.3 * time_s), 0.0) ** 2
    assert ends_of(sign * pumps) == ()
    noise = np.random.default_rng(4).normal(0.0, 50.0, time_s.size)
    assert ends_of(sign * np.maximum(pumps + noise, 2.01e5)) == (sign * 2.01e5,)


def test_dropouts_to_the_least_reading_are_no_end_of_the_range() -> None:
    """The readings before do not lead there; a probe that drops out is left out for that."""
    rng = np.random.default_rng(6)
    values = np.round(500.0 + 100.0 * np.sin(np.arange(4000) / 20.0) + rng.normal(0.0, 3.0, 4000))
    for start in range(200, 3900, 311):
        values[start : start + 6] = 3.0
    assert ends_of(values) == ()


@pytest.mark.parametrize(
    ("bits", "share"),
    [(bits, share) for bits in (10, 12, 16, 0) for share in (0.005, 0.02, 0.1)][1:],
)
def test_a_surge_that_is_cut_off_is_found_at_any_resolution(bits: int, share: float) -> None:
    for noise_percent in (0.02, 0.2):
        for name, values in sound(noise_percent).items():
            if not name.startswith("985 P25"):
                continue
            cut = np.minimum(values, np.quantile(values, 1.0 - share))
            cut = coarse(cut, bits) if bits else cut
            assert ends_of(cut) == (cut.max(),)
            # Turned over it is the other end.
            assert ends_of(-cut) == (-cut.max(),)


def test_both_ends_are_found_at_once() -> None:
    rng = np.random.default_rng(1)
    wave = 300.0 * np.sin(np.arange(3000) / 9.0) + rng.normal(0.0, 4.0, 3000)
    assert ends_of(np.clip(np.round(wave), -200.0, 230.0)) == (-200.0, 230.0)
