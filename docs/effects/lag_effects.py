"""Pages of the compressor's catalogue: what an effect leaves when it is hidden, who mimics it.

The truth is made by `comparisons.rig.coefficient_tests`, which shares no code with the search.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from blocks import bounds_of, table
from numpy.typing import NDArray

from classic_ml.readers.series_files import write_series
from classic_ml.series import CoefficientSeries
from comparisons.missing_effect import CATALOGUE, Diagnosis, Effect, diagnose, find_effect
from comparisons.missing_effect.catalogue import FLOW_NOISE
from comparisons.missing_effect.ranked import CandidateRow, candidate_rows
from comparisons.missing_effect.separate import separating_measurements
from comparisons.rig import HIDEABLE
from comparisons.rig.coefficient_tests import CoefficientTest, simulate_test

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests" / "support"))

from effect_data import TRUE_NAMES

__all__ = [
    "NAMES",
    "PICTURE_SEED",
    "Hidden",
    "hidden",
    "index_block",
    "measured_blocks",
    "picture_words",
    "plain_blocks",
    "write_records",
]

FloatArray = NDArray[np.float64]

STRENGTH = 1.5
DEGREE = 3
# The picture's, then those of the numbers: none of them was tuned on.
PICTURE_SEED = 3
SEEDS = tuple(range(1000, 1010))
RIVALS_SHOWN = 4
# Noise on φ is no effect of a strength in sigma: its share of φ's standard deviation is 3 %.
FLOW_NOISE_KIND = "phi3"
NAMES = (*(effect.name for effect in CATALOGUE), FLOW_NOISE.name)
KINDS = {"linear": "solved", "free": "searched", "held": "of a few values"}


@dataclass(frozen=True)
class Hidden:
    """A test with an effect hidden in it, and its diagnosis.

    Parameters
    ----------
    test : CoefficientTest
        Records and truth.
    diagnosis : Diagnosis
        What was made of the records.
    """

    test: CoefficientTest
    diagnosis: Diagnosis

    @property
    def tau_errors_percent(self) -> tuple[float, float]:
        """Relative error of τ without and with what was named."""
        d = self.diagnosis
        before, after = (
            100.0 * (t / self.test.tau_s - 1.0) for t in (d.tau_before_s, d.tau_after_s)
        )
        return before, after


@cache
def hidden(name: str, seed: int) -> Hidden:
    """Return a test with an effect in it and its diagnosis.

    Parameters
    ----------
    name : str
        Of the effect.
    seed : int
        Of the test. The flag ``in_stall`` is in the records of even seeds.
    """
    test = _test(name, seed)
    return Hidden(test, diagnose(_series(test), degree=DEGREE))


def _test(name: str, seed: int) -> CoefficientTest:
    known = seed % 2 == 0
    if name == FLOW_NOISE.name:
        return simulate_test(None, seed=seed, noise=FLOW_NOISE_KIND, degree=DEGREE, in_stall=known)
    return simulate_test(name, strength=STRENGTH, seed=seed, degree=DEGREE, in_stall=known)


def _series(test: CoefficientTest) -> list[CoefficientSeries]:
    return [
        CoefficientSeries(
            one.time_s,
            one.phi,
            one.psi_p,
            np.ones(one.phi.size, dtype=np.int64),
            T25_K=one.T25_K,
            Nc_frac=one.Nc_frac,
            in_stall=one.in_stall,
            source=f"record-{number}.csv",
        )
        for number, one in enumerate(test.records, start=1)
    ]


def write_records(name: str, folder: Path) -> list[Path]:
    """Write the records of the picture's test as series files.

    Parameters
    ----------
    name : str
        Of the effect.
    folder : path
        Made where it is missing.
    """
    folder.mkdir(parents=True, exist_ok=True)
    records = _series(_test(name, PICTURE_SEED))
    for record in records:
        write_series(record, folder / record.source)
    return [folder / record.source for record in records]


def plain_blocks(name: str) -> dict[str, str]:
    """Return the blocks that the code of an effect gives: what it is, its parameters, advice.

    Parameters
    ----------
    name : str
        Of the effect.
    """
    effect = find_effect(name)
    rows = [
        (f"`{p.name}`", p.unit, bounds_of(p.low, p.high), KINDS[p.kind]) for p in effect.parameters
    ]
    needs = f"the column `{effect.needs}`" if effect.needs in _COLUMNS else "φ and ψ' alone"
    head = f"**Port** {effect.port}. **Equation** {effect.equation}. **Needs** {needs}."
    return {
        "head": f"{head}\n\n{_sentence(effect.says)}.",
        "parameters": table(("parameter", "unit", "bounds", "found"), rows),
        "left_out": f"{_sentence(effect.on_tau)}.",
        "confirm": f"{_sentence(effect.confirm)}.",
        "commands": _commands(name),
    }


_COLUMNS = ("T25_K", "Nc_frac", "in_stall")


def _commands(name: str) -> str:
    """Say how the picture's records are made and diagnosed, and how a raw record is."""
    files = " ".join(f"records/record-{k}.csv" for k in (1, 2, 3))
    lines = [
        f"$ python docs/effects/make.py --records {name} -o records",
        f"$ sindy-surge diagnose {files} --degree {DEGREE} --separate",
    ]
    own = "The picture's three records, and what is missing from them:\n\n" + _session(lines)
    numbers = (
        f"Every number of this page is printed by `python docs/effects/make.py --only {name}`."
    )
    if name not in HIDEABLE:
        raw = "The simulated rig cannot hide it in raw counts."
    else:
        lines = [
            f"$ sindy-surge simulate --hide {name} -o rig",
            "$ sindy-surge reduce rig/raw.csv --test rig/test.toml -o series.csv",
            "$ sindy-surge diagnose series.csv",
        ]
        raw = (
            f"In raw counts of the simulated rig ({HIDEABLE[name].what}; `rig/truth` names it):\n\n"
            + _session(lines)
        )
    return f"{own}\n\n{raw}\n\n{numbers}"


