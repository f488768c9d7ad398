"""The rows that a comparison fits: several records stacked, no segment straddling two."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations
from typing import Any

import numpy as np

from classic_ml.coefficients import psi_is_known
from classic_ml.series import CoefficientSeries
from classic_ml.whole_run import check_rates
from classic_ml.whole_run_rows import has_whole_run, whole_run_rows
from comparisons.results import FitRows, Terms
from surge_core.errors import InputError
from surge_core.segments import runs_of, scored_pieces
from surge_core.types import BoolArray, FloatArray, IntArray

TRAIN_SHARE = 2.0 / 3.0
# An interval shorter than this says nothing about a lag of tens of milliseconds and costs a
# start of its own.
MINIMUM_SEGMENT_ROWS = 15


def stack_rows(records: Sequence[CoefficientSeries], target: str = "psi_p") -> FitRows:
    """Stack the rows in the intervals to be fitted of one or several records.

    Parameters
    ----------
    records : sequence of CoefficientSeries
        At one sample rate.
    target : {"psi_p", "psi"}
        Which coefficient is modelled. The work coefficient divides by the flow (paper, Eq 13):
        rows in which it is not known are left out and cut their segment in two.

    Raises
    ------
    InputError
        When the sample rates differ, a record is given twice or lacks the target, or nothing is
        left to fit.
    """
    check_rates(records)
    check_once(records)
    parts: list[tuple[Any, ...]] = []
    n_labels = 0
    for index, record in enumerate(records):
        values = getattr(record, target)
        if values is None:
            raise InputError(record.source, expected=f"a column {target}", found="none")
        known = psi_is_known(record.phi) if target == "psi" else True
        labels, n_labels = _labels(record.segment, record.scored & known, n_labels)
        rows = np.flatnonzero(labels)
        own = labels[rows]
        signals = record.phi[rows], values[rows], record.time_s[rows]
        parts.append((*signals, own, np.full(rows.size, index), _train(own)))
    phi, measured, time_s, labels, record_index, train = map(
        np.concatenate, zip(*parts, strict=True)
    )
    _check_rows(records, phi, measured, target)
    period_s = records[0].sample_period_s
    found = FitRows(phi, measured, time_s, labels, record_index, period_s, target, train)
    return replace(found, reduced=any(record.history for record in records))


def averaged_rows(
    records: Sequence[CoefficientSeries], until_s: Sequence[float] | None = None
) -> FitRows | None:
    """Return the rows that a free run through whole unfiltered records is scored on.

    Each stretch of them, in forward flow in stall, is a segment; φ and ψ' are averaged over one
    period of the stall cells. None without such rows, or where a record lacks its unfiltered
    columns. A record is fitted up to its time in ``until_s``; the rest is held out.
    """
    if not all(map(has_whole_run, records)):
        return None
    parts: list[tuple[Any, ...]] = []
    n_labels = 0
    for index, record in enumerate(records):
        run = whole_run_rows(record)
        labels = np.zeros(run.phi.size, dtype=np.int64)
        for piece in scored_pieces(run.weight, slice(0, labels.size)):
            n_labels += 1
            labels[piece] = n_labels
        own = labels > 0
        train = run.time_s[own] <= (np.inf if until_s is None else until_s[index])
        columns = run.phi, run.psi_p, run.time_s, labels
        parts.append((*(c[own] for c in columns), np.full(train.size, index), train, own))
    phi, psi_p, time_s, labels, record_index, train, keep = map(
        np.concatenate, zip(*parts, strict=True)
    )
    if not phi.size:
        return None
    averaged = partial(_averaged, tuple(records), keep)
    signals = phi, psi_p, time_s, labels, record_index
    return FitRows(*signals, records[0].sample_period_s, "psi_p", train, averaged)


def _averaged(records: Sequence[CoefficientSeries], keep: BoolArray, at: Terms) -> FloatArray:
    return np.concatenate([whole_run_rows(record, terms=at).terms for record in records])[keep]


def check_once(records: Sequence[CoefficientSeries]) -> None:
    """Refuse rows that are given twice: they would count as two, or be held out and fitted too."""
    for one, other in combinations(records, 2):
        if np.array_equal(one.phi, other.phi) and np.array_equal(one.psi_p, other.psi_p):
            raise InputError(
                other.source,
                expected="each record once",
                found=f"the rows of {one.source} again",
                remedy="leave one of them out",
            )


def _check_rows(
    records: Sequence[CoefficientSeries],
    phi: FloatArray,
    measured: FloatArray,
    target: str,
) -> None:
    """Refuse rows that cannot be fitted, with the reason that holds."""
    where = ", ".join(record.source for record in records)
    if phi.size == 0:
        marked = sum(int(record.scored.sum()) for record in records)
        raise InputError(
            where,
            expected=f"a segment of at least {MINIMUM_SEGMENT_ROWS} rows to be fitted",
            found=f"{marked} rows in segments that are numbered",
            remedy="number the intervals to be fitted 1, 2, … in the column segment",
        )
    for name, values in (("phi", phi), (target, measured)):
        if np.ptp(values) == 0.0:
            raise InputError(
                f"{where}: column {name}",
                expected="a signal that moves in the rows to be fitted",
                found=f"the constant {values[0]:g}",
                remedy="a lag cannot be identified without excitation",
            )


def _labels(segment: IntArray, keep: BoolArray, n_before: int) -> tuple[IntArray, int]:
    """Label the kept stretches, dropping those too short to be a segment."""
    labels = np.zeros(segment.size, dtype=np.int64)
    for run in runs_of(np.where(keep, segment, 0), segment.size):
        if keep[run.start] and run.stop - run.start >= MINIMUM_SEGMENT_ROWS:
            n_before += 1
            labels[run] = n_before
    return labels, n_before


def _train(labels: IntArray) -> BoolArray:
    """Leave out the last third of a record: whole segments where there are three or more."""
    train = np.zeros(labels.size, dtype=np.bool_)
    target = TRAIN_SHARE * labels.size
    runs = runs_of(labels, labels.size) if labels.size else []
    if len(runs) < 3:
        train[: int(target)] = True
        return train
    for run in runs:
        train[run] = run.stop <= target or run.start == 0
    return train
