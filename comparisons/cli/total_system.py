"""The command `sindy-surge total-system`: the method that models the whole facility."""

from __future__ import annotations

import argparse
from collections.abc import Iterable

from classic_ml.io import read_raw
from comparisons import total_system as method
from comparisons.cli.output import write_asked
from comparisons.total_system.facility import facility_of_case, rig_case_of_test
from comparisons.total_system.sensitivity import N_ROWS
from surge_core.errors import InputError
from surge_core.progress import shown_count, shown_steps

TOTAL_SYSTEM_SCHEMA = "sindy-surge/total-system/1"


def run(given: argparse.Namespace) -> Iterable[str]:
    """Fit the model of the whole facility to a raw record."""
    record, test = read_raw(given.raw, given.test)
    case = rig_case_of_test(test.name)
    if given.facility is not None:
        facility, origin = method.read_facility(given.facility), str(given.facility)
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
    if given.table:
        with shown_steps(N_ROWS) as shown:
            rows = method.sensitivity_rows(record, test, settings, progress=shown)
    document = {
        "schema": TOTAL_SYSTEM_SCHEMA,
        "record": record.source,
        "facility": origin,
        "fit": fit.to_json(),
        "sensitivity": rows,
    }
    written = write_asked(
        given, json=lambda: document, save_facility=lambda: method.facility_toml(facility)
    )
    table = [f"\n{method.sensitivity_table(rows)}"] if rows else []
    return f"record:   {record.source}\nfacility: {origin}\n\n{fit}", *table, *written
