"""Whole records as an estimator: one answer, its second reading, or the reason why there is none.

The lag over both branches (:mod:`classic_ml.whole_record_fit`) stands beside the fit to the
in-stall rows alone (:mod:`classic_ml.whole_run`). Where the two agree they are averaged, with half
their distance as the least standard deviation; where they part by more than two of their combined
standard deviations, or their mean would be too wide to be stated, the first is the answer, its
interval spans both, and the other is the second reading.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from classic_ml.characteristics import polynomial_names
from classic_ml.series import CoefficientSeries
from classic_ml.whole_record.branches import FreeRun, design
from classic_ml.whole_record.rakes import rake_signals_of
from classic_ml.whole_record_fit import (
    LARGEST_SHARE,
    N_TWINS,
    RAMP_MACH,
    Scatter,
    WholeRecordFit,
    fit_whole_record,
)
from classic_ml.whole_run import FARTHEST, WholeRunFit, check_rates, fit_whole_runs, output_error
from classic_ml.whole_run_rows import WholeRunRows, has_whole_run, stacked_rows
from surge_core.display import Field
from surge_core.errors import InputError
from surge_core.fit_state import FitState
from surge_core.types import FloatArray

# Two standard deviations, as of an interval of 95 %.
APART = 2.0
QUANTILE = 1.96
# Both readings come from the same noise: their mean is known little better than either. The second
# knows no twins, so that it has at most the weight of the first.
CORRELATION = 0.5
LARGEST_WEIGHT = 0.5
# Of τ: what would be written as 0 %.
SMALLEST_PART = 0.005
# What lessens each part of the error of τ.
REMEDIES = {
    "the scatter of the cycles": "a longer record",
    "the choices of the fit": "a record whose flow moves in stall and does not reverse",
    "the noise of the probes": "probes or converters of lower noise",
    "the time from plane to plane": "a pressure step applied to both planes at once",
    "the law of the probes near zero flow": "a calibration of the probes near zero flow",
}
Progress = Callable[[Iterable[int]], Iterable[int]]


@dataclass(frozen=True)
class Reading:
    """A time constant and its 95 % interval, in seconds."""

    value_s: float
    ci95_s: tuple[float, float]


@dataclass(frozen=True)
class WholeRecordRun(WholeRunFit):
    """The lag over both branches of whole records, with the attributes of an estimator.

    ``rows_`` are the pieces of the free runs, ``model_`` the same lag with τ held, for the checks.

    Parameters
    ----------
    fits_ : tuple of WholeRecordFit
        One for each record.
    ci95_s_ : tuple of float
        95 % interval of τ; spans both readings where they part.
    second_reading_ : Reading or None
        The in-stall rows alone; None where they agree, or where it is refused.
    """

    fits_: tuple[WholeRecordFit, ...]
    ci95_s_: tuple[float, float]
    second_reading_: Reading | None

    @property
    def cautions_(self) -> tuple[str, ...]:
        """What the interval lacks, and what τ hangs on beside the record."""
        found = [self.left_open_] if self.left_open_ else []
        if self.fit_state_ is FitState.MISALIGNED:
            shown = [fit.reading.signals.chain.alignment for fit in self.fits_]
            found += [alignment.words for alignment in shown if alignment.known]
        if not all(fit.twins.n for fit in self.fits_):
            found.append(
                "no twins were measured: the interval of τ lacks the errors of calibration and of "
                "noise near zero flow that all cycles share"
            )
        if any(abs(fit.probe_law) > 0.5 * fit.share for fit in self.fits_):
            found.append(f"τ hangs on the law of the probes near zero flow: {self._probe_law}")
        return tuple(found)

    @property
    def left_open_(self) -> str:
        """What leaves τ open, the most first, where it is not stated for that."""
        if self.fit_state_ is not FitState.UNCERTAIN:
            return ""
        widest = max(self.fits_, key=lambda fit: fit.share)
        parts = [
            f"{name} ({f'{100.0 * part:.0f} %' if math.isfinite(part) else 'not known'})"
            for name, part in widest.parts.items()
            if part > SMALLEST_PART
        ]
        lessens = REMEDIES[next(iter(widest.parts))]
        return f"τ is left open by {', '.join(parts)}; what lessens the first is {lessens}"

    @property
    def _probe_law(self) -> str:
        moved = max((fit.probe_law for fit in self.fits_), key=abs)
        return (
            f"with a ramp in place of its jump, below a calculated Mach number of {RAMP_MACH:g}, "
            f"τ moves by {moved:+.1%}, which is part of its interval"
        )

    @property
    def measurement_share_(self) -> float:
        """Standard deviation of log τ by the time from plane to plane and the law of the probes."""
        parts = [math.hypot(fit.planes.log_tau, fit.probe_law) for fit in self.fits_]
        return max(part if math.isfinite(part) else 0.0 for part in parts)

    @property
    def trusted_phi(self) -> FloatArray:
        """φ of the scored rows in stall, up to the flow of recovery."""
        found = []
        for fit in self.fits_:
            reading = fit.reading
            phi = reading.passes.phi[fit.fit.scored & reading.in_stall]
            recovery = math.inf if reading.levels is None else reading.levels.recovery_phi
            found.append(phi[phi <= recovery])
        return np.concatenate(found)

    def _about(self) -> Iterator[Field]:
        n_cycles = sum(fit.n_cycles for fit in self.fits_)
        yield Field(
            "fitted to",
            f"{self.n_scored_} rows in forward flow, in stall and out of it, of {n_cycles} "
            "surge cycles, the stall cells cancelled by the rake difference",
        )
        if all(fit.estimated for fit in self.fits_):
            yield Field("law of the probes", self._probe_law)
        if self.second_reading_ is not None:
            low, high = (1e3 * end for end in self.second_reading_.ci95_s)
            value = 1e3 * self.second_reading_.value_s
            words = f"{value:.3g} ms ({low:.3g} to {high:.3g})"
            yield Field("second reading", words, "advice")


def has_rakes(series: CoefficientSeries) -> bool:
    """Return whether a series carries the signals of its probe pairs."""
    return rake_signals_of(series) is not None


def fit_whole_records(
    records: Sequence[CoefficientSeries],
    *,
    degree: int = 2,
    until_s: Sequence[float] | None = None,
    n_twins: int = N_TWINS,
    progress: Progress = iter,
) -> WholeRunFit:
    """Fit one lag model to all forward rows of one or several records.

    Parameters
    ----------
    records : sequence of CoefficientSeries
        At one sample rate.
    degree : int
        Degree of the characteristic.
    until_s : sequence of float, optional
        Fit each record up to this time only; the interval is then not estimated.
    n_twins : int
        Twins of each record behind the interval; 0 leaves their part out of it.
    progress : callable
        Wraps the iteration over the twins.

    Returns
    -------
    WholeRunFit
        A :class:`WholeRecordRun`; where a series lacks the signals of its probe pairs, the fit to
        the in-stall rows. A state that withholds τ says why.
    """
    check_rates(records)
    signals = [rake_signals_of(record) for record in records]
    one_immersion = any(each and each.hub_minus_tip() is None for each in signals)
    found = [each for each in signals if each is not None]
    if one_immersion or len(found) < len(records):
        why = FitState.ONE_IMMERSION if one_immersion else None
        return _in_stall_alone(records, degree, until_s, why)
    whole = until_s is None
    ends = [math.inf] * len(records) if until_s is None else until_s
    settings: Any = {"interval": whole, "n_twins": n_twins, "progress": progress}
    try:
        fits = tuple(
            fit_whole_record(each, window_of(record, end), degree=degree, **settings)
            for each, record, end in zip(found, records, ends, strict=True)
        )
    except InputError:
        # No surge cycle that could be scored: the older fit says what there is.
        return _in_stall_alone(records, degree, until_s)
    second = None
    # With one rake the rows in stall keep their cells: what they give is no reading.
    cancelled = not any(each.one_rake for each in found)
    if whole and cancelled and all(map(has_whole_run, records)):
        second = fit_whole_runs(records, degree=degree)
    return _combined(records, fits, second)


def _in_stall_alone(
    records: Sequence[CoefficientSeries],
    degree: int,
    until_s: Sequence[float] | None,
    withheld: FitState | None = None,
) -> WholeRunFit:
    """Return the fit to the rows in stall, τ withheld where it is not known to 12 %."""
    fit = fit_whole_runs(records, degree=degree, until_s=until_s)
    known = fit.time_constant_stderr_s_ <= LARGEST_SHARE * fit.time_constant_s_
    if until_s is not None or (withheld is None and fit.fit_state_ is not FitState.CONVERGED):
        return fit
    return fit if known and withheld is None else fit.withheld(withheld or FitState.UNCERTAIN)


def window_of(record: CoefficientSeries, until_s: float = math.inf) -> slice:
    """Return the rows to stay in: those of a stated window, up to the time."""
    from_s, to_s = -math.inf, until_s
    for entry in record.history:
        if entry.step == "window" and entry.parameters.get("origin") != "found":
            from_s = float(entry.parameters["from_s"])
            to_s = min(until_s, float(entry.parameters["to_s"]))
    inside = np.flatnonzero((record.time_s >= from_s) & (record.time_s <= to_s))
    return slice(int(inside[0]), int(inside[-1]) + 1) if inside.size else slice(0, 0)


@dataclass(frozen=True)
class _Answer:
    """log τ with its standard deviation, and the curve with its covariance."""

    log_tau: float
    share: float
    coefficients: FloatArray
    covariance: FloatArray

    def with_second(
        self, second: WholeRunFit, fits: tuple[WholeRecordFit, ...], planes: Scatter
    ) -> _Answer | Reading:
        """Return the mean with another reading, or that reading where the two part.

        The curve is that at the mean τ: curve and τ err together.
        """
        tau_s, stderr_s = second.time_constant_s_, second.time_constant_stderr_s_
        if second.fit_state_ is not FitState.CONVERGED or not 0.0 < stderr_s < tau_s:
            return self
        share, apart = stderr_s / tau_s, math.log(tau_s) - self.log_tau
        reach = math.exp(QUANTILE * math.hypot(share, planes.log_tau))
        parted = Reading(tau_s, (tau_s / reach, tau_s * reach))
        if abs(apart) > APART * math.hypot(share, self.share):
            return parted
        other = min(self.share**2 / (self.share**2 + share**2), LARGEST_WEIGHT)
        own, others = (1.0 - other) * self.share, other * share
        mean_share = math.sqrt(own**2 + others**2 + 2.0 * CORRELATION * own * others)
        if mean_share >= self.share:
            # The other is so uncertain that it says nothing.
            return self
        mean_share = max(mean_share, 0.5 * abs(apart))
        if math.hypot(mean_share, planes.log_tau) > LARGEST_SHARE:
            return parted
        log_tau = self.log_tau + other * apart
        own_curve, _ = _mean_curve(
            [_curve_at(math.exp(log_tau), fit) for fit in fits], [fit.covariance for fit in fits]
        )
        coefficients, _ = _mean_curve(
            (own_curve, second.coef_), (self.covariance, second.covariance_)
        )
        # Both readings see one calibration and one state: the mean of the curves is no surer.
        return _Answer(log_tau, mean_share, coefficients, self.covariance)


def _combined(
    records: Sequence[CoefficientSeries],
    fits: tuple[WholeRecordFit, ...],
    second: WholeRunFit | None,
) -> WholeRecordRun:
    """Return one answer from the fits of all records and, if there is one, another reading."""
    log_tau, share = _mean_of([(math.log(fit.tau_s), fit.own_share) for fit in fits])
    # One law of the probes holds for all records: what is not known of it does not average out.
    share = math.hypot(share, max(abs(fit.probe_law) for fit in fits))
    curve = _mean_curve([fit.coefficients for fit in fits], [fit.covariance for fit in fits])
    answer = _Answer(log_tau, share, *curve)
    state = next((f.state for f in fits if f.state is not FitState.CONVERGED), FitState.CONVERGED)
    other = None
    planes = max((fit.planes for fit in fits), key=lambda each: each.log_tau)
    if second is not None and state is FitState.CONVERGED:
        found = answer.with_second(second, fits, planes)
        if isinstance(found, Reading):
            state, other = FitState.TWO_READINGS, found
        else:
            answer = found
    # Both readings, and records of one rig, share what the planes do: nothing of it averages out.
    share, tau_s = math.hypot(answer.share, planes.log_tau), math.exp(answer.log_tau)
    if not state.withholds and math.isfinite(share) and not share <= LARGEST_SHARE:
        state, other = FitState.UNCERTAIN, None
    degree = fits[0].reading.spec.degree
    rows = _rows(records, fits, degree)
    model = output_error(records[0].sample_period_s, "first", tau_s)
    stacked_rows(rows).fitted(model)
    reach = math.exp(QUANTILE * share) if share < FARTHEST else math.nan
    low_s, high_s = tau_s / reach, tau_s * reach
    covariance = answer.covariance + planes.curve
    if other is not None:
        low_s, high_s = min(low_s, other.ci95_s[0]), max(high_s, other.ci95_s[1])
        share = math.log(high_s / low_s) / (2.0 * QUANTILE)
        covariance = covariance + _over_interval(tau_s, (low_s, high_s), fits)
    run = WholeRecordRun(
        tau_s,
        tau_s * share,
        polynomial_names("phi", degree),
        answer.coefficients,
        covariance,
        degree,
        sum(fit.cycles.n for fit in fits),
        state,
        model,
        rows,
        fits,
        (low_s, high_s),
        other,
    )
    nothing = math.nan, math.nan
    return replace(run.withheld(state), ci95_s_=nothing) if state.withholds else run


def _mean_of(readings: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Return the mean of values by their standard deviations, which grow where these part."""
    values, errors = np.array(readings).T
    if values.size == 1 or not np.all(np.isfinite(errors)):
        return float(np.mean(values)), float(np.max(errors))
    weight = errors**-2.0 / np.sum(errors**-2.0)
    mean = float(weight @ values)
    chi2 = float(np.sum(((values - mean) / errors) ** 2)) / (values.size - 1)
    return mean, float(np.sum(errors**-2.0) ** -0.5) * math.sqrt(max(chi2, 1.0))


