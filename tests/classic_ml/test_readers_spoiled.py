"""Files that mislead: one sentence for the file, or one for the column, and never another file."""

from __future__ import annotations

import os
import tomllib
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from raw_data import RawTest, make_test, write_csv
from scipy.io import savemat

from classic_ml.inspection import inspect_file
from classic_ml.inspection_draft import draft_test_toml
from classic_ml.readers import read_raw
from classic_ml.readers.netcdf_classic import read_header
from classic_ml.readers.raw_csv import LONGEST_LINE
from classic_ml.readers.raw_formats import open_stored
from surge_core.errors import InputError

ROWS = 120
GOOD = {"time_s": np.arange(ROWS) / 1000.0, "P": np.linspace(1.0, 2.0, ROWS)}


@pytest.fixture(scope="module")
def made() -> RawTest:
    return make_test(seconds=0.2, rate_hz=1000.0)


Spoil = Callable[[h5py.File], Any]


def written(folder: Path, suffix: str, spoil: Spoil) -> Path:
    """Write two good columns and whatever else."""
    path = folder / f"record{suffix}"
    with h5py.File(path, "w", userblock_size=512 if suffix == ".mat" else 0) as file:
        for name, values in GOOD.items():
            file[name] = values
        spoil(file)
    if suffix == ".mat":
        with path.open("r+b") as opened:
            opened.write(b"MATLAB 7.3 MAT-file, made up".ljust(124) + b"\x00\x02IM")
    return path


def of_class(item: Any, kind: str) -> Any:
    item.attrs["MATLAB_class"] = np.bytes_(kind)
    return item


def a_text(codes: np.ndarray) -> Spoil:
    return lambda file: of_class(file.create_dataset("odd", data=codes), "char")


def with_attribute(name: str, value: Any) -> Spoil:
    def spoil(file: h5py.File) -> None:
        file["odd"] = GOOD["P"]
        file["odd"].attrs[name] = value

    return spoil


def a_virtual_dataset(file: h5py.File) -> None:
    layout = h5py.VirtualLayout((ROWS,), "f8")
    layout[:] = h5py.VirtualSource(".", "P", (ROWS,))
    file.create_virtual_dataset("odd", layout)


def a_name_that_is_not_utf8(file: h5py.File) -> None:
    file.create_dataset(b"odd\xff", data=GOOD["P"])


PAIR = np.zeros(3, dtype=[("a", "f8"), ("b", "f8")])
EMPTY = h5py.Empty("f8")
# What is beside the good columns, under which name it is told of, and in which words.
SPOILED: dict[str, tuple[str, Spoil, str, str]] = {
    "letter beyond": (".mat", a_text(np.array([[2**40]], "u8")), "odd", "letters are no codes"),
    "letter below": (".mat", a_text(np.array([[-5]], "i8")), "odd", "letters are no codes"),
    "letters in pairs": (".mat", a_text(PAIR), "odd", "letters are no codes"),
    "scale of none": (".nc", with_attribute("scale_factor", EMPTY), "odd", "scale_factor is empty"),
    "scale of length 0": (
        ".nc",
        with_attribute("scale_factor", np.zeros(0)),
        "odd",
        "scale_factor is empty",
    ),
    "scale in pairs": (
        ".nc",
        with_attribute("scale_factor", PAIR),
        "odd",
        "scale_factor is no number",
    ),
    "fill in words": (".nc", with_attribute("_FillValue", "none"), "odd", "_FillValue is no num"),
    "virtual": (".h5", a_virtual_dataset, "odd", "a view of other datasets"),
    "name": (".h5", a_name_that_is_not_utf8, "odd\ufffd", "a name that is not UTF-8"),
}


@pytest.mark.parametrize("case", SPOILED)
def test_one_item_that_cannot_be_read_is_left_aside_and_the_others_are_read(
    tmp_path: Path, case: str
) -> None:
    suffix, spoil, name, words = SPOILED[case]
    raw = open_stored(written(tmp_path, suffix, spoil))
    assert set(raw.names) == set(GOOD)
    assert words in raw.unusable[name]
    values = np.concatenate(list(raw.chunks(50)))
    for number, column in enumerate(raw.names):
        np.testing.assert_array_equal(values[:, number], GOOD[column])


def test_a_fill_value_that_is_empty_states_none(tmp_path: Path) -> None:
    raw = open_stored(written(tmp_path, ".nc", with_attribute("_FillValue", EMPTY)))
    values = np.concatenate(list(raw.chunks(50)))
    np.testing.assert_array_equal(values[:, raw.names.index("odd")], GOOD["P"])


def test_a_unit_that_is_empty_is_none(tmp_path: Path) -> None:
    raw = open_stored(written(tmp_path, ".h5", with_attribute("units", h5py.Empty("S3"))))
    assert raw.units == {}


