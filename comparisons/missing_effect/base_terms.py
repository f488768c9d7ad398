"""Base terms that the sparse regression discovers, on the rows that a diagnosis fits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from classic_ml.series import CoefficientSeries
from comparisons.missing_effect.lag_data import TRAIN
from comparisons.missing_effect.loading import load_data
from comparisons.results import is_known_term
from surge_core.errors import require


def discovered_terms(records: Sequence[CoefficientSeries]) -> tuple[list[str], list[str]]:
    """Return the terms that the sparse regression finds on the rows that a diagnosis fits.

    Beside them: those left out because their function is not known. The rows that the diagnosis
    holds out take no part: else the structure would know them.

    Raises
    ------
    InputError
        When the records do not go together, or no term that is found has a known function.
    """
    from classic_ml.whole_run_rows import has_whole_run

    ordered = sorted(records, key=lambda record: float(record.time_s[0]))
    data = load_data(ordered)
    time_s, rows = data.sampled(data["time_s"]), data.scored(TRAIN)
    until_s = {
        n: float(time_s[rows & (data.record == n)].max()) for n in np.unique(data.record[rows])
    }
    fitted = [ordered[number] for number in until_s]
    if all(has_whole_run(record) for record in ordered):
        from comparisons.harness.sparse_whole_run import fit_sparse_whole_runs

        found = fit_sparse_whole_runs(fitted, until_s=list(until_s.values())).terms_
    else:
        found = _row_terms(fitted, list(until_s.values()))
    terms = [name for name in found if is_known_term(name)]
    expected = "a structure with terms such as 1, phi, phi^2 or relu(phi-0.05)"
    remedy = "--degree N takes the powers of φ"
    require(bool(terms), "--base sindy", expected, ", ".join(found) or "none", remedy)
    return terms, [name for name in found if name not in terms]


def _row_terms(records: Sequence[CoefficientSeries], until_s: list[float]) -> list[str]:
    from comparisons.harness.rows import stack_rows
    from sindy_surge import SparseLagRegressor

    cut = [
        replace(record, segment=np.where(record.time_s <= end, record.segment, 0))
        for record, end in zip(records, until_s, strict=True)
    ]
    rows = stack_rows(cut)
    # Only the names are used: what resampling tells of their certainty is the structure command's.
    model = SparseLagRegressor(
        rows.sample_period_s, hold="first", psi_terms=False, output_name="psi_p", n_bootstrap=0
    )
    return list(model.fit(rows.X, rows.measured, segments=rows.labels).terms_)
