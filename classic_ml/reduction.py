"""The whole reduction: a raw record in, the series of coefficients out."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from classic_ml.calibration import (
    calibrate,
    check_facing,
    invert_thermocouples,
    near_stall_match,
    near_stall_rows,
)
from classic_ml.coefficients import coefficients, corrected_speed_fraction
from classic_ml.cycles import FEW_CYCLES, find_cycles
from classic_ml.description import TestDescription
from classic_ml.faults.choice import choose_channels, with_faults_bridged
from classic_ml.faults.near_stall import check_near_stall
from classic_ml.faults.search import inspect_readings
from classic_ml.filters import filter_channels
from classic_ml.flow import local_flows, plane_averages
from classic_ml.records import Channel, Dropped, LedgerEntry, Record, fault_name, ledger_grid
from classic_ml.reduction_settings import ReductionSettings
from classic_ml.segments import (
    RAKE_DIFFERENCE,
    cell_frequency_hz,
    cell_period_s,
    estimated_threshold_lbm_s,
    extend_while_settled,
    free_run_rows,
    hub_tip_stall,
    segment,
    window_rows,
)
from classic_ml.series import COLUMNS, CoefficientSeries
from classic_ml.whole_record.rakes import RakeSignals, rake_signals
from classic_ml.work.alignment import alignment_of
from classic_ml.work.balance import with_work
from surge_core.display import Displayed, Field, Sheet
from surge_core.errors import InputError
from surge_core.types import BoolArray

# As often as a reduction reports that it has got further.
STEPS = 5
# With the right threshold 1 to 15 % of the window on 13 simulated records; with half of it, as
# where it was meant in kg/s, 27 to 29 % at 90 to 98.5 % speed.
REGIMES_DIFFER = 0.2
# What the window is looked for with.
AHEAD = ReductionSettings()
# Of the unfiltered averages, what is laid beside the filtered ones.
UNFILTERED = {
    "P25_Pa": "P25_unfiltered_Pa",
    "P31_Pa": "P31_unfiltered_Pa",
    "Wc25_kg_s": "Wc25_unfiltered_kg_s",
    "phi": "phi_unfiltered",
    "psi_p": "psi_p_unfiltered",
}


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


@dataclass(frozen=True)
class _Window:
    """The window of the surge cycles, and where it came from."""

    times_s: tuple[float, float]
    rows: slice
    entry: LedgerEntry


def reduce_record(
    record: Record,
    test: TestDescription,
    settings: ReductionSettings | None = None,
    *,
    keep_probes: bool = True,
    progress: Callable[[int], object] = lambda _: None,
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
    progress : callable
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
    record, _ = _matched(record, test)
    progress(1)
    window = _window(record, test, chosen)
    record = choose_channels(record.after(window.entry), test, window.rows)
    progress(1)
    averaged = _averaged(record, test, chosen)
    if not keep_probes:
        averaged = averaged.without(_of_probes(averaged, test))
    progress(1)
    unfiltered, rakes = _unfiltered(record, test, chosen.probe_ramp)
    del record
    progress(1)
    reduced = _with_coefficients(averaged, unfiltered, test, chosen, window.rows)
    del averaged
    reduced = _with_states(reduced, unfiltered, test, chosen, window)
    alignment = alignment_of(reduced, test, window.rows)
    reduced = reduced.after(alignment.entry())
    rakes = replace(rakes, chain=replace(rakes.chain, alignment=alignment))
    progress(1)
    return Reduction(_series(reduced, rakes), reduced, chosen, test, window.times_s)


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
    matched, shifts = _matched(record, test)
    sound = choose_channels(matched, test, slice(0, 0))
    forward = [probe.name for probe in test.pressures if probe.facing == "forward"]
    named = [*forward, *(couple.name for couple in test.temperatures)]
    return {name: shifts[name] for name in named if name in sound}


def _matched(record: Record, test: TestDescription) -> tuple[Record, dict[str, float]]:
    """Inspect, calibrate and match near stall; return what the match has added as well."""
    steady = record = inspect_readings(record, test)
    if not test.near_stall_shifts:
        steady = calibrate(record.part(near_stall_rows(record, test)), test)
        check_facing(steady, test)
    shifts, entry = near_stall_match(steady, test)
    matched = calibrate(record, test, shifts).after(entry)
    return matched.after(check_near_stall(matched, test, shifts)), shifts


def _window(record: Record, test: TestDescription, settings: ReductionSettings) -> _Window:
    """Return the quasi-steady window, and where it came from."""
    for times_s, origin, where in (
        (settings.window_s, "the settings", f"{record.source}: ReductionSettings.window_s"),
        (test.window_s, test.source, f"{test.source}: [window]"),
    ):
        if times_s is not None:
            entry = LedgerEntry(
                "window",
                f"{times_s[0]:g} to {times_s[1]:g} s, as stated in {origin}",
                {"from_s": times_s[0], "to_s": times_s[1], "origin": origin},
            )
            return _Window(times_s, window_rows(record, times_s, where), entry)
    # Looked for in all channels, bridged: which of them can be used depends on the window, and a
    # dropout must not end it.
    bridged = with_faults_bridged(record, test.channel_names)
    slow = filter_channels(bridged, test.channel_names, **AHEAD.low_pass)
    flows = local_flows(slow, test, planes=(25,), probe_ramp=settings.probe_ramp)
    averages = plane_averages(flows, test)
    speed = Channel("Nc_frac", corrected_speed_fraction(averages["T25_K"], test), "1")
    cycles = find_cycles(averages.after(LedgerEntry("speed", "of the window"), add=[speed]))
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
    times_s = cycles.from_s, cycles.to_s
    return _Window(times_s, window_rows(record, times_s), entry)


def _averaged(record: Record, test: TestDescription, settings: ReductionSettings) -> Record:
    """Filter all channels alike, and average over each plane."""
    names = [name for name in test.channel_names if name in record]
    record = filter_channels(record, names, **settings.low_pass)
    record = invert_thermocouples(record, test, invert=settings.thermocouple_inversion)
    return plane_averages(local_flows(record, test, probe_ramp=settings.probe_ramp), test)


def _of_probes(record: Record, test: TestDescription) -> Iterable[str]:
    """Return the channels of a record that belong to single probes."""
    pairs = [pair for plane in test.areas_m2 for pair in test.pairs(plane)]
    for name in test.channel_names:
        yield from (name, fault_name(name))
    for pair in pairs:
        yield from (f"Wc{pair.name}_kg_s", f"Pt{pair.name}_Pa")


def _unfiltered(
    record: Record, test: TestDescription, probe_ramp: float
) -> tuple[Record, RakeSignals]:
    """Reduce without any low-pass, for the free run, for spectra and for Fig 5 and 6.

    The thermocouples' lag is undone whatever the settings say: behind no filter it is what it is.
    Of plane 31 the pressure alone is needed. The signals of the single pairs go with it.
    """
    inverted = invert_thermocouples(record, test)
    plain = local_flows(inverted, test, planes=(25,), probe_ramp=probe_ramp)
    rakes = rake_signals(plain, test)
    plain = plane_averages(plain, test)
    faults = {fault_name(name) for name in test.channel_names}
    plain = plain.without(set(_of_probes(plain, test)) - faults)
    plain = coefficients(plain, test)
    entry = LedgerEntry("keep", "P25 under the name that it has beside the filtered one")
    renamed = [replace(plain.channel("P25_Pa"), name="P25_unfiltered_Pa")]
    if not rakes.one_rake:
        # The last are those of total pressure.
        apart = rakes.cell_differences(25)[-1:]
        renamed += [Channel(RAKE_DIFFERENCE, values, "Pa") for values, _ in apart]
    return plain.after(entry, add=renamed), rakes


def _with_coefficients(
    averaged: Record,
    unfiltered: Record,
    test: TestDescription,
    settings: ReductionSettings,
    window: slice,
) -> Record:
    """Compute the coefficients of the averages, and lay the unfiltered ones beside them."""
    record = coefficients(averaged, test)
    if "W31_kg_s" in record:
        # What the mass balance averages over where no filter takes the cells out.
        period_s = None
        if settings.phase == "none":
            period_s = 1.0 / cell_frequency_hz(unfiltered, window, test.rotor_speed_rpm)
        record = with_work(record, test, settings.work_form, period_s)
    else:
        dropped = Dropped("ψ", record.n_samples, "no T31 that counts, so no W31")
        record = record.after(LedgerEntry("work coefficient", "ψ is not known", {}, (dropped,)))
    kept = [replace(unfiltered.channel(old), name=new) for old, new in UNFILTERED.items()]
    entry = LedgerEntry("keep", "plane averages, φ and ψ' of the unfiltered pressures kept")
    return record.after(entry, add=kept)


def _with_states(
    record: Record,
    unfiltered: Record,
    test: TestDescription,
    settings: ReductionSettings,
    window: _Window,
) -> Record:
    """Add the stall state, the segments to be fitted and the rows of the free run."""
    rows, found = window.rows, window.entry.parameters["origin"] == "found"
    period_s, has_cells = cell_period_s(unfiltered, rows, test.rotor_speed_rpm)
    # A record that continues another does not hold the reading near stall.
    unstalled = slice(0) if test.near_stall_shifts else near_stall_rows(record, test)
    stalled = hub_tip_stall(unfiltered, rows, 1.0 / period_s, unstalled)
    record, threshold = _segmented(record, unfiltered, test, settings, window, stalled)
    in_stall = record["in_stall"] > 0.5
    parameters: dict[str, str | int | float | bool] = {"stall_rule": "hub-tip"}
    flags: tuple[str, ...] = ()
    if stalled is None:
        stalled, parameters = in_stall, {"stall_rule": "threshold"}
        flags += (
            "hub and tip do not show the stall state: it is estimated by the threshold of the "
            "flow, which costs accuracy of the time constant",
        )
    if not has_cells:
        flags += (
            "no line of rotating stall stands out of the spectrum of P25: averages are taken over "
            f"{1e3 * period_s:g} ms",
        )
    differ = float(np.mean(in_stall[rows] != stalled[rows]))
    estimated = settings.threshold_lbm_s is None and test.threshold_lbm_s is None
    if threshold is not None and differ > REGIMES_DIFFER:
        flags += (
            f"the threshold of {threshold:.4g} lbm/s gives another regime than hub and tip do in "
            f"{differ:.0%} of the window{'' if estimated else ': is it in lbm/s?'}",
        )
    # A stated window is not extended.
    inside = extend_while_settled(unfiltered, rows) if found else rows
    free_run, entry = free_run_rows(unfiltered, stalled, inside, period_s)
    entry = replace(entry, parameters={**entry.parameters, **parameters}, flags=flags)
    columns = {"stalled": stalled, "free_run": free_run}
    return record.after(entry, add=[Channel(n, v.astype(float), "1") for n, v in columns.items()])


def _segmented(
    record: Record,
    unfiltered: Record,
    test: TestDescription,
    settings: ReductionSettings,
    window: _Window,
    stalled: BoolArray | None,
) -> tuple[Record, float | None]:
    """Add the segments, and return the flow between the regimes, None where all is in stall."""
    stated = settings.threshold_lbm_s
    stated = test.threshold_lbm_s if stated is None else stated
    threshold = None if stated in (None, "none") else float(stated)
    if stated is None:
        threshold, entry = estimated_threshold_lbm_s(
            unfiltered, record["Wc25_kg_s"], window.rows, stalled
        )
        record = record.after(entry)
    hysteresis, where = settings.hysteresis_lbm_s, "ReductionSettings.hysteresis_lbm_s"
    if hysteresis is None:
        hysteresis, where = test.hysteresis_lbm_s, f"{test.source}: segmentation.hysteresis_lbm_s"
    if threshold is not None and 0.0 < threshold <= hysteresis:
        expected = f"less than the threshold of {threshold:g} lbm/s"
        raise InputError(where, expected=expected, found=f"{hysteresis:g}")
    segmented = segment(record, window.rows, threshold_lbm_s=threshold, hysteresis_lbm_s=hysteresis)
    return segmented, threshold


def _series(record: Record, rakes: RakeSignals) -> CoefficientSeries:
    columns: dict[str, Any] = {name: record[name] for name in COLUMNS if name in record}
    return CoefficientSeries(
        time_s=record.time_s,
        rakes=rakes.columns(),
        source=record.source,
        history=(*record.history, rakes.chain.entry()),
        **columns,
    )
