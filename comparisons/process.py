"""The command `sindy-surge` as a process of its own, from its first line to its end."""

from __future__ import annotations

import atexit
import gc
import sys

__all__ = ["run"]

# 128 + SIGINT, as a shell reports a process that was interrupted.
EXIT_INTERRUPTED = 130
# Packages load some hundred thousand objects, none of which is garbage: with the usual 700 the
# collector goes through them again and again.
OBJECTS_BETWEEN_COLLECTIONS = 50_000


def run() -> int:
    """Run the command line of this process, and return its exit code.

    What Python does at its end is to look for garbage in all that was loaded, for a quarter of a
    second: of that it is relieved.

    Returns
    -------
    int
        As :func:`comparisons.cli.main`.
    """
    gc.set_threshold(OBJECTS_BETWEEN_COLLECTIONS)
    atexit.register(gc.freeze)
    try:
        from comparisons.cli import main

        return main()
    except KeyboardInterrupt:
        print("sindy-surge: interrupted", file=sys.stderr)
        return EXIT_INTERRUPTED
