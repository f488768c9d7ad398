"""pysindy by itself on a surge record, with every favour that knowledge of the truth can do it."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
from surge_truths import PERIOD_S, FloatArray, Record, canonical

DERIVATIVES = ("FD", "SFD")
SMOOTHING_SAMPLES = 11
# STLSQ's threshold as a share of the norm of dψ'/dt: from nothing removed to everything.
THRESHOLDS = np.geomspace(1e-2, 1e2, 31)
RIDGES = (0.05, 0.0)  # its default, and none
KNOTS = tuple(round(0.05 * k, 2) for k in range(11))


def make_model(derivative: str) -> tuple[Any, list[str]]:
    """Return pysindy's model, not fitted, and the names of its terms."""
    import pysindy

    if derivative == "FD":
        differentiate = pysindy.FiniteDifference()
    else:
        smoother = {"window_length": SMOOTHING_SAMPLES, "polyorder": 3}
        differentiate = pysindy.SmoothedFiniteDifference(smoother_kws=smoother)
    library, names = _library()
    optimizer = pysindy.STLSQ(threshold=1.0, normalize_columns=True)
    return pysindy.SINDy(optimizer, library, differentiate), names


def fit_once(model: Any, record: Record) -> None:
    """Fit a model at its one threshold."""
    with warnings.catch_warnings():
        # That a threshold removes every term, and pysindy's own book-keeping of axes.
        warnings.simplefilter("ignore")
        model.fit(record.psi_p[:, None], t=PERIOD_S, u=record.phi[:, None])


def in_hindsight(
    model: Any, names: list[str], record: Record, truth: dict[str, float]
) -> tuple[bool, float]:
    """Return whether any threshold gives the true terms, and τ of the regression on those alone.

    The model is one that was fitted to the record, for its derivative and its library.
    """
    psi_p, phi = record.psi_p[:, None], record.phi[:, None]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        rate = np.asarray(model.differentiation_method(psi_p, t=PERIOD_S))
        used = getattr(model.differentiation_method, "smoothed_x_", psi_p)
        columns = np.asarray(model.feature_library.transform(np.column_stack((used, phi))))
    wanted = canonical([*truth, "psi_p"])
    right = any(
        canonical(name for name, weight in zip(names, weights, strict=True) if weight) == wanted
        for ridge in RIDGES
        for weights in swept(columns, rate, THRESHOLDS, alpha=ridge, normalize_columns=True)
    )
    chosen = columns[:, [names.index(name) for name in ("psi_p", *truth)]]
    return right, float(-1.0 / np.linalg.lstsq(chosen, rate[:, 0])[0][0])


def _library() -> tuple[Any, list[str]]:
    """Return the library over (ψ', φ) and the names of its terms."""
    from pysindy import CustomLibrary, GeneralizedLibrary, IdentityLibrary, PolynomialLibrary

    special = CustomLibrary([*map(_hinge, KNOTS), lambda x: np.where(x < 0, x**2, 0.0)])
    libraries = [PolynomialLibrary(5), special, IdentityLibrary()]
    inputs = [[1], [1], [0]]
    names = ["1", "phi", *(f"phi^{k}" for k in range(2, 6))]
    names += ["relu(phi)" if k == 0 else f"relu(phi-{k:g})" for k in KNOTS]
    names += ["phi^2[phi<0]", "psi_p"]
    return GeneralizedLibrary(libraries, inputs_per_library=inputs), names


def _hinge(knot: float) -> Callable[[FloatArray], FloatArray]:
    # Not a default argument: pysindy counts the arguments of a function as its inputs.
    return lambda x: np.maximum(x - knot, 0.0)


def swept(
    columns: FloatArray, target: FloatArray, thresholds: FloatArray, **options: Any
) -> list[FloatArray]:
    """Return STLSQ's coefficients at each threshold, a share of the norm of the target.

    It sees nothing but inner products, so that the triangular factor stands for the rows.
    """
    from pysindy import STLSQ

    triangle: FloatArray = np.asarray(np.linalg.qr(np.column_stack((columns, target)), mode="r"))
    size = float(np.linalg.norm(target))
    found = []
    for share in thresholds:
        optimizer = STLSQ(threshold=share * size, **options)
        with warnings.catch_warnings():
            # That a threshold removes every term.
            warnings.simplefilter("ignore")
            optimizer.fit(triangle[:, :-1], triangle[:, -1:])
        found.append(np.asarray(optimizer.coef_[0]))
    return found
