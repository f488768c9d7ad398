"""What was tested, where each channel sits and how it was calibrated."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import nan, pi
from types import MappingProxyType
from typing import Literal

from classic_ml.units import COUNT
from surge_core.errors import InputError

__all__ = [
    "PLAUSIBLE_BIAS",
    "PLAUSIBLE_BIAS_K",
    "Compressor",
    "Converter",
    "FileLayout",
    "NearStall",
    "PressureChannel",
    "ProbePair",
    "TemperatureChannel",
    "TestDescription",
]

# The match mends the drift of an amplifier. A reading that is off by more has another unit,
# or its zero and calibrate readings belong to another channel.
PLAUSIBLE_BIAS = 0.2
# No thermocouple is off by an eighth; 698 K written in °F is off by a seventh.
PLAUSIBLE_BIAS_K = 0.12


@dataclass(frozen=True)
class Compressor:
    """Constants of the machine that the reduction needs.

    Parameters
    ----------
    mean_radius_m : float
        Radius of the mean rotor velocity U.
    inertia_per_m : float
        ∫dx/A from plane 25 to plane 31 (Eq 5).
    internal_volume_m3 : float
        Volume between the planes that stores mass and energy (Eq 13).
    gamma : float
        Ratio of the specific heats.
    gas_constant_J_kg_K : float
        Specific gas constant.
    """

    mean_radius_m: float
    inertia_per_m: float
    internal_volume_m3: float
    gamma: float
    gas_constant_J_kg_K: float

    @property
    def specific_heat_J_kg_K(self) -> float:
        """Specific heat at constant pressure, γR/(γ−1)."""
        return self.gamma * self.gas_constant_J_kg_K / (self.gamma - 1.0)


@dataclass(frozen=True)
class Converter:
    """The analogue-to-digital converter.

    Parameters
    ----------
    bits : int
        Resolution; the codes run from 0 to 2^bits − 1.
    low_V, high_V : float
        Its range in volts.
    """

    bits: int
    low_V: float
    high_V: float

    @property
    def top_code(self) -> int:
        """Highest code, where the converter clips."""
        return int(2**self.bits - 1)

    @property
    def volts_per_count(self) -> float:
        """Step of one code."""
        return float((self.high_V - self.low_V) / 2**self.bits)


@dataclass(frozen=True)
class NearStall:
    """The facility's steady reading before the surge, and when the record shows the same state.

    Parameters
    ----------
    from_s, to_s : float
        Part of the record, on the facility clock, to be matched with the reading.
    P25_Pa, P31_Pa : float
        Plane-average total pressures.
    T25_K, T31_K : float
        Plane-average total temperatures.
    """

    from_s: float
    to_s: float
    P25_Pa: float
    T25_K: float
    P31_Pa: float
    T31_K: float

    def pressure_Pa(self, plane: int) -> float:
        """Return the facility's total pressure at a plane."""
        return {25: self.P25_Pa, 31: self.P31_Pa}[plane]

    def temperature_K(self, plane: int) -> float:
        """Return the facility's total temperature at a plane."""
        return {25: self.T25_K, 31: self.T31_K}[plane]


@dataclass(frozen=True)
class FileLayout:
    """How the raw record lies in its file, whatever the format.

    Parameters
    ----------
    time : str
        Column of the clock.
    time_unit : str, optional
        Its unit; without it the one that the file states, else seconds.
    group : str, optional
        Group, struct or table of the file that holds the channels; needed where several do.
    clock : {"column", "from rate"}
        Where the time of a row comes from: from the column, or from its number and the sample
        rate.
    start_s : float, optional
        Facility clock at the first row, for a clock that is made or that tells the date.
    other_columns : {"refuse", "ignore"}
        What to do with a column that feeds no channel.
    units : {"check", "from test.toml"}
        Whether a unit that the file states must be the one of test.toml, or is passed over.
    """

    time: str = "time_s"
    time_unit: str | None = None
    group: str | None = None
    clock: str = "column"
    start_s: float | None = None
    other_columns: str = "refuse"
    units: str = "check"


