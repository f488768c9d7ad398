"""The whole reduction: a raw record in, the series of coefficients out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from classic_ml.calibration import calibrate_and_match, invert_thermocouples, near_stall_match
from classic_ml.coefficients import coefficients, corrected_speed_fraction
from classic_ml.columns.computed import as_stored
from classic_ml.columns.workspace import blocks
from classic_ml.faults.choice import choose_channels, with_faults_bridged
from classic_ml.faults.near_stall_flows import check_flows
from classic_ml.faults.search import inspect_readings
from classic_ml.free_run_rows import extend_while_settled, free_run_rows
from classic_ml.look_ahead import LookAhead, look_ahead, probe_averages, without
from classic_ml.plane_averages import plane_flows
from classic_ml.readers.test_description import TestDescription
from classic_ml.records import Channel, LedgerEntry, Record, ledger_grid
from classic_ml.reduction_settings import ReductionSettings
from classic_ml.segments import (
    HUB_LESS_TIP,
    cell_frequency_hz,
    hub_tip_difference,
    knows_hub_and_tip,
    segment,
    window_rows,
)
from classic_ml.series import COLUMNS, CoefficientSeries, series_fields
from classic_ml.surge_cycles import FEW_CYCLES, cycles_within, find_cycles
from surge_core.display import Displayed, Field, Sheet
from surge_core.errors import InputError
from surge_core.types import FloatArray

__all__ = ["STEPS", "Reduction", "ReductionSettings", "near_stall_shifts", "reduce_record"]

# As often as a reduction tells that it has got further.
STEPS = 6

# With the right threshold 1 to 15 % of the window on 13 simulated records; with half of it, as
# where it was meant in kg/s, 27 to 29 % at 90 to 98.5 % speed.
REGIMES_DIFFER = 0.2
# The slowest surge cycles last some seconds; what a filter below leaves of others is none.
LEAST_CUTOFF_HZ = 1.0
# What is in the record of a reduction beside the series.
Keep = Literal["probes", "averages", "series"]
# What the free run is chosen by, and φ and ψ' are made of.
UNFILTERED_AVERAGES = (
    *("P25_Pa", "P31_Pa", "T25_K", "W25_kg_s"),
    *("Wc25_kg_s", "Wc25_hub_kg_s", "Wc25_tip_kg_s"),
)
# The channels of the series; its clock is none.
IN_SERIES = tuple(name for name in COLUMNS if name != "time_s")
# What the coefficients are computed from.
COMPUTED_FROM = ("P25_Pa", "T25_K", "W25_kg_s", "P31_Pa", "T31_K", "W31_kg_s")
# What the segments and the rows of the free run are chosen by.
CHOSEN_BY = ("Wc25_kg_s", "P31_Pa", "P25_unfiltered_Pa")


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
        low_pass = (
            "none"
            if settings.phase == "none"
            else f"order {settings.filter_order} at {settings.cutoff_hz:g} Hz, "
            f"phase “{settings.phase}”"
        )
        flags = tuple(flag for entry in self.record.history for flag in entry.flags)
        fields = (
            Field("test", self.test.name),
            Field("quasi-steady cycles", f"{from_s:.3f} to {to_s:.3f} s"),
            Field("low-pass", low_pass),
            *series_fields(self.series),
            *((Field("flags", flags, "advice"),) if flags else ()),
        )
        return Sheet("Reduction", fields, ledger_grid(self.record.history))


def reduce_record(
    record: Record,
    test: TestDescription,
    settings: ReductionSettings | None = None,
    *,
    keep: Keep = "probes",
    progress: Callable[[int], object] | None = None,
) -> Reduction:
    """Reduce a raw record to the series of coefficients.

    Parameters
    ----------
    record : Record
        Counts and kelvin, as :func:`classic_ml.readers.read_raw` returns them.
    test : TestDescription
        The test they belong to.
    settings : ReductionSettings, optional
        The switches.
    keep : {"probes", "averages", "series"}
        What is in the record: everything; no readings, faults and flows of single probes, so that
        it takes a third of the room in memory (on disk some averages are computed when they are
        read, from the readings, which stay there); or the channels of the series alone, which lets
        the readings go as soon as those have been computed.
    progress : callable, optional
        Told each time that one of the ``STEPS`` steps is done.

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
    _check(chosen, keep)
    kept = _kept(keep, chosen)
    step = progress if progress is not None else _nobody
    record = inspect_readings(record, test, whole=True)
    step(1)
    record = calibrate_and_match(record, test, chosen.near_stall_match)
    record = record.after(check_flows(record, test))
    step(1)
    window_s, found, ahead = _window(record, test, chosen)
    window = window_rows(record, window_s, _window_name(record, test, chosen))
    record = choose_channels(record.after(found), test, window)
    step(1)
    averaged = probe_averages(record, test, chosen, keep_probes=keep == "probes", ahead=ahead)
    was_named = ahead is None
    # What was left out of the record goes, too.
    del ahead
    step(1)
    plain, unfiltered = _unfiltered(record, test, chosen)
    in_use = tuple(name for name in test.channel_names if name in record)
    # From here on the readings are there for those alone who asked for them.
    averaged = _only(averaged, kept.averages)
    unfiltered = [channel for channel in unfiltered if kept.averages(channel.name)]
    place, n_rows = record.workspace, record.n_samples
    del record
    place.tidy(but_rows=n_rows)
    # A window that somebody named is not extended.
    inside = window if was_named else extend_while_settled(plain, window, in_use)
    record = _with_coefficients(averaged, unfiltered, test, chosen, window)
    del averaged, unfiltered
    record = _only(record, kept.coefficients)
    step(1)
    if was_named:
        record = _few_cycles_told(record, window_s)
    record = _segmented(record, test, chosen, window)
    record = _with_free_run(record, plain, window, inside, chosen.probes)
    record = _regimes_compared(record, window, _threshold(test, chosen))
    record = _only(record, kept.result)
    step(1)
    return Reduction(_series(record), record, chosen, test, window_s)


