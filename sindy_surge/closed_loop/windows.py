"""Simulation of the closed loop in windows of the record, with its sensitivities."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sindy_surge.closed_loop.terms import StateTerms
from surge_core.types import FloatArray

__all__ = ["Supports", "Windows", "simulate_windows"]

Supports = tuple[tuple[int, ...], tuple[int, ...], tuple[int, ...]]

_RTOL = 1e-6
# A trial that leaves the record's range this many times over has failed; it is held there, or
# the integrator would follow it to infinity in ever smaller steps.
_RANGES = 5.0
# The right equations take two to five evaluations a sample; a trial whose equations have become
# too stiff for that is given up as one that runs away.
_EVALUATIONS_PER_SAMPLE = 10
_LEAST_EVALUATIONS = 2000


@dataclass(frozen=True)
class Windows:
    """The record cut into windows of equal length, each simulated from a start of its own.

    Parameters
    ----------
    states : ndarray of shape (n_windows, n_samples, 3)
        φ, ψ' and Ψ as measured; a plenum pressure that was not measured holds its estimate.
    noise : ndarray of shape (n_measured,)
        Standard deviation of the noise of φ, ψ' and, where measured, Ψ.
    sample_period_s : float
        Sample period in seconds.
    """

    states: FloatArray
    noise: FloatArray
    sample_period_s: float

    @classmethod
    def cut(
        cls, record: FloatArray, noise: FloatArray, sample_period_s: float, length: int
    ) -> Windows:
        """Cut a record of shape (n_rows, 3) into windows of about `length` samples.

        Fewer rows than there are windows are left over at the end.
        """
        n_windows = max(1, round(len(record) / length))
        length = len(record) // n_windows
        states = record[: n_windows * length].reshape(n_windows, length, 3)
        return cls(states, noise, sample_period_s)

    @property
    def hidden_plenum(self) -> bool:
        """Whether the plenum pressure was not measured."""
        return self.noise.size == 2

    @property
    def spread(self) -> FloatArray:
        """Standard deviation of each channel."""
        result: FloatArray = self.states.std(axis=(0, 1))
        return result

    def residual(self, states: FloatArray) -> FloatArray:
        """Return measured less simulated over the noise, of the measured channels."""
        measured = self.noise.size
        result: FloatArray = (self.states - states)[:, :, :measured] / self.noise
        return result

    def tie(self, supports: Supports) -> FloatArray:
        """Return the matrix from the free coefficients to all.

        A hidden Ψ has no unit of its own: it gets that of ψ' by dφ/dt = a (ψ' - Ψ), whose two
        coefficients are therefore one. Otherwise all are free.
        """
        identity = np.eye(sum(len(s) for s in supports))
        if not self.hidden_plenum:
            return identity
        identity[1, 0] = -1.0
        return np.delete(identity, 1, axis=1)


class _TooStiffError(ArithmeticError):
    """A trial that takes too many evaluations to simulate."""


def _rate_function(
    windows: Windows,
    library: StateTerms,
    supports: Supports,
    coefficients: FloatArray,
    scales: FloatArray | None,
) -> Callable[[float, FloatArray], FloatArray]:
    """Return the time derivative of all windows' states and sensitivities, packed flat."""
    active = tuple(sorted({i for support in supports for i in support}))
    terms = library.subset(active)
    owner = np.repeat(np.arange(3), [len(s) for s in supports])
    place = np.array([active.index(i) for s in supports for i in s], dtype=np.intp)
    matrix = np.zeros((3, len(active)))
    matrix[owner, place] = coefficients
    shape = (len(windows.states), 3, 1 if scales is None else 4 + coefficients.size)
    own_columns = 4 + np.arange(coefficients.size)
    middle = windows.states.mean(axis=(0, 1))
    reach = _RANGES * np.ptp(windows.states, axis=(0, 1))

    left = iter(range(max(_EVALUATIONS_PER_SAMPLE * windows.states.shape[1], _LEAST_EVALUATIONS)))

    def rate(_: float, flat: FloatArray) -> FloatArray:
        if next(left, None) is None:
            raise _TooStiffError
        packed = flat.reshape(shape)
        states = packed[:, :, 0]
        result = np.empty(shape)
        if scales is None:
            result[:, :, 0] = terms.values(states) @ matrix.T
        else:
            values, slopes = terms.values_and_slopes(states)
            result[:, :, 0] = values @ matrix.T
            result[:, :, 1:] = (matrix @ slopes) @ packed[:, :, 1:]
            result[:, owner, own_columns] += values[:, place] * scales
        result *= (np.abs(states - middle) < reach).all(axis=1)[:, None, None]
        return result.ravel()

    return rate


def simulate_windows(
    windows: Windows,
    library: StateTerms,
    supports: Supports,
    coefficients: FloatArray,
    starts: FloatArray,
    *,
    sensitive: bool,
) -> tuple[FloatArray, FloatArray]:
    """Simulate all windows side by side, as one system of equations.

    The sensitivities S = ∂x/∂(start, coefficients) obey dS/dt = (∂f/∂x) S + ∂f/∂c.

    Parameters
    ----------
    coefficients : ndarray of shape (n_coefficients,)
        Their coefficients.
    starts : ndarray of shape (n_windows, 3)
        First state of each window.
    sensitive : bool
        Whether the sensitivities are wanted.

    Returns
    -------
    states : ndarray of shape (n_windows, n_samples, 3)
        The states; nan from where the integrator gave up.
    sensitivities : ndarray of shape (n_windows, n_samples, 3, 3 + n_coefficients)
        The sensitivities, if asked for; else of no columns.
    """
    from scipy.integrate import solve_ivp

    n_windows, n_samples, _ = windows.states.shape
    spread = windows.spread
    scales = _coefficient_scales(windows, library, supports) if sensitive else None
    wide = 0 if scales is None else 3 + scales.size
    initial = np.zeros((n_windows, 3, 1 + wide))
    initial[:, :, 0] = starts
    if sensitive:
        initial[:, [0, 1, 2], [1, 2, 3]] = spread
    times = np.arange(n_samples) * windows.sample_period_s
    paths = np.full((n_windows, n_samples, 3, 1 + wide), np.nan)
    try:
        found = solve_ivp(
            _rate_function(windows, library, supports, coefficients, scales),
            (0.0, float(times[-1])),
            initial.ravel(),
            t_eval=times,
            rtol=_RTOL,
            atol=np.broadcast_to(_RTOL * spread[None, :, None], initial.shape).ravel(),
            max_step=float(times[-1]) / 10,
        )
        reached = found.y.shape[1]
        paths[:, :reached] = np.moveaxis(found.y.reshape(n_windows, 3, 1 + wide, reached), -1, 1)
    except _TooStiffError:
        pass
    units = np.ones(wide) if scales is None else np.concatenate((spread, scales))
    return paths[..., 0], paths[..., 1:] / units


def _coefficient_scales(windows: Windows, library: StateTerms, supports: Supports) -> FloatArray:
    """Return the coefficients with which each term alone would carry its state through a window."""
    sizes = np.sqrt(np.mean(library.values(windows.states.reshape(-1, 3)) ** 2, axis=0))
    sizes[sizes == 0] = 1.0
    rates = windows.spread / (windows.states.shape[1] * windows.sample_period_s)
    return np.concatenate([rates[k] / sizes[list(s)] for k, s in enumerate(supports)])
