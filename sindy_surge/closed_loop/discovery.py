"""The closed loop: compressor, duct and plenum discovered as an autonomous surge model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from sindy_surge.closed_loop.model import LoopState, SurgeModel
from sindy_surge.closed_loop.record import (
    Cycles,
    half_width_samples,
    hidden_plenum,
    measure_cycles,
    read_record,
)
from sindy_surge.closed_loop.shooting import (
    JointFit,
    Linearised,
    Windows,
    fit_jointly,
)
from sindy_surge.closed_loop.structure import proposed_structure, settle_structure
from sindy_surge.closed_loop.terms import surge_library
from sindy_surge.noise import difference_noise
from sindy_surge.segments import Segments
from surge_core.types import FloatArray

__all__ = ["discover_surge_model"]


# Noise assumed at least, as a share of the spread: that of a 12-bit converter whose range is five
# standard deviations. Below it, rounding and the integrator's error would ask for terms.
_LEAST_NOISE = 3.5e-4
_AGREEMENT = 0.05
# Largest number of terms of one equation.
_MOST_TERMS = 6
# Of the right structure the residual is the noise that differences show, up to a few per cent.
_EXCESS = 1.5
# A cycle that dies away leaves fewer crossings than the nine or ten of a lasting one.
_FEWEST_SIMULATED = 7


def discover_surge_model(
    phi: ArrayLike,
    psi_p: ArrayLike,
    plenum: ArrayLike | None,
    sample_period_s: float,
) -> SurgeModel:
    """Discover the autonomous surge model behind measured surge cycles.

    Three equations dx/dt = Σ c_j s_j(φ, ψ', Ψ) for the flow through the duct, the compressor's
    lag behind its characteristic and the pressure of the plenum (Greitzer 1976, with the lag of
    the E3 surge paper). One library serves all three. Sparse regression in the weak form proposes
    the terms; all coefficients are then fitted together by simulation that restarts in every
    cycle, and the structure is tested against its neighbours there.

    Parameters
    ----------
    phi : array-like of shape (n_rows,)
        Flow coefficient in the duct.
    psi_p : array-like of shape (n_rows,)
        Pressure coefficient ψ' of the compressor.
    plenum : array-like of shape (n_rows,) or None
        Plenum pressure above that behind the throttle, best as a coefficient in the unit of ψ'.
        None makes it a hidden state under the assumption dφ/dt = a (ψ' - Ψ): a duct without
        losses between compressor and plenum.
    sample_period_s : float
        Sample period in seconds.

    Returns
    -------
    SurgeModel
        The model; its `state` says whether to trust it.

    Raises
    ------
    InputError
        If a channel cannot be used, or has fewer than four surge cycles.
    """
    record, cycles = read_record(phi, psi_p, plenum, sample_period_s)
    period_samples = cycles.period_s / sample_period_s
    half_width = half_width_samples(record[:, 0], period_samples)
    rows = Segments.from_labels(None, len(record))
    noise = np.array(
        [max(difference_noise(x, rows), _LEAST_NOISE * float(x.std())) for x in record.T]
    )
    if plenum is None:
        record = np.column_stack((record, hidden_plenum(record, sample_period_s, half_width)[0]))
    windows = Windows.cut(record, noise, float(sample_period_s), period_samples, surge_library())
    support, coefficients = proposed_structure(windows, half_width, _MOST_TERMS)
    fit = fit_jointly(windows, support, coefficients, windows.states[:, 0])
    # What the first structure leaves counts as noise in the choice between structures.
    if np.isfinite(fit.chi2):
        windows = replace(windows, noise=noise * np.maximum(fit.channel_rms, 1.0))
        fit = fit_jointly(windows, support, fit.coefficients, fit.starts)
    fit, settled = settle_structure(windows, fit, _MOST_TERMS)
    return _judged(_model(windows, fit, record, cycles), noise, fit.converged and settled)


def _model(windows: Windows, fit: JointFit, record: FloatArray, cycles: Cycles) -> SurgeModel:
    """Write the fit as three equations, with the covariance of all their coefficients."""
    support = list(fit.support)
    weights, owner = windows.weights[support], windows.equation[support]
    about = Linearised.about(windows, fit)
    spread = np.full((len(support),) * 2, np.nan) if about is None else about.covariance()
    terms, coefficients, rows = [], [], []
    for equation in range(record.shape[1]):
        own = weights * (owner == equation)[:, None]
        used = np.flatnonzero(own.any(axis=0)).tolist()
        terms.append(windows.library.subset(used))
        rows.append(own.T[used])
        coefficients.append(rows[-1] @ fit.coefficients)
    carried = np.vstack(rows)
    return SurgeModel(
        tuple(terms),
        tuple(coefficients),
        carried @ spread @ carried.T,
        fit.starts[0],
        windows.sample_period_s,
        record.min(axis=0),
        record.max(axis=0),
        fit.channel_rms * windows.noise,
        cycles,
        Cycles(np.nan, (np.nan,) * record.shape[1], 0),
        LoopState.NOT_CONVERGED,
    )


def _judged(model: SurgeModel, noise: FloatArray, settled: bool) -> SurgeModel:
    """Let the model run by itself, and say what came of it."""
    states = model.simulate()
    finite = bool(np.all(np.isfinite(states)))
    if finite:
        model = replace(model, simulated_cycles=measure_cycles(states, model.sample_period_s))
    state = LoopState.OK if settled else LoopState.NOT_CONVERGED
    if not finite or model.simulated_cycles.n_cycles < _FEWEST_SIMULATED:
        state = LoopState.DOES_NOT_CYCLE
    elif any(abs(row.difference) > _AGREEMENT for row in model.cycle_rows()):
        state = LoopState.CYCLES_DIFFER
    elif np.max(model.noise / noise) > _EXCESS or not model.is_lag:
        state = LoopState.MODEL_ERROR
    return replace(model, state=state)
