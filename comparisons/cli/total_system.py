"""The sub-command `total-system`: the method that models the whole facility, and its price."""

from __future__ import annotations

import argparse
from pathlib import Path

from comparisons.cli.shared import Commands, add_raw, add_targets, check_files, write_all

__all__ = ["TOTAL_SYSTEM_SCHEMA", "add_parser", "run_total_system"]

TOTAL_SYSTEM_SCHEMA = "sindy-surge/total-system/1"


def add_parser(subparsers: Commands) -> None:
    """Add the sub-command.

    Parameters
    ----------
    subparsers : argparse action
        The sub-commands of the parser.
    """
    parser = subparsers.add_parser(
        "total-system",
        help="fit a lumped model of the whole facility, the rival of the component method",
        description="Simulate compressor, plenums, throttle and supply, and adjust the "
        "characteristic and the time constant until P31, P25 and W25 agree with the measured "
        "ones. Needs the facility's numbers and the surge start, which the component method does "
        "not.",
    )
    add_raw(parser)
    parser.add_argument(
        "--facility",
        type=Path,
        metavar="FILE.toml",
        help="the facility's numbers; may be left out for a record of `simulate`",
    )
    parser.add_argument(
        "--save-facility",
        type=Path,
        metavar="FILE.toml",
        help="write the facility's numbers that were used, as a pattern for one's own",
    )
    parser.add_argument(
        "--table",
        action="store_true",
        help="table of what wrong starts (2, 10, 40 ms) and a wrong volume (10 %%) do to this "
        "method and to the component method; takes a minute",
    )
    add_targets(parser, "json")
    parser.set_defaults(run=run_total_system)


def run_total_system(arguments: argparse.Namespace) -> None:
    """Run the sub-command.

    Parameters
    ----------
    arguments : Namespace
        What the parser of `add_parser` gave.

    Raises
    ------
    InputError
        When an input cannot be used; the sentence names it.
    """
    from classic_ml.io import read_raw
    from comparisons import total_system as method
    from comparisons.total_system.rig_facility import facility_of_case, rig_case_of_test
    from comparisons.total_system.sensitivity import N_ROWS
    from surge_core.errors import InputError
    from surge_core.files import to_strict_json
    from surge_core.progress import shown_count, shown_steps

    inputs = [arguments.raw, arguments.test, arguments.facility]
    check_files(inputs, json=arguments.json, facility=arguments.save_facility)
    record, test = read_raw(arguments.raw, arguments.test)
    case = rig_case_of_test(test.name)
    if arguments.facility is not None:
        facility, origin = method.read_facility(arguments.facility), str(arguments.facility)
    elif case is not None:
        facility, origin = facility_of_case(case), f"simulated rig, case {case}"
    else:
        raise InputError(
            "--facility",
            expected="a file with the facility's volumes, throttle, supply and heat exchange",
            found="none",
            remedy="only a record of `sindy-surge simulate` brings them along; --save-facility "
            "writes a pattern from such a record",
        )
    settings = method.TotalSystemSettings(facility)
    with shown_count("fitting", unit=" step") as counted:
        signals = method.measured_signals(record, test)
        fit = method.fit_total_system(signals, settings, progress=counted)
    rows = []
    if arguments.table:
        with shown_steps(N_ROWS) as shown:
            rows = method.sensitivity_rows(record, test, settings, progress=shown)
    document = {
        "schema": TOTAL_SYSTEM_SCHEMA,
        "record": record.source,
        "facility": origin,
        "fit": fit.to_json(),
        "sensitivity": [row.to_json() for row in rows],
    }
    written = write_all(
        [
            ("numbers", arguments.json, lambda: to_strict_json(document)),
            ("facility", arguments.save_facility, lambda: method.facility_toml(facility)),
        ]
    )
    print(f"record:   {record.source}\nfacility: {origin}\n\n{fit}")
    if rows:
        print(f"\n{method.sensitivity_table(rows)}")
    for line in written:
        print(line)
