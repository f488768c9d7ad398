"""LagRegressor of classic_ml, standard errors and all."""

from __future__ import annotations

from collections.abc import Sequence

from worker import PERIOD_S, FloatArray, serve

from classic_ml import LagRegressor


def fit(phi: FloatArray, y: FloatArray) -> Sequence[float]:
    model = LagRegressor(sample_period_s=PERIOD_S, noise="armax").fit(phi[:, None], y)
    return [model.time_constant_s_, *model.coef_]


if __name__ == "__main__":
    serve(fit)
