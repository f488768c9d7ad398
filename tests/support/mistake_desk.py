"""The desk where mistakes are handed in: clean files, a command, and what it left behind."""

from __future__ import annotations

import contextlib
import io
import json
import os
import shlex
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from mistake import REDUCE, Mistake
from raw_data import RawTest, make_test

from comparisons.cli import main
from comparisons.harness.saved_models import save_models
from comparisons.results import FittedLag
from comparisons.total_system import facility_toml
from comparisons.total_system.facility import facility_of_case

FITTED = FittedLag(
    "classic_ml",
    "psi_p",
    0.018,
    0.001,
    ("1", "phi", "phi^2"),
    (1.2, 3.0, 45.0),
    (0.02, 0.3, 2.0),
    "first",
    (0.0, 0.2),
    ((0.0, 1.2, 0.02), (0.1, 1.95, 0.02), (0.2, 3.6, 0.05)),
    8,
    covariance=(1e-6, 0.0, 0.0, 0.0, 0.0, 4e-4, 0.0, 0.0, 0.0, 0.0, 0.09, 0.0, 0.0, 0.0, 0.0, 4.0),
    free_run_rms=0.02,
)
STUDY = """schema = "sindy-surge/study/1"
seeds = 2

[record]
source = "coefficients"
duration_s = 5.0
noise_percent = [1.0, 5.0]

[[method]]
name = "classic_ml"
"""
OSCILLATOR = """from comparisons.missing_effect import Model, P

model = Model(
    states={"q": "m", "v": "m/s"},
    inputs={"force": "N"},
    outputs={"position": "m"},
    params={"stiffness": P(900, 100, 5000, "N/m"), "viscous": P(5, 0, 200, "N s/m")},
    rhs=lambda t, x, u, p: (x.v, (u.force - p.viscous * x.v - p.stiffness * x.q) / 10.0),
    output=lambda t, x, u, p: x.q,
    exact=("q",),
)
"""
CLEAN: dict[str, Any] = {"seed": 0, "seconds": 2.0, "noise_counts": 1.0, "cells_lbm_s": 6.0}


@dataclass(frozen=True)
class Answer:
    """What a command said and left behind: files that are new, and those that changed."""

    code: int
    out: str
    err: str
    made: tuple[str, ...]
    changed: tuple[str, ...]


def clean_test() -> RawTest:
    """Return the test that all mistakes are made in."""
    return make_test(**CLEAN)


def clean_files(folder: Path) -> Path:
    """Write the clean files into a folder: record, description, and the series they reduce to."""
    clean_test().write(folder)
    done = run_in(folder, REDUCE)
    assert done.code == 0, done.err
    shutil.copy(folder / "reduced.csv", folder / "series.csv")
    shutil.copy(folder / "reduced.ledger.json", folder / "series.ledger.json")
    save_models({"classic_ml": FITTED}, folder / "model.json")
    (folder / "facility.toml").write_text(facility_toml(facility_of_case("985")), "utf-8")
    (folder / "study.toml").write_text(STUDY, "utf-8")
    (folder / "model.py").write_text(OSCILLATOR, "utf-8")
    (folder / "train.csv").write_text(_oscillation(), "utf-8")
    return folder


def run_in(folder: Path, command: str) -> Answer:
    """Run a command of ``sindy-surge`` in a folder, in this process."""
    before = _contents(folder)
    out, err = io.StringIO(), io.StringIO()
    with _working_in(folder), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = main(shlex.split(command))
        except SystemExit as stop:
            code = stop.code if isinstance(stop.code, int) else 1
    after = _contents(folder)
    return Answer(
        code,
        out.getvalue(),
        err.getvalue(),
        tuple(sorted(set(after) - set(before))),
        tuple(sorted(n for n in before if after.get(n) != before[n])),
    )


def hand_in(mistake: Mistake, clean: Path, folder: Path) -> Answer:
    """Copy the clean files into a folder, spoil them, and run the command there."""
    for file in clean.iterdir():
        if file.name not in ("reduced.csv", "reduced.ledger.json"):
            shutil.copy(file, folder / file.name)
    mistake.spoil(folder)
    return run_in(folder, mistake.command)


def ledger_of(folder: Path, name: str = "reduced") -> list[str]:
    """Return the flags and drops of a reduction, one sentence each."""
    entries: list[dict[str, Any]] = json.loads((folder / f"{name}.ledger.json").read_text("utf-8"))
    flags = [flag for entry in entries for flag in entry["flags"]]
    drops = [drop for entry in entries for drop in entry["dropped"]]
    return flags + [f"{d['what']} ({d['count']}): {d['why']}" for d in drops]


def rms_errors(clean: Path, spoiled: Path) -> tuple[float, float]:
    """Return the rms differences of φ and ψ' on the rows that both reductions would fit."""
    one, other = (pd.read_csv(file) for file in (clean, spoiled))
    for read in (one, other):
        values = read[["phi", "psi_p"]].to_numpy()
        assert np.isfinite(values).all()
    rows = min(len(one), len(other))
    both = (one["segment"][:rows] > 0) & (other["segment"][:rows] > 0)
    assert both.sum() > 100, "nothing to compare"
    differences = (one[["phi", "psi_p"]] - other[["phi", "psi_p"]])[:rows][both]
    phi, psi_p = np.sqrt((differences**2).mean())
    return float(phi), float(psi_p)


def _oscillation() -> str:
    """Return a measured run of the oscillator of the model file, as CSV."""
    rng = np.random.default_rng(4)
    force, q, v = 50.0 * np.repeat(rng.standard_normal(40), 10), 0.0, 0.0
    rows = ["time_s,force,position"]
    for i, f in enumerate(force):
        rows.append(f"{i / 100:.2f},{f:.6f},{q + 1e-4 * rng.standard_normal():.8f}")
        for _ in range(10):
            v += 1e-3 * (f - 8.0 * v - 1000.0 * q) / 10.0
            q += 1e-3 * v
    return "\n".join(rows) + "\n"


def _contents(folder: Path) -> dict[str, bytes]:
    return {
        str(file.relative_to(folder)): file.read_bytes()
        for file in sorted(folder.rglob("*"))
        if file.is_file()
    }


@contextlib.contextmanager
def _working_in(folder: Path) -> Iterator[None]:
    before = Path.cwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)
