"""Counts to pascal and kelvin: zero and calibrate readings, near-stall match, thermocouples."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from classic_ml.columns.computed import as_stored
from classic_ml.columns.order_statistics import mean
from classic_ml.columns.workspace import blocks
from classic_ml.description import (
    PLAUSIBLE_BIAS,
    PLAUSIBLE_BIAS_K,
    Converter,
    PressureChannel,
    ProbePair,
    TemperatureChannel,
    TestDescription,
)
from classic_ml.faults.marks import fault_name
from classic_ml.faults.near_stall_levels import common_shifts
from classic_ml.flow_kernels import change_scale
from classic_ml.rates import rate_in
from classic_ml.records import Channel, LedgerEntry, Record
from surge_core.errors import InputError
from surge_core.types import FloatArray

__all__ = [
    "calibrate",
    "calibrate_and_match",
    "check_facing",
    "invert_thermocouples",
    "match_near_stall",
    "near_stall_match",
    "near_stall_rows",
    "pressure_from_counts",
    "probe_pressure_Pa",
    "volts",
]

# Fewer rows than this and the match is worth no more than one noisy reading.
MINIMUM_NEAR_STALL_ROWS = 20
# What a probe in the wake of its mate reads, over the total pressure, up to sonic flow.
LEAST_IN_WAKE = 0.5


def volts(counts: FloatArray | float, adc: Converter) -> FloatArray:
    """Return the volts behind the codes of a converter."""
    return np.asarray(adc.low_V + np.asarray(counts, dtype=np.float64) * adc.volts_per_count)


def pressure_from_counts(
    channel: PressureChannel, adc: Converter, counts: FloatArray
) -> FloatArray:
    """Return the pressure that a transducer in counts saw.

    Parameters
    ----------
    channel : PressureChannel
        Its zero and calibrate readings and its reference pressure.
    adc : Converter
        The converter.
    counts : ndarray of shape (n,)
        Codes; any number type.

    Returns
    -------
    ndarray of shape (n,)
        P = (V − V_zero)/S + P_zoc with S = (V_calibrate − V_zero)/ΔP_calibrate, in pascal.
    """
    zero_V, sensitivity_V_Pa = _zero_and_sensitivity(channel, adc)
    return np.asarray((volts(counts, adc) - zero_V) / sensitivity_V_Pa + channel.zoc_reference_Pa)


def _zero_and_sensitivity(channel: PressureChannel, adc: Converter) -> tuple[float, float]:
    zero_V = float(volts(channel.zero_count, adc))
    calibrate_V = float(volts(channel.calibrate_count, adc))
    return zero_V, (calibrate_V - zero_V) / channel.calibrate_pressure_Pa


def probe_pressure_Pa(
    channel: PressureChannel, test: TestDescription, readings: FloatArray
) -> FloatArray:
    """Return the pressure that a probe saw, whatever its readings are in.

    Parameters
    ----------
    channel : PressureChannel
        The probe.
    test : TestDescription
        The test it belongs to.
    readings : ndarray of shape (n,)
        As a record has them: codes, or Pa, which are returned as they are.
    """
    if channel.record_unit == "Pa":
        return readings
    return pressure_from_counts(channel, test.adc, readings)


def calibrate(record: Record, test: TestDescription) -> Record:
    """Turn counts into pascal and indicated into total temperatures.

    Parameters
    ----------
    record : Record
        Counts or Pa, and kelvin, as read.
    test : TestDescription
        Calibration of each channel.

    Returns
    -------
    Record
        Pressures in Pa; temperatures divided by the recovery factor T_i/T.
    """
    _check_units(record, test)
    changes = {name: change for name, change in _calibrations(test).items() if change != _Change()}
    return record.after(_calibrated(test), add=_changed(record, changes))


def calibrate_and_match(record: Record, test: TestDescription, match: str = "pair") -> Record:
    """Calibrate, check how the probes face, and match near stall, all in one pass.

    Parameters
    ----------
    record : Record
        Counts or Pa, and kelvin, as read.
    test : TestDescription
        Calibration of each channel, and the facility's reading.
    match : {"pair", "forward", "none"}
        As :func:`match_near_stall` takes it.

    Returns
    -------
    Record
        What :func:`calibrate` and :func:`match_near_stall` give one after the other, to the last
        bit and with both ledger entries.

    Raises
    ------
    InputError
        As these and :func:`check_facing` do.
    """
    _check_units(record, test)
    shifts, entry = near_stall_match(record, test, match)
    changes = {
        name: replace(change, shift=shifts.get(name, 0.0))
        for name, change in _calibrations(test).items()
    }
    changes = {name: change for name, change in changes.items() if change != _Change()}
    return record.after(_calibrated(test), add=_changed(record, changes)).after(entry)


def near_stall_match(
    record: Record, test: TestDescription, match: str = "pair"
) -> tuple[dict[str, float], LedgerEntry]:
    """Return what the near-stall match adds to each channel that it moves, and how it was found.

    Parameters
    ----------
    record : Record
        Counts or Pa, and kelvin, as read.
    test : TestDescription
        Calibration of each channel, and the facility's reading.
    match : {"pair", "forward", "none"}
        As :func:`match_near_stall` takes it.

    Returns
    -------
    dict of str to float
        By channel, in Pa and K; 0 for one whose reading does not count.
    LedgerEntry
        The step.

    Raises
    ------
    InputError
        As :func:`match_near_stall` and :func:`check_facing` do.
    """
    if test.near_stall_shifts:
        return _match(record, test, slice(0, 0), match)
    rows = near_stall_rows(record, test)
    steady = {n: Channel(n, c.values[rows], c.unit) for n, c in record.channels.items()}
    near = calibrate(replace(record, channels=steady), test)
    all_rows = slice(0, near.n_samples)
    _check_facing(near, test, all_rows)
    return _match(near, test, all_rows, match)


@dataclass(frozen=True)
class _Change:
    """((start + readings · step) − zero)/slope + reference + shift, in a unit."""

    start: float = 0.0
    step: float = 1.0
    zero: float = 0.0
    slope: float = 1.0
    reference: float = 0.0
    shift: float = 0.0


def _calibrations(test: TestDescription) -> dict[str, _Change]:
    """Return what turns the readings of each channel into pascal or kelvin."""
    changes = {couple.name: _Change(slope=couple.recovery_factor) for couple in test.temperatures}
    for probe in test.pressures:
        changes[probe.name] = _Change()
        if probe.record_unit == "count":
            zero_V, sensitivity_V_Pa = _zero_and_sensitivity(probe, test.adc)
            changes[probe.name] = _Change(
                test.adc.low_V,
                test.adc.volts_per_count,
                zero_V,
                sensitivity_V_Pa,
                probe.zoc_reference_Pa,
            )
    return {name: changes[name] for name in test.channel_names}


def _check_units(record: Record, test: TestDescription) -> None:
    channels: list[PressureChannel | TemperatureChannel] = [*test.pressures, *test.temperatures]
    for described in channels:
        unit = record.channel(described.name).unit
        if unit != described.record_unit:
            raise InputError(
                f"channel {described.name}",
                expected=f'the unit "{described.record_unit}"',
                found=f'"{unit}"',
            )


def _calibrated(test: TestDescription) -> LedgerEntry:
    n_counts = sum(probe.record_unit == "count" for probe in test.pressures)
    ways = [f"{n_counts} pressures from counts by their zero and calibrate readings"] * (
        n_counts > 0
    )
    if n_counts < len(test.pressures):
        ways.append(f"{len(test.pressures) - n_counts} pressures recorded as such")
    ways.append(f"{len(test.temperatures)} temperatures by their recovery factor")
    converter = test.converter
    return LedgerEntry(
        "calibrate",
        ", ".join(ways),
        {}
        if converter is None
        else {"bits": converter.bits, "volts_per_count": converter.volts_per_count},
    )


def _changed(record: Record, changes: Mapping[str, _Change]) -> list[Channel]:
    """Return channels after a change of each."""
    place, n_rows = record.workspace, record.n_samples
    units = {name: "K" if record.channel(name).unit == "K" else "Pa" for name in changes}
    return [
        Channel(name, place.derived(n_rows, partial(_rescaled, record[name], change)), units[name])
        for name, change in changes.items()
    ]


def _rescaled(readings: FloatArray, c: _Change, rows: slice) -> FloatArray:
    out = np.empty(rows.stop - rows.start)
    stored = as_stored(readings)[rows]
    change_scale(stored, c.start, c.step, c.zero, c.slope, c.reference, c.shift, out)
    return out


def near_stall_rows(record: Record, test: TestDescription) -> slice:
    """Return the rows that the facility's near-stall reading describes."""
    reading = test.near_stall
    rows = record.rows_between(reading.from_s, reading.to_s)
    n_rows = rows.stop - rows.start
    if n_rows < MINIMUM_NEAR_STALL_ROWS:
        first_s, last_s = record.time_at_s(0), record.time_at_s(record.n_samples - 1)
        raise InputError(
            f"{test.source}: [near_stall]",
            expected=f"an interval with at least {MINIMUM_NEAR_STALL_ROWS} rows of the record "
            f"({first_s:.3f} to {last_s:.3f} s)",
            found=f"{reading.from_s:g} to {reading.to_s:g} s with {n_rows}",
        )
    return rows


