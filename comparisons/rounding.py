"""Numbers as people read them: those of the lag model, and gains of the log-likelihood."""

from __future__ import annotations

import math

from classic_ml.rounding import (
    NOT_KNOWN,
    bracketed,
    decimals_for,
    round_like,
    round_to_error,
    significant,
)

__all__ = [
    "NOT_KNOWN",
    "bracketed",
    "decimals_for",
    "log_units",
    "round_like",
    "round_to_error",
    "significant",
]

# From here on tenths are no evidence, and a search that ends on a flat crest does not hold them.
WHOLE_LOG_UNITS = 100.0
# A curve far beyond its data can miss by anything.
LARGE_LOG_UNITS = 1e7


def log_units(gain: float, not_known: str = NOT_KNOWN) -> str:
    """Return a gain of the log-likelihood to the digits that say something.

    Parameters
    ----------
    gain : float
        In natural log-units.
    not_known : str
        What stands for no finite number.
    """
    if not math.isfinite(gain):
        return not_known
    if abs(gain) >= LARGE_LOG_UNITS:
        return f"{gain:.2g}"
    return f"{gain:.1f}" if abs(gain) < WHOLE_LOG_UNITS else f"{gain:.0f}"
