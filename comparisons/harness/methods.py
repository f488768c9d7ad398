"""Methods of anybody's own beside the estimators: any class with ``fit`` and ``predict``.

A method is named by ``module:Class``, by one of `PEERS` or by an entry point of the group
``sindy_surge.methods``. Nothing but ``fit`` and ``predict`` is asked of it; what else it offers
(τ, a curve, its own one-step prediction) is shown.
"""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import entry_points
from types import SimpleNamespace
from typing import Any

import numpy as np

from classic_ml.series import CoefficientSeries
from comparisons.harness.estimators import EstimatorSpec
from comparisons.results import FitRows
from surge_core.errors import InputError
from surge_core.segments import runs_of
from surge_core.types import BoolArray, FloatArray, IntArray

_ROOM = "comparisons.harness.peers"
# Other people's methods that come with the package; each asks for its own library when it is made.
PEERS = {
    "pysindy": f"{_ROOM}:PlainPysindy",
    "frols": f"{_ROOM}:Frols",
    "narx": f"{_ROOM}:NarxNetwork",
    "prediction_error": f"{_ROOM}:PredictionError",
}
NAN = float("nan")
# What the curve of a method is known by: it has all of them or none.
CURVE = {"terms_": (), "coef_": np.empty(0), "covariance_": np.empty((0, 0))}


def method_name(given: str) -> str:
    """Return what a method is called in a table: the name of its class, or its own."""
    return given.rpartition(":")[2]


@dataclass(frozen=True)
class OwnMethod:
    """A method by what names it.

    Parameters
    ----------
    given : str
        ``module:Class`` or a name.
    called : str
        What it is called; as by :func:`method_name` without it.
    parameters : mapping
        What the class is made with.
    """

    given: str
    called: str = ""
    parameters: Mapping[str, Any] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """What it is called."""
        return self.called or method_name(self.given)

    def check(self) -> None:
        """Refuse, before anything is computed, a class that cannot be had, made or fitted."""
        made = self._made(1e-3)
        lacking = [name for name in ("fit", "predict") if not callable(getattr(made, name, None))]
        if lacking:
            raise InputError(
                f"method {self.name}",
                expected="a class with fit(X, y) and predict(X)",
                found=f"{type(made).__name__} without {' and '.join(lacking)}",
            )

    def spec(self) -> EstimatorSpec:
        """Return it as an estimator of a comparison."""
        return EstimatorSpec(self.name, self.name, self._fitted)

    def naming(self) -> Callable[[Sequence[CoefficientSeries]], Sequence[str]] | None:
        """Return ``firm_names`` of one that names effects in place of a fit; None for others."""
        naming: Callable[[Sequence[CoefficientSeries]], Sequence[str]] | None
        naming = getattr(self._made(1e-3), "firm_names", None)
        return naming

    def _fitted(self, rows: FitRows, _: Sequence[CoefficientSeries]) -> SimpleNamespace:
        """Return the fitted method as an estimator: NaN and none for what it lacks."""
        made = self._made(rows.sample_period_s)
        # Copies: what it scales in place is scored as measured.
        arrays = rows.X.copy(), rows.measured.copy()
        fitted = _asked(self.name, made.fit, *arrays, segments=rows.labels.copy())
        own = OwnFit(self.name, made if fitted is None else fitted)
        has = own.estimator
        whole = all(hasattr(has, each) for each in CURVE)
        interval = getattr(has, "ci95_s_", None)
        return SimpleNamespace(
            extended_=own,
            characteristic=own.characteristic,
            fit_state_=getattr(has, "fit_state_", None),
            cautions_=getattr(has, "cautions_", ()),
            time_constant_s_=getattr(has, "time_constant_s_", NAN),
            time_constant_stderr_s_=getattr(has, "time_constant_stderr_s_", NAN),
            ci95_s_=None if interval is None else (float(interval[0]), float(interval[1])),
            **{name: getattr(has, name) if whole else none for name, none in CURVE.items()},
        )

    def _made(self, sample_period_s: float) -> Any:
        """Make an estimator; the sample period is passed where its class takes one."""
        factory = _class_of(self.given, self.name)
        options = dict(self.parameters)
        try:
            if "sample_period_s" in inspect.signature(factory).parameters:
                options.setdefault("sample_period_s", sample_period_s)
            return factory(**options)
        except InputError:
            raise
        except Exception as error:
            raise InputError(
                f"method {self.name}: parameters",
                expected=f"what {self.given} takes",
                found=f"{type(error).__name__}: {error}",
            ) from error


