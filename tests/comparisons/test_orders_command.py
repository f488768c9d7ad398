"""The command `orders`: the right model of a simulated series, and every bad option."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from lag_data import PERIOD_S, flow, lagged

from comparisons.cli import main


def series_table(n: int = 3000, seed: int = 0) -> pd.DataFrame:
    rng = np.random.default_rng(seed)
    phi = flow(n, rng)
    psi_p = lagged(phi, "first") + 0.003 * rng.standard_normal(n)
    return pd.DataFrame({"time_s": np.arange(n) * PERIOD_S, "phi": phi, "psi_p": psi_p})


def run(*arguments: object) -> int:
    return main([str(argument) for argument in arguments])


def test_the_right_model_is_recommended(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, out = tmp_path / "s.csv", tmp_path / "o.json"
    series_table().to_csv(file, index=False)
    assert run("orders", file, "--degrees", 1, 2, 3, "--lags", 0, 1, "--json", out) == 0
    document = json.loads(out.read_text("utf-8"))
    assert document["recommended"]["degree"] == 2
    assert document["recommended"]["input_lag"] == 0
    # arx, armax with C of order 1 and 2, and output error.
    assert len(document["rows"]) == 4 * 3 * 2
    text = capsys.readouterr().out
    assert document["reason"] in text
    assert "*" in text
