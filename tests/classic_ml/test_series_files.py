"""Series files: what is written comes back bit for bit, and a bad file is refused whole."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from classic_ml import CoefficientSeries, read_series, write_series
from classic_ml.io import series as series_files
from classic_ml.records import Dropped, LedgerEntry
from surge_core.errors import InputError

HISTORY = (
    LedgerEntry(
        "read", "3 rows, ψ' known", {"rows": 3, "rate_hz": 1e3, "raw": "a.csv", "ok": True}
    ),
    LedgerEntry("segment", "1 segment", {}, (Dropped("rows", 7, "φ < 0.05"),), ("clipped",)),
)


def made(n: int = 400, *, optional: bool = True, seed: int = 0) -> CoefficientSeries:
    rng = np.random.default_rng(seed)
    more = {
        "psi": rng.standard_normal(n),
        "T25_K": 440.0 + rng.standard_normal(n),
        "Nc_frac": 0.75 + 1e-3 * rng.standard_normal(n),
        "in_stall": rng.integers(0, 2, n).astype(bool),
    }
    return CoefficientSeries(
        time_s=86400.0 + np.arange(n) / 1000.0,
        phi=rng.standard_normal(n) * 0.1,
        psi_p=np.exp(rng.standard_normal(n)),
        segment=np.repeat([0, 1, 2, 0], n // 4),
        history=HISTORY,
        **(more if optional else {}),
    )


@pytest.mark.parametrize("suffix", [".csv", ".nc", ".nc4", ".netcdf", ".CSV"])
@pytest.mark.parametrize("optional", [True, False])
def test_a_series_survives_its_file_bit_for_bit(
    tmp_path: Path, suffix: str, optional: bool
) -> None:
    series = made(optional=optional)
    file = tmp_path / f"run{suffix}"
    write_series(series, file)
    back = read_series(file)
    for name, values in series.columns().items():
        read = getattr(back, name)
        assert read.dtype == values.dtype
        np.testing.assert_array_equal(read, values)
    assert back.columns().keys() == series.columns().keys()
    assert back.history == HISTORY
    assert back.source == str(file)


def test_without_a_segment_column_all_rows_are_one_segment(tmp_path: Path) -> None:
    """Columns of other names are let pass."""
    file, series = tmp_path / "plain.csv", made()
    columns = {"time_s": series.time_s, "phi": series.phi, "psi_p": series.psi_p, "comment": "x"}
    pd.DataFrame(columns).to_csv(file, index=False)
    back = read_series(file)
    np.testing.assert_array_equal(back.phi, series.phi)
    assert back.n_segments == 1
    assert back.scored.all()
    assert back.history == ()


def test_a_netcdf_file_of_another_program_is_read_with_its_history(tmp_path: Path) -> None:
    import xarray as xr

    file = tmp_path / "other.nc"
    series = made()
    xr.Dataset(
        {"phi": ("time_s", series.phi), "psi_p": ("time_s", series.psi_p)},
        coords={"time_s": series.time_s},
        attrs={"history": "made by hand"},
    ).to_netcdf(file, engine="h5netcdf")
    back = read_series(file)
    np.testing.assert_array_equal(back.psi_p, series.psi_p)
    assert "made by hand" in back.history[0].did


def written(folder: Path) -> Path:
    file = folder / "run.csv"
    write_series(made(), file)
    return file


Edit = Callable[[pd.DataFrame], pd.DataFrame]


def cell(row: int, column: str, value: object) -> Edit:
    def edit(table: pd.DataFrame) -> pd.DataFrame:
        table = table.astype(object)
        table.loc[row, column] = value
        return table

    return edit


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (lambda t: t.drop(columns="phi"), "no column phi; a raw record goes through"),
        (lambda t: t.rename(columns={"psi_p": "phi"}), "column phi: expected each column once"),
        (lambda t: t.iloc[:99], "at least 100 rows, found 99"),
        (cell(11, "psi_p", None), "column psi_p: .* an empty cell in row 12"),
        (cell(11, "psi_p", "inf"), "column psi_p: .* inf in row 12"),
        (cell(11, "psi_p", "1,5"), "column psi_p: .* found '1,5' in row 12"),
        (lambda t: t.assign(in_stall="yes"), "in_stall: expected 0 or 1, found 'yes'"),
    ],
)
def test_a_bad_series_file_is_refused(tmp_path: Path, edit: Edit, words: str) -> None:
    file = written(tmp_path)
    edit(pd.read_csv(file)).to_csv(file, index=False)
    with pytest.raises(InputError, match=words) as caught:
        read_series(file)
    assert str(file) in str(caught.value)


@pytest.mark.parametrize("suffix", [".csv", ".nc"])
@pytest.mark.parametrize("content", [b"", b"\x00\xff\xfe" * 200, b"\xff\xd8\xff\xe0 not a table"])
def test_a_spoiled_file_is_refused(tmp_path: Path, suffix: str, content: bytes) -> None:
    file = tmp_path / f"run{suffix}"
    file.write_bytes(content)
    with pytest.raises(InputError, match=r"run\.(csv|nc)") as caught:
        read_series(file)
    assert "\n" not in str(caught.value)


def test_a_netcdf_file_that_was_cut_short_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "run.nc"
    write_series(made(), file)
    file.write_bytes(file.read_bytes()[:-3000])
    with pytest.raises(InputError, match="expected a series file"):
        read_series(file)


@pytest.mark.parametrize("suffix", [".csv", ".nc"])
def test_a_write_that_fails_leaves_the_old_file_and_nothing_else(
    tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / f"run{suffix}"
    write_series(made(seed=1), file)
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}

    def fail(series: CoefficientSeries, target: Path, *_: object) -> None:
        target.write_text("half a")
        raise OSError("disk full")

    monkeypatch.setattr(series_files, "_write_csv", fail)
    monkeypatch.setattr(series_files, "_write_netcdf", fail)
    with pytest.raises(OSError, match="disk full"):
        write_series(made(seed=2), file)
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_truth_values_as_pandas_writes_them_are_read(tmp_path: Path) -> None:
    file = written(tmp_path)
    table = pd.read_csv(file)
    stalled = np.arange(len(table)) % 3 == 0
    table.assign(in_stall=stalled).to_csv(file, index=False)
    assert "True" in file.read_text("utf-8")
    back = read_series(file).in_stall
    assert back is not None
    np.testing.assert_array_equal(back, stalled)
    table.assign(in_stall="maybe").to_csv(file, index=False)
    with pytest.raises(InputError, match=r"column in_stall: .* found 'maybe'"):
        read_series(file)


def test_a_table_of_another_country_is_the_same_series(tmp_path: Path) -> None:
    file = written(tmp_path)
    plain = read_series(file)
    text = file.read_text("utf-8").replace(",", ";").replace(".", ",")
    file.write_text(text, "utf-8")
    for name, values in plain.columns().items():
        np.testing.assert_array_equal(read_series(file).columns()[name], values, strict=True)


@pytest.mark.parametrize("units", ["s", "seconds since 1989-01-01"])
def test_a_netcdf_file_whose_clock_is_called_time_is_told_to_rename_it(
    tmp_path: Path, units: str
) -> None:
    import xarray as xr

    file = tmp_path / "run.nc"
    time_s = np.arange(200) * 1e-3
    data = xr.Dataset(
        {"phi": ("time", np.sin(time_s)), "psi_p": ("time", np.cos(time_s))},
        coords={"time": ("time", time_s, {"units": units})},
    )
    data.to_netcdf(file, engine="h5netcdf")
    with pytest.raises(InputError, match="no column time_s; rename 'time' to 'time_s'"):
        read_series(file)
    data.rename(time="time_s").to_netcdf(file, engine="h5netcdf")
    np.testing.assert_array_equal(read_series(file).time_s, time_s)
