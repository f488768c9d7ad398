"""A method of your own beside the others: any class with ``fit`` and ``predict``.

    sindy-surge compare series.csv --method your_own_method:NearestPast

with the folder of this file in PYTHONPATH. It predicts ψ' from φ now and a little earlier.
"""

from __future__ import annotations

import contextlib
import io
import json
from pathlib import Path

import numpy as np
from sklearn.neighbors import KNeighborsRegressor


class NearestPast:
    """The mean ψ' of the twenty moments with the most similar φ of late."""

    def __init__(self, sample_period_s: float) -> None:
        self.back = [round(s / sample_period_s) for s in (0.0, 0.01, 0.02, 0.03)]

    def _past(self, X: np.ndarray) -> np.ndarray:
        return np.column_stack([X[np.maximum(np.arange(len(X)) - k, 0), 0] for k in self.back])

    def fit(self, X: np.ndarray, y: np.ndarray) -> NearestPast:
        """X (n, 1) is φ, y (n,) is ψ'."""
        self.model = KNeighborsRegressor(20).fit(self._past(X), y)
        return self

    def predict(self, X: np.ndarray) -> np.ndarray:
        """Return ψ' from φ alone, of shape (n,)."""
        return self.model.predict(self._past(X))


def main() -> None:
    from comparisons.cli import main as sindy_surge

    for command in (
        "simulate --case 985 -o rig",
        "reduce rig/raw.csv --test rig/test.toml -o series.csv",
        "compare series.csv --no-twins --method your_own_method:NearestPast --json compare.json",
    ):
        with contextlib.redirect_stdout(io.StringIO()):
            assert sindy_surge(command.split()) == 0
    for name, found in json.loads(Path("compare.json").read_text("utf-8"))["estimators"].items():
        tau = found["time_constant_s"]
        words = "no τ" if tau is None else f"τ = {1e3 * tau['value']:.1f} ms"
        print(f"{name}: held-out rms {found['fit']['held_out']['rms']:.4f}, {words}")


if __name__ == "__main__":
    main()
