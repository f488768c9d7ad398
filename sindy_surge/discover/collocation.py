"""Likelihood of an equation when every state is measured with noise: states and terms together.

The true states obey dx/dt = Θ(x, u) Ξ between any two rows, as the rule of Hermite and Simpson
writes it (order 4; Hargraves & Paris 1987):

    x_{k+1} - x_k - h/6 (f_k + 4 f_m + f_{k+1}) = 0,   x_m = (x_k + x_{k+1})/2 + h/8 (f_k - f_{k+1})

Among the states that obey it, those nearest to the measured ones are the most likely. About
states and coefficients at hand, the defects r move by A δx - G δξ; with e = measured - states,
what noise has to explain is ρ = r + A e - G δξ, of covariance S = A Aᵀ in units of the noise, and
ρᵀ S⁻¹ ρ is the squared error. S is banded, so that all of it costs as much as a few passes over
the rows, and H = Gᵀ S⁻¹ G is the information on all terms of the library at once. (Gauss-Newton
on a fully discretised problem: no run can diverge, as it does from a bad start when shooting.)
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import LinAlgError, cholesky_banded
from scipy.linalg.lapack import dtbtrs

from sindy_surge.discover.trajectories import Features, Trajectories
from sindy_surge.linear_problem import LinearProblem, Support, without_nuisances
from surge_core.types import BoolArray, FloatArray, IndexArray

# A step that moves the coefficients by less than this share of a standard error ends the search.
_STEP_SIGMA = 1e-2
_MOST_STEPS = 15
# The defects that the linearised step leaves, in units of noise, against one row's noise.
_LEAST_DEFECT = 1e-3
_HALVINGS = 4
# Parts of a step in which the error of the rule is found: it falls with their fourth power.
_PARTS = 4


@dataclass(frozen=True)
class Fit:
    """Coefficients of one support with the states that go with them."""

    xi: FloatArray  # (n_terms, n_states): Coefficients; zero outside the support
    x: FloatArray  # (n_rows, n_states): Estimated states
    chi2: float  # Squared error in units of the noise
    # (n_support, n_support): Of the coefficients, in units of the noise's variance
    covariance: FloatArray
    converged: bool  # Whether the search ended


@dataclass(frozen=True)
class Collocation:
    """Measured trajectories, candidate terms and the noise."""

    data: Trajectories  # What was measured
    features: Features  # The candidate terms
    noise: FloatArray  # (n_states,): Standard deviation of each state's noise
    known: FloatArray  # (n_terms, n_states): Coefficients that are given; zero elsewhere
    hidden: BoolArray  # (n_states,): States that are not measured
    # Length of the segments that trajectories are cut into, each with a start of its own
    rows: int | None = None
    joined: BoolArray = field(init=False)
    middle: FloatArray = field(init=False)  # Inputs half-way to the next row, and on arrival there
    end: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "joined", self.data.within(self.rows))
        object.__setattr__(self, "middle", self.data.middle_inputs())
        object.__setattr__(self, "end", self.data.end_inputs())

    @property
    def held(self) -> bool:
        """Whether an input is held between rows."""
        return bool(np.any(self.data.held))

    def cut(self, rows: int | None) -> Collocation:
        """Return the same with other segments."""
        return replace(self, rows=rows)

    def fit(
        self, support: IndexArray, xi: FloatArray, x: FloatArray, ridge: FloatArray | None = None
    ) -> Fit:
        """Fit some terms, from coefficients (n_terms, n_states) and states (n_rows, n_states).

        The support are columns of Ξ flattened by state, state * n_terms + term; a ridge, one a
        column, is added to the diagonal of H.
        """
        n_terms = xi.shape[0]
        place = support % n_terms, support // n_terms
        start = np.zeros_like(xi)
        start[place] = xi[place]
        xi, converged, chi2 = start, False, np.inf
        inverse = np.eye(support.size)
        about = _About(self, x, xi)
        for _ in range(_MOST_STEPS):
            try:
                white = about.whitened(support)
            except (LinAlgError, ValueError):
                return Fit(xi, x, np.inf, inverse, False)
            H = white.columns.T @ white.columns
            H += np.diag(ridge) if ridge is not None else 0.0
            inverse = _inverse(H)
            new = np.zeros_like(xi)
            new[place] = inverse @ (white.columns.T @ white.target)
            move = new[place] - xi[place]
            moved = float(move @ H @ move)
            target, chi2 = about.states(white, new[place])
            share = 1.0
            for _ in range(_HALVINGS):
                ahead = _About(self, x + share * (target - x), xi + share * (new - xi))
                # On the way to the step's end the defects shrink with it.
                if ahead.defect < max(2.0 * about.defect, _LEAST_DEFECT * chi2):
                    break
                share *= 0.5
            x, xi, about = ahead.x, ahead.xi, ahead
            if not (np.isfinite(chi2) and np.isfinite(about.defect)):
                return Fit(xi, x, np.inf, inverse, False)
            small = share == 1.0 and moved < _STEP_SIGMA**2 * max(support.size, 1)
            if small and about.defect < _LEAST_DEFECT * max(chi2, 1.0):
                converged = True
                break
        return Fit(xi, x, chi2, inverse, converged)

    def try_terms(self, support: Support, near: Fit) -> tuple[Fit, float]:
        """Fit some terms from a fit nearby; return the fit and its χ², infinite without one."""
        fit = self.fit(np.array(support, dtype=np.intp), near.xi, near.x)
        return fit, fit.chi2 if fit.converged else np.inf

    def rule_moves(self, support: Support, fit: Fit) -> float:
        """Return how far the error of the rule between rows moves the coefficients, as χ²."""
        about, x = _About(self, fit.x, fit.xi), fit.x[:-1]
        u, middle, end = self.data.u[:-1], self.middle, self.end
        h = about.h / _PARTS

        def rate(x: FloatArray, at: float) -> FloatArray:
            z = (1 - at) * ((1 - 2 * at) * u + 4 * at * middle) + at * (2 * at - 1) * end
            return np.asarray(self.features.values(x, z) @ about.total)

        # Runge and Kutta's rule on parts of each step.
        with np.errstate(all="ignore"):
            for at in np.arange(_PARTS) / _PARTS:
                a = rate(x, at)
                b = rate(x + h / 2 * a, at + 0.5 / _PARTS)
                c = rate(x + h / 2 * b, at + 0.5 / _PARTS)
                x = x + h / 6 * (a + 2 * b + 2 * c + rate(x + h * c, at + 1 / _PARTS))
        error = np.where(self.joined[:, None], (fit.x[1:] - x) / self.noise - about.r, 0.0)
        if not np.isfinite(error).all():
            return float(np.inf)
        white = about.whitened(np.array(support))
        basis = np.linalg.qr(white.columns)[0]
        return float(np.sum((basis.T @ _solved(white.factor, error.reshape(-1, 1))) ** 2))

    def regression(self, fit: Fit) -> LinearProblem:
        """Return the regression on all terms that are not given about a fit."""
        white = _About(self, fit.x, fit.xi).whitened(np.arange(fit.xi.size))
        return without_nuisances(np.zeros((white.target.size, 0)), white.columns, white.target)


@dataclass(frozen=True)
class _Whitened:
    """What the coefficients have to explain, in units of the noise, with the factor of S."""

    columns: FloatArray
    target: FloatArray
    factor: FloatArray
    before: FloatArray
    after: FloatArray


class _About:
    """The defects and their derivatives at states and coefficients."""

    def __init__(self, problem: Collocation, x: FloatArray, xi: FloatArray) -> None:
        self.problem, self.x, self.xi = problem, x, xi
        features, u = problem.features, problem.data.u
        total = xi + problem.known
        h = np.where(problem.joined, problem.data.step_s, 0.0)[:, None]
        self.h = h
        with np.errstate(all="ignore"):
            # A held input jumps in a row: the step before ends with another value.
            theta = features.values(x, u)
            self.theta = theta[:-1]
            self.theta_e = features.values(x[1:], problem.end) if problem.held else theta[1:]
            f, f_e = self.theta @ total, self.theta_e @ total
            middle = 0.5 * (x[1:] + x[:-1]) + h / 8.0 * (f - f_e)
            self.middle = middle
            self.theta_m = features.values(middle, problem.middle)
            f_m = self.theta_m @ total
            r = x[1:] - x[:-1] - h / 6.0 * (f + 4.0 * f_m + f_e)
            self.r = np.where(problem.joined[:, None], r, 0.0) / problem.noise
        # Against what one row's noise does to a difference, √2.
        self.defect = float(np.sum(self.r**2)) / 2.0
        self.total = total

    def _jacobians(self) -> tuple[FloatArray, FloatArray]:
        """Return A⁻ and A⁺, (n_rows - 1, n, n), in units of the noise."""
        problem, u = self.problem, self.problem.data.u

        def slopes(x: FloatArray, u: FloatArray) -> FloatArray:
            slope = problem.features.derivatives(x, u)
            return np.asarray(np.einsum("kfs,fj->kjs", slope, self.total))

        J = slopes(self.x, u)
        J, J_e = J[:-1], slopes(self.x[1:], problem.end) if problem.held else J[1:]
        self.J_m = slopes(self.middle, problem.middle)
        h = self.h[:, :, None]
        eye = np.eye(self.x.shape[1])
        before = -eye - h / 6.0 * (J + 4.0 * self.J_m @ (0.5 * eye + h / 8.0 * J))
        after = eye - h / 6.0 * (J_e + 4.0 * self.J_m @ (0.5 * eye - h / 8.0 * J_e))
        scale = problem.noise[None, :] / problem.noise[:, None]
        open_rows = problem.joined[:, None, None]
        return np.where(open_rows, before * scale, 0.0), np.where(open_rows, after * scale, 0.0)

    def whitened(self, support: IndexArray) -> _Whitened:
        """Return the regression on columns, whitened."""
        problem = self.problem
        before, after = self._jacobians()
        e = (problem.data.y - self.x) / problem.noise
        e = np.where(problem.hidden, 0.0, e)
        G = self._columns(support)
        xi_now = self.xi.T.ravel()[support]
        rho = self.r + np.einsum("kij,kj->ki", before, e[:-1])
        rho += np.einsum("kij,kj->ki", after, e[1:])
        # At ξ = 0 of the linearised problem: r + A e + G ξ_now.
        rho = rho.reshape(-1) + G @ xi_now
        factor = _factor(before, after, problem.joined)
        white = _solved(factor, np.column_stack((G, rho)))
        return _Whitened(white[:, :-1], white[:, -1], factor, before, after)

    def states(self, white: _Whitened, best: FloatArray) -> tuple[FloatArray, float]:
        """Return the states that go with coefficients, and the squared error there."""
        problem = self.problem
        rest = white.target - white.columns @ best
        multiplier = _solved(white.factor, rest, transposed=True).reshape(self.r.shape)
        eta = np.zeros_like(self.x)
        eta[:-1] -= np.einsum("kij,ki->kj", white.before, multiplier)
        eta[1:] -= np.einsum("kij,ki->kj", white.after, multiplier)
        measured = np.where(problem.hidden, self.x, problem.data.y)
        return measured + eta * problem.noise, float(np.sum(eta**2))

    def _columns(self, support: IndexArray) -> FloatArray:
        """Return G, how the defects move with the coefficients, ((n_rows - 1) n, n_support)."""
        K, n = self.r.shape
        n_terms = self.theta.shape[1]
        term, state = support % n_terms, support // n_terms
        h = np.where(self.problem.joined[:, None], self.h, 0.0)
        sums = h / 6.0 * (self.theta + 4.0 * self.theta_m + self.theta_e)[:, term]
        bends = (h**2 / 12.0) * (self.theta - self.theta_e)[:, term]
        # ∂x_m/∂ξ moves f_m in every equation.
        G = np.einsum("kis,ks->kis", self.J_m[:, :, state], bends)
        G[:, state, np.arange(support.size)] += sums
        scaled = G / self.problem.noise[:, None]
        return np.asarray(scaled.reshape(K * n, support.size))


def _factor(before: FloatArray, after: FloatArray, joined: BoolArray) -> FloatArray:
    """Return the banded Cholesky factor of S = A Aᵀ."""
    K, n, _ = before.shape
    own = before @ before.transpose(0, 2, 1) + after @ after.transpose(0, 2, 1)
    own[~joined] = np.eye(n)
    next_one = before[1:] @ after[:-1].transpose(0, 2, 1)
    band = np.zeros((2 * n, K * n))
    for a in range(n):
        for b in range(a, n):
            band[b - a, a::n] = own[:, b, a]
        for b in range(n):
            band[b - a + n, a : (K - 1) * n : n] = next_one[:, b, a]
    return np.asarray(cholesky_banded(band, lower=True, check_finite=True))


def _solved(factor: FloatArray, columns: FloatArray, *, transposed: bool = False) -> FloatArray:
    """Solve with the Cholesky factor of S, or its transpose."""
    solved, info = dtbtrs(factor, columns, uplo="L", trans="T" if transposed else "N")
    if info != 0:
        raise LinAlgError("the covariance of the defects is singular")
    return np.asarray(solved.reshape(columns.shape))


def _inverse(H: FloatArray) -> FloatArray:
    size = np.sqrt(np.maximum(np.diag(H), 1e-300))
    inverse = np.linalg.pinv(H / np.outer(size, size), hermitian=True)
    return np.asarray(inverse / np.outer(size, size))
