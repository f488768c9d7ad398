"""Files that are spoiled at random: an answer or one sentence, never a traceback or a half."""

from __future__ import annotations

import json
import shlex
import shutil
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mistake import REDUCE
from mistake_checks import check_printable, check_sentence
from mistake_desk import Answer, ledger_of, rms_errors, run_in
from raw_data import to_toml

FUZZ = settings(
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
# What probes whose calibrations are a few per cent apart leave open in φ and ψ'.
TOLERATED = (0.05, 0.2)
RECONSTRUCT = "reconstruct model.json series.csv -o again.csv"
NEEDED = {
    REDUCE: ("raw.csv", "test.toml"),
    RECONSTRUCT: ("model.json", "series.csv", "series.ledger.json"),
}


@contextmanager
def desk(clean: Path, command: str) -> Iterator[Path]:
    """Give a folder with the files that a command needs."""
    with TemporaryDirectory() as name:
        for file in NEEDED[command]:
            shutil.copy(clean / file, name)
        yield Path(name)


@st.composite
def damage(draw: st.DrawFn) -> Any:
    """Return a function that damages bytes: flips, cuts, doubles, drops or overwrites some."""
    kind = draw(st.sampled_from(["flip", "cut", "drop", "double", "write"]))
    at, length = draw(st.floats(0.0, 1.0, exclude_max=True)), draw(st.integers(1, 300))
    bits, noise = draw(st.integers(1, 255)), draw(st.binary(min_size=1, max_size=12))

    def change(data: bytes) -> bytes:
        i = int(at * len(data))
        if kind == "flip":
            return data[:i] + bytes([data[i] ^ bits]) + data[i + 1 :]
        if kind == "cut":
            return data[:i]
        if kind == "drop":
            return data[:i] + data[i + length :]
        if kind == "double":
            return data[: i + length] + data[i:]
        return data[:i] + noise + data[i + len(noise) :]

    return change


def answered(answer: Answer, *outputs: str) -> bool:
    """Tell whether a command went through; fail unless it did so or refused in one sentence."""
    check_printable(answer)
    assert not answer.changed
    if answer.code == 0:
        assert set(answer.made) == set(outputs)
        return True
    check_sentence(answer)
    assert not answer.made
    return False


def right_or_flagged(clean: Path, folder: Path, names: tuple[str, ...] = ("",)) -> None:
    """Fail when a reduction gives other numbers than the clean one and names none of some."""
    told = set(ledger_of(folder)) - set(ledger_of(clean))
    words = [
        text
        for text in told
        if not text.startswith("rows")
        and "equivalent of" not in text
        and any(name in text for name in names)
    ]
    phi, psi_p = rms_errors(clean / "reduced.csv", folder / "reduced.csv")
    assert words or (phi <= TOLERATED[0] and psi_p <= TOLERATED[1]), (phi, psi_p)


def finite(file: Path, *columns: str) -> bool:
    """Whether the columns of a table hold numbers alone."""
    return bool(np.isfinite(pd.read_csv(file)[list(columns)].to_numpy()).all())


@pytest.mark.parametrize("file", ["raw.csv", "test.toml"])
@settings(FUZZ, max_examples=30)
@given(change=damage())
def test_a_damaged_record_or_description(clean: Path, change: Any, file: str) -> None:
    with desk(clean, REDUCE) as folder:
        (folder / file).write_bytes(change((folder / file).read_bytes()))
        if answered(run_in(folder, REDUCE), "reduced.csv", "reduced.ledger.json"):
            assert finite(folder / "reduced.csv", "phi", "psi_p")
            # What a description says cannot be compared with anything.
            if file == "raw.csv":
                right_or_flagged(clean, folder)


@settings(FUZZ, max_examples=40)
@given(change=damage(), file=st.sampled_from(["series.csv", "series.ledger.json", "model.json"]))
def test_a_damaged_series_ledger_or_model(clean: Path, change: Any, file: str) -> None:
    with desk(clean, RECONSTRUCT) as folder:
        (folder / file).write_bytes(change((folder / file).read_bytes()))
        if answered(run_in(folder, RECONSTRUCT), "again.csv"):
            assert finite(folder / "again.csv", "phi", "psi_p", "psi_p_reconstructed")


OTHER_VALUES = st.one_of(
    st.booleans(),
    st.integers(-(10**20), 10**20),
    st.floats(),
    st.text(max_size=20),
    st.lists(st.one_of(st.integers(), st.text(max_size=5)), max_size=3),
    st.dictionaries(st.text(min_size=1, max_size=5), st.integers(0, 9), max_size=2),
)


def leaves(tables: dict[str, Any], path: tuple[str, ...] = ()) -> list[tuple[str, ...]]:
    """Return the paths of all values, and of the tables that hold them."""
    out = []
    for key, value in tables.items():
        out.append((*path, key))
        if isinstance(value, dict):
            out += leaves(value, (*path, key))
    return out


@settings(FUZZ, max_examples=50)
@given(data=st.data(), value=OTHER_VALUES)
def test_a_value_of_another_type(clean: Path, data: st.DataObject, value: Any) -> None:
    with desk(clean, REDUCE) as folder:
        tables = tomllib.loads((folder / "test.toml").read_text("utf-8"))
        path = data.draw(st.sampled_from(leaves(tables)))
        inner = tables
        for key in path[:-1]:
            inner = inner[key]
        inner[path[-1]] = value
        (folder / "test.toml").write_text(to_toml(tables), "utf-8")
        if answered(run_in(folder, REDUCE), "reduced.csv", "reduced.ledger.json"):
            assert finite(folder / "reduced.csv", "phi", "psi_p")


@settings(FUZZ, max_examples=40)
@given(data=st.data(), value=st.one_of(OTHER_VALUES, st.none()))
def test_a_model_of_other_types(clean: Path, data: st.DataObject, value: Any) -> None:
    with desk(clean, RECONSTRUCT) as folder:
        document = json.loads((folder / "model.json").read_text("utf-8"))
        inner = document["models"]["classic_ml"]
        key = data.draw(st.sampled_from(list(inner)))
        if isinstance(inner[key], list) and data.draw(st.booleans()):
            inner, key = inner[key], data.draw(st.integers(0, len(inner[key]) - 1))
        inner[key] = value
        (folder / "model.json").write_text(json.dumps(document), "utf-8")
        if answered(run_in(folder, RECONSTRUCT), "again.csv"):
            assert finite(folder / "again.csv", "psi_p_reconstructed")


PROBES = [
    f"P{plane}_{rake}_{place}_{facing}"
    for plane in (25, 31)
    for rake in "AB"
    for place in ("tip", "hub")
    for facing in ("forward", "aft")
]
ROWS = st.tuples(st.integers(400, 1500), st.integers(30, 400)).map(lambda p: slice(p[0], sum(p)))


@st.composite
def faults(draw: st.DrawFn) -> Any:
    """Return what a failing transducer or a slip of the hand does, and which probes it names."""
    kind = draw(
        st.sampled_from(
            ["scale", "offset", "swap", "reverse", "copy", "hold", "zero", "noise", "spikes", "nan"]
        )
    )
    name, other = draw(st.permutations(PROBES).map(lambda p: p[:2]))
    rows, size = draw(ROWS), draw(st.floats(0.1, 3.0))

    def change(table: pd.DataFrame) -> pd.DataFrame:
        values = table[name].to_numpy(dtype=np.float64).copy()
        if kind == "scale":
            values[rows] = (1.0 + size) * values[rows]
        elif kind == "offset":
            values[rows] += 500.0 * size
        elif kind == "swap":
            values, table[other] = table[other].to_numpy(dtype=np.float64).copy(), values
        elif kind == "reverse":
            values = values[::-1]
        elif kind == "copy":
            values = table[other].to_numpy(dtype=np.float64).copy()
        elif kind == "hold":
            values[rows] = values[rows.start]
        elif kind == "zero":
            values[rows] = 0.0
        elif kind == "noise":
            values[rows] = np.random.default_rng(1).integers(0, 4096, rows.stop - rows.start)
        elif kind == "spikes":
            values[rows.start : rows.stop : 17] += 400.0 * size
        else:
            values[rows] = np.nan
        return table.assign(**{name: np.clip(np.round(values), 0, 4095)})

    names = {name, other} if kind in ("swap", "copy") else {name}
    pairs = {text[1:].rsplit("_", 1)[0] for text in names}
    return change, (*names, *pairs)


@settings(FUZZ, max_examples=40)
@given(fault=faults())
def test_a_faulty_channel_is_refused_flagged_or_harmless(clean: Path, fault: Any) -> None:
    change, names = fault
    with desk(clean, REDUCE) as folder:
        change(pd.read_csv(folder / "raw.csv")).to_csv(folder / "raw.csv", index=False)
        if answered(run_in(folder, REDUCE), "reduced.csv", "reduced.ledger.json"):
            right_or_flagged(clean, folder, names)


@pytest.mark.parametrize("option", ["--cutoff", "--threshold", "--filter-order"])
@settings(FUZZ, max_examples=15)
@given(value=st.one_of(st.floats().map(str), st.text(max_size=8), st.integers().map(str)))
def test_an_option_of_any_text(clean: Path, option: str, value: str) -> None:
    command = f"{REDUCE} {shlex.quote(f'{option}={value}')}"
    with desk(clean, REDUCE) as folder:
        answered(run_in(folder, command), "reduced.csv", "reduced.ledger.json")
