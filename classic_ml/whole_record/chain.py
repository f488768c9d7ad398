"""What lies between the air and the readings of each probe pair, as it travels with a series."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from classic_ml.description import Compressor
from classic_ml.flow import T_STANDARD_K, choked_flow
from classic_ml.records import LedgerEntry
from surge_core.types import FloatArray

STEP = "rakes"
# Beyond this share of the choked flow a pair is overloaded: Eq 3 has no inverse at the choke.
LARGEST_SHARE = 0.98
_MACHINE = "compressor."
# What the ledger carries of a pair, in the order of its fields.
_OF_PAIR = ("slope", "offset", "noise_Pa", "noise_aft_Pa")
_Parameters = Mapping[str, str | int | float | bool]


@dataclass(frozen=True)
class PairChain:
    """A forward and an aft probe."""

    name: str  # Plane, rake and immersion, e.g. ``"25_A_tip"``
    slope: float  # a and b of Eq 2
    offset: float
    noise_Pa: float  # Standard deviation of the white noise of the two channels
    noise_aft_Pa: float

    @property
    def plane(self) -> int:
        """25 or 31."""
        return int(self.name.partition("_")[0])

    @property
    def rake(self) -> str:
        """Such as ``"A"``."""
        return self.name.split("_")[1]

    @property
    def immersion(self) -> str:
        """``"hub"``, ``"tip"``, or the name of one between."""
        return self.name.rpartition("_")[2]


@dataclass(frozen=True)
class Chain:
    """The probe pairs of a record that count, and the constants of Eq 1 to 8."""

    pairs: tuple[PairChain, ...]
    areas_m2: Mapping[int, float]  # Flow area of each plane
    compressor: Compressor
    rotor_speed_rpm: float  # Physical speed, and 100 % corrected speed
    design_corrected_speed_rpm: float
    near_stall_rows: int  # Rows of the reading to which the channels were matched

    @property
    def rotor_velocity_m_s(self) -> float:
        """Mean rotor velocity U = 2π N r."""
        return 2.0 * np.pi * self.rotor_speed_rpm / 60.0 * self.compressor.mean_radius_m

    def of_plane(self, plane: int) -> tuple[PairChain, ...]:
        """Return the pairs of a plane."""
        return tuple(pair for pair in self.pairs if pair.plane == plane)

    def largest_flow_kg_s(self, plane: int) -> float:
        """Return the corrected flow beyond which a pair of a plane is overloaded."""
        return LARGEST_SHARE * choked_flow(self.areas_m2[plane], self.compressor)

    def corrected_speed(self, inlet_K: FloatArray) -> FloatArray:
        """Return N_c = N/√θ as a fraction of the design corrected speed."""
        corrected = self.rotor_speed_rpm / np.sqrt(inlet_K / T_STANDARD_K)
        return np.asarray(corrected / self.design_corrected_speed_rpm)

    def entry(self) -> LedgerEntry:
        """Return the step of the ledger that carries the chain."""
        parameters: dict[str, str | int | float | bool] = {
            "near_stall_rows": self.near_stall_rows,
            "rotor_speed_rpm": self.rotor_speed_rpm,
            "design_corrected_speed_rpm": self.design_corrected_speed_rpm,
        }
        parameters |= {f"area_{plane}_m2": area for plane, area in self.areas_m2.items()}
        parameters |= {f"{_MACHINE}{k}": v for k, v in self.compressor.model_dump().items()}
        for pair in self.pairs:
            parameters |= {f"{pair.name}.{what}": getattr(pair, what) for what in _OF_PAIR}
        did = (
            f"unfiltered flow and total pressure of {len(self.pairs)} probe pairs kept, with what "
            "lies between the air and their readings: the time constant is estimated from these"
        )
        return LedgerEntry(STEP, did, parameters)

    @classmethod
    def from_parameters(cls, given: _Parameters) -> Chain:
        """Read the chain back from the parameters of its step."""
        names = [name.removesuffix(".slope") for name in given if name.endswith(".slope")]
        pairs = tuple(
            PairChain(name, *(float(given[f"{name}.{what}"]) for what in _OF_PAIR))
            for name in names
        )
        machine = {k.removeprefix(_MACHINE): v for k, v in given.items() if k.startswith(_MACHINE)}
        areas = {int(k[5:-3]): float(v) for k, v in given.items() if k.startswith("area_")}
        return cls(
            pairs,
            areas,
            Compressor.model_validate(machine),
            float(given["rotor_speed_rpm"]),
            float(given["design_corrected_speed_rpm"]),
            int(given["near_stall_rows"]),
        )
