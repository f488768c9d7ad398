"""Surge and stall as they happen, from the causal operating points.

Surge is detected by its one certain sign: the flow at plane 25 runs backwards. A cycle is a fall
and a rise of P31 by at least 15 % of its mean, as in the reduction, and is counted when the rise
that follows its trough has come that far.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pandas as pd

from classic_ml.cycles import DEEP_SHARE, LEAST_SWING
from classic_ml.flow import LBM_KG
from classic_ml.io import TestDescription
from classic_ml.segments import SHORTEST_S
from comparisons.live.operating_point import low_pass_delay_s

# The filtered flow stays below zero for tens of milliseconds in a surge, for one or two in noise
# about a flow near zero.
REVERSED_S = 0.003
# The period is the median of so many cycles: one freak cycle does not move it.
PERIODS = 9
# Without a reversal for so many periods, and at least so long, the surge is over.
QUIET_PERIODS = 3.0
QUIET_S = 1.0
# P31 sinks by a third within a test: its mean for the swing is that of about a second.
MEAN_S = 1.0


@dataclass(frozen=True)
class Sighting:
    """Something that was detected.

    Parameters
    ----------
    kind : {"surge", "cycle", "stall", "recovered"}
        What.
    at_s : float
        When it happened, on the facility clock, the delay of the low-pass taken off.
    seen_s : float
        Clock of the row that showed it.
    number : int
        Of a cycle: how many there were, this one included.
    period_s : float
        Of a cycle: median period of the last ones.
    """

    kind: str
    at_s: float
    seen_s: float
    number: int = 0
    period_s: float = float("nan")


class CycleCounter:
    """Find the troughs of P31 between rises that are deep enough.

    Parameters
    ----------
    rate_hz : float
        Sample rate.
    """

    def __init__(self, rate_hz: float) -> None:
        self._share = 1.0 / (MEAN_S * rate_hz)
        self._mean_Pa = 0.0
        self._rising = False
        self._extreme_Pa, self._extreme_s = np.inf, 0.0
        self._trough_Pa = np.inf
        self._rises: deque[float] = deque(maxlen=PERIODS)
        self._deep_Pa = 0.0
        self._troughs_s: deque[float] = deque(maxlen=PERIODS + 1)

    @property
    def period_s(self) -> float:
        """Median distance of the last troughs; NaN before there are two."""
        if len(self._troughs_s) < 2:
            return float("nan")
        return float(np.median([after - before for before, after in pairwise(self._troughs_s)]))

    def take(self, time_s: float, pressure_Pa: float) -> float | None:
        """Take the next row, and return the clock of a trough that it has made certain.

        Parameters
        ----------
        time_s, pressure_Pa : float
            Clock and P31.
        """
        self._mean_Pa += (pressure_Pa - self._mean_Pa) * (self._share if self._mean_Pa else 1.0)
        if (pressure_Pa >= self._extreme_Pa) == self._rising:
            self._extreme_Pa, self._extreme_s = pressure_Pa, time_s
            return None
        if abs(pressure_Pa - self._extreme_Pa) < max(LEAST_SWING * self._mean_Pa, self._deep_Pa):
            return None
        trough_s = None if self._rising else self._extreme_s
        if trough_s is None:
            self._rises.append(self._extreme_Pa - self._trough_Pa)
            self._deep_Pa = DEEP_SHARE * float(np.median(self._rises))
        else:
            self._trough_Pa = self._extreme_Pa
            self._troughs_s.append(trough_s)
        self._rising = not self._rising
        self._extreme_Pa, self._extreme_s = pressure_Pa, time_s
        return trough_s


class SurgeDetector:
    """Detect surge, its cycles and the stall state.

    Parameters
    ----------
    test : TestDescription
        For the threshold between in-stall and unstalled.

    Attributes
    ----------
    surging, in_stall : bool
        The state now; in stall before a surge only where the test states a threshold.
    n_cycles : int
        Complete cycles, from trough to trough of P31.
    """

    def __init__(self, test: TestDescription) -> None:
        self._rate_hz = test.sample_rate_hz
        threshold = test.threshold_lbm_s
        stated = isinstance(threshold, int | float)
        self._threshold_kg_s = float(threshold or 0.0) * LBM_KG if stated else -np.inf
        self._late_s = low_pass_delay_s(self._rate_hz)
        self._least_reversed = max(1, round(REVERSED_S * self._rate_hz))
        self._least_stalled = max(1, round(SHORTEST_S * self._rate_hz))
        self._last_reversal_s = -np.inf
        self.surging = self.in_stall = False
        self.n_cycles = 0
        self.restart()

    def restart(self) -> None:
        """Begin again behind a gap; what was counted stays."""
        self._reversed_rows = self._stalled_rows = 0
        self._counter = CycleCounter(self._rate_hz)

    @property
    def period_s(self) -> float:
        """Median period of the last cycles; NaN before there is one."""
        return self._counter.period_s

    def take(self, points: pd.DataFrame) -> list[Sighting]:
        """Return what the next operating points show; rows without one are passed over.

        Parameters
        ----------
        points : DataFrame
            Rows that follow on those before, as of `points_of`.
        """
        rows = points[["time_s", "Wc25_kg_s", "P31_Pa"]].dropna(subset="Wc25_kg_s")
        return [sighting for row in rows.to_numpy().tolist() for sighting in self._row(*row)]

    def _row(self, time_s: float, flow_kg_s: float, pressure_Pa: float) -> list[Sighting]:
        seen = self._surge(time_s, flow_kg_s)
        if self.surging:
            seen += self._cycle(time_s, pressure_Pa)
        return seen + self._stall(time_s, flow_kg_s)

    def _surge(self, time_s: float, flow_kg_s: float) -> list[Sighting]:
        self._reversed_rows = self._reversed_rows + 1 if flow_kg_s < 0.0 else 0
        if self._reversed_rows >= self._least_reversed:
            self._last_reversal_s = time_s
            if not self.surging:
                self.surging, self._counter = True, CycleCounter(self._rate_hz)
                return [self._begun("surge", time_s, self._reversed_rows)]
        elif self.surging and time_s - self._last_reversal_s > np.fmax(
            QUIET_S, QUIET_PERIODS * self.period_s
        ):
            self.surging = False
            return [Sighting("recovered", self._last_reversal_s - self._late_s, time_s)]
        return []

    def _cycle(self, time_s: float, pressure_Pa: float) -> list[Sighting]:
        trough_s = self._counter.take(time_s, pressure_Pa)
        if trough_s is None or np.isnan(self.period_s):
            return []
        self.n_cycles += 1
        return [Sighting("cycle", trough_s - self._late_s, time_s, self.n_cycles, self.period_s)]

    def _stall(self, time_s: float, flow_kg_s: float) -> list[Sighting]:
        self._stalled_rows = self._stalled_rows + 1 if flow_kg_s < self._threshold_kg_s else 0
        self.in_stall = self._stalled_rows >= self._least_stalled
        if self._stalled_rows == self._least_stalled and not self.surging:
            return [self._begun("stall", time_s, self._stalled_rows)]
        return []

    def _begun(self, kind: str, time_s: float, n_rows: int) -> Sighting:
        return Sighting(kind, time_s - (n_rows - 1) / self._rate_hz - self._late_s, time_s)
