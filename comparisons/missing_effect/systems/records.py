"""The experiments of a diagnosis: what is fitted, what is held out of it, what is only shown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from comparisons.missing_effect.systems.experiments import Experiment, is_held
from comparisons.missing_effect.systems.fit import Fit
from comparisons.missing_effect.systems.metric import correlations
from comparisons.missing_effect.systems.model import Model
from comparisons.missing_effect.systems.roles import measured_as, rates_of
from comparisons.missing_effect.systems.structure import Between, Run
from surge_core.errors import require
from surge_core.types import FloatArray

# The last third of each record is held out of the naming.
FITTED_SHARE = 2.0 / 3.0
# Rows that are fitted and held out while structures are compared, all records together: what a
# round of sixty candidates takes well under a minute for. The parameters come from all rows.
MOST_FITTED, MOST_HELD_OUT = 8_000, 4_000
FEWEST_HELD_OUT = 40
# Of a training record: its last third must be a stretch that can be simulated.
FEWEST_ROWS = 3 * FEWEST_HELD_OUT
# Rows whose cubic tells a measured displacement and its speed at the start, and the factor by which
# its errors are widened: a cubic is no more than a fair description of so short a stretch.
FIRST_ROWS, FIRST_ROWS_DOUBT, FEWEST_FIRST = 20, 3.0, 10


@dataclass(frozen=True)
class Records:
    """Stretches of the training records for a model.

    Fitted and held out are the first two thirds and the last third of the whole records, as far as
    naming uses them; the span is from the first to the last clock, in seconds.
    """

    model: Model
    whole: tuple[Experiment, ...]
    fitted: tuple[Experiment, ...]
    held_out: tuple[Experiment, ...]
    span: tuple[float, float]

    @classmethod
    def of(cls, model: Model, experiments: Sequence[Experiment]) -> Records:
        """Cut training records; refuse an empty list, short records or unlike rates."""
        model = model.with_record_parameters()
        require(bool(experiments), "fit", "at least one experiment", "none")
        whole = tuple(e.of(model) for e in experiments)
        periods = sorted({e.sample_period_s for e in whole})
        require(
            periods[-1] <= periods[0] * (1.0 + 1e-6),
            "fit",
            "one sample rate",
            f"periods from {periods[0]:g} to {periods[-1]:g} s",
            "resample the experiments to one rate",
        )
        for e in whole:
            enough = e.n_samples >= FEWEST_ROWS
            e.require(enough, "rows", f"at least {FEWEST_ROWS}", f"{e.n_samples}")
        span = (
            min(e.first_s for e in whole),
            max(e.first_s + e.n_samples * e.sample_period_s for e in whole),
        )
        total = sum(e.n_samples for e in whole)
        records = cls(model, whole, whole, whole, span).cut(
            MOST_FITTED / total, MOST_HELD_OUT / total
        )
        for which, parts in (
            ("the first two thirds", records.fitted),
            ("the last third", records.held_out),
        ):
            for part, name in product(parts, model.output_names):
                part.read(name, f" in {which} of the record")
        return records

    def cut(self, fitted: float = 1.0, held_out: float = 1.0) -> Records:
        """Return the records with at most these shares of their rows fitted and held out.

        They count from the start of the two thirds and of the last third of each record.
        """
        first, last = [], []
        for e in self.whole:
            cut = int(FITTED_SHARE * e.n_samples)
            most, most_out = (
                max(int(share * e.n_samples), FEWEST_HELD_OUT) for share in (fitted, held_out)
            )
            first.append(e.rows(0, min(cut, most)))
            last.append(e.rows(cut, e.n_samples).rows(0, most_out))
        return replace(self, fitted=tuple(first), held_out=tuple(last))

    @property
    def between(self) -> tuple[str, ...]:
        """How each input runs between samples: as the model says, held where it shows it, or open.

        What is late by half a sample looks like another way between the samples of a staircase. An
        input that never moves shows nothing, and runs as the others do.
        """
        wanted, names = self.model.input_between_samples, self.model.input_names
        held = {
            name: all(is_held(e.channels[name]) for e in self.whole)
            for name in names
            if any(np.ptp(e.channels[name]) > 0.0 for e in self.whole)
        }
        others = all(held.values())
        return tuple("held" if wanted == "auto" and held.get(n, others) else wanted for n in names)

    @property
    def shortened(self) -> bool:
        """Whether naming uses fewer rows than there are."""
        whole = self.cut()
        return any(
            a.n_samples < b.n_samples for a, b in zip(self.fitted, whole.fitted, strict=True)
        )


def runs_of(
    records: Records, experiments: Sequence[Experiment], between: Between, *, begun: bool
) -> tuple[Run, ...]:
    """Return stretches of the training records as runs, inputs laid between samples.

    Where they begin as the record does (``begun``), what the model knows of its start holds.
    """
    return tuple(
        Run.of(records.model, e, between, records.span, _known_start(records.model, e, begun=begun))
        for e in experiments
    )


def check_run(records: Records, experiment: Experiment, fit: Fit) -> Run:
    """Return a check record as a run whose unknown starts are as large as in the fit in training.

    A few samples alone would give a hidden state, or a parameter that is of each record, any value.
    """
    model = records.model
    mean, sd = _known_start(model, experiment, begun=True)
    sd = np.where(np.isfinite(sd), sd, fit.scale[: sd.size])
    # The likelihood counts each row as new. Errors that go together for many rows say as much as
    # one: what is known of a record's parameter must weigh against them so much more.
    rows = np.sqrt(rows_together(fit))
    for i, p in enumerate(model.per_record.values(), start=model.own_states):
        found = np.array([start[i] for start in fit.starts])
        whole, least = 0.5 * (p.high - p.low), 1e-3 * (p.high - p.low)
        spread = max(float(np.std(found, ddof=1)), least) if found.size > 1 else whole
        mean[i], sd[i] = np.mean(found), spread / rows
    return Run.of(model, experiment, fit.structure.between, records.span, (mean, sd))


def rows_together(fit: Fit) -> float:
    """Return over how many rows errors of a fit go together: the sum of their correlations."""
    longest = 1.0
    for errors in fit.errors:
        for correlation in correlations(errors).T:
            until = np.flatnonzero(correlation <= 0.0)
            whole = float(2.0 * np.sum(correlation[: until[0] if until.size else None]) - 1.0)
            longest = max(longest, whole)
    return longest


def _known_start(
    model: Model, experiment: Experiment, *, begun: bool
) -> tuple[FloatArray, FloatArray]:
    """Return what is known of the state at the start, and its errors: infinite where nothing is."""
    mean, sd = np.zeros(len(model.states)), np.full(len(model.states), np.inf)
    measured = measured_as(model)
    for i, (j, factor) in rates_of(model).items():
        if i in measured:
            value, spread = _first_rows(experiment, measured[i])
            mean[i], sd[i] = value[0], spread[0]
            if np.isfinite(factor):
                mean[j], sd[j] = value[1] / factor, spread[1] / abs(factor)
    for i, name in enumerate(model.state_names):
        start = model.x0.get(name)
        if start == "first" or (i in measured and (start is None or not begun)):
            if not np.isfinite(sd[i]):
                mean[i] = _first_reading(experiment, measured.get(i, name))
        elif start is not None:
            mean[i], known = start if isinstance(start, tuple) else (start, np.inf)
            sd[i] = known if begun else sd[i]
    return mean, sd


def _first_reading(experiment: Experiment, name: str) -> float:
    expected = f"an output that reads it, for the start of {name} as 'first'"
    require(name in experiment.channels, "model: x0", expected, "none")
    values = experiment.channels[name]
    return float(values[np.isfinite(values)][0])


def _first_rows(experiment: Experiment, name: str) -> tuple[FloatArray, FloatArray]:
    """Return value and slope of an output at the first row, and their errors: a cubic.

    Where a displacement is measured, its first rows know the speed; a free search would use the
    speed at the start to make up for what the model lacks, and carry that into every other record.
    """
    values = experiment.channels[name]
    rows = np.flatnonzero(np.isfinite(values[:FIRST_ROWS])).astype(np.float64)
    read = values[np.isfinite(values)]
    if rows.size < FEWEST_FIRST:
        return np.array([read[0], 0.0]), np.array([np.inf, np.inf])
    cubic = np.vander(rows, 4, increasing=True)
    first = read[: rows.size]
    coefficients = np.linalg.lstsq(cubic, first, rcond=None)[0]
    left = first - cubic @ coefficients
    # A reading of a few bits can repeat itself exactly; its step is then the least error.
    steps = np.abs(np.diff(read))
    noise = max(
        float(np.sqrt(left @ left / (rows.size - 4))),
        float(np.min(steps[steps > 0.0])) / np.sqrt(12.0),
    )
    spread = FIRST_ROWS_DOUBT * noise * np.sqrt(np.diag(np.linalg.inv(cubic.T @ cubic)))
    per = experiment.sample_period_s
    mean = np.array([coefficients[0], coefficients[1] / per])
    return mean, np.array([spread[0], spread[1] / per])
