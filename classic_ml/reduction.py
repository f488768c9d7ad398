"""The whole reduction: a raw record in, the series of coefficients out."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from classic_ml.airflow import local_flows, physical_flow, plane_averages
from classic_ml.calibration import (
    calibrate,
    check_facing,
    invert_thermocouples,
    match_near_stall,
    near_stall_rows,
)
from classic_ml.coefficients import (
    WORK_FORMS,
    coefficients,
    corrected_speed_fraction,
    flow_coefficient,
)
from classic_ml.errors import InputError
from classic_ml.faults import choose_channels, inspect_readings
from classic_ml.filtering import filter_channels
from classic_ml.free_run_rows import extend_while_settled, free_run_rows
from classic_ml.readers.test_description import TestDescription
from classic_ml.records import Channel, LedgerEntry, Record
from classic_ml.segments import (
    FEW_CYCLES,
    cell_frequency_hz,
    find_cycles,
    segment,
    window_rows,
)
from classic_ml.series import CoefficientSeries

__all__ = ["Reduction", "ReductionSettings", "reduce_record"]

# In the steady flow near stall the planes pass the same but for bleeds of a few per cent (0.3 % on
# the independent record); exchanged areas are a factor of twenty.
FLOWS_DIFFER = 0.05
FLOWS_REFUSED = 0.2
# An axial compressor near stall is at φ of 0.3 to 0.6, a centrifugal one above 0.1.
NEAR_STALL_PHI = (0.1, 1.5)

_CHOICES = {
    "filter_order": (3, 5),
    "phase": ("zero", "causal", "none"),
    "probes": ("all", "tip", "hub"),
    "near_stall_match": ("pair", "forward", "none"),
    "stall_rule": ("threshold", "hub-tip"),
    "work_form": WORK_FORMS,
}


@dataclass(frozen=True)
class ReductionSettings:
    """The switches of the reduction; the defaults are what a careful reduction uses.

    Parameters
    ----------
    filter_order : {3, 5}
        Order of the Butterworth low-pass.
    cutoff_hz : float
        Its −3 dB frequency in one pass.
    phase : {"zero", "causal", "none"}
        Forth and back; once, as in the paper (delays by about 8 ms); or no filter at all.
    probes : {"all", "tip", "hub"}
        Immersions in the plane averages.
    threshold_lbm_s : float, "none" or None
        Corrected flow between in-stall and unstalled; None takes what test.toml says.
    hysteresis_lbm_s : float or None
        Half width of the band around it; None takes what test.toml says.
    stall_rule : {"threshold", "hub-tip"}
        How the stall state is told.
    inertia_factor : float
        Multiplies ∫dx/A in Eq 5; 0 drops the inertia term.
    thermocouple_inversion : bool
        Undo the lag of the thermocouples. The paper did not; behind a 48 Hz filter the lag of T25
        cancels part of what the filter does to the curve, so that undoing it alone makes the
        curve worse.
    near_stall_match : {"pair", "forward", "none"}
        What the near-stall match moves.
    work_form : {"auto", "exit-flow", "mass-balance", "temperature-rise"}
        How ψ is had: by Eq 13 with W31 as measured, with the storage between the planes from a
        balance of mass, from the temperature rise alone, or by the first unless the flows of the
        two planes disagree by more than ψ can bear.
    window_s : tuple of float, optional
        Quasi-steady cycles on the facility clock; None takes test.toml's, else they are found.

    Raises
    ------
    InputError
        Naming the setting at fault.
    """

    filter_order: int = 3
    cutoff_hz: float = 48.0
    phase: str = "zero"
    probes: str = "all"
    threshold_lbm_s: float | str | None = None
    hysteresis_lbm_s: float | None = None
    stall_rule: str = "threshold"
    inertia_factor: float = 1.0
    thermocouple_inversion: bool = False
    near_stall_match: str = "pair"
    work_form: str = "auto"
    window_s: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        for name, choices in _CHOICES.items():
            if getattr(self, name) not in choices:
                raise _refused(name, " or ".join(repr(c) for c in choices), getattr(self, name))
        if not _is_number(self.cutoff_hz, above=0.0):
            raise _refused("cutoff_hz", "a number above 0", self.cutoff_hz)
        threshold = self.threshold_lbm_s
        if threshold not in (None, "none") and not _is_number(threshold, above=0.0):
            raise _refused("threshold_lbm_s", "a number above 0, 'none' or None", threshold)
        if not _is_number(self.inertia_factor, least=0.0):
            raise _refused("inertia_factor", "a number from 0 on", self.inertia_factor)
        hysteresis = self.hysteresis_lbm_s
        if hysteresis is not None and not _is_number(hysteresis, least=0.0):
            raise _refused("hysteresis_lbm_s", "a number from 0 on, or None", hysteresis)
        window = self.window_s
        if window is not None and not (
            len(window) == 2 and all(_is_number(v) for v in window) and window[0] < window[1]
        ):
            raise _refused("window_s", "two times, the earlier first", window)


def _is_number(value: object, *, above: float = -np.inf, least: float = -np.inf) -> bool:
    return (
        isinstance(value, int | float)
        and not isinstance(value, bool)
        and bool(np.isfinite(value))
        and value > above
        and value >= least
    )


def _refused(name: str, expected: str, found: object) -> InputError:
    return InputError(f"ReductionSettings.{name}", expected=expected, found=repr(found))


@dataclass(frozen=True)
class Reduction:
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


def reduce_record(
    record: Record, test: TestDescription, settings: ReductionSettings | None = None
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
    record = inspect_readings(record, test)
    record = calibrate(record, test)
    check_facing(record, test)
    record = match_near_stall(record, test, chosen.near_stall_match)
    record = record.after(_near_stall_flows(record, test))
    window_s, found = _window(record, test, chosen)
    window = window_rows(record, window_s, _window_name(record, test, chosen))
    record = choose_channels(record.after(found), test, window)
    plain, unfiltered = _unfiltered(record, test, chosen)
    record = _averages(record, test, chosen)
    record = coefficients(
        record,
        test,
        inertia_factor=chosen.inertia_factor,
        work_form=chosen.work_form,
        cell_period_s=_cell_period_s(_with_channels(record, unfiltered), chosen, window),
    )
    record = _with_channels(record, unfiltered)
    record = _segmented(record, test, chosen, window)
    named = chosen.window_s is not None or test.window_s is not None
    record = _with_free_run(record, plain, window, chosen.probes, named=named)
    return Reduction(_series(record), record, chosen, test, window_s)


def _near_stall_flows(record: Record, test: TestDescription) -> LedgerEntry:
    """Check φ, and the flow of one plane against the other's, in the steady flow near stall."""
    rows = near_stall_rows(record, test)
    steady = replace(
        record,
        channels={n: Channel(n, c.values[rows], c.unit) for n, c in record.channels.items()},
        start_s=float(record.time_s[rows][0]),
    )
    # No row is in a window yet: only what cannot be matched is left out here.
    steady = choose_channels(steady, test, np.zeros(steady.n_samples, dtype=np.bool_))
    steady = plane_averages(local_flows(steady, test), test)
    phi = float(
        np.mean(
            flow_coefficient(
                steady["Wc25_kg_s"],
                steady["T25_K"],
                test.areas_m2[25],
                test.rotor_velocity_m_s,
                test.compressor,
            )
        )
    )
    inlet, leaving, how = *_steady_flows(steady, test), ""
    if "W31_kg_s" not in steady:
        how = " (with the facility's T31)"
    differ = abs(leaving / inlet - 1.0)
    areas = f"area_m2 of [planes.25] and [planes.31] in {test.source}"
    if differ > FLOWS_REFUSED and not how:
        raise InputError(
            f"{record.source}: flow near stall",
            expected=f"W25 and W31 within {FLOWS_REFUSED:.0%} of each other",
            found=f"{inlet:.4g} and {leaving:.4g} kg/s",
            remedy=f"check {areas} ({test.areas_m2[25]:g} and {test.areas_m2[31]:g} m²)",
        )
    if not NEAR_STALL_PHI[0] <= phi <= NEAR_STALL_PHI[1]:
        raise InputError(
            f"{record.source}: φ near stall",
            expected=f"{NEAR_STALL_PHI[0]:g} to {NEAR_STALL_PHI[1]:g}",
            found=f"{phi:.3g}",
            # The area is not among them: it cancels between Eq 3 and its inverse.
            remedy=f"check rotor_speed_rpm and mean_radius_m in {test.source}, and the zero and "
            "calibrate readings",
        )
    flags: tuple[str, ...] = ()
    if differ > FLOWS_DIFFER:
        flags = (
            f"near stall W25 is {inlet:.4g} kg/s and W31 {leaving:.4g} kg/s{how}: check {areas}",
        )
    return LedgerEntry(
        "near-stall flow",
        f"φ {phi:.3f}, W25 {inlet:.2f} kg/s, W31 {leaving:.2f} kg/s{how}",
        {"phi": round(phi, 4), "W25_kg_s": round(inlet, 4), "W31_kg_s": round(leaving, 4)},
        flags=flags,
    )


