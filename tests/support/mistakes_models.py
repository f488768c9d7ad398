"""Mistakes in saved models, model files, measured records, studies and facilities."""

from __future__ import annotations

import io
import json
import pickle
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from mistake import HARMLESS, REFUSED, Mistake, Spoil
from mistakes_raw_files import NOISE
from spoiling import as_text, replaced, toml, written

__all__ = ["CANARY", "EXPERIMENTS", "FACILITIES", "MODELS", "STUDIES", "Trap"]

RUN = "reconstruct model.json series.csv -o again.csv"
OWN = "diagnose --model model.py --fit train.csv --report own.html"
STUDY = "study study.toml --out study --jobs 1"
SYSTEM = "total-system raw.csv --test test.toml --facility facility.toml --json system.json"
# A file that a pickle would make if anybody loaded it.
CANARY = "loaded"


class Trap:
    """A pickle that leaves a file behind when it is loaded."""

    def __reduce__(self) -> tuple[Any, ...]:
        """Return what loading calls."""
        return (Path.touch, (Path(CANARY),))


def _model(change: Callable[[dict[str, Any]], Any]) -> Spoil:
    """Change the one model of the file."""

    def edit(text: str) -> str:
        document = json.loads(text)
        name = next(iter(document["models"]))
        document["models"][name] = change(document["models"][name])
        return json.dumps(document)

    return as_text(edit, "model.json")


def _refused_model(id_: str, did: str, says: tuple[str, ...], spoil: Spoil) -> Mistake:
    return Mistake(f"model-{id_}", did, REFUSED, ("model.json", *says), RUN, spoil=spoil)