def _session(lines: Sequence[str]) -> str:
    shown = "\n".join(lines)
    return f"```console\n{shown}\n```"


def _sentence(words: str) -> str:
    return words[0].upper() + words[1:] if words[0].isascii() else words


def measured_blocks(name: str, seeds: Sequence[int] = SEEDS) -> dict[str, str]:
    """Return the blocks with numbers: the picture's test, who mimics it, τ, what parts them.

    Parameters
    ----------
    name : str
        Of the effect.
    seeds : sequence of int
        Tests that the numbers are of.
    """
    tests = [hidden(name, seed) for seed in seeds]
    return {
        "picture": picture_words(name),
        "mimics": _mimics(find_effect(name), tests),
        "tau": _tau_words(name, tests),
        "apart": _apart(name, tests),
    }


def picture_words(name: str) -> str:
    """Say what was hidden in the picture's test, and what was found.

    Parameters
    ----------
    name : str
        Of the effect.
    """
    one = hidden(name, PICTURE_SEED)
    d, test = one.diagnosis, one.test
    size = _told(test, name)
    before, after = one.tau_errors_percent
    what = (
        f"Hidden here: {size}" if size else "Nothing hidden but noise on φ, 3 % of its own spread"
    )
    return (
        f"{what}; true τ {1e3 * test.tau_s:.1f} ms. The lag model without it reads τ "
        f"{_off(before)} and leaves {d.gap.before_rms / test.sigma:.2f} times the noise on "
        f"held-out rows; with what is named τ is {_off(after)} and "
        f"{d.gap.after_rms / test.sigma:.2f} times the noise is left. Verdict: `{d.verdict}`"
        f"{_names(d)}."
    )


def _off(percent: float) -> str:
    """Say an error; a few hundredths of a per cent are the noise's."""
    if abs(percent) < 0.1:
        return "right within 0.1 %"
    return f"{abs(percent):.1f} % too {'high' if percent > 0.0 else 'low'}"


def _names(d: Diagnosis) -> str:
    return "".join(f", {' or '.join(f'`{n}`' for n in item.alias_set)}" for item in d.missing)


def _told(test: CoefficientTest, name: str) -> str:
    """Say what was hidden, under the catalogue's names where its form is the truth's."""
    truth = test.effects.get(name, {})
    names = TRUE_NAMES.get(name, {})
    if not names:
        return ", ".join(f"{key} = {value:.3g}" for key, value in truth.items())
    units = {p.name: p.unit for p in find_effect(name).parameters}
    return ", ".join(
        f"{own} = {truth[other]:.3g}" + (f" {units[own]}" if units[own] != "1" else "")
        for own, other in names.items()
    )


def _mimics(effect: Effect, tests: Sequence[Hidden]) -> str:
    if effect.name == FLOW_NOISE.name:
        return _verdicts(tests)
    rows = [_first_round(one.diagnosis) for one in tests]
    own = [next((r for r in round_ if r.name == effect.name), None) for round_ in rows]
    shares: dict[str, list[float]] = {}
    for round_, mine in zip(rows, own, strict=True):
        for row in round_:
            if mine is not None and row.kind == "name" and row.name != effect.name:
                shares.setdefault(row.name, []).append(row.train_gain / mine.train_gain)
    sets = [{n for item in one.diagnosis.missing for n in item.alias_set} for one in tests]
    order = sorted(
        shares, key=lambda n: (-sum(n in s for s in sets), -len(shares[n]) * median(shares[n]))
    )
    listed = [
        (
            f"[`{name}`]({name}.md)",
            f"{100.0 * median(shares[name]):.0f} %",
            f"{len(shares[name])} of {len(tests)}",
            f"{sum(name in s for s in sets)} of {len(tests)}",
        )
        for name in order[:RIVALS_SHOWN]
    ]
    unique = sum(s == {effect.name} for s in sets)
    inside = sum(effect.name in s for s in sets)
    doubted = sum(one.diagnosis.verdict == "provisional" for one in tests)
    head = (
        f"Hidden in {len(tests)} tests, it was named alone in {unique}, in the named set in "
        f"{inside}, provisionally in {doubted}."
    )
    if not listed:
        return f"{head} No other effect was worth a fit."
    heads = ("rival in its place", "gain, of the truth's", "worth a fit in", "in the set in")
    return f"{head}\n\n{table(heads, listed)}"


