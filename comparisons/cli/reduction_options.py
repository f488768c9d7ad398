"""The options of a reduction, which `reduce` and `live` share."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from comparisons.cli.shared import number, whole
from surge_core.errors import InputError

if TYPE_CHECKING:
    from classic_ml.reduction import ReductionSettings

__all__ = [
    "add_read_window",
    "add_reduction_options",
    "options_named",
    "read_window",
    "reduction_settings",
]

# Option, the field of the settings behind it, and what argparse has to know.
OPTIONS: tuple[tuple[str, str, dict[str, Any]], ...] = (
    ("--filter-order", "filter_order", {"type": whole(1, 99), "metavar": "N"}),
    ("--cutoff", "cutoff_hz", {"type": number, "metavar": "HZ"}),
    ("--phase", "phase", {"choices": ("zero", "causal", "none")}),
    ("--probes", "probes", {"choices": ("all", "tip", "hub")}),
    (
        "--invert-thermocouples",
        "thermocouple_inversion",
        {"action": "store_const", "const": True},
    ),
    (
        "--work-form",
        "work_form",
        {"choices": ("auto", "exit-flow", "mass-balance", "temperature-rise")},
    ),
    ("--threshold", "threshold_lbm_s", {"type": number, "metavar": "LBM_S"}),
    ("--hysteresis", "hysteresis_lbm_s", {"type": number, "metavar": "LBM_S"}),
    ("--window", "window_s", {"type": number, "nargs": 2, "metavar": ("FROM_S", "TO_S")}),
)
HELP = {
    "--filter-order": "Butterworth order, 3 or 5 (default: 3)",
    "--cutoff": "filter cut-off (default: 48)",
    "--phase": "filter direction (default: zero)",
    "--probes": "probes that are averaged (default: all)",
    "--invert-thermocouples": "undo the lag of the thermocouples",
    "--work-form": "ψ by Eq 13 with W31 as measured, or from the temperature rise alone",
    "--threshold": "corrected flow below which the machine is in stall (default: test.toml's, else "
    "estimated from the record)",
    "--hysteresis": "half width of a band around the threshold (default: test.toml's, else 0)",
    "--window": "window of the quasi-steady cycles, else from test.toml, else found",
}


def add_reduction_options(parser: argparse.ArgumentParser | argparse._ArgumentGroup) -> None:
    """Add the options.

    Parameters
    ----------
    parser : argparse parser or group
        Where they go.
    """
    for option, field, details in OPTIONS:
        parser.add_argument(option, dest=field, help=HELP[option], **details)


def add_read_window(parser: argparse.ArgumentParser | argparse._ArgumentGroup) -> None:
    """Add the options that read a part of a file.

    Parameters
    ----------
    parser : argparse parser or group
        Where they go.
    """
    for option, end in (("--from-s", "start"), ("--to-s", "end")):
        parser.add_argument(
            option,
            type=float,
            default=None,
            metavar="SECONDS",
            help=f"{end} of the part of the file that is read, on its clock; the near-stall "
            "reading is read with it (default: all of it)",
        )


def read_window(arguments: argparse.Namespace) -> tuple[float, float] | None:
    """Return the part of the file that is to be read; None for all of it.

    Parameters
    ----------
    arguments : argparse.Namespace
        With the options of :func:`add_read_window`.
    """
    if arguments.from_s is None and arguments.to_s is None:
        return None
    from_s = -math.inf if arguments.from_s is None else arguments.from_s
    to_s = math.inf if arguments.to_s is None else arguments.to_s
    if not from_s < to_s:
        raise InputError("--to-s", expected=f"a time after {from_s:g} s", found=f"{to_s:g}")
    return from_s, to_s


def reduction_settings(arguments: argparse.Namespace) -> ReductionSettings:
    """Take over what was given; the rest keeps the defaults of the reduction.

    Parameters
    ----------
    arguments : argparse.Namespace
        With the options of :func:`add_reduction_options`.

    Raises
    ------
    InputError
        Naming the field of the settings; :func:`options_named` makes the option of it.
    """
    from classic_ml.reduction import ReductionSettings

    given = {field: getattr(arguments, field) for _, field, _ in OPTIONS}
    if given["window_s"] is not None:
        given["window_s"] = tuple(given["window_s"])
    return ReductionSettings(**{name: value for name, value in given.items() if value is not None})


@contextmanager
def options_named() -> Iterator[None]:
    """Name the option in an error: a user of the command line does not know the field behind it."""
    try:
        yield
    except InputError as error:
        # A key of test.toml that has the name of a setting is no option.
        table, _, field = error.where.rpartition(": ")[2].rpartition(".")
        named = {name: option for option, name, _ in OPTIONS}
        if field not in named or table not in ("", "ReductionSettings"):
            raise
        raise InputError(
            named[field], expected=error.expected, found=error.found, remedy=error.remedy
        ) from None
