"""Base terms that the sparse regression discovers, on the rows that a diagnosis fits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from classic_ml.series import CoefficientSeries
from comparisons.missing_effect.lag_data import TRAIN
from comparisons.missing_effect.loading import load_data
from comparisons.results import is_known_term
from surge_core.errors import InputError


@dataclass(frozen=True)
class BaseTerms:
    """Terms of a base characteristic, and those left out because their function is not known."""

    terms: tuple[str, ...]
    dropped: tuple[str, ...] = ()


def discovered_terms(records: Sequence[CoefficientSeries]) -> BaseTerms:
    """Return the terms that the sparse regression finds on the rows that a diagnosis fits.

    The rows that the diagnosis holds out take no part: else the structure would know them.

    Raises
    ------
    InputError
        When the records do not go together, or no term that is found has a known function.
    """
    from classic_ml.whole_run_rows import has_whole_run

    ordered = sorted(records, key=lambda record: float(record.time_s[0]))
    until_s = _fitted_until(ordered)
    fitted = [record for record, until in zip(ordered, until_s, strict=True) if until is not None]
    ends = [until for until in until_s if until is not None]
    whole = all(has_whole_run(record) for record in ordered)
    found = _whole_run_terms(fitted, ends) if whole else _row_terms(fitted, ends)
    terms = tuple(name for name in found if is_known_term(name))
    if not terms:
        raise InputError(
            "--base sindy",
            expected="a structure with terms such as 1, phi, phi^2 or relu(phi-0.05)",
            found=", ".join(found) or "none",
            remedy="--degree N takes the powers of φ",
        )
    return BaseTerms(terms, tuple(name for name in found if name not in terms))


def _fitted_until(ordered: Sequence[CoefficientSeries]) -> list[float | None]:
    """Return the time of the last fitted row of each record; None where none is fitted."""
    data = load_data(ordered)
    time_s = data.sampled(data["time_s"])
    rows = [data.scored(TRAIN) & (data.record == number) for number in range(len(ordered))]
    return [float(time_s[own].max()) if own.any() else None for own in rows]


def _whole_run_terms(records: Sequence[CoefficientSeries], until_s: list[float]) -> list[str]:
    from comparisons.harness.sparse_whole_run import fit_sparse_whole_runs

    return list(fit_sparse_whole_runs(records, until_s=until_s).terms_)


def _row_terms(records: Sequence[CoefficientSeries], until_s: list[float]) -> list[str]:
    from comparisons.harness.rows import stack_rows
    from sindy_surge import SparseLagRegressor

    rows = stack_rows([_cut(r, end) for r, end in zip(records, until_s, strict=True)])
    # Only the names are used: what resampling tells of their certainty is the structure command's.
    model = SparseLagRegressor(
        rows.sample_period_s, hold="first", psi_terms=False, output_name="psi_p", n_bootstrap=0
    )
    return list(model.fit(rows.X, rows.measured, segments=rows.labels).terms_)


def _cut(record: CoefficientSeries, until_s: float) -> CoefficientSeries:
    return replace(record, segment=np.where(record.time_s <= until_s, record.segment, 0))
