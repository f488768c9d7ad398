"""The workflow on whole runs from raw counts: names by what they explain."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from classic_ml.series import CoefficientSeries
from comparisons.missing_effect.candidates import Bench, Candidate
from comparisons.missing_effect.conclusion import concluded
from comparisons.missing_effect.effect import Effect
from comparisons.missing_effect.excitation import block_rows
from comparisons.missing_effect.fit import fit_structure
from comparisons.missing_effect.lag_data import LagData
from comparisons.missing_effect.loading import load_data
from comparisons.missing_effect.noise import NoiseModel
from comparisons.missing_effect.results import (
    SIZE,
    Diagnosis,
    FittedParameter,
    Gap,
    MissingEffect,
)
from comparisons.missing_effect.search import Leftover, Round
from comparisons.missing_effect.uncertainty import LEAST_SIZE
from comparisons.missing_effect.whole_runs import (
    RippleLine,
    alias_by_share,
    averaged_noise,
    cycles_left_out,
    plain_bench,
    ripple_line,
    weighed_by_share,
)
from surge_core.errors import InputError

__all__ = ["diagnose_whole_runs"]

# Untouched records leave 0.012 to 0.021 of the mean ψ'. A further effect is only looked for above
# the first of these; above the second, whatever was named, something else is there.
CHAIN_ERROR = 0.022
LARGEST_MODEL_ERROR = 0.03
NOTHING_LEFT = Leftover(0.0, 0, 1.0)
# Averaged φ² above this is a reversal and not its edge; what the loss must explain there.
LEAST_LOSS = 1e-5
LEAST_REVERSED_ROWS = 10
LEAST_LOSS_SHARE = 0.4
# A second average smears rows across the switches; with fewer left than this it is not taken.
LEAST_KEPT = 0.4


def diagnose_whole_runs(
    records: Sequence[CoefficientSeries],
    terms: tuple[str, ...],
    *,
    catalogue: Sequence[Effect],
    most_effects: int,
) -> Diagnosis:
    """Find what the lag model of whole runs lacks.

    Parameters
    ----------
    records : sequence of CoefficientSeries
        Reduced from raw counts.
    terms : tuple of str
        Of the characteristic.
    catalogue : sequence of Effect
        Names that compete.
    most_effects : int
        At most so many are added.
    """
    line = _strongest_line(records)
    plain = load_data(records)
    data = _averaged_over(records, line, plain) if line else plain
    unavailable = {e.name: why for e in catalogue if (why := e.missing_channel(data)) is not None}
    # The average has taken the cells off; what it leaves of others is looked for as a line.
    effects = [e for e in catalogue if e.name not in unavailable and not e.episodes]
    block = block_rows(data)
    base = plain_bench(plain, terms, len(effects), block)
    bench = start = plain_bench(data, terms, len(effects), block) if line else base
    rounds: list[Round] = []
    sets: dict[str, tuple[Candidate, ...]] = {}
    # What a second pattern of cells leaves takes other names: they are looked for once it is gone.
    while len(sets) < most_effects and line is None:
        bench, candidates = weighed_by_share(bench, [e for e in effects if e.name not in sets])
        if not sets:
            base = start = bench
        winner = next((c for c in candidates if c.evidence.accepted), None)
        rounds.append(Round(bench, _noise(bench), candidates, (), (), winner, NOTHING_LEFT))
        if winner is None:
            break
        sets[winner.name] = alias_by_share(winner, candidates)
        bench = replace(bench, fit=winner.fit)
        if _model_error(bench) < CHAIN_ERROR:
            break
    if not rounds:
        rounds.append(Round(bench, _noise(bench), (), (), (), None, NOTHING_LEFT))
    diagnosis = concluded(
        _verdict(sets, line, bench),
        base,
        bench,
        sets=sets,
        provisional=_leaves_much(bench),
        noise=_noise(bench),
        leftover=NOTHING_LEFT,
        rounds=rounds,
        unavailable=unavailable,
        gap=_gap(base, start, bench, averaged_noise(records)),
    )
    return _with_line(_with_reverse_loss(diagnosis, bench), line)


def _averaged_over(
    records: Sequence[CoefficientSeries], line: RippleLine, plain: LagData
) -> LagData:
    """Return the rows averaged over a second pattern too, where enough of them are left."""
    try:
        data = load_data(records, also_average_s=1.0 / line.frequency_hz)
    except InputError:
        return plain
    kept = np.count_nonzero(data.scored()) / np.count_nonzero(plain.scored())
    return data if kept >= LEAST_KEPT else plain


def _gap(base: Bench, start: Bench, final: Bench, floor_rms: float) -> Gap:
    """Return the errors of cycles left out, on the rows that both averages score."""
    valid = final.rows.valid
    before = cycles_left_out(base.fit, base)[valid] * base.metric.sigma
    after = before
    if final is not start or start is not base:
        after = cycles_left_out(final.fit, final)[valid] * final.metric.sigma
    return Gap(float(np.sqrt(np.mean(before**2))), float(np.sqrt(np.mean(after**2))), floor_rms)


def _strongest_line(records: Sequence[CoefficientSeries]) -> RippleLine | None:
    lines = [line for record in records if (line := ripple_line(record)) is not None]
    return max(lines, key=lambda line: line.height) if len(lines) == len(records) else None


def _noise(bench: Bench) -> NoiseModel:
    errors = bench.fit.errors(bench.train, replace(bench.train_metric, sigma=1.0))
    scored = bench.train.scored()
    rms = float(np.sqrt(np.mean(errors[scored] ** 2)))
    return NoiseModel(rms, rms, (), 0.0)


def _leaves_much(bench: Bench) -> bool:
    return _model_error(bench) > LARGEST_MODEL_ERROR


def _model_error(bench: Bench) -> float:
    """Return what a model leaves, as a share of the mean ψ'."""
    scored = bench.data.scored()
    return _noise(bench).sigma / float(np.mean(np.abs(bench.data.measured[scored])))