def _curve_at(tau_s: float, fit: WholeRecordFit) -> FloatArray:
    """Return the in-stall coefficients for another time constant."""
    reading = fit.reading
    run = FreeRun.of(reading.passes, reading.spec, reading.in_stall, fit.fit.scored)
    return run.profile(tau_s)[0][: reading.spec.degree + 1]


def _over_interval(
    tau_s: float, ci95_s: tuple[float, float], fits: tuple[WholeRecordFit, ...]
) -> FloatArray:
    """Return the covariance of a curve whose 95 % band holds that at the far end of τ's interval.

    Curve and τ err together: where τ may be that of another reading, so may the curve.
    """
    far_s = max(ci95_s, key=lambda end_s: abs(math.log(end_s / tau_s)))
    moves = np.array([_curve_at(far_s, fit) - _curve_at(tau_s, fit) for fit in fits]) / QUANTILE
    return np.asarray(moves.T @ moves / len(fits))


def _mean_curve(
    coefficients: Sequence[FloatArray], covariances: Sequence[FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Return the mean of characteristics by their covariances."""
    if len(coefficients) == 1 or not all(np.isfinite(each).all() for each in covariances):
        return coefficients[0], covariances[0]
    inverse = [np.linalg.pinv(each) for each in covariances]
    covariance = np.asarray(np.linalg.pinv(np.sum(inverse, axis=0)))
    weighted = [w @ each for w, each in zip(inverse, coefficients, strict=True)]
    return covariance @ np.sum(weighted, axis=0), covariance


def _rows(
    records: Sequence[CoefficientSeries], fits: tuple[WholeRecordFit, ...], degree: int
) -> tuple[WholeRunRows, ...]:
    """Return the pieces of all free runs, each record with nuisances of its own."""
    n_terms = degree + 1
    readings = [fit.reading for fit in fits]
    designs = [design(each.passes, each.spec, each.in_stall) for each in readings]
    widths = [inputs.shape[1] - n_terms for inputs, _ in designs]
    first = np.concatenate([[0], np.cumsum(widths)])
    rows = []
    for number, (record, fit) in enumerate(zip(records, fits, strict=True)):
        (inputs, psi_p), passes = designs[number], fit.reading.passes
        phi = passes.smooth(passes.phi, fit.reading.spec.average_s)
        nuisance = np.zeros((psi_p.size, first[-1]))
        nuisance[:, first[number] : first[number + 1]] = inputs[:, n_terms:]
        for piece in passes.pieces:
            rows.append(
                WholeRunRows(
                    phi[piece],
                    inputs[piece, :n_terms],
                    nuisance[piece],
                    psi_p[piece],
                    fit.fit.scored[piece].astype(np.float64),
                    record.time_s[passes.row[piece]],
                    int(np.count_nonzero(fit.reading.in_stall[piece])),
                    np.full(phi[piece].size, number),
                )
            )
    return tuple(rows)
