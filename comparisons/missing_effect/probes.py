"""Score tests: what each effect would win, by its slope at amplitude zero, and all together."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from comparisons.missing_effect.catalogue.workings import HIGHEST_SHARE, stall_episodes
from comparisons.missing_effect.covariance import orthonormal
from comparisons.missing_effect.effect import Effect
from comparisons.missing_effect.engine import Candidate
from comparisons.missing_effect.fit import Fit, Solution, fit_structure, solved
from comparisons.missing_effect.lag_data import TRAIN, LagData
from comparisons.missing_effect.noise import Metric
from comparisons.missing_effect.ports import Ports, respond
from comparisons.missing_effect.quantities import chance
from surge_core.types import FloatArray

# The spectrum of an episode is laid this many times finer than its own lines.
FINER = 4
KEPT_STARTS = 3
# Columns that have lost all but this share of themselves to the base say nothing of their own.
LEAST_OWN_SHARE = 1e-4
# The chance below which what a model leaves is called structure, and not chance.
LEFTOVER_P = 1e-4
# A name is firm only while no test of what it leaves comes below this; tests of one term at a
# time are weaker.
DOUBTFUL_P = 1e-3
DOUBTFUL_ALONE_P = 5e-3
LARGEST_UNEVENNESS = 5.0
# An effect whose start is searched this widely is tested apart from the others.
MANY_TRIALS = 20.0


@dataclass(frozen=True)
class Probe:
    """What the score of one effect says: log-units that a step along its slope would win.

    ``starts`` are the values of its nonlinear parameters from which its search should begin, best
    first; ``columns`` is its slope at the best of them, orthonormal, free of what the base can
    move.
    """

    effect: Effect
    gain: float
    degrees: int
    starts: tuple[FloatArray, ...]
    columns: FloatArray

    def candidate(self, fit: Fit) -> Candidate[Effect, Fit]:
        """Return a model with the effect, fitted and not weighed yet."""
        return Candidate((self.effect,), fit, promised=self.gain)

    @property
    def chance(self) -> float:
        """Chance of so large a gain in noise, times what was searched."""
        return min(1.0, _chi2(self.gain, self.degrees) * self.effect.searched)


class Prober:
    """Score tests against one model, fitted to these data (with the state of open terms)."""

    def __init__(self, fit: Fit, data: LagData, metric: Metric) -> None:
        self.fit, self.data, self.metric = fit, data, metric
        self.solution: Solution = solved(fit.structure, data, metric, fit.nonlinear)
        self.ports = fit.structure.ports(data, fit.nonlinear)
        slopes = orthonormal(self.solution.free_slopes())
        self.basis = np.column_stack([self.solution.basis, slopes])
        self.errors = self.solution.errors
        self._here = self._answer(self.ports)

    def probe(self, effect: Effect) -> Probe:
        """Return the score of one effect at the best of its starts."""
        if effect.episodes:
            return self._ripple(effect)
        starts = effect.starts(self.data)
        columns_of = self._columns if effect.linear else self._slope
        scored = [self._score(columns_of(effect, start)) for start in starts]
        price = 0.5 * float(np.log(max(int(np.count_nonzero(self.data.weight)), 2)))
        order = np.argsort([price * own.shape[1] - gain for gain, own, _ in scored])
        best = scored[order[0]]
        if effect.linear:
            kept = tuple(starts[i] for i in order[:KEPT_STARTS])
        else:
            kept = tuple(self._begun(effect, starts[i], scored[i][2]) for i in order[:KEPT_STARTS])
        if not effect.free:
            # Nothing is searched: each of the held values is tried.
            kept = tuple(starts[i] for i in order)
        return Probe(effect, best[0], best[1].shape[1], kept, best[1])

    def probes(self, effects: Iterable[Effect]) -> list[Probe]:
        """Return the scores of those effects that the model has not."""
        return [self.probe(e) for e in effects if e.name not in self.fit.structure.names]

    def fitted(self, effect: Effect, more: Sequence[FloatArray] = ()) -> Fit | None:
        """Fit the model with one effect more, from where its score tells to begin, and others.

        Returns None where there is nowhere to begin.
        """
        own = [*self.probe(effect).starts, *more]
        starts = [np.concatenate([self.fit.nonlinear, values]) for values in own]
        structure = self.fit.structure.with_effect(effect)
        return fit_structure(structure, self.data, self.metric, starts) if starts else None

    def joint(self, columns: Sequence[FloatArray]) -> tuple[float, FloatArray]:
        """Return the gain and the basis of many columns at once."""
        basis = orthonormal(np.column_stack(columns))
        along = basis.T @ self.errors
        return 0.5 * float(along @ along), basis

    def _columns(self, effect: Effect, start: FloatArray) -> FloatArray:
        """Return the answers to the columns that an effect adds."""
        after = effect.acts(self.ports, self.data, start)
        own = replace(
            after,
            driven=after.driven[:, self.ports.driven.shape[1] :],
            added=after.added[:, self.ports.added.shape[1] :],
        )
        return respond(own, self.data, self.fit.tau_s, self.data.nuisance[:, :0])

    def _slope(self, effect: Effect, start: FloatArray) -> FloatArray:
        amplitude = effect.parameters[0]
        moved = start.copy()
        moved[0] = amplitude.step
        if effect.port == "input":
            structure = self.fit.structure.with_effect(effect)
            ports = structure.ports(self.data, np.concatenate([self.fit.nonlinear, moved]))
        else:
            ports = effect.acts(self.ports, self.data, moved)
        return (self._answer(ports) - self._here)[:, None] / amplitude.step

    def _answer(self, ports: Ports) -> FloatArray:
        fit = self.fit
        return fit.structure.answer(self.data, ports, fit.nonlinear, self.solution.coefficients)

    def _score(self, columns: FloatArray) -> tuple[float, FloatArray, float]:
        """Return gain, own orthonormal columns, and the amplitude of a single column."""
        seen = self.metric.seen(columns, self.solution.decay, self.data)
        whole = np.sqrt(np.einsum("ij,ij->j", seen, seen))
        seen -= self.basis @ (self.basis.T @ seen)
        own = np.sqrt(np.einsum("ij,ij->j", seen, seen))
        kept = own > np.maximum(LEAST_OWN_SHARE * whole, 1e-12)
        if not np.any(kept):
            return 0.0, np.zeros((columns.shape[0], 0)), 0.0
        basis = orthonormal(seen[:, kept])
        along = basis.T @ self.errors
        amplitude = float(seen[:, 0] @ self.errors) / max(float(own[0]) ** 2, 1e-300)
        return 0.5 * float(along @ along), basis, amplitude

    def _begun(self, effect: Effect, start: FloatArray, amplitude: float) -> FloatArray:
        """Return a start with the amplitude that its slope suggests, within half the bounds."""
        parameter = effect.parameters[0]
        out = start.copy()
        out[0] = np.clip(amplitude, 0.5 * parameter.low, 0.5 * parameter.high)
        return out

    def _ripple(self, effect: Effect) -> Probe:
        """Search the frequency of a ripple in the spectra of the errors, episode by episode."""
        found = []
        for gate in effect.starts(self.data)[:, 1]:
            episodes = stall_episodes(self.data, float(gate))
            if not episodes:
                continue
            frequency, power = _episode_spectrum(self.errors, episodes, self.data)
            best = int(np.argmax(power))
            # Two numbers an episode: what white errors would give on the average is their count.
            found.append((float(power[best]), len(episodes), np.array([frequency[best], gate])))
        if not found:
            return Probe(effect, 0.0, 0, (), np.zeros((self.data.n_samples, 0)))
        found.sort(key=lambda item: item[1] - item[0])
        gain, count, start = found[0]
        return Probe(effect, gain, 2 * count, (start,), np.zeros((self.data.n_samples, 0)))


def _episode_spectrum(
    errors: FloatArray, episodes: Sequence[slice], data: LagData
) -> tuple[FloatArray, FloatArray]:
    """Return frequencies and the log-units that a sine of free phase in each episode would win."""
    longest = max(e.stop - e.start for e in episodes)
    size = int(2 ** np.ceil(np.log2(FINER * longest)))
    power = np.zeros(size // 2 + 1)
    for rows in episodes:
        e = errors[rows]
        power += np.abs(np.fft.rfft(e, size)) ** 2 / max(e.size, 1)
    frequency = np.fft.rfftfreq(size, data.sample_period_s)
    # Below two cycles an episode a sine is a trend, and trends are another effect's.
    lowest = 2.0 / (np.median([e.stop - e.start for e in episodes]) * data.sample_period_s)
    power[frequency < lowest] = 0.0
    power[frequency > HIGHEST_SHARE / data.sample_period_s] = 0.0
    return np.asarray(frequency, dtype=np.float64), power


@dataclass(frozen=True)
class Leftover:
    """What a score test of all open terms and all effects finds in a model's errors.

    The gain is what they would win together, or the best where each is tested alone; the chance
    that of this gain, or of a ripple or a branch where they say more; the unevenness by how many
    standard errors the rows that were held out are left noisier than the others.
    """

    gain: float
    degrees: int
    p_value: float
    alone: bool = False
    unevenness: float = 0.0

    @property
    def structured(self) -> bool:
        """Whether the errors hold more than noise that the model's inputs explain."""
        return self.p_value < LEFTOVER_P

    @property
    def doubts(self) -> tuple[str, ...]:
        """Why a name that leaves this is not firm: a stricter bound, and even errors."""
        out, p = [], chance(self.p_value)
        if self.structured:
            out.append(
                "the model with it still leaves structure in its errors (what else was tested "
                f"would win {self.gain:.0f} log-units together, p {p})"
            )
        elif self.p_value < (DOUBTFUL_ALONE_P if self.alone else DOUBTFUL_P):
            out.append(f"what the model with it leaves is hardly chance (p {p})")
        if self.unevenness > LARGEST_UNEVENNESS:
            out.append("it leaves the rows that were held out noisier than those fitted")
        return tuple(out)


