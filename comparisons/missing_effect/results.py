"""What a diagnosis is: verdict, names, the gap before and after, and everything behind them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import PurePath

from comparisons.missing_effect.catalogue import CATALOGUE
from comparisons.missing_effect.effect import Effect, FittedParameter
from comparisons.missing_effect.fit import Fit
from comparisons.missing_effect.lag_data import LagData
from comparisons.missing_effect.noise import NoiseModel
from comparisons.missing_effect.quantities import numbers_of, tau_ms
from comparisons.missing_effect.search import Leftover, Round
from comparisons.missing_effect.whole_run_spectra import RippleLine
from surge_core.display import Displayed, Field, Grid, Sheet
from surge_core.rounding import significant
from surge_core.types import FloatArray

__all__ = [
    "CORRELATION",
    "MUCH_CORRELATED",
    "SIZE",
    "Absent",
    "Diagnosis",
    "FittedParameter",
    "Gap",
    "MissingEffect",
    "ReverseLoss",
    "Untold",
]

# Under this name the evidence holds how many standard errors large an effect is as a whole.
SIZE = "size_in_errors"
# And under this one the largest correlation of two numbers of the effect, from which on their
# errors say little one by one.
CORRELATION, MUCH_CORRELATED = "largest_correlation", 0.9


@dataclass(frozen=True)
class Gap:
    """Held-out rms errors in units of the coefficient, by fits to the other rows.

    Parameters
    ----------
    before_rms, after_rms : float
        Of the free run, without and with what was added.
    floor_rms : float
        Measurement noise.
    """

    before_rms: float
    after_rms: float
    floor_rms: float

    @property
    def shrink(self) -> float:
        """Share of the gap that is closed: (before² − after²)/(before² − floor²)."""
        gap = self.before_rms**2 - self.floor_rms**2
        won = self.before_rms**2 - self.after_rms**2
        return float(won / gap) if gap > 0.0 and won > 0.0 else 0.0


@dataclass(frozen=True)
class MissingEffect:
    """One effect that the model lacked.

    Parameters
    ----------
    effect : str
        First name.
    alias_set : tuple of str
        The names that these data cannot separate, the first among them.
    provisional : bool
        True where the model still leaves structure in its errors, or where what the effect does
        is not distinguished from nothing: then the name stands for something that may be another.
    parameters : tuple of FittedParameter
        Its numbers.
    evidence : mapping
        Gains in log-units on the fitted rows, later time and the other record, and their z; how
        many standard errors large all that the effect does is.
    doubts : tuple of str
        Why the name is not firm, where the search itself says so.
    """

    effect: str
    alias_set: tuple[str, ...]
    provisional: bool
    parameters: tuple[FittedParameter, ...]
    evidence: Mapping[str, float]
    doubts: tuple[str, ...] = ()


@dataclass(frozen=True)
class Untold:
    """An effect about which these records do not decide.

    Parameters
    ----------
    effect : str
        Its name.
    why, what_would_tell : str
        What it reads where nothing is missing; the measurement that would tell.
    """

    effect: str
    why: str
    what_would_tell: str


@dataclass(frozen=True)
class Absent:
    """An effect that is not there, and the size from which on it would have been seen.

    Parameters
    ----------
    effect, parameter : str
        Its name, and that of its number; ``"rms"`` for the part of ψ' that it makes.
    size : float
        Of its number.
    unit : str
        SI; ``"1"`` without one.
    """

    effect: str
    parameter: str
    size: float
    unit: str


@dataclass(frozen=True)
class ReverseLoss:
    """What the lag model leaves in reversed flow, and the loss that explains it.

    Parameters
    ----------
    squared : ndarray of shape (n,)
        φ² of the reversed rows, averaged as ψ' is.
    left : ndarray of shape (n,)
        Measured minus simulated ψ' there.
    size : float
        c of the loss c φ².
    share : float
        Share of the squares of ``left`` that it explains.
    """

    squared: FloatArray
    left: FloatArray
    size: float
    share: float


@dataclass(frozen=True)
class Diagnosis(Displayed):
    """What a model of these records lacks.

    Parameters
    ----------
    verdict : str
        ``nothing_missing``, ``named``, ``alias_set``, ``provisional``, ``unnamed_term``,
        ``unexplained_structure`` or ``noise_model_wrong``.
    missing : tuple of MissingEffect
        In the order in which they were found.
    gap : Gap
        On held-out rows.
    tau_before_s, tau_after_s : float
        τ by fits to all rows.
    tau_stderr_s : float
        Of the one after.
    tau_by_alias_s : mapping of str to float
        τ under every name of the alias sets.
    before, after : Fit
        To all rows.
    before_fitted, after_fitted : Fit
        To the fitted rows alone.
    data : LagData
        The rows.
    noise : NoiseModel
        Of the model after.
    leftover : Leftover
        What the model after leaves.
    rounds : tuple of Round
        The search.
    unavailable : mapping of str to str
        Effects that these records cannot show, and why.
    ripple : RippleLine, optional
        A second pattern of stall cells, on whole runs.
    reverse_loss : ReverseLoss, optional
        The loss in reversed flow where it acts, on whole runs.
    remarks : tuple of str
        What a reader should know beside it.
    untold : tuple of Untold
        On whole runs, effects about which these records do not decide.
    absent : tuple of Absent
        On whole runs, effects that would have been seen.
    catalogue : tuple of Effect
        The names that competed; whatever is looked up by name is looked up here.
    """

    verdict: str
    missing: tuple[MissingEffect, ...]
    gap: Gap
    tau_before_s: float
    tau_after_s: float
    tau_stderr_s: float
    tau_by_alias_s: Mapping[str, float]
    before: Fit
    after: Fit
    before_fitted: Fit
    after_fitted: Fit
    data: LagData
    noise: NoiseModel
    leftover: Leftover
    rounds: tuple[Round, ...]
    unavailable: Mapping[str, str]
    ripple: RippleLine | None = None
    reverse_loss: ReverseLoss | None = None
    remarks: tuple[str, ...] = ()
    untold: tuple[Untold, ...] = ()
    absent: tuple[Absent, ...] = ()
    catalogue: tuple[Effect, ...] = CATALOGUE

    @property
    def whole_runs(self) -> bool:
        """Whether the records were taken as whole runs, averaged over the stall cells."""
        return self.data.average_s > 0.0

    @property
    def names(self) -> tuple[str, ...]:
        """First names of what is missing."""
        return tuple(item.effect for item in self.missing)

    def _sheet(self) -> Sheet:
        found = tuple(
            (
                " or ".join(item.alias_set) + (" (provisional)" if item.provisional else ""),
                numbers_of(item.effect, item.parameters),
            )
            for item in self.missing
        )
        gap = self.gap
        before = (f"{gap.before_rms / gap.floor_rms:.2f}", tau_ms(self.tau_before_s))
        after = (
            f"{gap.after_rms / gap.floor_rms:.2f}",
            tau_ms(self.tau_after_s, self.tau_stderr_s),
        )
        models: tuple[tuple[str, ...], ...] = (
            (("before", *before), ("after", *after)) if found else (("the model", *after),)
        )
        grids = [Grid("On rows held out", ("model", "rms over the noise's", "τ"), models)]
        if found:
            words = frozenset(range(2))
            grids.insert(0, Grid("Missing", ("effect", "numbers"), found, words, marked=0))
        clear = self.verdict in ("named", "nothing_missing", "alias_set")
        verdict = self.verdict.replace("_", " ")
        return Sheet(
            f"Diagnosis: {verdict}",
            (
                Field("records", tuple(PurePath(source).name for source in self.data.sources)),
                Field("verdict", verdict, "good" if clear else "advice"),
                Field("noise (rms)", significant(gap.floor_rms, 3)),
                *((Field("remarks", self.remarks, "advice"),) if self.remarks else ()),
            ),
            tuple(grids),
        )