@dataclass(frozen=True)
class PressureChannel:
    """One pressure probe: its place and its calibration.

    A channel in counts has the zero and the calibrate reading of its transducer; one that is
    recorded in a unit of pressure has none of them (``nan``) and may have a reference instead.

    Parameters
    ----------
    name : str
        Channel name.
    plane : int
        25 or 31.
    rake, immersion, facing : str
        Its place; immersion is ``"hub"`` or ``"tip"``, facing is ``"forward"`` or ``"aft"``.
    probe_slope, probe_offset : float
        a and b of Eq 2, common to the forward and aft probes of a pair.
    zoc_reference_Pa : float
        Pressure on the reference side of the transducer.
    zero_count, calibrate_count : float
        Mean codes of the zero and the calibrate readings.
    calibrate_pressure_Pa : float
        Differential pressure that was applied for the calibrate reading.
    unit : str
        Unit in the file: ``"count"``, or a unit of pressure.
    reference_Pa : float, optional
        Absolute pressure that a reading of zero stands for, in a unit that leaves it open.
    column : str
        Column of the file; empty where it has the channel's name.
    """

    name: str
    plane: int
    rake: str
    immersion: str
    facing: str
    probe_slope: float
    probe_offset: float
    zoc_reference_Pa: float = nan
    zero_count: float = nan
    calibrate_count: float = nan
    calibrate_pressure_Pa: float = nan
    unit: str = COUNT
    reference_Pa: float | None = None
    column: str = ""

    @property
    def record_unit(self) -> str:
        """Unit in a record as read: ``"count"``, or ``"Pa"`` for every unit of pressure."""
        return COUNT if self.unit == COUNT else "Pa"

    @property
    def file_column(self) -> str:
        """Column of the file."""
        return self.column or self.name


@dataclass(frozen=True)
class TemperatureChannel:
    """One aspirated thermocouple.

    Parameters
    ----------
    name : str
        Channel name.
    plane : int
        25 or 31.
    rake : str
        Rake it sits on.
    recovery_factor : float
        Indicated over total temperature, both absolute.
    time_constant_s : float
        Lag of the junction.
    unit : str
        Unit in the file.
    column : str
        Column of the file; empty where it has the channel's name.
    """

    name: str
    plane: int
    rake: str
    recovery_factor: float
    time_constant_s: float
    unit: str = "K"
    column: str = ""

    @property
    def record_unit(self) -> str:
        """Unit in a record as read: ``"K"``."""
        return "K"

    @property
    def file_column(self) -> str:
        """Column of the file."""
        return self.column or self.name


@dataclass(frozen=True)
class ProbePair:
    """The forward and the aft probe of one rake at one immersion.

    Parameters
    ----------
    forward, aft : PressureChannel
        The two probes.
    """

    forward: PressureChannel
    aft: PressureChannel

    @property
    def name(self) -> str:
        """Plane, rake and immersion, e.g. ``"25_A_tip"``."""
        return f"{self.forward.plane}_{self.forward.rake}_{self.forward.immersion}"

    @property
    def immersion(self) -> str:
        """``"hub"`` or ``"tip"``."""
        return self.forward.immersion


