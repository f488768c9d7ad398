"""What a wrong surge start and a wrong plenum volume do to both methods, recomputed for each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from classic_ml.description import TestDescription
from classic_ml.records import Record
from classic_ml.reduction import ReductionSettings, reduce_record
from comparisons.total_system.fit import fit_total_system, prepare
from comparisons.total_system.measured import SMOOTHING_S, Measured, measured_signals
from comparisons.total_system.settings import (
    TotalSystemFit,
    TotalSystemSettings,
    TotalSystemState,
)
from surge_core.errors import InputError
from surge_core.rounding import NOT_KNOWN, round_to_error, significant
from surge_core.types import FloatArray

__all__ = [
    "COMPONENT",
    "CostSection",
    "SensitivityRow",
    "cost_section",
    "sensitivity_rows",
    "sensitivity_table",
    "start_error_table",
]


COMPONENT, MULTIPLE = "component", "multiple-shooting"
METHODS = (COMPONENT, MULTIPLE, "aligned", "fitted")
# The paper's own range of trust at 98.5 % ends at 0.175; below 0 nothing is measured well.
PHI_OF_TABLE = (0.0, 0.05, 0.1, 0.15)
# Shifts of the start that the notes on the rig measured the output error of.
START_ERRORS_S = (0.002, 0.010, 0.040)
VOLUME_FACTORS = (1.1,)
# Rows of the whole table: each method without an error and under each.
N_ROWS = len(METHODS) * (1 + len(START_ERRORS_S) + len(VOLUME_FACTORS))


@dataclass(frozen=True)
class SensitivityRow:
    """One method under one error of what it was told.

    Parameters
    ----------
    method : str
        ``"component"``, or how the total-system method takes the surge start.
    perturbation : str
        What was wrong, in words.
    start_error_s, volume_factor : float
        The same in numbers.
    beta, beta_stderr : tuple of float
        Coefficients of ψ'_QS on 1, φ, φ².
    tau_s, tau_stderr_s : float
        Time constant, in seconds.
    tau_change : float
        Change of τ over the same method's τ without the error.
    beta_change : tuple of float
        Change of β against the same method without the error.
    curve_change : float
        Largest change of ψ'_QS at φ = 0, 0.05, 0.1 and 0.15.
    state : str
        How the fit ended.
    P31_rms : float
        Residual of P31 over its swing; nan for the component method, which does not simulate it.
    """

    method: str
    perturbation: str
    start_error_s: float
    volume_factor: float
    beta: tuple[float, float, float]
    beta_stderr: tuple[float, float, float]
    tau_s: float
    tau_stderr_s: float
    tau_change: float
    beta_change: tuple[float, float, float]
    curve_change: float
    state: str
    P31_rms: float

    def to_json(self) -> dict[str, Any]:
        """Return the row as plain JSON types."""
        return asdict(self)


def start_error_table(
    record: Record,
    test: TestDescription,
    settings: TotalSystemSettings,
    *,
    start_errors_s: Sequence[float] = START_ERRORS_S,
    methods: Sequence[str] = METHODS,
    progress: Callable[[str], object] = lambda _: None,
) -> list[SensitivityRow]:
    """Return what errors of the surge start do; see `sensitivity_rows`.

    Parameters
    ----------
    record, test, settings, start_errors_s, methods, progress
        As in `sensitivity_rows`.
    """
    return sensitivity_rows(
        record,
        test,
        settings,
        start_errors_s=start_errors_s,
        volume_factors=(),
        methods=methods,
        progress=progress,
    )


def sensitivity_rows(
    record: Record,
    test: TestDescription,
    settings: TotalSystemSettings,
    *,
    start_errors_s: Sequence[float] = START_ERRORS_S,
    volume_factors: Sequence[float] = VOLUME_FACTORS,
    methods: Sequence[str] = METHODS,
    progress: Callable[[str], object] = lambda _: None,
) -> list[SensitivityRow]:
    """Return β and τ of both methods, each without an error and under each error.

    A start error of e says that the surge began e later on the facility's clock than it did. The
    total-system method runs its model from there. The component method gets the record with its
    clock moved by as much against test.toml's near-stall reading and window, and is reduced and
    fitted anew; a wrong volume it can be told of is the one between the planes, which is scaled
    by the same factor.

    Parameters
    ----------
    record : Record
        The raw record.
    test : TestDescription
        Its test.
    settings : TotalSystemSettings
        Facility and switches; ``start``, ``start_error_s`` and ``volume_factor`` are set here.
        Without ``initial_beta`` a single run starts from what multiple shooting finds with the
        same volume.
    start_errors_s, volume_factors : sequence of float
        The errors.
    methods : sequence of str
        ``"component"`` and the ways to take the surge start.
    progress : callable
        Called with a word on each fit before it runs.

    Returns
    -------
    list of SensitivityRow
        By method, the one without an error first.

    Raises
    ------
    InputError
        When the record cannot be used, or a method is not known.
    """
    for method in methods:
        if method not in METHODS:
            raise InputError("methods", expected=" or ".join(METHODS), found=repr(method))
    errors = [(0.0, 1.0)]
    errors += [(error, 1.0) for error in start_errors_s]
    errors += [(0.0, factor) for factor in volume_factors]
    plain = replace(settings, start_error_s=0.0, volume_factor=1.0)
    system = _SystemRows(record, test, plain)
    rows: list[SensitivityRow] = []
    for method in methods:
        known: SensitivityRow | None = None
        for error, factor in errors:
            progress(f"{method}: {_words(error, factor)}")
            if method == COMPONENT:
                row = _component_row(record, test, error, factor)
            else:
                row = system.row(method, error, factor)
            known = known or row
            rows.append(_against(row, known))
    return rows


class _SystemRows:
    """Fits of the total-system method, each with the best start values it can be given.

    A single run starts from what multiple shooting finds with the same volume; multiple shooting,
    which has one basin, from what it finds without an error.
    """

    def __init__(self, record: Record, test: TestDescription, settings: TotalSystemSettings):
        self._record, self._test, self._settings = record, test, settings
        self._measured: Measured | None = None
        self._found: dict[tuple[float, float], TotalSystemFit] = {}

    def row(self, method: str, error_s: float, factor: float) -> SensitivityRow:
        """Return the row of one method under one error."""
        if method == MULTIPLE:
            return _system_row(self._multiple(error_s, factor), error_s, factor)
        told = replace(
            self._started(self._settings, self._multiple(0.0, factor)),
            start=method,
            start_error_s=error_s,
            volume_factor=factor,
        )
        return _system_row(fit_total_system(self._data(), self._test, told), error_s, factor)

    def _data(self) -> Measured:
        if self._measured is None:
            given = self._settings.smoothing_s
            self._measured = measured_signals(
                self._record, self._test, SMOOTHING_S if given is None else given
            )
        return self._measured

    def _multiple(self, error_s: float, factor: float) -> TotalSystemFit:
        if (error_s, factor) not in self._found:
            told = replace(
                self._settings, start=MULTIPLE, start_error_s=error_s, volume_factor=factor
            )
            if (error_s, factor) != (0.0, 1.0):
                told = self._started(told, self._multiple(0.0, 1.0))
            self._found[error_s, factor] = fit_total_system(self._data(), self._test, told)
        return self._found[error_s, factor]

    def _started(self, told: TotalSystemSettings, fit: TotalSystemFit) -> TotalSystemSettings:
        if told.initial_beta is not None or fit.state is not TotalSystemState.CONVERGED:
            return told
        return replace(told, initial_beta=fit.beta, initial_tau_s=fit.tau_s)


def _words(error_s: float, factor: float) -> str:
    if error_s:
        return f"start {1e3 * error_s:+g} ms"
    return f"volume x {factor:g}" if factor != 1.0 else "none"


def _system_row(fit: TotalSystemFit, error_s: float, factor: float) -> SensitivityRow:
    return SensitivityRow(
        fit.settings.start,
        _words(error_s, factor),
        error_s,
        factor,
        fit.beta,
        fit.beta_stderr,
        fit.tau_s,
        fit.tau_stderr_s,
        0.0,
        (0.0, 0.0, 0.0),
        0.0,
        fit.state.code,
        fit.relative_rms["P31"],
    )


def _component_row(
    record: Record, test: TestDescription, error_s: float, factor: float
) -> SensitivityRow:
    """Reduce and fit the component method anew with what it would be told."""
    from comparisons.harness.estimators import default_estimators
    from comparisons.harness.rows import stack_rows

    machine = replace(
        test.compressor, internal_volume_m3=factor * test.compressor.internal_volume_m3
    )
    told = replace(test, compressor=machine)
    moved = replace(record, start_s=record.start_s - error_s)
    rows = stack_rows([reduce_record(moved, told, ReductionSettings()).series])
    spec = next(s for s in default_estimators() if s.name == "classic_ml")
    model = spec.build(rows).fit(rows.X, rows.measured, rows.labels)
    stderr = np.sqrt(np.diag(model.covariance_))
    return SensitivityRow(
        COMPONENT,
        _words(error_s, factor),
        error_s,
        factor,
        _three(model.coef_),
        _three(stderr),
        float(model.time_constant_s_),
        float(model.time_constant_stderr_s_),
        0.0,
        (0.0, 0.0, 0.0),
        0.0,
        model.fit_state_.code,
        float("nan"),
    )


def _three(values: FloatArray) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])


def _against(row: SensitivityRow, known: SensitivityRow) -> SensitivityRow:
    """Fill in the changes against the same method without an error."""
    change = np.subtract(row.beta, known.beta)
    curve = np.polynomial.polynomial.polyval(np.asarray(PHI_OF_TABLE), change)
    return replace(
        row,
        tau_change=row.tau_s / known.tau_s - 1.0,
        beta_change=_three(change),
        curve_change=float(np.max(np.abs(curve))),
    )


def sensitivity_table(rows: Sequence[SensitivityRow]) -> str:
    """Return the rows as an aligned table for a terminal.

    Parameters
    ----------
    rows : sequence of SensitivityRow
        Rows of `sensitivity_rows` or `start_error_table`.
    """
    heads = ("method", "told wrong", "β₁", "β₂", "β₃", "τ [ms]", "Δτ", "Δψ'_QS", "P31", "state")
    cells = [_cells(row) for row in rows]
    widths = [max(len(line[i]) for line in (heads, *cells)) for i in range(len(heads))]
    left = (0, 1, len(heads) - 1)
    lines = [
        "  ".join(
            text.ljust(width) if i in left else text.rjust(width)
            for i, (text, width) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in (heads, *cells)
    ]
    rule = "─" * (sum(widths) + 2 * (len(widths) - 1))
    legend = (
        "Δ: against the same method told right; Δψ'_QS: largest of φ = 0, 0.05, 0.1, 0.15; "
        "P31: residual over swing"
    )
    return "\n".join([lines[0], rule, *lines[1:], "", legend])


def _cells(row: SensitivityRow) -> list[str]:
    share = f"{100.0 * row.P31_rms:.1f} %" if np.isfinite(row.P31_rms) else NOT_KNOWN
    return [
        row.method,
        row.perturbation,
        *(round_to_error(b, e) for b, e in zip(row.beta, row.beta_stderr, strict=True)),
        round_to_error(1e3 * row.tau_s, 1e3 * row.tau_stderr_s),
        f"{100.0 * row.tau_change:+.1f} %",
        significant(row.curve_change, 2) if row.curve_change else "0",
        share,
        row.state,
    ]


@dataclass(frozen=True)
class CostSection:
    """The misfit along one parameter, all others held.

    Parameters
    ----------
    parameter : str
        Name of the parameter.
    change : ndarray of shape (n,)
        Its change, as a share of the centre.
    P31_rms : ndarray of shape (n,)
        Residual of P31 over its swing; nan where the model did not stay finite.
    """

    parameter: str
    change: FloatArray
    P31_rms: FloatArray

    @property
    def n_minima(self) -> int:
        """Number of local minima inside the section."""
        inner = self.P31_rms[1:-1]
        return int(np.sum((inner < self.P31_rms[:-2]) & (inner < self.P31_rms[2:])))

    @property
    def basin(self) -> tuple[float, float]:
        """How far down and up from the lowest point the misfit rises without a fall."""
        best = int(np.nanargmin(self.P31_rms))
        low, high = best, best
        while low > 0 and self.P31_rms[low - 1] > self.P31_rms[low]:
            low -= 1
        while high < self.change.size - 1 and self.P31_rms[high + 1] > self.P31_rms[high]:
            high += 1
        return float(self.change[low]), float(self.change[high])


def cost_section(
    data: Record | Measured,
    test: TestDescription,
    settings: TotalSystemSettings,
    parameter: str = "beta_3",
    *,
    span: float = 0.1,
    n_points: int = 41,
) -> CostSection:
    """Return the misfit along one parameter through the start values of the settings.

    A single run beyond the first cycle has a needle at the truth and many other minima beside
    it; multiple shooting has one wide basin.

    Parameters
    ----------
    data, test, settings
        As in `fit_total_system`; ``initial_beta`` and ``initial_tau_s`` are the centre. Nodes are
        taken as measured.
    parameter : {"beta_1", "beta_2", "beta_3", "tau"}
        What is moved.
    span : float
        Largest change, as a share of the centre.
    n_points : int
        Points, at least 3.

    Raises
    ------
    InputError
        When the parameter is not known, or there are fewer than three points.
    """
    names = ("beta_1", "beta_2", "beta_3", "tau")
    if parameter not in names:
        raise InputError("parameter", expected=" or ".join(names), found=repr(parameter))
    if n_points < 3 or not 0.0 < span < 1.0:
        raise InputError(
            "cost_section", expected="3 points or more within 100 %", found=f"{n_points}, {span}"
        )
    shooting, model = prepare(data, test, settings)
    centre, i = shooting.parameters.start(model), names.index(parameter)
    spread = float(np.std(np.concatenate(shooting.scored_outputs)[:, 0]))
    change = np.linspace(-span, span, n_points)
    rms = np.empty(n_points)
    for k, share in enumerate(change):
        z = centre.copy()
        z[i] = np.log1p(share) if parameter == "tau" else (1.0 + share) * centre[i]
        rms[k] = shooting.rms(z, shooting.first_nodes[:, :0])[0] / spread
    return CostSection(parameter, change, rms)
