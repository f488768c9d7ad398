"""Effects at all their places in a fitted model, with the scales of its runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from comparisons.missing_effect.systems.fit import Fit
from comparisons.missing_effect.systems.places import (
    AT_INPUTS,
    AT_OUTPUTS,
    Place,
    Placed,
    SystemEffect,
    rms,
)
from comparisons.missing_effect.systems.shapes import Kind
from comparisons.missing_effect.systems.simulate import FINE
from comparisons.missing_effect.systems.structure import Run
from surge_core.types import FloatArray

# Rows of a run on which a term of the user's own is sized.
SIZED_ROWS = 500
# What acts within a model, where a black box lets nothing in.
INSIDE = (Kind.TERM, Kind.HYSTERESIS, Kind.STATE_LIMIT, Kind.OVERFLOW)


def placed_effects(
    fit: Fit, runs: Sequence[Run], effects: Sequence[SystemEffect]
) -> tuple[list[Placed], dict[str, str]]:
    """Return all effects at all their places, scaled by the model's runs.

    Returns
    -------
    placed : list of Placed
        Those that the signals can show and that the model has not.
    refused : dict of str to str
        Effects that cannot be shown at any place, and why.
    """
    signals = _Signals(fit, runs)
    present = {e.key for e in fit.structure.effects}
    placed: list[Placed] = []
    refused: dict[str, str] = {}
    for effect in effects:
        if fit.structure.model.simulate is not None and effect.kind in INSIDE:
            refused.setdefault(effect.name, "acts inside the simulation, which is out of reach")
        for place in effect.places(fit.structure.model):
            own, measured = signals.of(effect, place)
            scaled = measured / rms(measured)
            why = "needs a signal that changes"
            if float(np.ptp(measured)) > 0.0:
                why = effect.refused(own / rms(own), scaled)
            if why:
                refused.setdefault(effect.name, why)
                continue
            one = signals.placed(effect, place, effect.starts(scaled))
            if one is not None and one.key not in present:
                placed.append(one)
    for one in placed:
        refused.pop(one.name, None)
    return placed, refused


class _Signals:
    """Signals and equations along the runs of a model, for scales."""

    def __init__(self, fit: Fit, runs: Sequence[Run]) -> None:
        n_x = len(fit.structure.model.states)
        self.model = fit.structure.model
        self.theta = fit.theta
        every = [path.states[::FINE, :n_x] for path in fit.paths]
        self.states = np.concatenate(every)
        names = self.model.input_names
        self.inputs = np.concatenate([run.experiment.columns(names) for run in runs])
        self.outputs = np.concatenate([run.outputs for run in runs])
        self.simulated = np.concatenate([path.outputs for path in fit.paths])
        h = runs[0].sample_period_s
        self.slopes = np.concatenate([np.gradient(x, h, axis=0) if n_x else x for x in every])

    def of(self, effect: SystemEffect, place: Place) -> tuple[FloatArray, FloatArray]:
        """Return the signal that an effect acts on in the model, and as it was measured."""
        if effect.kind in AT_OUTPUTS:
            measured = self.outputs[:, place.at]
            return self.simulated[:, place.at], measured[np.isfinite(measured)]
        if effect.kind in AT_INPUTS:
            values = self.inputs[:, place.at]
        elif effect.expression is not None:
            values = self._expression(effect)
        elif place.signal >= 0:
            values = self._signal(place.signal)
        else:
            # Constants, drifts and the recorder act on no signal that could be at fault.
            values = np.array([1.0, -1.0])
        return values, values

    def _signal(self, index: int) -> FloatArray:
        n_x = self.states.shape[1]
        return self.states[:, index] if index < n_x else self.inputs[:, index - n_x]

    def _expression(self, effect: SystemEffect) -> FloatArray:
        assert effect.expression is not None
        function = effect.expression(self.model)
        p = tuple(self.theta[: len(self.model.params)].tolist())
        rows = range(0, len(self.states), max(1, len(self.states) // SIZED_ROWS))
        return np.array(
            [
                function(0.0, *self.model.groups(tuple(self.states[k]), tuple(self.inputs[k]), p))
                for k in rows
            ],
            dtype=np.float64,
        )

    def placed(
        self, effect: SystemEffect, place: Place, starts: tuple[tuple[float, ...], ...]
    ) -> Placed | None:
        """Return an effect with its scales; None for a centred form that is the plain one."""
        one = Placed(effect, place, self._scales(effect, place), starts)
        if not effect.centred:
            return one
        indices = (place.signal, place.other)
        signals = [self._signal(i) if i >= 0 else np.zeros(1) for i in indices]
        centres = [float(np.mean(s)) if np.min(s) * np.max(s) > 0.0 else 0.0 for s in signals]
        if not any(centres):
            return None
        own, other = (rms(s - c) for s, c in zip(signals, centres, strict=True))
        return replace(one, scales=(one.scales[0], own, other), centres=(centres[0], centres[1]))

    def _scales(self, effect: SystemEffect, place: Place) -> tuple[float, float, float]:
        """Return the scales of what it enters, of its signal, and of a second one or a time."""
        if effect.kind == Kind.DRIFT:
            value = abs(float(self.theta[place.at]))
            return value if value > 0.0 else 1.0, 1.0, 1.0
        own = rms(self.of(effect, place)[1])
        if effect.kind not in (Kind.TERM, Kind.HYSTERESIS):
            return 1.0, own, 1.0
        into = rms(self.slopes[:, place.at])
        if effect.name == "gravity" and place.signal >= 0:
            own = 1.0
        if effect.kind == Kind.HYSTERESIS:
            return into, own, own / rms(self.slopes[:, place.signal])
        other = rms(self._signal(place.other)) if place.other >= 0 else 1.0
        return into, own, other
