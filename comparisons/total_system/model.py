"""The lumped model of the whole system: compressor, plenums, throttle, inlet, supply.

    I dW/dt = P25 PR − P31,    PR = (1 + ψ'_i U²/(2 c_p T25))^(γ/(γ−1))
    P25 = P_in − loss − I_in dW/dt
    ψ'_i = ψ' + k_rev φ² [φ < 0],    τ dψ'/dt + ψ' = q ψ'_QS(φ) + (1 − q) ψ'_unstalled(φ, N_c)
    mass and energy of a discharge, an exhaust and an inlet volume; compressible orifices; the gas
    at the face, heated by reversed flow and by in-stall recirculation

The throttle follows its schedule from the surge start on. Source: the idea is that of the paper's
Reference 6.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from classic_ml.description import TestDescription
from classic_ml.flow import T_STANDARD_K
from comparisons.total_system.facility import Facility
from comparisons.total_system.kernel import FACILITY_FIELDS, Constants, integrate, orifice
from surge_core.errors import InputError
from surge_core.types import FloatArray

# In the order of the compiled loops.
STATES = ("W25", "psi_p_lagged", "psi", "P31", "T31", "P_in", "T_in", "P_ex", "T_ex", "T_coil",
          "T25")  # fmt: skip
COLUMNS = (*STATES, "P25", "phi", "W31", "W_throttle", "W_exhaust", "W_supply")
# A linear rise of the pressure from plane 25 to plane 31 puts half of P31 on the stored gas.
_STORAGE_SHARE = 0.5
# The fastest of the model is the loss in reversed flow. Against steps a fifth as long, five a
# millisecond change P31 and W25 by 1e-4 of their swing; half as many miss P25 in the blowdown by a
# third of its swing.
STEPS_PER_SECOND = 5_000.0


@dataclass(frozen=True)
class TotalSystemModel:
    """Compressor and facility with numbers in them.

    Parameters
    ----------
    test : TestDescription
        Machine, speed, areas, near-stall reading.
    facility : Facility
        All that stands around the compressor.
    near_stall_flow_kg_s : float
        Flow of the near-stall reading, which sizes throttle, exhaust and supply.
    beta : tuple of float
        β₁, β₂, β₃ of ψ'_QS = β₁ + β₂ φ + β₃ φ² in stall.
    tau_s : float
        Time constant of ψ' and ψ, in seconds.
    start_s : float
        Surge start: when the first stall begins, on the clock of the record; infinite for none.
    volume_factor : float
        Multiplies the discharge volume.
    """

    test: TestDescription
    facility: Facility
    near_stall_flow_kg_s: float
    beta: tuple[float, float, float]
    tau_s: float
    start_s: float = np.inf
    volume_factor: float = 1.0

    def near_stall_state(self) -> FloatArray:
        """Return the state of the near-stall reading, of shape (11,), in the order of `STATES`."""
        near, machine = self.test.near_stall, self.test.compressor
        work = 2.0 * machine.specific_heat_J_kg_K / self.test.rotor_velocity_m_s**2
        rise = (near.P31_Pa / near.P25_Pa) ** ((machine.gamma - 1.0) / machine.gamma) - 1.0
        state = {
            "W25": self.near_stall_flow_kg_s,
            "psi_p_lagged": work * near.T25_K * rise,
            "psi": work * (near.T31_K - near.T25_K),
            "P31": near.P31_Pa,
            "T31": near.T31_K,
            "P_in": near.P25_Pa * (1.0 + self.facility.inlet.loss_frac),
            "T_in": near.T25_K,
            "P_ex": self.facility.throttle.exhaust_pressure_frac * near.P31_Pa,
            "T_ex": near.T31_K,
            "T_coil": near.T25_K,
            "T25": near.T25_K,
        }
        return np.array([state[name] for name in STATES])

    def constants(self) -> Any:
        """Return the numbers of the compiled loops, orifices sized by the near-stall reading.

        Raises
        ------
        InputError
            When the exhaust would be below the ambient pressure.
        """
        test, f, near = self.test, self.facility, self.test.near_stall
        machine, flow = test.compressor, self.near_stall_flow_kg_s
        g, velocity = machine.gamma, test.rotor_velocity_m_s
        middle = f.throttle.exhaust_pressure_frac * near.P31_Pa
        ambient = f.throttle.ambient_pressure_Pa
        if not middle > ambient:
            raise InputError(
                "[throttle] exhaust_pressure_frac",
                expected=f"an exhaust pressure above ambient near stall, {ambient:g} Pa",
                found=f"{middle:g} Pa",
            )
        loss = f.inlet.loss_frac * near.P25_Pa / flow**2
        known = [float(value) for table in f.model_dump().values() for value in table.values()]
        c = Constants(
            **dict(zip(FACILITY_FIELDS, known, strict=True)),
            beta1=self.beta[0],
            beta2=self.beta[1],
            beta3=self.beta[2],
            tau=self.tau_s,
            inertia=machine.inertia_per_m,
            storage_volume=_STORAGE_SHARE * machine.internal_volume_m3,
            discharge_volume=self.volume_factor * f.volumes.discharge_m3,
            loss=loss,
            supply_flow=flow,
            supply_pressure=near.P25_Pa + loss * flow**2,
            recirculation_heat=f.heat.recirculation_work
            * velocity**2
            / (2.0 * machine.specific_heat_J_kg_K),
            throttle_area=1.0,
            exhaust_area=1.0,
            start=self.start_s,
            speed=test.rotor_speed_rpm * np.sqrt(T_STANDARD_K) / test.design_corrected_speed_rpm,
            velocity=velocity,
            area=test.areas_m2[25],
            flow_constant=test.areas_m2[25] * np.sqrt(g / machine.gas_constant_J_kg_K),
            choke=(2.0 / (g + 1.0)) ** ((g + 1.0) / (2.0 * (g - 1.0))),
            gamma=g,
            gas=machine.gas_constant_J_kg_K,
            heat=machine.specific_heat_J_kg_K,
        )
        through, _ = orifice(c, 1.0, near.P31_Pa, near.T31_K, middle, near.T31_K)
        out, _ = orifice(c, 1.0, middle, near.T31_K, ambient, near.T31_K)
        return c._replace(
            throttle_area=f.throttle.area_factor * flow / through, exhaust_area=flow / out
        )

    def simulate(
        self, *, n_rows: int, period_s: float, state: FloatArray | None = None
    ) -> dict[str, FloatArray]:
        """Run the model from its surge start, or at rest without one.

        Parameters
        ----------
        n_rows : int
            Rows wanted; the first is the surge start.
        period_s : float
            Distance of rows.
        state : ndarray of shape (11,), optional
            State to start from; the near-stall reading without it.

        Returns
        -------
        dict of str to ndarray of shape (n_rows,)
            The columns of `COLUMNS`: pressures in Pa, temperatures in K, flows in kg/s.
        """
        surging = bool(np.isfinite(self.start_s))
        begin = self.start_s if surging else 0.0
        # Branch, armed, when it was switched to, and the blend it was switched from.
        latch = np.array([float(surging), 0.0, begin, 0.0])
        first = self.near_stall_state() if state is None else state
        steps = max(1, round(period_s * STEPS_PER_SECOND))
        forced = np.empty((0, 4))
        rows = integrate(self.constants(), first, latch, begin, n_rows, period_s, steps, forced)
        return {name: np.ascontiguousarray(rows[:, i]) for i, name in enumerate(COLUMNS)}
