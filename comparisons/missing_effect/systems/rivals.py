"""Is a close rival rejected? Cox's test: what would be seen if the rival were the truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from comparisons.missing_effect.systems.bench import Bench
from comparisons.missing_effect.systems.fit import Fit, fit_runs
from comparisons.missing_effect.systems.metric import Metric
from comparisons.missing_effect.systems.structure import Run
from surge_core.types import FloatArray

# Repeats, whose gaps give a normal tail, and steps of each fit: both begin near their ends.
REPEATS, STEPS = 20, 3
# Innovations are drawn in blocks, with either sign.
BLOCK_ROWS = 20


def rejected(name: Fit, rival: Fit, lane: Bench, metric: Metric, rng: np.random.Generator) -> float:
    """Return the chance of so large an advantage of a name if its rival were the truth.

    The rival is simulated with its own innovations drawn again, both are fitted to it, and the
    advantage is compared with the one on the record (Cox 1962).
    """
    from scipy.stats import norm

    def again(f: Fit, runs: Sequence[Run], starts: Sequence[FloatArray]) -> Fit:
        return fit_runs(f.structure, runs, metric, f.theta, starts, f.scale, most=STEPS)

    name, rival = (again(f, lane.train, lane.fit.starts) for f in (name, rival))
    found, gaps = rival.cost - name.cost, []
    for _ in range(REPEATS if not rival.failed else 0):
        drawn = [
            replace(run, outputs=path.outputs + _drawn(errors, metric, rng))
            for run, path, errors in zip(lane.train, rival.paths, rival.errors, strict=True)
        ]
        one, two = (again(f, drawn, f.starts) for f in (name, rival))
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
