"""The paper's chain: from rake volts to the quasi-steady characteristic and the time constant."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from classic_ml.characteristics import PiecewiseLinear
    from classic_ml.errors import InputError
    from classic_ml.fit_state import FitState
    from classic_ml.lag_model import LagRegressor
    from classic_ml.readers.series_files import read_series, write_series
    from classic_ml.records import Record
    from classic_ml.series import CoefficientSeries

__all__ = [
    "CoefficientSeries",
    "FitState",
    "InputError",
    "LagRegressor",
    "PiecewiseLinear",
    "Record",
    "read_series",
    "write_series",
]

_HOME = {
    "CoefficientSeries": "series",
    "FitState": "fit_state",
    "InputError": "errors",
    "LagRegressor": "lag_model",
    "PiecewiseLinear": "characteristics",
    "Record": "records",
    "read_series": "readers.series_files",
    "write_series": "readers.series_files",
}


def __getattr__(name: str) -> object:
    """Import a public name when it is asked for: scikit-learn takes a second to load."""
    if name not in _HOME:
        raise AttributeError(f"module 'classic_ml' has no attribute {name!r}")
    return getattr(import_module(f"classic_ml.{_HOME[name]}"), name)
