"""The lag over both branches: one free run, its curves by least squares for each τ.

    τ dψ'/dt + ψ' = s ψ'_stall(φ) + (1 − s) ψ'_unstalled(φ, N_c)

with s the state, in stall 1. For a held τ the run is linear in all coefficients, so that the sum of
squares is a function of τ alone (variable projection). Every row in forward flow is scored, of
both branches: τ lives in the contrast between the pass into reversal and the pass out of it at the
same φ. Reversed rows are simulated through.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from classic_ml.segments import near
from classic_ml.whole_record.passes import Passes
from classic_ml.whole_record.rakes import RakeSignals
from surge_core.lag import FirstOrderLag
from surge_core.types import BoolArray, FloatArray

TAUS_S = np.geomspace(0.004, 0.08, 31)
# In log τ, half the width of the search once it is known nearly; and what is at an end of a search.
AROUND, END = 0.5, 0.03
# After this much of a piece its start has decayed to a tenth for τ of 10 ms.
START_S = 0.02
# Reversed flow is averaged over this much before it is squared, so that noise makes no loss.
LOSS_AVERAGE_S = 0.005
# Columns with less than this of the largest are no columns.
RANK = 1e-7
FEWEST_UNSTALLED = 20
HIGHER_HINGE = 1.3
# The cells are gone before this average, so that it may be shorter than half their period, and must
# be, or it mixes the pass into reversal with the pass out of it.
AVERAGE_PERIODS = 0.4
LONGEST_AVERAGE_S = 0.005


@dataclass(frozen=True)
class Specification:
    """What a fit takes for granted, each varied for the interval."""

    average_s: float  # Average over ψ' and the inputs alike, applied last
    lowest_phi: float  # φ up to which rows are not scored
    guard_s: float  # How far around such a row no row is scored
    blend_s: float = 0.006  # Time of the change between the branches
    degree: int = 2  # Of the in-stall characteristic
    hinges: bool = True  # Whether that may bend above the flow of recovery
    moves: bool = False  # Whether it moves with N_c, as the unstalled branch does


@dataclass(frozen=True)
class BranchFit:
    """A fitted lag over both branches."""

    tau_s: float
    # (q,): Of the columns of :func:`design`, those of the in-stall powers first, then the starts
    coefficients: FloatArray
    errors: FloatArray  # (m,): On the scored rows
    scored: BoolArray  # (n,): Which these are
    at_end: bool  # τ is at an end of what was searched

    @property
    def cost(self) -> float:
        """Sum of squares."""
        return float(self.errors @ self.errors)


def scored_rows(passes: Passes, spec: Specification) -> BoolArray:
    """Return the rows in forward flow, away from reversals and from the starts of pieces."""
    guard = passes.rows_of(spec.guard_s)
    left_out = near(passes.phi <= spec.lowest_phi, guard, guard)
    for piece in passes.pieces:
        left_out[piece.start : piece.start + passes.rows_of(START_S)] = True
    return ~left_out


def design(
    passes: Passes, spec: Specification, in_stall: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Return the inputs of the lag, of shape (n, q), and ψ', averaged alike."""
    phi, speed = passes.phi, passes.speed
    state = passes.smooth(in_stall.astype(np.float64), spec.blend_s)
    columns = [state * phi**power for power in range(spec.degree + 1)]
    moving = [state * speed, state * speed * phi] if spec.moves else []
    if np.count_nonzero(~in_stall) > FEWEST_UNSTALLED:
        other, own = 1.0 - state, phi - float(np.median(phi[~in_stall]))
        # A cubic: with a parabola τ was 3 % further off on machines whose branch is none.
        columns += [other * own**power for power in range(4)]
        columns += [other * speed * own**power for power in range(3)]
        columns += [other * speed**2]
        recoveries = in_stall[:-1] & ~in_stall[1:] & (passes.piece[1:] == passes.piece[:-1])
        if spec.hinges and recoveries.any():
            level = float(np.median(passes.smooth(phi, 0.003)[:-1][recoveries]))
            above = state * np.maximum(phi - level, 0.0)
            columns += [above, above * speed, state * np.maximum(phi - HIGHER_HINGE * level, 0.0)]
    columns += moving
    if has_loss(passes):
        # With its derivative beside it the loss acts without the lag for any τ.
        loss = state * _backward(passes) ** 2
        columns += [loss, np.gradient(loss) * passes.rows_of(START_S)]
    inputs = np.column_stack([passes.smooth(column, spec.average_s) for column in columns])
    return inputs, passes.smooth(passes.psi_p, spec.average_s)


def has_loss(passes: Passes) -> bool:
    """Return whether the last two inputs are the loss in reversed flow and its derivative."""
    return bool(np.any(_backward(passes) < 0.0))


def _backward(passes: Passes) -> FloatArray:
    return passes.smooth(np.minimum(passes.phi, 0.0), LOSS_AVERAGE_S)


