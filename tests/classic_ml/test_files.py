"""Results are written whole or not at all, to files of their own, and failures name them."""

from __future__ import annotations

import errno
import os
import re
from pathlib import Path

import pytest

from surge_core.errors import InputError
from surge_core.files import check_apart, replace_whole


@pytest.mark.parametrize("way", ["same", "symbolic link", "relative"])
def test_an_input_is_not_replaced_under_any_of_its_names(
    tmp_path: Path, way: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    raw, other = tmp_path / "raw.csv", tmp_path / "other.csv"
    raw.write_text("1", "utf-8")
    if way == "symbolic link":
        other.symlink_to(raw)
    elif way == "relative":
        monkeypatch.chdir(tmp_path)
        other = Path("raw.csv")
    else:
        other = raw
    with pytest.raises(InputError, match="a file of its own for each output, found an input"):
        check_apart([raw], [other])
    check_apart([raw], [tmp_path / "new.csv", tmp_path / "newer.csv"])
    with pytest.raises(InputError, match="another output"):
        check_apart([raw], [tmp_path / "new.csv", tmp_path / "new.csv"])


def test_a_full_disk_is_told_by_the_name_that_the_user_gave(tmp_path: Path) -> None:
    """Libraries name no file, or the temporary one that nobody knows."""
    path = tmp_path / "series.csv"

    def nameless(_: Path) -> None:
        raise OSError(errno.EFBIG, os.strerror(errno.EFBIG))

    def temporary(neighbour: Path) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(neighbour))

    for write in (nameless, temporary):
        with pytest.raises(OSError, match=re.escape(str(path))) as caught:
            replace_whole(path, write)
        assert caught.value.filename == str(path)
        assert caught.value.strerror
    assert not list(tmp_path.iterdir())
