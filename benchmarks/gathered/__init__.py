"""The blocks of the one table that `all.py` prints."""

import sys
from pathlib import Path

# Records, bound, statistics and processes of the ML block are those of `peers/run.py`.
sys.path.append(str(Path(__file__).resolve().parents[1] / "peers"))
