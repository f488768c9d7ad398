"""One row of the table of mistakes: what was spoiled, and what the command line owes for it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

Spoil = Callable[[Path], None]

REDUCE = "reduce raw.csv --test test.toml -o reduced.csv"


@dataclass(frozen=True)
class Mistake:
    """A bad input, the command that meets it, and what is expected of the command.

    Refused: exit 2 with one sentence and nothing written. Flagged: exit 0 with a flag or a drop in
    the ledger that names the fault. Harmless: exit 0 with the numbers of the unspoiled files.
    ``says`` holds words of the sentence or of the flags; ``within`` the largest rms errors of φ and
    ψ' in the segments that both reductions have.
    """

    id: str
    outcome: Literal["refused", "flagged", "harmless"]
    says: tuple[str, ...]
    spoil: Spoil = field(default=lambda folder: None, compare=False, repr=False)
    command: str = REDUCE
    within: tuple[float, float] | None = None
