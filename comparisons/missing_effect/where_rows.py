"""What is looked at and what is found of a residual: rows of numbers and a sentence a panel."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from comparisons.missing_effect.quantities import scale_of
from surge_core.rounding import round_to_error, significant
from surge_core.types import FloatArray, IntArray

FEWEST_SCORED = 40
PANELS = ("time", "frequency", "flow")
# Which way the signal goes.
WAYS = ("any", "falling", "rising")
# A background this far above the stated floor is worth a word: the floor may be stated too low.
HIGH_BACKGROUND = 1.1
SYMBOLS = {"psi_p": "ψ'", "phi": "φ"}


@dataclass(frozen=True)
class Residuals:
    """What is looked at: measured rows of one output, and the simulation before and after.

    Parameters
    ----------
    output, unit, signal, signal_unit : str
        Names and units of the output, and of the signal that the third panel is laid over.
    time_s, over : ndarray of shape (n,)
        Clock of each row, in seconds, and the signal.
    measured, before, after : ndarray of shape (n,)
        The output, and the models without and with what was added; NaN where it is not scored.
    runs : tuple of slice
        Uniformly sampled pieces in order; nothing is carried from one to the next.
    record, record_names : ndarray of int of shape (n,), tuple of str
        Number of the record of each row, and the names of the records.
    period_s, cycle_hz : float
        Sample period; main frequency of the signal, 0 where it has none.
    simulated : bool
        Whether the signal is the output itself, simulated. Residuals are part of a measured
        output: laid over that, noise alone gives a slope.
    floor_rms, ar : float, ndarray of shape (p,)
        Measurement noise, where it is known, and its autoregression, e[k] = Σ aᵢ e[k−i] + white.
    """

    output: str
    unit: str
    time_s: FloatArray
    measured: FloatArray
    before: FloatArray
    after: FloatArray
    over: FloatArray
    signal: str
    signal_unit: str
    runs: tuple[slice, ...]
    record: IntArray
    record_names: tuple[str, ...]
    period_s: float
    simulated: bool = False
    floor_rms: float = math.nan
    ar: FloatArray = field(default_factory=lambda: np.zeros(0))
    cycle_hz: float = 0.0

    @property
    def enough(self) -> bool:
        """Whether there are rows enough to look at."""
        return int(np.count_nonzero(np.isfinite(self.measured))) >= FEWEST_SCORED


@dataclass(frozen=True)
class TimeRow:
    """A block of time.

    Parameters
    ----------
    record : str
        Name of the record.
    from_s, to_s : float
        Clock at its ends, in seconds.
    n : int
        Scored rows.
    before_rms, after_rms : float
        Of the residual, in the unit of the output.
    mean : float
        Of the residual before.
    excess : float
        √(rms² − floor²) before, 0 below the floor; NaN where no floor is known.
    z_mean, z_variance : float
        Of the mean before against zero and of the variance of its innovations against the
        floor's; NaN where no floor is known.
    """

    record: str
    from_s: float
    to_s: float
    n: int
    before_rms: float
    after_rms: float
    mean: float
    excess: float
    z_mean: float
    z_variance: float

    @property
    def z(self) -> float:
        """The larger of the two; a variance below the floor is no structure."""
        known = [z for z in (abs(self.z_mean), self.z_variance) if math.isfinite(z)]
        return max(known, default=math.nan)


@dataclass(frozen=True)
class BandRow:
    """A band of frequencies.

    Parameters
    ----------
    low_hz, high_hz : float
        Edges.
    before_psd, after_psd, measured_psd : float
        Mean power density of the residuals and of the measured output, each less its mean, in
        the squared unit of the output a hertz.
    share : float
        Share of the power of the residual before that lies in the band.
    ratio, z : float
        Power before over that of the floor, and z; NaN where no floor is known.
    """

    low_hz: float
    high_hz: float
    before_psd: float
    after_psd: float
    measured_psd: float
    share: float
    ratio: float
    z: float


@dataclass(frozen=True)
class Cell:
    """A mean over n rows: its standard error from the sums of blocks, and z, that of a t."""

    mean: float
    stderr: float
    z: float
    n: int


@dataclass(frozen=True)
class SignalRow:
    """A range of the signal, with the residual in all of its rows ("any"), rising and falling.

    ``at`` is the mean of the signal between its ends.
    """

    low: float
    high: float
    at: float
    before: Mapping[str, Cell]
    after: Mapping[str, Cell]


@dataclass(frozen=True)
class Where:
    """Where the residual of one output stands out, before and after.

    Parameters
    ----------
    of : Residuals
        What was looked at.
    time : tuple of TimeRow
        Blocks of each record.
    frequency : tuple of BandRow
        Bands, spaced logarithmically.
    flow : tuple of SignalRow
        Ranges of the signal.
    direction : Cell
        Mean while the signal falls less that while it rises, before.
    background : float
        rms of the quietest quarter of the spectrum over the floor; NaN where none is known.
    looks : int
        Numbers that were looked at.
    bound_z : float
        What chance reaches in that many looks.
    """

    of: Residuals
    time: tuple[TimeRow, ...]
    frequency: tuple[BandRow, ...]
    flow: tuple[SignalRow, ...]
    direction: Cell
    background: float
    looks: int
    bound_z: float

    @property
    def standing_out(self) -> tuple[str, ...]:
        """The panels in which something lies beyond what chance reaches, the strongest first."""
        found = {
            "time": [row.z for row in self.time],
            "frequency": [row.z for row in self.frequency],
            "flow": [abs(cell.z) for row in self.flow for cell in row.before.values()]
            + [abs(self.direction.z)],
        }
        largest = {name: np.nanmax([0.0, *values]) for name, values in found.items()}
        beyond = [name for name, z in largest.items() if z > self.bound_z]
        return tuple(sorted(beyond, key=lambda name: -largest[name]))

    def to_json(self) -> dict[str, list[dict[str, Any]]]:
        """Return the rows of each panel as plain dictionaries; NaN for what is not known.

        Returns
        -------
        dict
            ``{"time": [...], "frequency": [...], "flow": [...]}``. A row of ``flow`` gives the
            means in its range before and after; ``mean``, ``stderr`` and ``z`` are those before,
            while the signal goes the way that ``direction`` says.
        """
        own = {"record": ", ".join(self.of.record_names), "output": self.of.output}
        return {
            "time": [{**own, **asdict(row), "rms": row.before_rms} for row in self.time],
            "frequency": [{**own, **asdict(row)} for row in self.frequency],
            "flow": [{**own, **self._flow_json(row, way)} for way in WAYS[1:] for row in self.flow],
        }

    def _flow_json(self, row: SignalRow, way: str) -> dict[str, Any]:
        models = (("before", row.before), ("after", row.after))
        means = {
            f"{model}_{part}": getattr(cells["any"], part)
            for model, cells in models
            for part in ("mean", "stderr")
        }
        means |= {f"{model}_{one}": cells[one].mean for model, cells in models for one in WAYS[1:]}
        return {
            "signal": self.of.signal,
            "simulated": self.of.simulated,
            f"{self.of.signal}_from": row.low,
            f"{self.of.signal}_to": row.high,
            "low": row.low,
            "high": row.high,
            "at": row.at,
            "direction": way,
            **asdict(row.before[way]),
            **means,
        }


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
    numbers = f"rms {worst} where the median block has {middle}"
    numbers += f", and {left} there after" if two else ""
    if not judged:
        return f"in time: the residual is largest from {block}, {numbers}"
    if top.z > where.bound_z:
        return f"in time: the residual stands out most from {block}, {numbers}"
    return f"in time: no block stands out; the largest, {block}: {numbers}"


def _of_frequency(where: Where) -> str:
    if not any(math.isfinite(row.share) for row in where.frequency):
        return "over frequency: no residual to look at"
    judged = any(math.isfinite(row.z) for row in where.frequency)
    beyond = [r for r in where.frequency if r.z > where.bound_z]
    if judged and not beyond:
        return "over frequency: no band stands out"
    row = max(beyond or where.frequency, key=lambda r: r.share)
    band = f"the band from {row.low_hz:.3g} to {row.high_hz:.3g} Hz"
    holds = f"holds {100.0 * row.share:.0f} % of its power"
    if row.measured_psd > 0.0:
        part = 100.0 * row.before_psd / row.measured_psd
        shown = significant(part, 2) if part < 10.0 else f"{part:.0f}"
        listed = "more than" if part > 100.0 else f"{shown} % of"
        holds += f", {listed} what was measured there"
    floor = f" and is {row.ratio:.3g} times the noise" if judged else ""
    return f"over frequency: {band} {holds}{floor}"


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
