"""A fitted lag model as a value: it can be saved, read back and run on another record."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from comparisons.harness.model_fields import Fields, ModelFormat, read_models, write_models
from comparisons.harness.terms import evaluate_terms, is_known_term
from surge_core.display import Displayed, Sheet
from surge_core.lag import FirstOrderLag, Hold
from surge_core.rounding import bracketed
from surge_core.segments import runs_of
from surge_core.types import FloatArray

__all__ = ["MODEL_SCHEMA", "FittedLag", "LagEstimator", "load_models", "save_models"]

MODEL_SCHEMA = "sindy-surge/model/1"
MODEL_FORMAT = ModelFormat(MODEL_SCHEMA, "a model file", "sindy-surge compare --save")
TARGETS = ("psi_p", "psi")
# More than any record has.
MOST_BLOCKS = 10**9
_HOLDS: dict[str, Hold] = {"zero": "zero", "first": "first"}


class LagEstimator(Protocol):
    """What the harness asks of a fitted estimator (DESIGN section 5)."""

    time_constant_s_: float
    time_constant_stderr_s_: float
    terms_: list[str]
    coef_: FloatArray
    covariance_: FloatArray

    def characteristic(self, phi: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return the quasi-steady characteristic and its standard error."""


@dataclass(frozen=True)
class FittedLag(Displayed):
    """τ dy/dt + y = Σ β_i s_i(φ) with numbers in it.

    Parameters
    ----------
    estimator : str
        Name of the estimator that found it.
    target : {"psi_p", "psi"}
        The coefficient it gives.
    time_constant_s, time_constant_stderr_s : float
        τ and its standard error, in seconds.
    terms : tuple of str
        Names of the s_i.
    coefficients, stderr : tuple of float
        β_i and their standard errors.
    hold : {"zero", "first"}
        How φ acts between samples.
    valid_phi : tuple of float
        Range of φ in which the curve can be trusted.
    n_blocks : int
        Blocks behind the standard errors; 0 where the estimator does not say.
    dead_time_s : float
        How much later than φ the coefficient was measured, in seconds; negative if φ was late.
    table : tuple of tuple of float
        The characteristic as (φ, value, standard error), for plots and for terms whose function
        is not known by name.
    """

    estimator: str
    target: str
    time_constant_s: float
    time_constant_stderr_s: float
    terms: tuple[str, ...]
    coefficients: tuple[float, ...]
    stderr: tuple[float, ...]
    hold: Hold
    valid_phi: tuple[float, float]
    table: tuple[tuple[float, float, float], ...]
    n_blocks: int = 0
    dead_time_s: float = 0.0

    @classmethod
    def from_estimator(
        cls,
        estimator: LagEstimator,
        name: str,
        target: str,
        hold: Hold,
        phi: FloatArray,
        valid_phi: tuple[float, float],
    ) -> FittedLag:
        """Take the numbers out of a fitted estimator.

        Parameters
        ----------
        estimator : LagEstimator
            Fitted.
        name, target : str
            How it is called and which coefficient it gives.
        hold : {"zero", "first"}
            The hold it was fitted with.
        phi : ndarray of shape (n,)
            Points at which its characteristic is kept.
        valid_phi : tuple of float
            Range of trust.
        """
        value, stderr = estimator.characteristic(phi)
        return cls(
            name,
            target,
            float(estimator.time_constant_s_),
            float(estimator.time_constant_stderr_s_),
            tuple(estimator.terms_),
            tuple(float(b) for b in estimator.coef_),
            tuple(float(s) for s in np.sqrt(np.maximum(np.diag(estimator.covariance_), 0.0))),
            hold,
            valid_phi,
            tuple(zip(phi.tolist(), value.tolist(), stderr.tolist(), strict=True)),
            int(getattr(estimator, "n_blocks_", 0)),
            float(np.nan_to_num(getattr(estimator, "dead_time_s_", 0.0))),
        )

    @property
    def ci95_s(self) -> tuple[float, float]:
        """95 % interval of τ, in seconds; on log τ where τ is well told from zero."""
        if not math.isfinite(self.time_constant_stderr_s):
            return (math.nan, math.nan)
        reach = self._quantile * self.time_constant_stderr_s
        if reach > 0.5 * self.time_constant_s:
            # So wide, log τ is no longer normal either: a bound from above is what is known.
            return (max(0.0, self.time_constant_s - reach), self.time_constant_s + reach)
        factor = math.exp(reach / self.time_constant_s)
        return (self.time_constant_s / factor, self.time_constant_s * factor)

    @property
    def _quantile(self) -> float:
        """97.5 % quantile of Student's t: a variance from few blocks is itself uncertain."""
        from scipy.stats import norm, t

        return float(t.isf(0.025, self.n_blocks - 1) if self.n_blocks > 1 else norm.isf(0.025))

    def quasi_steady(self, phi: ArrayLike) -> FloatArray:
        """Return the characteristic at φ, of shape (n,)."""
        if all(is_known_term(term) for term in self.terms):
            terms = evaluate_terms(list(self.terms), phi)
            return np.asarray(terms @ np.asarray(self.coefficients))
        grid, value, _ = np.asarray(self.table).T
        return np.asarray(np.interp(np.asarray(phi, dtype=np.float64), grid, value))

    def lag(self, sample_period_s: float) -> FirstOrderLag:
        """Return the discrete lag for a sample period."""
        return FirstOrderLag(self.time_constant_s, sample_period_s, self.hold)

    def free_run(
        self,
        phi: FloatArray,
        sample_period_s: float,
        labels: ArrayLike | None = None,
        start: FloatArray | None = None,
    ) -> FloatArray:
        """Reconstruct the coefficient from φ: no measurement of it but each segment's start.

        Parameters
        ----------
        phi : ndarray of shape (n,)
            Measured flow coefficient.
        sample_period_s : float
            Sample period of φ, in seconds; need not be that of the fit.
        labels : array-like of int, shape (n,), optional
            Segments.
        start : ndarray of shape (n,), optional
            Measured coefficient; only the first row of each segment is used.
        """
        quasi_steady = self.quasi_steady(phi)
        if not math.isfinite(self.time_constant_s):
            return quasi_steady
        begin = quasi_steady if start is None else start
        lag = self.lag(sample_period_s)
        out = np.empty_like(quasi_steady)
        for run in runs_of(labels, quasi_steady.size):
            forcing = self._late(quasi_steady[run], sample_period_s)
            out[run] = lag.respond(forcing, begin[run.start])
        return out

    def _late(self, forcing: FloatArray, sample_period_s: float) -> FloatArray:
        """Return the forcing of one segment as it acts, dead_time_s later, its ends prolonged."""
        if self.dead_time_s == 0.0:
            return forcing
        rows = np.arange(forcing.size, dtype=np.float64)
        return np.interp(rows - self.dead_time_s / sample_period_s, rows, forcing)

    def one_step(
        self,
        phi: FloatArray,
        target: FloatArray,
        sample_period_s: float,
        labels: ArrayLike | None = None,
    ) -> FloatArray:
        """Predict each row from the measured row before it; first rows predict themselves."""
        quasi_steady = self.quasi_steady(phi)
        if not math.isfinite(self.time_constant_s):
            return quasi_steady
        lag = self.lag(sample_period_s)
        out = target.copy()
        for run in runs_of(labels, target.size):
            before = target[run][:-1]
            forcing = self._late(quasi_steady[run], sample_period_s)
            out[run.start + 1 : run.stop] = lag.a * before + lag.drive(forcing)
        return out

    def equation(self) -> str:
        """Return the model in one line, each number rounded to its standard error."""
        symbol = {"psi_p": "ψ'", "psi": "ψ"}.get(self.target, self.target)
        terms = [
            _term(name, value, stderr)
            for name, value, stderr in zip(self.terms, self.coefficients, self.stderr, strict=True)
        ]
        right = " ".join(terms).removeprefix("+ ") or "0"
        if not math.isfinite(self.time_constant_s):
            return f"{symbol} = {right}"
        tau_ms = bracketed(1e3 * self.time_constant_s, 1e3 * self.time_constant_stderr_s)
        late = f", φ at t - {1e3 * self.dead_time_s:.3g} ms" if self.dead_time_s else ""
        return f"{tau_ms} ms · d{symbol}/dt + {symbol} = {right}{late}"

    def to_json(self) -> dict[str, Any]:
        """Return the value as plain JSON types."""
        return {
            "estimator": self.estimator,
            "target": self.target,
            "time_constant_s": _finite(self.time_constant_s),
            "time_constant_stderr_s": _finite(self.time_constant_stderr_s),
            "terms": [
                {"name": name, "coefficient": value, "stderr": _finite(stderr)}
                for name, value, stderr in zip(
                    self.terms, self.coefficients, self.stderr, strict=True
                )
            ],
            "hold": self.hold,
            "valid_phi": list(self.valid_phi),
            "n_blocks": self.n_blocks,
            "dead_time_s": self.dead_time_s,
            "characteristic": [[_finite(v) for v in row] for row in self.table],
        }

    @classmethod
    def from_json(cls, data: Mapping[str, Any], where: str = "model") -> FittedLag:
        """Build from what :meth:`to_json` gave.

        Parameters
        ----------
        data : mapping
            Plain JSON types.
        where : str
            File and key of the model, for errors.

        Raises
        ------
        InputError
            Naming the key that cannot be used.
        """
        return _from_fields(Fields.of(data, where, MODEL_FORMAT.remedy))

    def _sheet(self) -> Sheet:
        from comparisons.show.sheets import lag_value_sheet

        return lag_value_sheet(self)


