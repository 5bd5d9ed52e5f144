"""Some of the frozen answers of close_loop, of every way that needs no recordings at hand; ./run oracle asks all."""

from __future__ import annotations

from pathlib import Path

import pytest

from validation import frozen, oracle

OLD = oracle.read(Path(__file__).resolve().parents[1] / "diagnosis" / "oracle.jsonl")
JOINTS = frozen.joints(None, OLD)
ASKED = {
    "battery/1009 none": 2, "battery/035 none": 2, "battery/008 warm_up 1": 3, "battery/036 gear_friction": 12,
    "battery/046 load_torque": 60, "battery/025 creep": 17, "battery/034 leak 1": 24,
    "sealed/1": 3, "sealed/2": 4, "sealed/3": 3, "sealed/4": 3, "regulators/900": 8, "regulators/915": 8,
    "guessed/821": 23,
}  # fmt: skip
"""Case -> processor time [s]."""


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow(seconds)) for name, seconds in ASKED.items()]
)
def test_a_frozen_answer_is_not_worse(name: str) -> None:
    said = oracle.compared(OLD[name], oracle.answer(name, JOINTS[name]))
    # Processor time depends on the machine and on what else it does.
    assert [line for line in said if line.startswith("worse") and "processor time" not in line] == []


def test_the_asked_cases_are_of_every_kind_that_can_be_made() -> None:
    kinds = {frozen.kind_of(name) for name in JOINTS} - {"laws", "trials"}  # a minute and more each
    assert {frozen.kind_of(name) for name in ASKED} == kinds
