"""Discovered equations, and the discovered loop of a series, as text, JSON and page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from comparisons.page.blocks import Block, Part, Picture, Words
from comparisons.page.style import FAINT, legend_above, panel, strips
from sindy_surge.discover.columns import idle_words
from sindy_surge.discover.dynamics import SparseDynamics
from sindy_surge.discover.equations import Rival, Term
from sindy_surge.discover.loop_balance import Balance
from sindy_surge.discover.loop_lag import Branch
from sindy_surge.discover.loops import SurgeLoop
from surge_core.fit_state import FitState
from surge_core.terms import signed_sum, terms_json
from surge_core.types import FloatArray

DISCOVER_SCHEMA = "sindy-surge/discover/1"
RIVALS_SHOWN = 5
DISCOVERED = "#1f5fa8"


def discover_document(model: SparseDynamics) -> dict[str, Any]:
    """Return the document of ``discover --json`` of a fitted model."""
    stated = _stated(model)
    return {
        "schema": DISCOVER_SCHEMA,
        "equations": _equations(model, model.equation_terms_) if stated else [],
        "rivals": [
            {"behind": rival.behind, "equations": _equations(model, rival.equations)}
            for rival in model.rivals_
            if stated
        ],
        "idle": list(model.idle_),
        "late": _late(model),
        "beyond": list(model.beyond_),
        "noise": dict(zip(model.state_names_, model.noise_.tolist(), strict=False))
        | _input_noise(model),
        "fit_state": {"code": model.state_.code, "advice": model.state_.advice},
    }


def _stated(model: SparseDynamics) -> bool:
    """Return whether the equations explain the data: else none of them is stated."""
    return model.state_ not in (FitState.UNEXPLAINED, FitState.NO_EQUATIONS)


def _equations(
    model: SparseDynamics, equations: tuple[tuple[Term, ...], ...]
) -> list[dict[str, Any]]:
    named = zip(model.state_names_, equations, strict=True)
    return [{"state": state, "terms": list(map(asdict, terms))} for state, terms in named]


def discover_lines(model: SparseDynamics) -> tuple[str, ...]:
    """Return state, equations and rivals, line by line; of a failed fit only what would pay."""
    head = f"{model.state_}: {model.state_.advice}"
    beyond = [f"beyond the library: {', '.join(model.beyond_)} would pay"] if model.beyond_ else []
    beyond += idle_words(model.idle_)
    if not _stated(model):
        return (head, *beyond)
    named = zip(model.state_names_, model.equation_terms_, strict=True)
    equations = [f"d{state}/dt = {_written(terms)}" for state, terms in named] + beyond
    equations += [model.late_.words(model.state_names_)] if model.late_ is not None else []
    noisy = [f"{name} is measured with noise of {s:.2g}" for name, s in _input_noise(model).items()]
    equations += [f"{'; '.join(noisy)}: estimated with the states"] if noisy else []
    rivals = [f"  {_difference(model, rival)}" for rival in model.rivals_[:RIVALS_SHOWN]]
    tried = f"{len(model.path_)} models compared"
    words = f"rivals: none within 5 of the log-likelihood ({tried})"
    if model.rivals_:
        weight = sum(np.exp(-rival.behind) for rival in model.rivals_)
        words = (
            f"rivals: {len(model.rivals_)} of {tried} are within 5 of the log-likelihood and "
            f"cannot be excluded: together {weight:.2g} times as likely"
        )
    return (head, *equations, words, *rivals)


def _input_noise(model: SparseDynamics) -> dict[str, float]:
    """Return the noise of the inputs that are not taken as exact."""
    sizes = zip(model.input_names_, model.input_noise_.tolist(), strict=True)
    return {name: size for name, size in sizes if size > 0.0}


def _late(model: SparseDynamics) -> dict[str, Any] | None:
    late = model.late_
    if late is None:
        return None
    states = [model.state_names_[i] for i in late.states]
    return {"states": states, "how": late.how, "value_s": late.late_s, "stderr_s": late.stderr_s}


def _written(terms: Sequence[Term]) -> str:
    """Write a right-hand side in the user's own names; a coefficient without error was given."""
    names = [t.name if t.stderr > 0.0 else f"{t.name} (given)" for t in terms]
    rows = [(n, t.coefficient, t.stderr) for n, t in zip(names, terms, strict=True)]
    return signed_sum(rows, str)


def _difference(model: SparseDynamics, rival: Rival) -> str:
    parts = []
    for state, own, other in zip(
        model.state_names_, model.equation_terms_, rival.equations, strict=True
    ):
        mine, theirs = {t.name for t in own}, {t.name for t in other}
        changes = [f"without {n}" for n in sorted(mine - theirs)]
        changes += [f"with {n}" for n in sorted(theirs - mine)]
        if changes:
            parts.append(f"d{state}/dt {' and '.join(changes)}")
    return f"{rival.behind:.1f} behind: {'; '.join(parts)}"


def discover_parts(
    model: SparseDynamics, x: Sequence[FloatArray], t: Sequence[FloatArray]
) -> tuple[Part, ...]:
    """Return the parts of the page; ``x`` and ``t`` are states and times of each trajectory."""
    equations = _said("Equations", discover_lines(model), good=model.state_ is FitState.OK)
    return equations, Part("Measured and estimated", tuple(_pictures(model, x, t)))


