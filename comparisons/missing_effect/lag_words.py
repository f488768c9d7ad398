"""What is said of a lag model alone: τ, its noise, and why two of its effects look alike."""

from __future__ import annotations

from collections.abc import Collection
from itertools import combinations

from comparisons.missing_effect.lag_result import LagDiagnosis
from comparisons.missing_effect.quantities import chance, tau_ms
from surge_core.rounding import significant

_DRIFTS = ("facility_heating", "sensitivity_drift", "bias_drift", "speed_droop")
_SLOPE = (
    "the slope of the characteristic hardly changes over the flow that was swept, so that both act "
    "on dφ/dt"
)
_BRANCHES = "both change the characteristic where φ hardly ever is"
ALIAS_REASONS = {
    frozenset(("transport_delay", "second_order_lag")): "both move the phase alike, and part only "
    "in the second order of their time",
    frozenset(("transport_delay", "flow_inertia")): _SLOPE,
    frozenset(("second_order_lag", "flow_inertia")): _SLOPE,
    frozenset(("reverse_flow_branch", "characteristic_shape")): _BRANCHES,
    frozenset(("reverse_flow_branch", "hysteresis")): _BRANCHES,
    **{
        frozenset(pair): "both are slow drifts, and only a reading of temperature, speed or zero "
        "parts them"
        for pair in combinations(_DRIFTS, 2)
    },
}
_TAU_MEANING = {
    "amplitude_dependent_lag": "that at the mean amplitude",
    "flow_dependent_lag": "that above the threshold",
    "asymmetric_lag": "the mean of rising and falling flow",
}
# A τ that moves by less is said to stay.
LEAST_CHANGE = 5e-4


def tau_words(d: LagDiagnosis) -> str:
    """Say where τ goes with what was added.

    Parameters
    ----------
    d : LagDiagnosis
        The diagnosis.
    """
    row = d.parameters[0]
    now = tau_ms(row.after, row.after_stderr)
    meaning = [_TAU_MEANING[name] for name in d.names if name in _TAU_MEANING]
    means = f" ({', '.join(meaning)})" if meaning else ""
    if abs(row.after / row.before - 1.0) < LEAST_CHANGE:
        return f"τ stays at {now}{means}"
    return f"τ goes from {tau_ms(row.before, row.before_stderr)} to {now}{means}"


def noise_words(d: LagDiagnosis) -> str:
    """Say what the noise is like.

    Parameters
    ----------
    d : LagDiagnosis
        The diagnosis.
    """
    if d.whole_runs:
        times = d.noise.sigma / d.gap.floor_rms
        return (
            f"The noise of the averaged ψ' is {significant(d.gap.floor_rms, 3)} rms; the model "
            f"leaves {times:.1f} times that: noise near zero flow, calibration, and what no effect "
            "here explains."
        )
    size = f"rms {significant(d.noise.sigma, 3)} in ψ'"
    if not d.noise.coloured and not d.noise.heavy_tailed:
        return f"The noise is white and about normal, {size}."
    out = [f"The noise has {size}{', outliers aside' if d.noise.heavy_tailed else ''}."]
    if d.noise.coloured:
        lags = ", ".join(f"{a:.2f}" for a in d.noise.ar)
        out.append(
            f"An error depends on those before it (autoregression {lags}), so that rows count for "
            "less than their number."
        )
    if d.noise.heavy_tailed:
        out.append(
            f"{100.0 * d.noise.heavy_share:.1f} % of the errors lie beyond three standard "
            "deviations, where the normal law has 0.3 %: they were held down."
        )
    out.append("An estimator that takes noise for white and normal states wrong errors.")
    return " ".join(out)


def structure_words(d: LagDiagnosis) -> str:
    """Say what a test of all effects and open terms together finds in what is left.

    Parameters
    ----------
    d : LagDiagnosis
        The diagnosis.
    """
    left = d.leftover
    if not left.degrees:
        return ""
    tested = f"{left.degrees} columns of effects and open terms together"
    if left.structured:
        return (
            f"Yet {tested} would win {left.gain:.0f} log-units (p {chance(left.p_value)}): this is "
            "not “nothing missing”, it is something without a name."
        )
    return f"What {tested} could still win is chance (p {chance(left.p_value)})."


def limit_words(verdict: str, *, limited: bool) -> str:
    """Say what more could be done where nothing was named.

    Parameters
    ----------
    verdict : str
        One of the seven.
    limited : bool
        Whether the limits were looked for.
    """
    if verdict == "unexplained_structure":
        return (
            "Look at where it stands out; a further channel (T25_K, Nc_frac, in_stall), another "
            "base (--degree, --base sindy) or a longer record may give it a name."
        )
    listed = (
        "the limits below say how small."
        if limited
        else "--limits plants each into these records and says how small."
    )
    return f"That has a limit: an effect that is small enough goes unseen, and {listed}"


def shape_words(names: Collection[str]) -> str:
    """Say what helps where the base terms themselves lack a bend.

    Parameters
    ----------
    names : collection of str
        What is missing.
    """
    if "characteristic_shape" not in names:
        return ""
    return (
        "The base terms are too stiff for these records: a higher --degree, or --base sindy, takes "
        "the bend into the characteristic itself."
    )


def lag_ledger(d: LagDiagnosis) -> tuple[str, ...]:
    """Say which effects were not fitted, and what was looked for in another way.

    Parameters
    ----------
    d : LagDiagnosis
        The diagnosis.
    """
    out = []
    if skipped := ", ".join(effect.name for effect in d.not_fitted):
        out.append(
            f"Tested and not worth a fit, since a score test promised too little: {skipped}."
        )
    if d.whole_runs:
        line = f"found at {d.ripple.frequency_hz:.4g} Hz" if d.ripple else "none found"
        out.append(
            "A second pattern of cells was looked for as a line of the rake differences that no "
            f"side line of the first has for a partner: {line}."
        )
    return tuple(out)