def _steady_flows(steady: Record, test: TestDescription) -> tuple[float, float]:
    """Return W25 and W31, the latter with the facility's T31 where no thermocouple counts."""
    inlet = float(np.mean(steady["W25_kg_s"]))
    if "W31_kg_s" in steady:
        return inlet, float(np.mean(steady["W31_kg_s"]))
    exit_K = np.full(steady.n_samples, test.near_stall.temperature_K(31))
    return inlet, float(np.mean(physical_flow(steady["Wc31_kg_s"], steady["P31_Pa"], exit_K)))


def _averages(record: Record, test: TestDescription, settings: ReductionSettings) -> Record:
    """Filter, undo the thermocouple lag, and average flows and pressures over each plane."""
    names = tuple(name for name in test.channel_names if name in record)
    record = filter_channels(
        record,
        names,
        order=settings.filter_order,
        cutoff_hz=settings.cutoff_hz,
        phase=settings.phase,
    )
    record = invert_thermocouples(record, test, invert=settings.thermocouple_inversion)
    return plane_averages(local_flows(record, test), test, settings.probes)


def _unfiltered(
    record: Record, test: TestDescription, settings: ReductionSettings
) -> tuple[Record, list[Channel]]:
    """Reduce without any low-pass, for the free run, for spectra and for Fig 5 and 6.

    The thermocouples' lag is undone whatever the settings say: behind no filter it is what it is.
    """
    plain = _averages(record, test, replace(settings, phase="none", thermocouple_inversion=True))
    plain = coefficients(
        plain, test, inertia_factor=settings.inertia_factor, work_form="temperature-rise"
    )
    names = {
        "P25_Pa": "P25_unfiltered_Pa",
        "P31_Pa": "P31_unfiltered_Pa",
        "Wc25_kg_s": "Wc25_unfiltered_kg_s",
        "phi": "phi_unfiltered",
        "psi_p": "psi_p_unfiltered",
    }
    kept = [Channel(new, plain[old], plain.channel(old).unit) for old, new in names.items()]
    return plain, kept


