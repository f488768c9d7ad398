"""What a reader should know of a comparison: of its records, its rows and its fits."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

from classic_ml.filters import emptied_above_hz
from classic_ml.records import LedgerEntry
from classic_ml.series import CoefficientSeries
from classic_ml.whole_record_run import WholeRecordRun
from classic_ml.whole_run_rows import has_whole_run
from comparisons.harness.rows import MINIMUM_SEGMENT_ROWS
from comparisons.results import Caution, EstimatorResult, FitRows

# Records this far apart in corrected speed have different characteristics.
SPEED_SPREAD = 0.03
# Estimators that differ by more than this in τ are not measuring one thing.
TAU_AGREEMENT = 0.15
# How the ledger words a probe that was left out for its range.
BEYOND = re.compile(
    r"beyond its limits in (?P<of>\d+) of (?P<all>[1-9]\d*) rows "
    r"(?P<place>in the window|at near stall)"
)
# Corners this far apart are two filters: of one filter, corners are read up to twice apart.
CORNER_RATIO = 2.5


def comparison_cautions(
    records: Sequence[CoefficientSeries], rows: FitRows, results: tuple[EstimatorResult, ...]
) -> tuple[Caution, ...]:
    """Return what a reader should know of all lines of a comparison."""
    cautions = [*_of_rows(records, rows, results), *_of_records(records), *_taus_apart(results)]
    cautions += _shared_rows(results)
    if rows.target == "psi_p":
        cautions += filter_cautions(rows)
    for result in results:
        cautions += [Caution.of("estimator", result.name, remark=text) for text in result.remarks]
    return tuple(cautions)


def lacks_ledger(record: CoefficientSeries) -> bool:
    """Whether a series has unfiltered columns, and not the ledger that says how to read them."""
    return record.phi_unfiltered is not None and not record.history


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
        The coefficient whose τ it is: only that of ψ' was measured to be biased: 29 to
        31 ms over seeds of the simulated rig, whose truth is 18 ms, with armax and the default
        reduction (zero phase); on other machines it comes out low.
    quotable : sequence of str
        Estimators that were fitted to unfiltered signals and whose τ may be quoted, the
        recommended first.

    Returns
    -------
    Caution or None
        None for ψ, and where no ledger shows such a filter.
    """
    cutoffs = {cutoff_hz for history in histories for cutoff_hz in _first_cutoff_hz(history)}
    if target != "psi_p" or not cutoffs:
        return None
    at = " and ".join(f"{cutoff:g}" for cutoff in sorted(cutoffs))
    code = "quote_tau" if quotable else "tau_biased"
    return Caution.of(code, cutoff_hz=at, estimators=next(iter(quotable), ""))


def unknown_work(history: Sequence[LedgerEntry]) -> Caution | None:
    """Say why ψ is not known, where a ledger shows that it is not."""
    dropped = [(entry, dropped) for entry in history for dropped in entry.dropped]
    why = [d.why for entry, d in dropped if entry.did == "ψ is not known" and d.what == "ψ"]
    if not why:
        return None
    lost = [
        (d.what, d.why)
        for entry, d in dropped
        if entry.step == "choose channels" and d.what.startswith("T31")
    ]
    matched = [BEYOND.match(each) for _, each in lost]
    beyond = [found for found in matched if found]
    if not beyond or len(beyond) < len(lost):
        said = "; ".join(f"{what}: {each}" for what, each in lost)
        return Caution.of("psi_unknown", why=why[0] + (f" ({said})" if said else ""))
    n, share = len(beyond), min(int(found["of"]) / int(found["all"]) for found in beyond)
    probes = "its probe was" if n == 1 else f"{'both' if n == 2 else f'all {n}'} T31 probes were"
    place = "window" if beyond[0]["place"] == "in the window" else "rows at near stall"
    limits = f"beyond {'its' if n == 1 else 'their'} limits in {100 * share:.0f} % of the {place}"
    words = f"it needs T31, and {probes} {limits}"
    return Caution.of("psi_unknown", why=words)


