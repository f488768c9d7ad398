"""When a name is firm, and what a model leaves: what speaks against an answer."""

from __future__ import annotations

from collections.abc import Collection, Hashable, Sequence
from dataclasses import replace

import numpy as np

from comparisons.missing_effect.effect import FittedParameter
from comparisons.missing_effect.nulls import (
    COLOURED,
    LEAST_P,
    SURROGATES,
    Leftover,
    foretold,
    foretold_late,
    newly_foretold,
)
from comparisons.missing_effect.quantities import plain_name
from comparisons.missing_effect.runs import CheckRun
from comparisons.missing_effect.search import RIVALLED
from comparisons.missing_effect.systems.bench import Bench
from comparisons.missing_effect.systems.catalogue import SYSTEM_CATALOGUE
from comparisons.missing_effect.systems.fit import Fit, settled
from comparisons.missing_effect.systems.metric import metric_of
from comparisons.missing_effect.systems.model import Model
from comparisons.missing_effect.systems.places import (
    LATE,
    LIMITS,
    Placed,
    SystemEffect,
    label_of,
    signal_names,
)
from comparisons.missing_effect.systems.records import Records, rows_together
from comparisons.missing_effect.systems.roles import feeds_through, measured_as
from comparisons.missing_effect.systems.score import Prober, placed_effects
from comparisons.missing_effect.systems.shapes import Kind, Map, Term
from comparisons.missing_effect.systems.system import ModelCandidate, ModelRound
from surge_core.types import FloatArray

# Effects that are another one with something more, whether or not that other one competes; a dead
# zone without a gap is a straight line.
REFINED = frozenset(name for effect in SYSTEM_CATALOGUE for name in effect.simple_form_of) | {
    "dead_zone"
}
# Their first number is nothing where they are: a lag of 230 ± 100 ms was firm.
FROM_NOTHING = frozenset({"further_lag", "backlash", "dead_zone"})
# What a firm name needs: so many standard errors, held-out rows that gain at least this share of
# what fitted ones gain each, and no rival elsewhere that the record does not reject at this
# chance.
FIRM_ERRORS, LEAST_HELD_OUT_RATE, REJECTED = 3.0, 0.2, 0.01
_NOT_REJECTED = "the record does not reject it"
# A firm name leaves less than this share of an error that was more than so many times the noise.
MOST_LEFT, BEYOND_NOISE = 0.5, 2.0
# What stays of the squared error where a name leaves next to nothing: 0.0004 on the Silverbox, 0.05
# where a name was false.
NEXT_TO_NOTHING = 0.01
# What stays of the squared error, over what a rival explains less, below which it is rejected: 0.01
# on the Silverbox, 0.2 where a spilling tank took other names.
LEAST_ARREARS = 0.1
# A firm name closes this share of a gap that is clear of the noise: a sensor that samples and holds
# was a lag that closed 6 % of it.
LEAST_CLOSED, CLEAR_OF_NOISE = 0.25, 1.5
# A signal hardly changes its sign where |Σ x|x|| is at least this share of Σ x².
ALIKE = 0.9
# A signal is said to be followed where chance does as well this seldom.
FOLLOWED_P = 0.05
# A term without a name that wins this share more on the rows fitted says that more is there.
OUTFITTED_SHARE = 0.5


