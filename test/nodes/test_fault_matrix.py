"""The fault matrix with real processes: the lines that matter most, and all of them."""

from __future__ import annotations

import pytest

from validation.faults.catalogue import FAULTS
from validation.faults.command import chosen

pytestmark = [pytest.mark.ros, pytest.mark.realtime]

# Tests of their own have a device that is unplugged, a second commander and clocks that are set.
MOST_IMPORTANT = (
    "estimator killed", "controller killed", "pressure stuck", "bridge killed",
    "rig file of another joint", "rig file with refined values",
)  # fmt: skip


@pytest.mark.parametrize(
    "names",
    [pytest.param(MOST_IMPORTANT, marks=pytest.mark.thorough(31)), pytest.param(None, marks=pytest.mark.thorough(240))],
    ids=["important", "all"],
)
def test_the_valves_are_safe_in_time_and_control_comes_back(names: tuple[str, ...] | None) -> None:
    from validation.faults.bench import run_faults

    outcomes = run_faults(chosen(FAULTS, names), "shin2022")
    assert len(outcomes) == len(names or FAULTS)
    assert {outcome.fault.name: outcome.failures for outcome in outcomes if not outcome.held} == {}
    assert any(outcome.safe_ms and outcome.by == "device" for outcome in outcomes)
