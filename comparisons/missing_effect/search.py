"""The search: which effects a model lacks, one after the other or two at a time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from comparisons.missing_effect.candidates import Bench, Candidate
from comparisons.missing_effect.effect import Effect
from comparisons.missing_effect.evidence import alias_rows, paired_z
from comparisons.missing_effect.fit import Fit, fit_structure
from comparisons.missing_effect.lag_data import LATER, OTHER, TRAIN
from comparisons.missing_effect.noise import NoiseModel
from comparisons.missing_effect.probes import Probe
from surge_core.types import FloatArray

# The chance below which what a model leaves is called structure, and not chance.
LEFTOVER_P = 1e-4
# A name is firm only while no test of what it leaves comes below this; tests of one term at a
# time are weaker.
DOUBTFUL_P = 1e-3
DOUBTFUL_ALONE_P = 5e-3
LARGEST_UNEVENNESS = 5.0
# An open term takes the place of a name only when it is better by this much.
UNNAMED_GAP = 6.0
UNNAMED_Z = 3.0
PAIR_GAP = 6.0
PAIR_Z = 3.0
PAIR_HEADS = 3
PAIR_TAILS = 3
MOST_OPEN_FITS = 3
# An effect whose start is searched this widely is tested apart from the others.
MANY_TRIALS = 20.0


@dataclass(frozen=True)
class Leftover:
    """What a score test of all open terms and all effects finds in a model's errors.

    Parameters
    ----------
    gain : float
        Log-units that they would win together, or the best of them where each is tested alone.
    degrees : int
        Columns.
    p_value : float
        Of that gain, or of a ripple or a branch where they say more.
    alone : bool
        Whether each was tested alone.
    unevenness : float
        By how many standard errors the rows that were held out are left noisier than the others.
    """

    gain: float
    degrees: int
    p_value: float
    alone: bool = False
    unevenness: float = 0.0

    @property
    def structured(self) -> bool:
        """Whether the errors hold more than noise that the model's inputs explain."""
        return self.p_value < LEFTOVER_P

    @property
    def doubtful(self) -> bool:
        """Whether a name that leaves this is provisional: a stricter bound, and even errors."""
        bound = DOUBTFUL_ALONE_P if self.alone else DOUBTFUL_P
        return self.p_value < bound or self.unevenness > LARGEST_UNEVENNESS


@dataclass(frozen=True)
class Round:
    """One round of the search.

    Parameters
    ----------
    bench : Bench
        The model of the round and the metric.
    noise : NoiseModel
        Of the best candidate's errors.
    candidates : tuple of Candidate
        Names, best first.
    unnamed : tuple of Candidate
        Open terms, best first.
    pairs : tuple of Candidate
        Pairs that were tried, best first.
    winner : Candidate or None
        What is added; None where nothing is accepted.
    leftover : Leftover
        What the winner, or the model itself, leaves.
    """

    bench: Bench
    noise: NoiseModel
    candidates: tuple[Candidate, ...]
    unnamed: tuple[Candidate, ...]
    pairs: tuple[Candidate, ...]
    winner: Candidate | None
    leftover: Leftover


def search_round(bench: Bench, effects: Sequence[Effect], open_terms: Sequence[Effect]) -> Round:
    """Try everything that may be added to the model on the bench.

    Parameters
    ----------
    bench : Bench
        Model, records, metric.
    effects : sequence of Effect
        Names that the records can carry and that the model has not.
    open_terms : sequence of Effect
        Terms without a name.
    """
    prober = bench.prober()
    named = bench.promising([prober.probe(effect) for effect in effects])
    unnamed = bench.promising([prober.probe(term) for term in open_terms], MOST_OPEN_FITS)
    fits = [(probe, bench.fitted(probe)) for probe in (*named, *unnamed)]
    bench, noise, fits = _in_own_metric(bench, fits, effects)
    base = bench.errors(bench.fit)
    tried = bench.ranked([bench.weighed(fit, [probe.effect], base) for probe, fit in fits])
    names = tuple(c for c in tried if not c.unnamed)
    terms = tuple(c for c in tried if c.unnamed)
    winner = _winner(bench, names, terms)
    left = leftover_of(bench, winner, effects, open_terms)
    pairs: tuple[Candidate, ...] = ()
    if left.structured and (names or terms):
        pairs = bench.ranked(_pairs(bench, names, effects, base))
        best = next((pair for pair in pairs if pair.evidence.accepted), None)
        if best is not None and _better(bench, best, winner, names):
            after = leftover_of(bench, best, effects, open_terms)
            if after.gain < 0.5 * left.gain or not after.structured:
                winner, left = best, after
    return Round(bench, noise, names, terms, pairs, winner, left)


