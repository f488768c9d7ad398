"""One row of the table of mistakes: what was spoiled, and what the command line owes for it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

__all__ = ["REDUCE", "Mistake", "Spoil"]

Spoil = Callable[[Path], None]

REDUCE = "reduce raw.csv --test test.toml -o reduced.csv"


@dataclass(frozen=True)
class Mistake:
    """A bad input, the command that meets it, and what is expected of the command.

    Parameters
    ----------
    id : str
        Short name, unique in the table.
    outcome : {"refused", "flagged", "harmless"}
        Exit 2 with one sentence and nothing written; exit 0 with a flag or a drop in the ledger
        that names the fault; exit 0 with the numbers of the unspoiled files.
    says : tuple of str
        Words of the sentence on stderr, or of the flags in the ledger: file, channel, row, remedy.
    spoil : callable
        Spoils the files in a folder.
    command : str
        Arguments of ``sindy-surge``, run in the folder of the files.
    within : tuple of float, optional
        Largest rms errors of φ and ψ' in the segments that both reductions have; None for a result
        that is not compared.
    """

    id: str
    outcome: Literal["refused", "flagged", "harmless"]
    says: tuple[str, ...]
    spoil: Spoil = field(default=lambda folder: None, compare=False, repr=False)
    command: str = REDUCE
    within: tuple[float, float] | None = None
