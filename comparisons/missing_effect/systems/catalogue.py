"""The general catalogue: effects that a model of any system may lack, and where each may sit."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from classic_ml.records import FloatArray
from comparisons.missing_effect.systems.model import Model
from comparisons.missing_effect.systems.places import Number, Place, SystemEffect
from comparisons.missing_effect.systems.roles import (
    angles,
    displacements,
    free_equations,
    physical,
    rates,
)
from comparisons.missing_effect.systems.shapes import Kind, Map, Term

__all__ = ["OPEN_TERMS", "SYSTEM_CATALOGUE", "find_system_effect"]

Places = Callable[[Model], tuple[Place, ...]]
Starts = Callable[[FloatArray], tuple[tuple[float, ...], ...]]


# Amplitudes are in units of what the equation, or the reading, has already.
def _amplitude(symbol: str) -> Number:
    return Number(symbol, -50.0, 50.0)


# Width of a change of sign, over the rms of the signal. Wider than a quarter the change is no
# friction at rest any more, but a damping that falls with amplitude.
WIDTH = Number("width", 0.004, 0.25)
WIDTH_START = 0.02
# A sign means something only where the signal spends time on both sides of it: this share of the
# samples beyond a twentieth of its rms, either way.
LEAST_SIDE_SHARE = 0.02
SIDE = 0.05
# Quantiles of the size of a signal at which thresholds start.
THRESHOLDS = (0.98, 0.85, 0.6)


def _on(signals: Callable[[Model], Sequence[int]]) -> Places:
    """Return places in every equation that is not exact, on some signals."""

    def places(model: Model) -> tuple[Place, ...]:
        return tuple(Place(i, s) for i in free_equations(model) for s in signals(model))

    return places


def _alone(model: Model) -> tuple[Place, ...]:
    return tuple(Place(i) for i in free_equations(model))


def _inputs(model: Model) -> tuple[Place, ...]:
    n = len(model.states)
    return tuple(Place(j, n + j) for j in range(len(model.inputs)))


def _outputs(model: Model) -> tuple[Place, ...]:
    return tuple(Place(j) for j in range(len(model.outputs)))


def _parameters(model: Model) -> tuple[Place, ...]:
    return tuple(Place(j) for j in range(len(model.params)))


def _everywhere(_: Model) -> tuple[Place, ...]:
    return (Place(-1),)


def _states(model: Model) -> tuple[Place, ...]:
    return tuple(Place(i, i) for i in physical(model))


def _spills(model: Model) -> tuple[Place, ...]:
    """Return every state that may spill: lost, or into each other state of the same unit."""
    out = []
    free = free_equations(model)
    units = list(model.states.values())
    for i in (i for i in displacements(model) if i in free):
        out.append(Place(i, i, -1))
        out += [Place(i, i, j) for j in free if j != i and units[j] == units[i]]
    return tuple(out)


def _input_signals(model: Model) -> tuple[int, ...]:
    n = len(model.states)
    return tuple(range(n, n + len(model.inputs)))


def _every_signal(model: Model) -> tuple[int, ...]:
    return (*physical(model), *_input_signals(model))


def _products(model: Model) -> tuple[Place, ...]:
    pairs = [(a, b) for a in _every_signal(model) for b in _every_signal(model) if a < b]
    return tuple(Place(i, a, b) for i in free_equations(model) for a, b in pairs)


def _zero(_: FloatArray) -> tuple[tuple[float, ...], ...]:
    return ((0.0,),)


def _fixed(*starts: tuple[float, ...]) -> Starts:
    return lambda _: starts


def _quantiles(*shares: float) -> Starts:
    def starts(signal: FloatArray) -> tuple[tuple[float, ...], ...]:
        return tuple((float(v),) for v in np.quantile(np.abs(signal), shares))

    return starts


def _upper(signal: FloatArray) -> tuple[tuple[float, ...], ...]:
    return tuple((float(v),) for v in np.quantile(signal, THRESHOLDS))


def _lower(signal: FloatArray) -> tuple[tuple[float, ...], ...]:
    return tuple((float(v),) for v in np.quantile(signal, [1.0 - q for q in THRESHOLDS]))


def _spill_starts(signal: FloatArray) -> tuple[tuple[float, ...], ...]:
    return tuple((float(v), 1.0) for v in np.quantile(signal, THRESHOLDS))


def _gap_starts(signal: FloatArray) -> tuple[tuple[float, ...], ...]:
    return tuple((0.0, float(v)) for v in np.quantile(np.abs(signal), (0.3, 0.6, 0.85)))


def _always(_: FloatArray) -> str:
    return ""


def both_signs(signal: FloatArray) -> str:
    """Return why a signal does not change sign, or an empty text.

    Parameters
    ----------
    signal : ndarray
        Over its rms.
    """
    share = min(float(np.mean(signal > SIDE)), float(np.mean(signal < -SIDE)))
    return "" if share >= LEAST_SIDE_SHARE else "needs a signal that changes sign"


def one_side(reading: FloatArray) -> str:
    """Return why a reading cannot come from a sensor that shows one side only, or an empty text.

    Parameters
    ----------
    reading : ndarray
        Over its rms. Noise may take a few readings below zero.
    """
    beyond = float(np.mean(reading < -SIDE))
    return "" if beyond <= LEAST_SIDE_SHARE else "needs a reading that stays on one side of zero"


_FORCE = "a force, flow or current in this equation against the signal, both measured"
_SENSOR = "a calibration of the sensor, in rest and over its range"
_DRIVE = "the drive's answer to slow steps up and down, measured behind it"

SYSTEM_CATALOGUE: tuple[SystemEffect, ...] = (
    SystemEffect(
        "cubic_stiffness",
        Kind.TERM,
        Term.CUBE,
        "− k₃ {s}³",
        "A restoring force that grows with the cube of the deflection: a hardening or softening "
        "spring.",
        (_amplitude("k_3"),),
        _on(displacements),
        _zero,
        _always,
        _FORCE,
    ),
    SystemEffect(
        "quadratic_stiffness",
        Kind.TERM,
        Term.SQUARE,
        "− k₂ {s}²",
        "A restoring force that differs between the two directions, or a spring about another "
        "rest.",
        (_amplitude("k_2"),),
        _on(displacements),
        _zero,
        _always,
        _FORCE,
    ),
    SystemEffect(
        "quadratic_drag",
        Kind.TERM,
        Term.DRAG,
        "− c₂ {s}|{s}|",
        "A resistance that grows with the square of the speed or flow: turbulence.",
        (_amplitude("c_2"),),
        _on(rates),
        _zero,
        _always,
        _FORCE,
    ),
    SystemEffect(
        "coulomb_friction",
        Kind.TERM,
        Term.COULOMB,
        "− F_c sign({s})",
        "A dry friction of constant size against the motion.",
        (_amplitude("F_c"), WIDTH),
        _on(rates),
        _fixed((0.0, WIDTH_START)),
        both_signs,
        "a slow motion in both directions: the force to keep it up",
        simple_form_of=("stribeck_friction", "softening_damping"),
    ),
    SystemEffect(
        "stribeck_friction",
        Kind.TERM,
        Term.STRIBECK,
        "− F_c sign({s})(1 + b e^(−({s}/s_s)²))",
        "A dry friction that is larger near rest than in motion.",
        (_amplitude("F_c"), WIDTH, Number("excess", -0.5, 3.0)),
        _on(rates),
        _fixed((0.0, WIDTH_START, 0.3)),
        both_signs,
        "a slow motion in both directions at several speeds near rest",
    ),
    SystemEffect(
        "dead_zone",
        Kind.INPUT_MAP,
        Map.DEAD_ZONE,
        "{s} acts only beyond ± c",
        "An input that does nothing until it exceeds a threshold.",
        (Number("threshold", 0.002, 5.0),),
        _inputs,
        _fixed((0.05,), (0.2,), (0.5,)),
        both_signs,
        _DRIVE,
        linear=False,
    ),
    SystemEffect(
        "dead_zone",
        Kind.TERM,
        Term.GAP,
        "− k_s ({s} beyond ± c)",
        "A contact or a clearance: a force that sets in beyond a gap.",
        (_amplitude("k_s"), Number("gap", 0.0, 5.0)),
        _on(displacements),
        _gap_starts,
        _always,
        _FORCE,
    ),
    SystemEffect(
        "backlash",
        Kind.INPUT_PLAY,
        0,
        "{s} follows through a play ± c",
        "A play in the drive: after each reversal the input moves without effect.",
        (Number("play", 0.002, 5.0),),
        _inputs,
        _fixed((0.05,), (0.2,), (0.5,)),
        _always,
        _DRIVE,
        own_state=True,
        linear=False,
    ),
    SystemEffect(
        "hysteresis",
        Kind.HYSTERESIS,
        0,
        "− F_h z, δ dz/dt = {s} − ½|{s}|z − ½{s}|z| (Bouc–Wen)",
        "A force that depends on the path and not on the position alone.",
        (_amplitude("F_h"), Number("reach", 0.02, 20.0)),
        _on(rates),
        _fixed((0.0, 0.1), (0.0, 1.0)),
        both_signs,
        "slow loops of several sizes: force against position",
        own_state=True,
    ),
    SystemEffect(
        "saturation",
        Kind.INPUT_MAP,
        Map.BOTH,
        "{s} acts only within ± c",
        "An actuator that gives no more than its limit.",
        (Number("limit", 0.05, 10.0),),
        _inputs,
        _quantiles(*THRESHOLDS),
        both_signs,
        _DRIVE,
        linear=False,
    ),
    SystemEffect(
        "saturation",
        Kind.INPUT_MAP,
        Map.UPPER,
        "{s} acts only up to c",
        "An actuator that gives no more than its limit.",
        (Number("limit", -10.0, 10.0),),
        _inputs,
        _upper,
        _always,
        _DRIVE,
        linear=False,
    ),
    SystemEffect(
        "saturation",
        Kind.STATE_LIMIT,
        Map.UPPER,
        "{s} acts only up to c",
        "A state whose action on the others is limited, such as a magnet's flux.",
        (Number("limit", -10.0, 10.0),),
        _states,
        _upper,
        _always,
        _FORCE,
        linear=False,
    ),
    SystemEffect(
        "saturation",
        Kind.STATE_LIMIT,
        Map.BOTH,
        "{s} acts only within ± c",
        "A state whose action on the others is limited, such as a magnet's flux.",
        (Number("limit", 0.05, 10.0),),
        _states,
        _quantiles(*THRESHOLDS),
        both_signs,
        _FORCE,
        linear=False,
    ),
    SystemEffect(
        "saturation",
        Kind.OUTPUT_MAP,
        Map.UPPER,
        "reading ≤ c",
        "A sensor at the upper end of its range.",
        (Number("limit", -10.0, 10.0),),
        _outputs,
        _upper,
        _always,
        _SENSOR,
        linear=False,
    ),
    SystemEffect(
        "saturation",
        Kind.OUTPUT_MAP,
        Map.LOWER,
        "reading ≥ c",
        "A sensor at the lower end of its range.",
        (Number("limit", -10.0, 10.0),),
        _outputs,
        _lower,
        _always,
        _SENSOR,
        linear=False,
    ),
    SystemEffect(
        "overflow",
        Kind.OVERFLOW,
        0,
        "what exceeds {s} = c spills",
        "A vessel or a store that is full: what exceeds its rim is lost, or runs into another.",
        (Number("rim", -10.0, 10.0), Number("share", 0.0, 3.0)),
        _spills,
        _spill_starts,
        _always,
        "the level, looked at, while it is filled beyond the rim",
        linear=False,
    ),
    SystemEffect(
        "absolute_value_sensor",
        Kind.OUTPUT_MAP,
        Map.ABSOLUTE,
        "reading = |y|",
        "A sensor that is blind to the sign, such as a pulse counter.",
        (),
        _outputs,
        _fixed(()),
        one_side,
        _SENSOR,
        linear=False,
    ),
    SystemEffect(
        "rectifying_sensor",
        Kind.OUTPUT_MAP,
        Map.RECTIFIED,
        "reading = max(y, 0)",
        "A sensor that shows one direction only.",
        (),
        _outputs,
        _fixed(()),
        one_side,
        _SENSOR,
        linear=False,
    ),
    SystemEffect(
        "gravity",
        Kind.TERM,
        Term.SINE,
        "+ g sin({s})",
        "Gravity on a body that swings.",
        (_amplitude("g"),),
        _on(angles),
        _zero,
        _always,
        _FORCE,
    ),
    SystemEffect(
        "gravity",
        Kind.TERM,
        Term.CONSTANT,
        "+ g",
        "A constant force, flow or current in the equation, such as gravity.",
        (_amplitude("g"),),
        _alone,
        _zero,
        _always,
        "the system at rest without input",
    ),
    SystemEffect(
        "constant_bias",
        Kind.OUTPUT_MAP,
        Map.SHIFT,
        "reading = y + b",
        "A sensor with an offset.",
        (_amplitude("b"),),
        _outputs,
        _zero,
        _always,
        _SENSOR,
    ),
    SystemEffect(
        "constant_bias",
        Kind.INPUT_MAP,
        Map.SHIFT,
        "{s} + b",
        "An input whose zero is off.",
        (_amplitude("b"),),
        _inputs,
        _zero,
        _always,
        _DRIVE,
    ),
    SystemEffect(
        "transport_delay",
        Kind.INPUT_DELAY,
        0,
        "{s}(t − d)",
        "An input that arrives late, by more than one sample.",
        (Number("delay", 1.0, 400.0),),
        _inputs,
        _fixed((2.0,), (5.0,), (15.0,), (40.0,)),
        _always,
        "a step of the input, and when the first answer comes",
        linear=False,
    ),
    SystemEffect(
        "further_lag",
        Kind.INPUT_LAG,
        0,
        "T d{s}'/dt + {s}' = {s}",
        "A lag between the input and its action: a drive, a valve, a pipe.",
        (Number("time_constant", 1.0, 2000.0),),
        _inputs,
        _fixed((2.0,), (6.0,), (20.0,), (64.0,)),
        _always,
        _DRIVE,
        own_state=True,
        linear=False,
    ),
    SystemEffect(
        "further_lag",
        Kind.OUTPUT_LAG,
        0,
        "T d(reading)/dt + reading = y",
        "A slow sensor.",
        (Number("time_constant", 1.0, 2000.0),),
        _outputs,
        _fixed((2.0,), (6.0,), (20.0,), (64.0,)),
        _always,
        _SENSOR,
        own_state=True,
        linear=False,
    ),
    SystemEffect(
        "asymmetric_damping",
        Kind.TERM,
        Term.SIZE,
        "− c_a |{s}|",
        "A resistance that differs between the two directions.",
        (_amplitude("c_a"),),
        _on(rates),
        _zero,
        both_signs,
        "a steady motion in both directions: the force to keep it up",
    ),
    SystemEffect(
        "softening_damping",
        Kind.TERM,
        Term.COULOMB,
        "− c_s tanh({s}/s_0)",
        "A damping that falls with amplitude: a friction whose change of sign is wide.",
        (_amplitude("c_s"), Number("width", WIDTH.high, 3.0)),
        _on(rates),
        _fixed((0.0, 0.5)),
        both_signs,
        "free decay from several amplitudes",
    ),
    SystemEffect(
        "recording_filter",
        Kind.RECORDING,
        0,
        "all channels behind one all-pass (1 − αs + βs²)/(1 + αs + βs²)",
        "Inputs and outputs were recorded through the same filter: no linear model can see it, "
        "but harmonics come late.",
        (Number("alpha", -3.0, 3.0), Number("beta", 0.01, 2.0)),
        _everywhere,
        _fixed((0.0, 0.05), (0.0, 0.15), (0.0, 0.4)),
        _always,
        "the recorder's answer to a step, laid on all channels",
    ),
    SystemEffect(
        "parameter_drift",
        Kind.DRIFT,
        0,
        "{p}(1 + s t)",
        "A parameter that changes over the record: wear, heating, a leak.",
        (Number("drift", -3.0, 3.0),),
        _parameters,
        _zero,
        _always,
        "the same test again, before and after",
    ),
)

_OPEN = "a term without a name"

# What would be found where no name fits: general terms, and readings with a bend.
OPEN_TERMS: tuple[SystemEffect, ...] = tuple(
    SystemEffect(
        f"open_{name}",
        kind,
        code,
        equation,
        _OPEN,
        (_amplitude("c_s"),),
        places,
        _zero,
        _always,
        "",
        unnamed=True,
    )
    for name, kind, code, equation, places in (
        ("product", Kind.TERM, Term.PRODUCT, "+ c {s}·{o}", _products),
        ("linear", Kind.TERM, Term.LINEAR, "+ c {s}", _on(_every_signal)),
        ("square", Kind.TERM, Term.SQUARE, "+ c {s}²", _on(_input_signals)),
        ("cube", Kind.TERM, Term.CUBE, "+ c {s}³", _on(_input_signals)),
        ("rate_square", Kind.TERM, Term.SQUARE, "+ c {s}²", _on(rates)),
        ("rate_cube", Kind.TERM, Term.CUBE, "+ c {s}³", _on(rates)),
        ("reading_square", Kind.OUTPUT_MAP, Map.SQUARE, "y + c y²", _outputs),
        ("reading_cube", Kind.OUTPUT_MAP, Map.CUBE, "y + c y³", _outputs),
    )
)


def find_system_effect(name: str) -> tuple[SystemEffect, ...]:
    """Return the entries of the general catalogue under a name.

    Parameters
    ----------
    name : str
        Identifier; several places of one effect have entries of their own.
    """
    return tuple(effect for effect in SYSTEM_CATALOGUE if effect.name == name)