def _in_own_metric(
    bench: Bench, fits: list[tuple[Probe, Fit]], effects: Sequence[Effect]
) -> tuple[Bench, NoiseModel, list[tuple[Probe, Fit]]]:
    """Take the noise from the best candidate's errors, and fit again where it is not white.

    From the base's errors it would whiten the very effect away.
    """
    n = bench.train.n_samples
    best = min(
        [fit for _, fit in fits] + [bench.fit],
        key=lambda fit: fit.cost + 0.5 * fit.n_parameters * np.log(n),
    )
    noise = bench.noise(_with_ripple(bench, best, effects))
    moved = bench.in_metric_of(best, noise)
    was_white = bench.metric.ar.size == 0 and bench.metric.flow is None
    if not noise.coloured and not noise.heavy_tailed and was_white:
        return moved, noise, fits
    again = []
    for probe, fit in fits:
        own = [fit.nonlinear[bench.fit.nonlinear.size :]]
        again.append((probe, moved.fitted(replace(probe, starts=tuple(own)))))
    return moved, noise, again


def _with_ripple(bench: Bench, best: Fit, effects: Sequence[Effect]) -> Fit:
    """Return the best fit with a ripple beside it where its errors hold one.

    An autoregression would take a line of the spectrum for the colour of the noise.
    """
    ripple = next((effect for effect in effects if effect.episodes), None)
    if ripple is None or any(e.episodes or e.unnamed for e in best.structure.effects):
        return best
    moved = replace(bench, fit=best)
    probe = moved.prober().probe(ripple)
    if probe.chance < LEFTOVER_P and probe.gain > probe.degrees * np.log(bench.train.n_samples):
        return moved.fitted(probe)
    return best


def _winner(
    bench: Bench, names: Sequence[Candidate], terms: Sequence[Candidate]
) -> Candidate | None:
    name = next((c for c in names if c.evidence.accepted), None)
    term = next((c for c in terms if c.evidence.accepted), None)
    if term is None or name is None:
        return name or term
    clear = term.rank - name.rank > UNNAMED_GAP
    return term if clear and _z_over(bench, term, name) > UNNAMED_Z else name


def _z_over(bench: Bench, one: Candidate, other: Candidate) -> float:
    """Return by how many standard errors one candidate beats another, block by block."""
    if one.whole_errors is None:
        return 0.0
    rival = other.errors if other.whole_errors is None else other.whole_errors
    gain = 0.5 * (rival**2 - one.whole_errors**2)
    return paired_z(gain, bench.rows, TRAIN, LATER, OTHER)


def _better(
    bench: Bench, pair: Candidate, single: Candidate | None, names: Sequence[Candidate]
) -> bool:
    """Tell whether two effects explain clearly more than one, and than each of the two."""
    members = {effect.name for effect in pair.added}
    alone = [c for c in names if c.name in members]
    if any(pair.evidence.score - c.evidence.score < PAIR_GAP for c in alone):
        return False
    if single is None:
        return True
    return pair.rank - single.rank > PAIR_GAP and _z_over(bench, pair, single) > PAIR_Z


def _pairs(
    bench: Bench, names: Sequence[Candidate], effects: Sequence[Effect], base: FloatArray
) -> tuple[Candidate, ...]:
    """Fit the best names together with each second one that its errors ask for."""
    out: dict[frozenset[str], Candidate] = {}
    for head in names[:PAIR_HEADS]:
        first = head.added[0]
        second_bench = replace(bench, fit=head.fit)
        prober = second_bench.prober()
        others = [e for e in effects if e.name != first.name]
        probes = second_bench.promising([prober.probe(e) for e in others], PAIR_TAILS)
        for probe in probes:
            key = frozenset((first.name, probe.effect.name))
            if key in out:
                continue
            fit = second_bench.fitted(probe)
            out[key] = bench.weighed(fit, [first, probe.effect], base)
    return tuple(sorted(out.values(), key=lambda c: -c.evidence.score))


