"""Tests at the level of coefficients: φ and ψ' of several surge records, one effect hidden in them.

The truth is τ dψ'/dt + ψ' = ψ'_QS(φ) with none, one or two physical effects at their ports. φ is a
formula in time, so that ψ' is simulated on its own fine grid and only then sampled: what is left of
a perfect model is noise alone, and an error of a simulation at the sample rate is its own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.signal import lfilter

from comparisons.rig.coefficient_effects import FORMS
from comparisons.rig.coefficient_plant import Plant, draw_plant
from comparisons.rig.coefficient_runs import Planted, constant_lag, lay_steps, run_record
from surge_core.errors import InputError
from surge_core.types import BoolArray, FloatArray, IntArray

Noise = Literal["white", "ar1", "t3", "outliers", "phi1", "phi3"]
NOISES: tuple[Noise, ...] = get_args(Noise)

# Ten steps from sample to sample: at 10 ms the simulation is exact to 1e-7 of ψ'.
_SUBSTEPS = 10
# Enough for the size of the signal, and for what is left of an effect.
_COARSE = 2
# The part of the first records that a model is fitted to; the rest is held out.
_TRAIN_SHARE = 0.6
_TRAIN_RECORDS = 2
# ln τ of the refit is looked for this far to either side.
_LOG_TAU_REACH = 1.5
_TAU_TOLERANCE = 1e-5
_SIZE_TOLERANCE = 1e-3
_MAX_TRIALS = 25
_AR1 = 0.7
_T_DEGREES = 3.0
_OUTLIER_SHARE, _OUTLIER_SIZE = 0.01, 10.0
_PHI_NOISE: Mapping[Noise, float] = {"phi1": 0.01, "phi3": 0.03}
# Gaps of a record in segments: their number, their length in seconds, the length of a piece between
# them as a multiple of τ at least, and how far ψ'_QS is off inside them.
_GAPS, _GAP_S, _PIECE_TAUS = 3, (0.4, 1.0), 10.0
_GAP_OFFSET = 2.0


@dataclass(frozen=True)
class CoefficientRecord:
    """One record as its user has it.

    Parameters
    ----------
    time_s : ndarray of shape (n,)
        Facility clock, in seconds.
    phi, psi_p : ndarray of shape (n,)
        Measured flow coefficient φ and pressure coefficient ψ'.
    T25_K : ndarray of shape (n,)
        Inlet temperature as its thermocouple shows it, in kelvin.
    Nc_frac : ndarray of shape (n,)
        Corrected speed as a fraction of design.
    in_stall : ndarray of bool, shape (n,)
        True while the machine is in stall.
    segment : ndarray of int, shape (n,), optional
        1, 2, … in the intervals to be fitted, 0 elsewhere; None: all rows are one interval.
    """

    time_s: FloatArray
    phi: FloatArray
    psi_p: FloatArray
    T25_K: FloatArray
    Nc_frac: FloatArray
    in_stall: BoolArray | None = None
    segment: IntArray | None = None


@dataclass(frozen=True)
class CoefficientTest:
    """Records of one test, and their truth.

    Parameters
    ----------
    records : tuple of CoefficientRecord
        The records, in the order of the facility clock.
    tau_s : float
        True time constant, in seconds, as it is to be reported for each effect.
    beta : tuple of float
        Coefficients of ψ'_QS in plain powers of φ, from the constant on.
    effects : mapping of str to mapping of str to float
        Parameters of each hidden effect, by its name; empty for none.
    strengths : mapping of str to float
        Strength that each effect has reached alone, in sigma.
    sigma : float
        Standard deviation of the noise on ψ'.
    clean : tuple of ndarray
        ψ' of each record without noise.
    """

    records: tuple[CoefficientRecord, ...]
    tau_s: float
    beta: tuple[float, ...]
    effects: Mapping[str, Mapping[str, float]]
    strengths: Mapping[str, float]
    sigma: float
    clean: tuple[FloatArray, ...]


def simulate_test(
    effect: str | tuple[str, ...] | None = None,
    *,
    strength: float = 1.0,
    seed: int = 0,
    noise: Noise = "white",
    n_samples: int = 2000,
    sample_period_s: float = 0.01,
    n_records: int = 3,
    degree: int = 3,
    gaps: bool = False,
    noise_frac: float = 0.01,
) -> CoefficientTest:
    """Simulate the records of a test in which an effect is hidden.

    Parameters
    ----------
    effect : str, tuple of str or None
        One or more of `EFFECTS` and `OUTSIDE`; None: nothing is missing. `second_order_lag` takes
        the place of any other effect on the lag.
    strength : float
        Rms, in sigma, of what is left of each effect without noise, once τ and a polynomial of the
        right degree have been fitted again to the first 60 % of the first two records.
    seed : int
        Seed. Compressor, flow, noise and the draw of each effect have streams of their own: tests
        of one seed differ in nothing but what they were asked to differ in.
    noise : str
        "white", "ar1" (0.7), "t3" (Student, three degrees), "outliers" (1 % of ten times the size),
        or white noise on ψ' with 1 % ("phi1") or 3 % ("phi3") of the standard deviation of φ on φ.
    n_samples, sample_period_s : int, float
        Rows of each record, and time between two, in seconds.
    n_records : int
        Number of records; each starts 1.5 of its durations after the one before.
    degree : int
        3: the characteristic is the cubic of Moore and Greitzer; 2: a parabola.
    gaps : bool
        Whether the records fall into segments with gaps between them, in which the compressor is on
        another characteristic.
    noise_frac : float
        sigma over the standard deviation of ψ' without effect and noise.

    Returns
    -------
    CoefficientTest
        Records and truth.

    Raises
    ------
    InputError
        For an unknown effect or noise, fewer than 100 rows, or too few for three gaps.
    """
    names = () if effect is None else (effect,) if isinstance(effect, str) else tuple(effect)
    asked = [("effect", name, tuple(FORMS)) for name in names]
    for what, value, known in (*asked, ("noise", noise, NOISES)):
        if value not in known:
            raise InputError(what, expected="one of " + ", ".join(known), found=f"{value!r}")
    if n_samples < 100:
        raise InputError("n_samples", expected="at least 100 rows", found=f"{n_samples}")
    plant = draw_plant(
        _stream(seed, "plant"),
        n_records=n_records,
        duration_s=n_samples * sample_period_s,
        sample_period_s=sample_period_s,
        degree=degree,
    )
    clock: FloatArray = sample_period_s * np.arange(n_samples, dtype=np.float64)
    times = tuple(f.origin_s + clock for f in plant.flows)
    untouched = [run_record(plant, i, t, {}, substeps=_COARSE) for i, t in enumerate(times)]
    sigma = noise_frac * float(np.std(np.concatenate(untouched)))
    excess = _excess_of(plant, times, degree)
    planted, strengths = {}, {}
    for name in names:
        planted[name], strengths[name] = _size_effect(
            plant, name, _stream(seed, name), strength, lambda trial: excess(trial) / sigma
        )
    rng = _stream(seed, "noise")
    gap_rng = _stream(seed, "gaps") if gaps else None
    records, clean = [], []
    for i, (flow, time) in enumerate(zip(plant.flows, times, strict=True)):
        segment = None if gap_rng is None else _segments(gap_rng, time, plant.tau_s)
        offset = None if segment is None else _GAP_OFFSET * plant.psi_std * (segment == 0)
        psi = run_record(plant, i, time, planted, substeps=_SUBSTEPS, curve_offset=offset)
        clean.append(psi)
        phi = flow.values(time)
        measured_psi = psi + sigma * _unit_noise(rng, psi.size, noise)
        measured_phi = phi
        if noise in _PHI_NOISE:
            measured_phi = phi + _PHI_NOISE[noise] * np.std(phi) * rng.standard_normal(phi.size)
        temperature, speed = plant.temperatures[i].at(time)[0], plant.speeds[i].at(time)[0]
        in_stall = phi < plant.stall_phi
        records.append(
            CoefficientRecord(
                time, measured_phi, measured_psi, temperature, speed, in_stall, segment
            )
        )
    return CoefficientTest(
        tuple(records), plant.tau_s, plant.beta, planted, strengths, sigma, tuple(clean)
    )


def _stream(seed: int, purpose: str) -> np.random.Generator:
    """Return a generator that no other purpose shares."""
    return np.random.default_rng([seed, *purpose.encode()])


def _excess_of(
    plant: Plant, times_s: Sequence[FloatArray], degree: int
) -> Callable[[Planted], float]:
    """Return the function that gives the rms of what effects leave after a refit without noise.

    It is an output-error fit of τ and of a polynomial characteristic to the first 60 % of the first
    two records.
    """
    starts = [t[: max(int(_TRAIN_SHARE * t.size), 2)] for t in times_s[:_TRAIN_RECORDS]]
    laid = [lay_steps(plant, i, t, {}, _COARSE) for i, t in enumerate(starts)]
    # Powers of φ from the first on, and of each record input, steps and samples.
    inputs = [
        [(np.ascontiguousarray(at.phi**k), step_s, samples) for at, step_s, samples in laid]
        for k in range(1, degree + 1)
    ]

    def left(psi: FloatArray, tau_s: float) -> FloatArray:
        """Return what the best polynomial leaves at a time constant; a constant needs no lag."""
        columns = [np.ones_like(psi)]
        for records in inputs:
            parts = [
                constant_lag(step_s, power, tau_s, float(power[0, 0]))[samples]
                for power, step_s, samples in records
            ]
            columns.append(np.concatenate(parts))
        orthogonal, _ = np.linalg.qr(np.column_stack(columns))
        return np.asarray(psi - orthogonal @ (orthogonal.T @ psi))

    def excess(planted: Planted) -> float:
        runs = [run_record(plant, i, t, planted, substeps=_COARSE) for i, t in enumerate(starts)]
        psi = np.concatenate(runs)
        found = minimize_scalar(
            lambda x: float(np.sum(left(psi, np.exp(x)) ** 2)),
            bounds=np.log(plant.tau_s) + np.array([-_LOG_TAU_REACH, _LOG_TAU_REACH]),
            method="bounded",
            options={"xatol": _TAU_TOLERANCE},
        )
        return float(np.sqrt(np.mean(left(psi, float(np.exp(found.x))) ** 2)))

    return excess


def _size_effect(
    plant: Plant,
    name: str,
    rng: np.random.Generator,
    strength: float,
    reached_by: Callable[[Planted], float],
) -> tuple[dict[str, float], float]:
    """Draw an effect and give it a strength, as a function of what is planted says it.

    The strength reached is less than asked only where the effect cannot be made so large.
    """
    form = FORMS[name]
    others = form.draw(plant, rng)
    sign = 1.0 if not form.signed or rng.random() < 0.5 else -1.0
    guess, limit = form.sizes(plant)
    if strength == 0.0:
        return {form.size: sign * 0.0, **others}, 0.0
    # What is left grows nearly in proportion to the size, and always with it.
    size, low, high = min(guess, limit), 0.0, limit
    for _ in range(_MAX_TRIALS):
        reached = reached_by({name: {form.size: sign * size, **others}})
        too_weak = reached < strength
        if abs(reached / strength - 1.0) < _SIZE_TOLERANCE or (too_weak and size >= limit):
            break
        low, high = (size, high) if too_weak else (low, size)
        size = size * strength / max(reached, 1e-3 * strength)
        if not low < size < high:
            # A limit not yet known to be too large answers itself whether it can be reached.
            size = limit if high >= limit else 0.5 * (low + high)
    return {form.size: sign * size, **others}, reached


def _unit_noise(rng: np.random.Generator, n: int, noise: Noise) -> FloatArray:
    """Draw noise of unit variance (that of the bulk, for outliers)."""
    if noise == "t3":
        # The variance of Student's t with ν degrees of freedom is ν/(ν − 2).
        spread = np.sqrt(_T_DEGREES / (_T_DEGREES - 2.0))
        return np.asarray(rng.standard_t(_T_DEGREES, n) / spread)
    white = rng.standard_normal(n)
    if noise == "ar1":
        innovation = np.sqrt(1.0 - _AR1**2)
        later, _ = lfilter([innovation], [1.0, -_AR1], white[1:], zi=[_AR1 * white[0]])
        return np.concatenate((white[:1], later))
    if noise == "outliers":
        wild = rng.random(n) < _OUTLIER_SHARE
        return np.where(wild, _OUTLIER_SIZE * white, white)
    return white


def _segments(rng: np.random.Generator, time_s: FloatArray, tau_s: float) -> IntArray:
    """Return the number of the interval of each row, 0 in the gaps between the intervals."""
    period_s = float(time_s[1] - time_s[0])
    lengths = np.ceil(rng.uniform(*_GAP_S, _GAPS) / period_s).astype(int)
    shortest = int(np.ceil(_PIECE_TAUS * tau_s / period_s))
    spare = time_s.size - int(lengths.sum()) - (_GAPS + 1) * shortest
    if spare < 0:
        raise InputError(
            "gaps", expected="records long enough for three gaps", found=f"{time_s.size} rows"
        )
    # Cuts of what is to spare into as many parts as there are pieces.
    cuts = np.sort(rng.integers(0, spare + 1, _GAPS))
    segment = np.zeros(time_s.size, dtype=np.int64)
    begin = 0
    for number, (end, length) in enumerate(
        zip((*cuts, spare), (*lengths, 0), strict=True), start=1
    ):
        stop = int(end) + number * shortest + int(lengths[: number - 1].sum())
        segment[begin:stop] = number
        begin = stop + int(length)
    return segment
