"""The tables of the terminal.

`SINDY_SURGE_WRITE_GOLDEN=1 pytest tests/comparisons/test_table.py` writes the golden file again;
read the difference before it is committed.
"""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path

from comparison_data import made_comparison, made_series

from comparisons.harness.reconstruction import reconstruct_record
from comparisons.results import COLUMNS, Caution
from comparisons.show.table import comparison_table, reconstruction_table

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


def test_cells_hold_what_the_fields_say() -> None:
    best, second, third = made_comparison().grid().rows
    by_heading = {heading: i for i, heading in enumerate(COLUMNS)}
    assert best[by_heading["Δ to least"]] == "least"
    assert second[by_heading["Δ to least"]] == "0.0025 ± 0.0011"
    assert third[by_heading["Δ to least"]] == third[by_heading["held-out rms"]] == "n/a"
    assert third[by_heading["95 % [ms]"]] == "n/a"
    assert third[by_heading["τ [ms]"]] == "20.00 ± ?"


def test_a_time_constant_not_separated_from_zero_gets_an_upper_bound() -> None:
    comparison = made_comparison()
    small = {"time_constant_s": 2e-5, "time_constant_stderr_s": 1.6e-4}
    result = comparison.results[0]
    wide = dataclasses.replace(result, model=dataclasses.replace(result.model, **small))
    comparison = dataclasses.replace(comparison, results=(wide, *comparison.results[1:]))
    assert "< 0.28" in comparison.grid().rows[0]


def test_reconstructions_of_other_records_in_a_table() -> None:
    comparison = made_comparison()
    runs = [reconstruct_record(r.model, made_series(5, "other.csv")) for r in comparison.results]
    title, *lines = reconstruction_table(runs).splitlines()
    names = " ".join(lines[2 + len(runs) :])
    assert title == "ψ' of other.csv"
    assert "classic_ml (whole-run output error)" in names
    assert "sindy (sparse regression (SINDy))" in names
    assert "custom" not in names  # it is called by its name already
    assert "sparse regression (SINDy)" in lines[2]