def check_facing(record: Record, test: TestDescription) -> None:
    """Refuse a pair whose aft probe reads above its forward one in the steady flow near stall.

    Parameters
    ----------
    record : Record
        Calibrated pressures, before the near-stall match, which may move one probe alone.
    test : TestDescription
        Pairs, and when the machine was near stall.

    Raises
    ------
    InputError
        Naming the pair.
    """
    _check_facing(record, test, near_stall_rows(record, test))


def _check_facing(record: Record, test: TestDescription, rows: slice) -> None:
    for plane in test.areas_m2:
        for pair in test.pairs(plane):
            aft, forward = pair.aft.name, pair.forward.name
            below_Pa = _sound_mean(record, rows, aft, forward)
            # A pair that does not count there is left out when the channels are chosen.
            if below_Pa is not None and below_Pa >= 0.0:
                _check_levels(record, test, rows, pair)
                raise InputError(
                    f"{record.source}: pair P{pair.name}",
                    expected="the forward probe above the aft one near stall",
                    found=f"{below_Pa / 1e3:.3g} kPa below",
                    remedy="are forward and aft exchanged?",
                )


def _check_levels(record: Record, test: TestDescription, rows: slice, pair: ProbePair) -> None:
    """Refuse a probe that is at no level of an exchanged pair: it has another unit, or range."""
    target = test.near_stall.pressure_Pa(pair.forward.plane)
    for probe, least in ((pair.forward, LEAST_IN_WAKE), (pair.aft, 1.0 - PLAUSIBLE_BIAS)):
        level = _sound_mean(record, rows, probe.name)
        if level is not None and not least <= level / target <= 1.0 + PLAUSIBLE_BIAS:
            raise _other_level(record, probe.name, level, target, "Pa", test)


