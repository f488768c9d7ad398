"""Columns that grow by rows, as a file is read or as readings come in."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from classic_ml.columns.workspace import Workspace
from surge_core.errors import InputError
from surge_core.types import FloatArray

__all__ = ["GrowingColumns"]


# Rows that come in a few at a time are gathered so many before they are put away.
STAGED_ROWS = 4_096


class GrowingColumns:
    """Columns that grow by rows, as a file is read or as readings come in.

    Parameters
    ----------
    workspace : Workspace
        Where they lie.
    n_columns : int
        Number of columns.
    n_rows : int, optional
        Rows that are to be expected, where that is known.
    readings : bool
        Whether whole numbers are to be expected, as a converter gives them.
    """

    def __init__(
        self,
        workspace: Workspace,
        n_columns: int,
        n_rows: int | None = None,
        *,
        readings: bool = False,
    ) -> None:
        writer = workspace.readings_writer if readings else workspace.writer
        self._writers = [writer(n_rows) for _ in range(n_columns)]
        self._staged = np.empty((n_columns, STAGED_ROWS))
        self._n_staged = 0
        self._n_put = 0

    @property
    def n_rows(self) -> int:
        """Rows so far."""
        return self._n_put + self._n_staged

    def append(self, rows: ArrayLike) -> None:
        """Take up further rows.

        Parameters
        ----------
        rows : array_like of shape (m, n_columns)
            One row a sample.
        """
        values = np.asarray(rows, dtype=np.float64)
        if values.ndim != 2 or values.shape[1] != len(self._writers):
            raise InputError(
                "rows", expected=f"{len(self._writers)} values in each", found=f"{values.shape}"
            )
        self.append_columns(tuple(values.T))

    def append_columns(self, columns: Sequence[NDArray[Any]]) -> None:
        """Take up further rows, column by column.

        Parameters
        ----------
        columns : sequence of ndarray of shape (m,)
            One a column, of numbers that are float64 or become such.
        """
        n_rows = columns[0].size if columns else 0
        if self._n_staged + n_rows > STAGED_ROWS:
            self._put(self._staged[:, : self._n_staged])
            self._n_staged = 0
        if n_rows > STAGED_ROWS:
            self._put(columns)
            return
        stop = self._n_staged + n_rows
        for staged, column in zip(self._staged, columns, strict=True):
            staged[self._n_staged : stop] = column
        self._n_staged = stop

    def _put(self, columns: Sequence[NDArray[Any]] | FloatArray) -> None:
        for writer, column in zip(self._writers, columns, strict=True):
            writer.append(column)
        self._n_put += columns[0].size

    def finished(self) -> list[FloatArray]:
        """Return the columns, each of shape (n_rows,) and read-only; it ends the growth."""
        self._put(self._staged[:, : self._n_staged])
        self._n_staged = 0
        return [writer.finished() for writer in self._writers]
