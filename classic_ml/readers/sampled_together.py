"""Channels that state their own start and step: were they sampled together, and at the rate?"""

from __future__ import annotations

from collections.abc import Collection, Sequence

from classic_ml.readers.raw_table import RawFile, Sampling
from classic_ml.readers.test_description import TestDescription
from surge_core.errors import InputError

__all__ = ["check_rate", "check_sampled_together", "sampled_apart"]

# A start is stated to a microsecond; a skew of a hundredth of a step shows in no result.
SAME_START = 0.01
# Of one step that was computed twice.
SAME_STEP = 1e-9
# As of a clock that is read.
RATE_TOLERANCE = 1e-3
# LabVIEW writes this step where nobody has set one.
UNSET_STEP_S = 1.0


def check_sampled_together(stored: RawFile, names: Sequence[str]) -> None:
    """Refuse channels of which the file says that they start or step otherwise than another.

    Parameters
    ----------
    stored : RawFile
        The file.
    names : sequence of str
        Columns that are read.

    Raises
    ------
    InputError
        Naming two of them, and by how much they differ.
    """
    fault = sampled_apart(stored, names)
    if fault is not None:
        raise fault


def sampled_apart(stored: RawFile, names: Sequence[str]) -> InputError | None:
    """Return what is wrong where columns were not sampled together; None where they were.

    Parameters
    ----------
    stored, names
        As for :func:`check_sampled_together`.
    """
    stated = [(name, stored.sampled[name]) for name in names if name in stored.sampled]
    for name, sampling in stated[1:]:
        other, first = stated[0]
        differing = _difference(sampling, first)
        if differing:
            more = sum(bool(_difference(s, first)) for _, s in stated) - 1
            return InputError(
                f"{stored.source}: channels {other} and {name}",
                expected="one start and one wf_increment for all channels that are read",
                found=f"that the second {differing}"
                + (f" (and {more} more that differ)" * (more > 0)),
                remedy="resample them to one clock, or correct the properties that are wrong",
            )
    return None


def check_rate(stored: RawFile, names: Collection[str], test: TestDescription) -> None:
    """Refuse channels whose stated step is not that of the rate from which a clock is made.

    Parameters
    ----------
    stored : RawFile
        The file.
    names : collection of str
        Columns that are read.
    test : TestDescription
        The description, with the rate.

    Raises
    ------
    InputError
        Naming the channel and both rates.
    """
    for name in stored.names:
        sampling = stored.sampled.get(name) if name in names else None
        if sampling is None or sampling.step_s == UNSET_STEP_S:
            continue
        if abs(sampling.step_s * test.sample_rate_hz - 1.0) > RATE_TOLERANCE:
            rate_hz = 1.0 / sampling.step_s
            raise InputError(
                f"{stored.source}: channel {name}",
                expected=f"{test.sample_rate_hz:g} samples a second, as {test.source} [test] "
                "sample_rate_hz says",
                found=f"{rate_hz:g} by its wf_increment",
                remedy=f"correct the one that is wrong: sample_rate_hz = {rate_hz:g}, or the "
                "property",
            )


def _difference(sampling: Sampling, first: Sampling) -> str:
    """Return in words how a channel was sampled otherwise than another; empty where it was not."""
    if abs(sampling.step_s / first.step_s - 1.0) > SAME_STEP:
        return f"steps by {sampling.step_s:g} s where the first steps by {first.step_s:g} s"
    later_s = sampling.later_s(first)
    if abs(later_s) > SAME_START * first.step_s:
        return f"starts {abs(later_s):g} s {'later' if later_s > 0.0 else 'earlier'}"
    return ""
