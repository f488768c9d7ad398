"""The closed loop: compressor, duct and plenum discovered as an autonomous surge model."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from sindy_surge.candidate_terms import independent_columns
from sindy_surge.closed_loop.cycles import Cycles, measure_cycles
from sindy_surge.closed_loop.fit import (
    JointFit,
    coefficient_covariance,
    fit_jointly,
)
from sindy_surge.closed_loop.input import (
    half_width_samples,
    hidden_plenum,
    read_record,
    record_cycles,
)
from sindy_surge.closed_loop.model import LoopState, SurgeModel
from sindy_surge.closed_loop.structure import (
    StructureRow,
    WeakStructure,
    settle_structure,
    weak_structure,
)
from sindy_surge.closed_loop.terms import StateTerms, surge_library
from sindy_surge.closed_loop.windows import Supports, Windows
from sindy_surge.noise import difference_noise
from sindy_surge.segments import Segments
from surge_core.errors import InputError
from surge_core.types import FloatArray

__all__ = ["discover_surge_model"]


# Noise assumed at least, as a share of the spread: that of a 12-bit converter whose range is five
# standard deviations. Below it, rounding and the integrator's error would ask for terms.
_LEAST_NOISE = 3.5e-4
# Lengths of the windows of the joint fit, in cycles.
_WINDOWS = (1.0, 0.25, 0.1)
_AGREEMENT = 0.05
# Of the right structure the residual is the noise that differences show, up to a few per cent.
_EXCESS = 1.5


def discover_surge_model(
    phi: ArrayLike,
    psi_p: ArrayLike,
    plenum: ArrayLike | None,
    sample_period_s: float,
    *,
    library: StateTerms | None = None,
    max_terms: int = 6,
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
    library : StateTerms or None
        Candidate terms; None takes `surge_library`.
    max_terms : int
        Largest number of terms of one equation.

    Returns
    -------
    SurgeModel
        The model; its `state` says whether to trust it.

    Raises
    ------
    InputError
        If a channel cannot be used, or has fewer than four surge cycles.
    """
    chosen = surge_library() if library is None else library
    if max_terms < 1:
        raise InputError("max_terms", expected="at least 1", found=f"{max_terms}")
    if not {"psi_p", "plenum"} <= set(chosen.names):
        raise InputError(
            "library",
            expected="psi_p and plenum among the terms, which drive the flow through the duct",
            found=", ".join(chosen.names),
        )
    channels, period = read_record(phi, psi_p, plenum, sample_period_s)
    cycles = record_cycles(channels, period)
    half_width = half_width_samples(channels[:, 0], cycles.period_s / period)
    gain = None
    if plenum is None:
        estimate, gain = hidden_plenum(channels, period, half_width)
        channels = np.column_stack((channels, estimate))
    task = _Task(channels, gain, period, cycles, half_width, chosen, max_terms)
    fit, windows, path, settled = task.solve()
    return _model(task, fit, windows, path, settled)