def _check(settings: ReductionSettings, keep: Keep) -> None:
    if settings.phase != "none" and settings.cutoff_hz < LEAST_CUTOFF_HZ:
        raise InputError(
            "ReductionSettings.cutoff_hz",
            expected=f"at least {LEAST_CUTOFF_HZ:g} Hz, so that the surge cycles pass",
            found=f"{settings.cutoff_hz:g}",
        )
    if keep not in get_args(Keep):
        raise InputError("keep", expected=" or ".join(get_args(Keep)), found=repr(keep))


@dataclass(frozen=True)
class _Kept:
    """Which channels stay when the averages are there, the coefficients, and at the end."""

    averages: Callable[[str], bool]
    coefficients: Callable[[str], bool]
    result: Callable[[str], bool]


def _kept(keep: Keep, settings: ReductionSettings) -> _Kept:
    def every(_: str) -> bool:
        return True

    if keep == "probes":
        return _Kept(every, every, every)
    if keep == "averages":
        return _Kept(every, every, lambda name: not name.startswith("fault_"))
    needed = {*IN_SERIES, *CHOSEN_BY}
    if settings.stall_rule == "hub-tip":
        needed |= {"Wc25_hub_kg_s", "Wc25_tip_kg_s"}
    computed_from = needed | set(COMPUTED_FROM)
    return _Kept(computed_from.__contains__, needed.__contains__, IN_SERIES.__contains__)


