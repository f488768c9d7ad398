"""One plane of probes: what is averaged over it, and how."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

from classic_ml.flow import physical_flow
from classic_ml.readers.test_description import ProbePair, TestDescription
from classic_ml.records import Record
from surge_core.errors import InputError
from surge_core.types import FloatArray

__all__ = ["AveragedPlane", "averaged_plane", "present_pairs"]


def present_pairs(record: Record, test: TestDescription, plane: int) -> tuple[ProbePair, ...]:
    """Return the pairs whose two probes are (still) in the record."""
    return tuple(
        pair
        for pair in test.pairs(plane)
        if pair.forward.name in record and pair.aft.name in record
    )


@dataclass(frozen=True)
class AveragedPlane:
    """What is averaged over one plane.

    Parameters
    ----------
    plane : int
        25 or 31.
    pairs : mapping of str to tuple of ProbePair
        Those that can be used, by immersion.
    used : tuple of str
        Immersions that the averages are taken over.
    couples : tuple of str
        Thermocouples.
    """

    plane: int
    pairs: Mapping[str, tuple[ProbePair, ...]]
    used: tuple[str, ...]
    couples: tuple[str, ...]

    @property
    def pressure(self) -> str:
        """Name of the total pressure."""
        return f"P{self.plane}_Pa"

    @property
    def flow(self) -> str:
        """Name of the physical flow."""
        return f"W{self.plane}_kg_s"

    @property
    def flow_factors(self) -> tuple[str, str, str]:
        """Names of what the physical flow is computed from (Eq 4)."""
        return f"Wc{self.plane}_kg_s", self.pressure, f"T{self.plane}_K"

    def needs_flows(self, names: Collection[str]) -> bool:
        """Tell whether any of these averages is one of flows."""
        return any(name == self.flow or name.startswith("Wc") for name in names)

    def all_pairs(self) -> Iterator[ProbePair]:
        """Yield the pairs of all immersions."""
        return (pair for pairs in self.pairs.values() for pair in pairs)

    def over_immersions(
        self, local: Mapping[str, FloatArray]
    ) -> tuple[dict[str, FloatArray], FloatArray]:
        """Return the mean of each immersion, and over those in use, of what each pair shows."""
        by_immersion = {i: _mean([local[p.name] for p in pairs]) for i, pairs in self.pairs.items()}
        return by_immersion, _mean([by_immersion[i] for i in self.used])

    def names(self) -> list[str]:
        """Return the names of the averages."""
        p = self.plane
        flows = [f"Wc{p}_kg_s", *(f"Wc{p}_{i}_kg_s" for i in self.pairs)]
        return [*flows, self.pressure, *([f"T{p}_K", self.flow] if self.couples else [])]

    def averages(
        self,
        local: Mapping[str, tuple[FloatArray | None, FloatArray]],
        temperatures_K: Sequence[FloatArray],
        names: Collection[str],
    ) -> dict[str, FloatArray]:
        """Return some averages of some rows.

        Parameters
        ----------
        local : mapping of str to tuple of ndarray
            Corrected flow, where one of them is asked for, and total pressure of each pair.
        temperatures_K : sequence of ndarray
            Of the thermocouples.
        names : collection of str
            Those that are asked for, of this plane.

        Returns
        -------
        dict of str to ndarray of shape (n,)
            By name.
        """
        p = self.plane
        found: dict[str, FloatArray] = {}
        if self.needs_flows(names):
            flows = {name: flow for name, (flow, _) in local.items() if flow is not None}
            by_immersion, found[f"Wc{p}_kg_s"] = self.over_immersions(flows)
            found |= {f"Wc{p}_{i}_kg_s": by_immersion[i] for i in by_immersion}
        if self.flow in names or self.pressure in names:
            totals = {name: total for name, (_, total) in local.items()}
            found[self.pressure] = self.over_immersions(totals)[1]
        if self.flow in names or f"T{p}_K" in names:
            found[f"T{p}_K"] = _mean(temperatures_K)
        if self.flow in names:
            found[self.flow] = physical_flow(*(found[name] for name in self.flow_factors))
        return {name: found[name] for name in names}


def averaged_plane(record: Record, test: TestDescription, plane: int, probes: str) -> AveragedPlane:
    """Choose what is averaged over a plane, or refuse where there is too little.

    Parameters
    ----------
    record : Record
        Which channels there are.
    test : TestDescription
        Places of the probes.
    plane : int
        25 or 31.
    probes : {"all", "tip", "hub"}
        Immersions to use.

    Raises
    ------
    InputError
        When an immersion that is wanted has no pair left, or plane 25 no thermocouple.
    """
    wanted = ("tip", "hub") if probes == "all" else (probes,)
    pairs = present_pairs(record, test, plane)
    by_immersion = {i: tuple(p for p in pairs if p.immersion == i) for i in ("tip", "hub")}
    used = [
        i for i in wanted if by_immersion[i] or any(p.immersion == i for p in test.pairs(plane))
    ]
    missing = [i for i in used if not by_immersion[i]]
    if missing or not used:
        raise InputError(
            f"{record.source}: plane {plane}",
            expected="at least one usable probe pair at " + (" and ".join(missing) or "a place"),
            found="none",
            remedy="the history of the record says which were left out and why",
        )
    couples = tuple(c.name for c in test.thermocouples(plane) if c.name in record)
    if plane == 25 and not couples:
        raise InputError(
            f"{record.source}: plane 25",
            expected="at least one thermocouple that can be used",
            found="none",
            remedy="without T25 there is neither φ nor ψ'",
        )
    return AveragedPlane(plane, {i: p for i, p in by_immersion.items() if p}, tuple(used), couples)


def _mean(values: Sequence[FloatArray]) -> FloatArray:
    if len(values) == 1:
        return values[0]
    added = values[0] + values[1]
    for further in values[2:]:
        added += further
    if len(values) & (len(values) - 1):
        added /= len(values)
    else:
        # Of a power of two the inverse is a double, and a product takes half the time.
        added *= 1.0 / len(values)
    return added
