"""`inspect` looks at any file, however spoiled: it shows what there is, or says one sentence."""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path

import pytest
from mistake import Mistake
from mistake_checks import check_printable, check_sentence
from mistake_desk import hand_in
from mistakes_clocks import CLOCKS
from mistakes_formats import FORMATS
from mistakes_hostile import HOSTILE
from mistakes_models import CANARY
from mistakes_raw_files import RAW_FILES
from mistakes_raw_readings import PROBES
from mistakes_series import NETCDF, SERIES

ROWS = tuple(
    row
    for row in (*RAW_FILES, *FORMATS, *CLOCKS, *PROBES, *SERIES, *NETCDF, *HOSTILE)
    if row.command.split()[0] in ("reduce", "compare")
)


@pytest.mark.parametrize("mistake", ROWS, ids=lambda row: row.id)
def test_a_spoiled_file_is_shown_or_refused(mistake: Mistake, clean: Path, tmp_path: Path) -> None:
    words = shlex.split(mistake.command)
    described = " --test test.toml" if words[0] == "reduce" else ""
    command = f"inspect {shlex.quote(words[1])}{described}"
    answer = hand_in(replace(mistake, command=command), clean, tmp_path)
    assert not (tmp_path / CANARY).exists(), "a data file was executed"
    check_printable(answer)
    assert not answer.made
    assert not answer.changed
    if answer.code == 0:
        assert answer.err == ""
        assert answer.out
    else:
        check_sentence(answer)
