"""The measured sealed joint, and how a bag says that chambers are sealed."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from csv_files import ROWS, Lab

from pam_antagonist.errors import BadInput
from pam_antagonist.recording import bag_hash, read_bag, write_bag
from pam_antagonist.recording.csv_import import notes, read_csv
from pam_antagonist.recording.csv_map import load_map
from pam_antagonist.recording.notes import read_notes, sealed_muscles, write_notes

SEALED = {"constant": 0.0, "unit": "V", "sealed": True}
# As the recording begins and turns around; the torque's sign does not follow the angle's.
LINES = """\
t_s,torque_Nm,angle_deg,p1_kPa_gauge,p2_kPa_gauge
0.000,0.290024,1.243477,366.33546,366.74882
0.001,0.290619,1.246350,366.32873,366.75250
0.002,-0.426941,-3.427394,372.76374,359.67752
"""


def bag_of(lab: Lab, folder: Path) -> Path:
    mapping = load_map(lab.map)
    write_bag(folder, read_csv(lab.csv, mapping))
    write_notes(folder, notes(lab.csv, mapping))
    return folder


def test_the_map_turns_its_columns_into_si_units(lab: Lab) -> None:
    recording = read_csv(lab.text(LINES).csv, load_map("sealed_joint"))
    assert recording.pressure[0] == pytest.approx([366335.46 + 101325.0, 366748.82 + 101325.0])
    assert recording.angle is not None and recording.external_torque is not None
    assert recording.angle == pytest.approx(
        [1.243477 * math.pi / 180, 1.24635 * math.pi / 180, -3.427394 * math.pi / 180]
    )
    assert recording.external_torque.tolist() == [0.290024, 0.290619, -0.426941]
    assert recording.torque is None, "there is no torque meter: the torque was commanded"
    assert recording.voltage.tolist() == [[0.0, 0.0]] * 3
    assert np.diff(recording.stamp_ns).tolist() == [1_000_000, 1_000_000]


def test_a_bag_says_which_muscles_are_sealed(lab: Lab, tmp_path: Path) -> None:
    lab.entries(valve_1=SEALED, valve_2={"constant": 5.0, "unit": "V", "sealed": True})
    both = bag_of(lab, tmp_path / "both")
    assert sealed_muscles(both) == (1, 2)
    assert sealed_muscles(next(both.glob("*.mcap"))) == (1, 2)
    recording = read_bag(both)
    assert recording.voltage.tolist() == [[0.0, 5.0]] * len(ROWS), "the declared voltages stand on valve_state"
    lab.entries(valve_2=SEALED)
    assert sealed_muscles(bag_of(lab, tmp_path / "second")) == (2,)
    lab.entries(valve_2={"constant": 0.0, "unit": "V"})
    assert sealed_muscles(bag_of(lab, tmp_path / "none")) == ()


def test_a_bag_notes_where_it_comes_from(lab: Lab, tmp_path: Path) -> None:
    lab.text("t,p1,p2,u1,u2\n0,300,500,5,5\n0.01,300,500,5,5\n")
    found = read_notes(bag_of(lab, tmp_path / "bag"))
    assert found["pam_antagonist.source"] == "trial.csv"
    # What sha256sum prints for these 45 bytes.
    assert found["pam_antagonist.source_sha256"] == "3d4e924c2635ed56460b8582a76f100e826e0be7c778c4a1a41489c299d84789"


def test_notes_are_added_to_those_that_are_there_and_change_no_message(lab: Lab, tmp_path: Path) -> None:
    bag = bag_of(lab, tmp_path / "bag")
    before, recording = bag_hash(bag), read_bag(bag)
    write_notes(bag, {"operator": "Zoë", "pam_antagonist.source": "other.csv"})
    assert read_notes(bag)["operator"] == "Zoë"
    assert read_notes(bag)["pam_antagonist.source"] == "other.csv"
    assert "pam_antagonist.source_sha256" in read_notes(bag)
    assert bag_hash(bag) == before
    assert np.array_equal(read_bag(bag).pressure, recording.pressure)


@pytest.mark.parametrize("text", ["", "5", "[]", "rosbag2_bagfile_information: 3",
                                  "rosbag2_bagfile_information: {custom_data: [1]}"])  # fmt: skip
def test_metadata_of_another_kind_holds_no_notes(tmp_path: Path, text: str) -> None:
    (tmp_path / "metadata.yaml").write_text(text)
    assert read_notes(tmp_path) == {}


@pytest.mark.parametrize("text", ["{", "a: *b", "\x01"])
def test_damaged_metadata_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "metadata.yaml").write_text(text)
    with pytest.raises(BadInput, match="metadata.yaml: not readable as YAML"):
        read_notes(tmp_path)


def test_a_note_that_names_no_muscle_is_refused(lab: Lab, tmp_path: Path) -> None:
    bag = bag_of(lab, tmp_path / "bag")
    write_notes(bag, {"pam_antagonist.sealed": "both"})
    with pytest.raises(BadInput, match="is 'both', expected '1', '2' or '1 2'"):
        sealed_muscles(bag)
