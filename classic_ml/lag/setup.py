"""From the settings of a lag model and a record to the problem that is fitted."""

from __future__ import annotations

from typing import Any, Literal, Protocol

import numpy as np

from classic_ml.lag.conditioning import Conditioned
from classic_ml.lag.drift import knots_of
from classic_ml.lag.prediction import LagProblem, rows_late
from classic_ml.noise_models import NoiseKind
from surge_core.errors import InputError
from surge_core.lag import Hold
from surge_core.segments import with_known_inputs
from surge_core.types import FloatArray

__all__ = ["LagSettings", "lag_problem", "ripple_frequencies"]

# Longest dead time that is tried: transport over a few metres, and no more than a tenth of a run.
MOST_DEAD_SAMPLES = 250
MOST_OF_A_RUN = 0.1
MOST_OF_A_GIVEN_RUN = 0.5


class LagSettings(Protocol):
    """Parameters of :class:`classic_ml.LagRegressor` that make the problem."""

    sample_period_s: float
    noise: NoiseKind
    drift: Literal["spline"] | None
    hold: Hold
    noise_order: int
    knot_spacing_s: float
    exact_start: bool
    time_constant_s: float | None
    dead_time_s: float | Literal["fit"]
    ripple_hz: float | tuple[float, ...] | None


def ripple_frequencies(ripple_hz: Any) -> tuple[Any, ...]:
    """Return the frequencies of a ripple, of which there may be one, several or none.

    Parameters
    ----------
    ripple_hz : float, sequence of float or None
        As the user gave it, not yet checked.
    """
    if ripple_hz is None:
        return ()
    return tuple(np.atleast_1d(np.asarray(ripple_hz, dtype=object)).tolist())


def lag_problem(
    settings: LagSettings,
    y: FloatArray,
    conditioned: Conditioned,
    weight: FloatArray,
    runs: list[slice],
    about: float | None = None,
) -> LagProblem:
    """Set up the fit.

    Parameters
    ----------
    settings : LagSettings
        The model, its parameters checked.
    y : ndarray of shape (n,)
        ψ' as measured.
    conditioned : Conditioned
        The terms of the characteristic.
    weight : ndarray of shape (n,)
        Weight of each row.
    runs : list of slice
        The segments.
    about : float, optional
        The dead time in samples, where it is roughly known.

    Raises
    ------
    InputError
        When the dead time or the drift's knots do not suit the segments.
    """
    period = float(settings.sample_period_s)
    dead, longest = _dead_samples(settings, runs, about)
    if longest > 0.0:
        weight = with_known_inputs(weight, runs, rows_late(longest))
    knots = None if settings.drift is None else knots_of(runs, period, settings.knot_spacing_s)
    held = settings.time_constant_s
    frequencies = np.asarray(ripple_frequencies(settings.ripple_hz), dtype=np.float64)
    return LagProblem(
        # Compiled code takes read-only and strided arrays for other types, to be compiled anew.
        np.require(y, requirements=["C", "W"]),
        conditioned.rows,
        np.require(weight, requirements=["C", "W"]),
        np.zeros(0) if np.all(weight == 1.0) else np.sqrt(weight),
        tuple(runs),
        period,
        settings.hold,
        settings.noise,
        settings.noise_order if settings.noise == "armax" else 0,
        bool(settings.exact_start),
        None if held is None else float(np.log(held)),
        dead,
        settings.dead_time_s == "fit",
        knots,
        knots is not None and conditioned.constant is None,
        2.0 * np.pi * period * frequencies,
        longest,
    )


def _dead_samples(
    settings: LagSettings, runs: list[slice], about: float | None
) -> tuple[float, float]:
    """Return the dead time to start from and the longest that is tried, in samples."""
    period = float(settings.sample_period_s)
    shortest = min(run.stop - run.start for run in runs)
    if settings.dead_time_s == "fit":
        longest = max(1.0, min(MOST_DEAD_SAMPLES, MOST_OF_A_RUN * shortest))
        return (0.0, longest) if about is None else (about, min(longest, about + 1.0))
    dead = float(settings.dead_time_s) / period
    if dead > MOST_OF_A_GIVEN_RUN * shortest:
        raise InputError(
            "dead_time_s",
            expected=f"at most half of the shortest segment, {0.5 * shortest * period:g} s",
            found=f"{settings.dead_time_s:g}",
        )
    return dead, dead
