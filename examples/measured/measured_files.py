"""Where the files of a measured benchmark are: a folder, or the package that fetches them."""

import os
from pathlib import Path


def measured_file(system: str, name: str) -> Path:
    """Return a file from the folder in SINDY_SURGE_BENCHMARKS, or through nonlinear-benchmarks."""
    folder = os.environ.get("SINDY_SURGE_BENCHMARKS")
    if folder:
        paths = [*Path(folder).glob(name), *Path(folder).glob(f"*/{name}")]
    else:
        import nonlinear_benchmarks

        places = getattr(nonlinear_benchmarks, system)(data_file_locations=True)
        paths = [Path(place) for place in ([places] if isinstance(places, str) else places)]
    return next(path for path in sorted(paths) if path.name == name)