def _other_level(
    record: Record, name: str, found: float, target: float, unit: str, test: TestDescription
) -> InputError:
    return InputError(
        f"{record.source}: channel {name}",
        expected=f"about {target:g} {unit} at near stall, as {test.source} [near_stall] says",
        found=f"{found:g} {unit}",
        remedy="check the unit of the column, and the zero and calibrate readings"
        if unit == "Pa"
        else "check the unit of the column",
    )


def _sound_mean(record: Record, rows: slice, name: str, less: str | None = None) -> float | None:
    """Return the mean of a channel, or of what it is above another, where its readings count.

    None where they do not count in most of the rows.
    """
    names = [name] if less is None else [name, less]
    faults = [record[fault_name(n)] for n in names if fault_name(n) in record]
    n_rows = rows.stop - rows.start

    def readings() -> Iterator[FloatArray]:
        for block in blocks(n_rows):
            part = slice(rows.start + block.start, rows.start + block.stop)
            values = record[name][part] if less is None else record[name][part] - record[less][part]
            bad = np.zeros(values.size, dtype=np.bool_)
            for fault in faults:
                bad |= fault[part] != 0.0
            yield values[~bad] if faults else values

    n_sound = sum(part.size for part in readings())
    if n_sound == 0 or 2 * n_sound < n_rows:
        return None
    return mean(readings, workspace=record.workspace)


