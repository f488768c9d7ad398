"""A study on a real Dask scheduler with worker processes of its own."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator
from pathlib import Path

import pandas as pd
import pytest

from comparisons.study.design import Task, count_cells
from comparisons.study.engines import Engine, Outcome, dask_engine
from comparisons.study.run import run_study
from comparisons.study.spec import spec_from
from surge_core.errors import InputError

pytest.importorskip("distributed", reason="the extra 'cluster' is not installed")

STUDY = spec_from(
    {
        "seeds": 3,
        "record": {"duration_s": 4.0, "noise_percent": [1.0, 5.0]},
        "method": [{"name": "classic_ml_arx"}, {"name": "classic_ml_output_error"}],
    }
)


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """Address of a scheduler on this machine, and its two workers."""
    file = tmp_path / "scheduler.json"
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": tmp_path}
    head = [sys.executable, "-m"]
    common = ["--scheduler-file", str(file), "--no-dashboard"]
    scheduler = subprocess.Popen(
        [*head, "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0", *common],
        **quiet,
    )
    deadline = time.monotonic() + 60.0
    while not (file.exists() and file.read_text("utf-8").strip()):
        assert scheduler.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.1)
    worker = [*head, "distributed.cli.dask_worker", "--nthreads", "1", "--no-nanny", *common]
    workers = [subprocess.Popen(worker, **quiet) for _ in range(2)]
    address = json.loads(file.read_text("utf-8"))["address"]
    _wait_for_workers(address, 2)
    yield address, workers
    for process in (*workers, scheduler):
        process.kill()
        process.wait()


def _wait_for_workers(address: str, count: int) -> None:
    from distributed import Client

    with Client(address, set_as_default=False) as client:
        client.wait_for_workers(count, timeout=60.0)


def without_times(table: pd.DataFrame) -> pd.DataFrame:
    return table[[c for c in table if not c.startswith("seconds")]]


def test_a_cluster_gives_the_same_bits_though_a_worker_is_killed(
    cluster: tuple[str, list[subprocess.Popen[bytes]]], tmp_path: Path
) -> None:
    address, workers = cluster
    alone = run_study(STUDY, tmp_path / "alone")
    together = run_study(STUDY, tmp_path / "cluster", engine=dask_engine(address), workers=2)
    pd.testing.assert_frame_equal(without_times(alone), without_times(together), check_exact=True)

    def with_an_accident(engine: Engine) -> Engine:
        def work(tasks: Iterable[Task]) -> Iterator[Outcome]:
            for k, outcome in enumerate(engine(tasks)):
                if k == 1:
                    os.kill(workers[0].pid, signal.SIGKILL)
                yield outcome

        return work

    engine = with_an_accident(dask_engine(address))
    after = run_study(STUDY, tmp_path / "accident", engine=engine, workers=2)
    assert workers[0].poll() is not None
    assert len(after) == count_cells(STUDY)
    pd.testing.assert_frame_equal(without_times(alone), without_times(after), check_exact=True)


def test_a_wrong_address_is_told() -> None:
    for address in ("tcp://127.0.0.1:1", "nonsense://x"):
        with pytest.raises(InputError, match="--scheduler"):
            dask_engine(address, timeout_s=1.0)
