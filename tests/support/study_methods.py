"""Estimators of other people, for studies: some that fit, some that break."""

from __future__ import annotations

import os
import signal
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


class NoFit:
    """No estimator."""

    def predict(self, X: Any) -> Any:
        return np.zeros(len(X))


class KillsItself:
    """Takes its process with it where the data are noisier than so much of their spread."""

    def __init__(self, noise: float = 0.0) -> None:
        self.noise = noise

    def fit(self, X: Any, y: Any) -> Any:
        rough = float(np.std(np.diff(y, 2))) / np.sqrt(6.0) / float(np.std(y))
        if rough > self.noise:
            os.kill(os.getpid(), signal.SIGKILL)
        return self

    def predict(self, X: Any) -> Any:
        return np.zeros(len(X))


class Scales(Breaks):
    """Scales in place what it is fitted to, and predicts its mean."""

    def fit(self, X: Any, y: Any) -> Any:
        y /= 1000.0
        X *= 0.0
        self.mean = float(np.mean(y))
        return self

    def predict(self, X: Any) -> Any:
        return np.full(len(X), self.mean)


class LeavesState(Scales):
    """Changes what all share."""

    def fit(self, X: Any, y: Any) -> Any:
        np.seterr(all="raise")
        os.chdir("/")
        np.random.seed(0)  # noqa: NPY002
        return super().fit(X, y)


class Exits(Breaks):
    """Ends the process, politely."""

    def fit(self, X: Any, y: Any) -> Any:
        raise SystemExit(0)


class Blank(Scales):
    """Predicts nothing at all."""

    def predict(self, X: Any) -> Any:
        return np.full(len(X), np.nan)


class Imaginary(Scales):
    """Predicts what no sensor shows."""

    def predict(self, X: Any) -> Any:
        return np.full(len(X), 1j)


class Fails(Scales):
    """Fails while an environment variable says so."""

    def fit(self, X: Any, y: Any) -> Any:
        if os.environ.get("STUDY_METHODS_FAIL"):
            raise ValueError("not yet")
        return super().fit(X, y)
