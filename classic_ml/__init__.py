"""The paper's chain: from rake volts to the quasi-steady characteristic and the time constant."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from classic_ml.characteristics import PiecewiseLinear as PiecewiseLinear
    from classic_ml.io.series import read_series as read_series
    from classic_ml.io.series import write_series as write_series
    from classic_ml.lag_regressor import LagRegressor as LagRegressor
    from classic_ml.records import Record as Record
    from classic_ml.series import CoefficientSeries as CoefficientSeries
    from surge_core.errors import InputError as InputError
    from surge_core.fit_state import FitState as FitState

_HOMES = {
    "CoefficientSeries": "classic_ml.series",
    "FitState": "surge_core.fit_state",
    "InputError": "surge_core.errors",
    "LagRegressor": "classic_ml.lag_regressor",
    "PiecewiseLinear": "classic_ml.characteristics",
    "Record": "classic_ml.records",
    "read_series": "classic_ml.io.series",
    "write_series": "classic_ml.io.series",
}
__all__ = list(_HOMES)


def __getattr__(name: str) -> object:
    """Import a public name when it is asked for: scikit-learn takes a second to load."""
    if name not in _HOMES:
        raise AttributeError(f"module 'classic_ml' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
