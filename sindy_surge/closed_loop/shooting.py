"""Joint fit of the three equations by simulation, restarted once a cycle (multiple shooting)."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from sindy_surge.candidate_terms import independent_columns
from sindy_surge.closed_loop.terms import STATES, StateTerms
from sindy_surge.linear_problem import LinearProblem, Support, without_nuisances
from surge_core.leave_out import leave_out, scatter
from surge_core.types import FloatArray, IndexArray

__all__ = ["JointFit", "Linearised", "Windows", "fit_jointly"]

_RTOL = 1e-6
# Share of the change that would move a window by its spread, for the derivatives by differences.
_DIFFERENCE = 1e-6
# A trial that leaves the record's range this many times over has failed; it is held there, or
# the integrator would follow it to infinity in ever smaller steps.
_RANGES = 5.0
# The right equations take two to five evaluations a sample; a trial whose equations have become
# too stiff for that is given up as one that runs away.
_EVALUATIONS_PER_SAMPLE = 10
_LEAST_EVALUATIONS = 2000
_MAX_STEPS = 30
_MAX_TRIALS = 8
_BLOCKS_PER_WINDOW = 10


@dataclass(frozen=True)
class JointFit:
    """The three equations fitted together.

    Parameters
    ----------
    support : tuple of int
        Positions of the terms among the candidates of the windows, rising.
    coefficients : ndarray of shape (n_support,)
        Their coefficients per second.
    starts : ndarray of shape (n_windows, 3)
        State at the first sample of each window.
    residual : ndarray of shape (n_windows, n_samples, n_measured)
        Measured less simulated, over the noise.
    converged : bool
        Whether the last step was negligible.
    """

    support: Support
    coefficients: FloatArray
    starts: FloatArray
    residual: FloatArray
    converged: bool = False

    @property
    def chi2(self) -> float:
        """Sum of the squared residuals; infinite if the simulation broke off."""
        total = float(np.sum(self.residual**2))
        return total if np.isfinite(total) else np.inf

    @property
    def channel_rms(self) -> FloatArray:
        """Root mean square of the residual of each measured channel, over its noise."""
        result: FloatArray = np.sqrt(np.mean(self.residual**2, axis=(0, 1)))
        return result


@dataclass(frozen=True)
class Windows:
    """The record cut into windows of about a cycle, each simulated from a start of its own.

    Parameters
    ----------
    states : ndarray of shape (n_windows, n_samples, 3)
        φ, ψ' and Ψ as measured; a plenum pressure that was not measured holds its estimate.
    noise : ndarray of shape (n_measured,)
        Standard deviation of the noise of φ, ψ' and, where measured, Ψ.
    sample_period_s : float
        Sample period in seconds.
    library : StateTerms
        The terms of the candidates.
    equation : ndarray of int of shape (n_candidates,)
        State whose derivative the candidate adds to.
    weights : ndarray of shape (n_candidates, n_terms)
        The candidate as a sum of terms: a single one, but for ψ' - Ψ where Ψ was not measured.
    """

    states: FloatArray
    noise: FloatArray
    sample_period_s: float
    library: StateTerms
    equation: IndexArray
    weights: FloatArray

    @classmethod
    def cut(
        cls,
        record: FloatArray,
        noise: FloatArray,
        sample_period_s: float,
        cycle_samples: float,
        library: StateTerms,
    ) -> Windows:
        """Cut a record of shape (n_rows, 3), with the terms that it can separate as candidates."""
        n_windows = max(1, round(len(record) / cycle_samples))
        length = len(record) // n_windows
        states = record[: n_windows * length].reshape(n_windows, length, len(STATES))
        single = np.eye(len(library))[independent_columns(library.values(record))]
        flow = single
        if noise.size < len(STATES):
            # A hidden Ψ has no unit of its own: it gets that of ψ' by dφ/dt = a (ψ' - Ψ).
            names = np.array(library.names)
            flow = ((names == "psi_p") - 1.0 * (names == "plenum"))[None]
        weights = np.vstack((flow, single, single))
        equation = np.repeat(np.arange(3), [len(flow), len(single), len(single)]).astype(np.intp)
        return cls(states, noise, sample_period_s, library, equation, weights)

    @property
    def spread(self) -> FloatArray:
        """Standard deviation of each channel."""
        result: FloatArray = self.states.std(axis=(0, 1))
        return result

    def fit_of(self, support: Support, coefficients: FloatArray, starts: FloatArray) -> JointFit:
        """Simulate every window and compare it with the record."""
        states = self.simulate(support, coefficients[None], starts[None])[0]
        residual: FloatArray = (self.states - states)[..., : self.noise.size] / self.noise
        return JointFit(support, coefficients, starts, residual)

    def scales(self, support: Support) -> FloatArray:
        """Return the changes of starts and coefficients that would move a window by its spread."""
        rows = list(support)
        terms = self.library.values(self.states.reshape(-1, len(STATES)))
        sizes = np.sqrt(np.mean((terms @ self.weights[rows].T) ** 2, axis=0))
        sizes[sizes == 0] = 1.0
        rates = self.spread / (self.states.shape[1] * self.sample_period_s)
        return np.concatenate((self.spread, rates[self.equation[rows]] / sizes))

    def simulate(
        self, support: Support, coefficients: FloatArray, starts: FloatArray
    ) -> FloatArray:
        """Simulate all windows of several trials side by side, as one system of equations.

        From coefficients (n_trials, n_support) and starts (n_trials, n_windows, 3) to states
        (n_trials, n_windows, n_samples, 3), nan where the integrator gave up.
        """
        from scipy.integrate import solve_ivp

        rows = list(support)
        active = np.flatnonzero(self.weights[rows].any(axis=0))
        terms = self.library.subset(active.tolist())
        weights, owner = self.weights[rows][:, active], self.equation[rows]
        into = (owner[:, None] == np.arange(len(STATES))).astype(float)
        matrices = np.einsum("ts,sa,sk->tak", coefficients, weights, into)
        middle = self.states.mean(axis=(0, 1))
        reach = _RANGES * np.ptp(self.states, axis=(0, 1))

        n_samples = self.states.shape[1]
        left = iter(range(max(_EVALUATIONS_PER_SAMPLE * n_samples, _LEAST_EVALUATIONS)))

        def rate(_: float, flat: FloatArray) -> FloatArray:
            if next(left, None) is None:
                raise ArithmeticError("too stiff")
            x = flat.reshape(starts.shape)
            inside = (np.abs(x - middle) < reach).all(axis=-1, keepdims=True)
            slope: FloatArray = (terms.values(x) @ matrices) * inside
            return slope.ravel()

        times = np.arange(n_samples) * self.sample_period_s
        atol = np.broadcast_to(_RTOL * self.spread, starts.shape).ravel()
        paths = np.full((*starts.shape, n_samples), np.nan)
        with suppress(ArithmeticError):
            found = solve_ivp(
                rate,
                (0.0, float(times[-1])),
                starts.ravel(),
                t_eval=times,
                rtol=_RTOL,
                atol=atol,
                max_step=float(times[-1]) / 10,
            )
            paths[..., : found.t.size] = found.y.reshape(*starts.shape, -1)
        return np.moveaxis(paths, -1, 2)


@dataclass(frozen=True)
class Linearised:
    """The simulation of a fit differentiated, the starts of the windows apart.

    Parameters
    ----------
    starts : ndarray of shape (n_windows, n_equations, 3)
        Derivatives with respect to the start of the window.
    columns : ndarray of shape (n_windows, n_equations, n_support)
        Derivatives with respect to the coefficients.
    residual : ndarray of shape (n_windows, n_equations)
        The residual.
    fit : JointFit
        The fit.
    """

    starts: FloatArray
    columns: FloatArray
    residual: FloatArray
    fit: JointFit

    @classmethod
    def about(
        cls, windows: Windows, fit: JointFit, support: Support | None = None
    ) -> Linearised | None:
        """Take differences for a support that holds the fit's; None if a simulation breaks off."""
        wide = fit.support if support is None else support
        values = np.zeros(len(wide))
        values[[wide.index(i) for i in fit.support]] = fit.coefficients
        moves = _DIFFERENCE * windows.scales(wide)
        n_states = len(STATES)
        trials = 1 + moves.size
        coefficients = np.tile(values, (trials, 1))
        starts = np.tile(fit.starts, (trials, 1, 1))
        for k, move in enumerate(moves):
            if k < n_states:
                starts[1 + k, :, k] += move
            else:
                coefficients[1 + k, k - n_states] += move
        paths = windows.simulate(wide, coefficients, starts)[..., : windows.noise.size]
        slopes = (paths[1:] - paths[0]) / moves[:, None, None, None] / windows.noise
        if not np.all(np.isfinite(slopes)):
            return None
        flat = np.moveaxis(slopes, 0, -1).reshape(len(fit.starts), -1, moves.size)
        residual = fit.residual.reshape(len(flat), -1)
        return cls(flat[:, :, :n_states], flat[:, :, n_states:], residual, fit)

    def projected(self) -> tuple[FloatArray, FloatArray]:
        """Return columns and residual, flat, without what a change of the starts explains."""
        basis, _ = np.linalg.qr(self.starts)
        both = np.concatenate((self.columns, self.residual[..., None]), axis=-1)
        both -= basis @ (np.swapaxes(basis, 1, 2) @ both)
        flat = both.reshape(-1, both.shape[-1])
        return flat[:, :-1], flat[:, -1]

    def linear_problem(self, support: Support) -> LinearProblem:
        """Return the regression on the terms of `support`, about the fit.

        Its target is what the fit leaves plus what its own terms explain, so that the fit's own
        support returns the fit's coefficients.
        """
        columns, left = self.projected()
        own = [support.index(i) for i in self.fit.support]
        goal = left + columns[:, own] @ self.fit.coefficients
        return without_nuisances(columns[:, :0], columns, goal)

    def covariance(self) -> FloatArray:
        """Return the covariance of the coefficients: a jackknife over tenths of the windows.

        The inverse information alone is too small where the residual is not white.
        """
        columns, left = self.projected()
        blocks = np.array_split(np.arange(left.size), _BLOCKS_PER_WINDOW * len(self.starts))
        # The starts were estimated too.
        freedom = left.size - self.starts.shape[-1] * len(self.starts)
        covariance: FloatArray = scatter(leave_out(columns, left, blocks).moves)
        covariance *= left.size / freedom
        return covariance


