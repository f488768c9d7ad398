"""What the steady reading near stall tells of each probe: calibrations that contradict others."""

from __future__ import annotations

import numpy as np

from classic_ml.faults.marks import fault_name
from classic_ml.planes import local_flows
from classic_ml.probe_plane import present_pairs
from classic_ml.readers.test_description import ProbePair, TestDescription
from classic_ml.records import Record
from surge_core.errors import InputError

__all__ = ["check_pairs", "check_steady"]

# On 12 untouched records the end of the reading differs from the rest by 0.07 % at most; a machine
# that is throttled slowly towards its limit drifts by a few per cent.
STEADY = 0.05
# The last part of the reading, which runs into the surge where it was chosen too long.
LAST_SHARE = 0.2
# Hub and tip of a real machine differ near stall, but not by a factor.
FLOW_FACTOR = 2.0
# Pairs at one immersion of the same records differ by 1.5 % at most.
SAME_IMMERSION = 0.1
# Of two pairs that differ nobody knows which one is wrong.
FEWEST_PAIRS = 3


def check_steady(steady: Record, test: TestDescription) -> None:
    """Refuse a near-stall reading that ends in another state than it began.

    Parameters
    ----------
    steady : Record
        The rows near stall, calibrated.
    test : TestDescription
        When they were.

    Raises
    ------
    InputError
        Naming the channel that moves.
    """
    last = slice(round((1.0 - LAST_SHARE) * steady.n_samples), steady.n_samples)
    before = slice(0, last.start)
    moves = {}
    for probe in test.pressures:
        # What is clipped or stuck there is left out when the channels are chosen.
        if fault_name(probe.name) in steady and np.any(steady[fault_name(probe.name)]):
            continue
        values = steady[probe.name]
        moves[probe.name] = float(np.mean(values[last]) / np.mean(values[before]) - 1.0)
    name = max(moves, key=lambda n: abs(moves[n]), default="")
    if name and abs(moves[name]) > STEADY:
        reading = test.near_stall
        raise InputError(
            f"{test.source}: [near_stall]",
            expected=f"a steady part of the record, as the reading of the facility is "
            f"({reading.from_s:g} to {reading.to_s:g} s)",
            found=f"{name} {moves[name]:+.0%} in its last fifth",
            remedy="let it end before the surge begins",
        )


def check_pairs(steady: Record, test: TestDescription) -> tuple[str, ...]:
    """Compare the flow at each pair of a plane near stall with that at the others.

    Parameters
    ----------
    steady : Record
        The rows near stall, matched, without the channels that do not count there.
    test : TestDescription
        Pairs and their calibrations.

    Returns
    -------
    tuple of str
        Flags: pairs that differ from those at their immersion.

    Raises
    ------
    InputError
        Naming a pair of which the flow is another one's by a factor: its calibration is wrong.
    """
    flows = local_flows(steady, test)
    flags: list[str] = []
    for plane in test.areas_m2:
        pairs = present_pairs(steady, test, plane)
        mean = {pair.name: float(np.mean(flows[f"Wc{pair.name}_kg_s"])) for pair in pairs}
        if len(pairs) >= FEWEST_PAIRS:
            for pair in pairs:
                _check_pair(steady, test, pair, mean)
        flags += _differing(pairs, mean)
    return tuple(flags)


def _check_pair(
    steady: Record, test: TestDescription, pair: ProbePair, mean: dict[str, float]
) -> None:
    others = float(np.median([flow for name, flow in mean.items() if name != pair.name]))
    # No forward flow near stall at all is another fault, and told of as such.
    if others <= 0.0 or others < FLOW_FACTOR * mean[pair.name] < FLOW_FACTOR**2 * others:
        return
    raise InputError(
        f"{steady.source}: pair P{pair.name}",
        expected=f"about the corrected flow of the others of plane {pair.forward.plane} near stall "
        f"({others:.3g} kg/s)",
        found=f"{mean[pair.name]:.3g}",
        remedy=f"check the zero and calibrate readings, references and probe slope of "
        f"{pair.forward.name} and {pair.aft.name} in {test.source}",
    )


def _differing(pairs: tuple[ProbePair, ...], mean: dict[str, float]) -> list[str]:
    """Return a flag for each immersion at which the rakes of a plane disagree."""
    flags = []
    for immersion in dict.fromkeys(pair.immersion for pair in pairs):
        flows = {p.name: mean[p.name] for p in pairs if p.immersion == immersion}
        low, high = min(flows, key=flows.__getitem__), max(flows, key=flows.__getitem__)
        if flows[high] > (1.0 + SAME_IMMERSION) * flows[low]:
            flags.append(
                f"near stall the corrected flow is {flows[high]:.3g} kg/s at {high} and "
                f"{flows[low]:.3g} at {low}: check their calibrations"
            )
    return flags
