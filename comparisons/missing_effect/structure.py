"""Which terms and effects a lag model has, and its answer for given parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise, starmap

import numpy as np

from comparisons.missing_effect.effect import PORT_ORDER, Effect
from comparisons.missing_effect.lag_data import LagData
from comparisons.missing_effect.ports import Ports, Response, ages, respond
from surge_core.types import FloatArray

# log τ nearer than this to a bound is at it: a hundredth of τ, less than any fit states.
AT_END = 0.01
# Linear coefficients that belong to no effect.
TERMS, NUISANCE = "terms", "nuisance"


@dataclass(frozen=True)
class Structure:
    """Names of the terms s_i(φ) and the effects that are added to the lag, without numbers.

    The parameters that are not linear stand in one vector: log τ first, then those of each effect.
    """

    terms: tuple[str, ...]
    effects: tuple[Effect, ...] = ()

    def with_effect(self, effect: Effect) -> Structure:
        """Return the structure with one effect more."""
        return Structure(self.terms, (*self.effects, effect))

    @property
    def names(self) -> tuple[str, ...]:
        """Identifiers of the effects."""
        return tuple(effect.name for effect in self.effects)

    @property
    def bounds(self) -> FloatArray:
        """Bounds of the parameters that are not linear, of shape (p, 2)."""
        rows = [(np.log(1e-5), np.log(1e3))]
        rows += [(p.low, p.high) for effect in self.effects for p in effect.nonlinear]
        return np.array(rows)

    def at_end(self, nonlinear: FloatArray) -> bool:
        """Whether τ lies at the end of its search."""
        low, high = self.bounds[0]
        return not low + AT_END < nonlinear[0] < high - AT_END

    @property
    def steps(self) -> FloatArray:
        """Small steps of the parameters that are not linear, of shape (p,)."""
        return np.array([1e-4, *(p.step for effect in self.effects for p in effect.nonlinear)])

    @cached_property
    def slots(self) -> dict[str, range]:
        """Where in the vector the parameters of each effect stand, by its name."""
        ends = np.cumsum([1, *(len(effect.nonlinear) for effect in self.effects)]).tolist()
        return dict(zip(self.names, starmap(range, pairwise(ends)), strict=True))

    @property
    def free(self) -> tuple[int, ...]:
        """Which of the parameters that are not linear are fitted."""
        return (0, *(self.slots[e.name][i] for e in self.effects for i in e.free))

    @property
    def switching(self) -> tuple[int, ...]:
        """Which of them are thresholds at which the answer may change at once."""
        return tuple(self.slots[e.name][i] for e in self.effects if e.switches for i in e.free)

    def ports(self, data: LagData, nonlinear: FloatArray) -> Ports:
        """Return what stands at each port for log τ and the parameters of the effects."""
        ports = self.bare_ports(data, nonlinear)
        for effect in self.in_order:
            if effect.port != "input":
                ports = effect.acts(ports, data, self.values_of(effect, nonlinear))
        return ports

    def bare_ports(self, data: LagData, nonlinear: FloatArray) -> Ports:
        """Return the ports once the effects at the input have acted, and no others."""
        ports = Ports(data["phi"], np.zeros((data["phi"].size, 0)), ())
        for effect in self.in_order:
            if effect.port == "input":
                ports = effect.acts(ports, data, self.values_of(effect, nonlinear))
        return replace(Ports.of(data, ports.phi, self.terms), known=ports.known)

    @property
    def in_order(self) -> tuple[Effect, ...]:
        """The effects in the order in which a signal meets them; a ripple last."""
        return tuple(sorted(self.effects, key=lambda e: (PORT_ORDER.index(e.port), e.episodes)))

    def values_of(self, effect: Effect, nonlinear: FloatArray) -> FloatArray:
        """Return the values of one effect out of the vector."""
        own = self.slots[effect.name]
        return nonlinear[own.start : own.stop]

    def layout(self, data: LagData, nonlinear: FloatArray) -> dict[str, slice]:
        """Return where the linear coefficients of the terms, nuisances and effects stand."""
        bare, n = self.bare_ports(data, nonlinear), len(self.terms)
        widths, behind = {TERMS: n}, dict[str, int]()
        for effect in self.in_order:
            if effect.linear:
                alone = effect.acts(bare, data, self.values_of(effect, nonlinear))
                driven = alone.driven.shape[1] - n
                home = widths if driven else behind
                added = 0 if alone.added is None else alone.added.shape[1]
                home[effect.name] = driven or added
        widths |= {NUISANCE: data.nuisance.shape[1], **behind}
        ends = np.cumsum([0, *widths.values()]).tolist()
        return dict(zip(widths, starmap(slice, pairwise(ends)), strict=True))

    def adapted(self, data: LagData, nonlinear: FloatArray) -> FloatArray:
        """Return the vector with held values as other rows ask for them."""
        out = nonlinear.copy()
        for effect in self.effects:
            if effect.adapted is not None:
                own = self.values_of(effect, nonlinear)
                out[list(self.slots[effect.name])] = effect.adapted(data, own)
        return out

    def without(self, effect: Effect, nonlinear: FloatArray) -> tuple[Structure, FloatArray]:
        """Return the structure and the vector without one effect."""
        kept = tuple(e for e in self.effects if e.name != effect.name)
        return Structure(self.terms, kept), np.delete(nonlinear, self.slots[effect.name])

    def respond(self, data: LagData, nonlinear: FloatArray) -> Response:
        """Return the answer to every linear coefficient, at the samples."""
        return respond(self.ports(data, nonlinear), data, float(np.exp(nonlinear[0])))

    def respond_decay(self, data: LagData, nonlinear: FloatArray) -> FloatArray:
        """Return what is left, at each sample, of a start of its run that is off by one."""
        ports = self.ports(data, nonlinear)
        return np.asarray(np.exp(-ages(ports, data, float(np.exp(nonlinear[0])))))

    def output(self, data: LagData, nonlinear: FloatArray, coefficients: FloatArray) -> FloatArray:
        """Return the model's answer for given coefficients, of shape (n,)."""
        return self.answer(data, self.ports(data, nonlinear), nonlinear, coefficients)

    def slopes(
        self,
        data: LagData,
        nonlinear: FloatArray,
        coefficients: FloatArray,
        which: Sequence[int],
    ) -> FloatArray:
        """Return the derivative of the answer with respect to some parameters that are not linear.

        ``which`` are their places in ``nonlinear``, a column each.
        """
        here = self.ports(data, nonlinear)
        base = self.answer(data, here, nonlinear, coefficients)
        out = np.empty((base.size, len(which)))
        for column, i in enumerate(which):
            step = self.steps[i]
            if nonlinear[i] + step > self.bounds[i, 1]:
                step = -step
            moved = nonlinear.copy()
            moved[i] += step
            ports = here if i == 0 else self.ports(data, moved)
            out[:, column] = (self.answer(data, ports, moved, coefficients) - base) / step
        return out

    def answer(
        self, data: LagData, ports: Ports, nonlinear: FloatArray, coefficients: FloatArray
    ) -> FloatArray:
        """Return the model's answer with something of one's own at the ports, of shape (n,)."""
        q, k = ports.driven.shape[1], data.nuisance.shape[1]
        nuisance = data.nuisance @ coefficients[q : q + k, None] if k else data.nuisance
        tau_s = float(np.exp(nonlinear[0]))
        answer = respond(ports.contracted(coefficients), data, tau_s, nuisance)
        return np.asarray(answer.columns.sum(axis=1) + answer.known)