@dataclass(frozen=True)
class _Task:
    """A record whose model is to be discovered.

    Parameters
    ----------
    record : ndarray of shape (n_rows, 3)
        φ, ψ' and Ψ.
    duct_gain_per_s : float or None
        First value of a in dφ/dt = a (ψ' - Ψ), if Ψ was not measured.
    sample_period_s : float
        Sample period in seconds.
    cycles : Cycles
        The record's cycles.
    half_width : int
        Half width of the test functions in samples.
    library : StateTerms
        The candidate terms.
    max_terms : int
        Largest number of terms of one equation.
    """

    record: FloatArray
    duct_gain_per_s: float | None
    sample_period_s: float
    cycles: Cycles
    half_width: int
    library: StateTerms
    max_terms: int

    @property
    def noise(self) -> FloatArray:
        """Noise of the measured channels, as their differences show it."""
        whole = Segments.from_labels(None, len(self.record))
        measured = self.record[:, : 3 if self.duct_gain_per_s is None else 2].T
        return np.array(
            [max(difference_noise(x, whole), _LEAST_NOISE * float(x.std())) for x in measured]
        )

    @property
    def allowed(self) -> Supports:
        """Terms that each equation may have: those that this record can separate."""
        usable = tuple(int(i) for i in independent_columns(self.library.values(self.record)))
        if self.duct_gain_per_s is None:
            return usable, usable, usable
        names = self.library.names
        return (names.index("psi_p"), names.index("plenum")), usable, usable

    def windows(self, cycles: float, noise: FloatArray) -> Windows:
        """Cut the record into windows of so many cycles."""
        length = max(round(cycles * self.cycles.period_s / self.sample_period_s), 8)
        return Windows.cut(self.record, noise, self.sample_period_s, length)

    def solve(self) -> tuple[JointFit, Windows, tuple[StructureRow, ...], bool]:
        """Propose the structure, fit it and settle it."""
        allowed = self.allowed
        proposed = self._proposed(allowed)
        supports = (proposed[0].support, proposed[1].support, proposed[2].support)
        coefficients = np.concatenate([one.coefficients for one in proposed])
        windows, fit = self._first_fit(supports, coefficients)
        # What the first structure leaves counts as noise in the choice between structures.
        if np.isfinite(fit.chi2):
            windows = replace(windows, noise=windows.noise * np.maximum(fit.channel_rms, 1.0))
            fit = fit_jointly(windows, self.library, supports, fit.coefficients, fit.starts)
        fit, tried, settled = settle_structure(windows, self.library, allowed, fit, self.max_terms)
        windows, fit = self._whole_cycles(windows, fit)
        rows = tuple(row for one in proposed for row in one.rows) + tried
        return fit, windows, rows, settled

    def _proposed(self, allowed: Supports) -> list[WeakStructure]:
        """Return the terms of the three equations as the weak form has them."""
        found = []
        for equation, terms in enumerate(allowed):
            if equation == 0 and self.duct_gain_per_s is not None:
                pair = self.duct_gain_per_s * np.array([1.0, -1.0])
                found.append(WeakStructure(terms, pair, ()))
                continue
            found.append(
                weak_structure(
                    self.record,
                    self.library,
                    terms,
                    equation,
                    self.half_width,
                    self.sample_period_s,
                    self.max_terms,
                )
            )
        return found

    def _first_fit(self, supports: Supports, coefficients: FloatArray) -> tuple[Windows, JointFit]:
        """Fit whole cycles at once or, where that fails, a part of a cycle first.

        Equations that are not quite right follow the record for a while, though not for a cycle.
        """
        fits: list[tuple[float, int, Windows, JointFit]] = []
        for share in _WINDOWS:
            windows = self.windows(share, self.noise)
            fit = fit_jointly(windows, self.library, supports, coefficients, windows.states[:, 0])
            if fit.converged:
                break
            fits.append((fit.chi2 / fit.residual.size, len(fits), windows, fit))
        else:
            return min(fits)[2:]
        return self._whole_cycles(windows, fit)

    def _whole_cycles(self, windows: Windows, fit: JointFit) -> tuple[Windows, JointFit]:
        """Fit whole cycles from what parts of cycles gave; keep that if it ends far worse off."""
        whole = self.windows(_WINDOWS[0], windows.noise)
        if whole.states.shape == windows.states.shape:
            return windows, fit
        again = fit_jointly(whole, self.library, fit.supports, fit.coefficients, whole.states[:, 0])
        worse = again.chi2 / again.residual.size > _EXCESS**2 * fit.chi2 / fit.residual.size
        return (whole, again) if again.converged and not worse else (windows, fit)


def _model(
    task: _Task, fit: JointFit, windows: Windows, path: tuple[StructureRow, ...], settled: bool
) -> SurgeModel:
    ends = np.cumsum([len(s) for s in fit.supports])[:2]
    flow, lag, plenum = np.split(fit.coefficients, ends)
    flow_terms, lag_terms, plenum_terms = (task.library.subset(s) for s in fit.supports)
    left = fit.channel_rms * windows.noise
    model = SurgeModel(
        (flow_terms, lag_terms, plenum_terms),
        (flow, lag, plenum),
        coefficient_covariance(windows, task.library, fit),
        fit.starts[0],
        task.sample_period_s,
        task.record.min(axis=0),
        task.record.max(axis=0),
        left,
        task.cycles,
        None,
        LoopState.OK,
        path,
    )
    states = model.simulate()
    finite = bool(np.all(np.isfinite(states)))
    simulated = measure_cycles(states, task.sample_period_s) if finite else None
    model = replace(model, simulated_cycles=simulated)
    excess = float(np.max(left / task.noise))
    return replace(model, state=_state(model, finite, excess, fit.converged and settled))


def _state(model: SurgeModel, finite: bool, excess: float, settled: bool) -> LoopState:
    if not finite:
        return LoopState.LEAVES_RANGE
    rows = model.cycle_rows()
    simulated = model.simulated_cycles
    # A cycle that dies away leaves fewer crossings than the nine or ten of a lasting one.
    if simulated is None or simulated.n_cycles < 7:
        return LoopState.DOES_NOT_CYCLE
    if any(abs(row.difference) > _AGREEMENT for row in rows):
        return LoopState.CYCLES_DIFFER
    if excess > _EXCESS:
        return LoopState.MODEL_ERROR
    if not model.is_lag:
        return LoopState.NOT_A_LAG
    return LoopState.OK if settled else LoopState.NOT_CONVERGED