def _said(title: str, lines: Sequence[str], *, good: bool) -> Part:
    """Return the lines of the terminal as a part: the state, and what was found."""
    state, *found = lines
    words = (Words(state, "plain" if good else "caution"), Words("\n".join(found), "code"))
    return Part(title, words if found else words[:1])


def _pictures(
    model: SparseDynamics, x: Sequence[FloatArray], t: Sequence[FloatArray]
) -> list[Block]:
    """Draw the first trajectory over time, and the first two states against each other."""
    first, n = len(x[0]), x[0].shape[1]
    # Where readings come late they are drawn as they were moved.
    measured = model.search_.likelihood.data.y[:first, :n]
    estimated, names = model.x_[:first], model.state_names_
    figure, panels = strips(n, 1.2 + 1.5 * n, "time [s]")
    for j, ax in enumerate(panels):
        ax.plot(t[0], measured[:, j], ".", ms=2, color=FAINT, label="measured")
        ax.plot(t[0], estimated[:, j], color=DISCOVERED, lw=1.2, label="equations")
        ax.set_ylabel(names[j])
    legend_above(figure, panels[0])
    left = np.sqrt(np.mean((measured - estimated[:, :n]) ** 2, axis=0))
    words = ", ".join(f"{name} {rms:.2g}" for name, rms in zip(names, left, strict=False))
    pictures: list[Block] = [
        Picture(
            "States over time, first file",
            figure,
            f"Measured states and the run of the equations nearest to them; rms apart: {words}.",
            "One run of the equations through the whole file, without restarts.",
        )
    ]
    if n < 2:
        return pictures
    figure, ax = panel(names[0], names[1])
    ax.plot(measured[:, 0], measured[:, 1], ".", ms=2, color=FAINT, label="measured")
    ax.plot(estimated[:, 0], estimated[:, 1], color=DISCOVERED, lw=1.2, label="equations")
    legend_above(figure, ax)
    pictures.append(
        Picture(
            f"{names[1]} over {names[0]}, first file",
            figure,
            "The measured loop and the loop of the equations.",
            "Where the two part in the same place in every cycle, a term is missing.",
        )
    )
    return pictures


def loop_document(loop: SurgeLoop) -> dict[str, Any]:
    """Return the document of `discover --json`, with branches, levels, τ and period."""
    # Of a loop that does not run as the record does no number is stated.
    lag, stated = loop.lag, loop.state is FitState.OK

    def terms(part: Branch | Balance) -> list[dict[str, Any]]:
        return terms_json(part.terms, part.coefficients, part.stderr)

    names = ("recover_phi", "stall_phi")
    levels = zip(names, lag.levels, lag.levels_stderr, strict=False)
    tau = {"value": lag.time_constant_s, "stderr": lag.time_constant_stderr_s}
    equations = [
        {"state": "phi", "terms": terms(loop.duct)},
        {"state": "plenum", "terms": terms(loop.plenum)},
    ]
    return {
        "schema": DISCOVER_SCHEMA,
        "equations": equations if stated else [],
        "branches": [{"name": b.name, "terms": terms(b)} for b in lag.branches if stated],
        "levels": {n: {"value": v, "stderr": error} for n, v, error in levels if stated},
        "time_constant_s": tau if stated else dict.fromkeys(tau),
        "period_s": {"measured": loop.measured_cycles.period_s, "simulated": loop.period_s},
        "rivals": [],
        "fit_state": {"code": loop.state.code, "advice": loop.state.advice},
    }


def loop_lines(loop: SurgeLoop) -> tuple[str, ...]:
    """Return what terminal and page show: state, equations, and what the loop measures."""
    head = f"{loop.state}: {loop.state.advice}"
    period = f"period: {loop.measured_cycles.period_s:.4f} s measured"
    if loop.state is not FitState.OK:
        beyond = ", ".join((*loop.duct.beyond, *loop.plenum.beyond))
        return head, *([f"beyond the library: {beyond} would pay"] if beyond else []), period
    lag = loop.lag
    names = ("unstalled once φ rises through", "stalled once φ falls through")
    levels = zip(names, lag.levels, lag.levels_stderr, strict=False)
    kinks = [("kink at φ", b.knot, b.knot_stderr) for b in lag.branches if np.isfinite(b.knot)]
    simulated = f"{loop.period_s:.4f} s" if np.isfinite(loop.period_s) else "none"
    return (
        head,
        *loop.equations(),
        f"branches: {loop.n_branches}",
        f"time constant: {1e3 * lag.time_constant_s:.2f} ± {1e3 * lag.time_constant_stderr_s:.2f} "
        "ms",
        *(f"{name}: {level:.4f} ± {error:.4f}" for name, level, error in (*levels, *kinks)),
        f"{period}, {simulated} simulated",
        f"plenum pressure: {'hidden' if loop.plenum_hidden else 'measured'}",
    )


def loop_parts(loop: SurgeLoop, source: str) -> tuple[Part, ...]:
    """Return the section of the report."""
    good = loop.state is FitState.OK
    return (_said(f"Surge loop of {Path(source).name}", loop_lines(loop), good=good),)
