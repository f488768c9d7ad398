"""Foreign estimators for studies: some that fit, some that break."""

from __future__ import annotations

import os
from typing import Any

import numpy as np


class Breaks:
    """Fails in its fit."""

    def fit(self, X: Any, y: Any) -> Any:
        raise ZeroDivisionError("nothing to divide by")

    def predict(self, X: Any) -> Any:
        return np.zeros(len(X))


class Short(Breaks):
    """Predicts too few values."""

    def fit(self, X: Any, y: Any) -> Any:
        return self

    def predict(self, X: Any) -> Any:
        return np.zeros(3)


class Blank(Short):
    """Predicts nothing at all."""

    def predict(self, X: Any) -> Any:
        return np.full(len(X), np.nan)


class NoFit:
    """No estimator."""

    def predict(self, X: Any) -> Any:
        return np.zeros(len(X))


class Scales(Breaks):
    """Scales in place what it is fitted to, and predicts its mean and a random number."""

    def fit(self, X: Any, y: Any) -> Any:
        y /= 1000.0
        X *= 0.0
        self.mean = float(np.mean(y)) + 1e-6 * np.random.normal()  # noqa: NPY002
        return self

    def predict(self, X: Any) -> Any:
        return np.full(len(X), self.mean)


class Fails(Scales):
    """Fails while an environment variable says so."""

    def fit(self, X: Any, y: Any) -> Any:
        if os.environ.get("STUDY_METHODS_FAIL"):
            raise ValueError("not yet")
        return super().fit(X, y)
