"""The autoregression of a signal that is known in pieces."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from surge_core.types import FloatArray


def autoregression(
    pieces: Sequence[FloatArray], largest: int
) -> tuple[FloatArray, list[FloatArray]]:
    """Fit w[k] = Σ α_i w[k-i] + white by Burg's method, its order, up to the largest, by BIC.

    No sum reaches across two pieces. Returned are the coefficients, none when order 0 wins, and of
    each piece what they cannot predict: all but as many first rows.
    """
    n = sum(piece.size for piece in pieces)
    variance = sum(float(piece @ piece) for piece in pieces) / max(n, 1)
    forward, backward = list(pieces), list(pieces)
    coefficients = np.empty(0)
    best, best_score = (coefficients, forward), n * np.log(variance) if variance > 0 else -np.inf
    for order in range(1, largest + 1):
        forward = [f[1:] for f in forward]
        backward = [b[:-1] for b in backward]
        pairs = list(zip(forward, backward, strict=True))
        power = sum(float(f @ f + b @ b) for f, b in pairs)
        if power <= 0:
            break
        reflection = 2 * sum(float(f @ b) for f, b in pairs) / power
        coefficients = np.append(coefficients - reflection * coefficients[::-1], reflection)
        forward = [f - reflection * b for f, b in pairs]
        backward = [b - reflection * f for f, b in pairs]
        variance *= 1 - reflection**2
        if variance <= 0:
            break
        score = n * np.log(variance) + order * np.log(n)
        if score < best_score:
            best, best_score = (coefficients, forward), score
    return best
