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