@dataclass(frozen=True)
class TestDescription:
    """Everything that test.toml says.

    Parameters
    ----------
    name : str
        Name of the test.
    sample_rate_hz : float
        Samples a second of every channel.
    rotor_speed_rpm : float
        Physical rotor speed N, constant through the test.
    design_corrected_speed_rpm : float
        100 % corrected speed.
    compressor : Compressor
        The machine.
    areas_m2 : mapping of int to float
        Flow area of planes 25 and 31.
    converter : Converter or None
        The converter behind the pressure channels; None where none of them is in counts.
    near_stall : NearStall
        The facility reading before the surge.
    pressures : tuple of PressureChannel
        Pressure channels in file order.
    temperatures : tuple of TemperatureChannel
        Thermocouples in file order.
    threshold_lbm_s : float, "none" or None
        Corrected inlet flow that splits in-stall from unstalled, in lbm/s; ``"none"`` for a record
        without an unstalled regime; None where test.toml does not say.
    hysteresis_lbm_s : float
        Half width of the band around the threshold.
    window_s : tuple of float, optional
        Quasi-steady cycles, on the facility clock; None when they are to be found.
    limits : mapping of str to tuple of float
        By channel, the readings that count, in Pa or K whatever the unit of the column.
    near_stall_shifts : mapping of str to float
        By forward probe and thermocouple, what the near-stall match adds, in Pa and K, for a record
        that does not hold the near-stall reading itself; empty where the match is to be found.
    file : FileLayout
        How the record lies in its file.
    source : str
        The file.
    """

    # The name starts with "Test" because it describes one; test runners are to leave it alone.
    __test__ = False

    name: str
    sample_rate_hz: float
    rotor_speed_rpm: float
    design_corrected_speed_rpm: float
    compressor: Compressor
    areas_m2: Mapping[int, float]
    converter: Converter | None
    near_stall: NearStall
    pressures: tuple[PressureChannel, ...]
    temperatures: tuple[TemperatureChannel, ...]
    threshold_lbm_s: float | Literal["none"] | None = None
    hysteresis_lbm_s: float = 0.0
    window_s: tuple[float, float] | None = None
    limits: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    near_stall_shifts: Mapping[str, float] = field(default_factory=dict)
    file: FileLayout = FileLayout()
    source: str = "test.toml"

    def __post_init__(self) -> None:
        object.__setattr__(self, "areas_m2", MappingProxyType(dict(self.areas_m2)))
        object.__setattr__(self, "limits", MappingProxyType(dict(self.limits)))
        shifts = MappingProxyType(dict(self.near_stall_shifts))
        object.__setattr__(self, "near_stall_shifts", shifts)

    def __reduce__(self) -> tuple[object, ...]:
        """Survive pickling, which a mapping proxy does not."""
        values = {name: getattr(self, name) for name in self.__dataclass_fields__}
        for name in ("areas_m2", "limits", "near_stall_shifts"):
            values[name] = dict(getattr(self, name))
        return (_rebuild, (values,))

    @property
    def adc(self) -> Converter:
        """The converter behind the channels that are in counts.

        Raises
        ------
        InputError
            When no channel is.
        """
        if self.converter is None:
            raise InputError(
                f"{self.source}: [adc]", expected="the converter of the counts", found="none"
            )
        return self.converter

    @property
    def rotor_velocity_m_s(self) -> float:
        """Mean rotor velocity U = 2π N r, from the physical speed."""
        return 2.0 * pi * self.rotor_speed_rpm / 60.0 * self.compressor.mean_radius_m

    @property
    def channel_names(self) -> tuple[str, ...]:
        """Names of all channels: pressures, then temperatures."""
        return tuple(c.name for c in self.pressures) + tuple(c.name for c in self.temperatures)

    def pairs(self, plane: int) -> tuple[ProbePair, ...]:
        """Return the probe pairs of a plane, in file order."""
        forward = [c for c in self.pressures if c.plane == plane and c.facing == "forward"]
        aft = {
            (c.rake, c.immersion): c
            for c in self.pressures
            if c.plane == plane and c.facing == "aft"
        }
        return tuple(ProbePair(c, aft[c.rake, c.immersion]) for c in forward)

    def thermocouples(self, plane: int) -> tuple[TemperatureChannel, ...]:
        """Return the thermocouples of a plane, in file order."""
        return tuple(c for c in self.temperatures if c.plane == plane)


def _rebuild(values: dict[str, object]) -> TestDescription:
    return TestDescription(**values)  # type: ignore[arg-type]
