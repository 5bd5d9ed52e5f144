"""Tables as loggers of other laboratories write them: LabVIEW, absolute encoders, one topic a row, ragged rows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from csv_files import HEADER, Lab

SIZE = 200
TIME = 0.01 * np.arange(SIZE)
ANGLE = 25.0 * np.sin(6.0 * TIME) - 5.0  # [deg]


def rows_of(**columns: Any) -> list[list[float]]:
    """Rows of a joint that moves; columns replace those of the same name or are added."""
    known = {"t": TIME, "p1": 300 + ANGLE, "p2": 400 - ANGLE, "u1": 5 + 0.1 * ANGLE, "u2": 5 - 0.1 * ANGLE}
    return [list(row) for row in zip(*{**known, **columns}.values(), strict=True)]


def labview(decimal: str, comments: Sequence[int], segments: int = 1) -> str:
    separator = "\t" if decimal == "," else ","
    head = ["LabVIEW Measurement\t", "Writer_Version\t2", f"Separator{separator}{'Tab' if decimal == ',' else 'Comma'}",
            f"Decimal_Separator{separator}{decimal}", "***End_of_Header***\t"]  # fmt: skip
    head += ["\t", "Channels\t4", "Samples\t200\t200", "***End_of_Header***\t\t\t"] * segments
    lines = [*head, separator.join(["X_Value", *HEADER[1:], "Comment"])]
    for number, row in enumerate(rows_of()):
        cells = [f"{cell:.6f}".replace(".", decimal) for cell in row]
        lines.append(separator.join([*cells, "start"] if number in comments else cells))
    return "\r\n".join(lines) + "\r\n"


@pytest.mark.parametrize("decimal", [",", "."])
@pytest.mark.parametrize("comments", [(0,), (), (7, 90)])
def test_a_labview_header_declares_the_layout(lab: Lab, decimal: str, comments: Sequence[int]) -> None:
    lab.text(labview(decimal, comments)).entries(time={"column": "X_Value", "unit": "s"})
    recording = lab.read()
    assert len(recording) == SIZE
    assert recording.pressure[:, 0] == pytest.approx(1e3 * (300 + ANGLE), abs=1e-2)
    layout = {"delimiter": "tab" if decimal == "," else ",", "decimal": decimal, "skip_lines": 9}
    lab.entries(time={"column": "X_Value", "unit": "s"}, file=layout)
    assert np.array_equal(lab.read().pressure, recording.pressure)


def test_ragged_rows_are_read_where_only_unused_last_columns_are_missing(lab: Lab) -> None:
    rows = rows_of()
    for texts in ({3: "start"}, {3: "start", 50: "stop, or so"}, dict.fromkeys(range(0, SIZE, 5), "7")):
        named = [[*row, f'"{texts[k]}"'] if k in texts else row for k, row in enumerate(rows)]
        recording = lab.rows(named, (*HEADER, "remark")).read()
        assert len(recording) == SIZE and recording.issues[0].size == SIZE - len(texts)
        assert (
            "rows have fewer or more cells than the header, in columns that the map does not use" in recording.issues[0]
        )
    unnamed = [[*row, "start"] if k == 3 else row for k, row in enumerate(rows)]
    assert lab.rows(unnamed).read().issues[0].size == 1


def test_ragged_rows_that_may_lack_another_cell_are_refused(lab: Lab) -> None:
    marked = [[*row, 1] for row in rows_of()]
    del marked[20][2]  # all behind it stand one column too far left
    assert "line 22 has 5 cells" in lab.rows(marked, (*HEADER, "mark")).refusal()
    more = [[*row, 5] if k == 20 else row for k, row in enumerate(rows_of())]
    assert "line 22 has 6 cells" in lab.rows(more).refusal()
    names = ("t", "p1", "p2", "u1", "u2", "remark (a", "b)")
    assert "line 2 has 6 cells" in lab.rows([[*row, 1] for row in rows_of()], names).refusal()


@pytest.mark.parametrize(
    ("unit", "wraps", "turn", "per_degree"),
    [("deg", 360.0, 360.0, 1.0), ("rad", 2 * np.pi, 2 * np.pi, np.pi / 180), ("rev", 1.0, 1.0, 1 / 360),
     ("deg", 180.0, 180.0, 1.0), ("mrad", 2000 * np.pi, 2000 * np.pi, np.pi / 0.18)],
)  # fmt: skip
@pytest.mark.parametrize("low", [0.0, -0.5])
def test_an_absolute_encoder_is_unwrapped_on_request(
    lab: Lab, unit: str, wraps: float, turn: float, per_degree: float, low: float
) -> None:
    moving = ANGLE * per_degree + (0.0 if low == 0.0 else turn / 2)
    cells = (moving - low * turn) % turn + low * turn
    lab.rows(rows_of(angle=cells), (*HEADER, "angle")).entries(angle={"column": "angle", "unit": unit})
    assert f"it jumps as an absolute encoder that begins again: give wraps: {wraps:.7g}" in lab.refusal()
    offset = 0.0 if low == 0.0 else -turn / 2
    lab.entries(angle={"column": "angle", "unit": unit, "wraps": wraps, "offset": offset})
    recording = lab.read()
    assert recording.angle == pytest.approx(np.radians(ANGLE), abs=1e-9)
    assert "begins again after" in recording.issues[0] and recording.issues[0].size > 0


def test_an_absolute_encoder_in_another_unit(lab: Lab) -> None:
    lab.rows(rows_of(angle=ANGLE % 360), (*HEADER, "angle")).entries(angle={"column": "angle", "unit": "rad"})
    assert "give unit: deg, wraps: 360" in lab.refusal()
    lab.rows(rows_of(angle=(ANGLE % 360) * 4096 / 360), (*HEADER, "angle"))
    assert (
        "of an absolute encoder give scale and wraps" in lab.entries(angle={"column": "angle", "unit": "deg"}).refusal()
    )


def by_topic(groups: Sequence[Sequence[int]], apart_s: float, every: Sequence[int] | None = None) -> list[list[Any]]:
    """Rows that hold the cells of one group of columns each."""
    out = []
    for number, group in enumerate(groups):
        for k, row in enumerate(rows_of()):
            if every is None or k % every[number] == 0:
                cells = [value if column in group else "" for column, value in enumerate(row)]
                out.append([round(row[0] + number * apart_s, 6), *cells[1:]])
    return sorted(out, key=lambda row: row[0])


@pytest.mark.parametrize("groups", [((1,), (2,), (3, 4)), ((3,), (2, 4), (1,)), ((1, 2), (3, 4))])
@pytest.mark.parametrize("apart_s", [4e-4, 0.0])
def test_rows_of_one_topic_each(lab: Lab, groups: Sequence[Sequence[int]], apart_s: float) -> None:
    recording = lab.rows(by_topic(groups, apart_s)).read()
    assert len(recording) == SIZE
    first = next(number for number, group in enumerate(groups) if 1 in group)
    at = next(number for number, group in enumerate(groups) if 2 in group)
    moved = np.interp(TIME[1:-1] + first * apart_s, TIME + at * apart_s, 400 - ANGLE)
    assert recording.pressure[:, 0] == pytest.approx(1e3 * (300 + ANGLE))
    assert recording.pressure[1:-1, 1] == pytest.approx(1e3 * moved)
    held = [next(number for number, group in enumerate(groups) if column in group) for column in (3, 4)]
    for number, sign in zip(held, (1, -1), strict=True):
        index = np.arange(SIZE) + (number < first and apart_s > 0.0)  # the next row with a voltage
        index = np.minimum(index, SIZE - 1)
        assert recording.voltage[:, (1 - sign) // 2] == pytest.approx(5 + sign * 0.1 * ANGLE[index])
    assert bool(recording.issues) == (apart_s > 0.0)
    assert not recording.issues or "the rows hold the cells of some columns each" in recording.issues[-1]


def test_commands_that_are_written_when_they_change_are_held(lab: Lab) -> None:
    lab.rows(by_topic(((1, 2), (3, 4)), 1e-3, every=(1, 20)))
    lab.entries(
        **{name: {"column": f"u{name[-1]}", "unit": "V", "holds": "from_row"} for name in ("valve_1", "valve_2")}
    )
    recording = lab.read()
    last = np.maximum((np.arange(SIZE) - 1) // 20 * 20, 0)
    assert recording.voltage[:, 0] == pytest.approx(5 + 0.1 * ANGLE[last])
    assert "held between such rows" in " ".join(recording.issues)
