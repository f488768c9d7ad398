"""Refusals and cautions of a fit, each as a sentence that says what to change."""

from __future__ import annotations

from typing import Any

import numpy as np

from sindy_surge.identification import Identified
from surge_core.fit_state import FitState
from surge_core.types import FloatArray
from surge_core.validation import one_of, positive, whole_number


def check_parameters(estimator: Any) -> None:
    """Refuse parameters of `SparseLagRegressor` that cannot be used.

    Raises
    ------
    InputError
        For the first that is wrong.
    """
    positive("sample_period_s", estimator.sample_period_s)
    one_of("hold", estimator.hold, ("first", "zero"))
    for name, least in (("max_terms", 1), ("n_bootstrap", 0)):
        whole_number(name, getattr(estimator, name), least, 1_000_000)


def is_constant(values: FloatArray) -> bool:
    """Return whether no column (n_rows, n_columns) changes but for rounding."""
    spread = np.ptp(values, axis=0)
    return bool(np.all(spread <= 1e-12 * np.maximum(np.abs(values).max(axis=0), 1e-300)))


def cautions_of(found: Identified, state: FitState) -> tuple[str, ...]:
    """Say what a user should know before the numbers are used."""
    problem, dead_time_s = found.problem, found.model.lag.dead_time_s
    sentences = [] if state is FitState.OK else [state.advice]
    if abs(dead_time_s) > 2 * found.dead_time_stderr_s > 0:
        late, early = ("ψ'", "φ") if dead_time_s > 0 else ("φ", "ψ'")
        sentences.append(
            f"{late} was measured {abs(dead_time_s) * 1e3:.3g} ms later than {early} "
            f"(standard error {found.dead_time_stderr_s * 1e3:.2g} ms): look for a sample of "
            "misalignment, or the wrong `hold`, which is half of one"
        )
    for knot in found.knots:
        sentences.append(
            f"a kink sits at {knot.knot:g} (standard error {knot.stderr:.2g}), between the knots "
            "of the library; a hinge was added there, and the errors allow for it"
        )
    gain, lag = problem.mean_gain(found.model), found.model.lag
    if gain != 0.0:
        sentences.append(
            "the structure holds ψ', and τ is that of the equation as written; about the mean "
            f"point of the record the lag is {lag.tau_s / (1 - gain) * 1e3:.3g} ms, "
            "which other powers of ψ' share"
        )
    if problem.noise.colour.size and state is not FitState.MODEL_ERROR_DOMINATES:
        sentences.append(
            f"the noise is coloured (autoregression of order {problem.noise.colour.size}) and was "
            "whitened for it; a missing effect can look the same"
        )
    return tuple(sentences)
