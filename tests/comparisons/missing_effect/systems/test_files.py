"""Records and models as files: what is read, and what each mistake is told."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import scipy.io
import xarray
from driven_mass import MODEL, PERIOD_S, table

from comparisons.missing_effect.systems.files import load_model, read_experiment
from surge_core.errors import InputError

N = 200


def good() -> pd.DataFrame:
    return table(0, N)


@pytest.fixture(scope="module")
def model_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("model") / "model.py"
    file.write_text(MODEL, "utf-8")
    return file


def arrays() -> dict[str, np.ndarray]:
    """The record as MATLAB leaves it: vectors either way, scalars, tables, words."""
    made = good()
    return {
        "t": made["time_s"].to_numpy()[:, None],
        "F": made["F"].to_numpy()[None, :],
        "y": made["y"].to_numpy()[:, None],
        "gain": np.array([[3.0]]),
        "image": np.ones((4, 5)),
        "note": np.array(["a rig"]),
    }


def write_mat(path: Path) -> None:
    scipy.io.savemat(path, arrays())


def write_npz(path: Path) -> None:
    np.savez(path, **arrays())


def write_netcdf(path: Path) -> None:
    made = good().set_index("time_s")
    xarray.Dataset.from_dataframe(made).to_netcdf(path, engine="h5netcdf")


def write_csv(path: Path) -> None:
    good().to_csv(path, index=False)


WRITERS = {
    "run.csv": write_csv,
    "run.mat": write_mat,
    "run.npz": write_npz,
    "run.nc": write_netcdf,
}


@pytest.mark.parametrize("name", WRITERS)
def test_a_record_comes_back_from_every_format(name: str, tmp_path: Path, model_file: Path) -> None:
    WRITERS[name](tmp_path / name)
    made = good()
    for model in (None, load_model(model_file)):
        run = read_experiment(tmp_path / name, model, settle=7)
        assert run.sample_period_s == PERIOD_S
        assert set(run.channels) == {"F", "y"}
        assert (run.name, run.settle, run.first_s) == ("run", 7, 0.0)
        for channel in ("F", "y"):
            assert np.allclose(run.channels[channel], made[channel], rtol=1e-14, atol=0.0)


def test_a_clock_of_few_decimals_gives_records_of_one_sampler_one_period(tmp_path: Path) -> None:
    periods = set()
    for n, first in ((90, 0.0), (151, 3.7), (200, 1000.0)):
        made = table(1, n)
        made["time_s"] = (first + np.arange(n) / 16.0).round(5)
        made.to_csv(tmp_path / "run.csv", index=False)
        run = read_experiment(tmp_path / "run.csv", name="other")
        periods.add(run.sample_period_s)
        assert run.name == "other"
        assert run.first_s == first
    assert periods == {0.0625}


def test_an_uneven_rate_is_kept_to_the_digits_that_the_clock_has(tmp_path: Path) -> None:
    made = good()
    made["time_s"] = np.arange(N) / 610.35
    made.to_csv(tmp_path / "run.csv", index=False)
    found = read_experiment(tmp_path / "run.csv").sample_period_s
    assert abs(found * 610.35 - 1.0) < 1e-6 / (N - 1)


def text(made: pd.DataFrame) -> str:
    return made.to_csv(index=False)


def changed(row: int, column: str, value: object) -> Callable[[], str]:
    def make() -> str:
        made = good().astype(object)
        made.loc[row, column] = value
        return text(made)

    return make


def lines(change: Callable[[list[str]], list[str]]) -> Callable[[], str]:
    return lambda: "\n".join(change(text(good()).splitlines())) + "\n"


def header(words: str) -> Callable[[], str]:
    return lines(lambda rows: [words, *rows[1:]])


def packed(save: Callable[..., object], **replaced: object) -> Callable[[], bytes]:
    def make() -> bytes:
        kept = {k: v for k, v in {**arrays(), **replaced}.items() if v is not None}
        out = io.BytesIO()
        save(out, kept) if save is scipy.io.savemat else save(out, **kept)
        return out.getvalue()

    return make


def jitter() -> str:
    made = good()
    made.loc[50, "time_s"] += 0.002 * PERIOD_S
    return text(made)


def drifting() -> str:
    made = good()
    made["time_s"] *= 1.0 + 1e-4 * np.arange(N) / N
    return text(made)


NUL = b"\x00\xff\xfe\x80" * 400

BAD = {
    "empty.csv": (lambda: "", "an empty file"),
    "binary.csv": (lambda: NUL, "bytes that are no text"),
    "header_only.csv": (lambda: "time_s,F,y\n", "rows: expected at least 40, found 0"),
    "short.csv": (lambda: text(good()[:39]), "rows: expected at least 40, found 39"),
    "gap.csv": (lambda: text(good().drop(index=range(80, 90))), "a gap in row 81"),
    "repeat.csv": (changed(70, "time_s", 69 * PERIOD_S), "a repeated time in row 71"),
    "back.csv": (changed(70, "time_s", 0.1), "a step back in row 71"),
    "nan_time.csv": (changed(70, "time_s", ""), "time_s: expected finite times, found nan in row"),
    "inf_time.csv": (changed(3, "time_s", "inf"), "found inf in row 4"),
    "jitter.csv": (jitter, "row 51 off by 0.002 periods"),
    "drift.csv": (drifting, "a uniform clock within 0.001 of its period"),
    "falling.csv": (lambda: text(good()[::-1]), "a step back in row 2"),
    "nan.csv": (changed(12, "y", ""), "y: expected finite values, found nan in row 13"),
    "inf.csv": (changed(12, "F", "-inf"), "F: expected finite values, found -inf in row 13"),
    "word.csv": (changed(12, "y", "over"), "y: expected numbers, found 'over' in row 13"),
    "no_clock.csv": (header("clock,F,y"), "one column of time in seconds, 'time_s' or 't'"),
    "clocks.csv": (header("time_s,t,y"), "'time_s' or 't', found both"),
    "no_input.csv": (header("time_s,force,y"), "F: expected columns F, y, found y"),
    "no_output.csv": (header("time_s,F,q"), "y: expected columns F, y, found F"),
    "doubled.csv": (header("time_s,y,y"), "expected each column once, found 'y' twice"),
    "semicolons.csv": (header("time_s;F;y"), "columns separated by commas"),
    "no_header.csv": (lines(lambda rows: rows[1:]), "one column of time in seconds"),
    "long_row.csv": (
        lines(lambda rows: [*rows[:60], rows[60] + ",3", *rows[61:]]),
        "a table of 3 columns",
    ),
    "longer_rows.csv": (
        lines(lambda rows: [rows[0], *(row + ",3" for row in rows[1:])]),
        "a table of 3 columns",
    ),
    "cut.csv": (lambda: text(good()).rsplit(",", 1)[0] + "\n", "y: expected finite values"),
    "constant.csv": (lambda: text(good().assign(y=1.0)), "an output that changes"),
    "run.txt": (lambda: text(good()), "a record ending in .csv, .mat, .npz or .nc"),
    "empty.mat": (lambda: b"", "an empty file"),
    "text.mat": (lambda: text(good()), "a MATLAB file, found what cannot be read"),
    "cut.mat": (
        lambda: packed(scipy.io.savemat)()[:3000],
        "a MATLAB file, found what cannot be read",
    ),
    "new.mat": (lambda: b"MATLAB 7.3 MAT-file" + NUL, "found version 7.3"),
    "new_plain.mat": (lambda: b"\x89HDF\r\n\x1a\n" + NUL, "found version 7.3"),
    "square.mat": (packed(scipy.io.savemat, y=np.ones((20, 10))), "y: expected a vector"),
    "lengths.mat": (
        packed(scipy.io.savemat, y=np.arange(150.0)),
        "y: expected 200 values, as many as of time, found 150",
    ),
    "complex.mat": (packed(scipy.io.savemat, F=np.arange(200) * 1j), "a vector of real numbers"),
    "no_clock.mat": (packed(scipy.io.savemat, t=None), "one column of time in seconds"),
    "text.npz": (lambda: text(good()), "an .npz file of plain arrays"),
    "cut.npz": (lambda: packed(np.savez)()[:2000], "an .npz file of plain arrays"),
    "pickle.npz": (
        packed(np.savez, y=np.array([{}] * 200, dtype=object)),
        "y: expected numbers, since a file is read as data and never executed",
    ),
    "no_input.npz": (packed(np.savez, F=None), "F: expected columns F, y, found y"),
    "text.nc": (lambda: text(good()), "a netCDF file, found what cannot be read"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_record_is_refused_in_one_sentence_that_names_it(
    name: str, tmp_path: Path, model_file: Path
) -> None:
    make, words = BAD[name]
    made = make()
    file = tmp_path / name
    file.write_bytes(made if isinstance(made, bytes) else made.encode("utf-8"))
    with pytest.raises(InputError) as refused:
        read_experiment(file, load_model(model_file))
    said = str(refused.value)
    assert words in said
    assert said.startswith(str(file))
    assert "\n" not in said


def test_what_is_no_file_is_refused(tmp_path: Path) -> None:
    for path, words in ((tmp_path, "a folder"), (tmp_path / "no.csv", "no such file")):
        with pytest.raises(InputError, match=words):
            read_experiment(path)
        with pytest.raises(InputError, match=words):
            load_model(path)


BODY = MODEL.replace("model = Model", "first = Model")

BAD_MODELS = {
    "syntax": ("x = 1\ndef f(:\n", "line 2: expected Python that runs, found SyntaxError"),
    "raises": ("x = 1\n\ny = 1 / 0\n", "line 3: expected Python that runs, found ZeroDivision"),
    "deep": (
        "def f():\n    return {}['k']\n\nf()\n",
        "line 2: expected Python that runs, found KeyError: 'k'",
    ),
    "exits": ("import sys\nsys.exit(3)\n", "line 2: expected Python that runs, found SystemExit"),
    "imports": ("import no_such_module\n", "line 1: expected Python that runs, found ModuleNot"),
    "none": ("x = 1\n", "a variable 'model' that is a Model, found no Model in it"),
    "no_model": (BODY.replace("first = Model", "model = dict"), "found no Model in it"),
    "several": (
        BODY + "second = Model(**{f: getattr(first, f) for f in " + "("
        "'states', 'inputs', 'outputs', 'params', 'rhs', 'output')})\n",
        "several models: first",
    ),
    "refused": (MODEL.replace('"F": "N"', '"q": "N"'), "inputs: expected each name once"),
    "nul": ("x = '\0'\n", "expected Python that runs"),
}


@pytest.mark.parametrize("name", BAD_MODELS)
def test_a_bad_model_file_is_refused_with_its_line(name: str, tmp_path: Path) -> None:
    program, words = BAD_MODELS[name]
    file = tmp_path / "model.py"
    file.write_text(program, "utf-8")
    with pytest.raises(InputError) as refused:
        load_model(file)
    said = str(refused.value)
    assert words in said
    assert said.startswith(str(file))
    assert "\n" not in said


def test_a_model_file_is_a_program_with_neighbours_and_one_model_of_any_name(
    tmp_path: Path,
) -> None:
    (tmp_path / "neighbour_of_model.py").write_text("STATES = {'q': 'm', 'v': 'm/s'}\n", "utf-8")
    program = BODY.replace('{"q": "m", "v": "m/s"}', "STATES")
    file = tmp_path / "model.py"
    file.write_text("from neighbour_of_model import STATES\nimport math\n" + program, "utf-8")
    model = load_model(file)
    assert model.state_names == ("q", "v")
    assert model.evaluate(0.0, (0.1, 0.2), (0.3,), (1.0, 0.5, 10.0))[0] == pytest.approx(
        (0.2, 0.3 - 0.1 - 1.0)
    )


@pytest.mark.parametrize("settle", [-1, N, N + 1])
def test_a_record_of_which_nothing_would_be_scored_is_refused(settle: int, tmp_path: Path) -> None:
    write_csv(tmp_path / "run.csv")
    with pytest.raises(InputError, match="settle: expected from 0 to fewer than 200 rows"):
        read_experiment(tmp_path / "run.csv", settle=settle)