def fit_jointly(
    windows: Windows, support: Support, coefficients: FloatArray, starts: FloatArray
) -> JointFit:
    """Fit all coefficients and the start of every window by damped Gauss-Newton.

    A simulation of a whole record is too sensitive to its start and its coefficients to be
    fitted; one that restarts in every cycle is not (Bock 1981). The starts are projected out
    window by window, so that a long record costs no more for each cycle than a short one.

    Parameters
    ----------
    windows : Windows
        The record.
    support : tuple of int
        The candidates that stand in the equations.
    coefficients : ndarray of shape (n_support,)
        First values.
    starts : ndarray of shape (n_windows, 3)
        First values of the windows' first states.

    Returns
    -------
    JointFit
        The fit, converged or as far as it came.
    """
    fit = windows.fit_of(support, coefficients, starts)
    damping = 1e-3
    for _ in range(_MAX_STEPS):
        about = Linearised.about(windows, fit)
        if about is None or not np.isfinite(fit.chi2):
            return fit
        columns, left = about.projected()
        sizes = np.linalg.norm(columns, axis=0)
        sizes[sizes == 0] = 1.0
        target = np.concatenate((left, np.zeros(sizes.size)))
        inverse = np.linalg.pinv(about.starts, rcond=1e-8)
        for _ in range(_MAX_TRIALS):
            system = np.vstack((columns / sizes, np.sqrt(damping) * np.eye(sizes.size)))
            change = np.linalg.lstsq(system, target, rcond=1e-12)[0] / sizes
            rest = about.residual - about.columns @ change
            moved = fit.starts + (inverse @ rest[..., None])[..., 0]
            step = windows.fit_of(support, fit.coefficients + change, moved)
            # Rounding may hide the last digits of the gain.
            if step.chi2 < fit.chi2 * (1 + 1e-9):
                break
            damping *= 10
        else:
            return fit
        gain = fit.chi2 - step.chi2
        damping = max(damping / 10, 1e-12)
        fit = step
        if gain < 1e-2 + 1e-7 * fit.chi2:
            return replace(fit, converged=True)
    return fit
