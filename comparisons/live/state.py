"""What a session knows at one moment: one list of fields for terminal and page."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from classic_ml.flow import LBM_KG
from comparisons.live.estimate import Estimate
from surge_core.rounding import round_to_error

__all__ = ["Event", "LiveState", "Point", "field_rows", "page_document", "status_line", "tau_words"]


@dataclass(frozen=True)
class Event:
    """Something that happened, for the log.

    Parameters
    ----------
    clock : str
        Time of day.
    kind : str
        One word: ``"surge"``, ``"cycle"``, ``"feed"``, ``"record"``, ``"estimate"``, …
    text : str
        One sentence.
    """

    clock: str
    kind: str
    text: str


@dataclass(frozen=True)
class Point:
    """One operating point.

    Parameters
    ----------
    time_s, Wc25_kg_s, pressure_ratio, phi, psi_p, Nc_frac : float
        Facility clock, corrected inlet flow, P31/P25, φ, ψ' and the corrected speed.
    """

    time_s: float
    Wc25_kg_s: float
    pressure_ratio: float
    phi: float
    psi_p: float
    Nc_frac: float


@dataclass(frozen=True)
class LiveState:
    """Everything that is shown.

    Parameters
    ----------
    test, phase, feed : str
        Name of the test; ``"waiting"``, ``"running"``, ``"reducing"`` or ``"done"``; how the feed
        does, in words.
    feed_silent : bool
        Whether rows have stopped to come.
    n_rows, n_pieces, n_refused, n_repeated : int
        Rows kept, pieces of the record, lines left out, rows that were sent twice.
    point : Point or None
        The newest operating point.
    shown : str
        How the operating point was made: its delay, and whether it is matched at near stall.
    machine : str
        ``"stable"``, ``"in stall"``, ``"surge, in stall"``, ``"surge, unstalled"`` or
        ``"not known"``.
    n_cycles : int
        Complete surge cycles.
    period_s : float
        Their median period; NaN before there are two troughs.
    estimate : Estimate or None
        The newest provisional fit.
    trail : tuple of tuple of float
        (time, φ, ψ', W25 corrected in kg/s, P31/P25) of the last seconds, thinned out.
    events : tuple of Event
        The last ones, the newest at the end.
    """

    test: str
    phase: str
    feed: str
    feed_silent: bool = False
    n_rows: int = 0
    n_pieces: int = 0
    n_refused: int = 0
    n_repeated: int = 0
    point: Point | None = None
    shown: str = ""
    machine: str = "not known"
    n_cycles: int = 0
    period_s: float = math.nan
    estimate: Estimate | None = None
    trail: tuple[tuple[float, ...], ...] = field(default=(), repr=False)
    events: tuple[Event, ...] = ()


def field_rows(state: LiveState) -> list[tuple[str, str]]:
    """Return label and value of everything that is shown in words.

    Parameters
    ----------
    state : LiveState
        The moment.
    """
    return [
        ("test", f"{state.test} ({state.phase})"),
        ("feed", state.feed),
        ("machine", state.machine),
        ("clock", f"{state.point.time_s:.3f} s" if state.point else "–"),
        ("corrected flow", _flow(state.point)),
        ("pressure ratio", _number(state.point, "pressure_ratio", ".3f")),
        ("φ", _number(state.point, "phi", ".4f")),
        ("ψ'", _number(state.point, "psi_p", ".3f")),
        ("corrected speed", _speed(state.point)),
        ("surge cycles", _cycles(state)),
        ("time constant τ", tau_words(state.estimate)),
        ("record", _record(state)),
        ("signals", state.shown or "–"),
    ]


def _number(point: Point | None, name: str, form: str) -> str:
    value = math.nan if point is None else float(getattr(point, name))
    return format(value, form) if math.isfinite(value) else "–"


def _flow(point: Point | None) -> str:
    if point is None or not math.isfinite(point.Wc25_kg_s):
        return "–"
    return f"{point.Wc25_kg_s / LBM_KG:.1f} lbm/s ({point.Wc25_kg_s:.2f} kg/s)"


def _speed(point: Point | None) -> str:
    if point is None or not math.isfinite(point.Nc_frac):
        return "–"
    return f"{100.0 * point.Nc_frac:.1f} %"


def _cycles(state: LiveState) -> str:
    if not math.isfinite(state.period_s):
        return str(state.n_cycles)
    return (
        f"{state.n_cycles}, one every {1e3 * state.period_s:.0f} ms ({1.0 / state.period_s:.2f} Hz)"
    )


def tau_words(estimate: Estimate | None) -> str:
    """Return the time constant as it is shown.

    Parameters
    ----------
    estimate : Estimate or None
        The newest fit.
    """
    if estimate is None:
        return "not yet estimated"
    if estimate.why_not:
        return f"not yet: {estimate.why_not}"
    tau = round_to_error(1e3 * estimate.tau_s, 1e3 * estimate.tau_stderr_s)
    cycles = f"{estimate.n_cycles} cycles" if estimate.n_cycles else "the window of test.toml"
    return f"{tau} ms, provisional, {cycles}"


def _record(state: LiveState) -> str:
    parts = [f"{state.n_rows} rows"]
    if state.n_pieces > 1:
        parts.append(f"in {state.n_pieces} pieces")
    if state.n_repeated:
        parts.append(f"{state.n_repeated} sent twice")
    if state.n_refused:
        parts.append(f"{state.n_refused} lines left out")
    return ", ".join(parts)


def status_line(state: LiveState) -> str:
    """Return the moment in one line of a terminal.

    Parameters
    ----------
    state : LiveState
        The moment.
    """
    values = dict(field_rows(state))
    names = ("clock", "machine", "corrected flow", "φ", "ψ'", "surge cycles")
    words = "  ".join(f"{name} {values[name]}" for name in names)
    return f"{words}  τ {values['time constant τ']}  {state.feed}"


def page_document(state: LiveState) -> dict[str, Any]:
    """Return the moment as plain JSON types, numbers that are not finite as null.

    Parameters
    ----------
    state : LiveState
        The moment.
    """
    estimate, point = state.estimate, state.point
    known = estimate is not None and not estimate.why_not
    return {
        "schema": "sindy-surge/live/1",
        "test": state.test,
        "phase": state.phase,
        "machine": state.machine,
        "feed_silent": state.feed_silent,
        "fields": [{"label": label, "value": value} for label, value in field_rows(state)],
        "point": None if point is None else _finite([point.phi, point.psi_p]),
        "trail": [_finite(row) for row in state.trail],
        "tau_ms": _finite([1e3 * estimate.tau_s, 1e3 * estimate.tau_stderr_s])
        if estimate is not None and known
        else None,
        "curve": [_finite(row) for row in estimate.curve] if estimate is not None else [],
        "events": [{"clock": e.clock, "kind": e.kind, "text": e.text} for e in state.events],
    }


def _finite(values: Any) -> list[float | None]:
    return [float(f"{v:.6g}") if math.isfinite(v) else None for v in values]
