"""The work characteristic as text and as JSON."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

import numpy as np

from classic_ml.work.coefficient import WorkCharacteristic
from comparisons.harness.work_fit import is_vague, why_withheld
from comparisons.show.json_output import curve_json, state_json, tau_json
from surge_core.rounding import bracketed, round_to_error
from surge_core.terms import terms_json
from surge_core.types import FloatArray

WORK_SCHEMA = "sindy-surge/work/1"


def work_document(fit: WorkCharacteristic, source: str) -> dict[str, Any]:
    """Return the fit as plain JSON types."""
    errors = np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
    return {
        "schema": WORK_SCHEMA,
        "record": source,
        "time_constant_s": tau_json(fit.time_constant_s, fit.time_constant_stderr_s),
        "breakpoints": list(fit.breakpoints),
        "terms": terms_json(fit.terms, fit.coef, errors),
        "characteristic": curve_json("psi", *_curve(fit)),
        "valid_phi": list(fit.valid_phi),
        "rows_scored": fit.n_scored,
        "cycles": fit.n_cycles,
        **state_json(fit.fit_state.code, why_withheld(fit) or fit.fit_state.advice),
        "history": [asdict(fit.entry)],
    }


def work_table(fit: WorkCharacteristic) -> str:
    """Return the fit as text."""
    low, high = fit.valid_phi
    if not math.isfinite(fit.time_constant_s):
        return (
            f"ψ_QS is not stated, nor τ ({fit.n_cycles} cycles, {fit.n_scored} rows): "
            f"{why_withheld(fit)}\n{fit.entry.did}"
        )
    lines = [
        f"work characteristic ψ_QS from {fit.n_scored} rows in {fit.n_cycles} cycles, φ "
        f"{low:.3f} to {high:.3f}, pieces meeting at φ "
        + " and ".join(f"{point:.3g}" for point in fit.breakpoints),
        "τ = "
        + bracketed(1e3 * fit.time_constant_s, 1e3 * fit.time_constant_stderr_s)
        + f" ms; {fit.fit_state.advice}",
        "    φ    ψ_QS",
    ]
    inside = [(p, v, s) for p, v, s in zip(*_curve(fit), strict=True) if low <= p <= high]
    lines += [f"{p:.3f}   {round_to_error(v, s)}" for p, v, s in inside]
    lines.append(fit.entry.did)
    if is_vague(fit):
        lines.append("τ or the curve is known to no better than 12 %: `run` does not state it")
    return "\n".join(lines)


def _curve(fit: WorkCharacteristic) -> tuple[FloatArray, FloatArray, FloatArray]:
    last = fit.valid_phi[1] if math.isfinite(fit.valid_phi[1]) else 0.0
    phi = np.round(np.arange(0.0, max(last, 0.01) + 0.005, 0.01), 3)
    return (phi, *fit.characteristic(phi))
