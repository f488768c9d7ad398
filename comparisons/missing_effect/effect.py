"""What an effect is: a port, an equation, parameters, and how it acts on a lag model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from comparisons.missing_effect.lag_data import LagData
from comparisons.missing_effect.ports import Ports
from surge_core.types import FloatArray

PortName = Literal["input", "characteristic", "lag", "output", "noise"]
PORT_ORDER: tuple[PortName, ...] = ("input", "characteristic", "lag", "output", "noise")


@dataclass(frozen=True)
class Parameter:
    """One number of an effect.

    Parameters
    ----------
    name, unit : str
        Symbol and SI unit; ``"1"`` without one.
    low, high : float
        Physical bounds.
    kind : {"linear", "free", "held"}
        ``"linear"``: a coefficient of a column; ``"free"``: searched continuously; ``"held"``:
        one of a few values that the grid lists.
    step : float
        Size of a step that changes the model little; for finite differences and for starts.
    """

    name: str
    unit: str
    low: float
    high: float
    kind: Literal["linear", "free", "held"] = "linear"
    step: float = 1e-3


Acts = Callable[[Ports, LagData, FloatArray], Ports]
Grid = Callable[[LagData], FloatArray]
Adapts = Callable[[LagData, FloatArray], FloatArray]


def no_shape(data: LagData) -> FloatArray:
    """Return the grid of an effect with nothing but an amplitude."""
    return np.zeros((1, 0))


@dataclass(frozen=True)
class FittedParameter:
    """A number of an effect.

    Parameters
    ----------
    name : str
        Symbol.
    value, stderr : float
        From all rows.
    unit : str
        SI; ``"1"`` without one.
    """

    name: str
    value: float
    stderr: float
    unit: str


@dataclass(frozen=True)
class Effect:
    """One physical effect that a lag model may lack.

    Parameters
    ----------
    name : str
        Identifier.
    port : {"input", "characteristic", "lag", "output", "noise"}
        Where it acts.
    equation : str
        What it adds.
    says : str
        One sentence: what happens in the machine or in the measurement.
    parameters : tuple of Parameter
        The amplitude first; with amplitude 0 the effect is not there.
    acts : callable
        ``acts(ports, data, values)`` returns the ports with the effect; ``values`` holds the
        parameters that are not linear, in their order.
    grid : callable
        ``grid(data)`` returns where a search starts, one row a start, of the parameters that are
        neither linear nor the amplitude.
    searched : float
        How many independent trials that search is worth.
    needs : str
        Signal without which it cannot be detected; empty for none.
    on_tau : str
        What the time constant suffers when the effect is left out.
    confirm : str
        The measurement that would confirm it.
    episodes : bool
        Whether its columns belong to one episode each, with a phase that means nothing elsewhere.
    unnamed : bool
        Whether it is an open term, without a name.
    adapted : callable, optional
        ``adapted(data, values)`` returns the values for other rows, where held ones depend on
        what is fitted.
    switches : bool
        Whether a small step of its thresholds can change the answer at once: where φ turns back
        just at one of them, the likelihood jumps.
    kin : Effect, optional
        What acts much as this does and is no name: while the rows do not tell it apart, what is
        there may be neither.
    """

    name: str
    port: PortName
    equation: str
    says: str
    parameters: tuple[Parameter, ...]
    acts: Acts
    grid: Grid = no_shape
    searched: float = 1.0
    on_tau: str = ""
    confirm: str = ""
    needs: str = ""
    episodes: bool = False
    unnamed: bool = False
    adapted: Adapts | None = None
    switches: bool = False
    kin: Effect | None = None

    @property
    def linear(self) -> bool:
        """Whether the amplitude is a coefficient of a column."""
        return self.parameters[0].kind == "linear"

    @property
    def nonlinear(self) -> tuple[Parameter, ...]:
        """The parameters that ``acts`` takes, the amplitude among them when it is one."""
        return tuple(p for p in self.parameters if p.kind != "linear")

    @property
    def free(self) -> tuple[int, ...]:
        """Which of ``nonlinear`` are searched continuously."""
        return tuple(i for i, p in enumerate(self.nonlinear) if p.kind == "free")

    @property
    def key(self) -> str:
        """What makes it the same as another: a lag has one place for each effect."""
        return self.name

    @property
    def brings(self) -> int:
        """How many numbers it adds."""
        return len(self.parameters)

    def is_plain_form_of(self, other: Effect) -> bool:
        """Tell whether another is this one with something more: none of the catalogue is."""
        return False

    def missing_channel(self, data: LagData) -> str | None:
        """Return why the effect cannot be separated from these records, or None.

        Parameters
        ----------
        data : LagData
            The records.
        """
        if not self.needs:
            return None
        if self.needs not in data:
            return f"needs the column {self.needs}"
        values = data[self.needs]
        if float(np.ptp(values)) <= 1e-6 * float(np.mean(np.abs(values))):
            return f"needs a {self.needs} that changes"
        return None

    def starts(self, data: LagData) -> FloatArray:
        """Return the values of ``nonlinear`` that a search of some records starts from.

        One row a start; where the amplitude is one of them it starts at zero.
        """
        shapes = np.atleast_2d(self.grid(data))
        if self.linear:
            return shapes
        return np.column_stack([np.zeros(shapes.shape[0]), shapes])