def specification(signals: RakeSignals, passes: Passes, degree: int) -> Specification:
    """Take the average from the cells, and the lowest φ from the probes' law."""
    average_s = min(AVERAGE_PERIODS * passes.period_s, LONGEST_AVERAGE_S)
    # Eq 2 knows no flow below its offset: M_true jumps there from zero.
    chain, machine = signals.chain, signals.chain.compressor
    jump = max(abs(pair.offset) for pair in chain.of_plane(25))
    sound_m_s = math.sqrt(
        machine.gamma * machine.gas_constant_J_kg_K * float(np.median(signals.inlet_K[passes.row]))
    )
    lowest = jump * sound_m_s / chain.rotor_velocity_m_s
    return Specification(average_s, lowest, 0.5 * average_s, degree=degree)


def specifications(spec: Specification) -> tuple[Specification, ...]:
    """Return what could as well have been taken for granted, one thing changed in each."""
    return (
        replace(spec, average_s=0.6 * spec.average_s),
        replace(spec, average_s=1.4 * spec.average_s),
        replace(spec, lowest_phi=3.0 * spec.lowest_phi),
        replace(spec, guard_s=2.0 * spec.guard_s),
        replace(spec, degree=spec.degree + 1),
        replace(spec, hinges=not spec.hinges),
        replace(spec, blend_s=0.5 * spec.blend_s),
        replace(spec, blend_s=1.5 * spec.blend_s),
        replace(spec, moves=not spec.moves),
    )


@dataclass(frozen=True)
class FreeRun:
    """A free run, linear in all but τ: the inputs of the lag and ψ', averaged alike."""

    passes: Passes
    inputs: FloatArray
    psi_p: FloatArray
    scored: BoolArray

    @classmethod
    def of(
        cls,
        passes: Passes,
        spec: Specification,
        in_stall: BoolArray,
        scored: BoolArray | None = None,
    ) -> FreeRun:
        """Set up a run that is scored on all rows that could be, if no others are given."""
        scored = scored_rows(passes, spec) if scored is None else scored
        return cls(passes, *design(passes, spec, in_stall), scored)

    def profile(self, tau_s: float) -> tuple[FloatArray, FloatArray]:
        """Return coefficients and errors of the least squares for a τ, each piece with a start."""
        columns, scale = self._columns(tau_s)
        own, measured = columns[self.scored], self.psi_p[self.scored]
        coefficients = np.asarray(np.linalg.lstsq(own, measured, rcond=RANK)[0])
        return coefficients / scale, measured - own @ coefficients

    def information(self, fit: BranchFit, rows: BoolArray) -> float:
        """Return what rows know of log τ: the square of what moves with it and no column makes.

        In units of the noise's variance.
        """
        ends = [responses(fit.tau_s * by, self.passes, self.inputs)[rows] for by in (0.99, 1.01)]
        slope = (ends[1] - ends[0]) @ fit.coefficients / math.log(1.01 / 0.99)
        own = self._columns(fit.tau_s)[0][rows]
        left = slope - own @ np.linalg.lstsq(own, slope, rcond=RANK)[0]
        return float(left @ left)

    def _columns(self, tau_s: float) -> tuple[FloatArray, FloatArray]:
        """Return the responses, each over its size, and those sizes."""
        answers = responses(tau_s, self.passes, self.inputs)
        # By all rows: a column may be nothing in those that are scored.
        scale = np.sqrt(np.mean(answers**2, axis=0)) + 1e-12
        return answers / scale, scale

    def least_error(self, tau_s: float) -> float:
        """Return the mean square error of that."""
        errors = self.profile(tau_s)[1]
        return float(errors @ errors) / max(errors.size, 1)


def responses(tau_s: float, passes: Passes, inputs: FloatArray) -> FloatArray:
    """Return the lag's answers to the inputs from rest, then the decay of each piece's start."""
    lag = FirstOrderLag(tau_s, passes.sample_period_s, "first")
    pieces = passes.pieces
    out = np.zeros((inputs.shape[0], inputs.shape[1] + len(pieces)))
    for number, piece in enumerate(pieces):
        out[piece, : inputs.shape[1]] = lag.respond(inputs[piece], np.zeros(inputs.shape[1]))
        out[piece, inputs.shape[1] + number] = lag.decay(piece.stop - piece.start)
    return out


def fit_branches(
    passes: Passes,
    spec: Specification,
    in_stall: BoolArray,
    *,
    scored: BoolArray | None = None,
    near_s: float | None = None,
) -> BranchFit:
    """Fit τ and both branches, on ``scored`` rows in place of all that could be.

    The search stays near ``near_s`` where τ is known nearly.
    """
    from scipy.optimize import minimize_scalar

    run = FreeRun.of(passes, spec, in_stall, scored)
    if near_s is None:
        best = int(np.argmin([run.least_error(tau_s) for tau_s in TAUS_S]))
        ends = TAUS_S[max(best - 1, 0)], TAUS_S[min(best + 1, TAUS_S.size - 1)]
    else:
        ends = near_s * math.exp(-AROUND), near_s * math.exp(AROUND)
    found = minimize_scalar(
        lambda log_tau: run.least_error(math.exp(log_tau)),
        bounds=(math.log(ends[0]), math.log(ends[1])),
        options={"xatol": 2e-4},
    )
    tau_s = math.exp(found.x)
    at_end = min(math.log(tau_s / TAUS_S[0]), math.log(TAUS_S[-1] / tau_s)) < END
    return BranchFit(tau_s, *run.profile(tau_s), run.scored, at_end)
