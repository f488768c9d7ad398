"""Where a residual stands out, in words: one sentence a panel, each with its number."""

from __future__ import annotations

import math
from statistics import median

from comparisons.missing_effect.where_rows import Line, Where

__all__ = ["describe", "signed"]

# A background this far above the stated floor is worth a word: the floor may be stated too low.
HIGH_BACKGROUND = 1.1
MEMORY_WORTH_A_WORD = 0.98
SAME_LINE = 0.05


def describe(where: Where) -> tuple[str, ...]:
    """Return a sentence for each panel with its strongest row, and one on how it was judged.

    Parameters
    ----------
    where : Where
        The rows.
    """
    sentences = [_of_time(where), _of_frequency(where), _of_flow(where), _of_phase(where)]
    if len(where.regime) > 1:
        sentences.append(_of_regime(where))
    return (*sentences, _of_judgement(where))


def signed(value: float) -> str:
    """Return a number with its sign and two decimals, zero without a minus.

    Parameters
    ----------
    value : float
        The number.
    """
    text = f"{value:+.2f}"
    return "+0.00" if text == "-0.00" else text


def _of_time(where: Where) -> str:
    row = max(where.time, key=lambda r: r.z)
    by_mean = row.z == abs(row.z_mean)
    what = (
        f"mean residual {_floors(row.mean, where)} (z {row.z_mean:.1f})"
        if by_mean
        else f"variance above the floor's (z {row.z_variance:.1f})"
    )
    block = f"{row.from_s:.4g} to {row.to_s:.4g} s of {row.record}"
    typical = median(r.rms for r in where.time) / where.floor_rms
    numbers = (
        f"{what}, rms {row.rms / where.floor_rms:.2f} floors beside {typical:.2f} "
        f"in the median block"
    )
    if row.z > where.bound_z:
        return f"Time: strongest at {block}: {numbers}."
    return f"Time: nothing stands out; the strongest of {len(where.time)} blocks, {block}: {what}."


def _of_frequency(where: Where) -> str:
    row = max(where.frequency, key=lambda r: r.z)
    band = f"{row.low_hz:.3g} to {row.high_hz:.3g} Hz"
    against = (
        f"{row.ratio:.3g} times the floor (z {row.z:.1f}; chance reaches {row.ratio_bound:.2f})"
    )
    tail = "".join(_of_line(line, where) for line in where.lines if line.source == "residual")
    if row.z > where.bound_z:
        slow = row is where.frequency[0] and "surge" not in row.lines
        # A line that was only found is reported by itself.
        known = [name for name in row.lines if name == "surge" or not tail]
        held = f", which holds {' and '.join(known)}" if known else ""
        held = ", slower than surge" if slow and _surges(where) else held
        return (
            f"Frequency: strongest in {band}{held}: {against}, "
            f"{100 * row.share:.0f} % of what exceeds the floor{tail}."
        )
    if tail:
        return f"Frequency: no band stands out (largest: {band}, {against}){tail}."
    return (
        f"Frequency: nothing stands out; the strongest of {len(where.frequency)} bands, "
        f"{band}: {against}."
    )


def _of_line(line: Line, where: Where) -> str:
    own = f"; a line at {line.frequency_hz:.3g} Hz, {line.width_hz:.2g} Hz wide, z {line.z:.1f}"
    for given in where.lines:
        if given.source == "given":
            ratio = line.frequency_hz / given.frequency_hz
            word = "the" if abs(ratio - 1.0) < SAME_LINE else "not the"
            return f"{own}, is {word} line of the stall cells at {given.frequency_hz:.3g} Hz"
    above = ", far above surge" if _surges(where) else ""
    return f"{own}{above}: rotating-stall cells or another ripple"


def _of_flow(where: Where) -> str:
    seen = [row for row in where.flow if math.isfinite(row.z)]
    if not seen:
        return "Flow: too few rows in each octile of φ to look at."
    row = max(seen, key=lambda r: abs(r.z))
    cell = f"φ {row.phi_from:.3f} to {row.phi_to:.3f} while {row.direction}"
    number = f"mean residual {_floors(row.mean, where)} over {row.n} rows (z {row.z:.1f})"
    falling, rising = where.direction_means
    split = (
        f"; it parts by direction of travel: falling {_floors(falling, where)}, "
        f"rising {_floors(rising, where)} (z {where.direction_z:.1f})"
        if abs(where.direction_z) > where.bound_z
        else ""
    )
    if abs(row.z) > where.bound_z:
        return f"Flow: strongest at {cell}: {number}{split}."
    if split:
        return f"Flow: no cell stands out (largest: {cell}, {number}){split}."
    return f"Flow: nothing stands out; the strongest of {len(seen)} cells, {cell}: {number}."


def _of_phase(where: Where) -> str:
    seen = [row for row in where.phase if math.isfinite(row.z)]
    if not seen:
        return "Cycle phase: φ has no regular surge cycle, so that phase is not looked at."
    row = max(seen, key=lambda r: abs(r.z))
    part = f"{row.from_cycle:.2f} to {row.to_cycle:.2f} of a cycle after φ rises through its mean"
    number = f"mean residual {_floors(row.mean, where)} (z {row.z:.1f})"
    if abs(row.z) > where.bound_z:
        return f"Cycle phase: strongest {part}: {number}."
    return f"Cycle phase: nothing stands out; the strongest of {len(seen)} parts, {part}: {number}."


def _of_regime(where: Where) -> str:
    row = max(where.regime, key=lambda r: r.z)
    least = min(r.ratio for r in where.regime)
    surge = f", surge at {row.surge_hz:.3g} Hz" if math.isfinite(row.surge_hz) else ""
    regime = f"{row.record} (mean φ {row.phi_mean:.3f}, amplitude {row.phi_amplitude:.3f}{surge})"
    by_mean = row.z == abs(row.z_mean)
    number = (
        f"rms {row.ratio:.2f} floors{'' if by_mean else f' (z {row.z_variance:.1f})'} beside "
        f"{least:.2f} in the quietest of {len(where.regime)} records, "
        f"mean {_floors(row.mean, where)}{f' (z {row.z_mean:.1f})' if by_mean else ''}"
    )
    if row.z > where.bound_z:
        return f"Regime: strongest in {regime}: {number}."
    return f"Regime: nothing stands out; the strongest, {regime}: {number}."


def _of_judgement(where: Where) -> str:
    verdict = (
        f"Beyond chance, strongest first: {', '.join(where.standing_out)}"
        if where.standing_out
        else "Nothing stands out"
    )
    parts = [
        f"{verdict}: {where.looks} looks, in which chance reaches z {where.bound_z:.1f}",
        f"one floor is the rms of the measurement noise, {where.floor_rms:.3g}",
    ]
    if where.effective_share < MEMORY_WORTH_A_WORD:
        parts.append(
            f"the noise has a memory, so that 100 rows on end count as "
            f"{100 * where.effective_share:.0f} independent ones in a mean"
        )
    if where.background > HIGH_BACKGROUND:
        parts.append(
            f"even the quietest quarter of the spectrum lies at {where.background:.2f} floors, "
            f"so that all z are measured against that"
        )
    return "; ".join(parts) + "."


def _surges(where: Where) -> bool:
    return any(line.name == "surge" for line in where.lines)


def _floors(value: float, where: Where) -> str:
    return f"{signed(value / where.floor_rms)} floors"
