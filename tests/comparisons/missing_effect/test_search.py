"""The one search on a system of a few lines: a table of columns, some of which make up y."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from comparisons.missing_effect.engine import Candidate, Policy, Round, System, Tried
from comparisons.missing_effect.evidence import Rows, Tie
from comparisons.missing_effect.lag_data import LATER, TRAIN
from comparisons.missing_effect.search import _rival, alias_sets, search

N, BLOCK = 1200, 30
PART = np.repeat(np.array([TRAIN, LATER], dtype=np.int8), (N // 2, N // 2))
ROWS = Rows.of(PART, np.ones(N, dtype=bool), BLOCK)
RNG = np.random.default_rng(3)
TABLE = {name: RNG.standard_normal(N) for name in ("a", "b", "c", "d")}
NOISE = RNG.standard_normal(N)
# Nearly a; and what stands for a and b together until both are there.
TABLE["like a"] = TABLE["a"] + 0.03 * RNG.standard_normal(N)
TABLE["a and b"] = TABLE["a"] + 0.8 * TABLE["b"] + 0.4 * RNG.standard_normal(N)
TABLE["a refined"] = TABLE["a"] + 0.3 * TABLE["b"]
POLICY = Policy(term=Tie(12.0, 0.02, 2.33, 0.7), plain_speaks=True)


@dataclass(frozen=True)
class Column:
    """A column; those of a library have no name."""

    name: str
    unnamed: bool = False
    brings: int = 1

    @property
    def key(self) -> str:
        return self.name

    def is_plain_form_of(self, other: Any) -> bool:
        return f"{self.name} refined" == other.name


@dataclass(frozen=True)
class Linear:
    """Columns with their coefficients; its own structure."""

    y: np.ndarray
    effects: tuple[Column, ...] = ()
    coefficients: np.ndarray = field(default_factory=lambda: np.zeros(0))

    @property
    def structure(self) -> Linear:
        return self

    @property
    def n_parameters(self) -> int:
        return len(self.effects)

    @property
    def errors(self) -> np.ndarray:
        made = [TABLE[c.name] * b for c, b in zip(self.effects, self.coefficients, strict=True)]
        return np.asarray(self.y - np.sum(made, axis=0))

    def with_effects(self, *effects: Column) -> Linear:
        fitted = PART == TRAIN
        columns = np.column_stack([TABLE[c.name] for c in effects])[fitted]
        found = np.linalg.lstsq(columns, self.y[fitted], rcond=None)[0]
        return replace(self, effects=effects, coefficients=found)


@dataclass(frozen=True, eq=False)
class Table(System[Column, Linear]):
    fit: Linear
    policy: Policy = POLICY
    rows: Rows = ROWS

    @property
    def base_errors(self) -> np.ndarray:
        return self.fit.errors

    def tried(self, effects: Sequence[Column], library: Sequence[Column]) -> Tried[Column, Linear]:
        new = [c for c in (*effects, *library) if c not in self.found]
        return Tried(self, [Candidate((c,), self.fit.with_effects(*self.found, c)) for c in new])

    def errors_of(self, fit: Linear) -> tuple[np.ndarray, tuple[float, float]]:
        return fit.errors, (0.0, 0.0)

    def searched(self, added: Sequence[Column]) -> float:
        return float(len(TABLE))

    def with_winner(self, step: Round[Column, Linear]) -> Table:
        assert step.winner is not None
        return replace(self, fit=step.winner.fit)

    def without_needless(self, one: Column) -> Table | None:
        rest = self.fit.with_effects(*(c for c in self.found if c != one))
        lost = 0.5 * float(rest.errors @ rest.errors - self.fit.errors @ self.fit.errors)
        return replace(self, fit=rest) if lost < 0.5 * np.log(N) else None

    def with_refined(self, plain: Column, refined: Candidate[Column, Linear]) -> Table | None:
        alone = self.fit.with_effects(*refined.added)
        same = alone.errors @ alone.errors < self.fit.errors @ self.fit.errors + 24.0
        return replace(self, fit=alone) if same else None


def found_in(y: np.ndarray, names: str, library: str = "", most: int = 3) -> dict[Any, set[str]]:
    """Names of what is found, each with its alias set."""
    effects = [Column(name) for name in names.split(", ")]
    terms = [Column(name, unnamed=True) for name in library.split(", ") if name]
    system, rounds = search(Table(Linear(y)), effects, terms, most)
    sets = alias_sets(system, rounds, effects)
    assert sorted(k for s in rounds if s.winner for k in s.winner.keys if k in sets) == sorted(sets)
    return {c.name: {other.name for other in sets[c.key]} for c in system.found}


def test_what_makes_up_the_record_is_found_and_nothing_else() -> None:
    y = TABLE["b"] - 0.5 * TABLE["d"] + NOISE
    assert found_in(y, "a, b, c, d") == {"b": {"b"}, "d": {"d"}}
    assert found_in(y, "a, b, c, d", most=1) == {"b": {"b"}}
    assert found_in(NOISE, "a, b, c, d") == {}


def test_what_the_rows_cannot_tell_apart_stands_in_one_set() -> None:
    assert set.union(*found_in(TABLE["a"] + NOISE, "a, like a, c").values()) == {"a", "like a"}


def test_a_name_speaks_unless_a_term_without_one_is_clearly_better() -> None:
    assert list(found_in(TABLE["a"] + NOISE, "like a, c", library="a")) == ["like a"]
    assert list(found_in(TABLE["a"] + NOISE, "c, d", library="a")) == ["a"]


def test_what_stood_in_for_two_is_taken_out_once_both_are_there() -> None:
    y = 2.0 * (TABLE["a"] + TABLE["b"]) + NOISE
    assert set(found_in(y, "a, b, c, a and b")) == {"a", "b"}


def test_a_refined_form_speaks_for_its_plain_one_and_what_that_leaves() -> None:
    for more in (0.0, 0.3):
        y = 4.0 * TABLE["a refined"] + more * TABLE["a"] + NOISE
        assert set(found_in(y, "a, b, a refined")) == {"a refined"}


def test_what_explains_more_of_the_plain_errors_is_a_rival() -> None:
    y = 2.0 * TABLE["a"] + TABLE["c"] + NOISE
    table = Table(Linear(y), replace(POLICY, rival_share=0.8))
    a, c = map(table.weighed, table.tried([Column("a"), Column("c")], ()).candidates)
    for slow in (0.0, 1.0):
        step = Round(table, (a, replace(c, slow=slow)), a, (a,))
        assert (_rival(step, a, table) is not None) == (slow > 0.0)
