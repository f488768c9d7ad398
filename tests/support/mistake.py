"""One row of the table of mistakes: what a user did, and what the command line owes him for it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

__all__ = ["FLAGGED", "HARMLESS", "REFUSED", "UNNOTICED", "Mistake", "Outcome", "Spoil"]

Outcome = Literal["refused", "flagged", "harmless", "unnoticed"]
Spoil = Callable[[Path], None]

# Exit 2, one sentence, nothing written.
REFUSED: Outcome = "refused"
# Exit 0, with a flag or a drop in the ledger that names the fault; what is left is right.
FLAGGED: Outcome = "flagged"
# Exit 0 and the numbers of the unspoiled files: nothing was wrong with it.
HARMLESS: Outcome = "harmless"
# Exit 0 and other numbers; nothing in the file shows it. Each says why.
UNNOTICED: Outcome = "unnoticed"

REDUCE = "reduce raw.csv --test test.toml -o reduced.csv"


@dataclass(frozen=True)
class Mistake:
    """A bad input, the command that meets it, and what is expected of the command.

    Parameters
    ----------
    id : str
        Short name, unique in the table.
    did : str
        What the user did, in words.
    outcome : {"refused", "flagged", "harmless", "unnoticed"}
        What the command owes him.
    says : tuple of str
        Words of the sentence on stderr, or of the flags in the ledger: file, channel, row, remedy.
    command : str
        Arguments of ``sindy-surge``, run in the folder of the files.
    why : str
        Why it is harmless, or why nothing can notice it; what would.
    within : tuple of float, optional
        Largest rms errors of φ and ψ' in the segments that both reductions have; None for a result
        that is not compared.
    spoil : callable
        Spoils the files in a folder.
    feed : str
        File that the command gets as its standard input.
    """

    id: str
    did: str
    outcome: Outcome
    says: tuple[str, ...] = ()
    command: str = REDUCE
    why: str = ""
    within: tuple[float, float] | None = None
    spoil: Spoil = field(default=lambda folder: None, compare=False, repr=False)
    feed: str = ""
