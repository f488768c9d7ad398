"""Methods of anybody's own: what they offer is shown, what they lack is none."""

from __future__ import annotations

import json
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from commands import refused, run
from lag_data import PERIOD_S, TAU_S, flow, lagged

from classic_ml import LagRegressor
from comparisons.harness.methods import PEERS
from comparisons.harness.peers import PlainPysindy, PredictionError


@pytest.fixture
def series(tmp_path: Path) -> Path:
    rng = np.random.default_rng(0)
    phi = flow(3000, rng)
    psi_p = lagged(phi, "first") + 0.003 * rng.standard_normal(phi.size)
    segment = np.repeat(np.arange(1, 7), 500)
    time_s = np.arange(phi.size) * PERIOD_S
    table = {"time_s": time_s, "phi": phi, "psi_p": psi_p, "segment": segment}
    pd.DataFrame(table).to_csv(tmp_path / "series.csv", index=False)
    return tmp_path / "series.csv"


def compared(series: Path, *methods: str) -> dict[str, Any]:
    out = series.with_name("compare.json")
    asked = [part for method in methods for part in ("--method", method)]
    assert run("compare", series, "--json", out, *asked) == 0
    return json.loads(out.read_text("utf-8"))["estimators"]


class Peeks:
    """Predicts what it is given of ψ' beside φ."""

    def fit(self, X: Any, y: Any) -> Peeks:
        return self

    def predict(self, X: Any, segments: Any, start: Any) -> Any:
        assert np.isfinite(start).sum() == np.count_nonzero(np.diff(segments)) + 1
        return np.nan_to_num(start)


def test_the_peers_follow_a_lag_that_is_there(series: Path) -> None:
    names = [name for name in PEERS if name != "frols" or find_spec("sysidentpy")]
    found = compared(series, *names)
    scale = np.std(pd.read_csv(series)["psi_p"])
    for name in names:
        assert found[name]["fit"]["held_out"]["rms"] < 0.2 * scale, name
    tau = found["prediction_error"]["time_constant_s"]
    assert tau["value"] == pytest.approx(TAU_S, abs=4.0 * tau["stderr"] + 0.0002)
    assert found["narx"]["fit"]["one_step"]["rms"] < 0.1 * scale


def test_the_peers_own_tau_and_curve_are_right_without_noise() -> None:
    phi = flow(3000, np.random.default_rng(1))
    y = lagged(phi, "first")
    reference = LagRegressor(PERIOD_S, noise="arx", hold="first").fit(phi[:, None], y)
    at = np.linspace(*np.percentile(phi, [10, 90]), 9)
    for peer in (PredictionError(PERIOD_S), PlainPysindy(PERIOD_S, threshold=0.1)):
        peer.fit(phi[:, None], y)
        if np.isfinite(peer.time_constant_s_):
            assert peer.time_constant_s_ == pytest.approx(TAU_S, rel=0.02)
            curve = peer.characteristic(at)
            np.testing.assert_allclose(curve, reference.characteristic(at)[0], atol=0.05)
        # The smoothed differences of pysindy cost it a little.
        found = peer.predict(phi[:, None], None, y)
        np.testing.assert_allclose(found, y, atol=0.05 * np.ptp(y))


@pytest.mark.parametrize(
    ("method", "says"),
    [
        ("nothing", "pysindy, frols"),
        ("no_such_package:Net", "no_such_package"),
        (f"{__name__}:Nothing", "no attribute"),
        ("study_methods:NoFit", "NoFit without fit"),
        ("study_methods:Breaks", "nothing to divide by"),
        ("study_methods:Short", "3 values"),
        ("study_methods:Blank", "NaN"),
    ],
)
def test_a_method_that_cannot_be_used_is_one_sentence(
    series: Path, capsys: pytest.CaptureFixture[str], method: str, says: str
) -> None:
    assert says in refused(capsys, "compare", series, "--method", method)
