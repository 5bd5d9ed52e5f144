"""Commands of pressure regulators from a CSV file into a bag and back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from csv_files import Lab

from pam_antagonist import read_bag
from pam_antagonist.recording import write_bag

ROWS = 12
BAR = {"unit": "bar", "reference": "gauge"}
ASKED = {"command_1": {"column": "s1", **BAR}, "command_2": {"column": "s2", **BAR}}
AIR = {"pressure": 100.0, "unit": "kPa"}


@pytest.fixture
def lab(tmp_path: Path) -> Lab:
    """Two episodes with measured and commanded pressures."""
    rows = [
        (number, 0.02 * k, 300 + k, 500 - k, 2.0 + 0.1 * k, 4.0 - 0.1 * k) for number in (0, 1) for k in range(ROWS)
    ]
    return Lab(tmp_path).rows(rows, ("episode", "t", "p1", "p2", "s1", "s2"))


def mapped(lab: Lab, **changes: object) -> Lab:
    entries = {"atmosphere": AIR, **ASKED, **changes}
    lab.entries(valve_1=None, valve_2=None, **entries)
    lab.map.write_text(lab.map.read_text() + "drive: regulator\nepisode: episode\n")
    return lab


def test_commands_come_back_as_absolute_pressures(lab: Lab, tmp_path: Path) -> None:
    made = mapped(lab).read()
    write_bag(tmp_path / "bag", made)
    read = read_bag(tmp_path / "bag")
    assert read.drive == made.drive == "regulator"
    assert read.voltage[:ROWS, 0] == pytest.approx(100e3 + 1e5 * (2.0 + 0.1 * np.arange(ROWS)))
    assert np.array_equal(read.voltage, made.voltage)


def test_a_command_that_holds_from_its_row_on_belongs_to_the_next_one(lab: Lab) -> None:
    later = {name: {**entry, "holds": "from_row"} for name, entry in ASKED.items()}
    until, onward = mapped(lab).read().voltage, mapped(lab, **later).read().voltage
    for begin in (0, ROWS):
        assert np.array_equal(onward[begin], until[begin]), "an episode begins with its own command"
        assert np.array_equal(onward[begin + 1 : begin + ROWS], until[begin : begin + ROWS - 1])


def test_what_a_map_of_commands_has_to_say(lab: Lab) -> None:
    assert "command_1 is given, but the joint has valves" in lab.entries(atmosphere=AIR, **ASKED).refusal()
    assert "command_1 and command_2: expected both, or neither" in mapped(lab, command_2=None).refusal()
    assert "atmosphere is missing: command_1 is gauge pressure" in mapped(lab, atmosphere=None).refusal()


def test_setpoints_in_another_unit_are_recognised(lab: Lab) -> None:
    wrong = {name: {**entry, "unit": "kPa"} for name, entry in ASKED.items()}
    said = mapped(lab, **wrong).refusal()
    assert "command_1 (column 's1')" in said and "looks like bar" in said
