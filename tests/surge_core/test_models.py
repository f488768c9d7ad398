"""Declarations: what is right becomes a model, what is wrong is listed in one sentence."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import pytest
from pydantic import Field, model_validator

from surge_core.errors import InputError
from surge_core.models import Table, validated


class Machine(Table):
    radius_m: float = Field(
        ge=0.02,
        le=2.0,
        description="a mean radius of 0.02 to 2 m",
        json_schema_extra={"remedy": "is it in mm?"},
    )
    gamma: float = Field(1.4, gt=1.0, lt=2.0)


class Pressure(Table):
    kind: Literal["pressure"]
    plane: Literal[25, 31]


class Temperature(Table):
    kind: Literal["temperature"]
    lag_s: float


class Declared(Table):
    machine: Machine
    channels: dict[str, Annotated[Pressure | Temperature, Field(discriminator="kind")]] = Field({})
    runs: list[Machine] = Field([])
    seeds: int = 1

    @model_validator(mode="after")
    def _few(self) -> Declared:
        if self.seeds > 5:
            raise InputError("seeds", expected="at most 5", found=str(self.seeds))
        return self


GOOD: dict[str, Any] = {"machine": {"radius_m": 1}}


def test_what_is_right_becomes_its_model() -> None:
    made = validated(Declared, GOOD | {"channels": {"P": {"kind": "pressure", "plane": 25}}}, "f")
    assert made.machine == Machine(radius_m=1.0)
    assert made.channels["P"] == Pressure(kind="pressure", plane=25)


BAD: list[tuple[dict[str, Any], str]] = [
    ({}, "f: machine: expected a table with radius_m, gamma, found nothing"),
    (
        {"machine": {"radius_m": 450}},
        "f: machine.radius_m: expected a mean radius of 0.02 to 2 m, found 450; is it in mm?",
    ),
    ({**GOOD, "seeds": 6}, "f: seeds: expected at most 5, found 6"),
    ({**GOOD, "seeds": True}, "f: seeds: expected a whole number, found True"),
    (
        {**GOOD, "sed": 1},
        "f: expected keys out of machine, channels, runs, seeds, "
        "found the key 'sed' (is 'seeds' meant?)",
    ),
    (
        {**GOOD, "channels": {"P": {"kind": "volts"}}},
        "f: channels.P.kind: expected one of 'pressure', 'temperature', found 'volts'",
    ),
    (
        {**GOOD, "runs": [{"radius_m": 1}, {"radius_m": 1, "gamma": float("inf")}]},
        "f: runs[2].gamma: expected a finite number, found inf",
    ),
    (
        {"machine": {"radius_m": "1", "gamma": 3}, "channels": {"P": 3, "T": {"kind": "pressure"}}},
        "f: machine.radius_m: expected a mean radius of 0.02 to 2 m, found '1' "
        "(write the number alone); machine.gamma: expected a value less than 2, found 3; "
        "channels.P: expected a table, found 3; "
        "channels.T.plane: expected a value, found nothing",
    ),
]


@pytest.mark.parametrize(("given", "sentence"), BAD)
def test_all_that_is_wrong_is_listed_at_once(given: dict[str, Any], sentence: str) -> None:
    with pytest.raises(InputError) as caught:
        validated(Declared, given, "f")
    assert str(caught.value) == sentence
