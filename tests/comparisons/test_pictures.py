"""Words beside a picture: what they say is in the record."""

from __future__ import annotations

import re

import numpy as np
import pytest

from comparisons.show import plots_record

RATE_HZ = 1000.0


@pytest.mark.parametrize("surge_hz", [3.0, 5.0, 11.0])
def test_a_cycle_takes_as_long_as_it_was_made(surge_hz: float) -> None:
    psi_p = 1.2 + 0.1 * np.sin(2.0 * np.pi * surge_hz * np.arange(4000) / RATE_HZ)
    found = re.search(r"A cycle takes ([\d.]+) ms", plots_record.cycle_words(psi_p, RATE_HZ))
    assert found is not None
    assert float(found[1]) == pytest.approx(1e3 / surge_hz, rel=0.01)
