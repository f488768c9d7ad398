"""Raw records as Parquet: one column a channel."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from classic_ml.readers.raw_columns import one_line
from classic_ml.readers.raw_table import (
    Columns,
    RawFile,
    arrow_file,
    cannot_be_read,
    check_unique,
    in_one_line,
    rebatched,
)
from classic_ml.readers.test_description import FileLayout
from surge_core.errors import InputError

__all__ = ["INDEX", "open_parquet"]

_UNIT_KEYS = (b"units", b"unit")
_PER_SECOND = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}
INDEX = "__index_level_"
BUFFER_BYTES = 1 << 20


def open_parquet(file: Path, layout: FileLayout) -> RawFile:
    """Open a Parquet file; its rows are read batch by batch, what pandas wrote of itself is not.

    Parameters
    ----------
    file : path
        An existing file. The metadata ``units`` or ``unit`` of a column state its unit; a column
        of timestamps counts from the first sample; a missing value is NaN.
    layout : FileLayout
        Which column is the clock; an index without a name that pandas wrote is left aside unless
        it is that, or holds timestamps.

    Returns
    -------
    RawFile
        The columns of numbers.

    Raises
    ------
    InputError
        When the file is spoiled or encrypted, or holds no column of numbers.
    """
    import pyarrow as pa

    try:
        with _opened(file) as opened:
            schema, n_rows = opened.schema_arrow, opened.metadata.num_rows
    except (pa.ArrowException, OSError, ValueError) as error:
        raise cannot_be_read(file, "a Parquet file", one_line(error)) from None
    fields = [
        field
        for field in schema
        if (_is_numeric(field.type) or pa.types.is_timestamp(field.type))
        and (
            field.name == layout.time
            or not field.name.startswith(INDEX)
            or pa.types.is_timestamp(field.type)
        )
    ]
    if not fields:
        raise InputError(str(file), expected="columns of numbers", found="none")
    if n_rows == 0:
        raise InputError(str(file), expected="rows", found="none")
    names = tuple(field.name for field in fields)
    check_unique(str(file), names)
    units = {field.name: _unit(field) for field in fields}
    origins = _first_stamps(file, [f.name for f in fields if pa.types.is_timestamp(f.type)])
    unusable = {
        f.name: "an index of pandas" if f.name.startswith(INDEX) else f"a column of {f.type}"
        for f in schema
        if f.name not in names
    }

    def pieces(rows: int, kept: tuple[str, ...]) -> Iterator[Columns]:
        read = [field for field in fields if field.name in kept]
        with _opened(file) as table:
            try:
                for batch in table.iter_batches(
                    rows, columns=[field.name for field in read], use_threads=False
                ):
                    yield tuple(
                        _numbers(column, field.type, origins.get(field.name))
                        for column, field in zip(batch.columns, read, strict=True)
                    )
            except (pa.ArrowException, OSError) as error:
                raise InputError(
                    str(file), expected="rows that can be read", found=one_line(error)
                ) from None

    def selected(kept: tuple[str, ...]) -> Callable[[int], Iterator[Columns]]:
        return lambda rows: rebatched(pieces(rows, kept), rows)

    stamps = {name: _from_date(name, origins, schema) for name in origins}
    return RawFile(
        str(file),
        names,
        selected(names),
        {name: unit for name, unit in units.items() if unit},
        n_rows,
        stamps.get(layout.time, ""),
        unusable,
        stamps,
        selected=selected,
    )


def _is_numeric(kind: Any) -> bool:
    import pyarrow as pa

    tests = (pa.types.is_integer, pa.types.is_floating, pa.types.is_boolean, pa.types.is_decimal)
    return any(test(kind) for test in (*tests, pa.types.is_duration))


def _unit(field: Any) -> str:
    import pyarrow as pa

    if pa.types.is_timestamp(field.type) or pa.types.is_duration(field.type):
        return "s"
    metadata = {key.lower(): value for key, value in (field.metadata or {}).items()}
    unit = next((metadata[k].decode("utf-8", "replace") for k in _UNIT_KEYS if k in metadata), "")
    return in_one_line(unit)


def _numbers(column: Any, kind: Any, origin: int | None) -> NDArray[Any]:
    """Return a column as whole numbers or as float64; stamps and durations in seconds."""
    import pyarrow as pa

    if pa.types.is_timestamp(kind) or pa.types.is_duration(kind):
        missing = column.is_null().to_numpy(zero_copy_only=False)
        ticks = column.cast(pa.int64()).fill_null(0).to_numpy(zero_copy_only=False)
        # The difference first: a date in nanoseconds is no double.
        seconds = (ticks - (origin or 0)) / _PER_SECOND[kind.unit]
        return np.where(missing, np.nan, seconds)
    plain = pa.types.is_integer(kind) or pa.types.is_floating(kind)
    if plain and not column.null_count:
        # As it lies in memory: other ways load pandas, or make a copy first.
        numbers = np.from_dlpack(column)
        return numbers if pa.types.is_integer(kind) else np.asarray(numbers, dtype=np.float64)
    if kind != pa.float64():
        column = column.cast(pa.float64(), safe=False)
    return np.asarray(column.to_numpy(zero_copy_only=not column.null_count), dtype=np.float64)


@contextmanager
def _opened(file: Path) -> Iterator[Any]:
    import pyarrow.parquet as pq

    # Neither buffered whole nor read by threads: a row group may be larger than memory.
    with (
        arrow_file(file) as opened,
        pq.ParquetFile(opened, pre_buffer=False, buffer_size=BUFFER_BYTES) as table,
    ):
        yield table


def _first_stamps(file: Path, names: list[str]) -> dict[str, int]:
    """Return the first value of each column of timestamps, in its own ticks."""
    import pyarrow as pa

    if not names:
        return {}
    with _opened(file) as table:
        batch = next(table.iter_batches(1, columns=names, use_threads=False))
    return {
        name: batch.column(number).cast(pa.int64())[0].as_py() or 0
        for number, name in enumerate(names)
    }


def _from_date(name: str, origins: dict[str, int], schema: Any) -> str:
    ticks = np.datetime64(origins[name], schema.field(name).type.unit)
    return f"seconds from the first sample at {ticks}"