@dataclass(frozen=True)
class OwnFit:
    """A fitted method as a model that can be run over rows.

    Parameters
    ----------
    name : str
        What it is called.
    estimator : object
        Fitted, with ``predict``.
    """

    name: str
    estimator: Any

    def characteristic(self, phi: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return its curve at φ and the error of that, of shape (n,); NaN where it has none."""
        none = np.full(phi.size, NAN)
        if not callable(getattr(self.estimator, "characteristic", None)):
            return none, none
        found = _asked(self.name, self.estimator.characteristic, phi.copy())
        value, stderr = found if isinstance(found, tuple) else (found, none)
        return _values(self.name, "characteristic", value, phi.size), np.asarray(stderr, float)

    def equation(self) -> str:
        """Return the method in one line."""
        own = getattr(self.estimator, "equation", None)
        return str(own()) if callable(own) else f"{type(self.estimator).__name__}: no equation"

    def free_run_over(
        self,
        rows: FitRows,
        records: Sequence[CoefficientSeries],
        labels: IntArray | None = None,
    ) -> FloatArray:
        """Return its prediction from φ: of ψ' it is given the first row of each segment alone."""
        marks = rows.labels if labels is None else labels
        start = np.full(rows.phi.size, NAN)
        for run in runs_of(marks, start.size):
            start[run.start] = rows.measured[run.start]
        found = _asked(
            self.name, self.estimator.predict, rows.X.copy(), segments=marks.copy(), start=start
        )
        return _values(self.name, "predict", found, start.size)

    def one_step_over(
        self, rows: FitRows, records: Sequence[CoefficientSeries]
    ) -> tuple[FloatArray, BoolArray]:
        """Return its own prediction one step ahead, and which rows have one: none without it."""
        own = getattr(self.estimator, "one_step", None)
        if not callable(own):
            return np.zeros(rows.phi.size), np.zeros(rows.phi.size, dtype=np.bool_)
        arrays = rows.X.copy(), rows.measured.copy()
        value, known = _asked(self.name, own, *arrays, segments=rows.labels.copy())
        return _values(self.name, "one_step", value, rows.phi.size), np.asarray(known, np.bool_)

    def to_json(self) -> dict[str, Any]:
        """Return the name: what a method holds is its own."""
        return {"estimator": self.name}


def named_methods() -> dict[str, str]:
    """Return ``module:Class`` of the methods that have a name; no entry point takes a peer's."""
    return {p.name: p.value for p in entry_points(group="sindy_surge.methods")} | PEERS


def _class_of(given: str, called: str) -> Any:
    module, colon, name = named_methods().get(given, given).partition(":")
    if not colon:
        raise InputError(
            f"method {called}",
            expected=f"module:Class, or one of {', '.join(named_methods())}",
            found="neither",
        )
    try:
        return getattr(importlib.import_module(module), name)
    except Exception as error:
        raise InputError(
            f"method {called}",
            expected=f"a class at {module}:{name}",
            found=f"{type(error).__name__}: {error}",
            remedy="install its package where the workers run, or put its folder into PYTHONPATH",
        ) from error


def _asked(name: str, function: Any, *arrays: FloatArray, **options: Any) -> Any:
    """Call a function of a method with the options that it takes."""
    taken = inspect.signature(function).parameters
    try:
        return function(*arrays, **{key: options[key] for key in options if key in taken})
    except InputError:
        raise
    except Exception as error:
        where = f"method {name}: {function.__name__}"
        found = f"{type(error).__name__}: {error}"
        raise InputError(where, expected="an answer", found=found) from error


def _values(name: str, what: str, found: Any, size: int) -> FloatArray:
    try:
        values = np.asarray(found, dtype=np.float64).reshape(-1)
    except (TypeError, ValueError):
        values = np.empty(0)
    if values.size != size or not np.all(np.isfinite(values)):
        shown = f"{values.size} values" if values.size != size else "NaN or infinite ones"
        raise InputError(f"method {name}: {what}", expected=f"{size} finite values", found=shown)
    return values
