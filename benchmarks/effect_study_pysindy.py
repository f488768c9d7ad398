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

from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from plain_pysindy import swept
from scipy.signal import butter, hilbert, savgol_filter, sosfiltfilt

from classic_ml import LagRegressor
from comparisons.rig.coefficient_tests import CoefficientRecord

FloatArray = NDArray[np.float64]

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


def sparse_discrepancy(records: tuple[CoefficientRecord, ...], degree: int) -> list[str]:
    """Run the recipe on the first two records of a test, whose base characteristic has a degree.

    The terms found come with the last to survive a rising threshold first.
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
    train = [(r, slice(None, n)) for r, n in zip(records, sizes, strict=True)]
    references = {
        "Nc": np.mean(np.concatenate([r.Nc_frac[part] for r, part in train])),
        "phi": np.median(np.concatenate([r.phi[part] for r, part in train])),
        "A": np.mean(np.concatenate([_amplitude(r)[part] for r, part in train])),
    }
    tables = [_table(r, base, references) for r in records]
    early = pd.concat([table[:n] for table, n in zip(tables, sizes, strict=True)])
    late = pd.concat([table[n:] for table, n in zip(tables, sizes, strict=True)])
    return _best_terms(early, late, degree)


def _amplitude(record: CoefficientRecord) -> FloatArray:
    period_s = float(record.time_s[1] - record.time_s[0])
    modulus = np.abs(hilbert(record.phi - record.phi.mean()))
    low_pass = butter(2, _AMPLITUDE_HZ, fs=1.0 / period_s, output="sos")
    return np.asarray(sosfiltfilt(low_pass, modulus))


def _derivative(values: FloatArray, period_s: float, order: int = 1) -> FloatArray:
    return np.asarray(
        savgol_filter(values, _SMOOTHING_ROWS, _SMOOTHING_DEGREE, deriv=order, delta=period_s)
    )


def _table(
    record: CoefficientRecord, base: LagRegressor, references: dict[str, Any]
) -> pd.DataFrame:
    """Return the candidates, φ and ψ', and dψ'/dt as measured less that of the base model."""
    h = float(record.time_s[1] - record.time_s[0])
    phi, psi, time = record.phi, record.psi_p, record.time_s
    dphi = _derivative(phi, h)
    curve, _ = base.characteristic(phi)
    e = (curve - psi) / base.time_constant_s_
    speed = record.Nc_frac / references["Nc"] - 1.0
    columns = {
        "phi^4": phi**4,
        "phi^5": phi**5,
        "phi^2[phi<0]": np.where(phi < 0.0, phi**2, 0.0),
        "dphi": dphi,
        "phi dphi": phi * dphi,
        "phi^2 dphi": phi**2 * dphi,
        "d2phi": _derivative(phi, h, 2),
        "d2psi": _derivative(psi, h, 2),
        "psi^2": psi**2,
        "t": time,
        "t psi": time * psi,
        "Nc-1": speed,
        "(Nc-1) phi": speed * phi,
        "psi dT/T": psi * _derivative(record.T25_K, h) / record.T25_K,
        "sgn(dphi) e": np.sign(dphi) * e,
        "[phi<median] e": (phi < references["phi"]) * e,
        "(A-A0) e": (_amplitude(record) / references["A"] - 1.0) * e,
    }
    return pd.DataFrame(columns | {"phi": phi, "psi": psi, "lacking": _derivative(psi, h) - e})


def _best_terms(train: pd.DataFrame, later: pd.DataFrame, degree: int) -> list[str]:
    names = [name for name in train if name not in ("phi", "psi", "lacking")]
    # What the terms of the base model, fitted to the first rows, can say is taken out of all.
    known, later_known = (
        np.column_stack((*(t["phi"] ** k for k in range(degree + 1)), t["psi"]))
        for t in (train, later)
    )
    every, later_every = (t[[*names, "lacking"]].to_numpy() for t in (train, later))
    shares = np.linalg.lstsq(known, every)[0]
    left, later_left = every - known @ shares, later_every - later_known @ shares
    columns, lacking = left[:, :-1], left[:, -1]
    later_columns, later_lacking = later_left[:, :-1], later_left[:, -1]
    norms = np.linalg.norm(columns, axis=0)
    norms[norms == 0.0] = 1.0
    weights = [np.zeros(len(names)), *swept(columns / norms, lacking, _THRESHOLDS)]
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
    terms = {i for i in range(len(names)) if weights[chosen][i] != 0.0}
    # How long a term survives; among equals, how large it is at its last.
    survived = [max(n for n, w in enumerate(weights) if w[i] != 0.0) for i in terms]
    order = sorted(
        zip(terms, survived, strict=True),
        key=lambda pair: (-pair[1], -abs(weights[pair[1]][pair[0]])),
    )
    return [names[i] for i, _ in order]
