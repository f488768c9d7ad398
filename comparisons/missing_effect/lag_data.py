"""What a lag model with effects is simulated from and fitted to: signals on a fine grid, rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surge_core.types import FloatArray, IntArray

TRAIN, LATER, OTHER = 0, 1, 2


@dataclass(frozen=True)
class FrozenReferences:
    """What effects are measured from; frozen with the fit, or they would mean another thing.

    Parameters
    ----------
    mean_amplitude, mean_amplitude_as_is : float
        Mean amplitude of φ, at which τ is stated: with the ends of the records prolonged, and as
        they stand.
    mean_speed : float
        Mean corrected speed, at which the characteristic is stated.
    phi_range : tuple of float
        Range of φ that was fitted.
    clock_zero_s : float
        Facility clock from which drifts and the heating of the facility count, in seconds.
    """

    mean_amplitude: float
    mean_amplitude_as_is: float
    mean_speed: float
    phi_range: tuple[float, float]
    clock_zero_s: float


@dataclass(frozen=True)
class Run:
    """One run: signals and nuisances on the fine grid, the coefficient and weights at samples."""

    signals: Mapping[str, FloatArray]
    nuisance: FloatArray
    measured: FloatArray
    weight: FloatArray


@dataclass(frozen=True)
class LagData:
    """Runs of one or several records, each signal on a grid finer than the samples.

    A model simulated at the sample step alone leaves an error that looks like a delay; four steps
    to a sample leave none that 6 000 samples can see.

    Parameters
    ----------
    signals : mapping of str to ndarray of shape (N,)
        Fine grid: ``time_s``, ``phi``, ``dphi_s`` and, where known, ``T25_K``, ``dT25_K_s``,
        ``Nc_frac``, ``in_stall``, ``amplitude``, ``stalled``.
    nuisance : ndarray of shape (N, k)
        Inputs of the lag that belong to no characteristic.
    measured : ndarray of shape (n,)
        The coefficient at the samples.
    weight : ndarray of shape (n,)
        1 where a sample is scored, 0 where it is simulated through.
    part, record : ndarray of int, shape (n,)
        0 fitted, 1 later time, 2 another record; index of the record.
    rows : ndarray of int, shape (n,)
        Row of the fine grid of each sample.
    runs, fine_runs : ndarray of int, shape (R, 2)
        First and last-plus-one row of each run, in samples and on the fine grid.
    step_s : float
        Step of the fine grid, in seconds.
    every : int
        Fine steps to a sample.
    average_s : float
        Length of the average that the measured coefficient passed; 0 for none.
    references : FrozenReferences
        What effects are measured from.
    middle_s : float
        Middle of the facility clock over all records, in seconds.
    surge_s : float
        Period of surge, in seconds.
    psi_levels : tuple of float
        Levels below which a quarter, three quarters and 92 % of the measured coefficient lie.
    sources : tuple of str
        Names of the records.
    has_reverse_loss : bool
        Whether the last two nuisances are the loss in reversed flow and its derivative.
    """

    signals: Mapping[str, FloatArray]
    nuisance: FloatArray
    measured: FloatArray
    weight: FloatArray
    part: NDArray[np.int8]
    record: IntArray
    rows: IntArray
    runs: IntArray
    fine_runs: IntArray
    step_s: float
    every: int
    average_s: float
    references: FrozenReferences
    middle_s: float
    surge_s: float
    psi_levels: tuple[float, float, float]
    sources: tuple[str, ...]
    has_reverse_loss: bool = False

    def __getitem__(self, name: str) -> FloatArray:
        """Return a signal on the fine grid."""
        return self.signals[name]

    def __contains__(self, name: object) -> bool:
        """Tell whether a signal is known."""
        return name in self.signals

    @property
    def n_samples(self) -> int:
        """Number of samples, scored or not."""
        return int(self.measured.size)

    @property
    def sample_period_s(self) -> float:
        """Time between two samples, in seconds."""
        return self.step_s * self.every

    @cached_property
    def slices(self) -> tuple[slice, ...]:
        """Rows of each run, in samples."""
        return tuple(slice(int(a), int(b)) for a, b in self.runs)

    @cached_property
    def steps_of_run(self) -> FloatArray:
        """Steps since the start of its run, at each row of the fine grid."""
        return np.concatenate(
            [np.arange(stop - start, dtype=float) for start, stop in self.fine_runs]
        )

    @cached_property
    def train(self) -> LagData:
        """Only what is fitted: each run up to its last row of that part."""
        return self.up_to(self.part == TRAIN)

    @cached_property
    def train_rows(self) -> IntArray:
        """Which samples ``train`` holds."""
        return np.concatenate(self._heads(self.part == TRAIN))

    def _heads(self, wanted: NDArray[np.bool_]) -> list[IntArray]:
        """Return the rows of each run up to its last wanted one."""
        out = []
        for start, stop in self.runs:
            last = np.flatnonzero(wanted[start:stop])
            out.append(np.arange(start, start + (last[-1] + 1 if last.size else 0)))
        return out

    def scored(self, part: int | None = None) -> NDArray[np.bool_]:
        """Return which samples are scored, of one part or of all."""
        rows = self.weight > 0.0
        return rows if part is None else rows & (self.part == part)

    def up_to(self, wanted: NDArray[np.bool_]) -> LagData:
        """Return the runs cut behind their last wanted samples; those without one are left out."""
        heads = [head for head in self._heads(wanted) if head.size]
        kept = np.concatenate(heads)
        runs = laid_out([self._cut(head[0], head[-1]) for head in heads], self.every)
        return replace(self, **runs, part=self.part[kept], record=self.record[kept])

    def _cut(self, first: int, last: int) -> Run:
        own, fine = slice(first, last + 1), slice(self.rows[first], self.rows[last] + 1)
        signals = {name: values[fine] for name, values in self.signals.items()}
        return Run(signals, self.nuisance[fine], self.measured[own], self.weight[own])

    def sampled(self, values: FloatArray) -> FloatArray:
        """Return a fine signal at the samples."""
        return values[self.rows]

    def averaged(self, columns: FloatArray) -> FloatArray:
        """Return fine columns as the average that the measured coefficient passed leaves them."""
        if self.average_s == 0.0:
            return columns
        from classic_ml.filters import period_average

        rate_hz = 1.0 / self.step_s
        return np.concatenate(
            [period_average(columns[a:b], self.average_s, rate_hz) for a, b in self.fine_runs]
        )

    def of_exit(self, change_Pa: FloatArray) -> FloatArray:
        """Return at the samples what a change of P31, on the fine grid, makes of ψ'."""
        change = (change_Pa * self.signals["psi_p_per_Pa"])[:, None]
        return self.sampled(self.averaged(change)[:, 0])

    def with_signal(self, name: str, values: FloatArray) -> LagData:
        """Return the same data with one more fine signal."""
        return replace(self, signals={**self.signals, name: values})

    def over_all_phi(self) -> LagData:
        """Return the same data with the range of φ of all scored rows."""
        phi = self.signals["phi"][self.rows[self.weight > 0.0]]
        reach = float(phi.min()), float(phi.max())
        return replace(self, references=replace(self.references, phi_range=reach))

    def with_known(self, late_s: float) -> LagData:
        """Return the rows, those unscored whose φ of so long before lies outside their run."""
        at = self.steps_of_run[self.rows] - late_s / self.step_s
        last = np.repeat(self.steps_of_run[self.fine_runs[:, 1] - 1], np.diff(self.runs)[:, 0])
        return replace(self, weight=self.weight * ((at >= 0.0) & (at <= last)))

    def with_measured(self, measured: FloatArray) -> LagData:
        """Return the same inputs with another measured coefficient."""
        return replace(self, measured=measured)

    def all_fitted(self) -> LagData:
        """Return the same rows, all of them to be fitted."""
        return replace(self, part=np.full(self.n_samples, TRAIN, dtype=np.int8))


def laid_out(runs: Sequence[Run], every: int) -> dict[str, Any]:
    """Return the fields of `LagData` that runs make, one after the other."""
    names = [n for n in runs[0].signals if all(n in run.signals for run in runs)]
    measured = _edges([run.measured.size for run in runs])
    fine = _edges([run.nuisance.shape[0] for run in runs])
    firsts = zip(fine[:, 0], np.diff(measured)[:, 0], strict=True)
    return {
        "signals": {name: np.concatenate([run.signals[name] for run in runs]) for name in names},
        "nuisance": np.concatenate([run.nuisance for run in runs]),
        "measured": np.concatenate([run.measured for run in runs]),
        "weight": np.concatenate([run.weight for run in runs]),
        "rows": np.concatenate([first + every * np.arange(size) for first, size in firsts]),
        "runs": measured,
        "fine_runs": fine,
    }


def _edges(sizes: Sequence[int]) -> IntArray:
    """Return first and last-plus-one row of pieces that stand one after the other."""
    ends = np.cumsum(sizes)
    return np.column_stack([np.concatenate([[0], ends[:-1]]), ends]).astype(np.int64)
