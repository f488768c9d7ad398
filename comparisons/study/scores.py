"""What a study says of a fit, and which way of it is better."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal

Better = Literal["smaller", "larger", "zero", "target"]


@dataclass(frozen=True)
class Score:
    """One number of a fit.

    Parameters
    ----------
    name : str
        Column of the table.
    label : str
        What people call it.
    unit : str
        Its unit; empty for a pure number.
    better : {"smaller", "larger", "zero", "target"}
        Whether less, more, nearer to zero or nearer to ``target`` is better.
    target : float
        For "target".
    """

    name: str
    label: str
    unit: str
    better: Better
    target: float = 0.0

    @property
    def loss_label(self) -> str:
        """What its loss is called."""
        words = {"zero": f"|{self.label}|", "target": f"|share “{self.label}” − {self.target:g}|"}
        return words.get(self.better, self.label)

    def losses(self, values: Any) -> Any:
        """Return what is lost at values of the score, an array or a table: smaller is better."""
        if self.better == "smaller":
            return values
        return -values if self.better == "larger" else abs(values - self.target)


SCORES: Mapping[str, Score] = MappingProxyType(
    {
        score.name: score
        for score in (
            Score("tau_error_ms", "error of τ", "ms", "zero"),
            Score("tau_covered", "95 % interval holds τ", "", "target", 0.95),
            Score("curve_rms_error", "rms error of the characteristic", "", "smaller"),
            Score("free_run_rms", "rms error of the free run", "", "smaller"),
            Score("free_run_percent", "fit of the free run", "%", "larger"),
            Score("one_step_rms", "rms error one step ahead", "", "smaller"),
            Score("held_out_rms", "rms error on rows held out", "", "smaller"),
            Score("held_out_percent", "fit on rows held out", "%", "larger"),
            Score("n_terms", "terms of the characteristic", "", "smaller"),
            Score("false_names", "firm names of effects that are not there", "", "smaller"),
        )
    }
)
# Numbers of a fit in the table: what is better or worse, and what is not.
NUMBERS = ("tau_ms", "tau_stderr_ms", "firm_names", *SCORES)
