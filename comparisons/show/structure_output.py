"""What the command `structure` found, as text and as JSON."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from comparisons.harness.structure_fit import FoundStructure
from comparisons.show.json_output import record_document
from surge_core.terms import pretty_term, terms_json

if TYPE_CHECKING:
    from sindy_surge.selection import PathRow

STRUCTURE_SCHEMA = "sindy-surge/structure/1"
WIDTH = 100
# One in a hundred resampled records is no evidence for a term.
LEAST_INCLUSION = 0.01


def structure_text(found: FoundStructure) -> str:
    """Return all that is known as text of at most 100 columns.

    Parameters
    ----------
    found : FoundStructure
        From :func:`find_structure`.
    """
    lines = _wrapped(opening_words(found))
    if found.refused:
        code, advice = found.state
        return "\n".join([*lines, "", *_wrapped(f"no structure ({code}): {advice}")])
    lines += ["", found.summary.sheet().text()]
    lines += _wrapped(left_out_words(found))
    return "\n".join(lines)


def opening_words(found: FoundStructure) -> str:
    """Say what was fitted, and why that.

    Parameters
    ----------
    found : FoundStructure
        The structure.
    """
    names = ", ".join(Path(record.source).name for record in found.records)
    return f"{pretty_term(found.target)} of {names}: {found.phi.size} rows; {found.reason}"


def _wrapped(prose: str, later: str = "  ") -> list[str]:
    return textwrap.wrap(prose, WIDTH, subsequent_indent=later, break_on_hyphens=False)


def left_out_words(found: FoundStructure) -> str:
    """Say how often terms that were not chosen came up, or why nothing is known of that.

    Parameters
    ----------
    found : FoundStructure
        The structure.
    """
    known = found.inclusion
    if not known:
        return f"No inclusion probabilities: {_why_no_inclusion(found)}."
    others = sorted(
        ((p, name) for name, p in known.items() if name not in found.fit.terms_),
        key=lambda pair: -pair[0],
    )
    shown = [f"{pretty_term(name)} {p:.2f}" for p, name in others if p >= LEAST_INCLUSION]
    if not shown:
        return "No other term came up in a resampled record."
    return "Not chosen, yet in some resampled records: " + ", ".join(shown) + "."


def _why_no_inclusion(found: FoundStructure) -> str:
    if found.fitted_to == "whole runs":
        return "the free run through whole records is not resampled (--bootstrap fits the rows)"
    if found.settings.get("n_bootstrap") == 0:
        return "no records were resampled"
    return f"records are not resampled where a fit ended as {found.state[0]}"


def structure_document(found: FoundStructure) -> dict[str, Any]:
    """Return all that is known as plain JSON types.

    Parameters
    ----------
    found : FoundStructure
        From :func:`find_structure`.
    """
    from sindy_surge.summary import interval95

    fit, known, summary = found.fit, found.inclusion, found.summary
    parts = summary.parts
    code, advice = found.state
    noise = getattr(fit, "noise_", None)
    tau, error = parts.time_constant_s, parts.time_constant_stderr_s
    return {
        "schema": STRUCTURE_SCHEMA,
        "records": [record_document(record) for record in found.records],
        "target": found.target,
        "fitted_to": found.fitted_to,
        "rows_fitted": int(found.phi.size),
        "segments_fitted": found.n_segments,
        "settings": found.settings,
        "equation": None if found.refused else found.equation(),
        "time_constant_s": {
            "value": tau,
            "stderr": error,
            "ci95": list(interval95(tau, error)),
        },
        # Null where none was looked for.
        "dead_time_s": {
            "value": getattr(fit, "dead_time_s_", None),
            "stderr": getattr(fit, "dead_time_stderr_s_", None),
        },
        "terms": [
            {**term, "inclusion_probability": known.get(term["name"])}
            for term in terms_json(parts.terms, parts.coef, parts.stderr)
        ],
        "candidates": list(fit.candidate_terms_),
        "inclusion_probability": known,
        "rivals": [list(terms) for terms in getattr(fit, "rivals_", ())],
        "path": [_path_row(row) for row in fit.path_],
        "noise": None
        if noise is None
        else {found.target: float(noise[0]), "phi": float(np.ravel(noise[1])[0])},
        "phi_range": [float(found.phi.min()), float(found.phi.max())] if found.phi.size else None,
        "fit_state": {"code": code, "advice": advice},
        # The key of files written before `fit_state`.
        "state": {"code": code, "advice": advice},
        "cautions": list(summary.cautions),
    }


def _path_row(row: PathRow) -> dict[str, Any]:
    keys = "size", "score", "chi2", "time_constant_s", "held_out_rms", "consistent", "chosen"
    return {"terms": list(row.terms), **{key: getattr(row, key) for key in keys}}