def near_stall_shifts(record: Record, test: TestDescription) -> dict[str, float]:
    """Return what the near-stall match of a record adds, for a record that goes on with its test.

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
    shifts, _ = near_stall_match(inspected, test)
    matched = calibrate_and_match(inspected, test)
    check_flows(matched, test)
    sound = choose_channels(matched, test, slice(0, 0))
    forward = [probe.name for probe in test.pressures if probe.facing == "forward"]
    named = [*forward, *(couple.name for couple in test.temperatures)]
    return {name: shifts[name] for name in named if name in sound}


def _nobody(_: int) -> None:
    """Tell nobody."""


def _unfiltered(
    record: Record, test: TestDescription, settings: ReductionSettings
) -> tuple[Record, list[Channel]]:
    """Reduce without any low-pass, for the free run, for spectra and for Fig 5 and 6.

    The thermocouples' lag is undone whatever the settings say: behind no filter it is what it is.
    """
    plain = record.after(LedgerEntry("filter", "no low-pass filter"))
    plain = invert_thermocouples(plain, test)
    # Without W31 no ψ is computed, which nobody wants of these.
    plain = plane_flows(plain, test, settings.probes, wanted=UNFILTERED_AVERAGES, stored=())
    if knows_hub_and_tip(plain):
        shift = Channel(HUB_LESS_TIP, hub_tip_difference(plain), "kg/s")
        plain = replace(plain, channels={**plain.channels, HUB_LESS_TIP: shift})
    plain = coefficients(
        plain,
        test,
        inertia_factor=settings.inertia_factor,
        wanted=("phi", "psi_p", "Nc_frac"),
        stored=[name for name in ("P25_Pa", HUB_LESS_TIP) if name in plain],
    )
    names = {
        "P25_Pa": "P25_unfiltered_Pa",
        "P31_Pa": "P31_unfiltered_Pa",
        "Wc25_kg_s": "Wc25_unfiltered_kg_s",
        "phi": "phi_unfiltered",
        "psi_p": "psi_p_unfiltered",
    }
    kept = [Channel(new, plain[old], plain.channel(old).unit) for old, new in names.items()]
    needed = {"phi", "Nc_frac", HUB_LESS_TIP}
    gone = [n for n in plain.channels if n not in needed and not n.startswith("fault_")]
    return without(plain, gone), kept


def _with_coefficients(
    averaged: Record,
    unfiltered: list[Channel],
    test: TestDescription,
    settings: ReductionSettings,
    window: slice,
) -> Record:
    """Compute the coefficients of the averages, and lay the unfiltered ones beside them."""
    # What the mass balance averages over where no filter takes the cells out.
    period_s = None
    if settings.phase == "none":
        period_s = 1.0 / cell_frequency_hz(_with_channels(averaged, unfiltered), window)
    record = coefficients(
        averaged,
        test,
        inertia_factor=settings.inertia_factor,
        work_form=settings.work_form,
        cell_period_s=period_s,
    )
    return _with_channels(record, unfiltered)


def _with_free_run(
    record: Record, plain: Record, window: slice, inside: slice, probes: str
) -> Record:
    """Mark the rows of the free run."""
    unfiltered = _with_channels(plain, [record.channel("P25_unfiltered_Pa")])
    rows = free_run_rows(unfiltered, plain["phi"], window, inside, record["in_stall"])
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
    """Note where the threshold tells the regimes otherwise than hub and tip themselves do."""
    if threshold_lbm_s is None:
        return record
    other = 0
    stalled, itself = as_stored(record["in_stall"]), as_stored(record["stalled"])
    for rows in blocks(window.stop, window.start):
        other += int(np.count_nonzero(stalled[rows] != itself[rows]))
        record.workspace.release()
    share = other / (window.stop - window.start)
    if share <= REGIMES_DIFFER:
        return record
    entry = LedgerEntry(
        "regimes",
        f"threshold and hub-minus-tip flow agree in {1.0 - share:.0%} of the window",
        {"share": round(share, 4)},
        flags=(
            f"the threshold of {threshold_lbm_s:g} lbm/s tells the regime otherwise than hub and "
            f"tip do in {share:.0%} of the window: is it in lbm/s?",
        ),
    )
    return record.after(entry)


def _with_channels(record: Record, channels: list[Channel]) -> Record:
    entry = LedgerEntry("keep", "plane averages, φ and ψ' of the unfiltered pressures kept")
    return record.after(entry, add=channels)


def _only(record: Record, is_kept: Callable[[str], bool]) -> Record:
    return without(record, [name for name in record.channels if not is_kept(name)])


def _window_name(record: Record, test: TestDescription, settings: ReductionSettings) -> str:
    """Return what to call the window in an error: where it was named."""
    if settings.window_s is not None:
        return f"{record.source}: ReductionSettings.window_s"
    return f"{test.source}: [window]" if test.window_s is not None else f"{record.source}: window"


def _window(
    record: Record, test: TestDescription, settings: ReductionSettings
) -> tuple[tuple[float, float], LedgerEntry, LookAhead | None]:
    """Return the quasi-steady window, where it came from, and what was computed to find it."""
    for window_s, origin in ((settings.window_s, "the settings"), (test.window_s, test.source)):
        if window_s is not None:
            entry = LedgerEntry(
                "window",
                f"{window_s[0]:g} to {window_s[1]:g} s, as {origin} says",
                {"from_s": window_s[0], "to_s": window_s[1], "origin": origin},
            )
            return window_s, entry, None
    # A look ahead with every channel in it: which of them can be used depends on the window.
    # Nor must a dropout that passes end it.
    ahead = look_ahead(with_faults_bridged(record, test), test, settings)
    speed = _corrected_speed(ahead.averaged, test)
    cycles = find_cycles(_with_channels(ahead.averaged, [speed]))
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
    return (cycles.from_s, cycles.to_s), entry, ahead


def _few_cycles_told(record: Record, window_s: tuple[float, float]) -> Record:
    """Note where the window that somebody named is too short."""
    flags = cycles_within(record, window_s)
    if not flags:
        return record
    return record.after(LedgerEntry("cycles", "counted in the window", flags=flags))


def _corrected_speed(record: Record, test: TestDescription) -> Channel:
    inlet_K = record["T25_K"]
    speed = record.workspace.derived(
        record.n_samples, lambda rows: corrected_speed_fraction(inlet_K[rows], test)
    )
    return Channel("Nc_frac", speed, "1")


def _threshold(test: TestDescription, settings: ReductionSettings) -> float | None:
    """Return the corrected flow between the regimes; None where all is in stall."""
    if settings.threshold_lbm_s is None:
        return test.threshold_lbm_s
    return None if settings.threshold_lbm_s == "none" else float(settings.threshold_lbm_s)


def _segmented(
    record: Record, test: TestDescription, settings: ReductionSettings, window: slice
) -> Record:
    threshold = _threshold(test, settings)
    hysteresis = settings.hysteresis_lbm_s
    if hysteresis is not None and threshold is not None and hysteresis >= threshold:
        raise InputError(
            "ReductionSettings.hysteresis_lbm_s",
            expected=f"less than the threshold of {threshold:g} lbm/s",
            found=f"{hysteresis:g}",
        )
    try:
        return segment(
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


def _series(record: Record) -> CoefficientSeries:
    work_known = "psi" in record
    place, n_rows = record.workspace, record.n_samples

    def clock(rows: slice) -> FloatArray:
        return record.start_s + np.arange(rows.start, rows.stop) / record.sample_rate_hz

    def of_type(name: str, kind: type[np.generic]) -> NDArray[Any]:
        return place.widened(as_stored(record[name]), kind)

    return CoefficientSeries(
        time_s=place.derived(n_rows, clock),
        phi=record["phi"],
        psi_p=record["psi_p"],
        psi=record["psi"] if work_known else None,
        T25_K=record["T25_K"],
        Nc_frac=record["Nc_frac"],
        in_stall=of_type("in_stall", np.bool_),
        segment=of_type("segment", np.int64),
        phi_unfiltered=record["phi_unfiltered"],
        psi_p_unfiltered=record["psi_p_unfiltered"],
        stalled=of_type("stalled", np.bool_),
        free_run=of_type("free_run", np.int64),
        source=record.source,
        history=record.history,
        workspace=place,
    )
