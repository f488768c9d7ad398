"""What a command owes whoever handed in a mistake, checked on its answer."""

from __future__ import annotations

import csv
import re
import unicodedata
from pathlib import Path

from mistake import FLAGGED, HARMLESS, REFUSED, Mistake
from mistake_desk import Answer, ledger_of, rms_errors
from mistakes_hostile import SCRIPT
from mistakes_models import CANARY

__all__ = ["LONGEST", "check", "check_printable", "check_sentence"]

# Categories of Unicode: controls, direction marks, halves of characters, ends of lines.
STEERING = ("Cc", "Cf", "Cs", "Zl", "Zp")

# A sentence that is read at once; files are named relative to the folder here.
LONGEST = 350
# What a programmer would say: a traceback, an object's address, a Python type or error.
PROGRAMMERS_WORDS = re.compile(
    r"Traceback|found None\b|<\S+ object|\bnp\.|\bdtype\b|\barray\(|\b\w+Error\b|codec|"
    r"\bdatetime\.|found (?:True|False)\b|<class"
)
NUMBER = re.compile(r"[-+][\d.]")


def check(mistake: Mistake, answer: Answer, clean: Path, folder: Path) -> None:
    """Fail unless the answer is what the table says."""
    assert not (folder / CANARY).exists(), "a data file was executed"
    check_printable(answer)
    assert not [n for n in answer.made if Path(n).name.startswith(".")], "temporary files are left"
    assert not answer.changed, f"changed {answer.changed}"
    if mistake.outcome == REFUSED:
        check_sentence(answer, mistake.says)
        # What came in live and cannot come again is kept, and the sentence says where.
        kept = [n for n in answer.made if mistake.feed and n in answer.err.partition(" kept: ")[2]]
        assert not set(answer.made) - set(kept), f"left {answer.made}"
        return
    assert answer.code == 0, answer.err
    _check_outputs(answer, folder)
    if mistake.outcome == FLAGGED:
        _check_flags(mistake, answer, clean, folder)
    if mistake.outcome == HARMLESS:
        assert answer.err == ""
    if mistake.within is not None:
        errors = rms_errors(clean / "reduced.csv", folder / "reduced.csv")
        assert errors[0] <= mistake.within[0], f"φ is off by {errors[0]:.3g}"
        assert errors[1] <= mistake.within[1], f"ψ' is off by {errors[1]:.3g}"


def check_printable(answer: Answer) -> None:
    """Fail when something that was printed would steer a terminal."""
    steering = {c for c in answer.out + answer.err if unicodedata.category(c) in STEERING}
    assert steering <= {"\n", "\t"}, steering


def check_sentence(answer: Answer, says: tuple[str, ...] = ()) -> None:
    """Fail unless the input was refused in one sentence with these words."""
    assert answer.code == 2, answer.out + answer.err
    assert answer.out == ""
    assert answer.err.count("\n") == 1, answer.err
    assert answer.err.endswith("\n")
    assert answer.err.startswith("sindy-surge")
    assert len(answer.err) <= LONGEST, f"{len(answer.err)} characters: {answer.err}"
    assert "expected" in answer.err or "No space left" in answer.err, answer.err
    # A model of the user's own is told of its own errors by their names.
    if ", line " not in answer.err:
        assert not PROGRAMMERS_WORDS.search(answer.err), answer.err
    missing = [word for word in says if word not in answer.err]
    assert not missing, f"{missing} not in: {answer.err}"


def _check_flags(mistake: Mistake, answer: Answer, clean: Path, folder: Path) -> None:
    if "reduced.csv" in answer.made:
        told = [text for text in ledger_of(folder) if text not in ledger_of(clean)]
    else:
        told = (answer.out + answer.err).splitlines()
    missing = [word for word in mistake.says if not any(word in text for text in told)]
    assert not missing, f"no flag with {missing} among {told}"


def _check_outputs(answer: Answer, folder: Path) -> None:
    """Fail when a page holds text that acts, or a table a cell that a spreadsheet executes."""
    for name in answer.made:
        if name.endswith(".html"):
            page = (folder / name).read_text("utf-8")
            assert SCRIPT not in page
            assert "<img src=x" not in page
        if name.endswith(".csv"):
            with (folder / name).open(encoding="utf-8", newline="") as lines:
                cells = [cell for row in csv.reader(lines) for cell in row]
            assert not [c for c in cells if c[:1] in ("=", "@", "\t")]
            assert not [c for c in cells if c[:1] in "+-" and c and not NUMBER.match(c)]
