"""Other people's methods, as one would write them in an afternoon, behind ``fit`` and ``predict``.

Each takes X (n, 1) = φ and y (n,) = ψ' with ``segments`` and simulates from φ; ``start`` is the
measured ψ' at the first row of each segment.
"""

from __future__ import annotations

import warnings
from abc import ABC, abstractmethod
from importlib.util import find_spec
from typing import Any, Self

import numpy as np
import pysindy
from numpy.polynomial.polynomial import polyval
from scipy.optimize import least_squares
from scipy.signal import lfilter
from sklearn.compose import TransformedTargetRegressor
from sklearn.neural_network import MLPRegressor
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import PolynomialFeatures, StandardScaler

from surge_core.errors import InputError
from surge_core.segments import runs_of
from surge_core.types import FloatArray, IntArray

# C keeps its root inside the circle, or the filter that whitens runs away.
LARGEST_C = 0.999
# Of the polynomials in ψ' and φ, the terms that FROLS chooses, and the network's one hidden layer.
DEGREE, CHOSEN_TERMS, HIDDEN_UNITS = 2, 8, 16
# A simulation that runs off stays finite, and is scored as what it is.
FARTHEST = 1e3


def _lagged(
    phi: FloatArray, y: FloatArray, segments: IntArray | None, lags: int
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return inputs (ψ', φ before, φ now), the ψ' to predict and its rows; no seam is crossed."""
    runs = runs_of(segments, phi.size)
    known = [np.arange(run.start + lags, run.stop) for run in runs]
    rows = np.concatenate(known).astype(np.int64)
    if rows.size < 10 * (lags + 1):
        raise InputError("rows", expected="segments longer than the lags", found=f"{rows.size}")
    before = np.arange(-lags, 0)
    past = y[rows[:, None] + before]
    return np.hstack([past, phi[rows[:, None] + np.append(before, 0)]]), y[rows], rows


class _Simulated(ABC):
    """What is run freely, step by step, from the last rows of ψ' and φ."""

    lags = 1
    level_ = 0.0

    @abstractmethod
    def _step(self, y: FloatArray, phi: FloatArray) -> FloatArray:
        """Return the next ψ' from the last ``lags`` and φ at these rows and the next, (n, …)."""

    def predict(
        self,
        X: FloatArray,
        segments: IntArray | None = None,
        start: FloatArray | None = None,
    ) -> FloatArray:
        """Return the free run of ψ', of shape (n,): all segments are run side by side."""
        begin = np.full(len(X), self.level_) if start is None else start
        lags, phi, runs = self.lags, X[:, 0], runs_of(segments, len(X))
        longest = max(run.stop - run.start for run in runs)
        to = np.arange(longest)
        rows = np.array([np.minimum(to, run.stop - run.start - 1) + run.start for run in runs])
        flow = phi[rows]
        # Before its first row a segment rests.
        flow = np.hstack([np.repeat(flow[:, :1], lags, axis=1), flow])
        found = np.repeat(begin[[run.start for run in runs]][:, None], lags + longest, axis=1)
        for k in range(lags + 1, lags + longest):
            after = self._step(found[:, k - lags : k], flow[:, k - lags : k + 1])
            found[:, k] = np.clip(after, -FARTHEST, FARTHEST)
        out = np.empty(phi.size)
        for run, values in zip(runs, found, strict=True):
            out[run] = values[lags : lags + run.stop - run.start]
        return out


class _Narx(_Simulated):
    """What networks and FROLS share: inputs of two lags, and their own step ahead."""

    lags = 2

    def one_step(
        self, X: FloatArray, y: FloatArray, segments: IntArray | None = None
    ) -> tuple[FloatArray, Any]:
        """Return ψ' one step ahead, of shape (n,), and which rows have one."""
        inputs, _, rows = _lagged(X[:, 0], y, segments, self.lags)
        out, known = y.copy(), np.zeros(y.size, dtype=np.bool_)
        out[rows], known[rows] = self._step(*np.hsplit(inputs, [self.lags])), True
        return out, known


class NarxNetwork(_Narx):
    """A NARX network: scikit-learn's MLPRegressor on two lags of ψ' and φ, run freely."""

    def fit(self, X: FloatArray, y: FloatArray, segments: IntArray | None = None) -> Self:
        """Fit it to φ, of shape (n, 1), and ψ', of shape (n,)."""
        inputs, target, _ = _lagged(X[:, 0], y, segments, self.lags)
        self.level_ = float(np.mean(target))
        network = MLPRegressor(
            hidden_layer_sizes=(HIDDEN_UNITS,),
            activation="tanh",
            solver="lbfgs",
            max_iter=500,
            random_state=0,
        )
        scaled = make_pipeline(StandardScaler(), network)
        self.model_ = TransformedTargetRegressor(scaled, transformer=StandardScaler())
        with warnings.catch_warnings():
            # It is stopped after so many steps.
            warnings.simplefilter("ignore")
            self.model_.fit(inputs, target)
        return self

    def _step(self, y: FloatArray, phi: FloatArray) -> FloatArray:
        return np.asarray(self.model_.predict(np.hstack([y, phi])))


class Frols(_Narx):
    """Polynomial NARX by forward regression: sysidentpy's FROLS chooses, least squares fits."""

    def __init__(self) -> None:
        if find_spec("sysidentpy") is None:
            raise InputError(
                "package sysidentpy",
                expected="it to be installed",
                found="no module sysidentpy",
                remedy='pip install "sindy-surge[peers]", or leave that --method out',
            )

    def fit(self, X: FloatArray, y: FloatArray, segments: IntArray | None = None) -> Self:
        """Fit it to φ, of shape (n, 1), and ψ', of shape (n,)."""
        from sysidentpy.model_structure_selection import FROLS

        inputs, target, _ = _lagged(X[:, 0], y, segments, self.lags)
        self.level_ = float(np.mean(target))
        self.features_ = PolynomialFeatures(DEGREE).fit(inputs)
        columns = self.features_.transform(inputs)
        # On the rows themselves: its own lags would cross the seams between segments.
        chooser = FROLS(n_terms=CHOSEN_TERMS, order_selection=False)
        # It leaves out the first rows of the target, which its own lags would need.
        padded = np.concatenate([np.zeros(chooser.max_lag), target])[:, None]
        chosen = chooser.error_reduction_ratio(columns, padded, CHOSEN_TERMS)[1]
        self.chosen_ = np.asarray(chosen, dtype=np.int64)
        self.weights_ = np.linalg.lstsq(columns[:, self.chosen_], target)[0]
        return self

    def _step(self, y: FloatArray, phi: FloatArray) -> FloatArray:
        columns = self.features_.transform(np.hstack([y, phi]))[:, self.chosen_]
        return np.asarray(columns @ self.weights_)


class PlainPysindy(_Simulated):
    """pysindy as its tutorial has it: smoothed differences, STLSQ, polynomials in ψ' and φ.

    Parameters
    ----------
    sample_period_s : float
        Sample period in s.
    threshold : float
        Of STLSQ, on normalised columns.
    """

    def __init__(self, sample_period_s: float, threshold: float = 1.0) -> None:
        self.sample_period_s = sample_period_s
        self.threshold = threshold

    def fit(self, X: FloatArray, y: FloatArray, segments: IntArray | None = None) -> Self:
        """Fit it to φ, of shape (n, 1), and ψ', of shape (n,)."""
        runs = [run for run in runs_of(segments, y.size) if run.stop - run.start > 15]
        differences = pysindy.SmoothedFiniteDifference(
            smoother_kws={"window_length": 11, "polyorder": 3}
        )
        optimizer = pysindy.STLSQ(threshold=self.threshold, normalize_columns=True)
        model = pysindy.SINDy(optimizer, pysindy.PolynomialLibrary(DEGREE), differences)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            model.fit([y[r, None] for r in runs], t=self.sample_period_s, u=[X[r] for r in runs])
        names = model.get_feature_names()
        weights = np.asarray(model.coefficients())[0]
        found = dict(zip(names, weights, strict=True))
        pull = -float(found["x0"])
        self.powers_ = np.asarray(model.feature_library.powers_)
        self.weights_ = weights
        self.level_ = float(np.mean(y))
        self.time_constant_s_ = np.nan
        mixed = (self.powers_[:, 0] > 0) & (self.powers_.sum(axis=1) > 1) & (weights != 0.0)
        if pull > 0.0 and not mixed.any():
            # Linear in ψ': a lag.
            self.time_constant_s_ = 1.0 / pull
            self.characteristic = self._characteristic
        return self

    def _rate(self, y: FloatArray, phi: FloatArray) -> FloatArray:
        terms = y[:, None] ** self.powers_[:, 0] * phi[:, None] ** self.powers_[:, 1]
        return np.asarray(terms @ self.weights_)

    def _characteristic(self, phi: FloatArray) -> FloatArray:
        """Return ψ' at rest, of shape (n,)."""
        return self._rate(np.zeros_like(phi), phi) * self.time_constant_s_

    def _step(self, y: FloatArray, phi: FloatArray) -> FloatArray:
        """Go one step by Runge and Kutta, φ joined by lines."""
        last, old, new = y[:, -1], phi[:, -2], phi[:, -1]
        h, middle = self.sample_period_s, 0.5 * (old + new)
        one = self._rate(last, old)
        two = self._rate(last + 0.5 * h * one, middle)
        three = self._rate(last + 0.5 * h * two, middle)
        four = self._rate(np.clip(last + h * three, -FARTHEST, FARTHEST), new)
        return np.asarray(last + h / 6.0 * (one + 2.0 * two + 2.0 * three + four))


class PredictionError(_Simulated):
    """The lag with a parabola and a moving average, by scipy's least squares over its errors.

    Parameters
    ----------
    sample_period_s : float
        Sample period in s.
    """

    def __init__(self, sample_period_s: float) -> None:
        self.sample_period_s = sample_period_s

    def fit(self, X: FloatArray, y: FloatArray, segments: IntArray | None = None) -> Self:
        """Fit it to φ, of shape (n, 1), and ψ', of shape (n,): y[k+1] = a y[k] + b·s + C e."""
        runs, self.level_ = runs_of(segments, y.size), float(np.mean(y))
        columns = np.vander(X[:, 0], 3, increasing=True)
        # φ is joined by lines: to first order the mean of the two ends acts.
        before = [np.column_stack([y[r][:-1], _middle(columns[r])]) for r in runs]
        after = [y[r][1:] for r in runs]
        start = np.linalg.lstsq(np.vstack(before), np.concatenate(after))[0]

        def errors(parameters: FloatArray) -> FloatArray:
            parts = zip(before, after, strict=True)
            raw = (target - inputs @ parameters[:4] for inputs, target in parts)
            return np.concatenate([lfilter([1.0], [1.0, parameters[4]], part) for part in raw])

        limits = ([-np.inf] * 4 + [-LARGEST_C], [np.inf] * 4 + [LARGEST_C])
        found = least_squares(errors, [*start, 0.0], bounds=limits, x_scale="jac")
        variance = 2.0 * found.cost / (found.fun.size - 5)
        jacobian = np.asarray(found.jac)
        covariance = variance * np.linalg.pinv(jacobian.T @ jacobian)
        self.a_, self.beta_ = float(found.x[0]), found.x[1:4] / (1.0 - found.x[0])
        self.time_constant_s_ = self.time_constant_stderr_s_ = np.nan
        if 0.0 < self.a_ < 1.0:
            self.time_constant_s_ = -self.sample_period_s / np.log(self.a_)
            slope = self.time_constant_s_**2 / (self.sample_period_s * self.a_)
            self.time_constant_stderr_s_ = slope * float(np.sqrt(covariance[0, 0]))
        return self

    def characteristic(self, phi: FloatArray) -> FloatArray:
        """Return the parabola at φ, of the same shape."""
        return np.asarray(polyval(phi, self.beta_))

    def _step(self, y: FloatArray, phi: FloatArray) -> FloatArray:
        drive = (1.0 - self.a_) * self.characteristic(phi).mean(axis=1)
        return np.asarray(np.clip(self.a_, -1.0, 1.0) * y[:, -1] + drive)


def _middle(values: FloatArray) -> FloatArray:
    return np.asarray(0.5 * (values[1:] + values[:-1]))
