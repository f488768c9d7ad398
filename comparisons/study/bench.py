"""The bench: methods on machines drawn at random, scored against a truth that they never see.

A study whose records are machines of every rig that is installed, and one row a method of what came
out: how often it answers, how far off, whether its interval holds the truth, and how it ranks.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from scipy.stats import friedmanchisquare, studentized_range

from comparisons.harness.methods import method_name, named_methods
from comparisons.page.style import ACCENT, INK, panel
from comparisons.study.rigs import draw_of, rig_names
from comparisons.study.spec import BUILT_IN, StudySpec, spec_from

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# A τ is right within 2 ms or 10 %, grossly wrong beyond 30 % with an interval that misses, and a
# curve right within 0.15, its rms error over the φ that was scored.
WITHIN_S, WITHIN_SHARE, GROSS_SHARE, CURVE_WITHIN = 2e-3, 0.10, 0.30, 0.15
LEVEL = 0.05
SCORES = ["tau_error_ms", "tau_covered", "curve_rms_error", "false_names"]


# What is counted of a method, and the head of its column: records, and those on which it states a
# τ; answers within 2 ms or 10 %, whose 95 % interval holds the truth, off by 30 % and more with an
# interval that misses, or none; curves that are stated where the truth is known, and those within
# 0.15; records with a firm name of a missing effect, and with one that is not there; records on
# which it failed without a sentence.
COUNTS = {
    "method": "method",
    "machines": "machines",
    "answers": "answers",
    "within": "within 2 ms or 10 %",
    "covered": "interval holds τ",
    "gross": "gross",
    "curves": "curves",
    "curves_within": "curve within 0.15",
    "named": "firm names",
    "false_names": "false names",
    "crashes": "crashes",
    "median_error_ms": "median |error| [ms]",
    "seconds": "s a record",
}


def bench_spec(
    machines: int,
    seed: int,
    methods: Sequence[str] = (),
    rigs: Sequence[str] = (),
    naming: str | None = None,
) -> StudySpec:
    """Return the study that a bench is.

    Parameters
    ----------
    machines : int
        So many, rounded up to as many of each rig.
    seed : int
        Of the bench; each machine has a seed of its own from it.
    methods : sequence of str
        Beside the five estimators: names of built-in peers, or ``module:Class``.
    rigs : sequence of str
        Rigs; all that are installed without them.
    naming : str, optional
        ``module:Class`` with ``firm_names``, which names effects in place of a fit; it is called
        "diagnose".

    Raises
    ------
    InputError
        When there is no such rig.
    """
    names = list(rigs) or list(rig_names())
    for name in names:
        draw_of(name)
    each = math.ceil(machines / len(names))
    # Seeds that a study takes as they are.
    states = np.random.SeedSequence(seed).generate_state(each)
    own = [{"name": name} for name in BUILT_IN]
    paths = named_methods()
    own += [{"name": method_name(text), "class": paths.get(text, text)} for text in methods]
    if naming is not None:
        own.append({"name": "diagnose", "class": naming})
    return spec_from(
        {
            "schema": "sindy-surge/study/1",
            "title": f"Bench: {each * len(names)} machines drawn at random, seed {seed}",
            "seeds": [int(state) for state in states],
            "scores": SCORES,
            "by": ["record.rig"] if len(names) > 1 else [],
            "record": {"source": "machines", "rig": names if len(names) > 1 else names[0]},
            "method": own,
        },
        "bench",
    )


def bench_rows(table: pd.DataFrame) -> list[dict[str, Any]]:
    """Return one row a method, under the names of `COUNTS`.

    Parameters
    ----------
    table : DataFrame
        Of the study, one row a cell.
    """
    return [
        {"method": str(name), **_counts(part)} for name, part in table.groupby("method", sort=False)
    ]


def _counts(part: pd.DataFrame) -> dict[str, int | float]:
    error = part["tau_error_ms"].to_numpy() / 1e3
    true = part["tau_ms"].to_numpy() / 1e3 - error
    stated, size = np.isfinite(error), np.abs(error)
    held = part["tau_covered"].to_numpy() == 1.0
    curve = part["curve_rms_error"].to_numpy()
    counted = {
        "answers": stated,
        "within": size <= np.fmax(WITHIN_S, WITHIN_SHARE * true),
        "covered": held & stated,
        "gross": stated & ~held & (size > GROSS_SHARE * true),
        "curves": np.isfinite(curve),
        "curves_within": curve <= CURVE_WITHIN,
        "named": part["firm_names"] > 0.0,
        "false_names": part["false_names"] > 0.0,
        "crashes": part["reason"].astype(str).str.match(r"[A-Z]\w*(Error|Exception|Warning): "),
    }
    return {
        "machines": len(part),
        **{name: int(np.count_nonzero(rows)) for name, rows in counted.items()},
        "median_error_ms": float(np.median(1e3 * size[stated])) if stated.any() else math.nan,
        "seconds": float(part["seconds"].median()),
    }


def ranks_of(table: pd.DataFrame) -> dict[str, Any]:
    """Rank the methods on each record by the absolute error of τ; without one a method ranks last.

    Parameters
    ----------
    table : DataFrame
        Of the study, one row a cell.

    Returns
    -------
    dict
        ``methods``, best first, and the ``mean`` rank of each; ``p_value``, the chance of such
        ranks if all methods were alike (Friedman), NaN below three methods;
        ``critical_difference``: mean ranks nearer than this are not parted at 5 % (Nemenyi; Demšar,
        Journal of Machine Learning Research 7, 2006).
    """
    # A method that names effects states no τ.
    namers = table.loc[table["firm_names"].notna(), "method"].unique()
    fitted = table[~table["method"].isin(namers)]
    wide = fitted.pivot_table(
        index="record", columns="method", values="tau_error_ms", dropna=False, sort=False
    )
    ranks = wide.abs().fillna(np.inf).rank(axis=1)
    n, k = ranks.shape
    mean = ranks.mean().sort_values(kind="stable")
    p = float(friedmanchisquare(*ranks.to_numpy().T).pvalue) if k > 2 and n > 1 else math.nan
    reach = float(studentized_range.ppf(1.0 - LEVEL, k, np.inf)) / math.sqrt(2.0)
    critical = reach * math.sqrt(k * (k + 1) / (6.0 * n))
    means = {"methods": [str(name) for name in mean.index], "mean": mean.tolist()}
    return {**means, "p_value": p, "critical_difference": critical}


def draw_ranks(ranks: dict[str, Any]) -> Figure:
    """Draw mean ranks with the critical difference: methods that a bar joins are not parted.

    Parameters
    ----------
    ranks : dict
        As of `ranks_of`.
    """
    words = "mean rank by |error of τ|; bar: critical difference (Nemenyi, 5 %)"
    figure, ax = panel(words, "", 1.2 + 0.35 * len(ranks["methods"]))
    ax.xaxis.label.set_fontsize(9)
    place = np.arange(len(ranks["methods"]))
    ax.plot(ranks["mean"], place, "o", color=ACCENT, ms=7)
    look: dict[str, Any] = {"color": INK, "lw": 2.0, "alpha": 0.35}
    for y, mean in zip(place, ranks["mean"], strict=True):
        ax.hlines(y, mean, mean + ranks["critical_difference"], **look)
    ax.set_yticks(place, ranks["methods"])
    ax.set_ylim(len(ranks["methods"]) - 0.5, -0.5)
    ax.set_xlim(left=0.8)
    return figure
