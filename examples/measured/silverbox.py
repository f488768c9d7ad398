"""Silverbox, an electronic oscillator (Wigren & Schoukens, ECC 2013): what its linear model lacks.

Run it as ``python examples/measured/silverbox.py --json numbers.json --report silverbox.html``;
the record comes from the folder in SINDY_SURGE_BENCHMARKS, or through nonlinear-benchmarks.
"""

from measured_files import measured_file
from scipy.io import loadmat

from comparisons.missing_effect import Experiment, Model, P
from comparisons.missing_effect.script import run_script

PERIOD_S = 2**14 / 1e7

model = Model(
    name="Silverbox",
    states={"x": "V", "v": "V/s"},
    inputs={"u": "V"},
    outputs={"y": "V"},
    params={
        "stiffness": P(2e5, 1e4, 1e6, "1/s^2"),
        "damping": P(40.0, 0.0, 500.0, "1/s"),
        "gain": P(2e5, 1e4, 1e6, "1/s^2"),
        "offset": P(0.0, -0.1, 0.1, "V"),
    },
    rhs=lambda t, x, u, p: (x.v, p.gain * u.u - p.stiffness * x.x - p.damping * x.v),
    output=lambda t, x, u, p: x.x + p.offset,
    exact=("x",),
)


def rows(name: str, start: int, stop: int) -> Experiment:
    record = loadmat(measured_file("Silverbox", "SNLS80mV.mat"))
    channels = {"u": record["V1"][0, start:stop], "y": record["V2"][0, start:stop]}
    return Experiment(name, PERIOD_S, channels, settle=50)


def main() -> int:
    # The official split: three quarters of the multisine for training, the rest and the arrow.
    train = rows("training", 40650, 105712)
    tests = [
        rows("multisine", 105712, 127400),
        rows("arrow", 100, 40575),
        rows("arrow_no_extrapolation", 100, 32100),
    ]
    return run_script({"silverbox": (model, [train], tests)})


if __name__ == "__main__":
    raise SystemExit(main())