def doubts_of(
    step: ModelRound,
    placed: Placed,
    numbers: Sequence[FittedParameter],
    checks: Sequence[CheckRun],
    model: Model,
    left: Leftover,
    errors: Sequence[FloatArray],
    *,
    alone: bool,
) -> tuple[str, ...]:
    """Return why a name is not firm, or a term not to be relied on; empty where it is.

    ``errors`` are the rms error of each output on the rows fitted without and with what was
    found, and what is new in each sample of it; ``alone`` is whether nothing else was found.
    """
    winner = step.winner
    assert winner is not None
    out = []
    amplitude = bool(numbers) and (placed.effect.linear or placed.name in FROM_NOTHING)
    if amplitude and not np.isfinite(numbers[0].stderr):
        out.append(f"{numbers[0].name} is not fixed by these records")
    elif amplitude and abs(numbers[0].value) < FIRM_ERRORS * numbers[0].stderr:
        size = abs(numbers[0].value) / numbers[0].stderr
        out.append(f"{numbers[0].name} is {size:.1f} standard errors from nothing")
    worse = [run for run in checks if np.any(run.worse)]
    by = "it" if alone else "all that was added"
    if worse:
        names = ", ".join(run.name for run in worse)
        out.append(f"the error on {names} got no better by {by}")
    elif checks and not any(np.any(run.after_rms < _known(run.before_rms)) for run in checks):
        out.append(f"the error on no check record got better by {by}")
    if placed.effect.unnamed:
        return tuple(out)
    plain = [c.added[0] for c in step.candidates if c.added[0].is_plain_form_of(placed)]
    refined = bool(plain) or placed.name in REFINED
    unknown = [n.name for n in numbers[1:] if refined and not n.stderr < 0.5 * abs(n.value)]
    if unknown:
        would_do = f": {plain_name(plain[0].label(model))} would do" if plain else ""
        are = "is" if len(unknown) == 1 else "are"
        out.append(f"{' and '.join(unknown)} {are} not known{would_do}")
    before, after, noise = errors
    stays = _left_on(checks, noise)
    if not stays and _more_than_half(before, after, noise):
        stays = ["more than half of the error on the rows fitted stays"]
    out += stays
    if step.rivalled:
        out.append("a term without a name explains more")
    elif _outfitted(step, winner):
        out.append("terms without a name fit the rows fitted better, if not those held out")
    if not winner.evidence.stands:
        out.append("it explains the slow part of the error alone, which a disturbance may be")
    fitted, held = step.rates
    if held < LEAST_HELD_OUT_RATE * fitted:
        much = f"{100.0 * held / fitted:.0f} % as much a row on held-out rows as on those fitted"
        out.append("it makes held-out rows worse" if held < 0.0 else f"it explains {much}")
    rival = step.rival
    # A record rejects a rival where what stands in its place leaves nothing, or too little to make
    # up for the rival's arrears. Else neither is right.
    against = (
        rival is not None
        and left.structured
        and _share_left(checks) > (LEAST_ARREARS * (1.0 - rival.rank / winner.rank))
    )
    if rival is not None and (step.rival_p > REJECTED or against):
        share = 100.0 * rival.rank / winner.rank
        name = plain_name(label_of(rival.added, model))
        rejected = "what is left speaks against both" if against else _NOT_REJECTED
        out.append(f"{name} explains {share:.0f} % as much, and {rejected}")
    return tuple(out)


def _share_left(checks: Sequence[CheckRun]) -> float:
    """Return the largest share of the squared error on check records that stays; 1 without any."""
    shares = [
        float((after / before) ** 2)
        for run in checks
        for after, before in zip(_known(run.after_rms), run.before_rms, strict=True)
        if before > 0.0 and np.isfinite(before)
    ]
    return max(shares, default=1.0)


def proves(checks: Sequence[CheckRun]) -> bool:
    """Tell whether a check record can prove a name beside which something is left.

    Where a fit to the record itself takes most of its error away, the training records gave the
    parameters wrong, and the error says little of the name: 7 and 10 % stayed beside a limit of a
    sensor that there was not, 85 and 90 % beside the names of two measured systems.
    """
    return any(np.any(~(run.refitted_rms < MOST_LEFT * run.after_rms)) for run in checks)


def _more_than_half(before: FloatArray, after: FloatArray, noise: FloatArray) -> bool:
    """Tell whether more than half stays of each error that is more than noise."""
    wide = before > BEYOND_NOISE * noise
    stays = after > np.fmax(MOST_LEFT * before, BEYOND_NOISE * noise)
    return bool(wide.any() and stays[wide].all())


def _left_on(checks: Sequence[CheckRun], noise: FloatArray) -> list[str]:
    """Return what of the error on check records stays; nothing where they are as they should be."""
    before, after, own = (
        np.reshape([getattr(run, name) for run in checks], (-1, noise.size))
        for name in ("before_rms", "after_rms", "refitted_rms")
    )
    # What a fit to the check record takes away differs between the records, and is not missing.
    stays = np.fmin(after, own)
    if _more_than_half(before, stays, noise):
        return ["more than half of the error on check records stays"]
    # Where what is new in each error is large, half of it says little: what is beyond that counts,
    # and larger noise on a check record is none of it.
    floor = np.array(
        [
            np.fmax(noise, metric_of([run.errors(before=False)]).sigma)
            if np.isfinite(run.after_rms).all()
            else noise
            for run in checks
        ]
    ).reshape(before.shape)
    clear = before > CLEAR_OF_NOISE * floor
    gap, left = before**2 - floor**2, stays**2 - floor**2
    if clear.any() and (left > (1.0 - LEAST_CLOSED) * gap)[clear].all():
        return ["it closes less than a quarter of what can be closed on check records"]
    return []


