"""What a session is put together from."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from classic_ml.description import TestDescription
from comparisons.live.display import Display
from comparisons.live.feed import Feed
from comparisons.live.latency import LatencyMeter
from comparisons.live.rows import Decoder, Tally
from comparisons.live.running_estimate import Estimator
from comparisons.live.state import Event

__all__ = ["SessionParts"]


@dataclass(frozen=True)
class SessionParts:
    """What a session is made of.

    Parameters
    ----------
    test : TestDescription
        The test.
    feed : Feed
        Where the bytes come from.
    decoder : callable
        ``decoder(tally)`` for each new connection.
    raw : path
        File of the raw record.
    estimator : Estimator
        Where the running estimate is made; the session closes it.
    display : Display
        The screens.
    meter : LatencyMeter
        Latencies.
    tell : callable
        ``tell(event)``, for the log.
    timeout_s : float
        End the session when no row has come for so long; infinite to wait for ever.
    """

    test: TestDescription
    feed: Feed
    decoder: Callable[[Tally], Decoder]
    raw: Path
    estimator: Estimator
    display: Display
    meter: LatencyMeter
    tell: Callable[[Event], None]
    timeout_s: float = math.inf