def _cell_period_s(
    record: Record, settings: ReductionSettings, window: NDArray[np.bool_]
) -> float | None:
    """Return what the mass balance averages over where no filter takes the cells out."""
    return 1.0 / cell_frequency_hz(record, window) if settings.phase == "none" else None


def _with_free_run(
    record: Record, plain: Record, window: NDArray[np.bool_], probes: str, *, named: bool
) -> Record:
    """Mark the rows of the free run; a window that somebody named is taken as it is."""
    unfiltered = _with_channels(plain, [record.channel("P25_unfiltered_Pa")])
    inside = window if named else extend_while_settled(unfiltered, window)
    rows = free_run_rows(unfiltered, plain["phi"], window, inside, record["in_stall"] > 0.5)
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


def _with_channels(record: Record, channels: list[Channel]) -> Record:
    entry = LedgerEntry("keep", "plane averages, φ and ψ' of the unfiltered pressures kept")
    return record.after(entry, add=channels)


def _window_name(record: Record, test: TestDescription, settings: ReductionSettings) -> str:
    """Return what to call the window in an error: where it was named."""
    if settings.window_s is not None:
        return f"{record.source}: ReductionSettings.window_s"
    return f"{test.source}: [window]" if test.window_s is not None else f"{record.source}: window"


def _window(
    record: Record, test: TestDescription, settings: ReductionSettings
) -> tuple[tuple[float, float], LedgerEntry]:
    """Return the quasi-steady window and where it came from."""
    for window_s, origin in ((settings.window_s, "the settings"), (test.window_s, test.source)):
        if window_s is not None:
            return window_s, LedgerEntry(
                "window",
                f"{window_s[0]:g} to {window_s[1]:g} s, as {origin} says",
                {"from_s": window_s[0], "to_s": window_s[1], "origin": origin},
            )
    # A look ahead with every channel in it: which of them can be used depends on the window.
    preview = _averages(record, test, ReductionSettings(phase="zero"))
    speed = Channel("Nc_frac", corrected_speed_fraction(preview["T25_K"], test), "1")
    cycles = find_cycles(_with_channels(preview, [speed]))
    flags: tuple[str, ...] = ()
    if cycles.n_cycles < FEW_CYCLES:
        flags = (f"only {cycles.n_cycles} cycles: the time constant will be uncertain",)
    return (cycles.from_s, cycles.to_s), LedgerEntry(
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


def _segmented(
    record: Record, test: TestDescription, settings: ReductionSettings, window: NDArray[np.bool_]
) -> Record:
    threshold = test.threshold_lbm_s if settings.threshold_lbm_s is None else None
    if settings.threshold_lbm_s not in (None, "none"):
        threshold = float(settings.threshold_lbm_s)
    hysteresis = settings.hysteresis_lbm_s
    return segment(
        record,
        window,
        threshold_lbm_s=threshold,
        hysteresis_lbm_s=test.hysteresis_lbm_s if hysteresis is None else hysteresis,
        stall_rule=settings.stall_rule,
    )


def _series(record: Record) -> CoefficientSeries:
    work_known = "psi" in record
    return CoefficientSeries(
        time_s=record.time_s,
        phi=record["phi"],
        psi_p=record["psi_p"],
        psi=record["psi"] if work_known else None,
        T25_K=record["T25_K"],
        Nc_frac=record["Nc_frac"],
        in_stall=record["in_stall"] > 0.5,
        segment=record["segment"].astype(np.int64),
        phi_unfiltered=record["phi_unfiltered"],
        psi_p_unfiltered=record["psi_p_unfiltered"],
        stalled=record["stalled"] > 0.5,
        free_run=record["free_run"].astype(np.int64),
        source=record.source,
        history=record.history,
    )
