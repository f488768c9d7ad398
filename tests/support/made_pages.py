"""Reports of every kind from small objects, with names as anybody may choose them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pandas as pd
from comparison_data import made_comparison, made_series
from raw_data import make_test

from classic_ml.reduction import Reduction, reduce_record
from comparisons.page.blocks import Part, Words
from comparisons.page.html import render_page
from comparisons.results import Caution, Truth
from comparisons.show.report import ReportSection, report_pages

# Each would run, style or load something in a page that does not escape it.
EVIL = (
    "<script>document.title='run'</script>\"'><img src=x onerror=\"document.title='run'\">"
    "</style></title></pre><svg onload=document.title='run'>{{7*7}}{% raw %}&lt;b&gt; $\\frac{1"
)


def made_page(kind: str, name: str = "record.csv") -> str:
    """Return a report.

    Parameters
    ----------
    kind : str
        One of PAGES.
    name : str
        Stands for every name that a user or a file brings: records, tests, channels, methods.
    """
    return PAGES[kind](name)


def _compare(name: str) -> str:
    from comparisons.harness.reconstruction import reconstruct_record

    comparison = made_comparison(
        made_series(source=name),
        cautions=(Caution("ledger", name, "inspect", {"finding": "P25_A: 40 rows clipped"}),),
    )
    phi = np.linspace(0.0, 1.0, 50)
    section = ReportSection(
        name,
        comparison,
        truth=Truth(0.018, phi, 0.3 + 1.2 * phi - 1.5 * phi**2, f"truth of {name}"),
        validation=(reconstruct_record(comparison.results[0].model, made_series(5, name)),),
        extra=(Part(name, (Words(name, "code"),)),),
    )
    return render_page(report_pages([section]), title=name, command=f"sindy-surge compare {name}")


@cache
def _reduction() -> Reduction:
    return reduce_record(*make_test(cells_lbm_s=8.0, noise_counts=1.5).load())


def _reduce(name: str) -> str:
    own = _reduction()
    series = replace(own.series, source=name)
    section = ReportSection(name, reduction=replace(own, series=series))
    return render_page(report_pages([section]), title=name, command=f"sindy-surge reduce {name}")


def _diagnose(name: str) -> str:
    from made_diagnosis import Told, made_diagnosis

    from comparisons.missing_effect.report import diagnosis_report

    d = made_diagnosis("alias_set")
    d = replace(d, data=replace(d.data, sources=(name, f"{name} 2")), unavailable={name: name})
    return diagnosis_report({name: d}, f"sindy-surge diagnose {name}", limits=Told(name))


def _system(name: str) -> str:
    from made_systems import made_diagnosis

    from comparisons.missing_effect.report import diagnosis_report

    d = made_diagnosis(name=name, runs={name: "training", f"{name} 2": "check"})
    d = replace(d, remarks=(name,), unavailable={name: name})
    return diagnosis_report({name: d}, f"sindy-surge diagnose --model {name}")


def _study(name: str) -> str:
    from comparisons.study.report import render_study_report
    from comparisons.study.spec import spec_from

    rng = np.random.default_rng(2)
    rows = [
        {
            "cell": 3 * k + place,
            "record": f"{name} {k}",
            "reduction": f"d-{k}",
            "method": method,
            "seed": k,
            "record.hide": (name, "b")[k % 2],
            "state": "failed" if place == 2 and k == 3 else "ok",
            "reason": name if place == 2 and k == 3 else "",
            "tau_error_ms": 5.0 + 0.5 * place + rng.normal(),
            "seconds": 0.1 * 4.0**place * rng.uniform(0.9, 1.1),
        }
        for k in range(12)
        for place, method in enumerate(("classic_ml", "sindy", f"mine {name}"))
    ]
    spec = spec_from(
        {
            "title": name,
            "scores": ["tau_error_ms"],
            "record": {"hide": ["none", "sensitivity_drift"]},
            "by": ["record.hide"],
            "method": [{"name": "classic_ml"}, {"name": name, "class": "a:B"}],
        }
    )
    return render_study_report(pd.DataFrame(rows), spec, command=f"sindy-surge study {name}")


def _reproduce(name: str) -> str:
    from comparisons.cli.reproduce import claims_sections
    from comparisons.page.blocks import Picture
    from comparisons.page.style import new_figure
    from comparisons.paper.claim import Claim

    figure = new_figure()
    figure.add_subplot().plot([0.0, 1.0, 2.0], [0.0, 1.0, 4.0])
    claims = [
        Claim(1, f"p. 3 {name}", f"The filter {name}", "built in", 48.0, 47.9, True, name, "Hz"),
        Claim(2, "p. 5", "The lag is 18 ms", "tested", 18.0, 29.1, False, "by trial", "ms"),
        Claim(3, "p. 6", "Cells turn", "tested", "half speed", name, True, "spectrum", ""),
    ]
    drawn = [Picture(name, figure, f"Level over time: 0 to 4 in 2 s {name}", "As printed")]
    return render_page(
        report_pages(claims_sections(claims, drawn)),
        title=name,
        command=f"sindy-surge reproduce {name}",
    )


PAGES: dict[str, Callable[[str], str]] = {
    "compare": _compare,
    "reduce": _reduce,
    "diagnose": _diagnose,
    "system": _system,
    "study": _study,
    "reproduce": _reproduce,
}
