"""The loop of a series, for `sindy-surge discover SERIES.csv --loop`: text, JSON and report."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from classic_ml.series import CoefficientSeries
from comparisons.page.blocks import Head, Part, Table, Words
from sindy_surge.discover.loop_balance import Balance
from sindy_surge.discover.loop_lag import Branch
from sindy_surge.discover.loops import SurgeLoop, discover_loop
from surge_core.fit_state import FitState
from surge_core.terms import terms_json


def discover_series_loop(series: CoefficientSeries, plenum: np.ndarray | None = None) -> SurgeLoop:
    """Discover the loop of a reduced record, from its unfiltered columns where it has them.

    The rows of its free run count where they are marked; without ``plenum``, of shape (n_rows,),
    the pressure of the plenum is hidden.
    """
    phi, psi_p = series.phi, series.psi_p
    if series.phi_unfiltered is not None and series.psi_p_unfiltered is not None:
        phi, psi_p = series.phi_unfiltered, series.psi_p_unfiltered
    rows = slice(None)
    if series.free_run is not None and np.any(series.free_run > 0):
        inside = np.flatnonzero(series.free_run > 0)
        rows = slice(inside[0], inside[-1] + 1)
    hidden = None if plenum is None else plenum[rows]
    return discover_loop(phi[rows], psi_p[rows], hidden, series.sample_period_s)


def loop_document(loop: SurgeLoop) -> dict[str, Any]:
    """Return the document of `discover --json`, with branches, levels, τ and period."""
    lag, stated = loop.lag, _stated(loop)
    names = ("recover_phi", "stall_phi")
    levels = zip(names, lag.levels, lag.levels_stderr, strict=False)
    equations = [
        {"state": "phi", "terms": _terms(loop.duct)},
        {"state": "plenum", "terms": _terms(loop.plenum)},
    ]
    period_s = loop.period_s
    return {
        "schema": "sindy-surge/discover/1",
        "equations": equations if stated else [],
        "branches": [{"name": b.name, "terms": _terms(b)} for b in lag.branches if stated],
        "levels": {n: {"value": v, "stderr": error} for n, v, error in levels if stated},
        "time_constant_s": {
            "value": lag.time_constant_s if stated else None,
            "stderr": lag.time_constant_stderr_s if stated else None,
        },
        "period_s": {
            "measured": loop.measured_cycles.period_s,
            "simulated": period_s if np.isfinite(period_s) else None,
        },
        "rivals": [],
        "fit_state": {"code": loop.state.code, "advice": loop.state.advice},
    }


def loop_text(loop: SurgeLoop) -> tuple[str, ...]:
    """Return what the terminal shows."""
    fields = (f"{name}: {value}" for name, value in _fields(loop))
    return (f"{loop.state}: {loop.state.advice}", *_equations(loop), *fields)


def loop_parts(loop: SurgeLoop, source: str) -> tuple[Part, ...]:
    """Return the section of the report."""
    rows = tuple(_fields(loop))
    table = Table("What the loop measures", (Head("quantity"), Head("value", prose=True)), rows)
    tone = "" if loop.state.code == "ok" else "caution"
    state = Words(f"{loop.state}: {loop.state.advice}.", *((tone,) if tone else ()))
    words = (Words(line) for line in _equations(loop))
    return (Part(f"Surge loop of {Path(source).name}", (state, *words, table)),)


def _stated(loop: SurgeLoop) -> bool:
    """Return whether the loop runs as the record does: else none of its numbers is stated."""
    return loop.state is FitState.OK


def _equations(loop: SurgeLoop) -> tuple[str, ...]:
    return loop.equations() if _stated(loop) else ()


def _terms(part: Branch | Balance) -> list[dict[str, Any]]:
    return terms_json(part.terms, part.coefficients, part.stderr)


def _fields(loop: SurgeLoop) -> list[tuple[str, str]]:
    period = f"{loop.measured_cycles.period_s:.4f} s measured"
    if not _stated(loop):
        return [("period", period)]
    lag = loop.lag
    tau = f"{1e3 * lag.time_constant_s:.2f} ± {1e3 * lag.time_constant_stderr_s:.2f} ms"
    fields = [("branches", str(loop.n_branches)), ("time constant", tau)]
    names = ("unstalled once φ rises through", "stalled once φ falls through")
    for name, level, error in zip(names, lag.levels, lag.levels_stderr, strict=False):
        fields.append((name, f"{level:.4f} ± {error:.4f}"))
    simulated = f"{loop.period_s:.4f} s" if np.isfinite(loop.period_s) else "none"
    fields.append(("period", f"{period}, {simulated} simulated"))
    fields.append(("plenum pressure", "hidden" if loop.plenum_hidden else "measured"))
    return fields
