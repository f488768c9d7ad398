"""Records and models as files: what is read, and what each mistake is told."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path

import h5py
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


WRITERS = {"run.csv": write_csv, "run.mat": write_mat, "run.npz": write_npz, "run.nc": write_netcdf}


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


def test_a_matlab_file_of_version_7_3_is_read(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "run.mat", "w") as file:
        for name in ("t", "F", "y", "gain"):
            file[name] = arrays()[name]
    run = read_experiment(tmp_path / "run.mat")
    assert set(run.channels) == {"F", "y"}
    assert np.allclose(run.channels["y"], good()["y"], rtol=1e-14, atol=0.0)


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


NUL = b"\x00\xff\xfe\x80" * 400

BAD = {
    "empty.csv": (lambda: "", "an empty file"),
    "binary.csv": (lambda: NUL, "bytes that are no text"),
    "short.csv": (lambda: text(good()[:39]), "rows: expected at least 40, found 39"),
    "nan_time.csv": (changed(70, "time_s", ""), "time_s: expected finite times, found nan in row"),
    "jitter.csv": (changed(50, "time_s", 50.002 * PERIOD_S), "row 51 off by 0.002 periods"),
    "uneven.csv": (changed(50, "time_s", 50.3 * PERIOD_S), "these times, interpolate the inputs"),
    "nan.csv": (changed(12, "F", ""), "F: expected finite values, found nan in row 13"),
    "word.csv": (changed(12, "y", "over"), "y: expected numbers, found 'over' in row 13"),
    "semicolons.csv": (header("time_s;F;y"), "columns separated by commas"),
    "long_row.csv": (
        lines(lambda rows: [*rows[:60], rows[60] + ",3", *rows[61:]]),
        "a table of 3 columns",
    ),
    "constant.csv": (lambda: text(good().assign(y=1.0)), "an output that changes"),
    "run.txt": (lambda: text(good()), "a record ending in .csv, .mat, .npz or .nc"),
    "cut.mat": (lambda: packed(scipy.io.savemat)()[:3000], "a MAT file, found what cannot be read"),
    "new.mat": (lambda: b"MATLAB 7.3 MAT-file" + NUL, "a MAT file, found what cannot be read"),
    "lengths.mat": (
        packed(scipy.io.savemat, y=np.arange(150.0)),
        "y: expected a vector of numbers, as many as of time, found 150 values",
    ),
    "pickle.npz": (
        packed(np.savez, y=np.array([{}] * 200, dtype=object)),
        "y: expected a vector of numbers, as many as of time, found objects; save them as numbers",
    ),
    "text.nc": (lambda: text(good()), "a netCDF file, found what cannot be read"),
}


def test_an_empty_cell_of_an_output_is_no_reading(tmp_path: Path, model_file: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text(changed(12, "y", "")())
    read = read_experiment(path, load_model(model_file))
    assert np.flatnonzero(np.isnan(read.channels["y"])).tolist() == [12]


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


def test_what_is_no_file_is_refused(tmp_path: Path) -> None:
    for path, words in ((tmp_path, "a folder"), (tmp_path / "no.csv", "no such file")):
        with pytest.raises(InputError, match=words):
            read_experiment(path)
        with pytest.raises(InputError, match=words):
            load_model(path)


BODY = MODEL.replace("model = Model", "first = Model")

BAD_MODELS = {
    "syntax": ("x = 1\ndef f(:\n", "line 2: expected Python that runs, found SyntaxError"),
    "deep": (
        "def f():\n    return {}['k']\n\nf()\n",
        "line 2: expected Python that runs, found KeyError: 'k'",
    ),
    "none": ("x = 1\n", "a variable 'model' that is a Model, found no Model in it"),
    "refused": (MODEL.replace('"F": "N"', '"q": "N"'), "inputs: expected each name once"),
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
