"""Counts to pascal and kelvin: zero and calibrate readings, near-stall match, thermocouples."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from classic_ml.errors import InputError
from classic_ml.readers.test_description import Converter, PressureChannel, TestDescription
from classic_ml.records import Channel, FloatArray, LedgerEntry, Record

__all__ = [
    "calibrate",
    "check_facing",
    "invert_thermocouples",
    "match_near_stall",
    "near_stall_rows",
    "pressure_from_counts",
    "volts",
]

# Fewer rows than this and the match is worth no more than one noisy reading.
MINIMUM_NEAR_STALL_ROWS = 20
# The match mends the drift of an amplifier. A reading that is off by more has another unit,
# or its zero and calibrate readings belong to another channel.
PLAUSIBLE_BIAS = 0.2


def volts(counts: FloatArray | float, adc: Converter) -> FloatArray:
    """Return the volts behind the codes of a converter."""
    return np.asarray(adc.low_V + np.asarray(counts, dtype=np.float64) * adc.volts_per_count)


def pressure_from_counts(
    channel: PressureChannel, adc: Converter, counts: FloatArray
) -> FloatArray:
    """Return the pressure that a transducer saw.

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
    zero_V = volts(channel.zero_count, adc)
    calibrate_V = volts(channel.calibrate_count, adc)
    sensitivity_V_Pa = (calibrate_V - zero_V) / channel.calibrate_pressure_Pa
    return np.asarray((volts(counts, adc) - zero_V) / sensitivity_V_Pa + channel.zoc_reference_Pa)


def calibrate(record: Record, test: TestDescription) -> Record:
    """Turn counts into pascal and indicated into total temperatures.

    Parameters
    ----------
    record : Record
        Counts and kelvin, as read.
    test : TestDescription
        Calibration of each channel.

    Returns
    -------
    Record
        Pressures in Pa; temperatures divided by the recovery factor T_i/T.
    """
    added = []
    for probe in test.pressures:
        channel = record.channel(probe.name)
        if channel.unit != "count":
            raise InputError(
                f"channel {probe.name}", expected='the unit "count"', found=f'"{channel.unit}"'
            )
        added.append(
            Channel(probe.name, pressure_from_counts(probe, test.adc, channel.values), "Pa")
        )
    for couple in test.temperatures:
        channel = record.channel(couple.name)
        if channel.unit != "K":
            raise InputError(
                f"channel {couple.name}", expected='the unit "K"', found=f'"{channel.unit}"'
            )
        added.append(Channel(couple.name, channel.values / couple.recovery_factor, "K"))
    entry = LedgerEntry(
        "calibrate",
        f"{len(test.pressures)} pressures from counts by their zero and calibrate readings, "
        f"{len(test.temperatures)} temperatures by their recovery factor",
        {"bits": test.adc.bits, "volts_per_count": test.adc.volts_per_count},
    )
    return record.after(entry, add=added)


def near_stall_rows(record: Record, test: TestDescription) -> NDArray[np.bool_]:
    """Return the rows that the facility's near-stall reading describes."""
    half = 0.5 * record.sample_period_s
    time_s = record.time_s
    reading = test.near_stall
    rows = (time_s >= reading.from_s - half) & (time_s <= reading.to_s + half)
    if np.count_nonzero(rows) < MINIMUM_NEAR_STALL_ROWS:
        raise InputError(
            f"{test.source}: [near_stall]",
            expected=f"an interval with at least {MINIMUM_NEAR_STALL_ROWS} rows of the record "
            f"({time_s[0]:.3f} to {time_s[-1]:.3f} s)",
            found=f"{reading.from_s:g} to {reading.to_s:g} s with {np.count_nonzero(rows)}",
        )
    return np.asarray(rows)


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
    rows = near_stall_rows(record, test)
    for plane in test.areas_m2:
        for pair in test.pairs(plane):
            good = rows & _sound(record, pair.forward.name) & _sound(record, pair.aft.name)
            if 2 * np.count_nonzero(good) < np.count_nonzero(rows):
                # A pair that does not count there is left out when the channels are chosen.
                continue
            below_Pa = float(np.mean(record[pair.aft.name][good] - record[pair.forward.name][good]))
            if below_Pa >= 0.0:
                raise InputError(
                    f"{record.source}: pair P{pair.name}",
                    expected="the forward probe above the aft one near stall",
                    found=f"{below_Pa / 1e3:.3g} kPa below",
                    remedy="are forward and aft exchanged?",
                )


def _sound(record: Record, name: str) -> NDArray[np.bool_]:
    fault = f"fault_{name}"
    if fault not in record:
        return np.ones(record.n_samples, dtype=np.bool_)
    return np.asarray(record[fault] == 0.0)


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
    if match == "none":
        return record.after(LedgerEntry("near-stall match", "not applied", {"match": match}))
    rows = near_stall_rows(record, test)
    added: list[Channel] = []
    shifts: dict[str, str | int | float | bool] = {}
    for plane in test.areas_m2:
        for pair in test.pairs(plane):
            target = test.near_stall.pressure_Pa(plane)
            shift = _shift(record, pair.forward.name, rows, target, "Pa", test)
            moved = (pair.forward, pair.aft) if match == "pair" else (pair.forward,)
            shifts[f"shift_{pair.name}_Pa"] = round(shift, 2)
            added += [Channel(p.name, record[p.name] + shift, "Pa") for p in moved]
        for couple in test.thermocouples(plane):
            target = test.near_stall.temperature_K(plane)
            shift = _shift(record, couple.name, rows, target, "K", test)
            shifts[f"shift_{couple.name}_K"] = round(shift, 4)
            added.append(Channel(couple.name, record[couple.name] + shift, "K"))
    word = "forward probes with their aft mates" if match == "pair" else "forward probes alone"
    entry = LedgerEntry(
        "near-stall match",
        f"{word} and thermocouples moved to the facility reading of {test.near_stall.from_s:g} to "
        f"{test.near_stall.to_s:g} s",
        {"match": match, **shifts},
    )
    return record.after(entry, add=added)


def _shift(
    record: Record,
    name: str,
    rows: NDArray[np.bool_],
    target: float,
    unit: str,
    test: TestDescription,
) -> float:
    good = rows & _sound(record, name)
    if 2 * np.count_nonzero(good) < np.count_nonzero(rows):
        # Most of its reading does not count: left alone here, it is dropped when the channels
        # are chosen.
        return 0.0
    mean = float(np.mean(record[name][good]))
    if abs(mean - target) > PLAUSIBLE_BIAS * target:
        raise InputError(
            f"{record.source}: channel {name}",
            expected=f"about {target:g} {unit} at near stall, as {test.source} [near_stall] says",
            found=f"{mean:g} {unit}",
            remedy="check the unit of the column, and the zero and calibrate readings",
        )
    return target - mean


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
    added = []
    for couple in couples:
        slope = np.gradient(record[couple.name], record.sample_period_s)
        added.append(
            Channel(couple.name, record[couple.name] + couple.time_constant_s * slope, "K")
        )
    entry = LedgerEntry(
        "thermocouples",
        f"lag of {len(couples)} junctions inverted by T + τ dT/dt",
        {"invert": True, **{f"tau_{c.name}_s": c.time_constant_s for c in couples}},
    )
    return record.after(entry, add=added)
