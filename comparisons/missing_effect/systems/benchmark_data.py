"""Where the files of measured benchmark systems are: a folder, or the package that fetches them."""

from __future__ import annotations

import os
from pathlib import Path

from surge_core.errors import InputError

# Environment variable that names a folder with the files, below it or in folders of it.
BENCHMARK_FOLDER = "SINDY_SURGE_BENCHMARKS"


def benchmark_file(system: str, name: str) -> Path:
    """Return the path of one file of a measured benchmark.

    From the folder that the environment variable ``SINDY_SURGE_BENCHMARKS`` names; without it
    through the package nonlinear-benchmarks, which fetches it once (extra ``benchmarks``).

    Parameters
    ----------
    system : str
        Name of the loader in nonlinear-benchmarks, such as ``"EMPS"``.
    name : str
        Name of the file.

    Raises
    ------
    InputError
        When the folder does not hold it, or the package is not installed.
    """
    folder = os.environ.get(BENCHMARK_FOLDER)
    if folder:
        found = sorted([*Path(folder).glob(name), *Path(folder).glob(f"*/{name}")])
        if not found:
            raise InputError(
                f"{BENCHMARK_FOLDER}={folder}",
                expected=f"the file {name} there or one folder below",
                found="none",
            )
        return found[0]
    try:
        import nonlinear_benchmarks
    except ImportError as error:
        raise InputError(
            name,
            expected=f"a folder in {BENCHMARK_FOLDER}, or the package nonlinear-benchmarks",
            found="neither",
            remedy="pip install 'sindy-surge[benchmarks]' fetches the data on first use",
        ) from error
    places = getattr(nonlinear_benchmarks, system)(data_file_locations=True)
    paths = [Path(p) for p in ([places] if isinstance(places, str) else places)]
    return next(path for path in paths if path.name == name)
