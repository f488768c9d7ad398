"""The whole reduction: a raw record in, the series of coefficients out."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from classic_ml.calibration import (
    calibrate,
    check_facing,
    invert_thermocouples,
    near_stall_match,
    near_stall_rows,
)
from classic_ml.coefficients import coefficients, corrected_speed_fraction
from classic_ml.cycles import FEW_CYCLES, cycles_within, find_cycles
from classic_ml.description import TestDescription
from classic_ml.faults.choice import choose_channels, with_faults_bridged
from classic_ml.faults.near_stall import check_near_stall
from classic_ml.faults.search import inspect_readings
from classic_ml.filters import filter_channels, filter_entry, low_pass
from classic_ml.free_run import extend_while_settled, free_run_rows
from classic_ml.planes import local_flows, plane_averages
from classic_ml.records import Channel, Dropped, LedgerEntry, Record, fault_name, ledger_grid
from classic_ml.reduction_settings import ReductionSettings
from classic_ml.segments import (
    cell_frequency_hz,
    estimated_threshold_lbm_s,
    segment,
    window_rows,
)
from classic_ml.series import CoefficientSeries
from classic_ml.work.forms import with_work
from surge_core.display import Displayed, Field, Sheet
from surge_core.errors import InputError
from surge_core.types import FloatArray

__all__ = ["STEPS", "Reduction", "ReductionSettings", "near_stall_shifts", "reduce_record"]

# As often as a reduction reports that it has got further.
STEPS = 6
# With the right threshold 1 to 15 % of the window on 13 simulated records; with half of it, as
# where it was meant in kg/s, 27 to 29 % at 90 to 98.5 % speed.
REGIMES_DIFFER = 0.2
# The slowest surge cycles last some seconds; what a filter below leaves of others is none.
LEAST_CUTOFF_HZ = 1.0
# What the window is looked for with.
AHEAD = ReductionSettings()


@dataclass(frozen=True)
class Reduction(Displayed):
    """What a reduction gives.

    Parameters
    ----------
    series : CoefficientSeries
        φ, ψ', ψ over the whole record, with the segments to be fitted.
    record : Record
        The channels behind it, filtered and not, and the full history.
    settings : ReductionSettings
        The switches it ran with.
    test : TestDescription
        The test.
    window_s : tuple of float
        The quasi-steady cycles.
    """

    series: CoefficientSeries
    record: Record
    settings: ReductionSettings
    test: TestDescription
    window_s: tuple[float, float]

    def _sheet(self) -> Sheet:
        settings, (from_s, to_s) = self.settings, self.window_s
        filtered = f"order {settings.filter_order} at {settings.cutoff_hz:g} Hz"
        filtered += f", phase “{settings.phase}”"
        flags = tuple(flag for entry in self.record.history for flag in entry.flags)
        fields = (
            Field("test", self.test.name),
            Field("quasi-steady cycles", f"{from_s:.3f} to {to_s:.3f} s"),
            Field("low-pass", "none" if settings.phase == "none" else filtered),
            *self.series.fields(),
            *((Field("flags", flags, "advice"),) if flags else ()),
        )
        return Sheet("Reduction", fields, ledger_grid(self.record.history))


def reduce_record(
    record: Record,
    test: TestDescription,
    settings: ReductionSettings | None = None,
    *,
    keep_probes: bool = True,
    progress: Callable[[int], object] | None = None,
) -> Reduction:
    """Reduce a raw record to the series of coefficients.

    Parameters
    ----------
    record : Record
        Counts and kelvin, as :func:`classic_ml.io.read_raw` returns them.
    test : TestDescription
        The test they belong to.
    settings : ReductionSettings, optional
        The switches.
    keep_probes : bool
        Keep readings, faults and flows of the single probes in the record beside the averages;
        without them it takes a third of the room.
    progress : callable, optional
        Called each time that one of the ``STEPS`` steps is done.

    Returns
    -------
    Reduction
        Series, record with its history, settings.

    Raises
    ------
    InputError
        When the record cannot be used; the sentence says why.
    """
    chosen = settings if settings is not None else ReductionSettings()
    if chosen.phase != "none" and chosen.cutoff_hz < LEAST_CUTOFF_HZ:
        raise InputError(
            "ReductionSettings.cutoff_hz",
            expected=f"at least {LEAST_CUTOFF_HZ:g} Hz, so that the surge cycles pass",
            found=f"{chosen.cutoff_hz:g}",
        )
    done = progress if progress is not None else _unreported
    record = _matched(inspect_readings(record, test, whole=True), test, chosen.near_stall_match)
    done(1)
    cache: _Filtered = {}
    window_s, found = _window(record, test, chosen, cache)
    window = window_rows(record, window_s, _window_name(record, test, chosen))
    record = choose_channels(record.after(found), test, window)
    was_named = found.parameters["origin"] != "found"
    done(1)
    unfiltered = _unfiltered(record, test, chosen)
    done(1)
    # A stated window is not extended.
    in_use = [name for name in test.channel_names if name in record]
    inside = window if was_named else extend_while_settled(unfiltered, window, in_use)
    averaged = _averaged(_low_passed(record, test, chosen, cache), test, chosen)
    del record
    cache.clear()
    if not keep_probes:
        averaged = averaged.without(_of_probes(averaged, test))
    done(1)
    reduced = _with_coefficients(averaged, unfiltered, test, chosen, window)
    del averaged
    done(1)
    if was_named and (flags := cycles_within(reduced, window_s)):
        reduced = reduced.after(LedgerEntry("cycles", "counted in the window", flags=flags))
    reduced, threshold = _segmented(reduced, unfiltered, test, chosen, window)
    reduced = _with_free_run(reduced, unfiltered, window, inside, chosen.probes)
    reduced = _regimes_compared(reduced, window, threshold)
    done(1)
    return Reduction(_series(reduced), reduced, chosen, test, window_s)


def near_stall_shifts(record: Record, test: TestDescription) -> dict[str, float]:
    """Return the near-stall match of a record, to be stated for one that continues it.

    Parameters
    ----------
    record : Record
        As read, with the near-stall reading in it.
    test : TestDescription
        Its test.

    Returns
    -------
    dict of str to float
        As ``TestDescription.near_stall_shifts`` takes them, in Pa and K: by forward probe and
        thermocouple, without those that cannot be matched.

    Raises
    ------
    InputError
        When :func:`reduce_record` would refuse the reading.
    """
    inspected = inspect_readings(record, test, whole=True)
    steady = calibrate(inspected.part(near_stall_rows(inspected, test)), test)
    shifts, _ = near_stall_match(steady, test)
    sound = choose_channels(_matched(inspected, test, "pair"), test, slice(0, 0))
    forward = [probe.name for probe in test.pressures if probe.facing == "forward"]
    named = [*forward, *(couple.name for couple in test.temperatures)]
    return {name: shifts[name] for name in named if name in sound}


def _unreported(_: int) -> None:
    """Report nothing."""


def _matched(inspected: Record, test: TestDescription, match: str) -> Record:
    """Calibrate, check how the probes face, match near stall, and check the flow there."""
    steady = inspected
    if not test.near_stall_shifts:
        steady = calibrate(inspected.part(near_stall_rows(inspected, test)), test)
        check_facing(steady, test)
    shifts, entry = near_stall_match(steady, test, match)
    matched = calibrate(inspected, test, shifts).after(entry)
    return matched.after(check_near_stall(matched, test, shifts))


# Of each channel the readings that were filtered and the result: what the window is found in is
# what is reduced, but for channels that are bridged in one of them.
_Filtered = dict[str, tuple[FloatArray, FloatArray]]


def _low_passed(
    record: Record, test: TestDescription, settings: ReductionSettings, cache: _Filtered
) -> Record:
    """Filter all channels alike; what is in the cache as it is is taken from there."""
    rate, names = record.sample_rate_hz, [n for n in test.channel_names if n in record]
    order, cutoff_hz, phase = settings.filter_order, settings.cutoff_hz, settings.phase
    if (order, cutoff_hz, phase) != (AHEAD.filter_order, AHEAD.cutoff_hz, AHEAD.phase):
        return filter_channels(record, names, order=order, cutoff_hz=cutoff_hz, phase=phase)
    for name in names:
        if name not in cache or cache[name][0] is not record[name]:
            smooth = low_pass(record[name], rate, order=order, cutoff_hz=cutoff_hz, phase=phase)
            cache[name] = record[name], smooth
    added = [Channel.adopt(n, cache[n][1], record.channel(n).unit) for n in names]
    entry = filter_entry(len(names), rate, order=order, cutoff_hz=cutoff_hz, phase=phase)
    return record.after(entry, add=added)


def _averaged(filtered: Record, test: TestDescription, settings: ReductionSettings) -> Record:
    """Undo the thermocouple lag where asked for, and average over each plane."""
    inverted = invert_thermocouples(filtered, test, invert=settings.thermocouple_inversion)
    return plane_averages(local_flows(inverted, test), test, settings.probes)


def _of_probes(record: Record, test: TestDescription) -> Iterable[str]:
    """Return the channels of a record that belong to single probes."""
    pairs = [pair for plane in test.areas_m2 for pair in test.pairs(plane)]
    for name in test.channel_names:
        yield from (name, fault_name(name))
    for pair in pairs:
        yield from (f"Wc{pair.name}_kg_s", f"Pt{pair.name}_Pa")


def _unfiltered(record: Record, test: TestDescription, settings: ReductionSettings) -> Record:
    """Reduce without any low-pass, for the free run, for spectra and for Fig 5 and 6.

    The thermocouples' lag is undone whatever the settings say: behind no filter it is what it is.
    """
    plain = record.after(LedgerEntry("filter", "no low-pass filter"))
    plain = invert_thermocouples(plain, test)
    plain = plane_averages(local_flows(plain, test), test, settings.probes)
    faults = {fault_name(name) for name in test.channel_names}
    plain = plain.without(set(_of_probes(plain, test)) - faults)
    plain = coefficients(plain, test, inertia_factor=settings.inertia_factor)
    return plain.after(
        LedgerEntry("keep", "P25 under the name that it has beside the filtered one"),
        add=[replace(plain.channel("P25_Pa"), name="P25_unfiltered_Pa")],
    )


def _with_coefficients(
    averaged: Record,
    unfiltered: Record,
    test: TestDescription,
    settings: ReductionSettings,
    window: slice,
) -> Record:
    """Compute the coefficients of the averages, and lay the unfiltered ones beside them."""
    record = coefficients(averaged, test, inertia_factor=settings.inertia_factor)
    if "W31_kg_s" in record:
        # What the mass balance averages over where no filter takes the cells out.
        period_s = None
        if settings.phase == "none":
            period_s = 1.0 / cell_frequency_hz(unfiltered, window)
        inertia = settings.inertia_factor * test.compressor.inertia_per_m
        record = with_work(record, test, inertia, settings.work_form, period_s)
    else:
        dropped = Dropped("ψ", record.n_samples, "no T31 that counts, so no W31")
        record = record.after(LedgerEntry("work coefficient", "ψ is not known", {}, (dropped,)))
    names = {
        "P25_Pa": "P25_unfiltered_Pa",
        "P31_Pa": "P31_unfiltered_Pa",
        "Wc25_kg_s": "Wc25_unfiltered_kg_s",
        "phi": "phi_unfiltered",
        "psi_p": "psi_p_unfiltered",
    }
    kept = [replace(unfiltered.channel(old), name=new) for old, new in names.items()]
    entry = LedgerEntry("keep", "plane averages, φ and ψ' of the unfiltered pressures kept")
    return record.after(entry, add=kept)


def _with_free_run(
    record: Record, unfiltered: Record, window: slice, inside: slice, probes: str
) -> Record:
    """Mark the rows of the free run."""
    rows = free_run_rows(unfiltered, unfiltered["phi"], window, inside, record["in_stall"])
    entry = rows.entry
    if probes != "all":
        flag = (
            f"the flow is that of the {probes} alone, not of the plane: the shift between hub and "
            "tip enters φ, and neither the curve nor the time constant can be quoted"
        )
        entry = replace(
            entry, parameters={**entry.parameters, "probes": probes}, flags=(*entry.flags, flag)
        )
    return record.after(entry, add=rows.channels)


def _regimes_compared(record: Record, window: slice, threshold_lbm_s: float | None) -> Record:
    """Flag where the threshold gives other regimes than hub and tip themselves do."""
    if threshold_lbm_s is None:
        return record
    share = float(np.mean(record["in_stall"][window] != record["stalled"][window]))
    if share <= REGIMES_DIFFER:
        return record
    entry = LedgerEntry(
        "regimes",
        f"threshold and hub-minus-tip flow agree in {1.0 - share:.0%} of the window",
        {"share": round(share, 4)},
        flags=(
            f"the threshold of {threshold_lbm_s:g} lbm/s gives another regime than hub and "
            f"tip do in {share:.0%} of the window: is it in lbm/s?",
        ),
    )
    return record.after(entry)


def _window_name(record: Record, test: TestDescription, settings: ReductionSettings) -> str:
    """Return what to call the window in an error: where it was named."""
    if settings.window_s is not None:
        return f"{record.source}: ReductionSettings.window_s"
    return f"{test.source}: [window]" if test.window_s is not None else f"{record.source}: window"


def _window(
    record: Record, test: TestDescription, settings: ReductionSettings, cache: _Filtered
) -> tuple[tuple[float, float], LedgerEntry]:
    """Return the quasi-steady window, and where it came from."""
    for window_s, origin in ((settings.window_s, "the settings"), (test.window_s, test.source)):
        if window_s is not None:
            entry = LedgerEntry(
                "window",
                f"{window_s[0]:g} to {window_s[1]:g} s, as {origin} says",
                {"from_s": window_s[0], "to_s": window_s[1], "origin": origin},
            )
            return window_s, entry
    # Looked for in all channels, bridged: which of them can be used depends on the window, and a
    # dropout must not end it.
    ahead = _low_passed(with_faults_bridged(record, test), test, AHEAD, cache)
    ahead = _averaged(ahead, test, AHEAD)
    speed = Channel("Nc_frac", corrected_speed_fraction(ahead["T25_K"], test), "1")
    cycles = find_cycles(ahead.after(LedgerEntry("speed", "of the window"), add=[speed]))
    flags: tuple[str, ...] = ()
    if cycles.n_cycles < FEW_CYCLES:
        flags = (f"only {cycles.n_cycles} cycles: the time constant will be uncertain",)
    if cycles.mild:
        flags += (
            f"the flow swings by {cycles.flow_swing:.0%} of its level before the surge only: the "
            "machine oscillates in stall, and no deep surge cycle is in the record",
        )
    entry = LedgerEntry(
        "window",
        f"{cycles.from_s:.3f} to {cycles.to_s:.3f} s: {cycles.n_cycles} cycles of "
        f"{cycles.period_s * 1e3:.0f} ms that repeat each other; the first reversal is at "
        f"{cycles.first_reversal_s:.3f} s",
        {
            "from_s": round(cycles.from_s, 6),
            "to_s": round(cycles.to_s, 6),
            "n_cycles": cycles.n_cycles,
            "left_out_cycles": cycles.left_out,
            "origin": "found",
        },
        flags=flags,
    )
    return (cycles.from_s, cycles.to_s), entry


def _threshold(
    unfiltered: Record,
    record: Record,
    test: TestDescription,
    settings: ReductionSettings,
    window: slice,
) -> tuple[float | None, LedgerEntry | None]:
    """Return the flow between the regimes, None where all is in stall, and how it was estimated."""
    stated = settings.threshold_lbm_s
    stated = test.threshold_lbm_s if stated is None else stated
    if stated == "none":
        return None, None
    if stated is not None:
        return float(stated), None
    return estimated_threshold_lbm_s(unfiltered, record["Wc25_kg_s"], window)


def _segmented(
    record: Record,
    unfiltered: Record,
    test: TestDescription,
    settings: ReductionSettings,
    window: slice,
) -> tuple[Record, float | None]:
    threshold, entry = _threshold(unfiltered, record, test, settings, window)
    if entry is not None:
        record = record.after(entry)
    hysteresis = settings.hysteresis_lbm_s
    if hysteresis is not None and threshold is not None and hysteresis >= threshold:
        raise InputError(
            "ReductionSettings.hysteresis_lbm_s",
            expected=f"less than the threshold of {threshold:g} lbm/s",
            found=f"{hysteresis:g}",
        )
    try:
        segmented = segment(
            record,
            window,
            threshold_lbm_s=threshold,
            hysteresis_lbm_s=test.hysteresis_lbm_s if hysteresis is None else hysteresis,
            stall_rule=settings.stall_rule,
        )
    except InputError as error:
        if not error.where.endswith(": segmentation"):
            raise
        # Nothing in stall is what a window before the surge holds.
        where = _window_name(record, test, settings)
        raise InputError(
            where, expected=error.expected, found=error.found, remedy=error.remedy
        ) from None
    return segmented, threshold


def _series(record: Record) -> CoefficientSeries:
    psi = record["psi"] if "psi" in record.channels else None
    return CoefficientSeries(
        time_s=record.time_s,
        phi=record["phi"],
        psi_p=record["psi_p"],
        psi=psi,
        T25_K=record["T25_K"],
        Nc_frac=record["Nc_frac"],
        in_stall=record["in_stall"].astype(np.bool_),
        segment=record["segment"].astype(np.int64),
        phi_unfiltered=record["phi_unfiltered"],
        psi_p_unfiltered=record["psi_p_unfiltered"],
        stalled=record["stalled"].astype(np.bool_),
        free_run=record["free_run"].astype(np.int64),
        source=record.source,
        history=record.history,
    )
