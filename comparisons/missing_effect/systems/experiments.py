"""Measured experiments: one run each of a system, and what its channels were between samples."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from numbers import Real
from types import MappingProxyType
from typing import Any

import numpy as np

from comparisons.missing_effect.systems.model import Model
from surge_core.errors import require
from surge_core.types import BoolArray, FloatArray, IntArray

FEWEST_ROWS = 40
FEWEST_READINGS = 10
# So many values no relay has; by chance all their changes lie two rows apart, or a multiple of
# that, once in half a million records.
FEWEST_VALUES = 20
# Of the gaps of a sensor with a clock of its own; the others hold a reading equal to the last.
STEADY = 0.9
# Of the jumps of an input that is held. Of one that is drawn as one of two in each row it is half.
REPEATED = 0.4
# Pieces a sample for a band-limited input: a spline through four times as many points follows it
# to well below the noise of any record here.
BAND_FACTOR = 4
# Rows by which a record is prolonged, point-symmetric about its ends, before it is transformed.
PADDING = 400
LEAST_BRIDGE = 100


@dataclass(frozen=True, eq=False)
class Experiment:
    """One run of a system: measured inputs and outputs at a uniform rate.

    Parameters
    ----------
    name : str
        What it is called in tables; a test split's name.
    sample_period_s : float
        In seconds.
    channels : mapping of str to ndarray of shape (n,)
        Inputs and outputs of the model, in its units; others are left alone. An output that is
        not a number in a row was not read there: a slower sensor, irregular times, an outage.
    first_s : float
        Clock of the first sample, in seconds.
    settle : int
        Rows at the start from which the initial state may be estimated when the run is a check;
        they are not scored there. 0 takes what the model has states for.

    Raises
    ------
    InputError
        When channels differ in length, are infinite, or are too short.
    """

    name: str
    sample_period_s: float
    channels: Mapping[str, FloatArray]
    first_s: float = 0.0
    settle: int = 0
    origin: str = ""
    # The run that this is a stretch of, as a black box must be simulated, and its rows before.
    record: Experiment | None = None
    skipped: int = 0

    def __post_init__(self) -> None:
        period_s: Any = self.sample_period_s
        number, channels = isinstance(period_s, Real), type(self.channels)
        found = repr(period_s) if number else type(period_s).__name__
        good = number and bool(np.isfinite(period_s) and period_s > 0.0)
        self.require(good, "sample period", "a positive number of seconds", found)
        mapping = issubclass(channels, Mapping)
        self.require(mapping, "channels", "a mapping of names to values", channels.__name__)
        made: dict[str, FloatArray] = {}
        for name, given in self.channels.items():
            made[name] = values = np.ascontiguousarray(given, dtype=np.float64)
            self.require(values.ndim == 1, name, "one value a row", f"shape {values.shape}")
            self._finite(name, np.isinf(values), values)
        sizes = sorted({values.size for values in made.values()})
        self.require(len(sizes) == 1, "channels", "one length", f"lengths {sizes}")
        few = sizes[0] < FEWEST_ROWS
        self.require(not few, "rows", f"at least {FEWEST_ROWS}", f"{sizes[0]}")
        object.__setattr__(self, "channels", MappingProxyType(made))

    def _finite(self, name: str, wrong: BoolArray, values: FloatArray) -> None:
        for row in np.flatnonzero(wrong)[:1]:
            self.require(
                False,
                name,
                "finite values",
                f"{values[row]} in row {row + 1}",
                "cut the record there, or give the pieces as experiments of their own",
            )

    def require(self, good: bool, what: str, expected: str, found: str, remedy: str = "") -> None:
        """Refuse the run, by its file or name and what in it, unless something is good."""
        require(good, f"{self.origin or self.name}: {what}", expected, found, remedy)

    @property
    def n_samples(self) -> int:
        """Number of rows."""
        return next(iter(self.channels.values())).size

    def of(self, model: Model) -> Experiment:
        """Return the run with what a model needs, checked.

        Parameters
        ----------
        model : Model
            The model.

        Raises
        ------
        InputError
            When an input or an output of the model is missing, an input has gaps, or an output is
            constant or hardly read.
        """
        wanted = (*model.input_names, *model.output_names)
        for name in wanted:
            self.require(
                name in self.channels,
                name,
                f"channels {', '.join(wanted)}",
                f"{', '.join(self.channels)}",
                f"name the column '{name}' in the file, or as it is in the model",
            )
        for name in model.input_names:
            self._finite(name, np.isnan(self.channels[name]), self.channels[name])
        for name in model.output_names:
            moves = float(np.ptp(self.read(name))) > 0.0
            self.require(moves, name, "an output that changes", "a constant")
        return replace(self, channels={name: self.channels[name] for name in wanted})

    def read(self, name: str, which: str = "") -> FloatArray:
        """Return the readings of an output in some part of it, refused where they are too few."""
        read = self.channels[name][np.isfinite(self.channels[name])]
        expected = f"at least {FEWEST_READINGS} readings{which}"
        self.require(read.size >= FEWEST_READINGS, name, expected, f"{read.size}")
        return read

    def rows(self, start: int, stop: int) -> Experiment:
        """Return a stretch of the run; its clock goes on."""
        return replace(
            self,
            channels={name: values[start:stop] for name, values in self.channels.items()},
            first_s=self.first_s + start * self.sample_period_s,
            record=self.record or self,
            skipped=self.skipped + start,
        )

    def columns(self, names: Sequence[str]) -> FloatArray:
        """Return channels side by side, shape (n, number of names)."""
        if not names:
            return np.zeros((self.n_samples, 0))
        return np.column_stack([self.channels[name] for name in names])


def _changes(values: FloatArray) -> IntArray:
    """Return the rows with another finite value than the row before."""
    with np.errstate(invalid="ignore"):
        return 1 + np.flatnonzero(np.abs(np.diff(values)) > 0.0)


def held_rows(name: str, fit: Sequence[Experiment], check: Sequence[Experiment]) -> int:
    """Return for how many rows an output is held after each reading in all runs; 1 if it is not.

    It changes after most of them, and what is fitted has readings enough without the repeats. A
    sensor with a clock of its own is held for so many rows or one more or less: one that was read
    every 7 or 8 rows, and had no lag, got a firm one of half of that.
    """
    runs = (*fit, *check)
    changed = [_changes(e.channels[name]) for e in runs]
    gaps = np.concatenate([np.zeros(0, dtype=np.intp), *(np.diff(rows) for rows in changed)])
    every = int(np.gcd.reduce(gaps))
    if every == 1 and gaps.min() > 1:
        usual = int(np.median(gaps))
        pairs = zip(runs, changed, strict=True)
        jumps = np.abs(np.concatenate([np.diff(e.channels[name])[rows - 1] for e, rows in pairs]))
        # A slow rise that is rounded steps as evenly, by one digit each time.
        steady = np.median(jumps) > 1.5 * jumps.min()
        every = usual if steady and np.mean(np.abs(gaps - usual) <= 1) >= STEADY else 1
    readings = sum(e.n_samples for e in runs) / max(every, 1)
    values = np.unique(np.concatenate([e.read(name) for e in runs]))
    often = gaps.size > 0.5 * readings
    enough = all(e.n_samples > 3 * FEWEST_READINGS * every for e in fit)
    return every if often and enough and values.size >= FEWEST_VALUES else 1


def without_repeats(experiment: Experiment, held: Mapping[str, int]) -> Experiment:
    """Return a run whose held outputs are no number but where they are read."""
    channels = dict(experiment.channels)
    for name, every in held.items():
        rows = _changes(channels[name])
        fresh = np.isin(np.arange(experiment.n_samples), rows)
        if not np.any(np.diff(rows) % every):
            fresh = (np.arange(experiment.n_samples) - rows[:1].sum()) % every == 0
        channels[name] = np.where(fresh, channels[name], np.nan)
    return replace(experiment, channels=channels)


def is_held(values: FloatArray) -> bool:
    """Tell whether an input is held between its rows: it jumps, and stays where it is then.

    A jump is as large as the input's own swing: a reading of a few bits stays as well, and moves by
    little; a pulse moves on.
    """
    changed = _changes(values)
    if not changed.size:
        return True
    jumps = values[changed] - values[changed - 1]
    inner = changed[changed < values.size - 1]
    stays = np.mean(values[inner + 1] == values[inner]) if inner.size else 1.0
    return bool(np.sqrt(np.mean(jumps**2)) >= np.std(values) and stays >= REPEATED)


def input_pieces(values: FloatArray, how: str) -> FloatArray:
    """Return an input between samples as cubic pieces.

    Held until the next sample, on straight lines, on a cubic spline, or band-limited: resampled
    four times finer by a polyphase filter, and on a spline through that. A piece has coefficients
    of 1, s, s² and s³, s from 0 to 1 along it.
    """
    if how in ("held", "linear"):
        pieces = np.zeros((values.size - (how == "linear"), 4))
        pieces[:, 0] = values[: len(pieces)]
        if how == "linear":
            pieces[:, 1] = np.diff(values)
        return pieces
    from scipy.interpolate import CubicSpline

    if how == "band":
        from scipy.signal import resample_poly

        # A line from end to end is taken off, so that the filter sees no step at either end.
        ramp = np.linspace(values[0], values[-1], values.size)
        fine = resample_poly(values - ramp, BAND_FACTOR, 1)[: BAND_FACTOR * (values.size - 1) + 1]
        values = fine + np.linspace(ramp[0], ramp[-1], fine.size)
    spline = CubicSpline(np.arange(values.size, dtype=np.float64), values)
    return np.ascontiguousarray(spline.c[::-1].T)


def all_pass(values: FloatArray, alpha: float, beta: float, *, inverse: bool = False) -> FloatArray:
    """Return channels behind an all-pass of second order, or before it.

    Inputs and outputs that went through the same anti-alias filter look right to any linear model,
    whose filter cancels. A nonlinear model does not commute with it: harmonics come late. What was
    recorded is F u and F y, so the system is driven by F⁻¹ of the input and F is laid over its
    answer. F(s) = (1 − α s + β s²) / (1 + α s + β s²), s in radians a sample; a common delay cannot
    be seen; α = 0 leaves everything as it is. Channels lie along the first axis.
    """
    if alpha == 0.0:
        return values
    from scipy.fft import irfft, next_fast_len, rfft

    n = values.shape[0]
    pad = min(PADDING, n - 1)
    before = 2.0 * values[:1] - values[pad:0:-1]
    after = 2.0 * values[-1:] - values[-2 : -pad - 2 : -1]
    joined = np.concatenate([before, values, after])
    size = next_fast_len(joined.shape[0] + LEAST_BRIDGE, real=True)
    # The gap to the next fast length is bridged, so that the ends do not meet with a step.
    bridge = np.linspace(0.0, 1.0, size - joined.shape[0] + 2)[1:-1]
    bridge = bridge.reshape(-1, *(1,) * (values.ndim - 1))
    joined = np.concatenate([joined, joined[-1:] * (1.0 - bridge) + joined[:1] * bridge])
    omega = 2.0 * np.pi * np.arange(size // 2 + 1) / size
    phase = -2.0 * np.arctan2(alpha * omega, 1.0 - beta * omega**2)
    turn = np.exp((-1j if inverse else 1j) * phase).reshape(-1, *(1,) * (values.ndim - 1))
    return np.asarray(irfft(rfft(joined, axis=0) * turn, n=size, axis=0)[pad : pad + n])
