"""The options of a reduction, which `reduce` and `live` share."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from surge_core.errors import InputError

if TYPE_CHECKING:
    from classic_ml.reduction import ReductionSettings

__all__ = ["add_reduction_options", "options_named", "reduction_settings"]

OPTIONS = {
    "filter_order": "--filter-order",
    "cutoff_hz": "--cutoff",
    "phase": "--phase",
    "probes": "--probes",
    "work_form": "--work-form",
    "threshold_lbm_s": "--threshold",
    "hysteresis_lbm_s": "--hysteresis",
    "window_s": "--window",
}


def add_reduction_options(parser: argparse.ArgumentParser | argparse._ArgumentGroup) -> None:
    """Add the options.

    Parameters
    ----------
    parser : argparse parser or group
        Where they go.
    """
    parser.add_argument(
        "--filter-order",
        type=int,
        default=None,
        metavar="N",
        help="Butterworth order, 3 or 5 (default: 3)",
    )
    parser.add_argument(
        "--cutoff", type=float, default=None, metavar="HZ", help="filter cut-off (default: 48)"
    )
    parser.add_argument(
        "--phase",
        choices=("zero", "causal", "none"),
        default=None,
        help="filter direction (default: zero)",
    )
    parser.add_argument(
        "--probes",
        choices=("all", "tip", "hub"),
        default=None,
        help="probes that are averaged (default: all)",
    )
    parser.add_argument(
        "--invert-thermocouples", action="store_true", help="undo the lag of the thermocouples"
    )
    parser.add_argument(
        "--work-form",
        choices=("auto", "exit-flow", "mass-balance", "temperature-rise"),
        default=None,
        help="ψ by Eq 13 with W31 as measured, or from the temperature rise alone",
    )
    parser.add_argument(
        "--threshold",
        type=float,
        default=None,
        metavar="LBM_S",
        help="corrected flow below which the machine is in stall (default: test.toml's, else "
        "estimated from the record)",
    )
    parser.add_argument(
        "--hysteresis",
        type=float,
        default=None,
        metavar="LBM_S",
        help="half width of a band around the threshold (default: test.toml's, else 0)",
    )
    parser.add_argument(
        "--window",
        type=float,
        nargs=2,
        default=None,
        metavar=("FROM_S", "TO_S"),
        help="window of the quasi-steady cycles, else from test.toml, else found",
    )


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

    given = {
        "filter_order": arguments.filter_order,
        "cutoff_hz": arguments.cutoff,
        "phase": arguments.phase,
        "probes": arguments.probes,
        "work_form": arguments.work_form,
        "thermocouple_inversion": arguments.invert_thermocouples or None,
        "threshold_lbm_s": arguments.threshold,
        "hysteresis_lbm_s": arguments.hysteresis,
        "window_s": tuple(arguments.window) if arguments.window else None,
    }
    return ReductionSettings(**{name: v for name, v in given.items() if v is not None})


@contextmanager
def options_named() -> Iterator[None]:
    """Name the option in an error: a user of the command line does not know the field behind it."""
    try:
        yield
    except InputError as error:
        field = error.where.replace(": ", ".").rsplit(".", 1)[-1]
        if field not in OPTIONS:
            raise
        # An option that is not given is what None is in Python.
        expected = error.expected.replace(", 'none' or None", "").replace(", or None", "")
        raise InputError(
            OPTIONS[field], expected=expected, found=error.found, remedy=error.remedy
        ) from None