def leftover_of(
    bench: Bench,
    winner: Candidate | None,
    effects: Sequence[Effect],
    open_terms: Sequence[Effect],
) -> Leftover:
    """Test the errors of a model for anything that open terms and effects could still explain.

    Parameters
    ----------
    bench : Bench
        Records and metric.
    winner : Candidate or None
        What was added to the model on the bench.
    effects, open_terms : sequence of Effect
        What may be left.
    """
    every = bench.everywhere()
    if winner is not None:
        whole = winner.whole or every.refitted(winner.fit)
        every = replace(every, fit=whole)
    every = every.with_states()
    prober = every.prober()
    present = set(every.fit.structure.names)
    probes = [
        prober.probe(effect) for effect in (*effects, *open_terms) if effect.name not in present
    ]
    searched = [p for p in probes if p.effect.searched >= MANY_TRIALS and p.degrees]
    few = [p for p in probes if p.effect.searched < MANY_TRIALS and p.columns.shape[1]]
    uneven = unevenness(every, bench.data.part)
    apart = min((p.chance for p in searched), default=1.0)
    if bench.metric.flow is not None and few:
        # Many smooth terms together make up the difference between a noisy φ and a smooth one,
        # which is the noise itself: here each is tested alone.
        best = min(few, key=lambda p: p.chance)
        p_value = min(1.0, len(few) * best.chance, 2.0 * apart)
        return Leftover(best.gain, best.degrees, p_value, True, uneven)
    gain, basis = prober.joint([p.columns for p in few]) if few else (0.0, np.zeros((0, 0)))
    together = _chi2(gain, basis.shape[1])
    return Leftover(gain, basis.shape[1], min(1.0, 2.0 * together, 2.0 * apart), False, uneven)


def _chi2(gain: float, degrees: int) -> float:
    from scipy.stats import chi2

    return float(chi2.sf(2.0 * gain, degrees)) if degrees else 1.0


def unevenness(every: Bench, part: NDArray[np.int8]) -> float:
    """Return by how many standard errors held-out rows are noisier, by a fit to all.

    Parameters
    ----------
    every : Bench
        With all rows fitted.
    part : ndarray of int, shape (n,)
        What was fitted and held out before.
    """
    errors = every.fit.errors(every.data, every.metric)
    valid = every.metric.rows(every.data) > 0.0
    fitted, held = errors[valid & (part == TRAIN)] ** 2, errors[valid & (part != TRAIN)] ** 2
    if min(fitted.size, held.size) < 2:
        return 0.0
    spread = np.hypot(np.std(fitted) / np.sqrt(fitted.size), np.std(held) / np.sqrt(held.size))
    return float((held.mean() - fitted.mean()) / max(spread, 1e-300))


def aliases(
    bench: Bench, winner: Candidate, candidates: Sequence[Candidate], base: FloatArray
) -> tuple[Candidate, ...]:
    """Return the accepted candidates that these rows cannot tell from a winner, it first."""
    others = [
        c
        for c in candidates
        if c.evidence.accepted and c.whole_errors is not None and c.name != winner.name
    ]
    if winner.whole_errors is None:
        return (winner,)
    near = alias_rows(
        bench.rows,
        base,
        [winner.whole_errors, *[c.whole_errors for c in others if c.whole_errors is not None]],
        [winner.rank, *[c.rank for c in others]],
    )
    return (winner, *[c for c, close in zip(others, near[1:], strict=True) if close])


def refitted_without(bench: Bench, effect: Effect) -> Bench:
    """Return the bench with one effect taken out of its model and the rest fitted again.

    Parameters
    ----------
    bench : Bench
        Model, records, metric.
    effect : Effect
        One that the model has.
    """
    structure, nonlinear = bench.fit.structure.without(effect, bench.fit.nonlinear)
    fit = fit_structure(structure, bench.train, bench.train_metric, [nonlinear])
    return replace(bench, fit=fit).with_states()
