"""Joint fit of the three equations by simulation, restarted once a cycle (multiple shooting)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sindy_surge.closed_loop.terms import StateTerms
from sindy_surge.closed_loop.windows import Supports, Windows, simulate_windows
from sindy_surge.linear_problem import LinearProblem, unit_norms, without_nuisances
from sindy_surge.uncertainty import newey_west
from surge_core.types import FloatArray

__all__ = [
    "JointFit",
    "coefficient_covariance",
    "fit_jointly",
    "library_equations",
]


_MAX_STEPS = 30
_MAX_TRIALS = 8
# Scores further apart than this share of a window are taken for independent.
_LAG_SHARE = 0.1


@dataclass(frozen=True)
class JointFit:
    """The three equations fitted together.

    Parameters
    ----------
    supports : tuple of three tuples of int
        Positions of each equation's terms within the library.
    coefficients : ndarray of shape (n_coefficients,)
        Those of dφ/dt, then of dψ'/dt, then of dΨ/dt, per second.
    starts : ndarray of shape (n_windows, 3)
        State at the first sample of each window.
    residual : ndarray of shape (n_windows, n_samples, n_measured)
        Measured less simulated, over the noise.
    converged : bool
        Whether the last step was negligible.
    """

    supports: Supports
    coefficients: FloatArray
    starts: FloatArray
    residual: FloatArray
    converged: bool

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
class _Linearised:
    """The equations about one trial, in each window the start apart from the coefficients.

    Parameters
    ----------
    starts : ndarray of shape (n_windows, n_equations, 3)
        Derivatives with respect to the start of the window.
    columns : ndarray of shape (n_windows, n_equations, n_free)
        Derivatives with respect to the free coefficients.
    residual : ndarray of shape (n_windows, n_equations)
        The residual.
    """

    starts: FloatArray
    columns: FloatArray
    residual: FloatArray

    @classmethod
    def of(
        cls, windows: Windows, sensitivities: FloatArray, residual: FloatArray, tie: FloatArray
    ) -> _Linearised:
        n_windows = len(sensitivities)
        weighted = sensitivities[:, :, : windows.noise.size] / windows.noise[:, None]
        flat = weighted.reshape(n_windows, -1, weighted.shape[-1])
        return cls(flat[:, :, :3], flat[:, :, 3:] @ tie, residual.reshape(n_windows, -1))

    def projected(self) -> tuple[FloatArray, FloatArray]:
        """Return columns and residual without what a change of the starts explains."""
        basis, _ = np.linalg.qr(self.starts)
        flipped = np.swapaxes(basis, 1, 2)
        columns = self.columns - basis @ (flipped @ self.columns)
        left = self.residual - (basis @ (flipped @ self.residual[..., None]))[..., 0]
        return columns, left

    def solver(self) -> Callable[[float], tuple[FloatArray, FloatArray]]:
        """Return the function from damping to the changes of free coefficients and starts."""
        columns, left = self.projected()
        n_free = columns.shape[-1]
        sizes = np.linalg.norm(columns, axis=(0, 1))
        sizes[sizes == 0] = 1.0
        stacked = np.concatenate((columns / sizes, left[..., None]), axis=-1)
        flat = stacked.reshape(-1, n_free + 1)
        triangle: FloatArray = np.asarray(np.linalg.qr(flat, mode="r"))[:n_free]
        inverse = np.linalg.pinv(self.starts, rcond=1e-8)

        def solve(damping: float) -> tuple[FloatArray, FloatArray]:
            system = np.vstack((triangle[:, :-1], np.sqrt(damping) * np.eye(n_free)))
            target = np.concatenate((triangle[:, -1], np.zeros(n_free)))
            change = np.linalg.lstsq(system, target, rcond=1e-12)[0] / sizes
            rest = self.residual - self.columns @ change
            return change, (inverse @ rest[..., None])[..., 0]

        return solve


def _linearise(
    windows: Windows, library: StateTerms, fit: JointFit, supports: Supports, tie: FloatArray
) -> _Linearised | None:
    """Simulate a fit with the sensitivities to all terms of `supports`; None if it breaks off."""
    own = [(k, i) for k, s in enumerate(fit.supports) for i in s]
    values = dict(zip(own, fit.coefficients.tolist(), strict=True))
    everything = np.array([values.get((k, i), 0.0) for k, s in enumerate(supports) for i in s])
    _, sensitivities = simulate_windows(
        windows, library, supports, everything, fit.starts, sensitive=True
    )
    if not np.all(np.isfinite(sensitivities)):
        return None
    return _Linearised.of(windows, sensitivities, fit.residual, tie)


def fit_jointly(
    windows: Windows,
    library: StateTerms,
    supports: Supports,
    coefficients: FloatArray,
    starts: FloatArray,
) -> JointFit:
    """Fit all coefficients and the start of every window by damped Gauss-Newton.

    A simulation of a whole record is too sensitive to its start and its coefficients to be
    fitted; one that restarts in every cycle is not (Bock 1981).

    Parameters
    ----------
    coefficients : ndarray of shape (n_coefficients,)
        First values.
    starts : ndarray of shape (n_windows, 3)
        First values of the windows' first states.
    """

    def trial(coefficients: FloatArray, starts: FloatArray) -> JointFit:
        states, _ = simulate_windows(
            windows, library, supports, coefficients, starts, sensitive=False
        )
        return JointFit(supports, coefficients, starts, windows.residual(states), False)

    tie = windows.tie(supports)
    fit = trial(coefficients, starts)
    damping = 1e-3
    for _ in range(_MAX_STEPS):
        about = _linearise(windows, library, fit, supports, tie)
        if about is None or not np.isfinite(fit.chi2):
            return fit
        solve = about.solver()
        for _ in range(_MAX_TRIALS):
            change, moved = solve(damping)
            step = trial(fit.coefficients + tie @ change, fit.starts + moved)
            # The integrator's own error may hide the last digits of the gain.
            if step.chi2 < fit.chi2 * (1 + 1e-9):
                break
            damping *= 10
        else:
            return fit
        gain = fit.chi2 - step.chi2
        damping = max(damping / 10, 1e-12)
        fit = step
        if gain < 1e-2 + 1e-7 * fit.chi2:
            return JointFit(supports, fit.coefficients, fit.starts, fit.residual, True)
    return fit


def library_equations(
    windows: Windows, library: StateTerms, allowed: Supports, fit: JointFit
) -> LinearProblem | None:
    """Return the regression on every allowed term of every equation, about a fit.

    Its target is what the fit leaves plus what its own terms explain, so that the fit's own
    support returns the fit's coefficients.

    Returns
    -------
    LinearProblem or None
        One column for each free coefficient; None if the simulation breaks off.
    """
    tie = windows.tie(allowed)
    about = _linearise(windows, library, fit, allowed, tie)
    if about is None:
        return None
    columns, left = about.projected()
    labels = [(k, i) for k, s in enumerate(allowed) for i in s]
    own = [labels.index((k, i)) for k, s in enumerate(fit.supports) for i in s]
    values = np.zeros(len(labels))
    values[own] = fit.coefficients
    # The tie has one column a free coefficient, with a one in the row of the first it drives.
    free = np.linalg.lstsq(tie, values)[0]
    flat = columns.reshape(-1, columns.shape[-1])
    return without_nuisances(flat[:, :0], flat, left.ravel() + flat @ free)


def coefficient_covariance(windows: Windows, library: StateTerms, fit: JointFit) -> FloatArray:
    """Return the covariance of the coefficients, from the scatter of the scores.

    H⁻¹ M H⁻¹ with M the Newey-West sum of the scores within each window: the inverse
    information alone is too small where the residual is not white.

    Returns
    -------
    ndarray of shape (n_coefficients, n_coefficients)
        Covariance; nan if the simulation breaks off.
    """
    tie = windows.tie(fit.supports)
    about = _linearise(windows, library, fit, fit.supports, tie)
    if about is None:
        return np.full((fit.coefficients.size, fit.coefficients.size), np.nan)
    columns, left = about.projected()
    n_windows, n_samples, n_channels = fit.residual.shape
    flat = columns.reshape(-1, columns.shape[-1])
    sizes = unit_norms(flat)
    scaled = flat / sizes
    scores = (scaled * left.ravel()[:, None]).reshape(-1, n_channels, sizes.size).sum(axis=1)
    runs = [slice(k, k + n_samples) for k in range(0, len(scores), n_samples)]
    middle = newey_west(scores, runs, max(1, round(_LAG_SHARE * n_samples)))
    bread = np.linalg.pinv(scaled.T @ scaled, rcond=1e-13, hermitian=True)
    spent = 3 * n_windows + sizes.size
    inner = bread @ middle @ bread * left.size / max(left.size - spent, 1)
    carried = tie / sizes
    covariance: FloatArray = carried @ inner @ carried.T
    return covariance
