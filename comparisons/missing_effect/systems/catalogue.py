"""The general catalogue: effects that a model of any system may lack, and where each may sit."""

from __future__ import annotations

from functools import partial

from comparisons.missing_effect.systems import catalogue_parts as parts
from comparisons.missing_effect.systems.places import Neutral, Number, SystemEffect
from comparisons.missing_effect.systems.roles import angles, displacements, rates
from comparisons.missing_effect.systems.shapes import Kind, Map, Term


# Amplitudes are in units of what the equation, or the reading, has already.
def _amplitude(symbol: str) -> Number:
    return Number(symbol, -50.0, 50.0)


def _resistance(symbol: str) -> Number:
    """Return an amplitude whose sign is part of the effect: it is subtracted."""
    return Number(symbol, -50.0, 0.0)


# Width of a change of sign, over the rms of the signal. Wider than a quarter the change is no
# friction at rest any more, but a damping that falls with amplitude.
WIDTH = Number("width", 0.004, 0.25)
WIDTH_START = 0.02

_FORCE = "a force, flow or current in this equation against the signal, both measured"
_SENSOR = "a calibration of the sensor, in rest and over its range"
_SUM = "what this equation sums up against the signal, both measured"
_DRIVE = "the drive's answer to slow steps up and down, measured behind it"

# What entries share: terms in an equation, what stands in place of an input or of a reading.
_other = partial(SystemEffect, code=0, refused=parts.always)
_term = partial(
    SystemEffect, kind=Kind.TERM, starts=parts.from_zero, refused=parts.always, confirm=_FORCE
)
_input, _reading = (
    partial(_other, kind=kind, places=places, confirm=confirm, linear=False)
    for kind, places, confirm in (
        (Kind.INPUT_MAP, parts.at_inputs, _DRIVE),
        (Kind.OUTPUT_MAP, parts.at_outputs, _SENSOR),
    )
)

