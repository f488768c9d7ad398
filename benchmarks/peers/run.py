"""LagRegressor beside other packages on the same records: accuracy, CPU time and peak memory.

    python benchmarks/peers/run.py --setup          makes the peers' environments, once
    python benchmarks/peers/run.py [--json FILE]    all peers, all noise colours, all lengths

Each peer runs in a process of its own, in an environment of its own, and gets the records as a
file. One that is not installed, fails or takes too long is a row with its reason.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import environments
import numpy as np
from efficiency import efficiency, middle_half
from lag_problem import NAMES, TAU_S, FloatArray, Problem

HERE = Path(__file__).resolve().parent
COLOURS = (-0.6, 0.0, 0.5)
RECORDS = {2_000: 40, 20_000: 20, 200_000: 10}
LONGEST = max(RECORDS)
QUICK_RECORDS = {500: 3}
# A fit that was begun within the cap should be let end, unless it takes so many times the cap.
END_AFTER_CAPS = 20.0
ONE_THREAD = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "NUMBA_NUM_THREADS": "1",
    "JAX_PLATFORMS": "cpu",
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1",
}


@dataclass(frozen=True)
class Peer:
    """One way of fitting.

    Parameters
    ----------
    name : str
        As printed.
    script : str
        What its process runs.
    environment : str or None
        Where; None for the one this script runs in.
    slow : bool
        Takes a minute or more for the longest records: run there in the first colour alone.
    """

    name: str
    script: str
    environment: str | None
    slow: bool = False


OWN = Peer("LagRegressor", "fit_classic_ml.py", None)
PEERS = (
    OWN,
    Peer("sysidentpy ELS", "fit_sysidentpy.py", "sysidentpy"),
    Peer("SIPPY ILLS", "fit_sippy_ills.py", "sippy", slow=True),
    Peer("SIPPY OPT", "fit_sippy_opt.py", "sippy", slow=True),
    Peer("statsmodels SARIMAX", "fit_statsmodels.py", "statsmodels", slow=True),
    Peer("jax-sysid", "fit_jax_sysid.py", "jax-sysid", slow=True),
)


@dataclass(frozen=True)
class Records:
    """The records of one setting, with what is known of them.

    Parameters
    ----------
    c : float
        Coefficient of C.
    phi, y : ndarray of shape (n_records, n_samples)
        Data.
    bound, one_step : ndarray of shape (n_records, 4)
        Least standard errors, and errors of the one-step estimate from the truth.
    """

    c: float
    phi: FloatArray
    y: FloatArray
    bound: FloatArray
    one_step: FloatArray

    @classmethod
    def simulate(cls, c: float, n_samples: int, n_records: int) -> Records:
        """Make records, of the same seeds for every colour."""
        made = [Problem("armax", c).record(n_samples, seed) for seed in range(n_records)]
        bounds = [record.bound() for record in made]
        return cls(
            c,
            np.array([record.phi for record in made]),
            np.array([record.y for record in made]),
            np.array([bound for bound, _ in bounds]),
            np.array([one_step for _, one_step in bounds]),
        )


@dataclass(frozen=True)
class Results:
    """What the process of a peer handed back.

    Parameters
    ----------
    parameters : ndarray of shape (n_records, 4)
        (τ in seconds, β); nan where there is no fit.
    cpu_s, peak_bytes : ndarray of shape (n_fits,)
        Of the fits that ended.
    lfilter_s : float
        One first-order pass of scipy.signal.lfilter over a record, in the same process.
    note : str
        Why there is less than there should be.
    """

    parameters: FloatArray
    cpu_s: FloatArray
    peak_bytes: FloatArray
    lfilter_s: float
    note: str


def run_peer(peer: Peer, records: Path, n_records: int, cap_s: float) -> Results:
    """Run a peer over a file of records."""
    nothing = np.full((n_records, len(NAMES)), np.nan)
    unusable = environments.missing(peer.environment) if peer.environment else None
    if unusable:
        return Results(nothing, np.zeros(0), np.zeros(0), float("nan"), unusable)
    python = environments.python_of(peer.environment) if peer.environment else sys.executable
    out = records.with_name("results.jsonl")
    out.unlink(missing_ok=True)
    end_s = round(END_AFTER_CAPS * cap_s)
    done = subprocess.run(
        [python, HERE / peer.script, records, out, "--cap-s", str(cap_s), "--end-s", str(end_s)],
        env=_environment_of(peer),
        capture_output=True,
        text=True,
        errors="replace",
        check=False,
    )
    note = ""
    if done.returncode == -signal.SIGXCPU:
        note = f"ended at {end_s} s of CPU time"
    elif done.returncode != 0:
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        note = f"ended with code {done.returncode}: {last}"
    return _read(out, nothing, note)


def _environment_of(peer: Peer) -> dict[str, str]:
    """Return the variables of a peer's process: one thread, and no way into another's packages."""
    variables = {**os.environ, **ONE_THREAD}
    if peer.environment is not None:
        variables.pop("PYTHONPATH", None)
    return variables


def _read(out: Path, parameters: FloatArray, note: str) -> Results:
    lines = out.read_text().splitlines() if out.is_file() else []
    # The last line of a process that was ended can be cut short.
    rows: list[dict[str, Any]] = [json.loads(line) for line in lines if line.endswith("}")]
    head, fits = (rows[0], rows[1:]) if rows else ({}, [])
    for row, fit in zip(parameters, fits, strict=False):
        if fit["failure"] is None:
            row[:] = fit["parameters"]
    good = [fit for fit in fits if fit["failure"] is None]
    failures = [fit["failure"] for fit in fits if fit["failure"] is not None]
    notes = [note] if note else []
    if failures:
        notes.append(f"{len(failures)} of {len(fits)} fits failed: {failures[0]}")
    if len(fits) < parameters.shape[0] and not note:
        notes.append("stopped at its cap")
    return Results(
        parameters,
        np.array([fit["cpu_s"] for fit in good]),
        np.array([fit["peak_bytes"] for fit in good if fit["peak_bytes"] is not None]),
        float(head.get("lfilter_s", "nan")),
        "; ".join(notes),
    )


@dataclass(frozen=True)
class Row:
    """One peer at one setting; ratios are nan where there is nothing to compare."""

    peer: str
    c: float
    n_samples: int
    n_fits: int
    tau_mean_s: float
    tau_rmse_s: float
    tau_bound_s: float
    efficiency: float
    efficiency_se: float
    plain_efficiency: float
    plain_efficiency_se: float
    beta_efficiency: list[float]
    beta_efficiency_se: list[float]
    rms_difference_to_own_s: float
    cpu_s: float
    times_own: float
    lfilter_passes: float
    peak_floats_per_sample: float
    note: str


def compare(peer: Peer, records: Records, got: Results, own: Results) -> Row:
    """Sum up one peer at one setting."""
    fitted = np.isfinite(got.parameters[:, 0])
    error = got.parameters[fitted] - Problem("armax", records.c).truth
    relative, control = error / records.bound[fitted], records.one_step[fitted]
    control = control / records.bound[fitted]
    paired = [efficiency(relative[:, i], control[:, i]) for i in range(len(NAMES))]
    plain = efficiency(relative[:, 0])
    both = fitted & np.isfinite(own.parameters[:, 0])
    difference = got.parameters[both, 0] - own.parameters[both, 0]
    n_samples = records.y.shape[1]
    cpu_s = middle_half(got.cpu_s)
    return Row(
        peer.name,
        records.c,
        n_samples,
        int(fitted.sum()),
        _mean(got.parameters[fitted, 0]),
        _root_mean_square(error[:, 0]),
        _mean(records.bound[:, 0]),
        *paired[0],
        *plain,
        [value for value, _ in paired[1:]],
        [se for _, se in paired[1:]],
        _root_mean_square(difference),
        cpu_s,
        cpu_s / middle_half(own.cpu_s),
        cpu_s / got.lfilter_s,
        _middle(got.peak_bytes) / 8.0 / n_samples,
        got.note,
    )


def _middle(values: FloatArray) -> float:
    return float(np.median(values)) if values.size else float("nan")


def _mean(values: FloatArray) -> float:
    return float(np.mean(values)) if values.size else float("nan")


def _root_mean_square(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")


HEADER = (
    f"{'':<19} {'fits':>4} {'tau ms':>8} {'rmse':>7} {'efficiency':>13} {'unpaired':>13} "
    f"{'least of beta':>13} {'to own, ms':>10} {'CPU ms':>9} {'x own':>7} {'lfilter':>8} "
    f"{'floats':>7}"
)


def line(row: Row) -> str:
    """Return one row of the printed table."""
    beta = min(
        zip(row.beta_efficiency, row.beta_efficiency_se, strict=True),
        key=lambda pair: (np.isnan(pair[0]), pair[0]),
    )
    text = (
        f"{row.peer:<19} {row.n_fits:>4} {_fixed(1e3 * row.tau_mean_s, 8, 3)} "
        f"{_fixed(1e3 * row.tau_rmse_s, 7, 3)} "
        f"{_with_error(row.efficiency, row.efficiency_se)} "
        f"{_with_error(row.plain_efficiency, row.plain_efficiency_se)} {_with_error(*beta)} "
        f"{_fixed(1e3 * row.rms_difference_to_own_s, 10, 4)} {_fixed(1e3 * row.cpu_s, 9, 1)} "
        f"{_fixed(row.times_own, 7, 2)} {_fixed(row.lfilter_passes, 8, 0)} "
        f"{_fixed(row.peak_floats_per_sample, 7, 0)}"
    )
    return f"{text}  {row.note}".rstrip()


def _fixed(value: float, width: int, digits: int) -> str:
    return f"{value:>{width}.{digits}f}" if np.isfinite(value) else f"{'-':>{width}}"


def _with_error(value: float, error: float) -> str:
    if not np.isfinite(value):
        return f"{'-':>13}"
    return f"{value:>5.2f} ± {error:.3f}" if np.isfinite(error) else f"{value:>5.2f}        "


def settings(options: argparse.Namespace, peers: list[Peer]) -> Iterator[tuple[Records, list[Row]]]:
    """Run every setting; yield its records and rows."""
    lengths = QUICK_RECORDS if options.quick else RECORDS
    colours = options.c or COLOURS
    for c in colours:
        for n_samples, n_records in lengths.items():
            if options.samples and n_samples not in options.samples:
                continue
            records = Records.simulate(c, n_samples, n_records)
            with tempfile.TemporaryDirectory() as folder:
                file = Path(folder) / "records.npz"
                np.savez(file, phi=records.phi, y=records.y)
                own = run_peer(OWN, file, n_records, options.cap_s)
                rows = [compare(OWN, records, own, own)]
                for peer in peers:
                    spared = peer.slow and c != colours[0] and n_samples == LONGEST
                    if peer is not OWN and not spared:
                        got = run_peer(peer, file, n_records, options.cap_s)
                        rows.append(compare(peer, records, got, own))
            yield records, rows


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--setup", action="store_true", help="make the environments and stop")
    parser.add_argument("--quick", action="store_true", help="three short records a setting")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the rows as JSON")
    parser.add_argument(
        "--peer", action="append", metavar="NAME", help="only these: part of a name"
    )
    parser.add_argument("--c", type=float, action="append", help="only this noise colour")
    parser.add_argument("--samples", type=int, action="append", help="only this length")
    parser.add_argument(
        "--cap-s", type=float, default=20.0, help="CPU seconds after which no fit is begun"
    )
    options = parser.parse_args()
    if options.setup:
        reasons = {name: environments.set_up(name) for name in environments.NAMES}
        for name, reason in reasons.items():
            print(f"{name}: {reason or 'ready'}")
        return 0
    wanted = [name.lower() for name in options.peer or [""]]
    peers = [peer for peer in PEERS if any(name in peer.name.lower() for name in wanted)]
    rows: list[Row] = []
    for records, some in settings(options, peers):
        n_records, n_samples = records.y.shape
        bound_ms = 1e3 * records.bound[:, 0].mean()
        print(
            f"\nc = {records.c:+.1f}, N = {n_samples}, {n_records} records, tau = "
            f"{1e3 * TAU_S:g} ms, bound {bound_ms:.3f} ms\n{HEADER}"
        )
        for row in some:
            print(line(row), flush=True)
        rows += some
    if options.json is not None:
        options.json.write_text(json.dumps([asdict(row) for row in rows], indent=1) + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