MODELS = (
    Mistake(
        "model-missing",
        "names a model that is not there",
        REFUSED,
        ("none.json", "no such file"),
        "reconstruct none.json series.csv",
    ),
    Mistake(
        "model-and-series-exchanged",
        "gives the series for the model",
        REFUSED,
        ("series.csv", "model"),
        "reconstruct series.csv model.json",
    ),
    Mistake(
        "model-estimator",
        "asks for an estimator that the file does not hold",
        REFUSED,
        ("--estimator", "sindy", "classic_ml"),
        f"{RUN} --estimator sindy",
    ),
    _refused_model("empty", "the model file is empty", ("model",), written("model.json", "")),
    _refused_model(
        "noise", "the model file is binary noise", ("model",), written("model.json", NOISE)
    ),
    _refused_model(
        "cut",
        "the model file is cut short",
        ("model",),
        as_text(lambda t: t[: len(t) // 2], "model.json"),
    ),
    _refused_model("list", "the model file is a list", ("model",), written("model.json", "[1, 2]")),
    _refused_model("number", "the model file is a number", ("model",), written("model.json", "12")),
    _refused_model(
        "none",
        "the model file holds no model",
        ("without a model",),
        as_text(lambda t: json.dumps({**json.loads(t), "models": {}}), "model.json"),
    ),
    _refused_model(
        "schema",
        "the model file is of another version",
        ("schema", "model/9"),
        replaced("model/1", "model/9", "model.json"),
    ),
    _refused_model(
        "tau-negative",
        "τ is negative",
        ("time constant",),
        _model(lambda m: {**m, "time_constant_s": -0.018}),
    ),
    _refused_model(
        "tau-endless",
        "τ is 1e999, more than any number",
        ("time_constant_s", "above 0 s", "inf", "save the model again"),
        replaced('"time_constant_s": 0.018', '"time_constant_s": 1e999', "model.json"),
    ),
    _refused_model(
        "tau-nan",
        "τ is NaN",
        ("time_constant_s", "above 0 s", "nan", "save the model again"),
        replaced('"time_constant_s": 0.018', '"time_constant_s": NaN', "model.json"),
    ),
    _refused_model(
        "target",
        "the model is of another coefficient",
        ("target", "psi_p", "'phi'", "save the model again"),
        _model(lambda m: {**m, "target": "phi"}),
    ),
    _refused_model(
        "tau-missing",
        "τ is missing",
        ("time_constant_s",),
        _model(lambda m: {k: v for k, v in m.items() if k != "time_constant_s"}),
    ),
    Mistake(
        "model-tau-none",
        "τ is null",
        HARMLESS,
        (),
        RUN,
        "a model whose τ was not identified is saved so, and run without a lag",
        spoil=_model(lambda m: {**m, "time_constant_s": None}),
    ),
    _refused_model(
        "coefficient-text",
        "a coefficient is a word",
        ("terms[1].coefficient", "a finite number", "'big'"),
        _model(lambda m: {**m, "terms": [{**m["terms"][0], "coefficient": "big"}]}),
    ),
    Mistake(
        "model-term-program",
        "a term is a program",
        HARMLESS,
        (),
        RUN,
        "a term of an unknown name is never evaluated: the curve comes from its table",
        spoil=_model(
            lambda m: {
                **m,
                "terms": [
                    {**m["terms"][0], "name": f"__import__('pathlib').Path('{CANARY}').touch()"}
                ],
            }
        ),
    ),
    _refused_model(
        "hold",
        "the hold is of another kind",
        ("hold", "third"),
        _model(lambda m: {**m, "hold": "third"}),
    ),
    _refused_model(
        "nested",
        "the model file is nested a hundred thousand deep",
        ("no JSON",),
        written("model.json", '{"a":' * 100_000 + "1" + "}" * 100_000),
    ),
)


def _own(id_: str, did: str, says: tuple[str, ...], text: str) -> Mistake:
    return Mistake(
        f"own-{id_}", did, REFUSED, ("model.py", *says), OWN, spoil=written("model.py", text)
    )


def _endless_npz(folder: Path) -> None:
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        head, {"descr": "<f8", "fortran_order": False, "shape": (2**37,)}
    )
    with zipfile.ZipFile(folder / "train.npz", "w") as archive:
        for name in ("time_s", "force", "position"):
            archive.writestr(f"{name}.npy", head.getvalue() + b"\0" * 800)


def _mat(folder: Path) -> None:
    from scipy.io import savemat

    cells = np.empty(200, dtype=object)
    cells[:] = "x"
    savemat(
        folder / "train.mat",
        {"time_s": np.arange(200) * 0.01, "force": np.zeros(200), "position": cells},
    )


def _cell(folder: Path, row: int, text: str) -> None:
    path = folder / "train.csv"
    rows = path.read_text("utf-8").splitlines()
    rows[row] = rows[row].rsplit(",", 1)[0] + "," + text
    path.write_text("\n".join(rows) + "\n", "utf-8")


EXPERIMENTS = (
    Mistake(
        "own-missing",
        "names a model file that is not there",
        REFUSED,
        ("none.py", "no such file"),
        "diagnose --model none.py --fit train.csv",
    ),
    Mistake(
        "own-without-records",
        "gives a model and no record",
        REFUSED,
        ("--fit",),
        "diagnose --model model.py",
    ),
    _own(
        "syntax", "the model file is no Python", ("line 2", "SyntaxError"), "x = 1\nmodel = = 2\n"
    ),
    _own("raises", "the model file fails", ("line 2", "ZeroDivisionError"), "x = 1\ny = 1 / 0\n"),
    _own(
        "exits",
        "the model file ends the program",
        ("line 2", "SystemExit"),
        "import sys\nsys.exit(0)\n",
    ),
    _own("empty", "the model file holds no model", ("model = Model",), "x = 1\n"),
    _own("noise", "the model file is binary noise", (), NOISE.decode("latin-1")),
    Mistake(
        "own-column",
        "a column of the model is not in the record",
        REFUSED,
        ("train.csv", "position"),
        OWN,
        spoil=replaced("position", "place", "train.csv"),
    ),
    Mistake(
        "own-nan",
        "a reading of the record is NaN",
        REFUSED,
        ("train.csv", "position", "row 200"),
        OWN,
        spoil=lambda folder: _cell(folder, 200, "nan"),
    ),
    Mistake(
        "own-gap",
        "rows of the record are missing",
        REFUSED,
        ("train.csv", "time_s", "gap"),
        OWN,
        spoil=as_text(
            lambda t: "\n".join([*t.splitlines()[:200], *t.splitlines()[210:]]), "train.csv"
        ),
    ),
    Mistake(
        "npz-pickle",
        "an .npz file holds pickled objects, which would be executed",
        REFUSED,
        ("train.npz: position", "never executed", "Python objects", "position.astype(float)"),
        OWN.replace("train.csv", "train.npz"),
        spoil=lambda folder: np.savez(
            folder / "train.npz",
            time_s=np.arange(200) * 0.01,
            force=np.zeros(200),
            position=np.array([Trap()] * 200, dtype=object),
        ),
    ),
    Mistake(
        "npz-is-pickle",
        "a pickle is named .npz",
        REFUSED,
        ("train.npz", "plain arrays, each with its name", "save it with savez"),
        OWN.replace("train.csv", "train.npz"),
        spoil=written("train.npz", pickle.dumps(Trap())),
    ),
    Mistake(
        "npz-endless",
        "a small .npz file claims a terabyte",
        REFUSED,
        ("train.npz",),
        OWN.replace("train.csv", "train.npz"),
        spoil=_endless_npz,
    ),
    Mistake(
        "mat-object",
        "a .mat file holds a cell array for a column",
        REFUSED,
        ("train.mat", "position"),
        OWN.replace("train.csv", "train.mat"),
        spoil=_mat,
    ),
    Mistake(
        "mat-noise",
        "binary noise is named .mat",
        REFUSED,
        ("train.mat",),
        OWN.replace("train.csv", "train.mat"),
        spoil=written("train.mat", NOISE),
    ),
)


def _study(id_: str, did: str, says: tuple[str, ...], spoil: Spoil) -> Mistake:
    return Mistake(f"study-{id_}", did, REFUSED, ("study.toml", *says), STUDY, spoil=spoil)


STUDIES = (
    _study(
        "key",
        "a key is misspelt",
        ("'seed'", "is 'seeds' meant?"),
        replaced("seeds = 2", "seed = 2", "study.toml"),
    ),
    _study(
        "string",
        "a number is in quotation marks",
        ("record.duration_s", "5"),
        replaced("duration_s = 5.0", 'duration_s = "5"', "study.toml"),
    ),
    _study(
        "source",
        "there is no such source of records",
        ("record.source", "rig"),
        replaced('"coefficients"', '"windtunnel"', "study.toml"),
    ),
    _study(
        "class",
        "the class of a method is a program",
        ("class", "package.module:Class"),
        as_text(
            lambda t: t + f"class = \"__import__('pathlib').Path('{CANARY}').touch()\"\n",
            "study.toml",
        ),
    ),
    Mistake(
        "study-out-within-file",
        "the folder of the study is to lie in a file",
        REFUSED,
        ("train.csv", "expected a folder"),
        STUDY.replace("--out study", "--out train.csv/study"),
    ),
)

FACILITIES = (
    Mistake(
        "facility-nested",
        "a value is nested a hundred thousand deep",
        REFUSED,
        ("facility.toml", "nested too deeply"),
        SYSTEM,
        spoil=written("facility.toml", "x = " + "[" * 100_000 + "]" * 100_000),
    ),
    Mistake(
        "facility-utf16",
        "the facility is saved as UTF-16",
        REFUSED,
        ("facility.toml", "UTF-16", "save it as UTF-8"),
        SYSTEM,
        spoil=written("facility.toml", "[volumes]\n".encode("utf-16")),
    ),
    Mistake(
        "facility-digits",
        "a number has 5000 digits",
        REFUSED,
        ("facility.toml", "digits"),
        SYSTEM,
        spoil=replaced("inlet_m3 = ", "inlet_m3 = 1" + "0" * 5000 + " # ", "facility.toml"),
    ),
    Mistake(
        "facility-missing",
        "names a facility that is not there",
        REFUSED,
        ("none.toml", "no such file"),
        SYSTEM.replace("facility.toml", "none.toml"),
    ),
    Mistake(
        "facility-not-named",
        "leaves the facility of another machine away",
        REFUSED,
        ("--facility",),
        SYSTEM.replace(" --facility facility.toml", ""),
    ),
    Mistake(
        "facility-key-missing",
        "a volume is missing",
        REFUSED,
        ("facility.toml", "volumes.discharge_m3"),
        SYSTEM,
        spoil=toml(("volumes/discharge_m3", ...), file="facility.toml"),
    ),
    Mistake(
        "facility-key",
        "a key is misspelt",
        REFUSED,
        ("facility.toml", "close_start", "close_start_s"),
        SYSTEM,
        spoil=replaced("close_start_s", "close_start", "facility.toml"),
    ),
    Mistake(
        "facility-negative",
        "a volume is negative",
        REFUSED,
        ("facility.toml", "volumes.inlet_m3", "-1"),
        SYSTEM,
        spoil=toml(("volumes/inlet_m3", -1.0), file="facility.toml"),
    ),
    Mistake(
        "facility-string",
        "a number is in quotation marks",
        REFUSED,
        ("facility.toml", "supply.temperature_K"),
        SYSTEM,
        spoil=toml(("supply/temperature_K", "288"), file="facility.toml"),
    ),
    Mistake(
        "facility-breaks",
        "the breakpoints are exchanged",
        REFUSED,
        ("facility.toml", "work_break_1", "below work_break_2"),
        SYSTEM,
        spoil=toml(("compressor/work_break_1", 0.9), file="facility.toml"),
    ),
)
