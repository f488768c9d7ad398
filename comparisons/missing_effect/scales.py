"""Units in which numbers read well."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable

from surge_core.rounding import significant

# Symbols that take a prefix; what stands behind a stroke or a dot stays as it is.
PREFIXED = frozenset(
    ("m", "V", "A", "s", "N", "rad", "K", "Pa", "W", "J", "T", "C", "F", "H", "Ω", "bar", "l", "L")
)
# Below these a number is given in thousandths, millionths, … of its unit.
STEPS_DOWN = ((1e-7, 1e9, "n", "10⁻⁹"), (1e-4, 1e6, "µ", "10⁻⁶"), (0.1, 1e3, "m", "10⁻³"))
# Of units that take no prefix: smaller numbers read badly as decimals.
PLAIN_BELOW = 1e-2


class Scale:
    """A factor to a unit that reads well; the unit is empty for a pure number."""

    def __init__(self, factor: float, unit: str) -> None:
        self.factor = factor
        self.unit = "" if unit == "1" else unit

    def text(self, value: float, digits: int = 3) -> str:
        """Return a number of the model's unit in this one, with the unit."""
        number = significant(value * self.factor, digits)
        joined = "·" if self.unit.startswith("10") else " "
        return f"{number}{joined}{self.unit}" if self.unit else number

    @property
    def bracketed(self) -> str:
        """The unit in brackets, for axes and heads."""
        return f"[{self.unit or '-'}]"


def scale_of(unit: str, sizes: Iterable[float]) -> Scale:
    """Return the unit in which numbers of some sizes read well; the largest decides."""
    finite = [abs(size) for size in sizes if math.isfinite(size)]
    largest = max(finite, default=1.0)
    match = re.match(r"([^\W\d_]+)(?=$|/|·)", unit)
    prefixed = match is not None and match.group(1) in PREFIXED
    if not 0.0 < largest < (STEPS_DOWN[-1][0] if prefixed else PLAIN_BELOW):
        return Scale(1.0, unit)
    for below, factor, prefix, power in STEPS_DOWN:
        if largest < below:
            plain = power if unit == "1" else f"{power} {unit}"
            return Scale(factor, f"{prefix}{unit}" if prefixed else plain)
    return Scale(1.0, unit)


def typical(sizes: Iterable[float]) -> float:
    """Return the geometric mean of sizes that differ by much; 1 where none is known."""
    known = [math.log(size) for size in sizes if math.isfinite(size) and size > 0.0]
    return math.exp(sum(known) / len(known)) if known else 1.0
