"""Probes of one place on several rakes: a plugged or exchanged one, a dead thermocouple.

Surge moves all rakes alike, and the stall cells pass each of them: on 46 sound records of four rigs
probes of one plane, immersion and facing move by 0.977 to 1.023 times what the same on another rake
do, and thermocouples of one plane by 0.99 to 1.01, however differently hub and tip move.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations, permutations

import numpy as np
from scipy.ndimage import uniform_filter1d

from classic_ml.description import PressureChannel, TestDescription
from classic_ml.faults.search import alike
from classic_ml.records import Dropped, Record
from surge_core.errors import InputError
from surge_core.types import FloatArray

# Three cycles of the fastest surge that was seen.
SHORTEST_S = 0.25
# A sensitivity that is off by so much is in doubt; by a factor of two a probe has come off.
DOUBTED, REFUSED = np.log(1.08), np.log(2.0)
# Averages over a 40th of a second leave the surge cycle and little of the stall cells, which pass
# the rakes one after the other. What lags by an eighth of a cycle is half its movement apart.
AVERAGE_HZ, APART = 40.0, 0.5
# Where the noise from row to row is more than a third of the largest movement at a place, unequal
# noise alone can move it by a twentieth.
NOISE_SHARE = 1.0 / 3.0
# Of two probes at different immersions either may be wrong.
FEWEST = 3
# Mean pressures of two rakes at one immersion are within 0.4 % of each other on those records once
# they are matched near stall; a zero that drifts by 1 % of P25 moves φ by 0.04.
LEVELS_APART = 0.01
# Exchanged probes go with each other's likes so many times as closely as with their own.
CLOSER = 4.0
# A junction with less than a tenth of another's movement is not in the gas.
STILL = 0.1


def compare_likes(
    record: Record, test: TestDescription, window: slice, left_out: Mapping[str, Dropped]
) -> tuple[dict[str, Dropped], list[str]]:
    """Return what does not move as its like on other rakes: to be left out, and the doubts.

    The record is calibrated and matched. It is refused where two probes are exchanged on a rake, or
    differ by more than a factor of two and nothing shows which of them is wrong. On one rake a
    probe is left out that moves by half or by twice as much as those of three or more immersions.
    """
    if window.stop - window.start < SHORTEST_S * record.sample_rate_hz:
        return {}, []
    bad, doubts = _still_thermocouples(record, test, window, left_out), list[str]()
    for plane in test.areas_m2:
        probes = {p.name: p for p in test.pressures if p.plane == plane and p.name not in left_out}
        sound = {n: record[n][window][record.marks(n)[window] == 0] for n in probes}
        places = alike(probes.values(), "immersion", "facing")
        drifted = _drifted_apart(places, sound)
        doubts += drifted
        for place in places:
            most = max((sound[name] for name in place), key=np.std)
            if np.std(np.diff(most, 2)) > np.sqrt(6.0) * NOISE_SHARE * np.std(most):
                places = [other for other in places if other != place]
        mates = {n: pair.aft.name for pair in test.pairs(plane) for n in [pair.forward.name]}
        mates |= {aft: forward for forward, aft in mates.items()}
        moves = {name: float(np.log(np.std(sound[name]))) for place in places for name in place}
        _refuse_exchanged(record, probes, places, mates, moves)
        spreads = [float(np.ptp([moves[name] for name in place])) for place in places]
        for k, place in enumerate(places):
            # What the rakes differ by elsewhere in the plane is the gas.
            usual = float(np.median([*spreads[:k], *spreads[k + 1 :]] or [0.0]))
            for name in place:
                likes = [other for other in place if other != name]
                right, known = _right(probes, likes, mates, moves, name)
                off, times = abs(moves[name] - right) - usual, f"{np.exp(moves[name] - right):.2f}"
                # What lags moves less; a sensitivity alone may be wrong either way.
                lags = known and moves[name] < right and _apart(record, window, name, likes) > APART
                did = f"{times} times as much as {' and '.join(likes) or 'the probes beside it'}"
                if off > (DOUBTED if lags else REFUSED):
                    if not known:
                        raise InputError(
                            f"{record.source}: channel {name}",
                            expected=f"about the movement of its like {likes[0]}",
                            found=f"{times} times that",
                            remedy="leave the pair of the one that is wrong out of test.toml",
                        )
                    why = f"moving {did} in the window"
                    bad[name] = Dropped(name, window.stop - window.start, why)
                elif likes and off > DOUBTED and not any(name in text for text in drifted):
                    whose = "its" if known else "their"
                    doubt = f"{name} moves {did}: check {whose} zero and calibrate readings"
                    doubts += [doubt] if known or name < likes[0] else []
    return bad, doubts


def _apart(record: Record, window: slice, name: str, likes: Sequence[str]) -> float:
    """Return the slow difference of a probe from its likes over the movement of these."""
    if not likes:
        return 0.0
    width = max(1, round(record.sample_rate_hz / AVERAGE_HZ))
    beside = np.median([record[like][window] for like in likes], axis=0)
    off = uniform_filter1d(record[name][window] - beside, width)
    return float(np.std(off) / np.std(beside))


def _right(
    probes: Mapping[str, PressureChannel],
    likes: Sequence[str],
    mates: Mapping[str, str],
    moves: Mapping[str, float],
    name: str,
) -> tuple[float, bool]:
    """Return the movement that a probe should have, and whether no like is in doubt with it.

    Of two that differ the one is right that moves against its mate as probes do at the other
    immersions: within half of what they differ, and nearer by as much.
    """
    facing = [other for other in moves if probes[other].facing == probes[name].facing]
    if not likes:
        beside = [moves[other] for other in facing]
        return (float(np.median(beside)) if len(beside) >= FEWEST else moves[name]), True
    if len(likes) > 1:
        return float(np.median([moves[other] for other in (name, *likes)])), True
    pair, others = (name, likes[0]), [n for n in facing if n not in (name, likes[0])]
    pattern = [moves[n] - moves[mates[n]] for n in others if mates[n] in moves]
    if not pattern or not {mates[n] for n in pair} <= moves.keys():
        return moves[likes[0]], False
    misses = {abs(moves[n] - moves[mates[n]] - np.median(pattern)): moves[n] for n in pair}
    (near, far), differ = (min(misses), max(misses)), abs(moves[name] - moves[likes[0]])
    known = bool(max(near, near + differ - far) < 0.5 * differ)
    return (misses[near] if known else moves[likes[0]]), known


def _refuse_exchanged(
    record: Record,
    probes: Mapping[str, PressureChannel],
    places: Sequence[Sequence[str]],
    mates: Mapping[str, str],
    moves: Mapping[str, float],
) -> None:
    """Refuse probes of two immersions of which each moves as the other does on another rake."""
    for one, other in combinations(places, 2):
        if probes[one[0]].facing != probes[other[0]].facing:
            continue
        ones, others = ({probes[name].rake: name for name in place} for place in (one, other))
        for rake, beside in permutations(sorted(ones.keys() & others.keys()), 2):
            here, there = [ones[rake], others[rake]], [ones[beside], others[beside]]
            own = min(abs(moves[a] - moves[b]) for a, b in zip(here, there, strict=True))
            crossed = max(abs(moves[a] - moves[b]) for a, b in zip(here, there[::-1], strict=True))
            # The order that the mates show on both rakes is the right one.
            known = [[moves.get(mates[name], np.nan) for name in two] for two in (here, there)]
            orders = {a > b for a, b in known if np.isfinite(a - b)}
            if own > max(DOUBTED, CLOSER * crossed) and orders != {moves[here[0]] > moves[here[1]]}:
                where = f"rake {rake}" if len(orders) == 1 else f"rake {rake} or {beside}"
                raise InputError(
                    f"{record.source}: channels {here[0]} and {here[1]}",
                    expected=f"each to move as its like on rake {beside}",
                    found="each moving as the like of the other does there",
                    remedy=f"exchange their columns if {probes[here[0]].immersion} and "
                    f"{probes[here[1]].immersion} are exchanged on {where}",
                )


def _drifted_apart(places: Sequence[Sequence[str]], sound: Mapping[str, FloatArray]) -> list[str]:
    """Return probes of one place that agree near stall and no longer in the surge cycles."""
    found = []
    for place in places:
        means = {name: float(np.mean(sound[name])) for name in place}
        low, high = min(means, key=means.__getitem__), max(means, key=means.__getitem__)
        apart = means[high] / means[low] - 1.0
        if apart > LEVELS_APART:
            found.append(
                f"{high} is {apart:.1%} above {low} in the window, though both were matched near "
                "stall: has the zero of one drifted, or is its sensitivity wrong?"
            )
    return found


def _still_thermocouples(
    record: Record, test: TestDescription, window: slice, left_out: Mapping[str, Dropped]
) -> dict[str, Dropped]:
    """Return the thermocouples that stay at near stall while those beside them leave."""
    still = {}
    for plane in test.areas_m2:
        names = [couple.name for couple in test.thermocouples(plane) if couple.name not in left_out]
        level_K = test.near_stall.temperature_K(plane)
        left_K = {n: float(np.sqrt(np.mean((record[n][window] - level_K) ** 2))) for n in names}
        for name in names:
            beside_K = float(np.median([left_K[other] for other in names if other != name] or [0]))
            if left_K[name] < STILL * beside_K:
                why = f"within {left_K[name]:.2g} K of near stall, which others leave by "
                still[name] = Dropped(name, window.stop - window.start, f"{why}{beside_K:.3g} K")
    return still
