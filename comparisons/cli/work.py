"""The command `sindy-surge work`: the work characteristic ψ_QS from raw counts."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterable
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from surge_core.errors import InputError

if TYPE_CHECKING:
    from classic_ml.readers.test_description import TestDescription
    from classic_ml.records import Record
    from classic_ml.work.coefficient import WorkCharacteristic
    from surge_core.types import FloatArray

__all__ = ["WORK_SCHEMA", "fit_work", "run_work", "work_document", "work_table"]

WORK_SCHEMA = "sindy-surge/work/1"
# Slopes over less than this share of the range cannot be told from the errors of φ.
LEAST_PIECE = 0.25
GRID_POINTS = 7
FEWEST_ROWS = 60


def fit_work(
    record: Record,
    test: TestDescription,
    *,
    breakpoints: tuple[float, float] | None = None,
    time_constant_s: float | None = None,
    progress: Callable[[Iterable[Any]], Iterable[Any]] = iter,
) -> WorkCharacteristic:
    """Reduce a raw record without any low-pass and fit its work characteristic.

    Parameters
    ----------
    record : Record
        Counts and kelvin, as :func:`classic_ml.readers.read_raw` returns them.
    test : TestDescription
        The test they belong to.
    breakpoints : tuple of float, optional
        Where the straight pieces of Fig 22 meet; without them the pair with the least error is
        taken from a grid over the flow that the record visits.
    time_constant_s : float, optional
        Hold τ at this value.
    progress : callable
        Wraps the iteration over the pairs, to show how far it is.

    Raises
    ------
    InputError
        In one sentence when there is no T31 that counts, so no W31 and no ψ.
    """
    from classic_ml.reduction import ReductionSettings, reduce_record
    from classic_ml.work.coefficient import fit_work_characteristic
    from comparisons.harness.cautions import unknown_work

    settings = ReductionSettings(phase="none", thermocouple_inversion=True)
    reduction = reduce_record(record, test, settings)
    if "W31_kg_s" not in reduction.record:
        raise InputError(
            f"{record.source}: ψ",
            expected="T31 inside the range of its acquisition in the surge cycles",
            found=(unknown_work(reduction.record.history) or "none").rstrip("."),
        )
    # All rows of the settled machine: cycles that do not repeat each other serve as well.
    window = reduction.record["free_run"] > 0.5

    def fitted(pair: tuple[float, float]) -> WorkCharacteristic:
        return fit_work_characteristic(
            reduction.record, test, window, breakpoints=pair, time_constant_s=time_constant_s
        )

    if breakpoints is not None:
        return fitted(breakpoints)
    phi = reduction.series.phi[reduction.record["free_run"] == 2.0]
    if phi.size < FEWEST_ROWS:
        raise InputError(
            f"{record.source}: ψ",
            expected=f"at least {FEWEST_ROWS} rows of forward flow in stall",
            found=f"{phi.size}",
            remedy="name a longer [window] in the test description",
        )
    low, high = np.percentile(phi, [5.0, 95.0])
    apart = LEAST_PIECE * (high - low)
    # A little off the grid's own spacing, so that rounding decides nothing.
    grid = np.linspace(low, high, GRID_POINTS + 2)[1:-1]
    pairs = [(float(a), float(b)) for a, b in combinations(grid, 2) if b - a >= 0.99 * apart]
    fits = [fitted(pair) for pair in progress(pairs)]
    return min(fits, key=lambda fit: (math.isnan(fit.residual_std), fit.residual_std))


def work_document(fit: WorkCharacteristic, source: str) -> dict[str, Any]:
    """Return the fit as plain JSON types.

    Parameters
    ----------
    fit : WorkCharacteristic
        The fit.
    source : str
        The record.
    """
    from dataclasses import asdict

    phi, value, stderr = _curve(fit)
    errors = np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
    return {
        "schema": WORK_SCHEMA,
        "record": source,
        "time_constant_s": {
            "value": fit.time_constant_s,
            "stderr": fit.time_constant_stderr_s,
        },
        "breakpoints": list(fit.breakpoints),
        "terms": [
            {"name": name, "coefficient": float(b), "stderr": float(s)}
            for name, b, s in zip(fit.terms, fit.coef, errors, strict=True)
        ],
        "characteristic": {
            "phi": phi.tolist(),
            "psi": value.tolist(),
            "stderr": stderr.tolist(),
        },
        "valid_phi": list(fit.valid_phi),
        "rows_scored": fit.n_scored,
        "cycles": fit.n_cycles,
        "state": {"code": fit.fit_state.code, "advice": fit.fit_state.advice},
        "history": [asdict(fit.entry)],
    }


def work_table(fit: WorkCharacteristic, *, searched: bool = False) -> str:
    """Return the fit as text.

    Parameters
    ----------
    fit : WorkCharacteristic
        The fit.
    searched : bool
        The breakpoints were searched: then the errors do not say all.
    """
    from surge_core.rounding import bracketed, round_to_error

    low, high = fit.valid_phi
    if not math.isfinite(fit.time_constant_s):
        return (
            f"ψ_QS and τ are not stated: {fit.n_cycles} cycles, {fit.n_scored} rows. "
            f"{fit.fit_state.advice}\n{fit.entry.did}"
        )
    lines = [
        f"work characteristic ψ_QS from {fit.n_scored} rows in {fit.n_cycles} cycles, φ "
        f"{low:.3f} to {high:.3f}, pieces meeting at φ "
        + " and ".join(f"{point:.3g}" for point in fit.breakpoints),
        "τ = "
        + bracketed(1e3 * fit.time_constant_s, 1e3 * fit.time_constant_stderr_s)
        + f" ms; {fit.fit_state.advice}",
        "    φ    ψ_QS",
    ]
    inside = [(p, v, s) for p, v, s in zip(*_curve(fit), strict=True) if low <= p <= high]
    lines += [f"{p:.3f}   {round_to_error(v, s)}" for p, v, s in inside]
    lines.append(fit.entry.did)
    if searched:
        lines.append(
            "the breakpoints were searched: errors of the curve do not contain this choice and are "
            "two to three times too small; name them with --breakpoints where they are known"
        )
    return "\n".join(lines)


def run_work(arguments: argparse.Namespace) -> None:
    """Run the command.

    Parameters
    ----------
    arguments : argparse.Namespace
        ``raw``, ``test``, ``breakpoints``, ``tau``, ``json``.
    """
    from classic_ml.readers import read_raw
    from comparisons.cli.progress import shown_over, shown_steps
    from comparisons.show.json_output import to_strict_json
    from surge_core.files import check_apart, check_target, write_whole

    if arguments.json:
        check_target(arguments.json, ())
        check_apart([arguments.raw, arguments.test], [arguments.json])
    with shown_steps(2) as begin:
        begin("reading")
        record, test = read_raw(arguments.raw, arguments.test)
        begin("reducing and fitting")
        fit = fit_work(
            record,
            test,
            breakpoints=_pair(arguments.breakpoints),
            time_constant_s=arguments.tau,
            progress=lambda pairs: shown_over(pairs, unit="fit"),
        )
    print(work_table(fit, searched=arguments.breakpoints is None))
    if arguments.json:
        write_whole(arguments.json, to_strict_json(work_document(fit, str(Path(arguments.raw)))))
        print(f"numbers: {arguments.json}")


def _pair(values: Iterable[float] | None) -> tuple[float, float] | None:
    if values is None:
        return None
    first, second = values
    if not 0.0 < first < second < 1.0:
        raise InputError(
            "--breakpoints",
            expected="two flow coefficients between 0 and 1, the smaller first",
            found=f"{first:g} {second:g}",
        )
    return first, second


def _curve(fit: WorkCharacteristic) -> tuple[FloatArray, FloatArray, FloatArray]:
    last = fit.valid_phi[1] if math.isfinite(fit.valid_phi[1]) else 0.0
    phi = np.round(np.arange(0.0, max(last, 0.01) + 0.005, 0.01), 3)
    return (phi, *fit.characteristic(phi))
