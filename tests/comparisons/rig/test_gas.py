from __future__ import annotations

import pytest

from comparisons.rig import gas


def test_flow_constant_is_that_of_the_paper_in_both_systems_of_units() -> None:
    assert pytest.approx(416.86, abs=0.01) == gas.FLOW_CONSTANT_KG_S_M2
    in_us = gas.FLOW_CONSTANT_KG_S_M2 / gas.LBM_KG * 0.3048**2
    assert in_us == pytest.approx(85.38, abs=0.005)
    choked = gas.corrected_flow_kg_s(1.0, 0.3048**2) / gas.LBM_KG
    assert choked == pytest.approx(49.4, abs=0.05)