def match_near_stall(record: Record, test: TestDescription, match: str = "pair") -> Record:
    """Shift each channel so that its near-stall mean agrees with the facility's reading.

    The paper adjusts the forward probes to the plane-average total pressure and says nothing
    of the aft ones. The difference of a pair decides the flow, and its error does not average
    out near zero flow, where M grows with the root of it; so by default the aft probe is moved
    with its forward mate and the difference stays as the zero and calibrate readings give it.

    Parameters
    ----------
    record : Record
        Calibrated pressures and temperatures.
    test : TestDescription
        The facility's reading.
    match : {"pair", "forward", "none"}
        Move the pair as one; move the forward probe alone; move nothing.

    Returns
    -------
    Record
        The matched record; only biases change, no sensitivity.

    Raises
    ------
    InputError
        When a channel is off by more than a fifth of the reading.
    """
    found = match != "none" and not test.near_stall_shifts
    rows = near_stall_rows(record, test) if found else slice(0, 0)
    shifts, entry = _match(record, test, rows, match)
    changes = {name: _Change(shift=shift) for name, shift in shifts.items()}
    return record.after(entry, add=_changed(record, changes))


def _match(
    record: Record, test: TestDescription, rows: slice, match: str
) -> tuple[dict[str, float], LedgerEntry]:
    """Return the shift of each channel that is moved: as stated, or from the rows near stall."""
    if match == "none":
        return {}, LedgerEntry("near-stall match", "not applied", {"match": match})
    stated = test.near_stall_shifts

    def shift_of(name: str, target: float, unit: str) -> float:
        return stated.get(name, 0.0) if stated else _shift(record, name, rows, target, unit, test)

    by_channel: dict[str, float] = {}
    shifts: dict[str, str | int | float | bool] = {}
    for plane in test.areas_m2:
        for pair in test.pairs(plane):
            target = test.near_stall.pressure_Pa(plane)
            shift = shift_of(pair.forward.name, target, "Pa")
            moved = (pair.forward, pair.aft) if match == "pair" else (pair.forward,)
            shifts[f"shift_{pair.name}_Pa"] = round(shift, 2)
            by_channel |= {p.name: shift for p in moved}
        for couple in test.thermocouples(plane):
            target = test.near_stall.temperature_K(plane)
            shift = shift_of(couple.name, target, "K")
            shifts[f"shift_{couple.name}_K"] = round(shift, 4)
            by_channel[couple.name] = shift
    word = "forward probes with their aft mates" if match == "pair" else "forward probes alone"
    reading = test.near_stall
    how = f"to the facility reading of {reading.from_s:g} to {reading.to_s:g} s"
    flags: tuple[str, ...] = ()
    if stated:
        how = f"as {test.source} [near_stall_shifts] says"
        flags = ("the near-stall reading that it is matched by is not in this record",)
    return by_channel, LedgerEntry(
        "near-stall match",
        f"{word} and thermocouples moved {how}",
        {"match": match, **shifts},
        flags=(*flags, *common_shifts(test, by_channel)),
    )


def _shift(
    record: Record,
    name: str,
    rows: slice,
    target: float,
    unit: str,
    test: TestDescription,
) -> float:
    measured = _sound_mean(record, rows, name)
    if measured is None:
        # Most of its reading does not count: left alone here, it is dropped when the channels
        # are chosen.
        return 0.0
    if abs(measured - target) > (PLAUSIBLE_BIAS if unit == "Pa" else PLAUSIBLE_BIAS_K) * target:
        raise _other_level(record, name, measured, target, unit, test)
    return target - measured


def invert_thermocouples(record: Record, test: TestDescription, *, invert: bool = True) -> Record:
    """Undo the lag of the thermocouples, T + τ_tc dT/dt.

    Parameters
    ----------
    record : Record
        Temperatures in K, best after the low-pass: the derivative amplifies noise.
    test : TestDescription
        Time constant of each junction.
    invert : bool
        False leaves the temperatures alone and says so in the history.

    Returns
    -------
    Record
        With the temperatures of the gas.
    """
    if not invert:
        return record.after(LedgerEntry("thermocouples", "lag not inverted", {"invert": False}))
    couples = [c for c in test.temperatures if c.name in record]

    def gas_K(couple: TemperatureChannel, rows: slice) -> FloatArray:
        slope = rate_in(record[couple.name], rows, record.sample_period_s)
        return record[couple.name][rows] + couple.time_constant_s * slope

    place, n_rows = record.workspace, record.n_samples
    added = [Channel(c.name, place.derived(n_rows, partial(gas_K, c)), "K") for c in couples]
    entry = LedgerEntry(
        "thermocouples",
        f"lag of {len(couples)} junctions inverted by T + τ dT/dt",
        {"invert": True, **{f"tau_{c.name}_s": c.time_constant_s for c in couples}},
    )
    return record.after(entry, add=added)
