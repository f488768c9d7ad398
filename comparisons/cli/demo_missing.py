"""The end of the demo: a record in which one effect is hidden, and the same without it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from classic_ml.series import CoefficientSeries
    from comparisons.show.report import ReportSection

__all__ = ["HIDDEN", "MissingEnding", "missing_ending"]

# The skew of a tape recorder: the P31 channels come 5 ms late. The paper's own trouble in small:
# every rms looks fair, and τ is wrong by half.
HIDDEN = "transport_delay"
CASE = "985"
PICTURE = "missing_effect.png"
PICTURE_DPI = 110


@dataclass(frozen=True)
class MissingEnding:
    """What the demo shows of a missing effect.

    Parameters
    ----------
    sections : tuple of ReportSection
        Of the record with the hidden effect, and of the one without.
    lines : tuple of str
        What was found, beside what was hidden.
    picture : path
        Where, who, gap and verdict in one picture.
    """

    sections: tuple[ReportSection, ...]
    lines: tuple[str, ...]
    picture: Path


def missing_ending(
    folder: Path,
    seed: int,
    untouched: CoefficientSeries,
    hidden: Callable[[str], CoefficientSeries],
    true_tau_s: float,
) -> MissingEnding:
    """Diagnose a record in which an effect is hidden, and the one without it.

    Parameters
    ----------
    folder : path
        Where the picture goes.
    seed : int
        Of the rig's sensors; the same for both records.
    untouched : CoefficientSeries
        The record of the same test without it.
    hidden : callable
        Simulates and reduces the test with the effect of a name.
    true_tau_s : float
        Truth of the rig, in seconds.
    """
    from comparisons.missing_effect import diagnose
    from comparisons.missing_effect.shown import where_of
    from comparisons.show.diagnose_report import diagnosis_parts
    from comparisons.show.plots_missing_effect import draw_diagnosis
    from comparisons.show.report import ReportSection

    sections, lines = [], [f"What is missing: {HIDDEN} hidden in the raw counts (seed {seed})"]
    picture = folder / PICTURE
    for what, record in (("with it", hidden(HIDDEN)), ("without it", untouched)):
        d = diagnose([record])
        before, after = where_of(d, d.before), where_of(d, d.after)
        if what == "with it":
            draw_diagnosis(d, before, after).savefig(picture, dpi=PICTURE_DPI)
        sections.append(
            ReportSection(
                title=f"What is missing: the 98.5 % test {what}",
                extra=diagnosis_parts(d, before, after),
            )
        )
        named = "; ".join(" or ".join(item.alias_set) for item in d.missing) or "nothing"
        lines.append(
            f"  {what:11s} {d.verdict}: {named}; τ {1e3 * d.tau_before_s:.1f} -> "
            f"{1e3 * d.tau_after_s:.1f} ms for {1e3 * true_tau_s:.0f}, held-out rms "
            f"{d.gap.before_rms:.4f} -> {d.gap.after_rms:.4f}"
        )
    return MissingEnding(tuple(sections), tuple(lines), picture)
