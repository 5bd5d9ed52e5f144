"""Times from what was on the valves."""

from __future__ import annotations

from pathlib import Path

import pytest

from pam_antagonist.hardware.emulator import LOG_HEADER
from validation.faults.valve_log import (
    BRIDGE_SAFE,
    CONTROLLER_SAFE,
    Row,
    ValveLog,
    first_obeyed,
    safe_since,
    share_safe,
    wrong_voltages,
)

MS = 1_000_000
ON = (6.0, 5.0)


def row(ms: float, voltage: tuple[float, float], by_itself: bool = False, event: str = "voltage") -> Row:
    return Row(round(ms * MS), event, voltage, by_itself)


ROWS = (
    row(0, ON),
    row(10, (6.1, 4.9)),
    row(20, BRIDGE_SAFE),
    row(25, ON),  # once more, so that what counts begins after it
    row(30, CONTROLLER_SAFE),
    row(32, CONTROLLER_SAFE, event="+nan"),
    row(40, (5.0, 5.3), by_itself=True),
    row(80, ON),
)


def test_safe_voltages_count_from_where_they_were_not_interrupted_any_more() -> None:
    since = safe_since(ROWS, 5 * MS, 70 * MS)
    assert since is not None
    assert (since.time_ns, since.source) == (30 * MS, "controller")


@pytest.mark.parametrize("at", [5, 27, 80, 100])
def test_voltages_that_are_not_safe_at_the_end_were_no_stop(at: int) -> None:
    assert safe_since(ROWS, 0, at * MS) is None
    assert safe_since((), 0, at * MS) is None


def test_control_is_back_with_the_first_voltage_that_is_not_safe() -> None:
    assert first_obeyed(ROWS, 35 * MS) == 80 * MS
    assert first_obeyed(ROWS, 22 * MS) == 25 * MS
    assert first_obeyed(ROWS[:7], 35 * MS) is None
    assert first_obeyed((), 0) is None


def test_share_of_safe_time() -> None:
    assert share_safe(ROWS, 0, 100 * MS) == pytest.approx(0.55)  # 20 to 25, 30 to 80
    assert share_safe(ROWS, 30 * MS, 80 * MS) == 1.0
    assert share_safe(ROWS, 80 * MS, 90 * MS) == 0.0


@pytest.mark.parametrize("voltage", [(10.0, 0.0), (6.0, 6.0), (0.0, 0.0), (9.0, 2.0), (float("nan"), 5.0)])
def test_a_voltage_that_nobody_can_have_meant_is_wrong(voltage: tuple[float, float]) -> None:
    rows = [*ROWS, row(90, voltage)]
    assert wrong_voltages(ROWS, 0, 100 * MS) == []
    assert len(wrong_voltages(rows, 0, 100 * MS)) == 1
    assert wrong_voltages(rows, 0, 89 * MS) == []


def test_log_is_read_while_it_is_written(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    log = ValveLog(path)
    assert log.update() == []
    path.write_text(f"{LOG_HEADER}\n5,1,voltage,5.0,5.25,1\n7,2,+fl")
    assert log.update() == [Row(5, "voltage", (5.0, 5.25), True)]
    with path.open("a") as file:
        file.write("ip,6.0,5.0,0\n9,3,voltage,6.5,4.5,0\n")
    assert [(item.time_ns, item.event, item.by_itself) for item in log.update()] == [
        (5, "voltage", True),
        (7, "+flip", False),
        (9, "voltage", False),
    ]
