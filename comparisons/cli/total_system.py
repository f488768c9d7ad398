"""The sub-command `total-system`: the method that models the whole facility, and its price."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

if TYPE_CHECKING:
    from classic_ml.io import TestDescription
    from comparisons.total_system import Facility, TotalSystemFit

__all__ = ["TOTAL_SYSTEM_SCHEMA", "add_parser", "run_total_system"]

TOTAL_SYSTEM_SCHEMA = "sindy-surge/total-system/1"
_Commands: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"


def add_parser(subparsers: _Commands) -> None:
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
    parser.add_argument("raw", type=Path, metavar="RAW", help="raw record (.csv)")
    parser.add_argument("--test", type=Path, required=True, help="description of the test (.toml)")
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
        "--start",
        choices=("multiple-shooting", "aligned", "fitted"),
        default="multiple-shooting",
        help="how the surge start is had (default: multiple-shooting)",
    )
    parser.add_argument(
        "--volume-factor",
        type=float,
        default=1.0,
        metavar="F",
        help="multiply the discharge volume that the model takes (default: 1)",
    )
    parser.add_argument(
        "--start-error",
        type=float,
        default=0.0,
        metavar="MS",
        help="move the surge start by as many milliseconds (default: 0)",
    )
    parser.add_argument(
        "--horizon",
        type=float,
        default=None,
        metavar="SECONDS",
        help="what a single run fits after the first reversal (default: 0.5)",
    )
    parser.add_argument(
        "--table",
        action="store_true",
        help="table of what wrong starts (2, 10, 40 ms) and a wrong volume (10 %%) do to this "
        "method and to the component method; takes minutes",
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the numbers as JSON")
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
    from comparisons.total_system import (
        TotalSystemSettings,
        facility_toml,
        fit_total_system,
        measured_signals,
    )
    from surge_core.errors import InputError
    from surge_core.files import check_apart, check_target, to_strict_json, write_whole
    from surge_core.progress import shown_count, shown_steps

    outputs = [path for path in (arguments.json, arguments.save_facility) if path is not None]
    for path in outputs:
        check_target(path)
    inputs = [arguments.raw, arguments.test]
    check_apart([*inputs, *([arguments.facility] if arguments.facility else [])], outputs)
    record, test = read_raw(arguments.raw, arguments.test)
    facility, origin = _facility(arguments.facility, test)
    given: dict[str, Any] = {} if arguments.horizon is None else {"horizon_s": arguments.horizon}
    try:
        settings = TotalSystemSettings(
            facility,
            start=arguments.start,
            start_error_s=1e-3 * arguments.start_error,
            volume_factor=arguments.volume_factor,
            **given,
        )
        measured = measured_signals(record, test)
        with shown_count("fitting", unit=" step") as counted:
            fit = fit_total_system(measured, settings, progress=counted)
        rows = []
        if arguments.table:
            from comparisons.total_system.sensitivity import N_ROWS, sensitivity_rows

            with shown_steps(N_ROWS) as shown:
                rows = sensitivity_rows(record, test, settings, progress=shown)
    except InputError as error:
        raise _in_options(error, InputError) from None
    if arguments.save_facility:
        write_whole(arguments.save_facility, facility_toml(facility))
    if arguments.json:
        document = {
            "schema": TOTAL_SYSTEM_SCHEMA,
            "record": record.source,
            "facility": origin,
            "fit": fit.to_json(),
            "sensitivity": [row.to_json() for row in rows],
        }
        write_whole(arguments.json, to_strict_json(document))
    _print(fit, record.source, origin)
    if rows:
        from comparisons.total_system import sensitivity_table

        _say(f"\n{sensitivity_table(rows)}")
    for label, path in (("numbers", arguments.json), ("facility", arguments.save_facility)):
        if path:
            _say(f"{label}: {path}")


def _facility(path: Path | None, test: TestDescription) -> tuple[Facility, str]:
    """Return the facility and where its numbers come from."""
    from comparisons.total_system import read_facility
    from comparisons.total_system.rig_facility import facility_of_case, rig_case_of_test
    from surge_core.errors import InputError

    if path is not None:
        return read_facility(path), str(path)
    case = rig_case_of_test(test.name)
    if case is None:
        raise InputError(
            "--facility",
            expected="a file with the facility's volumes, throttle, supply and heat exchange",
            found="none",
            remedy="only a record of `sindy-surge simulate` brings them along; --save-facility "
            "writes a pattern from such a record",
        )
    return facility_of_case(case), f"simulated rig, case {case}"


_OPTIONS = {
    "start_error_s": "--start-error (in s)",
    "volume_factor": "--volume-factor",
    "horizon_s": "--horizon",
}


def _in_options(error: Any, kind: type[Exception]) -> Exception:
    """Name the option where the error names the setting behind it."""
    where = error.where.removeprefix("TotalSystemSettings.")
    return kind(
        _OPTIONS.get(where, error.where),
        expected=error.expected,  # type: ignore[call-arg]
        found=error.found,
        remedy=error.remedy,
    )


def _print(fit: TotalSystemFit, source: str, origin: str) -> None:
    from surge_core.rounding import round_to_error, significant

    _say(f"Total-system fit of {source}\nfacility: {origin}\n")
    _say(f"  τ      {round_to_error(1e3 * fit.tau_s, 1e3 * fit.tau_stderr_s)} ms")
    for name, value, error in zip(("β₁", "β₂", "β₃"), fit.beta, fit.beta_stderr, strict=True):
        _say(f"  {name}     {round_to_error(value, error)}")
    for name, (value, error) in fit.others.items():
        _say(f"  {name}  {round_to_error(value, error)}" + (" s" if name == "start" else ""))
    _say(f"  surge start {fit.start_s:.4f} s, {fit.n_segments} runs over {fit.n_rows} rows")
    units = {"P31": "Pa", "P25": "Pa", "W25": "kg/s"}
    for name, rms in fit.rms.items():
        share = 100.0 * fit.relative_rms[name]
        _say(
            f"  residual of {name}: {significant(rms, 3)} {units[name]}, {share:.1f} % of its swing"
        )
    _say(f"  {fit.state.code}: {fit.state.value}")


def _say(text: str) -> None:
    sys.stdout.write(text + "\n")