def psi_by_rise(history: Sequence[LedgerEntry]) -> Caution | None:
    """Say that the ψ of a record leads to a curve that is too high, where its ledger shows it."""
    forms = [e.parameters.get("form") for e in history if e.step == "work coefficient"]
    return Caution("psi_by_rise") if "temperature-rise" in forms else None


def spread_speeds(records: Sequence[CoefficientSeries]) -> list[tuple[str, float]]:
    """Return each record's corrected speed where they are too far apart for one curve.

    It is that at the first row: surge heats the inlet, by as much as it lasts.
    """
    known = [(r.source, float(r.Nc_frac[0])) for r in records if r.Nc_frac is not None]
    speeds = [speed for _, speed in known] or [0.0]
    return known if max(speeds) - min(speeds) > SPEED_SPREAD else []


def filter_cautions(rows: FitRows) -> tuple[Caution, ...]:
    """Warn where the spectra of ψ' and φ end at different corners, those of two filters."""
    psi_hz, phi_hz = (
        emptied_above_hz(signal, rows.labels, sample_period_s=rows.sample_period_s)
        for signal in (rows.measured, rows.phi)
    )
    # A φ without noise is empty by itself: that alone says nothing of a filter.
    if psi_hz is None or (phi_hz is not None and phi_hz < CORNER_RATIO * psi_hz):
        return ()
    if phi_hz is None:
        return (Caution.of("psi_low_passed", psi_hz=psi_hz),)
    return (Caution.of("corners_apart", psi_hz=psi_hz, phi_hz=phi_hz),)


def _first_cutoff_hz(history: Iterable[LedgerEntry]) -> list[float]:
    """Return the cut-off of the first low-pass of a ledger: the one before the flow equation."""
    passes = [e.parameters for e in history if e.step == "filter"]
    found = [p.get("cutoff_hz") for p in passes if p.get("phase") != "none"]
    return [float(value) for value in found if isinstance(value, int | float)][:1]


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
        cautions.append(Caution.of("rows_left_out", rows=left_out, fewest=MINIMUM_SEGMENT_ROWS))
    return cautions


def _of_records(records: Sequence[CoefficientSeries]) -> list[Caution]:
    """Name what is odd about the records themselves, and what their ledgers found."""
    cautions = []
    for record in records:
        if not record.history:
            cautions.append(Caution("no_ledger", record.source))
        if record.n_segments == 1 and bool(record.scored.all()):
            cautions.append(Caution("one_segment", record.source))
    each = ", ".join(f"{name} {100.0 * speed:.1f} %" for name, speed in spread_speeds(records))
    if each:
        cautions.append(Caution.of("speeds_apart", each=each))
    return cautions + [
        Caution("ledger", record.source, entry.step, {"finding": flag})
        for record in records
        for entry in record.history
        for flag in entry.flags
    ]


def _shared_rows(results: tuple[EstimatorResult, ...]) -> list[Caution]:
    """Say whether the two rivals are independent evidence: what they share of the rows."""
    whole = {r.name: r.whole_run for r in results if r.name in ("classic_ml", "sindy")}
    if len(whole) < 2 or not any(r.model.measured for r in results if r.name in whole):
        return []
    if all(whole.values()):
        shared = (
            "Both use the same probes"
            if isinstance(whole["classic_ml"], WholeRecordRun)
            else "Both use the same rows in stall"
        )
    elif not any(whole.values()):
        shared = "Both are fitted to the same rows"
    else:
        return []
    return [Caution.of("shared_rows", shared=shared)]


def _taus_apart(results: tuple[EstimatorResult, ...]) -> list[Caution]:
    plain = [r for r in results if r.whole_run is None and r.extended is None]
    taus = [r.model.time_constant_s for r in plain if r.model.measured]
    if len(taus) < 2 or max(taus) <= (1.0 + 2.0 * TAU_AGREEMENT) * min(taus):
        return []
    all_of_them = len(plain) == len(results)
    who = "the estimators" if all_of_them else "the estimators on the filtered rows"
    return [Caution.of("taus_apart", who=who, low_ms=1e3 * min(taus), high_ms=1e3 * max(taus))]
