"""EMPS, the prismatic joint of a robot (Janot, Gautier & Brunot 2019): what its linear model lacks.

Run it as ``python examples/measured/emps.py --json numbers.json --report emps.html``; the records
come from the folder in SINDY_SURGE_BENCHMARKS, or through nonlinear-benchmarks. The joint is
looked at twice: with its controller, and from the control signal alone.
"""

from measured_files import measured_file
from scipy.io import loadmat

from comparisons.missing_effect import Experiment, Model, P
from comparisons.missing_effect.script import run_script

FORCE_PER_VOLT = 35.150651882485
POSITION_GAIN, VELOCITY_GAIN = 160.18, 243.45

JOINT = {
    "mass": P(100.0, 20.0, 500.0, "kg"),
    "viscous": P(200.0, 0.0, 2000.0, "N s/m"),
    "force_offset": P(0.0, -50.0, 50.0, "N"),
}


closed_loop = Model(
    name="EMPS with its controller",
    states={"q": "m", "v": "m/s", "rate": "m/s"},
    inputs={"reference": "m", "pulses": "V"},
    outputs={"position": "m", "control_signal": "V"},
    params={**JOINT, "rate_filter": P(1e-3, 2e-4, 1e-2, "s")},
    rhs=lambda t, x, u, p: (
        x.v,
        (
            FORCE_PER_VOLT
            * (VELOCITY_GAIN * (POSITION_GAIN * (u.reference - x.q) - x.rate) + u.pulses)
            - p.viscous * x.v
            + p.force_offset
        )
        / p.mass,
        (x.v - x.rate) / p.rate_filter,
    ),
    output=lambda t, x, u, p: (
        x.q,
        VELOCITY_GAIN * (POSITION_GAIN * (u.reference - x.q) - x.rate) + u.pulses,
    ),
    exact=("q", "rate"),
    balance={"v": ("mass", "N")},
)

open_loop = Model(
    name="EMPS from its control signal",
    states={"q": "m", "v": "m/s"},
    inputs={"control_signal": "V"},
    outputs={"position": "m"},
    params=JOINT,
    rhs=lambda t, x, u, p: (
        x.v,
        (FORCE_PER_VOLT * u.control_signal - p.viscous * x.v + p.force_offset) / p.mass,
    ),
    output=lambda t, x, u, p: x.q,
    exact=("q",),
    balance={"v": ("mass", "N")},
)


def experiment(name: str, file: str) -> Experiment:
    record = loadmat(measured_file("EMPS", file))
    columns = {"reference": "qg", "position": "qm", "control_signal": "vir", "pulses": "pulses_N"}
    channels = {
        channel: record[key].ravel() if key in record else 0.0 * record["qm"].ravel()
        for channel, key in columns.items()
    }
    return Experiment(name, 1e-3, channels, settle=20)


def main() -> int:
    train = [experiment("training", "DATA_EMPS.mat")]
    pulses = "DATA_EMPS_PULSES.mat"
    return run_script(
        {
            "closed_loop": (closed_loop, train, [experiment("closed_loop", pulses)]),
            "open_loop": (open_loop, train, [experiment("position_open_loop", pulses)]),
        }
    )


if __name__ == "__main__":
    raise SystemExit(main())
