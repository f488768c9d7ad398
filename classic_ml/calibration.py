"""Counts to pascal and kelvin: zero and calibrate readings, near-stall match, thermocouples."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from classic_ml.description import (
    PLAUSIBLE_BIAS,
    PLAUSIBLE_BIAS_K,
    Converter,
    PressureChannel,
    ProbePair,
    TemperatureChannel,
    TestDescription,
)
from classic_ml.records import Channel, LedgerEntry, Record, fault_name
from surge_core.errors import InputError
from surge_core.types import FloatArray

__all__ = [
    "calibrate",
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
    zero_V = float(volts(channel.zero_count, adc))
    calibrate_V = float(volts(channel.calibrate_count, adc))
    sensitivity_V_Pa = (calibrate_V - zero_V) / channel.calibrate_pressure_Pa
    pressure_Pa = volts(counts, adc) - zero_V
    # In place: of long records it is new memory that takes the time.
    pressure_Pa /= sensitivity_V_Pa
    pressure_Pa += channel.zoc_reference_Pa
    return np.asarray(pressure_Pa)


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


def calibrate(
    record: Record, test: TestDescription, shifts: Mapping[str, float] | None = None
) -> Record:
    """Turn counts into pascal and indicated into total temperatures.

    Parameters
    ----------
    record : Record
        Counts or Pa, and kelvin, as read.
    test : TestDescription
        Calibration of each channel.
    shifts : mapping of str to float, optional
        What is added to each channel besides, in Pa and K, from :func:`near_stall_match`.

    Returns
    -------
    Record
        Pressures in Pa; temperatures divided by the recovery factor T_i/T.
    """
    _check_units(record, test)
    in_counts = [probe for probe in test.pressures if probe.record_unit == "count"]
    added = []
    for probe in test.pressures:
        shift = 0.0 if shifts is None else shifts.get(probe.name, 0.0)
        if probe in in_counts:
            pressure_Pa = pressure_from_counts(probe, test.adc, record[probe.name])
            pressure_Pa += shift
            added.append(Channel.adopt(probe.name, pressure_Pa, "Pa"))
        elif shift != 0.0:
            added.append(Channel.adopt(probe.name, record[probe.name] + shift, "Pa"))
    for couple in test.temperatures:
        total_K = record[couple.name] / couple.recovery_factor
        total_K += 0.0 if shifts is None else shifts.get(couple.name, 0.0)
        added.append(Channel.adopt(couple.name, total_K, "K"))
    ways = []
    if in_counts:
        ways.append(f"{len(in_counts)} pressures from counts by their zero and calibrate readings")
    if len(in_counts) < len(test.pressures):
        ways.append(f"{len(test.pressures) - len(in_counts)} pressures recorded as such")
    ways.append(f"{len(test.temperatures)} temperatures by their recovery factor")
    adc = test.converter
    parameters: dict[str, str | int | float | bool] = (
        {} if adc is None else {"bits": adc.bits, "volts_per_count": adc.volts_per_count}
    )
    return record.after(LedgerEntry("calibrate", ", ".join(ways), parameters), add=added)


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
    steady = record.part(near_stall_rows(record, test))
    for plane in test.areas_m2:
        for pair in test.pairs(plane):
            forward, aft = pair.forward.name, pair.aft.name
            sound = _sound(steady, forward) & _sound(steady, aft)
            # A pair that does not count there is left out when the channels are chosen.
            if 2 * np.count_nonzero(sound) < sound.size:
                continue
            below_Pa = float(np.mean((steady[aft] - steady[forward])[sound]))
            if below_Pa >= 0.0:
                _check_levels(steady, test, pair)
                raise InputError(
                    f"{record.source}: pair P{pair.name}",
                    expected="the forward probe above the aft one near stall",
                    found=f"{below_Pa / 1e3:.3g} kPa below",
                    remedy="are forward and aft exchanged?",
                )


def near_stall_match(
    record: Record, test: TestDescription, match: str = "pair"
) -> tuple[dict[str, float], LedgerEntry]:
    """Return what the near-stall match adds to each channel that it moves, and how it was found.

    Parameters
    ----------
    record : Record
        Calibrated pressures and temperatures.
    test : TestDescription
        The facility's reading.
    match : {"pair", "forward", "none"}
        As :func:`match_near_stall` takes it.

    Returns
    -------
    dict of str to float
        By channel, in Pa and K; 0 for one whose reading does not count.
    LedgerEntry
        The step.
    """
    if match == "none":
        return {}, LedgerEntry("near-stall match", "not applied", {"match": match})
    stated = test.near_stall_shifts
    steady = None if stated else record.part(near_stall_rows(record, test))

    def shift_of(name: str, target: float, unit: str) -> float:
        if steady is None:
            return stated.get(name, 0.0)
        return _shift(steady, name, target, unit, test)

    shifts: dict[str, float] = {}
    parameters: dict[str, str | int | float | bool] = {"match": match}
    for plane in test.areas_m2:
        for pair in test.pairs(plane):
            shift = shift_of(pair.forward.name, test.near_stall.pressure_Pa(plane), "Pa")
            moved = (pair.forward, pair.aft) if match == "pair" else (pair.forward,)
            shifts |= {probe.name: shift for probe in moved}
            parameters[f"shift_{pair.name}_Pa"] = round(shift, 2)
        for couple in test.thermocouples(plane):
            shift = shift_of(couple.name, test.near_stall.temperature_K(plane), "K")
            shifts[couple.name] = shift
            parameters[f"shift_{couple.name}_K"] = round(shift, 4)
    word = "forward probes with their aft mates" if match == "pair" else "forward probes alone"
    how = f"to the facility reading of {test.near_stall.from_s:g} to {test.near_stall.to_s:g} s"
    flags: tuple[str, ...] = ()
    if stated:
        how = f"as {test.source} [near_stall_shifts] says"
        flags = ("the near-stall reading that it is matched by is not in this record",)
    did = f"{word} and thermocouples moved {how}"
    return shifts, LedgerEntry("near-stall match", did, parameters, flags=flags)


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
    shifts, entry = near_stall_match(record, test, match)
    moved = [
        Channel.adopt(name, record[name] + shift, record.channel(name).unit)
        for name, shift in shifts.items()
    ]
    return record.after(entry, add=moved)


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
    added = []
    couples = [c for c in test.temperatures if c.name in record]
    for couple in couples:
        indicated_K = record[couple.name]
        slope_K_s = np.gradient(indicated_K, record.sample_period_s)
        gas_K = indicated_K + couple.time_constant_s * slope_K_s
        added.append(Channel.adopt(couple.name, gas_K, "K"))
    entry = LedgerEntry(
        "thermocouples",
        f"lag of {len(couples)} junctions inverted by T + τ dT/dt",
        {"invert": True, **{f"tau_{c.name}_s": c.time_constant_s for c in couples}},
    )
    return record.after(entry, add=added)


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


def _sound(steady: Record, name: str) -> np.ndarray:
    """Return the rows in which a channel's readings count."""
    fault = fault_name(name)
    return steady[fault] == 0 if fault in steady else np.ones(steady.n_samples, dtype=np.bool_)


