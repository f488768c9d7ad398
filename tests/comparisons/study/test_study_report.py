"""The report of a study: who is best and what failed."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pandas as pd

from comparisons.study.report import render_study_report
from comparisons.study.spec import StudySpec, spec_from

METHODS = ("classic_ml", "sindy", "paper")


def made_results(methods: tuple[str, ...] = METHODS) -> pd.DataFrame:
    """Return a study of 12 records in which each method is 0.5 ms worse than the one before."""
    rng = np.random.default_rng(2)
    rows = []
    for k in range(12):
        hard = 5.0 + rng.normal()
        for place, name in enumerate(methods):
            rows.append(
                {
                    "record": f"r-{k}",
                    "reduction": f"d-{k}",
                    "method": name,
                    "record.hide": ("none", "sensitivity_drift")[k % 2],
                    "state": "ok",
                    "reason": "",
                    "tau_error_ms": hard + 0.5 * place + 0.05 * rng.normal(),
                    "seconds": 0.1 * 4.0**place,
                }
            )
    return pd.DataFrame(rows)


def spec(methods: tuple[str, ...] = METHODS) -> StudySpec:
    given: dict[str, Any] = {
        "title": "noise & drift",
        "scores": ["tau_error_ms"],
        "by": ["record.hide"],
        "record": {"hide": ["none", "sensitivity_drift"]},
        "method": [{"name": name} for name in methods],
    }
    return spec_from(given)


def words(page: str) -> str:
    """Return the text of a page, without its tags."""
    return " ".join(re.sub(r"<[^>]*>", " ", page).split())


def test_the_report_leads_with_the_answer_and_says_what_failed() -> None:
    table = made_results()
    table.loc[[4, 7, 10], ["state", "reason"]] = ["failed", "singular <matrix>"]
    page = words(render_study_report(table, spec()))
    assert page.index("classic_ml is best by |error of τ|") < page.rindex("Methods")
    assert "36 cells of 3 methods on 12 records; 3 failed." in page
    # All three failures of one method for one reason are one line.
    assert "sindy failed 3 singular &lt;matrix&gt;" in page
    assert "survivors only" in page
