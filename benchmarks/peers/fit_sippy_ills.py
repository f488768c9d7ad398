"""SIPPY's default ARMAX: iterated linear least squares, which is extended least squares."""

from __future__ import annotations

from collections.abc import Sequence

from sippy_armax import fit_armax
from worker import FloatArray, serve


def fit(phi: FloatArray, y: FloatArray) -> Sequence[float]:
    return fit_armax(phi, y, "ILLS")


if __name__ == "__main__":
    serve(fit)
