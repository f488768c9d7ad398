"""An effect at its place: which equation, which signal, which channel; and its scales."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from comparisons.missing_effect.systems.model import Model
from comparisons.missing_effect.systems.shapes import Kind
from surge_core.types import FloatArray

__all__ = ["Number", "Place", "Placed", "SystemEffect", "signal_names"]


def signal_names(model: Model) -> tuple[str, ...]:
    """Return what a term may act on: the states, then the inputs."""
    return (*model.state_names, *model.input_names)


@dataclass(frozen=True)
class Number:
    """One number of an effect, dimensionless inside.

    Parameters
    ----------
    name : str
        Symbol.
    low, high : float
        Bounds, in units of the scale.
    held : bool
        Whether it stays where the search started it.
    """

    name: str
    low: float
    high: float
    held: bool = False


@dataclass(frozen=True)
class Place:
    """Where an effect sits; −1 where something does not apply.

    Parameters
    ----------
    at : int
        The equation (a state), the input, the output or the parameter.
    signal, other : int
        What it acts on: states first, then inputs; and a second signal, or the state into which
        an overflow spills.
    """

    at: int
    signal: int = -1
    other: int = -1


@dataclass(frozen=True)
class SystemEffect:
    """One effect that a model of any system may lack.

    Parameters
    ----------
    name : str
        Identifier.
    kind, code : int
        How the kernels act (`systems.shapes`).
    equation : str
        What it adds, with ``{s}`` for its signal.
    says : str
        One sentence: what happens in the system or in the measurement.
    numbers : tuple of Number
        Its numbers in their slots; the amplitude or the threshold first.
    places : callable
        ``places(model)`` lists where it may sit.
    starts : callable
        ``starts(signal)`` lists where a search starts, from the signal that it acts on (scaled by
        its rms): one tuple of numbers a start.
    refused : callable
        ``refused(signal)`` says why this signal cannot show it, or an empty text.
    confirm : str
        The measurement that would confirm it.
    own_state : bool
        Whether it brings a state of its own.
    linear : bool
        Whether its first number is an amplitude that may have either sign and starts at zero.
    unnamed : bool
        Whether it is an open term, without a name.
    simple_form_of : tuple of str
        Effects that are this one with something more.
    """

    name: str
    kind: Kind
    code: int
    equation: str
    says: str
    numbers: tuple[Number, ...]
    places: Callable[[Model], tuple[Place, ...]]
    starts: Callable[[FloatArray], tuple[tuple[float, ...], ...]]
    refused: Callable[[FloatArray], str]
    confirm: str
    own_state: bool = False
    linear: bool = True
    unnamed: bool = False
    simple_form_of: tuple[str, ...] = ()

    @property
    def resists(self) -> bool:
        """Whether its amplitude is reported as a resistance: positive against the signal."""
        return self.equation.startswith("−")


@dataclass(frozen=True)
class Placed:
    """An effect at a place of a model, with the scales that make its numbers dimensionless.

    Parameters
    ----------
    effect : SystemEffect
        The effect.
    place : Place
        Where it sits.
    scales : tuple of float
        Of what it enters, of its signal, and of its second signal or its time.
    starts : tuple of tuple of float
        Where a search of its numbers starts.
    """

    effect: SystemEffect
    place: Place
    scales: tuple[float, float, float]
    starts: tuple[tuple[float, ...], ...]

    @property
    def key(self) -> tuple[str, Place, int, int]:
        """What makes it the same as another: its name and place, and which of its forms it is."""
        return self.effect.name, self.place, int(self.effect.kind), self.effect.code

    @property
    def held(self) -> tuple[bool, ...]:
        """Which of its numbers stay where they start.

        What an overflow loses runs nowhere: the share of it that arrives means nothing.
        """
        lost = self.effect.kind == Kind.OVERFLOW and self.place.other < 0
        return tuple(
            number.held or (lost and slot == 1) for slot, number in enumerate(self.effect.numbers)
        )

    @property
    def name(self) -> str:
        """Name of the effect."""
        return self.effect.name

    def where(self, model: Model) -> dict[str, str]:
        """Return its place in words: equation, signal, channel.

        Parameters
        ----------
        model : Model
            The model that it sits in.
        """
        signals = signal_names(model)
        at, kind = self.place.at, self.effect.kind
        names: dict[str, str] = {}
        if kind in (Kind.TERM, Kind.HYSTERESIS):
            names["equation"] = f"d{model.state_names[at]}/dt"
        elif kind in (Kind.INPUT_MAP, Kind.INPUT_LAG, Kind.INPUT_DELAY, Kind.INPUT_PLAY):
            names["input"] = model.input_names[at]
        elif kind in (Kind.OUTPUT_MAP, Kind.OUTPUT_LAG):
            names["sensor"] = model.output_names[at]
        elif kind == Kind.DRIFT:
            names["parameter"] = model.param_names[at]
        elif kind == Kind.RECORDING:
            names["channels"] = "all channels"
        else:
            names["state"] = model.state_names[at]
        if self.place.signal >= 0:
            names["signal"] = signals[self.place.signal]
        if self.place.other >= 0:
            key = "into" if kind == Kind.OVERFLOW else "times"
            names[key] = signals[self.place.other]
        return names

    def label(self, model: Model) -> str:
        """Return name and place in one line, for tables.

        Parameters
        ----------
        model : Model
            The model that it sits in.
        """
        names = self.where(model)
        inner = "·".join(names[k] for k in ("signal", "times") if k in names)
        outer = next(
            (
                names[k]
                for k in ("equation", "input", "sensor", "parameter", "state", "channels")
                if k in names
            ),
            "",
        )
        into = f" into {names['into']}" if "into" in names else ""
        joined = f"({inner}) in {outer}" if inner else f" of {outer}"
        return f"{self.name}{joined}{into}"


def rms(values: FloatArray) -> float:
    """Return the root mean square; 1 for a signal that is zero throughout."""
    size = float(np.sqrt(np.mean(values**2))) if values.size else 0.0
    return size if size > 0.0 else 1.0
