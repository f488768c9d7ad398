"""What a reader should know of a comparison: of its records, its rows and its fits."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from classic_ml.series import CoefficientSeries
from classic_ml.whole_run import has_whole_run
from comparisons.harness.fit_warnings import (
    drift_of,
    drift_warnings,
    filter_warnings,
    noise_model_warnings,
)
from comparisons.harness.rows import MINIMUM_SEGMENT_ROWS, FitRows
from comparisons.harness.tau_trial import TauEstimate
from surge_core.lag import Hold

if TYPE_CHECKING:
    from comparisons.harness.compare import EstimatorResult

__all__ = ["TAU_AGREEMENT", "comparison_cautions", "spread_speeds", "told_time_constants"]

# A surge cycle lasts a tenth of a second to a few: slower than this none is seen, and faster no
# rake follows.
SLOWEST_HZ, FASTEST_HZ = 20.0, 1e5
# Records this far apart in corrected speed have different characteristics.
SPEED_SPREAD = 0.03
# Estimators that differ by more than this in τ are not measuring one thing.
TAU_AGREEMENT = 0.15
# The estimators that differ in the noise model alone; `paper` is armax wherever it stands.
NOISE_KINDS = ("paper", "classic_ml_arx", "classic_ml_output_error")


def spread_speeds(records: Sequence[CoefficientSeries]) -> list[float]:
    """Return the corrected speeds of records that are too far apart for one curve, else none.

    Parameters
    ----------
    records : sequence of CoefficientSeries
        The records.
    """
    speeds = [float(np.median(r.Nc_frac[r.scored])) for r in records if r.Nc_frac is not None]
    return speeds if len(speeds) > 1 and max(speeds) - min(speeds) > SPEED_SPREAD else []


def told_time_constants(results: tuple[EstimatorResult, ...]) -> list[float]:
    """Return the τ that were measured: those that are told from zero.

    Parameters
    ----------
    results : tuple of EstimatorResult
        What the estimators made of the rows.
    """
    models = [result.model for result in results]
    return [
        m.time_constant_s
        for m in models
        if math.isfinite(m.time_constant_s)
        and 0.0 < 2.0 * m.time_constant_stderr_s < m.time_constant_s
    ]


def comparison_cautions(
    records: Sequence[CoefficientSeries],
    rows: FitRows,
    results: tuple[EstimatorResult, ...],
    *,
    degree: int,
    hold: Hold,
    held: bool,
) -> tuple[str, ...]:
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
    cautions = []
    left_out = sum(int(record.scored.sum()) for record in records) - rows.phi.size
    if left_out:
        why = "without a known ψ or " if rows.target == "psi" else ""
        cautions.append(
            f"{left_out} rows {why}in a stretch of fewer than {MINIMUM_SEGMENT_ROWS} "
            "were not fitted"
        )
    cautions += _record_cautions(records)
    for record in records:
        for entry in record.history:
            cautions += [f"{record.source}: {flag}" for flag in entry.flags]
    on_rows = tuple(r for r in results if r.whole_run is None and r.extended is None)
    taus = told_time_constants(on_rows)
    if len(taus) > 1 and max(taus) > (1.0 + 2.0 * TAU_AGREEMENT) * min(taus):
        who = "the estimators" if on_rows == results else "the estimators on the filtered rows"
        cautions.append(
            f"{who} put τ between {1e3 * min(taus):.3g} and {1e3 * max(taus):.3g} ms: what they "
            "disagree on is not measured by those rows"
        )
    if rows.target == "psi_p" and not any(result.whole_run for result in results):
        without = [record.source for record in records if not has_whole_run(record)]
        if any(result.name == "classic_ml" for result in results) and without:
            cautions.insert(
                0,
                "classic_ml (armax) and sindy were fitted to the rows: "
                f"{', '.join(without)} without the unfiltered columns, scored rows and ledger that "
                "`sindy-surge reduce` writes",
            )
    cautions += _fit_cautions(records, rows, results, degree=degree, hold=hold, held=held)
    return tuple(dict.fromkeys(cautions))


def _fit_cautions(
    records: Sequence[CoefficientSeries],
    rows: FitRows,
    results: tuple[EstimatorResult, ...],
    *,
    degree: int,
    hold: Hold,
    held: bool,
) -> tuple[str, ...]:
    """Warn of drift, of noise models that disagree, and of signals filtered unlike."""
    noise_kinds = [r for r in results if r.name in NOISE_KINDS and r.whole_run is None]
    if rows.target != "psi_p" or not noise_kinds:
        return ()
    words: tuple[str, ...] = ()
    if not held:
        found = tuple(
            TauEstimate(
                r.name,
                r.label,
                r.model.time_constant_s,
                r.model.time_constant_stderr_s,
                r.free_run.rms,
            )
            for r in noise_kinds
        )
        words += noise_model_warnings(found)
        words += drift_warnings(found, drift_of(rows, degree=degree, hold=hold))
    histories = [record.history for record in records]
    return words + filter_warnings(rows, histories, degree=degree, hold=hold)


def _record_cautions(records: Sequence[CoefficientSeries]) -> list[str]:
    """Name what is odd about the records themselves."""
    cautions = []
    for i, record in enumerate(records):
        if not record.history:
            cautions.append(
                f"{record.source}: no ledger lies beside it, so it is not known how it was "
                "filtered; a low-pass before the flow equation makes τ come out high"
            )
        if record.n_segments == 1 and bool(record.scored.all()):
            cautions.append(
                f"{record.source}: all its rows are one segment: unstalled rows, if there are "
                "any, are fitted as in-stall"
            )
        if not SLOWEST_HZ <= record.sample_rate_hz <= FASTEST_HZ:
            cautions.append(
                f"{record.source}: {record.sample_rate_hz:g} rows a second: is time_s in seconds?"
            )
        for other in records[:i]:
            if np.array_equal(other.phi, record.phi) and np.array_equal(other.psi_p, record.psi_p):
                cautions.append(
                    f"{record.source} holds the same rows as {other.source}: errors are stated "
                    "too small"
                )
    speeds = spread_speeds(records)
    if speeds:
        cautions.append(
            f"the records lie between {100 * min(speeds):.0f} and {100 * max(speeds):.0f} % "
            "corrected speed: one curve is fitted to all of them"
        )
    return cautions
