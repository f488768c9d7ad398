"""The maximum-likelihood fit beside other packages: `peers/run.py`'s records and processes."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import run
from efficiency import middle_half
from lag_problem import PERIOD_S, Problem

from gathered.table import Cell, FloatArray, Line, absent, memory, times_real_time

COLOUR = -0.6
PEERS = (
    run.OWN,
    run.Peer("scipy least_squares", "fit_scipy.py", None),
    *(peer for peer in run.PEERS if peer is not run.OWN),
)
NOT_ASKED = "not a question of this block: the structure is given and nothing is missing"
OWN_DOES = (
    "searches its own start and states standard errors, within the time; of the peers statsmodels "
    "alone can, and is not asked"
)
NO_FIT = "no fit to say it of"
# Two more processes whose imports and compilation take longer than all that they would show.
NOT_QUICK = ("SIPPY OPT", "jax-sysid")
NOT_IN_QUICK = "left out of --quick"
TOO_SLOW = "left out at this length, which takes it minutes: `peers/run.py` has it"


@dataclass(frozen=True)
class Setting:
    """One length of the records.

    Parameters
    ----------
    n_samples : int
        Rows of each.
    rounds, records : int
        How often every peer has its turn, and records of each turn.
    cap_s : float
        CPU seconds of a turn after which a peer begins no fit.
    left_out : dict
        Peers that have no turn, by name, and why.
    """

    n_samples: int
    rounds: int
    records: int
    cap_s: float
    left_out: dict[str, str] = field(default_factory=dict)


QUICK = (Setting(500, 1, 3, 2.0, dict.fromkeys(NOT_QUICK, NOT_IN_QUICK)),)
NORMAL = (
    Setting(2_000, 3, 12, 15.0),
    Setting(20_000, 2, 8, 15.0),
    Setting(200_000, 2, 4, 15.0, {peer.name: TOO_SLOW for peer in PEERS if peer.slow}),
)


def lines(quick: bool, seeds: int | None) -> list[Line]:
    """Return a line for each peer at each length.

    Parameters
    ----------
    quick : bool
        For its working alone.
    seeds : int, optional
        Records of a turn.
    """
    settings = QUICK if quick else NORMAL
    return [
        line for setting in settings for line in _at_one_length(setting, seeds or setting.records)
    ]


def _at_one_length(setting: Setting, n_records: int) -> list[Line]:
    total = setting.rounds * n_records
    records = run.Records.simulate(COLOUR, setting.n_samples, total)
    turns: dict[str, list[run.Results]] = {peer.name: [] for peer in PEERS}
    with tempfile.TemporaryDirectory() as folder:
        for number in range(setting.rounds):
            part = slice(number * n_records, (number + 1) * n_records)
            file = Path(folder) / "records.npz"
            np.savez(file, phi=records.phi[part], y=records.y[part])
            for peer in PEERS:
                if peer.name not in setting.left_out:
                    turns[peer.name].append(run.run_peer(peer, file, n_records, setting.cap_s))
    own = turns[run.OWN.name]
    return [
        Line("ml", f"{peer.name}, N = {setting.n_samples}", 0, absent(why))
        if (why := setting.left_out.get(peer.name))
        else _line(peer, records, turns[peer.name], own)
        for peer in PEERS
    ]


def _line(
    peer: run.Peer, records: run.Records, turns: list[run.Results], own: list[run.Results]
) -> Line:
    n_samples = records.y.shape[1]
    name = f"{peer.name}, N = {n_samples}"
    got = _together(turns)
    row = run.compare(peer, records, got, _together(own))
    if row.n_fits == 0:
        return Line("ml", name, 0, absent(row.note or NO_FIT))
    fitted = np.isfinite(got.parameters[:, 0])
    error = got.parameters[fitted, 0] - Problem("armax", records.c).truth[0]
    relative = error / records.bound[fitted, 0]
    pairs = [
        middle_half(mine.cpu_s) / middle_half(base.cpu_s)
        for mine, base in zip(turns, own, strict=True)
        if mine.cpu_s.size and base.cpu_s.size
    ]
    cells: dict[str, Cell] = {
        **absent(NOT_ASKED, "right_percent", "false_percent", "differs"),
        "tau_error_percent": 100.0 * _rms(error) / Problem("armax", records.c).truth[0],
        "error_over_bound": _rms(relative),
        "efficiency": (row.efficiency, row.efficiency_se),
        "times_own": float(np.median(pairs)) if pairs else float("nan"),
        "times_real_time": times_real_time(np.array([n_samples * PERIOD_S]), got.cpu_s),
        **memory(got.peak_bytes, n_samples),
    }
    note = row.note or (OWN_DOES if peer is run.OWN else "")
    return Line("ml", name, row.n_fits, cells, note)


def _together(turns: list[run.Results]) -> run.Results:
    return run.Results(
        np.concatenate([t.parameters for t in turns]),
        np.concatenate([t.cpu_s for t in turns]),
        np.concatenate([t.peak_bytes for t in turns]),
        float(np.median([t.lfilter_s for t in turns])),
        "; ".join(dict.fromkeys(t.note for t in turns if t.note)),
    )


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))