SYSTEM_CATALOGUE: tuple[SystemEffect, ...] = (
    _term(
        "cubic_stiffness",
        code=Term.CUBE,
        equation="− k₃ {s}³",
        says="A restoring force that grows with the cube of the deflection: a spring that hardens "
        "or softens.",
        numbers=(_amplitude("k_3"),),
        places=parts.on(displacements),
        neutral=Neutral("cubic law", "A law that bends with the cube of the quantity.", _SUM),
    ),
    _term(
        "quadratic_stiffness",
        code=Term.SQUARE,
        equation="− k₂ {s}²",
        says="A restoring force that differs between the two directions, or a spring about another "
        "rest.",
        numbers=(_amplitude("k_2"),),
        places=parts.on(displacements),
        neutral=Neutral(
            "quadratic law", "A law that bends: its slope changes with the quantity.", _SUM
        ),
    ),
    _term(
        "quadratic_drag",
        code=Term.DRAG,
        equation="− c₂ {s}|{s}|",
        says="A resistance that grows with the square of the speed or flow: turbulence.",
        numbers=(_resistance("c_2"),),
        places=parts.on_own,
        neutral=Neutral(
            "quadratic loss", "A loss that grows with the square of the quantity.", _SUM
        ),
    ),
    _term(
        "coulomb_friction",
        code=Term.COULOMB,
        equation="− F_c sign({s})",
        says="A dry friction of constant size against the motion.",
        numbers=(_resistance("F_c"), WIDTH),
        places=parts.on_own,
        starts=parts.fixed((0.0, WIDTH_START)),
        refused=parts.both_signs,
        confirm="a slow motion in both directions: the force to keep it up",
        neutral=Neutral(
            "constant loss", "A loss of constant size that changes sign with the quantity.", _SUM
        ),
        simple_form_of=("stribeck_friction", "softening_damping"),
    ),
    _term(
        "stribeck_friction",
        code=Term.STRIBECK,
        equation="− F_c sign({s})(1 + b e^(−({s}/s_s)²))",
        says="A dry friction that is larger near rest than in motion.",
        numbers=(_resistance("F_c"), WIDTH, Number("excess", -0.5, 3.0)),
        places=parts.on_own,
        starts=parts.fixed((0.0, WIDTH_START, 0.3)),
        refused=parts.both_signs,
        confirm="a slow motion in both directions at several speeds near rest",
        neutral=Neutral(
            "loss that is larger near zero",
            "A loss that changes sign with the quantity and is larger near zero than beyond.",
            _SUM,
        ),
    ),
    _input(
        "dead_zone",
        code=Map.DEAD_ZONE,
        equation="{s} acts only beyond ± c",
        says="An input that does nothing until it exceeds a threshold.",
        numbers=(Number("threshold", 0.002, 5.0),),
        starts=parts.fixed((0.05,), (0.2,), (0.5,)),
        refused=parts.both_signs,
    ),
    _term(
        "dead_zone",
        code=Term.GAP,
        equation="− k_s ({s} beyond ± c)",
        says="A contact or a clearance: a force that sets in beyond a gap.",
        numbers=(_resistance("k_s"), Number("gap", 0.0, 5.0)),
        places=parts.against_storing,
        starts=parts.from_gap,
        neutral=Neutral(
            "loss beyond a threshold",
            "A loss that sets in where the quantity exceeds a threshold: a relief, a breakdown.",
            _SUM,
        ),
    ),
    _other(
        "backlash",
        kind=Kind.INPUT_PLAY,
        equation="{s} follows through a play ± c",
        says="A play in the drive: after each reversal the input moves without effect.",
        numbers=(Number("play", 0.002, 5.0),),
        places=parts.at_inputs,
        starts=parts.fixed((0.05,), (0.2,), (0.5,)),
        confirm=_DRIVE,
        own_state=True,
        linear=False,
    ),
    _other(
        "hysteresis",
        kind=Kind.HYSTERESIS,
        equation="− F_h z, δ dz/dt = {s} − ½|{s}|z − ½r {s}|z| (Bouc–Wen)",
        says="A force that depends on the path and not on the position alone.",
        numbers=(_resistance("F_h"), Number("reach", 0.02, 20.0), Number("ratio", -2.0, 2.0)),
        places=parts.on_own,
        starts=parts.fixed((0.0, 0.1, 1.0), (0.0, 1.0, 1.0)),
        refused=parts.both_signs,
        confirm="slow loops of several sizes: force against position",
        neutral=Neutral(
            "hysteresis",
            "What the equation sums up depends on the path and not on the present value alone.",
            "slow loops of several sizes, " + _SUM,
        ),
        own_state=True,
    ),
    _input(
        "saturation",
        code=Map.BOTH,
        equation="{s} acts only within ± c",
        says="An actuator that gives no more than its limit.",
        numbers=(Number("limit", 0.05, 10.0),),
        starts=parts.from_quantiles(*parts.THRESHOLDS),
        refused=parts.both_signs,
    ),
    _input(
        "saturation",
        code=Map.UPPER,
        equation="{s} acts only up to c",
        says="An actuator that gives no more than its limit.",
        numbers=(Number("limit", -10.0, 10.0),),
        starts=parts.from_upper_end,
    ),
    _other(
        "saturation",
        kind=Kind.STATE_LIMIT,
        code=Map.UPPER,
        equation="{s} acts only up to c",
        says="A state whose action on the others is limited, such as a magnet's flux.",
        numbers=(Number("limit", -10.0, 10.0),),
        places=parts.at_states,
        starts=parts.from_upper_end,
        confirm=_FORCE,
        linear=False,
    ),
    _other(
        "saturation",
        kind=Kind.STATE_LIMIT,
        code=Map.BOTH,
        equation="{s} acts only within ± c",
        says="A state whose action on the others is limited, such as a magnet's flux.",
        numbers=(Number("limit", 0.05, 10.0),),
        places=parts.at_states,
        starts=parts.from_quantiles(*parts.THRESHOLDS),
        refused=parts.both_signs,
        confirm=_FORCE,
        linear=False,
    ),
    _reading(
        "saturation",
        code=Map.UPPER,
        equation="reading ≤ c",
        says="A sensor at the upper end of its range.",
        numbers=(Number("limit", -10.0, 10.0),),
        starts=parts.from_upper_end,
    ),
    _reading(
        "saturation",
        code=Map.LOWER,
        equation="reading ≥ c",
        says="A sensor at the lower end of its range.",
        numbers=(Number("limit", -10.0, 10.0),),
        starts=parts.from_lower_end,
    ),
    _other(
        "overflow",
        kind=Kind.OVERFLOW,
        equation="what exceeds {s} = c spills",
        says="A vessel or a store that is full: what exceeds its rim is lost or runs into another.",
        numbers=(Number("rim", -10.0, 10.0), Number("share", 0.0, 3.0)),
        places=parts.at_spills,
        starts=parts.from_rim,
        confirm="the level, looked at, while it is filled beyond the rim",
        linear=False,
    ),
    _reading(
        "absolute_value_sensor",
        code=Map.ABSOLUTE,
        equation="reading = |y|ⁿ",
        says="A sensor that is blind to the sign, such as a pulse counter.",
        numbers=(Number("exponent", 1.0, 2.5),),
        starts=parts.fixed((1.0,), (1.8,)),
        refused=parts.blind_to_sign,
        begins_afresh=True,
    ),
    _reading(
        "rectifying_sensor",
        code=Map.RECTIFIED,
        equation="reading = max(y, 0)",
        says="A sensor that shows one direction only.",
        numbers=(),
        starts=parts.fixed(()),
        refused=parts.blind_to_sign,
        begins_afresh=True,
    ),
    _term(
        "gravity",
        code=Term.SINE,
        equation="+ g sin({s})",
        says="Gravity on a body that swings.",
        numbers=(_amplitude("g"),),
        places=parts.on(angles),
    ),
    _term(
        "gravity",
        code=Term.CONSTANT,
        equation="+ g",
        says="A constant force in the equation, such as gravity.",
        numbers=(_amplitude("g"),),
        places=parts.alone,
        confirm="the system at rest without input",
        neutral=Neutral(
            "constant offset",
            "A constant in the equation: a bias, a leak, a surrounding that was left out.",
            "the system at rest without input",
        ),
    ),
    _reading(
        "constant_bias",
        code=Map.SHIFT,
        equation="reading = y + b",
        says="A sensor with an offset.",
        numbers=(_amplitude("b"),),
        starts=parts.from_zero,
        linear=True,
    ),
    _input(
        "constant_bias",
        code=Map.SHIFT,
        equation="{s} + b",
        says="An input whose zero is off.",
        numbers=(_amplitude("b"),),
        starts=parts.from_zero,
        linear=True,
    ),
    _other(
        "transport_delay",
        kind=Kind.INPUT_DELAY,
        equation="{s}(t − d)",
        says="An input that arrives late, by more than one sample.",
        numbers=(Number("delay", 1.0, 400.0),),
        places=parts.at_inputs,
        starts=parts.fixed((2.0,), (5.0,), (15.0,), (40.0,)),
        confirm="a step of the input, and when the first answer comes",
        linear=False,
    ),
    _other(
        "further_lag",
        kind=Kind.INPUT_LAG,
        equation="T d{s}'/dt + {s}' = {s}",
        says="A lag between the input and its action: a drive, a valve, a pipe.",
        numbers=(Number("time_constant", 1.0, 2000.0),),
        places=parts.at_inputs,
        starts=parts.fixed((2.0,), (6.0,), (20.0,), (64.0,)),
        confirm=_DRIVE,
        own_state=True,
        linear=False,
    ),
    _other(
        "further_lag",
        kind=Kind.OUTPUT_LAG,
        equation="T d(reading)/dt + reading = y",
        says="A slow sensor.",
        numbers=(Number("time_constant", 1.0, 2000.0),),
        places=parts.at_outputs,
        starts=parts.fixed((2.0,), (6.0,), (20.0,), (64.0,)),
        confirm=_SENSOR,
        own_state=True,
        linear=False,
    ),
    _term(
        "asymmetric_damping",
        code=Term.SIZE,
        equation="− c_a |{s}|",
        says="A resistance that differs between the two directions.",
        numbers=(_amplitude("c_a"),),
        places=parts.on(rates),
        refused=parts.both_signs,
        confirm="a steady motion in both directions: the force to keep it up",
        neutral=Neutral(
            "loss that differs between the signs",
            "A loss that is larger for one sign of the quantity than for the other.",
            _SUM,
        ),
    ),
    _term(
        "softening_damping",
        code=Term.COULOMB,
        equation="− c_s tanh({s}/s_0)",
        says="A damping that changes with amplitude: it falls where c_s is positive, a friction "
        "whose change of sign is wide, and grows where it is negative.",
        # Of either sign: beside the model's own damping it is what that lacks.
        numbers=(_amplitude("c_s"), Number("width", WIDTH.high, 3.0)),
        places=parts.on_own,
        starts=parts.fixed((0.0, 0.5)),
        refused=parts.both_signs,
        confirm="free decay from several amplitudes",
        neutral=Neutral(
            "loss that saturates", "A loss that grows ever less with the quantity.", _SUM
        ),
    ),
    _other(
        "recording_filter",
        kind=Kind.RECORDING,
        equation="all channels behind one all-pass (1 − αs + βs²)/(1 + αs + βs²)",
        says="Inputs and outputs were recorded through the same filter: no linear model can see "
        "it, but harmonics come late.",
        numbers=(Number("alpha", -3.0, 3.0), Number("beta", 0.01, 2.0)),
        places=parts.everywhere,
        starts=parts.fixed((0.0, 0.05), (0.0, 0.15), (0.0, 0.4)),
        confirm="the recorder's answer to a step, laid on all channels",
    ),
    _other(
        "parameter_drift",
        kind=Kind.DRIFT,
        equation="{p}(1 + s t)",
        says="A parameter that changes over the record: wear, heating, a leak.",
        numbers=(Number("drift", -3.0, 3.0),),
        places=parts.at_parameters,
        starts=parts.from_zero,
        confirm="the same test again, before and after",
    ),
)


def find_system_effect(name: str) -> tuple[SystemEffect, ...]:
    """Return the entries of the general catalogue under a name.

    Parameters
    ----------
    name : str
        Identifier; several places of one effect have entries of their own.
    """
    return tuple(effect for effect in SYSTEM_CATALOGUE if effect.name == name)
