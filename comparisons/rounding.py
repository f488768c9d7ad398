"""Numbers as people read them, under the name by which this package has always known them."""

from __future__ import annotations

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
    "round_like",
    "round_to_error",
    "significant",
]
