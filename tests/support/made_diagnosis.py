"""Diagnoses made by hand, one for each verdict: what is said of them depends on no search."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from classic_ml.series import CoefficientSeries
from comparisons.missing_effect.candidates import Bench, LagCandidate, LagRound
from comparisons.missing_effect.catalogue import find_effect
from comparisons.missing_effect.conclusion import missing_effect
from comparisons.missing_effect.effect import Effect, FittedParameter
from comparisons.missing_effect.evidence import Evidence
from comparisons.missing_effect.fit import Fit, Structure, errors_on
from comparisons.missing_effect.lag_data import LagData
from comparisons.missing_effect.lag_result import LagDiagnosis
from comparisons.missing_effect.loading import load_data
from comparisons.missing_effect.noise import Metric, NoiseModel
from comparisons.missing_effect.open_terms import open_terms
from comparisons.missing_effect.probes import Leftover
from comparisons.missing_effect.results import Gap, MissingEffect, ParameterRow

PERIOD_S = 0.01
TAU_S = 0.1
BETA = (0.2, 1.5, -1.8)
SIGMA = 0.002
VERDICTS = (
    "nothing_missing",
    "named",
    "alias_set",
    "provisional",
    "unnamed_term",
    "unexplained_structure",
    "noise_model_wrong",
)


def made_records(n: int = 400, n_records: int = 2) -> list[CoefficientSeries]:
    """ψ' behind a lag by the trapezoid rule at a twentieth of the sample period, with noise."""
    rng = np.random.default_rng(5)
    out = []
    for number in range(n_records):
        fine = np.arange((n - 1) * 20 + 1) * PERIOD_S / 20
        hertz = 1.1 + 0.3 * number
        phi = (
            0.2 + 0.16 * np.sin(2 * np.pi * hertz * fine) + 0.04 * np.sin(4 * np.pi * hertz * fine)
        )
        target = BETA[0] + BETA[1] * phi + BETA[2] * phi**2
        psi = np.empty_like(target)
        psi[0] = target[0]
        half = PERIOD_S / 20 / TAU_S / 2
        for k in range(1, psi.size):
            psi[k] = (psi[k - 1] * (1 - half) + half * (target[k] + target[k - 1])) / (1 + half)
        out.append(
            CoefficientSeries(
                30.0 * number + fine[::20],
                phi[::20],
                psi[::20] + SIGMA * rng.standard_normal(n),
                np.ones(n, dtype=np.int64),
                source=f"run-{number + 1}.csv",
            )
        )
    return out


@cache
def made_data() -> LagData:
    """The rows of the made records."""
    return load_data(made_records())


def made_fit(effect: Effect | None = None, values: tuple[float, ...] = ()) -> Fit:
    """The truth of the made records, with one effect of given numbers.

    Parameters
    ----------
    effect : Effect, optional
        What it has.
    values : tuple of float
        Its parameters, those that are coefficients last.
    """
    structure = Structure(("1", "phi", "phi^2"))
    if effect is None:
        return Fit(structure, np.array([np.log(0.11)]), np.array(BETA), 100.0)
    n = len(effect.nonlinear)
    return Fit(
        structure.with_effect(effect),
        np.array([np.log(TAU_S), *values[:n]]),
        np.array([*BETA, *values[n:]]),
        90.0,
    )


@cache
def made_diagnosis(verdict: str) -> LagDiagnosis:
    """A diagnosis of a verdict, its numbers chosen and not found.

    Parameters
    ----------
    verdict : str
        One of the seven.
    """
    data = made_data()
    base = made_fit()
    bench = Bench(data, base, Metric(SIGMA), 60, 15).with_states()
    noise = NoiseModel(SIGMA, SIGMA, (), 0.003)
    left = Leftover(14.2, 38, 0.81)
    if verdict == "noise_model_wrong":
        noise = NoiseModel(SIGMA, 0.8 * SIGMA, (0.55, -0.1), 0.021)
    if verdict in ("provisional", "unexplained_structure"):
        left = Leftover(171.0, 38, 3e-51)
    found = _found(verdict, data)
    if found is None:
        return _concluded(verdict, bench, None, (_refused(bench),), noise, left)
    return _concluded(verdict, bench, *found, noise, left)


