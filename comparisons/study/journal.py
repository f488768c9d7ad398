"""The journal of a study: every finished cell as a line of JSON, written as it comes.

A line goes to the disk whole, in one write to a file opened for appending, and is waited for; what
a killed process leaves is whole lines and at most one torn tail, which is cut off when the study
goes on.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

from surge_core.errors import InputError

__all__ = ["Journal", "finished_cells", "read_rows"]


class Journal:
    """An open journal.

    Parameters
    ----------
    path : path
        The file; it is made where it is missing.
    """

    def __init__(self, path: Path) -> None:
        _cut_torn_tail(path)
        self._file = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)

    def write(self, rows: Iterable[Mapping[str, Any]]) -> None:
        """Write rows, and return when they are on the disk.

        Parameters
        ----------
        rows : iterable of mapping
            Finished cells.
        """
        text = "".join(json.dumps(row) + "\n" for row in rows)
        data = text.encode("ascii")
        while data:
            data = data[os.write(self._file, data) :]
        os.fsync(self._file)

    def close(self) -> None:
        """Close the file."""
        os.close(self._file)

    def __enter__(self) -> Journal:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def _cut_torn_tail(path: Path) -> None:
    """Drop what follows the last whole line."""
    if not path.exists():
        return
    with path.open("r+b") as file:
        end = file.seek(0, os.SEEK_END)
        keep = end
        while keep > 0:
            start = max(0, keep - 65536)
            file.seek(start)
            block = file.read(keep - start)
            found = block.rfind(b"\n")
            if found >= 0:
                keep = start + found + 1
                break
            keep = start
        if keep < end:
            file.truncate(keep)


def read_rows(path: Path) -> Iterator[dict[str, Any]]:
    """Yield the rows of a journal, a torn last line left out.

    Parameters
    ----------
    path : path
        The file; a missing one has no rows.

    Raises
    ------
    InputError
        When a whole line is not a row.
    """
    if not path.exists():
        return
    with path.open("rb") as file:
        for number, line in enumerate(file, start=1):
            if not line.endswith(b"\n"):
                return
            try:
                row = json.loads(line)
                row["cell"] = int(row["cell"])
            except (ValueError, TypeError, KeyError) as error:
                raise InputError(
                    f"{path}: line {number}",
                    expected="a finished cell as JSON",
                    found=line[:60].decode("utf-8", "replace"),
                    remedy="take the line out, and the cell is run again",
                ) from error
            yield row


def finished_cells(
    path: Path, again: Callable[[Mapping[str, Any]], bool] = lambda _: False
) -> frozenset[int]:
    """Return the numbers of the cells in a journal.

    Parameters
    ----------
    path : path
        The file.
    again : callable
        Tells of a row whether its cell is to be run again; the last row of a cell counts.
    """
    open_again = {row["cell"]: again(row) for row in read_rows(path)}
    return frozenset(cell for cell, is_open in open_again.items() if not is_open)