def test_a_null_reference_in_an_array_of_structs_costs_one_field(tmp_path: Path) -> None:
    def spoil(file: h5py.File) -> None:
        hidden = file.create_group("#refs#")
        group = of_class(file.create_group("signals"), "struct")
        for field in ("label", "values"):
            group.create_dataset(field, (2, 1), dtype=h5py.ref_dtype)
        for number, label in enumerate("ab"):
            codes = np.array([[ord(label)]], dtype=np.uint16)
            text = of_class(hidden.create_dataset(f"label{number}", data=codes), "char")
            group["label"][number, 0] = text.ref
        group["values"][0, 0] = hidden.create_dataset("values0", data=GOOD["P"]).ref

    raw = open_stored(written(tmp_path, ".mat", spoil))
    assert set(raw.names) == {*GOOD, "a"}
    assert raw.unusable["b"] == "no vector of values"


def test_letters_that_take_two_codes_are_read(tmp_path: Path) -> None:
    """MATLAB writes UTF-16; half a letter is none, and must not spoil what is printed."""

    def spoil(file: h5py.File) -> None:
        file["data"] = np.stack([GOOD["P"], GOOD["P"]])
        hidden = file.create_group("#refs#")
        cells = of_class(file.create_dataset("names", (2, 1), dtype=h5py.ref_dtype), "cell")
        for number, name in enumerate(("P\U0001d70b", "Q\ud835")):
            codes = np.frombuffer(name.encode("utf-16-le", "surrogatepass"), "<u2")[:, None]
            cells[number, 0] = of_class(hidden.create_dataset(f"n{number}", data=codes), "char").ref

    raw = open_stored(written(tmp_path, ".mat", spoil))
    assert set(raw.names) == {*GOOD, "P\U0001d70b", "Q\ufffd"}


def test_groups_that_are_linked_to_in_many_ways_are_refused_in_the_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("classic_ml.readers.raw_hdf5.MOST_ITEMS", 1000)

    def spoil(file: h5py.File) -> None:
        inner = file.create_group("level0")
        inner["x"] = GOOD["P"]
        for level in range(1, 25):
            group = file.create_group(f"level{level}")
            group["left"] = group["right"] = inner
            inner = group

    with pytest.raises(InputError, match="at most 1,000 groups, datasets and references"):
        open_stored(written(tmp_path, ".h5", spoil))


def test_a_struct_that_refers_to_itself_comes_to_an_end(tmp_path: Path) -> None:
    def spoil(file: h5py.File) -> None:
        group = of_class(file.create_group("odd"), "struct")
        for field in ("a", "b"):
            cells = group.create_dataset(field, (3, 1), dtype=h5py.ref_dtype)
            for number in range(3):
                cells[number, 0] = group.ref

    raw = open_stored(written(tmp_path, ".mat", spoil))
    assert set(raw.names) == set(GOOD)


def test_groups_within_groups_without_end_are_left_aside(tmp_path: Path) -> None:
    def spoil(file: h5py.File) -> None:
        group = file
        for _ in range(600):
            group = group.create_group("g")
        group["x"] = GOOD["P"]

    raw = open_stored(written(tmp_path, ".h5", spoil))
    assert set(raw.names) == set(GOOD)
    assert any("groups within one another" in why for why in raw.unusable.values())


@pytest.mark.parametrize("way", ["external storage", "link through a link"])
def test_the_bytes_of_another_file_are_not_shown(tmp_path: Path, way: str) -> None:
    other = tmp_path / "other.h5"
    with h5py.File(other, "w") as file:
        file["secret"] = np.full(ROWS, 42.0)
        offset = file["secret"].id.get_offset()

    def spoil(file: h5py.File) -> None:
        if way == "external storage":
            external = [(str(other), offset, 8 * ROWS)]
            file.create_dataset("odd", (ROWS,), "f8", external=external)
        else:
            file["elsewhere"] = h5py.ExternalLink(str(other), "/")
            file["odd"] = h5py.SoftLink("/elsewhere/secret")

    raw = open_stored(written(tmp_path, ".h5", spoil))
    assert set(raw.names) == set(GOOD)
    assert "another file" in raw.unusable["odd"]


def test_two_record_variables_of_one_name_do_not_upset_a_classic_header(tmp_path: Path) -> None:
    def word(*numbers: int) -> bytes:
        return b"".join(number.to_bytes(4, "big") for number in numbers)

    def name(text: bytes) -> bytes:
        return word(len(text)) + text + bytes(-len(text) % 4)

    bounds = word(12, 1) + name(b"bounds") + word(6, 2) + np.array([0.0, 1.0], ">f8").tobytes()
    variables = b""
    for begin in (256, 264):
        variables += name(b"P") + word(1, 0) + bounds + word(6, 8, begin)
    head = b"CDF\x01" + word(3) + word(10, 1) + name(b"row") + word(0) + word(0, 0)
    path = tmp_path / "record.nc"
    path.write_bytes((head + word(11, 2) + variables).ljust(256) + bytes(48))
    assert [v.shape for v in read_header(path)] == [(3,), (3,)]
    assert [v.record_bytes for v in read_header(path)] == [16, 16]


