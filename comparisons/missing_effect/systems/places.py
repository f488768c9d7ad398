"""An effect at its place: which equation, which signal, which channel; and its scales."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field

import numpy as np

from comparisons.missing_effect.systems.model import Model
from comparisons.missing_effect.systems.shapes import Kind, Map, Term
from comparisons.missing_effect.systems.units import is_mechanical, is_speed
from surge_core.types import FloatArray

# How often the signal of an open term counts, in labels.
RAISED = {Term.SQUARE: "²", Term.SQUARE_PRODUCT: "²", Term.CUBE: "³"}
# What an effect sits at.
AT_INPUTS = (Kind.INPUT_MAP, Kind.INPUT_LAG, Kind.INPUT_DELAY, Kind.INPUT_PLAY)
AT_OUTPUTS = (Kind.OUTPUT_MAP, Kind.OUTPUT_LAG)
# Where a state ends, whatever happens there.
LIMITS = (Kind.STATE_LIMIT, Kind.OVERFLOW)
AT = {
    **dict.fromkeys((Kind.TERM, Kind.HYSTERESIS), "equation"),
    **dict.fromkeys(LIMITS, "state"),
    **dict.fromkeys(AT_INPUTS, "input"),
    **dict.fromkeys(AT_OUTPUTS, "sensor"),
    Kind.DRIFT: "parameter",
    Kind.RECORDING: "channels",
}
# What changes when a signal acts, and not how much.
DYNAMIC = (Kind.INPUT_LAG, Kind.INPUT_DELAY, Kind.INPUT_PLAY, Kind.OUTPUT_LAG, Kind.RECORDING)
LATE = tuple(kind for kind in DYNAMIC if kind != Kind.INPUT_PLAY)
# Terms whose two directions are alike, but for their sign.
ODD = (Term.LINEAR, Term.CUBE, Term.DRAG, Term.COULOMB, Term.STRIBECK, Term.GAP, Term.SINE)


def signal_names(model: Model) -> tuple[str, ...]:
    """Return what a term may act on: the states, then the inputs."""
    return (*model.state_names, *model.input_names)


@dataclass(frozen=True)
class Number:
    """One number of an effect, dimensionless inside: bounds are in units of its scale.

    The sign of an effect is part of it: an amplitude that only resists ends at zero. One that is
    held stays where the search started it.
    """

    name: str
    low: float
    high: float
    held: bool = False


@dataclass(frozen=True)
class Place:
    """Where an effect sits; −1 where something does not apply.

    At an equation (a state), an input, an output or a parameter; on a signal, states first and then
    inputs, and on another one, or on the state into which an overflow spills. The sign is −1 in an
    equation where what resists the signal is added and not subtracted.
    """

    at: int
    signal: int = -1
    other: int = -1
    sign: int = field(default=1, compare=False)


@dataclass(frozen=True)
class Neutral:
    """What an effect is called where nothing moves: of a temperature, a voltage, a level."""

    title: str
    says: str
    confirm: str


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
        ``refused(signal, measured)`` says why it cannot be shown, or an empty text: by the signal
        of the model, and by what was measured in its place, if anything was.
    confirm : str
        The measurement that would confirm it.
    own_state : bool
        Whether it brings a state of its own.
    linear : bool
        Whether its first number is an amplitude that starts at zero.
    unnamed : bool
        Whether it is an open term, without a name.
    simple_form_of : tuple of str
        Effects that are this one with something more.
    begins_afresh : bool
        Whether it makes another reading of everything, so that the model without it may be far
        off and a fit with it also begins at the user's own starts.
    centred : bool
        Whether signals that keep their sign count from their mean.
    neutral : Neutral, optional
        Its words where nothing moves; its own fit everywhere without.
    expression : callable, optional
        ``expression(model)`` gives a term of the user's own as a function of (t, x, u, p).
    """

    name: str
    kind: Kind
    code: int
    equation: str
    says: str
    numbers: tuple[Number, ...]
    places: Callable[[Model], tuple[Place, ...]]
    starts: Callable[[FloatArray], tuple[tuple[float, ...], ...]]
    refused: Callable[[FloatArray, FloatArray], str]
    confirm: str
    own_state: bool = False
    linear: bool = True
    unnamed: bool = False
    simple_form_of: tuple[str, ...] = ()
    begins_afresh: bool = False
    centred: bool = False
    neutral: Neutral | None = None
    expression: Callable[[Model], Callable[..., float]] | None = None

    @property
    def resists(self) -> bool:
        """Whether its amplitude is reported as a resistance: positive against the signal."""
        return self.equation.startswith("−")

    def allows(self, amplitude: float) -> bool:
        """Tell whether an amount of it has its sign; of one without an amplitude there is more."""
        if not self.linear:
            return amplitude > 0.0
        low, high = self.numbers[0].low, self.numbers[0].high
        return low < 0.0 if amplitude < 0.0 else high > 0.0


