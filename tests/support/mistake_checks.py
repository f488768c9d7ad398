"""What a command owes for a mistake, checked on its answer."""

from __future__ import annotations

import re
import unicodedata
from pathlib import Path

from mistake import Mistake
from mistake_desk import Answer, ledger_of, rms_errors

# Categories of Unicode: controls, direction marks, halves of characters, ends of lines.
STEERING = ("Cc", "Cf", "Cs", "Zl", "Zp")
# Files are named relative to the folder here; a sentence that lists several faults is longer.
LONGEST = 1500
# What a programmer would say: a traceback, an object's address, a Python type or error.
PROGRAMMERS_WORDS = re.compile(r"Traceback|<\S+ object|\bnp\.|\bdtype\b|\barray\(|<class")


def check(mistake: Mistake, answer: Answer, clean: Path, folder: Path) -> None:
    """Fail unless the answer is what the table says."""
    check_printable(answer)
    assert not answer.changed, f"changed {answer.changed}"
    if mistake.outcome == "refused":
        check_sentence(answer, mistake.says)
        assert not answer.made, f"left {answer.made}"
        return
    assert answer.code == 0, answer.err
    if mistake.outcome == "flagged":
        stated = [text for text in ledger_of(folder) if text not in ledger_of(clean)]
        missing = [word for word in mistake.says if not any(word in text for text in stated)]
        assert not missing, f"no flag with {missing} among {stated}"
    else:
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
    assert answer.err.startswith("sindy-surge")
    assert len(answer.err) <= LONGEST, f"{len(answer.err)} characters: {answer.err}"
    assert "expected" in answer.err, answer.err
    assert not PROGRAMMERS_WORDS.search(answer.err), answer.err
    missing = [word for word in says if word not in answer.err]
    assert not missing, f"{missing} not in: {answer.err}"