def _sound_mean(steady: Record, name: str) -> float | None:
    """Return the mean of the readings that count, None where most of them do not."""
    sound = _sound(steady, name)
    if 2 * np.count_nonzero(sound) < sound.size:
        return None
    return float(np.mean(steady[name][sound]))


def _shift(steady: Record, name: str, target: float, unit: str, test: TestDescription) -> float:
    measured = _sound_mean(steady, name)
    if measured is None:
        # Left alone here, it is dropped when the channels are chosen.
        return 0.0
    if abs(measured - target) > (PLAUSIBLE_BIAS if unit == "Pa" else PLAUSIBLE_BIAS_K) * target:
        raise _other_level(steady, name, measured, target, unit, test)
    return target - measured


def _check_levels(steady: Record, test: TestDescription, pair: ProbePair) -> None:
    """Refuse a probe that is at no level of an exchanged pair: it has another unit, or range."""
    target = test.near_stall.pressure_Pa(pair.forward.plane)
    for probe, least in ((pair.forward, LEAST_IN_WAKE), (pair.aft, 1.0 - PLAUSIBLE_BIAS)):
        level = _sound_mean(steady, probe.name)
        if level is not None and not least <= level / target <= 1.0 + PLAUSIBLE_BIAS:
            raise _other_level(steady, probe.name, level, target, "Pa", test)


def _other_level(
    steady: Record, name: str, found: float, target: float, unit: str, test: TestDescription
) -> InputError:
    return InputError(
        f"{steady.source}: channel {name}",
        expected=f"about {target:g} {unit} at near stall, as {test.source} [near_stall] says",
        found=f"{found:g} {unit}, readings from {np.min(steady[name]):g} to "
        f"{np.max(steady[name]):g}",
        remedy="check that from_s to to_s end before the surge, the unit of the column"
        + (" and the zero and calibrate readings" if unit == "Pa" else ""),
    )
