"""Counts to pascal and kelvin: zero and calibrate readings, near-stall match, thermocouples."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from classic_ml.description import (
    PLAUSIBLE_BIAS,
    PLAUSIBLE_BIAS_K,
    AnyChannel,
    CountChannel,
    TemperatureChannel,
    TestDescription,
)
from classic_ml.records import Channel, LedgerEntry, Record
from surge_core.errors import InputError
from surge_core.types import FloatArray

# Fewer rows than this and the match is worth no more than one noisy reading.
MINIMUM_NEAR_STALL_ROWS = 20
# The match moves clean probes by 0.5 % at most. One of a reversed sign is moved by twice what the
# facility is off the reference, within the noise of a reading.
MIRRORED, MIRROR_SHARE = 0.02, 0.05
# What a probe in the wake of its mate reads, over the total pressure, up to sonic flow.
LEAST_IN_WAKE = 0.5


def total_reading(
    channel: AnyChannel, test: TestDescription, readings: FloatArray, shift: float = 0.0
) -> FloatArray:
    """Return the pressure that a probe saw, or the total temperature, and a shift added to it.

    From codes P = (V − V_zero)/S + P_zoc with S = (V_calibrate − V_zero)/ΔP_calibrate. A
    thermocouple reads the total temperature times its recovery factor.
    """
    if isinstance(channel, TemperatureChannel):
        values = readings / channel.recovery_factor
    elif isinstance(channel, CountChannel):
        adc = test.adc
        zero_V, calibrate_V = (
            adc.low_V + count * adc.volts_per_count
            for count in (channel.zero_count, channel.calibrate_count)
        )
        sensitivity = (calibrate_V - zero_V) / channel.calibrate_pressure_Pa
        volts = adc.low_V + readings * adc.volts_per_count
        values = (volts - zero_V) / sensitivity + channel.zoc_reference_Pa
    else:
        values = readings
    return np.asarray(values + shift)


def calibrate(
    record: Record, test: TestDescription, shifts: Mapping[str, float] | None = None
) -> Record:
    """Turn counts into pascal and indicated into total temperatures, T_i over the recovery factor.

    ``shifts`` are added to the channels besides, in Pa and K, from :func:`near_stall_match`.
    """
    moved = shifts or {}
    added = []
    for channel in test.channels:
        values = total_reading(channel, test, record[channel.name], moved.get(channel.name, 0.0))
        added.append(Channel(channel.name, values, channel.si_unit))
    n_counts = sum(isinstance(probe, CountChannel) for probe in test.pressures)
    ways = []
    if n_counts:
        ways.append(f"{n_counts} pressures from counts by their zero and calibrate readings")
    if n_counts < len(test.pressures):
        ways.append(f"{len(test.pressures) - n_counts} pressures recorded as such")
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
            remedy="name its times by the clock of the record, which does not begin at 0"
            if reading.to_s < first_s
            else "",
        )
    return rows


def check_facing(record: Record, test: TestDescription) -> None:
    """Refuse a pair whose aft probe reads above its forward one in the steady flow near stall.

    The pressures are calibrated and not matched yet. A probe at no level of an exchanged pair is
    refused for its unit.
    """
    steady = record.part(near_stall_rows(record, test))
    for plane in test.areas_m2:
        target = test.near_stall.pressure_Pa(plane)
        for pair in test.pairs(plane):
            forward = _sound_mean(steady, pair.forward.name)
            aft = _sound_mean(steady, pair.aft.name)
            # A pair that does not count there is left out when the channels are chosen.
            if forward is None or aft is None or aft < forward:
                continue
            for probe, level, least in (
                (pair.forward, forward, LEAST_IN_WAKE),
                (pair.aft, aft, 1.0 - PLAUSIBLE_BIAS),
            ):
                if not least <= level / target <= 1.0 + PLAUSIBLE_BIAS:
                    raise _other_level(steady, probe.name, level, target, "Pa", test)
            raise InputError(
                f"{record.source}: pair P{pair.name}",
                expected="the forward probe above the aft one near stall",
                found=f"{(aft - forward) / 1e3:.3g} kPa below",
                remedy="are forward and aft exchanged?",
            )


def near_stall_match(record: Record, test: TestDescription) -> tuple[dict[str, float], LedgerEntry]:
    """Return what the near-stall match adds to each channel, in Pa and K, and how it was found.

    The paper adjusts the forward probes to the plane-average total pressure and says nothing
    of the aft ones. The difference of a pair decides the flow, and its error does not average
    out near zero flow, where M grows with the root of it; so the aft probe is moved with its
    forward mate and the difference stays as the zero and calibrate readings give it. Only biases
    change, no sensitivity. A channel whose reading does not count is left alone; one that is off by
    more than a fifth of the reading is refused. Where the test states the shifts, the record, which
    is calibrated, is not looked at.
    """
    stated = test.near_stall_shifts
    steady = None if stated else record.part(near_stall_rows(record, test))
    references_Pa = {
        p.name: p.zoc_reference_Pa if isinstance(p, CountChannel) else p.reference_Pa or 0.0
        for p in test.pressures
    }

    def shift_of(name: str, target: float, unit: str) -> float:
        if steady is None:
            return stated.get(name, 0.0)
        measured = _sound_mean(steady, name)
        if measured is None:
            # Left alone here, it is dropped when the channels are chosen.
            return 0.0
        off, asked = abs(measured - target), ""
        mirrored = abs(measured + target - 2.0 * references_Pa.get(name, np.inf))
        if off > MIRRORED * target and mirrored < MIRROR_SHARE * off:
            asked = "it is as far on the other side of its reference: is its sign reversed? "
        elif off <= target * (PLAUSIBLE_BIAS if unit == "Pa" else PLAUSIBLE_BIAS_K):
            return target - measured
        raise _other_level(steady, name, measured, target, unit, test, asked)

    shifts: dict[str, float] = {}
    parameters: dict[str, str | int | float | bool] = {"match": "pair"}
    for plane in test.areas_m2:
        for pair in test.pairs(plane):
            shift = shift_of(pair.forward.name, test.near_stall.pressure_Pa(plane), "Pa")
            shifts |= {pair.forward.name: shift, pair.aft.name: shift}
            parameters[f"shift_{pair.name}_Pa"] = round(shift, 2)
        for couple in test.thermocouples(plane):
            shift = shift_of(couple.name, test.near_stall.temperature_K(plane), "K")
            shifts[couple.name] = shift
            parameters[f"shift_{couple.name}_K"] = round(shift, 4)
    how = f"to the facility reading of {test.near_stall.from_s:g} to {test.near_stall.to_s:g} s"
    flags: tuple[str, ...] = ()
    if stated:
        how = f"as {test.source} [near_stall_shifts] says"
        flags = ("the near-stall reading that it is matched by is not in this record",)
    did = f"forward probes with their aft mates and thermocouples moved {how}"
    return shifts, LedgerEntry("near-stall match", did, parameters, flags=flags)


def invert_thermocouples(record: Record, test: TestDescription, *, invert: bool = True) -> Record:
    """Undo the lag of the thermocouples, T + τ_tc dT/dt, best after the low-pass.

    ``invert=False`` leaves the temperatures alone and says so in the history.
    """
    if not invert:
        return record.after(LedgerEntry("thermocouples", "lag not inverted", {"invert": False}))
    couples = [c for c in test.temperatures if c.name in record]
    added = []
    for couple in couples:
        slope_K_s = np.gradient(record[couple.name], record.sample_period_s)
        gas_K = record[couple.name] + couple.time_constant_s * slope_K_s
        added.append(Channel(couple.name, gas_K, "K"))
    entry = LedgerEntry(
        "thermocouples",
        f"lag of {len(couples)} junctions inverted by T + τ dT/dt",
        {"invert": True, **{f"tau_{c.name}_s": c.time_constant_s for c in couples}},
    )
    return record.after(entry, add=added)


def _sound_mean(steady: Record, name: str) -> float | None:
    """Return the mean of the readings that count, None where most of them do not."""
    sound = steady.marks(name) == 0
    return (
        float(np.mean(steady[name][sound])) if 2 * np.count_nonzero(sound) >= sound.size else None
    )


def _other_level(
    steady: Record,
    name: str,
    found: float,
    target: float,
    unit: str,
    test: TestDescription,
    asked: str = "",
) -> InputError:
    of_probe = unit == "Pa"
    return InputError(
        f"{steady.source}: channel {name}",
        expected=f"about {target:g} {unit} at near stall, as {test.source} [near_stall] says",
        found=f"{found:g} {unit}, readings from {np.min(steady[name]):g} to "
        f"{np.max(steady[name]):g}",
        remedy=f"{asked}check that from_s to to_s end before the surge, the units of the column "
        f"and of [near_stall]{', and the zero and calibrate readings' if of_probe else ''}; a dead "
        f"channel may be left out of test.toml{' with its mate' if of_probe else ''}",
    )