def doubts_beside(
    placed: Placed,
    numbers: Sequence[FittedParameter],
    found: Sequence[Placed],
    left: Leftover,
    model: Model,
    checks: Sequence[CheckRun],
    one_sided: Collection[int],
) -> tuple[str, ...]:
    """Return why a name that fits may be another's: by what was found with it and what is left.

    Where a name is not in the catalogue, the nearest that is takes its place and leaves what its
    shape is not: a term of the same signal, or a second name on the same curve.
    """
    if placed.unnamed:
        return ()
    before = found[: [one.key for one in found].index(placed.key)]
    out = []
    if placed.name == "softening_damping" and numbers[0].value < 0.0:
        # A magneto-rheological damper got one of (-440 ± 130) kN/s.
        out.append("c_s is negative, a gain but for the damping that the model has")
    if any(one.unnamed for one in before):
        out.append("a term without a name was found before it, for which it may stand in")
    for one in (other for other in found if other.key != placed.key):
        label = plain_name(one.label(model))
        if one.unnamed and placed.bends_as(one):
            out.append(f"{label} had to stand beside it, so that its own shape is not sure")
        elif placed.shares_curve_with(one, one_sided) and not _jumps(placed, numbers):
            out.append(f"{label} bends the same curve, and one law that was not tried may do both")
        elif placed.is_late_with(one):
            out.append(f"{label} is late as well, and one lag of a higher order may do both")
        elif _level_of(placed, model) == _level_of(one, model) != "":
            out.append(f"{label} begins at a level of the same signal, and one limit may do both")
    if placed.effect.kind in LATE and left.late:
        # A servo of second order in front of an oscillator got a firm delay on five of five seeds.
        out.append("what is left is late as well, and one lag of a higher order may do both")
    # Where a name leaves next to nothing of the error and other things are missing, their answers
    # lie along those of any place.
    other = left.ratio > COLOURED and _share_left(checks) < NEXT_TO_NOTHING
    if placed.key in left.asked and not other:
        out.append(f"what is left asks for {left.asked[placed.key]} beside it")
    return tuple(out)


def _level_of(placed: Placed, model: Model) -> str:
    """Return the reading or state above a level of which something begins; empty elsewhere."""
    kind, code = placed.effect.kind, placed.effect.code
    if kind == Kind.OUTPUT_MAP and code == Map.UPPER:
        return model.output_names[placed.place.at]
    if kind in LIMITS or (kind == Kind.TERM and code == Term.GAP):
        state = placed.place.signal
        return measured_as(model).get(state, model.state_names[state])
    return ""


def _jumps(placed: Placed, numbers: Sequence[FittedParameter]) -> bool:
    """Tell whether a term jumps where its signal changes sign, which no other law does.

    One whose width is known to be there bends as others do.
    """
    if placed.name not in ("coulomb_friction", "stribeck_friction"):
        return False
    return not any(n.value > FIRM_ERRORS * n.stderr for n in numbers if n.name == "width")


def _known(size: FloatArray) -> FloatArray:
    """Return errors, infinite where a record could not be simulated."""
    return np.nan_to_num(size, nan=np.inf)


def _outfitted(step: ModelRound, winner: ModelCandidate) -> bool:
    """Tell whether something without a name fits the rows fitted far better than the winner."""
    won = winner.evidence.train
    least = won + max(RIVALLED, OUTFITTED_SHARE * won)
    unnamed = [c.evidence for c in step.candidates if c.unnamed]
    return any(e.train > least and not e.at_end for e in unnamed)


def undecided(step: ModelRound) -> str:
    """Return what takes half of the error of an output on rows fitted, if those held out are mute.

    A record that has died out by its last third decides nothing there: a quadratic law of a prey
    was left out at a chance of 1e-138, and nothing was missing.
    """
    least = MOST_LEFT * step.bench.fit.rms
    for c in step.candidates if step.winner is None else ():
        halves = c.onward is not None and bool(np.any(c.onward.rms < least))
        if halves and c.evidence.p_value < LEAST_P and c.evidence.later >= 0.0:
            return plain_name(label_of(c.added, step.bench.records.model))
    return ""


