"""A surge test as it runs: rows from a socket or a pipe, seen at once, reduced at the end.

What is shown during the run is causal and says so: pressures behind a low-pass that runs once, the
operating point one row late, a time constant marked as provisional. What is written at the end is
the reduction of the rows that were kept on disk, by the very code of `sindy-surge reduce`.
"""

from __future__ import annotations
