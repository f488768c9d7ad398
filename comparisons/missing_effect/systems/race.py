"""The race: which candidates are worth a fit, their first steps, and which rivals are rejected."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from comparisons.missing_effect.systems.bench import Bench
from comparisons.missing_effect.systems.fit import Fit, fit_runs, settled
from comparisons.missing_effect.systems.metric import Metric, metric_of
from comparisons.missing_effect.systems.places import Place
from comparisons.missing_effect.systems.score import Answers, Probe
from comparisons.missing_effect.systems.shapes import Kind
from comparisons.missing_effect.systems.structure import Structure
from surge_core.types import FloatArray

# Effects that make an input or a reading come late.
LATE = (Kind.INPUT_LAG, Kind.INPUT_PLAY, Kind.OUTPUT_LAG)
# Effects that promise nothing to first order where the model without them went elsewhere: a wall
# or a rim that the run of a wrong model never meets. They always race.
BENT = (Kind.INPUT_MAP, Kind.STATE_LIMIT, Kind.OVERFLOW, Kind.OUTPUT_MAP, Kind.INPUT_PLAY)
# Candidates that are fitted: the most promising of each metric, as long as they promise a
# hundredth of the best; pairs and terms without a name, more than chance as well. Of names chance
# is asked after the fit: few blocks left flips without power, and what always races won unopposed.
# Of six names rounding decided which raced: the spilling tanks ended at 0.24 to 0.34 V, of ten at
# 0.26 to 0.28 V.
MOST_FITTED, MOST_TERMS, MOST_PAIRS, LEAST_PROMISE_SHARE = 10, 3, 3, 0.01
# Steps of the first lap, those that go on by either count, and steps to the end.
FIRST_LAP, FINALISTS, MOST_ITERATIONS = 4, 8, 15
FLIP_SEED = 0
# Log-units of held-out rows that chance makes: 1 %, one-sided.
ALIKE = 0.5 * 2.33**2
# Repeats, whose gaps give a normal tail, and steps of each fit: both begin near their ends.
REPEATS, STEPS = 20, 3
# Innovations are drawn in blocks, with either sign.
BLOCK_ROWS = 20


def promising(raw: Answers, white: Answers, late: Collection[int]) -> list[Probe]:
    """Return the most promising of both metrics, each place once, and what always races."""
    kept: dict[object, Probe] = {}
    for answers in (white, raw):
        probes = answers.best()
        best = probes[0].gain if probes else 0.0
        share = LEAST_PROMISE_SHARE * best
        least = max(answers.chance(np.random.default_rng(FLIP_SEED)), share)
        named = [p for p in probes if p.gain > share and not p.unnamed]
        terms = [p for p in probes if p.gain > least and p.unnamed]
        pairs = answers.pairs(MOST_PAIRS, least)
        for probe in (*named[:MOST_FITTED], *terms[:MOST_TERMS], *pairs):
            kept.setdefault(probe.key, probe)
    for probe in white.best():
        effect = probe.placed.effect
        # A weak filter through which all was recorded is a delay, as is an offset at its end.
        bent = (effect.kind in BENT and not effect.linear) or effect.kind is Kind.RECORDING
        if bent or (effect.kind is Kind.INPUT_DELAY and probe.placed.place.at in late):
            kept.setdefault(probe.key, probe)
    # The plain form of whatever is promising races beside it, and each half of a pair alone.
    wanted = {(e.name, e.place) for p in kept.values() for e in p.added}
    for probe in white.best():
        half = any(p.second is not None and probe.placed.key in p.key for p in kept.values())
        if _plain_forms(probe) & wanted or half:
            kept.setdefault(probe.key, probe)
    return list(kept.values())


def raced(bench: Bench, probes: Sequence[Probe]) -> dict[Probe, Fit]:
    """Fit a few steps each in the raw metric, and to the end those that are ahead by then.

    Ahead by either count: errors as they are, and the likelihood in the metric of their own.
    """
    lane = bench.raced()
    begun = {probe: _begun(lane, probe) for probe in probes}
    begun = {probe: fit for probe, fit in begun.items() if not fit.failed}
    if not begun:
        return {}
    own = {p: metric_of(f.errors).log_likelihood(f.errors) for p, f in begun.items()}
    ahead: list[Probe] = []
    # On long records each costs minutes.
    most = FINALISTS if lane is bench else FINALISTS // 2
    for unnamed in (False, True):
        group = [p for p in begun if p.unnamed == unnamed]
        by_size = _first(sorted(group, key=lambda p: begun[p].cost), most)
        by_own = _first(sorted(group, key=lambda p: -own[p]), most)
        ahead += [p for p in group if p in by_size or p in by_own]
    forms = {(p.placed.name, p.placed.place) for p in ahead}
    ahead += [p for p in begun if p not in ahead and _plain_forms(p) & forms]
    starts = {p: begun[p].starts if lane is bench else bench.fit.starts for p in ahead}
    return {
        p: begun[p].again(bench.train, bench.raw, starts[p], most=MOST_ITERATIONS) for p in ahead
    }


def _first(ranked: Sequence[Probe], most: int) -> list[Probe]:
    """Return the first few; overflows of one vessel into others, which fit alike, count once."""
    kinds = [
        (Kind.OVERFLOW, p.placed.place.at) if p.placed.effect.kind == Kind.OVERFLOW else p
        for p in ranked
    ]
    few = list(dict.fromkeys(kinds))[:most]
    return [p for p, kind in zip(ranked, kinds, strict=True) if kind in few]


def _plain_forms(probe: Probe) -> set[tuple[str, Place]]:
    """Return what a probe is a plain form of, at its place."""
    return {(name, probe.placed.place) for name in probe.placed.effect.simple_form_of}


def _begun(bench: Bench, probe: Probe) -> Fit:
    """Fit a few steps from where the score test points, or from the best of several starts."""
    structure = bench.fit.structure
    for placed in probe.added:
        structure = structure.with_effect(placed)

    # A rim that one step brings nearest may still be far: of three starts the spilling tanks' fit
    # went on from that one to -440, and from the others to -510 and -518.
    laps = (
        fit_runs(structure, bench.train, bench.raw, theta, bench.fit.starts, most=FIRST_LAP)
        for theta in _beginnings(bench, probe, structure)
    )
    best = min(laps, key=lambda fit: fit.cost)
    if best.failed or not probe.placed.effect.begins_afresh:
        return best
    return best.again(bench.train, bench.raw, most=MOST_ITERATIONS)


def _beginnings(bench: Bench, probe: Probe, structure: Structure) -> list[FloatArray]:
    """Return where a fit of one more effect, or of two, may begin."""
    effect, theta = probe.placed.effect, bench.fit.theta
    end = bench.fit.structure.offsets.stop
    slots = _slots(structure, probe)
    if probe.second is not None:
        return [np.concatenate([theta, slots, _slots(structure, probe.second)])]
    out = [np.concatenate([theta, slots])]
    if effect.begins_afresh:
        # What makes another reading of everything: the model without it may be far off.
        begun = structure.start()
        out.append(np.concatenate([begun[:end], theta[end:], slots]))
    elif effect.kind in LATE:
        # What comes late through it, the model without it has put down to a timing offset.
        untimed = theta.copy()
        untimed[bench.fit.structure.offsets] = 0.0
        out.append(np.concatenate([untimed, slots]))
    if effect.numbers and not effect.linear:
        # A threshold in the run of a model that lacks it may be nowhere near the true one.
        others = [start for start in probe.placed.starts if start != probe.start]
        out += [np.concatenate([theta, structure.slots(start)]) for start in others]
    return out


def _slots(structure: Structure, probe: Probe) -> FloatArray:
    linear = probe.placed.effect.linear and bool(probe.placed.effect.numbers)
    return structure.slots((0.0, *probe.start[1:]) if linear else probe.start)


def favoured_metric(bench: Bench, fits: Sequence[Fit]) -> Metric:
    """Return the metric of the errors of the candidate that held-out rows favour.

    By its own likelihood on the rows fitted, the most flexible wins, whatever comes after; of those
    that held-out rows favour alike, the one that fits best.
    """

    def held_out(fit: Fit) -> float:
        own = metric_of(fit.errors)
        later = settled(fit, bench.later, own)
        return -np.inf if later.failed else own.log_likelihood(later.errors)

    good = [bench.fit, *(fit for fit in fits if not fit.failed)]
    favour = [held_out(fit) for fit in good]
    alike = [f for f, own in zip(good, favour, strict=True) if own >= max(favour) - ALIKE]
    return metric_of(min(alike, key=lambda f: f.cost).errors)


def rejected(name: Fit, rival: Fit, lane: Bench, metric: Metric, rng: np.random.Generator) -> float:
    """Return the chance of so large an advantage of a name if its rival were the truth.

    The rival is simulated with its own innovations drawn again, both are fitted to it, and the
    advantage is compared with the one on the record (Cox 1962).
    """
    from scipy.stats import norm

    name, rival = (f.again(lane.train, metric, lane.fit.starts, most=STEPS) for f in (name, rival))
    found, gaps = rival.cost - name.cost, []
    for _ in range(REPEATS if not rival.failed else 0):
        drawn = [
            replace(run, outputs=path.outputs + _drawn(errors, metric, rng))
            for run, path, errors in zip(lane.train, rival.paths, rival.errors, strict=True)
        ]
        one, two = (f.again(drawn, metric, most=STEPS) for f in (name, rival))
        if np.isfinite(one.cost) and np.isfinite(two.cost):
            gaps.append(two.cost - one.cost)
    if len(gaps) < REPEATS // 2:
        return 1.0
    spread = max(float(np.std(gaps, ddof=1)), 1e-12)
    return float(norm.sf((found - float(np.mean(gaps))) / spread))


def _drawn(errors: FloatArray, metric: Metric, rng: np.random.Generator) -> FloatArray:
    """Return errors of the same colour from innovations drawn again in blocks."""
    from scipy.signal import lfilter

    white = metric.whitened(errors)
    n = white.shape[0]
    starts = rng.integers(0, max(n - BLOCK_ROWS, 1), size=n // BLOCK_ROWS + 1)
    rows = (starts[:, None] + np.arange(BLOCK_ROWS)).ravel()[:n] % n
    signs = np.repeat(rng.choice([-1.0, 1.0], size=starts.size), BLOCK_ROWS)[:n]
    out = np.empty_like(errors)
    for j, (sigma, ar) in enumerate(zip(metric.sigma, metric.ar, strict=True)):
        drawn = sigma * white[rows, j] * signs
        out[:, j] = lfilter([1.0], np.concatenate([[1.0], -ar]), drawn)
    return out
