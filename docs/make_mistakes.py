"""Write the page of mistakes: what was wrong in a file, and what the program says of it.

    python docs/make_mistakes.py                 all rows: each is made and handed in, in a minute
    python docs/make_mistakes.py --only ID,...   these rows anew; the others stay as they are

The rows are those of `tests/support/mistakes.py`, which the tests run. A sentence on the page is
what the command printed when the page was last written.
"""

from __future__ import annotations

import argparse
import os
import re
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE / "effects"), str(HERE.parent / "tests" / "support")]

from blocks import blocks_of, with_blocks  # noqa: E402
from mistake import FLAGGED, HARMLESS, REFUSED, UNNOTICED, Mistake  # noqa: E402
from mistake_desk import clean_files, hand_in, ledger_of  # noqa: E402
from mistakes import GROUPS, MISTAKES  # noqa: E402

__all__ = ["PAGE", "answer_of", "count_block", "groups_block", "said_on"]

PAGE = HERE / "mistakes.md"
# Of a flag that names many probes the beginning tells enough.
LONGEST = 350
# To whoever may write anywhere no folder is shut: what the page has of it stays.
SHUT, IS_ROOT = "target-shut", hasattr(os, "geteuid") and os.geteuid() == 0
HEADS = "| what was wrong | what the program says |\n| --- | --- |"


def answer_of(mistake: Mistake, clean: Path) -> str:
    """Make a mistake and return what the program says of it, as the page shows it.

    Parameters
    ----------
    mistake : Mistake
        The row.
    clean : path
        Folder with the clean files.

    Raises
    ------
    ValueError
        When it is not refused as the table says.
    """
    if mistake.outcome in (HARMLESS, UNNOTICED):
        word = "Harmless" if mistake.outcome == HARMLESS else "Unnoticed"
        return f"**{word}**: {_plain(mistake.why)}"
    with TemporaryDirectory() as name:
        folder = Path(name)
        answer = hand_in(mistake, clean, folder)
        if mistake.outcome == REFUSED and answer.code != 2:
            raise ValueError(f"{mistake.id}: expected exit code 2, found {answer.code}")
        if mistake.outcome == REFUSED:
            sentence = re.sub(r"^sindy-surge[ \w-]*: ", "", answer.err.strip())
            return f"**Refused**: {_code(sentence)}"
        if "reduced.csv" in answer.made:
            told = [text for text in ledger_of(folder) if text not in ledger_of(clean)]
        else:
            told = (answer.out + answer.err).splitlines()
    own = [text for text in told if any(word in text for word in mistake.says)] or told
    return f"**Noted**: {_code(own[0])}"


def _code(text: str) -> str:
    """Return a text letter by letter, in a cell of a table."""
    shown = text if len(text) <= LONGEST else text[: LONGEST - 1] + "…"
    shown = shown.replace("|", r"\|")
    return f"`` {shown} ``" if "`" in shown else f"`{shown}`"


def _plain(text: str) -> str:
    return re.sub(r"([\\*_|<>$\[\]])", r"\\\1", text)


def count_block() -> str:
    """Return how many mistakes there are, and what becomes of them."""
    counts = Counter(mistake.outcome for mistake in MISTAKES)
    return (
        f"Of the {len(MISTAKES)} mistakes below {counts[REFUSED]} are refused and "
        f"{counts[FLAGGED]} noted; {counts[HARMLESS]} are harmless, and {counts[UNNOTICED]} go "
        "unnoticed."
    )


def groups_block(said: Mapping[str, str]) -> str:
    """Return the tables of all groups.

    Parameters
    ----------
    said : mapping of str to str
        What the program says, by the row's id.
    """
    parts = []
    for title, rows in GROUPS.items():
        commands = {_command(row) for row in rows}
        lines = [f"## {title}", ""]
        if len(commands) == 1:
            lines += [f"Handed to `{next(iter(commands))}`.", ""]
        lines.append(HEADS)
        lines += [f"| {_first(row, rows)} | {said[row.id]} |" for row in rows]
        parts.append("\n".join(lines))
    return "\n\n".join(parts)


def _first(mistake: Mistake, group: Sequence[Mistake]) -> str:
    """Return the first cell of a row: with the command, where those of its group differ."""
    command = _command(mistake)
    alike = len({_command(row) for row in group}) == 1
    return f"{'' if alike or not command else f'`{command}`: '}{_plain(mistake.did)}"


def _command(mistake: Mistake) -> str:
    first = mistake.command.split()[:1]
    return f"sindy-surge {first[0]}" if first and first[0].replace("-", "").isalpha() else ""


def said_on(page: Path) -> dict[str, str]:
    """Return what a page shows for the rows of the table that are on it, by the row's id.

    Parameters
    ----------
    page : path
        The page.
    """
    shown, title = {}, ""
    for line in blocks_of(page).get("groups", "").splitlines():
        title = line.removeprefix("## ") if line.startswith("## ") else title
        first, found, second = line.removeprefix("| ").partition(" | **")
        if found:
            shown[title, first] = f"**{second}".removesuffix(" |")
    keys = {row.id: (title, _first(row, rows)) for title, rows in GROUPS.items() for row in rows}
    return {id_: shown[key] for id_, key in keys.items() if key in shown}


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--only", metavar="ID,...", help="these rows; the others stay as they are")
    options = parser.parse_args(arguments)
    wanted = set(options.only.split(",")) if options.only else {row.id for row in MISTAKES}
    said = said_on(PAGE)
    with TemporaryDirectory() as name:
        clean = clean_files(Path(name))
        for row in MISTAKES:
            if row.id in wanted:
                sys.stderr.write(f"{row.id}\n")
                if row.id == SHUT and IS_ROOT and row.id in said:
                    continue
                said[row.id] = answer_of(row, clean)
    made = {"count": count_block(), "groups": groups_block(said)}
    PAGE.write_text(with_blocks(PAGE.read_text("utf-8"), made), "utf-8")


if __name__ == "__main__":
    main()
