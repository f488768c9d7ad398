"""The options of a reduction, which `reduce` and `live` share."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from comparisons.cli.options import argument, number, whole
from surge_core.errors import InputError

if TYPE_CHECKING:
    from classic_ml.reduction_settings import ReductionSettings

# Each is stored under the name of the field of the settings behind it.
REDUCTION = (
    argument(
        "--filter-order",
        type=whole(1, 99),
        metavar="N",
        help="Butterworth order, 3 or 5 (default: 3)",
    ),
    argument(
        "--cutoff",
        dest="cutoff_hz",
        type=number,
        metavar="HZ",
        help="filter cut-off (default: 48)",
    ),
    argument(
        "--phase",
        choices=("zero", "causal", "none"),
        help="filter direction (default: zero)",
    ),
    argument(
        "--invert-thermocouples",
        dest="thermocouple_inversion",
        action="store_const",
        const=True,
        help="undo the lag of the thermocouples",
    ),
    argument(
        "--threshold",
        dest="threshold_lbm_s",
        type=number,
        metavar="LBM_S",
        help="corrected flow below which the machine is in stall (default: test.toml's, else "
        "estimated from the record)",
    ),
    argument(
        "--window",
        dest="window_s",
        type=number,
        nargs=2,
        metavar=("FROM_S", "TO_S"),
        help="window of the quasi-steady cycles, else from test.toml, else found",
    ),
)


def reduction_settings(given: argparse.Namespace) -> ReductionSettings:
    """Take over what was given; the rest keeps the defaults of the reduction.

    Parameters
    ----------
    given : argparse.Namespace
        With the arguments of ``REDUCTION``.

    Raises
    ------
    InputError
        Naming the field of the settings; :func:`options_named` makes the option of it.
    """
    from classic_ml.reduction_settings import ReductionSettings

    fields = {each.name: getattr(given, each.name) for each in REDUCTION}
    if given.window_s is not None:
        fields["window_s"] = tuple(given.window_s)
    return ReductionSettings(**{name: value for name, value in fields.items() if value is not None})


@contextmanager
def options_named() -> Iterator[None]:
    """Name the option in an error: a user of the command line does not know the field behind it."""
    try:
        yield
    except InputError as error:
        # A key of test.toml that has the name of a setting is no option.
        table, _, field = error.where.rpartition(": ")[2].rpartition(".")
        options = {each.name: each.flags[0] for each in REDUCTION}
        if field not in options or table not in ("", "ReductionSettings"):
            raise
        raise InputError(
            options[field], expected=error.expected, found=error.found, remedy=error.remedy
        ) from None