def leftover_of(
    prober: Prober, part: NDArray[np.int8], effects: Sequence[Effect], open_terms: Sequence[Effect]
) -> Leftover:
    """Test the errors of a model for anything that open terms and effects could still explain.

    The prober's model is fitted to all rows; ``part`` says which were fitted and held out before.
    """
    probes = prober.probes((*effects, *open_terms))
    searched = [p for p in probes if p.effect.searched >= MANY_TRIALS and p.degrees]
    few = [p for p in probes if p.effect.searched < MANY_TRIALS and p.columns.shape[1]]
    uneven = _unevenness(prober, part)
    apart = min((p.chance for p in searched), default=1.0)
    if prober.metric.flow is not None and few:
        # Many smooth terms together make up the difference between a noisy φ and a smooth one,
        # which is the noise itself: here each is tested alone.
        best = min(few, key=lambda p: p.chance)
        p_value = min(1.0, len(few) * best.chance, 2.0 * apart)
        return Leftover(best.gain, best.degrees, p_value, True, uneven)
    gain, basis = prober.joint([p.columns for p in few]) if few else (0.0, np.zeros((0, 0)))
    together = _chi2(gain, basis.shape[1])
    return Leftover(gain, basis.shape[1], min(1.0, 2.0 * together, 2.0 * apart), False, uneven)


def _chi2(gain: float, degrees: int) -> float:
    from scipy.stats import chi2

    return float(chi2.sf(2.0 * gain, degrees)) if degrees else 1.0


def _unevenness(prober: Prober, part: NDArray[np.int8]) -> float:
    """Return by how many standard errors held-out rows are noisier, by a fit to all."""
    errors = prober.fit.errors(prober.data, prober.metric)
    valid = prober.metric.rows(prober.data) > 0.0
    fitted, held = errors[valid & (part == TRAIN)] ** 2, errors[valid & (part != TRAIN)] ** 2
    if min(fitted.size, held.size) < 2:
        return 0.0
    spread = np.hypot(np.std(fitted) / np.sqrt(fitted.size), np.std(held) / np.sqrt(held.size))
    return float((held.mean() - fitted.mean()) / max(spread, 1e-300))