def save_models(models: Mapping[str, FittedLag], path: str | Path) -> None:
    """Write fitted models as JSON, whole or not at all.

    Parameters
    ----------
    models : mapping of str to FittedLag
        By estimator.
    path : str or path
        Target.
    """
    write_models(models, path, MODEL_FORMAT)


def load_models(path: str | Path) -> dict[str, FittedLag]:
    """Read models that :func:`save_models` wrote; the file is data, nothing in it is executed.

    Parameters
    ----------
    path : str or path
        The file.

    Raises
    ------
    InputError
        When it is missing or is not a model file.
    """
    return {name: _from_fields(fields) for name, fields in read_models(path, MODEL_FORMAT).items()}


def _from_fields(fields: Fields) -> FittedLag:
    """Return a model from its table in a file, every number of it checked."""
    terms = fields.tables("terms")
    names = tuple(term.text("name", "the name of a term") for term in terms)
    table = fields.points("characteristic")
    if not all(map(is_known_term, names)) and not _is_curve(table):
        raise fields.refuse(
            "characteristic",
            "rows of rising φ with values, from which terms of unknown names are run",
            f"{len(table)} row{'' if len(table) == 1 else 's'} that make no curve",
        )
    late = fields.number("dead_time_s", "a dead time in s") if "dead_time_s" in fields.values else 0
    return FittedLag(
        fields.text("estimator", "the name of an estimator"),
        fields.text("target", '"psi_p" or "psi"', TARGETS),
        # Null is a time constant that was not identified; such a model runs without its lag.
        fields.maybe("time_constant_s", "a time constant above 0 s, or null", above=0.0),
        fields.maybe("time_constant_stderr_s", "a standard error in s, or null", least=0.0),
        names,
        tuple(term.number("coefficient", "a coefficient, a finite number") for term in terms),
        tuple(term.maybe("stderr", "a standard error, or null", least=0.0) for term in terms),
        _HOLDS[fields.text("hold", 'the hold "zero" or "first"', tuple(_HOLDS))],
        fields.range("valid_phi"),
        table,
        fields.whole("n_blocks", "a number of blocks", MOST_BLOCKS),
        float(late),
    )


def _is_curve(table: tuple[tuple[float, float, float], ...]) -> bool:
    phi, value = ([row[k] for row in table] for k in (0, 1))
    rises = all(before < after for before, after in pairwise(phi))
    return bool(table) and rises and all(map(math.isfinite, value))


def _term(name: str, value: float, stderr: float) -> str:
    sign = "-" if value < 0.0 else "+"
    factor = "" if name == "1" else f" {name.replace('phi', 'φ')}"
    return f"{sign} {bracketed(abs(value), stderr)}{factor}"


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