def _found(
    verdict: str, data: LagData
) -> tuple[tuple[MissingEffect, Fit], tuple[LagCandidate, ...]] | None:
    delay, second = find_effect("transport_delay"), find_effect("second_order_lag")
    branch = find_effect("hysteresis")
    term = next(e for e in open_terms(data) if e.name == "phi*dphi")
    winner, values, other = {
        "named": (branch, (0.11, 0.32, 0.021), delay),
        "provisional": (branch, (0.11, 0.32, 0.021), delay),
        "alias_set": (delay, (0.0057,), second),
        "unnamed_term": (term, (0.013,), branch),
    }.get(verdict, (None, (), None))
    if winner is None or other is None:
        return None
    fit = made_fit(winner, values)
    numbers = [*values[len(winner.nonlinear) :], *values[: len(winner.nonlinear)]]
    parameters = tuple(
        FittedParameter(p.name, value, 0.01 * value, p.unit)
        for p, value in zip(winner.parameters, numbers, strict=True)
    )
    members = [winner, other] if verdict == "alias_set" else [winner]
    near = (1e-4,) if other is second else (0.004,) if other is delay else (0.1, 0.3, 0.01)
    candidates = (
        LagCandidate((winner,), fit, np.zeros(0), evidence(950.0)),
        LagCandidate((other,), made_fit(other, near), np.zeros(0), evidence(944.5)),
        LagCandidate((find_effect("bias_drift"),), made_fit(), np.zeros(0), evidence(-3.0, -8.0)),
    )
    doubts = Leftover(171.0, 38, 3e-51).doubts if verdict == "provisional" else ()
    item = missing_effect(winner, parameters, {"score": 950.0}, doubts, members)
    return (item, fit), candidates


def evidence(score: float, later: float = 200.0) -> Evidence:
    """Evidence of a given score.

    Parameters
    ----------
    score, later : float
        In log-units.
    """
    if later > 0.0:
        return Evidence(300.0, later, 450.0, 9.5, 1e-120, score)
    return Evidence(2.0, later, -5.0, -1.5, 1.0, score)


def _refused(bench: Bench) -> LagCandidate:
    effect = find_effect("bias_drift")
    return LagCandidate((effect,), made_fit(effect, (1e-5,)), np.zeros(0), evidence(-3.0, -8.0))


def _concluded(
    verdict: str,
    bench: Bench,
    found: tuple[MissingEffect, Fit] | None,
    candidates: tuple[LagCandidate, ...],
    noise: NoiseModel,
    left: Leftover,
) -> LagDiagnosis:
    base = bench.fit
    item, after = found if found else (None, base)
    step = LagRound(bench, candidates, candidates[0] if found else None, leftover=left)
    after_rms = 1.02 * SIGMA if found else 2.0 * SIGMA if left.structured else 1.01 * SIGMA
    before_rms = 2.1 * SIGMA if found else after_rms
    tau_by_alias = {}
    if item is not None:
        tau_by_alias = dict(zip(item.alias_set, (after.tau_s, 0.1043), strict=False))
    data = replace(bench, fit=after).with_states().data if found else bench.data
    return LagDiagnosis(
        verdict=verdict,
        missing=(item,) if item is not None else (),
        parameters=(ParameterRow("τ", "s", base.tau_s, after.tau_s, 0.0006, 0.0004),),
        gap=Gap(before_rms, after_rms, SIGMA),
        tau_by_alias_s=tau_by_alias,
        before=base,
        after=after,
        left=(errors_on(base, bench.data, Metric())[0], errors_on(after, data, Metric())[0]),
        data=data,
        noise=noise,
        leftover=left,
        rounds=(step,),
        unavailable={
            "speed_droop": "needs the column Nc_frac",
            "thermocouple_lag": "needs the column T25_K",
        },
    )


class Told:
    """What limits and separating measurements bring.

    Parameters
    ----------
    *lines : str
        What they say.
    """

    def __init__(self, *lines: str) -> None:
        self.lines = lines
        self.words = lines

    def to_json(self) -> dict[str, list[str]]:
        """The lines."""
        return {"lines": list(self.lines)}
