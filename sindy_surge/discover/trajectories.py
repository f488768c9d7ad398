"""Measured trajectories, stacked, with inputs between rows, and a library's terms on them."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.interpolate import make_interp_spline

from sindy_surge.candidate_terms import fitted_library, independent_columns
from sindy_surge.library import monomials
from sindy_surge.noise import difference_noise, smoothed
from sindy_surge.segments import Segments
from surge_core.errors import InputError, require
from surge_core.types import BoolArray, FloatArray, IndexArray, IntArray

# Central differences: the cube root of the rounding error, as a share of each state's size.
_STEP = 6e-6
# A product whose share that no other terms reproduce is less than this says nothing of its own.
_ALIAS = 1e-6


@dataclass(frozen=True)
class Features:
    """The terms s_i(x, u) of a library."""

    library: Any  # Fitted to states and inputs together
    names: tuple[str, ...]  # Names of its terms, as pysindy writes them
    # (n_columns,): Size of each state and input, for the steps of numerical derivatives
    size: FloatArray
    level: FloatArray  # (n_columns,): What an idle column is taken as; NaN for one that moves
    own: IndexArray  # The terms of the library that are used

    @classmethod
    def of(
        cls, library: Any, names: Sequence[str], x: FloatArray, u: FloatArray, idle: IndexArray
    ) -> Features:
        """Fit a copy of a library to states and inputs of these names, or refuse its bad terms.

        Of terms with idle columns stay those that terms without them do not reproduce.
        """
        z = np.column_stack((x, u))
        size = np.maximum(np.sqrt(np.mean(z**2, axis=0)), 1e-300)
        with np.errstate(all="ignore"):
            fitted, terms = fitted_library(library, z, names)
            n, level = len(terms), np.full(size.size, np.nan)
            found = cls(fitted, terms, size, level, np.arange(n))
            bad = np.flatnonzero(~np.isfinite(found.values(x, u)).all(axis=0))
        if bad.size:
            raise InputError(
                "library",
                expected="terms that are finite on the whole record",
                found=f"{terms[bad[0]]}, which is not",
                remedy="leave the term out, or write it so that noise cannot leave its domain",
            )
        if not idle.size:
            return found
        holds = np.any(found.derivatives(x, u, idle) != 0.0, axis=(0, 1))
        level[idle] = z[:, idle].mean(axis=0)
        order = np.argsort(holds, kind="stable")
        kept = order[independent_columns(found.values(x, u)[:, order])]
        own = np.flatnonzero(~holds | np.isin(np.arange(n), kept))
        return cls(fitted, tuple(terms[i] for i in own), size, level, own)

    def _columns(self, x: FloatArray, u: FloatArray) -> FloatArray:
        z = np.column_stack((x, u))
        return np.where(np.isnan(self.level), z, self.level)

    @cached_property
    def _powers(self) -> IntArray | None:
        """Exponents (n_terms, n_columns) of a polynomial library, None for another."""
        from pysindy import PolynomialLibrary

        # Not of a subclass, whose terms may be others.
        plain = type(self.library) is PolynomialLibrary
        return np.asarray(self.library.powers_)[self.own] if plain else None

    def values(self, x: FloatArray, u: FloatArray) -> FloatArray:
        """Return the terms (n_rows, n_terms) at states and inputs (n_rows, …)."""
        z = self._columns(x, u)
        if self._powers is not None:
            return monomials(z, self._powers)
        return np.asarray(self.library.transform(z), dtype=np.float64)[:, self.own]

    def derivatives(self, x: FloatArray, u: FloatArray, columns: IndexArray) -> FloatArray:
        """Return ∂s_i/∂z_j by some of all columns z, of shape (n_columns, n_rows, n_terms)."""
        z = self._columns(x, u)
        found = []
        for j in columns.tolist():
            if self._powers is not None:
                lower = self._powers.copy()
                lower[:, j] = np.maximum(lower[:, j] - 1, 0)
                found.append(self._powers[:, j] * monomials(z, lower))
                continue
            step = np.zeros(z.shape[1])
            step[j] = _STEP * self.size[j]
            ahead, behind = (self.library.transform(z + s * step) for s in (1.0, -1.0))
            found.append((np.asarray(ahead - behind) / (2.0 * step[j]))[:, self.own])
        return np.stack(found) * np.isnan(self.level[columns])[:, None, None]

    def index(self, name: str) -> int:
        """Return the place of a term, or refuse one that the library has not."""
        plain = re.sub(r"\s*\*\s*", " ", str(name).strip())
        expected = "terms of the library: " + ", ".join(self.names)
        require(plain in self.names, "known", expected, str(name), "write it as the library does")
        return self.names.index(plain)


# Laws of one quantity that a library of polynomials lacks, by what a sentence calls them.
_LAWS: dict[str, Callable[[FloatArray], FloatArray]] = {
    "sqrt|{}|": lambda z: np.sqrt(np.abs(z)),
    "|{0}| {0}": lambda z: np.abs(z) * z,
    "sin({})": np.sin,
    "cos({})": np.cos,
}


@dataclass(frozen=True)
class WiderFeatures(Features):
    """The terms of a library, and others that no model holds: laws of one quantity, and products.

    Products are those of a term with a state or an input.
    """

    # All terms, then laws and products that terms and earlier ones of their kind do not reproduce
    kept: IntArray

    @classmethod
    def of_features(cls, features: Features, x: FloatArray, u: FloatArray) -> WiderFeatures:
        """Return the terms of a library, which come first, and the others on a record."""
        n = len(features.names)
        given = {each.name: getattr(features, each.name) for each in fields(features)}
        every = cls(**given, kept=np.arange(0))
        values = every._with_others(x, u)
        first = n + len(_LAWS) * every.size.size
        terms, kept = np.arange(n), []
        # Below 0.9 rad the powers up to the fourth reproduce a sine, and laws a power.
        for others in (np.arange(n, first), np.arange(first, values.shape[1])):
            own = np.concatenate((terms, others))
            found = own[independent_columns(values[:, own], _ALIAS)]
            kept.append(found[found >= n])
        laws, products = (values[:, k] / np.linalg.norm(values[:, k], axis=0) for k in kept)
        # Of what keeps its sign |x| x is the square, and goes by that name.
        new = np.all(np.abs(laws.T @ products) < 1.0 - _ALIAS**2, axis=1)
        return replace(every, kept=np.concatenate((terms, kept[0][new], kept[1])))

    def others(self, columns: Sequence[str]) -> tuple[str, ...]:
        """Return the names of those that the library lacks, from those of states and inputs."""
        laws = [law.format(name) for law in _LAWS for name in columns]
        terms, factors = (("1", *names) for names in (self.names, columns))
        products = [_times(term, name) for term in terms for name in factors]
        every = (*self.names, *laws, *products)
        return tuple(every[i] for i in self.kept[len(self.names) :])

    def _with_others(self, x: FloatArray, u: FloatArray) -> FloatArray:
        own, z = super().values(x, u), self._columns(x, u)
        laws = [law(z) for law in _LAWS.values()]
        terms, factors = (np.pad(each, ((0, 0), (1, 0)), constant_values=1.0) for each in (own, z))
        products = (terms[:, :, None] * factors[:, None, :]).reshape(len(x), -1)
        return np.column_stack((own, *laws, products))

    def values(self, x: FloatArray, u: FloatArray) -> FloatArray:
        """Return the terms and the others (n_rows, n_terms) at states and inputs (n_rows, …)."""
        return self._with_others(x, u)[:, self.kept]

    def derivatives(self, x: FloatArray, u: FloatArray, columns: IndexArray) -> FloatArray:
        """Return ∂s_i/∂z_j of shape (n_columns, n_rows, n_terms), 0 of others: none is in."""
        more = self.kept.size - len(self.names)
        return np.pad(super().derivatives(x, u, columns), ((0, 0), (0, 0), (0, more)))


def factors(name: str) -> float:
    """Return the number of factors of a term; a law comes behind the powers that begin it."""
    return 3.5 if re.search(r"[(|]", name) else sum(_powers_of(name).values())


def _powers_of(term: str) -> Counter[str]:
    powers: Counter[str] = Counter()
    for factor in term.split():
        base, _, power = factor.partition("^")
        powers[base] += int(power) if power.isdigit() else 1
    del powers["1"]
    return powers


def _times(term: str, name: str) -> str:
    """Return the name of a term times a column, as pysindy writes it: ``T^4`` for T³ and T."""
    powers = _powers_of(f"{name} {term}")
    return " ".join(base if p == 1 else f"{base}^{p}" for base, p in powers.items()) or "1"


# Fewer rows than this hold no more than their own noise.
_FEWEST_ROWS = 20
# A step so many times the usual one, and those beside it, is a gap, over which nothing is run. Of
# exponential times one step in a million is so long.
_GAP = 20.0
# A spike is so many times what one second difference in a hundred exceeds: 60 standard deviations
# of noise.
_SPIKE = 20.0
# Noise assumed at least, as a share of a state's spread: that of a 12-bit converter whose range is
# five standard deviations.
LEAST_NOISE = 3.5e-4
CUT_ROWS = "cut the record there and pass the parts as trajectories"


@dataclass(frozen=True)
class Trajectories:
    """Trajectories one behind the other, cut at gaps."""

    y: FloatArray  # (n_rows, n_states): Measured states
    u: FloatArray  # (n_rows, n_inputs): Inputs
    time_s: FloatArray  # (n_rows,): Time of each row
    runs: Segments  # The rows of each trajectory between gaps
    # (n_inputs,): Inputs held from each row to the next; the others run smoothly through the rows
    held: BoolArray
    # (n_rows - 1, n_inputs): Where one jumps between rows, over which nothing is run
    open: BoolArray

    @classmethod
    def of(cls, x: Any, t: Any, u: Any = None, names: Any = None) -> Trajectories:
        """Read what a user passes, arrays or lists of arrays and times or a step, or refuse it."""
        xs = listed("x", x)
        # As many numbers as trajectories, which are longer, are a step each.
        several = _several(t) or (np.ndim(t) == 1 and len(t) == len(xs) < max(map(len, xs)))
        ts = list(t) if several else [t] * len(xs)
        us = listed("u", u) if u is not None else [np.zeros((len(each), 0)) for each in xs]
        _same("u", len(us), len(xs), "trajectories")
        _same("t", len(ts), len(xs), "trajectories")
        times: list[FloatArray] = []
        parts: list[IntArray] = []
        first: dict[bytes, int] = {}
        for number, (states, inputs, each) in enumerate(zip(xs, us, ts, strict=True)):
            _same(f"u of trajectory {number}", len(inputs), len(states), "rows")
            _same(f"x of trajectory {number}", states.shape[1], xs[0].shape[1], "states")
            times.append(times_of(each, len(states)))
            part = _parts(times[-1])
            parts.append(part + (parts[-1][-1] + 1 if parts else 0))
            where, fewest = f"x of trajectory {number}", int(np.bincount(part).min())
            enough, remedy = f"at least {_FEWEST_ROWS} rows without a gap", "leave these out"
            if max(map(len, xs)) < _FEWEST_ROWS:
                remedy = "take longer trajectories: each has to show its noise"
            require(fewest >= _FEWEST_ROWS, where, enough, str(fewest), remedy)
            # The same noise twice is no more evidence, but would count as such.
            same = first.setdefault(states.tobytes(), number)
            again = f"those of trajectory {same} again"
            require(same == number, where, "readings of its own", again, "give each record once")
            _no_spikes(where, states, names)
        inputs = np.concatenate(us)
        runs = Segments.from_labels(np.concatenate(parts), len(inputs))
        none = np.zeros(inputs.shape, dtype=np.bool_)
        return cls(np.concatenate(xs), inputs, np.concatenate(times), runs, none[0], none[1:])

    @property
    def step_s(self) -> FloatArray:
        """Time from each row to the next, (n_rows - 1,); meaningless between trajectories."""
        return np.diff(self.time_s)

    @cached_property
    def noise(self) -> FloatArray:
        """Noise of each state that sixth differences show, which a smooth signal hardly has."""
        shown = [difference_noise(y, self.runs, 6) for y in self.y.T]
        return np.asarray(np.maximum(shown, LEAST_NOISE * np.std(self.y, axis=0)))

    @cached_property
    def input_noise(self) -> FloatArray:
        """The least of each input that differences show; 0 where no converter would have seen it.

        Of an input in steps first differences show the least, of a smooth one the sixth.
        """
        shown = [min(difference_noise(u, self.runs, k) for k in range(1, 7)) for u in self.u.T]
        return np.where(shown > LEAST_NOISE * np.std(self.u, axis=0), shown, 0.0)

    def smooth(self) -> FloatArray:
        """Return the states, smoothed as far as their noise asks for."""
        result = np.empty_like(self.y)
        for j, noise in enumerate(self.noise.tolist()):
            for rows in self.runs.slices():
                result[rows, j] = smoothed(self.y[rows, j], noise)
        return result

    def moved(
        self, late: Sequence[int], late_s: float, x: FloatArray, *, lag: bool
    ) -> Trajectories:
        """Return them with the readings of some states as they were before a delay or a lag.

        Their noise stays as it is: only the way of the readings ``x`` without noise is made up.
        """
        y, columns = self.y.copy(), list(late)
        for rows in self.runs.slices():
            t = self.time_s[rows]
            smooth = make_interp_spline(t, x[rows][:, columns])
            way = late_s * smooth(t, 1) if lag else smooth(t + late_s) - smooth(t)
            y[rows, columns] += way
        return replace(self, y=y)

    def within(self, rows: int | None = None) -> BoolArray:
        """Return whether a row and the next belong together, (n_rows - 1,).

        With ``rows`` each trajectory is cut into segments of so many; half a segment further where
        the inputs move less there. A start is free: of a step at a cut nothing shows.
        """
        offset = self.runs.offsets()[1:]
        joined: BoolArray = (offset > 0) & ~np.any(self.open, axis=1)
        if rows is None:
            return joined
        size = np.maximum(np.ptp(self.u, axis=0), 1e-300)
        moves = np.sum(np.abs(np.diff(self.u, axis=0)) / size, axis=1)
        cuts = [(offset + more) % rows == 0 for more in (0, rows // 2)]
        cut = min(cuts, key=lambda here: float(moves[here & (offset > 0)].sum()))
        return np.asarray(joined & ~cut)

    @cached_property
    def end_inputs(self) -> FloatArray:
        """Return the inputs on arrival at the next row, (n_rows - 1, n_inputs)."""
        return np.where(self.held, self.u[:-1], self.u[1:])

    @cached_property
    def _between(self) -> dict[tuple[float, int], FloatArray]:
        return {}

    def inputs_at(self, share: float, degree: int = 3) -> FloatArray:
        """Return the inputs after a share of each step, (n_rows - 1, n_inputs), by splines."""
        if (share, degree) not in self._between:
            value, t = self.u[:-1].copy(), self.time_s
            at = t[:-1] + share * np.diff(t)
            for i in np.flatnonzero(~self.held).tolist():
                # A spline rings at a jump.
                ends = self.open[:, i] | (self.runs.offsets()[1:] == 0)
                for rows in np.split(np.arange(len(t)), np.flatnonzero(ends) + 1):
                    smooth = make_interp_spline(
                        t[rows], self.u[rows, i], min(degree, len(rows) - 1)
                    )
                    value[rows[:-1], i] = smooth(at[rows[:-1]])
            self._between[share, degree] = value
        return self._between[share, degree]

    @cached_property
    def open_at_jumps(self) -> Trajectories:
        """Return them open where an input jumps: rows do not say at what moment between them.

        It moves and stays as it was on one side at least, or moves far more than it does beside.
        One that does nothing else is held.
        """
        moves = np.abs(np.diff(self.u, axis=0))
        still = moves == 0.0
        moves[self.runs.starts[1:] - 1] = moves.max(axis=0)
        beside = np.pad(moves, ((1, 1), (0, 0)), mode="maximum")
        more = np.maximum(moves - np.maximum(beside[:-2], beside[2:]), 0.0)
        jumps = (more > _SPIKE * _usual(more, self.u)) | (np.minimum(beside[:-2], beside[2:]) == 0)
        return replace(self, held=self.held | np.all(jumps | still, axis=0), open=jumps & ~still)


def _several(values: Any) -> bool:
    """Tell whether a list holds an array, rather than numbers, anywhere.

    Lists of numbers that are shorter than the list they are in are the rows of one array.
    """
    return isinstance(values, list | tuple) and any(
        np.ndim(each) > 1
        or (np.ndim(each) == 1 and not (isinstance(each, list | tuple) and len(each) < len(values)))
        for each in values
    )


def listed(name: str, values: Any) -> list[FloatArray]:
    """Return the arrays that a user passes, each of shape (n_rows, n_columns), or refuse them."""
    from sklearn.utils import check_array

    several = _several(values)
    masked = any(np.ma.is_masked(each) for each in (values if several else [values]))
    require(not masked, name, "numbers without a mask", "masked ones", CUT_ROWS)
    try:
        arrays = [
            check_array(each, dtype=np.float64, ensure_2d=False, input_name=name)
            for each in (values if several else [values])
        ]
    except (TypeError, ValueError) as error:
        raise InputError(
            name,
            expected="finite numbers of shape (n_rows, n_columns), or a list of such arrays",
            found=str(error).partition("\n")[0],
            remedy=CUT_ROWS if "contains" in str(error) else "pass numbers, a row for each time",
        ) from error
    return [np.reshape(each, (len(each), -1)) for each in arrays]


def _usual(size: FloatArray, x: FloatArray) -> FloatArray:
    """Return what one in a hundred of the sizes of changes of columns exceeds."""
    # The three that a spike itself leaves are set aside; less than a step of the readings is none.
    step = [np.min(np.diff(np.unique(column)), initial=np.inf) for column in x.T]
    return np.asarray(np.maximum(np.sort(size, axis=0)[-4 - len(size) // 100], step))


def _no_spikes(name: str, x: FloatArray, names: Any) -> None:
    """Refuse a single reading far from both its neighbours, where these go on past it.

    By second differences, of which a spike leaves -1/2, 1, -1/2; a kink or a jump leaves others.
    """
    bent = x[1:-1] - 0.5 * (x[2:] + x[:-2])
    if len(bent) < _FEWEST_ROWS:
        return
    size = np.abs(bent)
    far = size[1:-1] > _SPIKE * _usual(size, x)
    for beside in (bent[:-2], bent[2:]):
        far &= (beside * bent[1:-1] < 0.0) & (np.abs(beside) > 0.25 * size[1:-1])
    rows, columns = np.nonzero(far)
    if rows.size:
        row, column = int(rows[0]) + 2, int(columns[0])
        before, found, after = x[row - 1 : row + 2, column]
        state = f"column {column}" if names is None else dict(enumerate(names)).get(column)
        odd = f"{found:g} in row {row} of {state}, between {before:g} and {after:g}"
        expected, remedy = "readings that follow one another", "; sample faster if it is real"
        raise InputError(name, expected=expected, found=odd, remedy=CUT_ROWS + remedy)


def times_of(t: Any, rows: int) -> FloatArray:
    """Return the time of each row from times or a step, or refuse them."""
    kind, remedy = np.asarray(t).dtype, "pass (t - t[0]) / np.timedelta64(1, 's') for dates"
    found = f"values of type {kind}"
    require(kind.kind in "fiu", "t", "times in seconds, or the sample period", found, remedy)
    times = np.asarray(t, dtype=np.float64)
    if times.ndim == 0:
        times = np.asarray(np.arange(rows) * float(times), dtype=np.float64)
    _same("t", times.size, rows, "rows")
    rise = bool(np.isfinite(times).all() and np.all(np.diff(times) > 0.0))
    found = "a repeat, a step back or NaN"
    require(rise, "t", "times that rise, or a positive step", found)
    return times.ravel()


def _parts(times: FloatArray) -> IntArray:
    """Return how many gaps lie before each row."""
    steps = np.diff(times)
    usual = np.sort(steps)[steps.size // 2 :][:1]
    most = np.maximum(usual, np.roll(steps, 1))
    gap = steps > _GAP * np.maximum(most, np.roll(steps, -1))
    return np.asarray(np.append(0, np.cumsum(gap)), dtype=np.int64)


def output_times(t: Any) -> FloatArray:
    """Return the times at which a run is wanted, or refuse them."""
    times = np.asarray(t, dtype=np.float64)
    expected = "an array of the times at which the states are returned"
    require(times.ndim == 1 and times.size > 0, "t", expected, f"one of shape {times.shape}")
    return times


def _same(name: str, found: int, wanted: int, of_what: str) -> None:
    require(found == wanted, name, f"{wanted} {of_what}", str(found))
