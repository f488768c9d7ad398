"""The tables of the terminal.

`SINDY_SURGE_WRITE_GOLDEN=1 pytest tests/comparisons/test_table.py` writes the golden file again;
read the difference before it is committed.
"""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path

from comparison_data import made_comparison

from comparisons.results import Caution
from comparisons.show.table import comparison_table

GOLDEN = Path(__file__).parents[1] / "golden" / "comparison_table.txt"
CAUTIONS = (
    Caution.of("tau_biased", cutoff_hz="48"),
    *(
        Caution("ledger", "record.csv", "inspect", {"finding": f"P25_{n}: {3 + n} rows clipped"})
        for n in range(1, 5)
    ),
    Caution.of("taus_apart", who="the estimators", low_ms=18.0, high_ms=30.1),
)


def test_the_table_is_the_golden_one() -> None:
    text = comparison_table(made_comparison(cautions=CAUTIONS)) + "\n"
    if os.environ.get("SINDY_SURGE_WRITE_GOLDEN"):
        GOLDEN.write_text(text, "utf-8")
    assert text == GOLDEN.read_text("utf-8")


def test_a_time_constant_not_separated_from_zero_gets_an_upper_bound() -> None:
    comparison = made_comparison()
    small = {"time_constant_s": 2e-5, "time_constant_stderr_s": 1.6e-4}
    result = comparison.results[0]
    wide = dataclasses.replace(result, model=dataclasses.replace(result.model, **small))
    comparison = dataclasses.replace(comparison, results=(wide, *comparison.results[1:]))
    assert "< 0.28" in comparison.grid().rows[0]