def test_a_reading_that_is_too_large_in_si_is_refused_by_its_row(
    made: RawTest, tmp_path: Path
) -> None:
    name = next(n for n in made.columns if n.startswith("T25"))
    spoiled = np.array(made.columns[name])
    spoiled[41] = 1e306
    made.write(tmp_path)
    text = (tmp_path / "test.toml").read_text("utf-8")
    head = f'[channels.{name}]\nkind = "temperature"\nunit = '
    kilo = text.replace(f'{head}"K"', f'{head}"kK"')
    assert kilo != text
    (tmp_path / "test.toml").write_text(kilo, "utf-8")
    write_csv(tmp_path / "raw.csv", {**made.columns, name: spoiled})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(InputError, match=r"a finite number in every row, found '1e\+306' in r"):
            read_raw(tmp_path / "raw.csv", tmp_path / "test.toml")


def clocks_of(folder: Path, late_s: float) -> Path:
    """Write two structs with clocks of their own, one of them computed in another way."""
    step_s = 1e-5
    one = np.cumsum(np.full(ROWS, step_s)) - 1.01e-3
    other = step_s * (np.arange(ROWS) - 100)
    assert 0.0 < abs(one[100]) < 1e-15 == other[100] + 1e-15
    parts = {"A": {"time": one, "Data": one}, "B": {"time": other + late_s, "Data": one}}
    savemat(folder / "record.mat", parts)
    return folder / "record.mat"


@pytest.mark.parametrize("rows", [1, 7, 1000])
def test_clocks_that_differ_by_rounding_at_zero_are_the_same(tmp_path: Path, rows: int) -> None:
    assert len(list(open_stored(clocks_of(tmp_path, 0.0)).chunks(rows))) == -(-ROWS // rows)


@pytest.mark.parametrize("rows", [1, 7, 1000])
def test_clocks_that_differ_by_a_thousandth_of_a_step_are_not(tmp_path: Path, rows: int) -> None:
    with pytest.raises(InputError, match="the same times for both"):
        list(open_stored(clocks_of(tmp_path, 1e-8)).chunks(rows))


@pytest.mark.parametrize("where", ["header", "second line", "row"])
def test_a_csv_file_without_line_ends_is_not_read_whole(tmp_path: Path, where: str) -> None:
    path = tmp_path / "record.csv"
    before = {"header": "", "second line": "time_s,P\n", "row": "time_s,P\n1,2\nx,3\n"}[where]
    path.write_text(before + "1," * (3 * LONGEST_LINE), "utf-8")
    with pytest.raises(InputError, match="a line of more than 1,048,576 letters"):
        list(open_stored(path, lenient=True).chunks(100))


@pytest.mark.skipif(os.name == "nt", reason="names are UTF-16 there")
@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_a_file_may_have_a_name_that_is_not_utf8(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / os.fsdecode(b"re\xffcord" + suffix.encode())
    if suffix == ".csv":
        write_csv(path, GOOD)
    else:
        with path.open("wb") as opened:
            pq.write_table(pa.table(GOOD), opened)
    inspection = inspect_file(path)
    assert inspection.rows == ROWS
    draft = draft_test_toml(inspection).encode("utf-8")
    assert "test" in tomllib.loads(draft.decode("utf-8"))


HOSTILE = (
    "P25 A\nz = 1",
    "P25\x01B",
    "P25\x7fC",
    "P25\rD",
    "P25 \u2028E",
    'P25 "F" \\u0041',
    "odd\x0bname",
    "odd\x7f",
    "time\x85",
)


def test_a_draft_is_toml_whatever_names_and_units_hold(tmp_path: Path) -> None:
    path = tmp_path / "y\nz = 1\x01\x7f.h5"
    with h5py.File(path, "w") as file:
        for number, name in enumerate(HOSTILE):
            file[name] = GOOD["time_s"] ** 2 + number
            if name.startswith("P25"):
                file[name].attrs["units"] = "psi\x7f"
        file["time_s"] = GOOD["time_s"]
    draft = draft_test_toml(inspect_file(path))
    document = tomllib.loads(draft)
    assert set(document) == {"test", "compressor", "planes", "file", "near_stall", "channels"}
    assert document["test"]["name"] == path.stem
    columns = {channel.get("column") for channel in document["channels"].values()}
    assert columns == {name for name in HOSTILE if name.startswith("P25")}
