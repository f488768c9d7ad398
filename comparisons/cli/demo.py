"""The demo: simulated surge tests from counts to the report, and one that hides an effect."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from classic_ml.series import write_series
from surge_core.errors import InputError

if TYPE_CHECKING:
    from classic_ml.reduction import Reduction
    from classic_ml.work.coefficient import WorkCharacteristic
    from comparisons.harness.compare import Comparison
    from comparisons.harness.reconstruction import Reconstruction
    from comparisons.harness.truth import Truth
    from comparisons.page.blocks import Part
    from comparisons.rig import RigRun
    from comparisons.show.report import ReportSection

__all__ = ["Demo", "run"]

# The paper's main case, and the one in which ψ could be had too; the second 98.5 % instability
# is for validation: nothing is fitted to it.
FITTED = (("985", "98.5 % speed"), ("90", "90 % speed"))
VALIDATION = "985-second"
RIG_FILES = {"raw.csv", "test.toml", "truth"}
# Beyond this the rig's in-stall parabola meets its unstalled branch.
TRUTH_TO_PHI = 0.24
# The paper's own valid range of the 90 % curves is 0 to 0.1.
WORK_TO_PHI = 0.1


@dataclass(frozen=True)
class Demo:
    """What the demo leaves behind.

    Parameters
    ----------
    comparisons : tuple
        (ψ' comparison, ψ comparison or None) of each test.
    summary : str
        Found against true, in lines of text: the rig's truth is known.
    report : path
        The HTML report.
    """

    comparisons: tuple[tuple[Comparison, Comparison | None], ...]
    summary: str
    report: Path


def run(
    folder: Path,
    seed: int = 0,
    *,
    progress: Callable[[Iterable[Any]], Iterable[Any]] = iter,
    command: str = "sindy-surge demo",
) -> Demo:
    """Simulate, reduce, compare, validate and report.

    Parameters
    ----------
    folder : path
        Where records, series, models and the report go; made if it does not exist.
    seed : int
        Seed of the rig's sensors.
    progress : callable
        Wraps iterations, to show how far they are.
    command : str
        Printed in the report.

    Raises
    ------
    InputError
        When the folder cannot be made.
    """
    from comparisons.cli.demo_missing import missing_ending
    from comparisons.harness.lag_value import save_models
    from comparisons.show.report import ReportSection, write_report

    _make(folder)
    sections: list[ReportSection] = []
    done: list[tuple[Comparison, Comparison | None]] = []
    lines: list[str] = []
    for case, title in progress(FITTED):
        rig, reduction = _test(case, seed, folder)
        comparison, work = _compare(reduction, progress)
        done.append((comparison, work))
        models = {result.name: result.model for result in comparison.results}
        save_models(models, folder / f"models_{case}.json")
        validation: tuple[Reconstruction, ...] = ()
        if case == FITTED[0][0]:
            validation = _validate(comparison, seed, folder)
        truth = _truth(rig, "psi_p")
        work_truth = _truth(rig, "psi") if work else None
        lines += _against_truth(title, comparison, truth)
        extra: tuple[Part, ...] = ()
        if work is not None and work_truth is not None:
            lines += _against_truth(title, work, work_truth)
            power = _power_balance(folder / f"raw_{case}")
            lines += _power_against_truth(title, power, work_truth)
            extra = (_power_part(power, work_truth),)
        sections.append(
            ReportSection(
                title=f"Simulated test at {title}",
                comparison=comparison,
                work=work,
                reduction=reduction,
                truth=truth,
                work_truth=work_truth,
                validation=validation,
                extra=extra,
            )
        )
        if case == FITTED[0][0]:
            first = (reduction.series, float(rig.truth_parameters["tau_s"]))
    ending = missing_ending(
        folder,
        seed,
        first[0],
        lambda effect: _test(FITTED[0][0], seed, folder, hide=effect)[1].series,
        first[1],
    )
    sections += ending.sections
    lines += ending.lines
    report = folder / "report.html"
    write_report(
        report,
        sections,
        title="A simulated surge test, end to end",
        command=command,
        progress=progress,
    )
    return Demo(tuple(done), "\n".join(lines), report)


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):
        raise InputError(str(folder), expected="a folder to write to", found="a file") from None


def _test(case: str, seed: int, folder: Path, hide: str | None = None) -> tuple[RigRun, Reduction]:
    """Simulate one test and reduce it from its files, as a real record is."""
    from classic_ml.readers import read_raw
    from classic_ml.reduction import reduce_record
    from comparisons.rig import simulate, write_run

    rig = simulate(case, seed=seed, hide=hide)
    name = case if hide is None else f"{case}-altered"
    raw = folder / f"raw_{name}"
    _clear(raw)
    write_run(rig, raw)
    reduction = reduce_record(*read_raw(raw / "raw.csv", raw / "test.toml"))
    write_series(reduction.series, folder / f"series_{name}.csv")
    return rig, reduction


def _clear(raw: Path) -> None:
    """Remove what an earlier demo left here, and nothing else."""
    if raw.is_dir() and {entry.name for entry in raw.iterdir()} <= RIG_FILES:
        shutil.rmtree(raw)


def _compare(
    reduction: Reduction, progress: Callable[[Iterable[Any]], Iterable[Any]]
) -> tuple[Comparison, Comparison | None]:
    from comparisons.harness.compare import compare_records

    comparison = compare_records([reduction.series], progress=progress)
    if reduction.series.psi is None:
        return comparison, None
    return comparison, compare_records([reduction.series], target="psi", progress=progress)


def _validate(comparison: Comparison, seed: int, folder: Path) -> tuple[Reconstruction, ...]:
    """Run the fitted models over a second instability that nothing was fitted to."""
    from comparisons.harness.reconstruction import reconstruct_record

    _, reduction = _test(VALIDATION, seed + 1, folder)
    return tuple(
        reconstruct_record(result.model, reduction.series) for result in comparison.results
    )


def _power_balance(raw: Path) -> WorkCharacteristic:
    """Fit ψ_QS to the power the blading delivers, as `sindy-surge work` does."""
    from classic_ml.readers import read_raw
    from comparisons.cli.work import fit_work

    return fit_work(*read_raw(raw / "raw.csv", raw / "test.toml"))


def _power_against_truth(title: str, power: WorkCharacteristic, truth: Truth) -> list[str]:
    if not np.isfinite(power.time_constant_s):
        return [f"{title}, ψ_QS from the power balance: not stated. {power.fit_state.advice}"]
    low, high = max(power.valid_phi[0], 0.0), min(power.valid_phi[1], WORK_TO_PHI)
    at = np.linspace(low, high, 50)
    off = np.max(np.abs(power.characteristic(at)[0] - np.interp(at, truth.phi, truth.quasi_steady)))
    return [
        f"{title}, ψ_QS from the power balance (`work`), φ from {low:.2f} to {high:.2f}: off by at "
        f"most {off:.2f}, τ {1e3 * power.time_constant_s:.1f} ms for "
        f"{1e3 * truth.time_constant_s:.0f}"
    ]


def _power_part(power: WorkCharacteristic, truth: Truth) -> Part:
    from comparisons.page.blocks import Head, Part, Table, Words
    from surge_core.rounding import round_to_error

    at = np.round(np.arange(0.02, WORK_TO_PHI + 0.005, 0.01), 3)
    value, stderr = power.characteristic(at)
    true = np.interp(at, truth.phi, truth.quasi_steady)
    rows = tuple(
        (f"{p:.2f}", round_to_error(v, s), f"{t:.2f}")
        for p, v, s, t in zip(at, value, stderr, true, strict=True)
    )
    heads = (Head("φ"), Head("ψ_QS"), Head("truth"))
    return Part(
        "Work characteristic from the power balance",
        (Words(power.entry.did), Table("ψ_QS from W25 ψ in one free run", heads, rows)),
    )


def _truth(rig: RigRun, target: str) -> Truth:
    """Return the rig's own in-stall characteristic over forward flow."""
    from comparisons.harness.truth import Truth

    phi = np.linspace(0.0, TRUTH_TO_PHI, 101)
    known = rig.truth_parameters
    if target == "psi_p":
        quasi_steady = np.polynomial.polynomial.polyval(phi, known["beta"])
    else:
        first, second = known["psi_breaks"]
        pieces = [
            np.minimum(phi, first),
            np.clip(phi - first, 0.0, second - first),
            np.maximum(phi - second, 0.0),
        ]
        quasi_steady = known["psi_intercept"] + np.asarray(known["psi_slopes"]) @ np.array(pieces)
    return Truth(float(known["tau_s"]), phi, quasi_steady, "truth of the simulated rig")


def _against_truth(title: str, comparison: Comparison, truth: Truth) -> list[str]:
    low, high = max(comparison.valid_phi[0], truth.phi[0]), min(comparison.valid_phi[1], 0.15)
    at = np.linspace(low, high, 50)
    true = np.interp(at, truth.phi, truth.quasi_steady)
    symbol = "ψ'_QS" if comparison.rows.target == "psi_p" else "ψ_QS"
    lines = [
        f"{title}, {symbol}: found against the truth of the rig, φ from {low:.2f} to {high:.2f}"
    ]
    for result in comparison.results:
        off = float(np.max(np.abs(result.model.quasi_steady(at) - true)))
        lines.append(
            f"  {result.label:32s} off by at most {off:.2f} of {true.min():.1f} to "
            f"{true.max():.1f}, "
            f"τ {1e3 * result.model.time_constant_s:5.1f} ms for {1e3 * truth.time_constant_s:.0f}"
        )
    return lines
