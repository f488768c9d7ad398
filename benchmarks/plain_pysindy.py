"""pysindy by itself on a surge record, with every favour that knowledge of the truth can do it."""

from __future__ import annotations

import time
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


def plain_pysindy(record: Record, truth: dict[str, float]) -> dict[str, dict[str, Any]]:
    """Fit one record, in one piece, by pysindy alone, at every threshold.

    For the finite difference ("FD") and the smoothed one over 11 samples ("SFD") it gives `right`,
    the settings that give the true terms; `tau_s` of the regression on those alone; and `cpu_s` of
    one fit at one threshold.
    """
    needed = any("psi_p" in name for name in truth)
    return {name: _fit(record, truth, name, needed) for name in DERIVATIVES}


def make_model(derivative: str, with_psi: bool) -> tuple[Any, list[str]]:
    """Return pysindy's model, not fitted, and the names of its terms, with powers of ψ' or not."""
    import pysindy

    if derivative == "FD":
        differentiate = pysindy.FiniteDifference()
    else:
        smoother = {"window_length": SMOOTHING_SAMPLES, "polyorder": 3}
        differentiate = pysindy.SmoothedFiniteDifference(smoother_kws=smoother)
    library, names = _library(with_psi)
    optimizer = pysindy.STLSQ(threshold=1.0, normalize_columns=True)
    return pysindy.SINDy(optimizer, library, differentiate), names


def fit_once(model: Any, record: Record) -> None:
    """Fit a model at its one threshold."""
    with warnings.catch_warnings():
        # That a threshold removes every term, and pysindy's own book-keeping of axes.
        warnings.simplefilter("ignore")
        model.fit(record.psi_p[:, None], t=PERIOD_S, u=record.phi[:, None])


def _fit(
    record: Record, truth: dict[str, float], derivative: str, with_psi: bool
) -> dict[str, Any]:
    model, names = make_model(derivative, with_psi)
    begun = time.process_time()
    fit_once(model, record)
    cpu_s = time.process_time() - begun
    psi_p, phi = record.psi_p[:, None], record.phi[:, None]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        rate = np.asarray(model.differentiation_method(psi_p, t=PERIOD_S))
        used = getattr(model.differentiation_method, "smoothed_x_", psi_p)
        columns = np.asarray(model.feature_library.transform(np.column_stack((used, phi))))
    supports = {
        f"{share:.3g} {ridge:g}": np.flatnonzero(found).tolist()
        for ridge in RIDGES
        for share, found in zip(
            THRESHOLDS,
            swept(columns, rate, THRESHOLDS, alpha=ridge, normalize_columns=True),
            strict=True,
        )
    }
    wanted = canonical([*truth, "psi_p"])
    return {
        "right": [
            setting
            for setting, support in supports.items()
            if canonical(names[i] for i in support) == wanted
        ],
        "tau_s": _tau_of_truth(columns, rate, names, truth),
        "cpu_s": cpu_s,
    }


def _library(with_psi: bool) -> tuple[Any, list[str]]:
    """Return the library over (ψ', φ) and the names of its terms."""
    from pysindy import CustomLibrary, GeneralizedLibrary, IdentityLibrary, PolynomialLibrary

    special = CustomLibrary([*map(_hinge, KNOTS), lambda x: np.where(x < 0, x**2, 0.0)])
    libraries = [PolynomialLibrary(5), special, IdentityLibrary()]
    inputs = [[1], [1], [0]]
    names = ["1", "phi", *(f"phi^{k}" for k in range(2, 6))]
    names += ["relu(phi)" if k == 0 else f"relu(phi-{k:g})" for k in KNOTS]
    names += ["phi^2[phi<0]", "psi_p"]
    if with_psi:
        libraries.append(CustomLibrary([lambda x: x**2, lambda x: x**3]))
        libraries.append(CustomLibrary([lambda x, y: x * y, lambda x, y: x * y**2]))
        inputs += [[0], [0, 1]]
        names += ["psi_p^2", "psi_p^3", "psi_p phi", "psi_p phi^2"]
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


def _tau_of_truth(
    columns: FloatArray, rate: FloatArray, names: list[str], truth: dict[str, float]
) -> float:
    """Return τ of the regression on the true terms; nan if one is not in the library."""
    wanted = ["psi_p", *truth]
    if not set(wanted) <= set(names):
        return float("nan")
    chosen = columns[:, [names.index(name) for name in wanted]]
    return float(-1.0 / np.linalg.lstsq(chosen, rate[:, 0])[0][0])
