from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from comparisons.rig import gas


def test_flow_constant_is_that_of_the_paper_in_both_systems_of_units() -> None:
    assert pytest.approx(416.86, abs=0.01) == gas.FLOW_CONSTANT_KG_S_M2
    in_us = gas.FLOW_CONSTANT_KG_S_M2 / gas.LBM_KG * 0.3048**2
    assert in_us == pytest.approx(85.38, abs=0.005)
    choked = gas.corrected_flow_kg_s(1.0, 0.3048**2) / gas.LBM_KG
    assert choked == pytest.approx(49.4, abs=0.05)


@given(
    flow=st.floats(-60.0, 60.0),
    pressure=st.floats(2e4, 2e6),
    slope=st.floats(1.0, 1.2),
    offset=st.floats(0.0, 0.02),
)
def test_probe_pressures_give_the_flow_back_outside_the_dead_band(
    flow: float, pressure: float, slope: float, offset: float
) -> None:
    forward, aft = gas.probe_pressures_pa(flow, pressure, area_m2=0.3, slope=slope, offset=offset)
    # Equation 1 to 3 written out here, with the reverse rule.
    ratio = max(forward, aft) / min(forward, aft)
    apparent = np.sqrt(5.0 * (ratio ** (0.4 / 1.4) - 1.0))
    true = slope * apparent + offset
    back = np.sign(forward - aft) * 0.3 * 416.86 * true / (1.0 + 0.2 * true**2) ** 3
    mach = abs(float(gas.mach_from_corrected_flow(flow, 0.3)))
    assert max(forward, aft) == pytest.approx(pressure)
    if mach <= offset:
        assert forward == aft
    elif mach > offset + 1e-3:
        assert back == pytest.approx(flow, rel=1e-3)
        assert (forward > aft) == (flow > 0.0)
