"""SIPPY's ARMAX by IPOPT on the prediction error: maximum likelihood."""

from __future__ import annotations

from collections.abc import Sequence

from sippy_armax import fit_armax
from worker import FloatArray, serve


def fit(phi: FloatArray, y: FloatArray) -> Sequence[float]:
    return fit_armax(phi, y, "OPT")


if __name__ == "__main__":
    serve(fit)
