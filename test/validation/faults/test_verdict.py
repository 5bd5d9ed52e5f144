"""Times from what was on the valves; what holds and what does not: the judgement of a fault, and the table."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path
from typing import Any

import pytest

from pam_antagonist.errors import BadInput
from pam_antagonist.strict_json import plain
from validation.device.emulator import LOG_HEADER
from validation.faults import command
from validation.faults.catalogue import FAULTS, at_device
from validation.faults.relay import Line
from validation.faults.verdict import (
    BRIDGE_SAFE,
    CONTROLLER_SAFE,
    Fault,
    Outcome,
    Recovery,
    Row,
    Status,
    ValveLog,
    Valves,
    Wanted,
    first_obeyed,
    judge,
    safe_since,
    wrong_voltages,
)
from validation.frame import in_markdown

MS = 1_000_000
ON = (6.0, 5.0)
STOP = Fault(
    "stop", "", at_device("stop"), Valves.SAFE, (Wanted("bridge: safety", 2, "stopped"),), Recovery.CLEAR,
    clear=("bridge",),
)  # fmt: skip
GOES_ON = Fault("on", "", at_device("flip=0.01"), Valves.CONTROLLED, (), Recovery.ITSELF)
SAYS = Status(150 * MS, "bridge: safety", 2, "stopped: so", {})


def seen(*rows: tuple[float, tuple[float, float]], **changes: Any) -> dict[str, Any]:
    """A fault at 100 ms that is over at 200 ms, and cleared at 300 ms."""
    log = [Row(round(at * MS), "voltage", voltage, False) for at, voltage in ((0, ON), *rows)]
    times = {"begin_ns": 100 * MS, "over_ns": 200 * MS, "cleared_ns": 300 * MS}
    return {**times, "rows": log, "statuses": (SAYS,), **changes}


def test_a_stop_in_time_that_lasts_until_it_is_cleared_holds() -> None:
    outcome = judge(STOP, **seen((121, BRIDGE_SAFE), (310, ON)))
    assert outcome.held, outcome.failures
    assert (outcome.safe_ms, outcome.by, outcome.wrong) == (pytest.approx(21.0), "bridge", 0)
    assert outcome.control_s == pytest.approx(0.01)
    assert outcome.statuses == ("bridge: safety ERROR: stopped: so",)


@pytest.mark.parametrize(
    ("observed", "words"),
    [
        (seen((151, BRIDGE_SAFE), (310, ON)), "safe voltages after 51 ms"),
        (seen(), "did not have safe voltages"),
        (seen((121, BRIDGE_SAFE), (250, ON)), "did not have safe voltages"),  # went on before it was cleared
        (seen((121, BRIDGE_SAFE)), "control did not come back"),
        (seen((110, (10.0, 0.0)), (121, BRIDGE_SAFE), (310, ON)), "1 wrong voltages"),
        (seen((121, BRIDGE_SAFE), (310, ON), statuses=()), "no status of bridge: safety"),
        (seen((121, BRIDGE_SAFE), (310, ON), statuses=(SAYS._replace(time_ns=90 * MS),)), "no status of"),
        (seen((121, BRIDGE_SAFE), (310, ON), statuses=(SAYS._replace(level=1),)), "no status of"),
        (seen((121, BRIDGE_SAFE), (310, ON), statuses=(SAYS._replace(part="plant: safety"),)), "no status of"),
    ],
)
def test_what_does_not_hold_is_said(observed: dict[str, Any], words: str) -> None:
    outcome = judge(STOP, **observed)
    assert not outcome.held
    assert any(words in failure for failure in outcome.failures), outcome.failures


def test_control_through_a_fault() -> None:
    outcome = judge(GOES_ON, **seen((120, BRIDGE_SAFE), (140, ON), cleared_ns=None))
    assert outcome.held
    assert outcome.share_safe == pytest.approx(0.2)
    assert (outcome.safe_ms, outcome.control_s) == (None, 0.0)
    outcome = judge(GOES_ON, **seen((120, BRIDGE_SAFE), (210, ON), cleared_ns=None))
    assert not outcome.held and "80 % of the time" in outcome.failures[0]


def test_a_count_has_to_grow_during_the_fault() -> None:
    fault = dataclasses.replace(
        GOES_ON, expected=(Wanted("estimator: samples", 0, "duplicate messages", counted=True),)
    )

    def counted(*counts: tuple[int, int]) -> Outcome:
        said = [Status(at * MS, "estimator: samples", 0, "", {"duplicate messages": str(n)}) for at, n in counts]
        return judge(fault, **seen(cleared_ns=None, statuses=said))

    assert counted((50, 3), (150, 4)).held
    assert not counted((50, 3), (150, 3)).held
    assert not counted((50, 3)).held


def test_every_line_of_the_matrix_can_be_made_and_has_expectations() -> None:
    names = [fault.name for fault in FAULTS]
    assert len(set(names)) == len(names)
    for fault in FAULTS:
        assert bool(fault.clear) == (fault.recovery is Recovery.CLEAR), fault.name
        assert fault.expected or fault.name == "two pipelines", fault.name
    benches = [fault.bench for fault in FAULTS]
    assert sum(a != b for a, b in zip(benches, benches[1:], strict=False)) == len(set(benches)) - 1


def test_table_page_and_json_tell_what_failed() -> None:
    good = judge(STOP, **seen((121, BRIDGE_SAFE), (310, ON)))
    bad = judge(STOP, **seen((163, BRIDGE_SAFE), (310, ON)))
    assert command.line(good).split()[:2] == ["yes", "stop:"] and "safe after 21 ms, by the bridge" in command.line(
        good
    )
    assert command.line(bad).startswith("NO") and "safe voltages after 63 ms, expected" in command.line(bad)
    assert command.summary([good, bad]) == "1 of 2 as expected; safe voltages after 63 ms at most"
    page = in_markdown(command.matrix([good, bad]))
    assert page.count("| stop |") == 2 and "**not as expected**: safe voltages after 63 ms" in page
    widths = {line.count("|") for line in page.splitlines() if line.startswith("|")}
    assert widths == {5}
    content = json.loads(json.dumps(plain(command.content([good, bad]))))
    assert [entry["held"] for entry in content["faults"]] == [True, False]
    assert not math.isnan(content["faults"][0]["safe_ms"])


def test_faults_are_chosen_by_name_in_the_order_of_the_table() -> None:
    names = [FAULTS[3].name, FAULTS[0].name]
    assert command.chosen(FAULTS, names) == [FAULTS[0], FAULTS[3]]
    assert command.chosen(FAULTS, None) == list(FAULTS)
    with pytest.raises(BadInput, match="'bridge kiled': expected one of estimator killed"):
        command.chosen(FAULTS, ["bridge kiled"])


def test_the_list_names_every_fault(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("rclpy")
    assert command.main(["--list"]) == 0
    said = capsys.readouterr().out
    assert all(f"{fault.name}  " in said and fault.what in said for fault in FAULTS)
    assert command.main(["--only", "nothing"]) == 2
    assert capsys.readouterr().err.startswith("error: --only 'nothing'")


def test_what_a_relay_does_to_messages() -> None:
    line = Line(0)

    def through(kind: str, value: float, now: float) -> list[int]:
        line.order = kind, value
        for k in range(1000):
            line.put(k, now)
        return list(line.due(now))

    assert through("", 0.0, 0.0) == list(range(1000))
    assert through("double", 0.0, 1.0) == [k // 2 for k in range(2000)]
    kept = through("drop", 0.2, 2.0)
    assert 700 < len(kept) < 900 and kept == sorted(set(kept))
    assert through("late", 0.1, 3.0) == []
    line.order = "", 0.0
    line.put(-1, 3.05)  # in order again, but behind those that wait
    assert list(line.due(3.09)) == []
    assert list(line.due(3.11)) == [*range(1000), -1]


def test_the_table_as_json_on_standard_output(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    run = pytest.importorskip("validation.faults.bench", exc_type=ImportError)

    def made(faults: list[Fault], rig: str, done: Any) -> list[Outcome]:
        outcome = judge(faults[0], **seen((121, BRIDGE_SAFE), (310, ON)))
        done(outcome)
        return [outcome]

    monkeypatch.setattr(run, "run_faults", made)
    assert command.main(["--only", "bridge killed", "--json", "-"]) in (0, 1)
    printed = capsys.readouterr()
    assert "bridge killed" in str(json.loads(printed.out)) and "bridge killed" in printed.err


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


@pytest.mark.parametrize("voltage", [(10.0, 0.0), (6.0, 6.0), (0.0, 0.0), (9.0, 2.0), (float("nan"), 5.0)])
def test_a_voltage_that_nobody_can_have_meant_is_wrong(voltage: tuple[float, float]) -> None:
    rows = [*ROWS, row(90, voltage)]
    assert (wrong_voltages(ROWS, 0), wrong_voltages(rows, 0), wrong_voltages(rows, 91 * MS)) == (0, 1, 0)


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
