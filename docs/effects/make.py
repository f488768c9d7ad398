"""Write the measured blocks and the pictures of the effect pages; their prose stays as it is.

    python docs/effects/make.py                       all pages, some twenty minutes
    python docs/effects/make.py --only NAME,...       some of them; systems/NAME of the general one
    python docs/effects/make.py --plain               only what the code alone gives, in seconds
    python docs/effects/make.py --records NAME -o DIR the records of a picture, as series files

A page holds blocks between `% made: NAME` and `% end`. Those of the compressor's catalogue are in
`docs/effects`, those of the general one in `docs/effects/systems`.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import lag_effects
import system_effects
from blocks import with_blocks
from lag_pictures import draw_hidden, save_picture
from system_pictures import draw_system

HERE = Path(__file__).parent
SYSTEMS = HERE / "systems"


def page_of(name: str, *, system: bool) -> Path:
    """Return the page of an effect.

    Parameters
    ----------
    name : str
        Of the effect.
    system : bool
        Whether it is one of the general catalogue.
    """
    return (SYSTEMS if system else HERE) / f"{name}.md"


def write_page(name: str, *, system: bool, plain: bool) -> None:
    """Replace the blocks of one page, and its picture.

    Parameters
    ----------
    name : str
        Of the effect.
    system : bool
        Whether it is one of the general catalogue.
    plain : bool
        Leave what must be measured.
    """
    home = system_effects if system else lag_effects
    page = page_of(name, system=system)
    made = dict(home.plain_blocks(name))
    if not plain:
        made |= home.measured_blocks(name)
        figure = draw_system(name) if system else draw_hidden(name)
        save_picture(figure, page.parent / "pictures" / f"{name}.png")
    page.write_text(with_blocks(page.read_text("utf-8"), made), "utf-8")


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument(
        "--only", metavar="NAME,...", help="these effects; systems/NAME is of the general one"
    )
    parser.add_argument("--plain", action="store_true", help="leave what must be measured")
    parser.add_argument("--records", metavar="NAME", help="write the records of a picture")
    parser.add_argument("-o", "--out", type=Path, default=Path("records"), metavar="DIR")
    options = parser.parse_args(arguments)
    if options.records:
        for file in lag_effects.write_records(options.records, options.out):
            sys.stdout.write(f"{file}\n")
        return
    for home, folder in ((lag_effects, HERE), (system_effects, SYSTEMS)):
        page = folder / "index.md"
        made = {"table": home.index_block()}
        page.write_text(with_blocks(page.read_text("utf-8"), made), "utf-8")
    wanted = options.only.split(",") if options.only else None
    for system, names in ((False, lag_effects.NAMES), (True, system_effects.NAMES)):
        for name in names:
            shown = f"systems/{name}" if system else name
            if wanted is None or shown in wanted:
                sys.stderr.write(f"{shown}\n")
                write_page(name, system=system, plain=options.plain)


if __name__ == "__main__":
    main()
