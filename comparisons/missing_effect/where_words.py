"""Where a residual stands out, in words: one sentence a panel, each with its number."""

from __future__ import annotations

import math

import numpy as np

from comparisons.missing_effect.scales import scale_of
from comparisons.missing_effect.where_rows import Cell, Where
from surge_core.rounding import round_to_error, significant

# A background this far above the stated floor is worth a word: the floor may be stated too low.
HIGH_BACKGROUND = 1.1
SYMBOLS = {"psi_p": "ψ'", "phi": "φ"}


def describe(where: Where, *, two: bool) -> tuple[str, ...]:
    """Return a sentence for each panel with its strongest row, and one on how it was judged.

    ``two`` says whether the models before and after differ.
    """
    output = SYMBOLS.get(where.of.output, where.of.output)
    panels = (_of_time(where, two), _of_frequency(where), _of_signal(where))
    said = tuple(f"{output} {words}." for words in panels)
    return (*said, _of_judgement(where)) if math.isfinite(where.of.floor_rms) else said


def _of_time(where: Where, two: bool) -> str:
    known = [row for row in where.time if math.isfinite(row.before_rms)]
    if not known:
        return "in time: could not be simulated by the model before"
    judged = any(math.isfinite(row.z) for row in known)
    top = max(known, key=lambda r: (r.z if math.isfinite(r.z) else 0.0) if judged else r.before_rms)
    unit, typical = where.of.unit, float(np.median([row.before_rms for row in known]))
    worst, middle, left = (
        scale_of(unit, [size]).text(size) for size in (top.before_rms, typical, top.after_rms)
    )
    block = f"{top.from_s:.4g} to {top.to_s:.4g} s of {top.record}"
    numbers = (
        f"rms {worst} where the median block has {middle}"
        f"{f', and {left} there after' if two else ''}"
    )
    if not judged:
        return f"in time: the residual is largest from {block}, {numbers}"
    if top.z > where.bound_z:
        return f"in time: the residual stands out most from {block}, {numbers}"
    return f"in time: no block stands out; the largest, {block}: {numbers}"


def _of_frequency(where: Where) -> str:
    share = [row.share for row in where.frequency]
    if not np.any(np.isfinite(share)):
        return "over frequency: no residual to look at"
    judged = any(math.isfinite(row.z) for row in where.frequency)
    beyond = [r for r in where.frequency if r.z > where.bound_z]
    row = max(beyond or where.frequency, key=lambda r: r.share)
    band = f"the band from {row.low_hz:.3g} to {row.high_hz:.3g} Hz"
    holds = f"holds {100.0 * row.share:.0f} % of its power"
    if row.measured_psd > 0.0:
        part = 100.0 * row.before_psd / row.measured_psd
        listed = "more than" if part > 100.0 else f"{significant(part, 2)} % of"
        holds += f", {listed} what was measured there"
    floor = f" and is {row.ratio:.3g} times the noise" if judged else ""
    line = where.line
    tail = f"; a line at {line.frequency_hz:.3g} Hz stands out, z {line.z:.1f}" if line else ""
    if judged and not beyond:
        return f"over frequency: no band stands out{tail}"
    return f"over frequency: {band} {holds}{floor}{tail}"


def _of_signal(where: Where) -> str:
    of = where.of
    signal = SYMBOLS.get(of.signal, of.signal)
    lead = f"over {signal}{' simulated' * of.simulated}: "
    cells = [
        (row, way, cell)
        for row in where.flow
        for way, cell in row.before.items()
        if math.isfinite(cell.z)
    ]
    if not cells:
        return f"{lead}too few visits for a mean"
    parts = ""
    if abs(where.direction.z) > where.bound_z:
        parts = (
            f"; it parts by direction: where {signal} falls it is {_number(where, where.direction)}"
            " beside where it rises"
        )
    row, way, top = max(cells, key=lambda one: abs(one[2].z))
    if abs(top.z) <= where.bound_z:
        return f"{lead}no mean residual stands out{parts}"
    ranges = [r for r in where.flow if any(abs(c.z) > where.bound_z for c in r.before.values())]
    over = scale_of(of.signal_unit, [r.at for r in where.flow])
    while_ = "" if way == "any" else f" while {signal} is {way}"
    return (
        f"{lead}the mean residual stands out in {len(ranges)} of {len(where.flow)} ranges, most "
        f"clearly at {over.text(row.at)}{while_}: {_number(where, top)}{parts}"
    )


def _number(where: Where, cell: Cell) -> str:
    scale = scale_of(where.of.unit, [abs(cell.mean)])
    text = round_to_error(scale.factor * cell.mean, scale.factor * cell.stderr).replace("-", "−")
    if not scale.unit:
        return text
    return f"({text}){'·' if scale.unit.startswith('10') else ' '}{scale.unit}"


def _of_judgement(where: Where) -> str:
    signal = SYMBOLS.get(where.of.signal, where.of.signal)
    panels = {"time": "in time", "frequency": "over frequency", "flow": f"over {signal}"}
    found = ", ".join(panels[name] for name in where.standing_out)
    said = f"The residual exceeds chance {found}, the strongest first" if found else ""
    said = said or "The residual nowhere exceeds chance"
    said += f". Chance reaches z = {where.bound_z:.1f} in the {where.looks} numbers compared."
    if where.background > HIGH_BACKGROUND:
        said += (
            f" Even the quietest quarter of the spectrum lies at {where.background:.2f} times the "
            "noise; every z is measured against that level."
        )
    return said