def _acted(signals: FloatArray, model: Model) -> FloatArray:
    """Return states and inputs, the inputs as they were in the row before."""
    n_x = len(model.states)
    return np.column_stack([signals[:, :n_x], np.vstack([signals[:1], signals[:-1]])[:, n_x:]])


def one_sided(fit: Fit, records: Records) -> frozenset[int]:
    """Return which signals hardly change their sign: odd laws of them are even ones as well."""
    every = np.concatenate(fit.signals(records.whole))
    alike = np.abs(np.sum(every * np.abs(every), axis=0)) >= ALIKE * np.sum(every**2, axis=0)
    return frozenset(np.flatnonzero(alike).tolist())


def _mute(fit: Fit, swing: FloatArray) -> str:
    """Return the outputs of which a model explains no more than chance, beside a constant.

    Errors that go together count once: of a robot whose actuation did not reach its height, 0.4 %
    of the squared swing were explained, and "nothing" was missing.
    """
    from scipy.stats import chi2

    out = []
    for j, name in enumerate(fit.structure.model.output_names):
        own = replace(fit, errors=tuple(e[:, [j]] for e in fit.errors))
        rows = sum(np.isfinite(e).sum() for e in own.errors) / rows_together(own)
        gain = float(np.log(max(swing[j] / max(own.rms[0], 1e-300), 1.0) ** 2))
        # What explains half is no chance, however slow the errors are.
        by_chance = chi2.sf(rows * gain, max(fit.n_parameters - 1, 1)) > LEAST_P
        out += [name] * bool(by_chance and gain < np.log(2.0))
    return " and ".join(out)


def leftover_of(
    bench: Bench, catalogue: Sequence[SystemEffect], library: Sequence[SystemEffect]
) -> Leftover:
    """Test what a model leaves for anything that effects, inputs or states still explain."""
    rng = np.random.default_rng(0)
    placed, _ = placed_effects(bench.fit, bench.train, [*catalogue, *library])
    metric = metric_of(bench.fit.errors)
    answers = Prober(bench.fit, bench.train, placed).in_metric(metric)
    flip_p = answers.p_value(SURROGATES)
    later = settled(bench.fit, bench.later, bench.raw)
    model = bench.records.model
    names = signal_names(model)
    fitted, held_out = (
        fit.signals([run.experiment for run in runs])
        for runs, fit in ((bench.train, bench.fit), (bench.later, later))
    )
    # A controller answers an error in its own row: there an input is no cause of it.
    causes = held_out if feeds_through(model) else [_acted(s, model) for s in held_out]
    p, share, follows, new_p, late_p = 1.0, 0.0, "", 1.0, 1.0
    entered = [run.experiment.columns(model.input_names) for run in (*bench.train, *bench.later)]
    ratios = bench.fit.rms / np.asarray(metric.sigma)
    mute = _mute(bench.fit, np.asarray(bench.raw.sigma))
    # An output of which less is explained than left is not shown to need nothing more.
    idle = bool(np.any((ratios > COLOURED) & (2.0 * bench.fit.rms**2 > np.square(bench.raw.sigma))))
    for j in range(len(model.outputs)):
        every = [e[:, j] for e in (*bench.fit.errors, *later.errors)]
        late_p = min(late_p, foretold_late(every, entered, rng))
        if ratios[j] > COLOURED:
            new_p = min(new_p, newly_foretold(every, [*fitted, *held_out]))
        found = foretold([np.nan_to_num(e[:, j]) for e in later.errors], causes, names, rng)
        if found[0] < p or (found[0] == p and found[1] > share):
            p, share, follows = found
    asked: dict[Hashable, str] = {}
    for one in bench.fit.structure.effects:
        # A form with something more is of its own set.
        others = [p for p in placed if one.bends_as(p) and not one.is_plain_form_of(p)]
        there = answers.of(others)
        if not one.unnamed and there.p_value(SURROGATES) < LEAST_P:
            asked[one.key] = plain_name(there.best()[0].placed.label(model))
    p, new_p, late_p = (min(1.0, chance * len(model.outputs)) for chance in (p, new_p, late_p))
    follows = follows if p < FOLLOWED_P else ""
    return Leftover(
        flip_p, p, share, float(np.max(ratios)), follows, asked, new_p, late_p, idle, mute
    )
