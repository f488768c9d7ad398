"""The published recipe beside the diagnosis: a sparse regression on what the derivative lacks.

Kaheman, Kaiser, Strom, Kutz & Brunton, "Learning discrepancy models from experimental data" (2019):
the known model is fitted, its rate of change is subtracted from the measured one, and STLSQ looks
for the terms of the difference. It gets the same records and these favours, each of which was seen
to raise its score: the base model is the output-error fit of this project, and its own terms are
fitted again beside the candidates; every effect that can be written as one term has its term among
them; columns are normalised; the threshold is chosen on the last 40 % of the two records, the
sparsest within one standard error of the best; and its first term is the last to survive a rising
threshold, not the one with the largest coefficient among correlated ones.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, hilbert, savgol_filter, sosfiltfilt

from classic_ml import LagRegressor
from comparisons.rig.coefficient_tests import CoefficientRecord

FloatArray = NDArray[np.float64]

TERMS = (
    "phi^4",
    "phi^5",
    "phi^2[phi<0]",
    "dphi",
    "phi dphi",
    "phi^2 dphi",
    "d2phi",
    "d2psi",
    "psi^2",
    "t",
    "t psi",
    "Nc-1",
    "(Nc-1) phi",
    "psi dT/T",
    "sgn(dphi) e",
    "[phi<median] e",
    "(A-A0) e",
)
# The terms that would put a user on the right track; None: no static term can say it.
RIGHT_TERMS: dict[str, tuple[str, ...] | None] = {
    "transport_delay": None,
    "facility_heating": ("t", "t psi"),
    "speed_droop": ("Nc-1", "(Nc-1) phi"),
    "hysteresis": None,
    "reverse_flow_branch": ("phi^2[phi<0]",),
    "characteristic_shape": ("phi^4", "phi^5"),
    "second_order_lag": ("d2psi",),
    "amplitude_dependent_lag": ("(A-A0) e",),
    "asymmetric_lag": ("sgn(dphi) e",),
    "flow_dependent_lag": ("[phi<median] e",),
    "flow_inertia": ("dphi", "d2phi"),
    "thermocouple_lag": ("psi dT/T",),
    "sensitivity_drift": ("t", "t psi"),
    "bias_drift": ("t",),
    "rotating_stall_ripple": None,
}
_TRAIN_SHARE, _TRAIN_RECORDS = 0.6, 2
_SMOOTHING_ROWS, _SMOOTHING_DEGREE = 11, 3
_AMPLITUDE_HZ = 0.25
# As shares of the norm of what is to be explained.
_THRESHOLDS = np.geomspace(1e-3, 1.0, 40)
# Blocks of the held-out rows that the standard error of their squared errors is taken from.
_BLOCKS = 12


@dataclass(frozen=True)
class _Rows:
    """Candidates and discrepancy of some rows.

    Parameters
    ----------
    columns : ndarray of shape (n, 17)
        One a term.
    known : ndarray of shape (n, degree + 2)
        The terms of the base model: powers of φ, and ψ'.
    lacking : ndarray of shape (n,)
        dψ'/dt as measured, less that of the base model.
    """

    columns: FloatArray
    known: FloatArray
    lacking: FloatArray


def sparse_discrepancy(
    records: tuple[CoefficientRecord, ...], degree: int
) -> tuple[list[str], float]:
    """Run the recipe on the first two records of a test.

    Parameters
    ----------
    records : tuple of CoefficientRecord
        The test.
    degree : int
        Degree of the base characteristic.

    Returns
    -------
    terms : list of str
        Terms found, the last to survive a rising threshold first; empty for none.
    explained : float
        Share that they explain of what the terms of the base model leave of the held-out rows.
    """
    records = records[:_TRAIN_RECORDS]
    sizes = [int(_TRAIN_SHARE * r.phi.size) for r in records]
    base = LagRegressor(
        float(records[0].time_s[1] - records[0].time_s[0]),
        noise="output-error",
        degree=degree,
        hold="first",
    )
    base.fit(
        np.concatenate([r.phi[:n] for r, n in zip(records, sizes, strict=True)])[:, None],
        np.concatenate([r.psi_p[:n] for r, n in zip(records, sizes, strict=True)]),
        segments=np.repeat(np.arange(len(records)), sizes),
    )
    references = _references(records, sizes)
    both = [_rows(r, base, references, degree) for r in records]
    train = _joined(both, [slice(None, n) for n in sizes])
    later = _joined(both, [slice(n, None) for n in sizes])
    return _best_terms(train, later)


def _references(records: tuple[CoefficientRecord, ...], sizes: list[int]) -> dict[str, float]:
    pairs = list(zip(records, sizes, strict=True))
    return {
        "Nc": float(np.mean(np.concatenate([r.Nc_frac[:n] for r, n in pairs]))),
        "phi": float(np.median(np.concatenate([r.phi[:n] for r, n in pairs]))),
        "A": float(np.mean(np.concatenate([_amplitude(r)[:n] for r, n in pairs]))),
    }


def _amplitude(record: CoefficientRecord) -> FloatArray:
    period_s = float(record.time_s[1] - record.time_s[0])
    modulus = np.abs(hilbert(record.phi - record.phi.mean()))
    low_pass = butter(2, _AMPLITUDE_HZ, fs=1.0 / period_s, output="sos")
    return np.asarray(sosfiltfilt(low_pass, modulus))


def _derivative(values: FloatArray, period_s: float, order: int = 1) -> FloatArray:
    return np.asarray(
        savgol_filter(values, _SMOOTHING_ROWS, _SMOOTHING_DEGREE, deriv=order, delta=period_s)
    )


def _rows(
    record: CoefficientRecord, base: LagRegressor, references: dict[str, float], degree: int
) -> _Rows:
    h = float(record.time_s[1] - record.time_s[0])
    phi, psi, time = record.phi, record.psi_p, record.time_s
    dphi, dpsi = _derivative(phi, h), _derivative(psi, h)
    curve, _ = base.characteristic(phi)
    e = (curve - psi) / base.time_constant_s_
    speed = record.Nc_frac / references["Nc"] - 1.0
    below = phi < references["phi"]
    columns = (
        phi**4,
        phi**5,
        np.where(phi < 0.0, phi**2, 0.0),
        dphi,
        phi * dphi,
        phi**2 * dphi,
        _derivative(phi, h, 2),
        _derivative(psi, h, 2),
        psi**2,
        time,
        time * psi,
        speed,
        speed * phi,
        psi * _derivative(record.T25_K, h) / record.T25_K,
        np.sign(dphi) * e,
        below * e,
        (_amplitude(record) / references["A"] - 1.0) * e,
    )
    known = np.column_stack((*(phi**k for k in range(degree + 1)), psi))
    return _Rows(np.column_stack(columns), known, dpsi - e)


def _joined(rows: list[_Rows], parts: list[slice]) -> _Rows:
    pairs = list(zip(rows, parts, strict=True))
    return _Rows(
        np.concatenate([r.columns[part] for r, part in pairs]),
        np.concatenate([r.known[part] for r, part in pairs]),
        np.concatenate([r.lacking[part] for r, part in pairs]),
    )


def _best_terms(train: _Rows, later: _Rows) -> tuple[list[str], float]:
    columns, lacking, later_columns, later_lacking = _beside_the_base(train, later)
    norms = np.linalg.norm(columns, axis=0)
    norms[norms == 0.0] = 1.0
    weights = [np.zeros(len(TERMS)), *_swept(columns / norms, lacking)]
    errors = np.array([(later_lacking - later_columns @ (w / norms)) ** 2 for w in weights])
    best = int(np.argmin(errors.sum(axis=1)))
    # Sum and standard error, over blocks, of how much worse each is than the best.
    worse = np.array(
        [[part.sum() for part in np.array_split(e, _BLOCKS)] for e in errors - errors[best]]
    )
    as_good = worse.sum(axis=1) <= worse.std(axis=1, ddof=1) * np.sqrt(_BLOCKS)
    sizes = [
        np.count_nonzero(w) if good else np.inf for w, good in zip(weights, as_good, strict=True)
    ]
    chosen = int(np.argmin(sizes))
    terms = {i for i in range(len(TERMS)) if weights[chosen][i] != 0.0}
    # How long a term survives; among equals, how large it is at its last.
    survived = [max(n for n, w in enumerate(weights) if w[i] != 0.0) for i in terms]
    order = sorted(
        zip(terms, survived, strict=True),
        key=lambda pair: (-pair[1], -abs(weights[pair[1]][pair[0]])),
    )
    explained = 1.0 - float(errors[chosen].sum() / np.sum(later_lacking**2))
    return [TERMS[i] for i, _ in order], explained


def _beside_the_base(
    train: _Rows, later: _Rows
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Take out of everything what the terms of the base model, fitted to `train`, can say."""
    every = np.column_stack((train.columns, train.lacking))
    shares = np.linalg.lstsq(train.known, every)[0]
    left = every - train.known @ shares
    later_left = np.column_stack((later.columns, later.lacking)) - later.known @ shares
    return left[:, :-1], left[:, -1], later_left[:, :-1], later_left[:, -1]


def _swept(columns: FloatArray, lacking: FloatArray) -> list[FloatArray]:
    """Run STLSQ, with its own ridge, over all thresholds from the lowest on."""
    from pysindy import STLSQ

    # It sees nothing but inner products: the triangular factor stands for the rows.
    triangle = np.linalg.qr(np.column_stack((columns, lacking)), mode="r")
    size = float(np.linalg.norm(lacking))
    found = []
    for share in _THRESHOLDS:
        optimizer = STLSQ(threshold=share * size)
        with warnings.catch_warnings():
            # That a threshold removes every term.
            warnings.simplefilter("ignore")
            optimizer.fit(triangle[:, :-1], triangle[:, -1:])
        found.append(np.asarray(optimizer.coef_[0]))
    return found