def _verdicts(tests: Sequence[Hidden]) -> str:
    counts: dict[str, int] = {}
    for one in tests:
        counts[one.diagnosis.verdict] = counts.get(one.diagnosis.verdict, 0) + 1
    said = ", ".join(f"`{name}` in {n}" for name, n in sorted(counts.items(), key=lambda x: -x[1]))
    told = sum(FLOW_NOISE.name in one.diagnosis.names for one in tests)
    return (
        f"Noise of 3 % on φ in {len(tests)} tests with nothing else missing gave the verdict "
        f"{said}; it was told as `flow_noise` in {told}."
    )


def _first_round(d: Diagnosis) -> list[CandidateRow]:
    return [row for row in candidate_rows(d) if row.round == 1]


def _tau_words(name: str, tests: Sequence[Hidden]) -> str:
    before = [one.tau_errors_percent[0] for one in tests]
    after = [one.tau_errors_percent[1] for one in tests]
    signs = sum(b > 0.0 for b in before)
    lean = "too high" if signs == len(tests) else "too low" if signs == 0 else "either way"
    said = (
        f"Over the {len(tests)} tests τ without it is off by {_size(before)} in the median and "
        f"{max(map(abs, before)):.1f} % at most, {lean}; with what is named, by {_size(after)} "
        f"in the median and {max(map(abs, after)):.1f} % at most."
    )
    rivals: dict[str, list[float]] = {}
    for one in tests:
        for other, tau_s in one.diagnosis.tau_by_alias_s.items():
            if other != name:
                rivals.setdefault(other, []).append(100.0 * (tau_s / one.test.tau_s - 1.0))
    wrong = ", ".join(f"`{other}` {_size(errors)}" for other, errors in sorted(rivals.items()))
    said += _in_own_times(name, tests)
    return said + (f" Under the other names of the sets τ is off by: {wrong}." if wrong else "")


def _in_own_times(name: str, tests: Sequence[Hidden]) -> str:
    """Say how large the error of τ is beside the time that was left out."""
    if name not in ("transport_delay", "second_order_lag"):
        return ""
    ratios = [
        (one.diagnosis.tau_before_s - one.test.tau_s) / _left_out_s(name, one.test) for one in tests
    ]
    what = "the delay" if name == "transport_delay" else "the second time constant"
    low, high = min(ratios), max(ratios)
    return (
        f" The error without it is {low:.1f} to {high:.1f} times {what}, {median(ratios):.1f} in "
        "the median."
    )


def _left_out_s(name: str, test: CoefficientTest) -> float:
    truth = test.effects[name]
    if name == "transport_delay":
        return truth["delay_s"]
    a2_s2, tau_s = truth["a2_s2"], test.tau_s
    return 2.0 * a2_s2 / (tau_s + float(np.sqrt(tau_s**2 - 4.0 * a2_s2)))


def _size(errors: Sequence[float]) -> str:
    return f"{median(map(abs, errors)):.2f} %"


def _apart(name: str, tests: Sequence[Hidden]) -> str:
    found = (one for one in tests if any(len(i.alias_set) > 1 for i in one.diagnosis.missing))
    first: Any = next(found, None)
    if first is None:
        return (
            f"In none of the {len(tests)} tests was it in a set with another name, so that "
            "`--separate` has nothing to tell apart."
        )
    seed = next(s for s in (*SEEDS, PICTURE_SEED) if hidden(name, s) is first)
    lines = separating_measurements(first.diagnosis).lines
    return (
        f"In the first of the tests with a set (seed {seed}) `--separate` says:\n\n"
        "```text\n" + "\n".join(lines) + "\n```"
    )


def index_block() -> str:
    """Return the table of the catalogue: port, name, equation, what happens."""
    rows = [
        (effect.port, f"[`{effect.name}`]({effect.name}.md)", effect.equation, effect.says)
        for effect in map(find_effect, NAMES)
    ]
    return table(("port", "effect", "equation", "what happens"), rows)