def _verdict(sets: Mapping[str, Sequence[Candidate]], line: RippleLine | None, bench: Bench) -> str:
    if _leaves_much(bench):
        return "provisional" if sets or line else "unexplained_structure"
    if not sets:
        return "named" if line else "nothing_missing"
    return "alias_set" if any(len(members) > 1 for members in sets.values()) else "named"


def _with_line(diagnosis: Diagnosis, line: RippleLine | None) -> Diagnosis:
    """Add the second pattern of cells, which a second average has taken off."""
    if line is None:
        return diagnosis
    found = MissingEffect(
        "rotating_stall_ripple",
        ("rotating_stall_ripple",),
        diagnosis.verdict == "provisional",
        (
            FittedParameter("r", line.amplitude, line.amplitude_stderr, "1"),
            FittedParameter("f", line.frequency_hz, line.frequency_stderr_hz, "Hz"),
        ),
        {"line_over_background": line.height},
    )
    return replace(diagnosis, missing=(found, *diagnosis.missing), ripple=line)


def _with_reverse_loss(diagnosis: Diagnosis, bench: Bench) -> Diagnosis:
    """Name the loss in reversed flow, which acts without the lag: no lag model holds it.

    It is judged in the reversed rows, where the run is not scored: by how much of what a model
    without it leaves there it explains.
    """
    data = bench.data
    if not data.has_reverse_loss:
        return diagnosis
    loss = data.sampled(data.nuisance[:, -2])
    rows = loss > LEAST_LOSS
    if np.count_nonzero(rows) < LEAST_REVERSED_ROWS:
        return diagnosis
    bare = replace(data, nuisance=np.ascontiguousarray(data.nuisance[:, :-2]))
    fit = diagnosis.after
    fit = fit_structure(fit.structure, bare, bench.metric, [fit.nonlinear])
    left, loss = (data.measured - fit.output(bare))[rows], loss[rows]
    size = float(loss @ left) / float(loss @ loss)
    after = left - size * loss
    share = 1.0 - float(after @ after) / float(left @ left)
    if size <= 0.0 or share < LEAST_LOSS_SHARE:
        return diagnosis
    # Neighbouring rows of an average say the same; one a reversal is what there is.
    reversals = 1 + int(np.count_nonzero(np.diff(np.flatnonzero(rows)) > 1))
    stderr = float(np.sqrt(np.mean(after**2) / (np.mean(loss**2) * reversals)))
    if size < LEAST_SIZE * stderr:
        return diagnosis
    found = MissingEffect(
        "reverse_flow_branch",
        ("reverse_flow_branch",),
        False,
        (
            FittedParameter("c", size, stderr, "1"),
            FittedParameter("lagged", 0.0, 0.0, "1"),
        ),
        {"share_of_reversed_rows": share, SIZE: size / stderr if stderr > 0.0 else np.inf},
    )
    verdict = "named" if diagnosis.verdict == "nothing_missing" else diagnosis.verdict
    remark = (
        f"the loss in reversed flow explains {100.0 * share:.0f} % of what the lag model leaves in "
        f"{reversals} reversals, where the run is not scored; it acts without the lag, and τ and "
        "the gap are those of the scored rows, which it does not touch"
    )
    return replace(
        diagnosis,
        missing=(*diagnosis.missing, found),
        verdict=verdict,
        remarks=(*diagnosis.remarks, remark),
    )
