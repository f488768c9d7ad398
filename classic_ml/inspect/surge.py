"""Where in a long record the machine surges, from the channels alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from surge_core.types import FloatArray

__all__ = ["SurgeSearch"]

# A surge cycle lasts from a tenth of a second to some seconds: sections in which it shows, and
# quiet ones between two cycles that do not end it.
SECTION_S, BRIDGED_S = 0.25, 3.0
# Before stall the noise of a probe is a few tenths of a per cent, a surge swings it by tens of per
# cent: sections that move so many times as much as the quiet ones are a surge's.
LEAST_RATIO = 10.0
# The share of sections that are as quiet as the machine is before it surges.
QUIET_SHARE = 0.01


class SurgeSearch:
    """The search for the part of a record in which its channels swing, block by block."""

    def __init__(self) -> None:
        self._starts: list[FloatArray] = []
        self._spreads: list[FloatArray] = []
        self._end_s = np.nan

    def add(self, time_s: FloatArray, step_s: float, columns: Sequence[FloatArray]) -> None:
        """Take the next rows into account.

        Parameters
        ----------
        time_s : ndarray of shape (n_rows,)
            Their clock.
        step_s : float
            Its usual step.
        columns : sequence of ndarray of shape (n_rows,)
            The channels.
        """
        rows = max(2, round(SECTION_S / step_s)) if step_s > 0.0 else 0
        n_sections = time_s.size // rows if rows else 0
        if not n_sections or not columns:
            return
        whole = n_sections * rows
        self._starts.append(time_s[:whole:rows])
        # A reading that is no number makes the spread of its section none.
        with np.errstate(invalid="ignore", over="ignore"):
            spreads = [np.std(c[:whole].reshape(-1, rows), axis=1) for c in columns]
        self._spreads.append(np.stack(spreads, axis=1))
        self._end_s = float(time_s[-1])

    def window_s(self) -> tuple[float, float] | None:
        """Return from when to when the longest surge lasts; None where no part stands out.

        The swing of a section is the median over the channels of their standard deviation in it,
        each beside that of the same channel in the quiet sections.
        """
        if not self._spreads:
            return None
        starts_s, spreads = np.concatenate(self._starts), np.concatenate(self._spreads)
        spreads = spreads[:, np.isfinite(spreads).all(axis=0)]
        if not spreads.size or not np.isfinite(starts_s).all():
            return None
        quiet = np.quantile(spreads, QUIET_SHARE, axis=0, method="lower")
        # A channel that stands still in its quiet sections is no measure of the others.
        moving = quiet > 0.0
        if not moving.any():
            return None
        swing = np.median(spreads[:, moving] / quiet[moving], axis=1)
        lively = np.flatnonzero(swing > LEAST_RATIO)
        if not lively.size:
            return None
        apart = np.flatnonzero(np.diff(starts_s[lively]) > BRIDGED_S) + 1
        longest = max(np.split(lively, apart), key=len)
        from_s = float(starts_s[max(0, longest[0] - 1)])
        behind = longest[-1] + 2
        return from_s, float(starts_s[behind]) if behind < starts_s.size else self._end_s
