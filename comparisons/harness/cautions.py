"""What a reader should know of a comparison: of its records, its rows and its fits."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import combinations

import numpy as np

from classic_ml.emptied_band import emptied_above_hz
from classic_ml.records import LedgerEntry
from classic_ml.series import CoefficientSeries
from classic_ml.whole_run import has_whole_run
from comparisons.harness.drift import TAUS_A_KNOT, Drift, Misalignment, drift_of, misalignment
from comparisons.harness.rows import MINIMUM_SEGMENT_ROWS
from comparisons.results import Caution, EstimatorResult, FitRows, TauEstimate
from surge_core.lag import Hold

__all__ = [
    "comparison_cautions",
    "drift_cautions",
    "filter_cautions",
    "noise_model_cautions",
    "spread_speeds",
    "tau_caution",
    "unknown_work",
]

# A surge cycle lasts a tenth of a second to a few: slower than this none is seen, and faster no
# rake follows.
SLOWEST_HZ, FASTEST_HZ = 20.0, 1e5
# Records this far apart in corrected speed have different characteristics.
SPEED_SPREAD = 0.03
# Estimators that differ by more than this in τ are not measuring one thing.
TAU_AGREEMENT = 0.15
# The estimators that differ in the noise model alone; `paper` is armax wherever it stands.
NOISE_KINDS = ("paper", "classic_ml_arx", "classic_ml_output_error")
FALSE_ALARM = 0.01
# A drift lengthens τ; arx and armax go up with its size where output error still holds.
LONGER = 1.15
LEAST_DRIFT_S = 5.0
# Corners this far apart are two filters: of one filter, corners are read up to twice apart.
CORNER_RATIO = 2.5


def comparison_cautions(
    records: Sequence[CoefficientSeries],
    rows: FitRows,
    results: tuple[EstimatorResult, ...],
    *,
    degree: int,
    hold: Hold,
    held: bool,
) -> tuple[Caution, ...]:
    """Return what a reader should know of all lines of a comparison.

    Parameters
    ----------
    records : sequence of CoefficientSeries
        The records.
    rows : FitRows
        The rows that were fitted.
    results : tuple of EstimatorResult
        What the estimators made of them.
    degree : int
        Degree of the classical characteristic.
    hold : {"zero", "first"}
        How φ acts between samples.
    held : bool
        τ was held: then the noise models cannot disagree on it.
    """
    cautions = [*_of_rows(records, rows, results), *_of_records(records), *_taus_apart(results)]
    noise_kinds = [r.estimate for r in results if r.name in NOISE_KINDS and r.whole_run is None]
    if rows.target == "psi_p" and noise_kinds:
        if not held:
            cautions += noise_model_cautions(noise_kinds)
            cautions += drift_cautions(noise_kinds, drift_of(rows, degree=degree, hold=hold))
        histories = [record.history for record in records]
        cautions += filter_cautions(rows, histories, misalignment(rows, degree=degree, hold=hold))
    for result in results:
        cautions += [Caution.of("estimator", result.name, remark=text) for text in result.remarks]
    return tuple(cautions)


def tau_caution(
    histories: Iterable[Sequence[LedgerEntry]],
    *,
    target: str = "psi_p",
    quotable: Sequence[str] = (),
) -> Caution | None:
    """Say what the τ of ψ' can be trusted for, where a ledger shows a low-pass before Eq 1 to 4.

    Parameters
    ----------
    histories : iterable of sequence of LedgerEntry
        Ledgers of the records.
    target : {"psi_p", "psi"}
        The coefficient whose τ it is: only that of ψ' was measured to come out high, 29 to 31 ms
        over seeds of the simulated rig, whose truth is 18 ms, with armax and the default
        reduction (zero phase).
    quotable : sequence of str
        Estimators that were fitted to unfiltered signals and whose τ may be quoted.

    Returns
    -------
    Caution or None
        None for ψ, and where no ledger shows such a filter.
    """
    # The first low-pass of a ledger is the one before the flow equation.
    cutoffs = {cutoff_hz for history in histories for _, cutoff_hz in _low_passes(history)[:1]}
    if target != "psi_p" or not cutoffs:
        return None
    at = " and ".join(f"{cutoff:g}" for cutoff in sorted(cutoffs))
    code = "quote_tau" if quotable else "tau_biased"
    return Caution.of(code, cutoff_hz=at, estimators=" and ".join(quotable))


def unknown_work(history: Sequence[LedgerEntry]) -> Caution | None:
    """Say why ψ is not known, where a ledger shows that it is not.

    Parameters
    ----------
    history : sequence of LedgerEntry
        Ledger of a record.
    """
    dropped = [(entry, dropped) for entry in history for dropped in entry.dropped]
    why = [d.why for entry, d in dropped if entry.did == "ψ is not known" and d.what == "ψ"]
    if not why:
        return None
    lost = [
        f"{d.what}: {d.why}"
        for entry, d in dropped
        if entry.step == "choose channels" and d.what.startswith("T31")
    ]
    return Caution.of("psi_unknown", why=why[0] + (f" ({'; '.join(lost)})" if lost else ""))


def spread_speeds(records: Sequence[CoefficientSeries]) -> list[tuple[str, float]]:
    """Return each record's median corrected speed where they are too far apart for one curve.

    Parameters
    ----------
    records : sequence of CoefficientSeries
        The records.
    """
    known = [
        (r.source, float(np.median(r.Nc_frac[r.scored]))) for r in records if r.Nc_frac is not None
    ]
    speeds = [speed for _, speed in known] or [0.0]
    return known if max(speeds) - min(speeds) > SPEED_SPREAD else []


def noise_model_cautions(estimates: Sequence[TauEstimate]) -> tuple[Caution, ...]:
    """Warn where noise models put τ further apart than their errors allow.

    Parameters
    ----------
    estimates : sequence of TauEstimate
        Of arx, armax and output error on the same rows.

    Returns
    -------
    tuple of Caution
        One with the pair that is furthest apart, or nothing.

    Notes
    -----
    |τ₁ - τ₂| is held against √(s₁² + s₂²) times the 1 % point for as many pairs. The errors of
    the two stem from the same rows and mostly cancel in the difference, so that false alarms are
    rarer than that.
    """
    pairs = list(combinations((e for e in estimates if math.isfinite(e.stderr_s)), 2))
    limit = _beyond(len(pairs))
    apart = {
        abs(one.tau_s - two.tau_s): (one, two)
        for one, two in pairs
        if abs(one.tau_s - two.tau_s) > limit * math.hypot(one.stderr_s, two.stderr_s)
    }
    if not apart:
        return ()
    one, two = apart[max(apart)]
    labels = {"one": one.label, "two": two.label}
    taus = {"one_ms": 1e3 * one.tau_s, "two_ms": 1e3 * two.tau_s}
    return (Caution.of("noise_models_disagree", **labels, **taus, pairs=len(apart)),)


def drift_cautions(estimates: Sequence[TauEstimate], drift: Drift | None) -> tuple[Caution, ...]:
    """Warn where τ nears the time scale of a drift, or moves once the drift is modelled.

    Parameters
    ----------
    estimates : sequence of TauEstimate
        Fitted without the drift.
    drift : Drift or None
        From :func:`~comparisons.harness.drift.drift_of`.
    """
    if drift is None:
        return ()
    cautions = []
    if (drift.tau_s + 2.0 * drift.stderr_s) * TAUS_A_KNOT > drift.knot_spacing_s:
        knots = {"knots_s": drift.knot_spacing_s, "taus_a_knot": TAUS_A_KNOT}
        cautions.append(Caution.of("knots_too_close", tau_ms=1e3 * drift.tau_s, **knots))
    # The error of a fit without the drift is blown up by the drift: that of the fit with it counts.
    moved = max(LONGER * drift.tau_s, drift.tau_s + _beyond(1) * drift.stderr_s)
    for estimate in estimates if drift.dominates else ():
        numbers = {"tau_ms": 1e3 * estimate.tau_s}
        if estimate.tau_s * LEAST_DRIFT_S > drift.time_s:
            numbers |= {"drift_s": drift.time_s}
            cautions.append(Caution.of("tau_near_drift", estimate.label, **numbers))
        elif estimate.tau_s > moved:
            numbers |= {"with_drift_ms": 1e3 * drift.tau_s}
            numbers |= {"drift_rms": drift.rms, "error_rms": drift.error_rms}
            cautions.append(Caution.of("drift_read_as_lag", estimate.label, **numbers))
    return tuple(cautions)


def filter_cautions(
    rows: FitRows, histories: Iterable[Sequence[LedgerEntry]], found: Misalignment | None
) -> tuple[Caution, ...]:
    """Warn where ψ' and φ seem to have passed different filters.

    Parameters
    ----------
    rows : FitRows
        The rows.
    histories : iterable of sequence of LedgerEntry
        Ledgers of the records.
    found : Misalignment or None
        From :func:`~comparisons.harness.drift.misalignment`.

    Returns
    -------
    tuple of Caution
        From the ledgers, from the corners of the two spectra, and from the dead time.
    """
    several = {tuple(dict(_low_passes(history))) for history in histories}
    cautions = [
        Caution.of("several_low_passes", count=len(names), filters="; ".join(names))
        for names in sorted(several)
        if len(names) > 1
    ]
    cautions += _unlike_corners(rows)
    if found is not None and found.significant:
        late, early = ("ψ'", "φ") if found.delay_s > 0.0 else ("φ", "ψ'")
        numbers = {"delay_ms": 1e3 * abs(found.delay_s), "stderr_ms": 1e3 * found.stderr_s}
        cautions.append(Caution.of("misaligned", late=late, early=early, **numbers))
    return tuple(cautions)


def _low_passes(history: Iterable[LedgerEntry]) -> list[tuple[str, float]]:
    """Return name and cut-off of the low-passes that a ledger shows, in their order."""
    found = []
    for entry in history:
        phase, cutoff = entry.parameters.get("phase"), entry.parameters.get("cutoff_hz")
        if entry.step == "filter" and phase != "none" and isinstance(cutoff, int | float):
            order = entry.parameters.get("order", "?")
            found.append((f"{phase} order {order} at {cutoff:g} Hz", float(cutoff)))
    return found


def _unlike_corners(rows: FitRows) -> list[Caution]:
    psi_hz, phi_hz = (
        emptied_above_hz(signal, rows.labels, sample_period_s=rows.sample_period_s)
        for signal in (rows.measured, rows.phi)
    )
    # A φ without noise is empty by itself: that alone says nothing of a filter.
    if psi_hz is None or (phi_hz is not None and phi_hz < CORNER_RATIO * psi_hz):
        return []
    if phi_hz is None:
        return [Caution.of("psi_low_passed", psi_hz=psi_hz)]
    return [Caution.of("corners_apart", psi_hz=psi_hz, phi_hz=phi_hz)]


def _of_rows(
    records: Sequence[CoefficientSeries], rows: FitRows, results: tuple[EstimatorResult, ...]
) -> list[Caution]:
    cautions = []
    without = [record.source for record in records if not has_whole_run(record)]
    expected = rows.target == "psi_p" and any(r.name == "classic_ml" for r in results)
    if expected and without and not any(r.whole_run for r in results):
        cautions.append(Caution.of("no_whole_run", records=", ".join(without)))
    left_out = sum(int(record.scored.sum()) for record in records) - rows.phi.size
    if left_out:
        code = "rows_left_out_psi" if rows.target == "psi" else "rows_left_out"
        cautions.append(Caution.of(code, rows=left_out, fewest=MINIMUM_SEGMENT_ROWS))
    return cautions


def _of_records(records: Sequence[CoefficientSeries]) -> list[Caution]:
    """Name what is odd about the records themselves, and what their ledgers found."""
    cautions = []
    for record in records:
        if not record.history:
            cautions.append(Caution("no_ledger", record.source))
        if record.n_segments == 1 and bool(record.scored.all()):
            cautions.append(Caution("one_segment", record.source))
        rate_hz = record.sample_rate_hz
        if not SLOWEST_HZ <= rate_hz <= FASTEST_HZ:
            cautions.append(Caution.of("odd_rate", record.source, rate_hz=rate_hz))
    each = ", ".join(f"{name} {100.0 * speed:.0f} %" for name, speed in spread_speeds(records))
    if each:
        cautions.append(Caution.of("speeds_apart", each=each))
    return cautions + [
        Caution("ledger", record.source, entry.step, {"finding": flag})
        for record in records
        for entry in record.history
        for flag in entry.flags
    ]


def _taus_apart(results: tuple[EstimatorResult, ...]) -> list[Caution]:
    plain = [r for r in results if r.on_rows]
    taus = [r.model.time_constant_s for r in plain if r.model.measured]
    if len(taus) < 2 or max(taus) <= (1.0 + 2.0 * TAU_AGREEMENT) * min(taus):
        return []
    all_of_them = len(plain) == len(results)
    who = "the estimators" if all_of_them else "the estimators on the filtered rows"
    return [Caution.of("taus_apart", who=who, low_ms=1e3 * min(taus), high_ms=1e3 * max(taus))]


def _beyond(n_tests: int) -> float:
    from scipy.stats import norm

    return float(norm.isf(0.5 * FALSE_ALARM / max(n_tests, 1)))