@dataclass(frozen=True)
class Placed:
    """An effect at a place of a model, with the scales that make its numbers dimensionless.

    Scales are those of what it enters, of its signal, and of its second signal or its time; centres
    what its two signals count from; a search of its numbers has several starts.
    """

    effect: SystemEffect
    place: Place
    scales: tuple[float, float, float]
    starts: tuple[tuple[float, ...], ...]
    centres: tuple[float, float] = (0.0, 0.0)

    @property
    def key(self) -> tuple[str, Place, int, int]:
        """What makes it the same as another: its name and place, and which of its forms it is."""
        return self.effect.name, self.place, int(self.effect.kind), self.effect.code

    @property
    def floats(self) -> tuple[float, ...]:
        """Scales, the first with the sign of the place, and centres."""
        into, own, other = self.scales
        return into * self.place.sign, own, other, *self.centres

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

    @property
    def unnamed(self) -> bool:
        """Whether it is a term without a name."""
        return self.effect.unnamed

    @property
    def brings(self) -> int:
        """How many numbers and states it adds."""
        return sum(not held for held in self.held) + self.effect.own_state

    def is_plain_form_of(self, other: Placed) -> bool:
        """Tell whether another is this one with something more, at the same place."""
        return self.place == other.place and other.name in self.effect.simple_form_of

    def bends_as(self, other: Placed) -> bool:
        """Tell whether another would do its work if its own shape were wrong.

        What comes late and a linear term are linear dynamics, both; else it is a law of the same
        one signal, in the same equation or where the signal comes from. A limit is where it is,
        whatever the shape of what goes over it.
        """
        mine, its = self.effect, other.effect
        same = self._channel[1] >= 0 and self._channel == other._channel
        if mine.kind in DYNAMIC:
            linear = its.kind == Kind.TERM and its.code == Term.LINEAR
            return linear or its.kind == Kind.RECORDING or (same and its.kind in DYNAMIC)
        elsewhere = mine.kind == its.kind == Kind.TERM and self.place.at != other.place.at
        product = its.kind == Kind.TERM and other.place.other >= 0
        shift = its.kind in (Kind.INPUT_MAP, Kind.OUTPUT_MAP) and its.code == Map.SHIFT
        is_law = not (its.kind in DYNAMIC or product or shift)
        return same and mine.kind not in LIMITS and is_law and not elsewhere

    def is_late_with(self, other: Placed) -> bool:
        """Tell whether both are lags or delays of one path: one lag may be what both are."""
        one, two = self.effect.kind, other.effect.kind
        same_end = any(one in end and two in end for end in (AT_INPUTS, AT_OUTPUTS))
        late = one in LATE and two in LATE
        return late and not (same_end and self.place.at != other.place.at)

    def shares_curve_with(self, other: Placed, one_sided: Collection[int]) -> bool:
        """Tell whether two terms of one equation are one curve of a signal.

        Both are odd or even in it; one that hardly changes its sign, of ``one_sided``, does not
        tell those apart, and a constant belongs to its curve.
        """
        pair = (self, other)
        terms = all(p.effect.kind == Kind.TERM and p.place.other < 0 for p in pair)
        if not terms or self.place.at != other.place.at:
            return False
        signals = {p.place.signal for p in pair if p.effect.code != Term.CONSTANT}
        alike = (self.effect.code in ODD) == (other.effect.code in ODD)
        constant = any(p.effect.code == Term.CONSTANT for p in pair)
        one = len(signals) == 1 and min(signals) >= 0
        return one and (signals <= set(one_sided) or (alike and not constant))

    @property
    def _channel(self) -> tuple[bool, int]:
        """Whether it sits at a sensor, and that sensor or else the signal that it acts on."""
        sensor = self.effect.kind in AT_OUTPUTS
        return sensor, self.place.at if sensor else self.place.signal

    def where(self, model: Model) -> dict[str, str]:
        """Return its place in words: equation, signal, channel."""
        key, signals = AT[self.effect.kind], signal_names(model)
        listed: dict[str, Sequence[str]] = {
            "equation": [f"d{name}/dt" for name in model.state_names],
            "state": model.state_names,
            "input": model.input_names,
            "sensor": model.output_names,
            "parameter": model.param_names,
            "channels": ("all channels",),
        }
        names = {key: listed[key][self.place.at]}
        if self.place.signal >= 0:
            names["signal"] = signals[self.place.signal]
        if self.place.other >= 0:
            second = "into" if self.effect.kind == Kind.OVERFLOW else "times"
            names[second] = signals[self.place.other]
        return names

    def label(self, model: Model) -> str:
        """Return name and place in one line, for tables: factors are joined by ``·``.

        A name that only a motion has gives way to its neutral one.
        """
        names, title = self.where(model), self.words(model).title
        name = self.name if title == self.name.replace("_", " ") else title.replace(" ", "_")
        factors = [names[k] for k in ("signal", "times") if k in names]
        if factors and self.effect.unnamed and self.effect.kind == Kind.TERM:
            factors[0] += RAISED.get(Term(self.effect.code), "")
        outer = names[AT[self.effect.kind]]
        joined = f"({'·'.join(factors)}) in {outer}" if factors else f" of {outer}"
        return f"{name}{joined}" + (f" into {names['into']}" if "into" in names else "")

    def equation(self, model: Model) -> str:
        """Return what it adds, with the signals of its place and what they count from."""
        names = self.where(model)
        signal, other = (
            f"({name} {'−' if centre > 0.0 else '+'} {abs(centre):.4g})" if centre else name
            for name, centre in zip(
                (names.get("signal", names.get("input", "")), names.get("times", "")),
                self.centres,
                strict=True,
            )
        )
        written = self.effect.equation.replace("{s}", signal).replace("{o}", other)
        return written.replace("{p}", names.get("parameter", ""))

    def words(self, model: Model) -> Neutral:
        """Return what it is called, what happens and what would confirm it, as units ask for."""
        effect, place = self.effect, self.place
        if effect.neutral is not None:
            units = [*model.states.values(), *model.inputs.values()]
            acting = units[place.at], units[place.signal if place.signal >= 0 else place.at]
            # A length alone may be a level; what moves has a speed as well.
            if not (all(map(is_mechanical, acting)) and any(map(is_speed, units))):
                return effect.neutral
        return Neutral(effect.name.replace("_", " "), effect.says, effect.confirm)


def label_of(added: Sequence[Placed], model: Model) -> str:
    """Return names and places of one effect or two in one line."""
    return " + ".join(placed.label(model) for placed in added)


def rms(values: FloatArray) -> float:
    """Return the root mean square of what is finite; 1 for a signal that is zero throughout."""
    kept = values[np.isfinite(values)]
    size = float(np.sqrt(np.mean(kept**2))) if kept.size else 0.0
    return size if size > 0.0 else 1.0
