"""Sealed joints, joints with regulators, and many recordings in one file: from columns into a bag and back."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from csv_files import ROWS, Lab

from pam_antagonist.errors import BadInput
from pam_antagonist.recording import bag_hash, read_bag, write_bag
from pam_antagonist.recording.csv_import import LEAST_ROWS, PAUSE_NS, notes, read_csv
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
PERIOD = 0.02
NEXT = {"next_p": {"column": "q", "unit": "kPa", "reference": "absolute"}, "next_angle": {"column": "a", "unit": "deg"}}
AIR = {"pressure": 100.0, "unit": "kPa"}
ASKED = {f"command_{n}": {"column": f"s{n}", "unit": "bar", "reference": "gauge"} for n in (1, 2)}


def bag_of(lab: Lab, folder: Path) -> Path:
    mapping = load_map(lab.map)
    write_bag(folder, read_csv(lab.csv, mapping))
    write_notes(folder, notes(lab.csv, mapping))
    return folder


def test_the_map_of_the_sealed_joint_turns_its_columns_into_si_units(lab: Lab) -> None:
    recording = read_csv(lab.text(LINES).csv, load_map("sealed_joint"))
    assert recording.pressure[0] == pytest.approx([366335.46 + 101325.0, 366748.82 + 101325.0])
    degrees = np.array([1.243477, 1.24635, -3.427394])
    assert recording.angle == pytest.approx(degrees * math.pi / 180)
    assert recording.external_torque is not None
    assert recording.external_torque.tolist() == [0.290024, 0.290619, -0.426941]
    assert recording.torque is None, "there is no torque meter: the torque was commanded"
    assert recording.voltage.tolist() == [[0.0, 0.0]] * 3
    assert np.diff(recording.stamp_ns).tolist() == [1_000_000, 1_000_000]


def test_a_bag_says_which_muscles_are_sealed(lab: Lab, tmp_path: Path) -> None:
    lab.entries(valve_1=SEALED, valve_2={"constant": 5.0, "unit": "V", "sealed": True})
    both = bag_of(lab, tmp_path / "both")
    assert sealed_muscles(both) == sealed_muscles(next(both.glob("*.mcap"))) == (1, 2)
    assert read_bag(both).voltage.tolist() == [[0.0, 5.0]] * len(ROWS), "the declared voltages stand on valve_state"
    assert sealed_muscles(bag_of(lab.entries(valve_2=SEALED), tmp_path / "second")) == (2,)
    none = bag_of(lab.entries(valve_2={"constant": 0.0, "unit": "V"}), tmp_path / "none")
    assert sealed_muscles(none) == ()
    write_notes(none, {"pam_antagonist.sealed": "both"})
    with pytest.raises(BadInput, match="is 'both', expected '1', '2' or '1 2'"):
        sealed_muscles(none)


def test_a_bag_notes_where_it_comes_from_and_what_else_is_noted(lab: Lab, tmp_path: Path) -> None:
    lab.text("t,p1,p2,u1,u2\n0,300,500,5,5\n0.01,300,500,5,5\n")
    bag = bag_of(lab, tmp_path / "bag")
    assert read_notes(bag)["pam_antagonist.source"] == "trial.csv"
    # What sha256sum prints for these 45 bytes.
    digest = "3d4e924c2635ed56460b8582a76f100e826e0be7c778c4a1a41489c299d84789"
    assert read_notes(bag)["pam_antagonist.source_sha256"] == digest
    before, recording = bag_hash(bag), read_bag(bag)
    write_notes(bag, {"operator": "Zoë", "pam_antagonist.source": "other.csv"})
    found = read_notes(bag)
    assert (found["operator"], found["pam_antagonist.source"]) == ("Zoë", "other.csv")
    assert found["pam_antagonist.source_sha256"] == digest
    assert bag_hash(bag) == before and np.array_equal(read_bag(bag).pressure, recording.pressure)


def test_metadata_of_another_kind_holds_no_notes(tmp_path: Path) -> None:
    nothing = "rosbag2_bagfile_information: "
    for text in ("", "5", "[]", f"{nothing}3", f"{nothing}{{custom_data: [1]}}"):
        (tmp_path / "metadata.yaml").write_text(text)
        assert read_notes(tmp_path) == {}
    for text in ("{", "a: *b", "\x01"):
        (tmp_path / "metadata.yaml").write_text(text)
        with pytest.raises(BadInput, match="metadata.yaml: not readable as YAML"):
            read_notes(tmp_path)


# ---------------------------------------------------------------- episodes and regulators


def episodes(
    lab: Lab, lengths: tuple[int, ...] = (12, 20, 15), drive: str = "regulator", begin: float = 0.0, **changes: object
) -> Lab:
    """Episodes whose time begins anew, of a joint with regulators; the map's plain entries are ``changes``."""
    names = ("episode", "t", "p1", "p2", "q", "a", "row", "s1", "s2")
    rows = [
        (n, begin + k * PERIOD, 300 + n, 500 - k, 400 + k, 10 * n, 100 * n + k, 2 + 0.1 * k, 4 - 0.1 * k)
        for n, length in enumerate(lengths)
        for k in range(length)
    ]
    entries = {"valve_1": None, "valve_2": None, "drive": drive, "episode": "episode", **changes}
    return lab.rows(rows, names).entries(**entries)


def test_episodes_keep_the_date_of_the_first(lab: Lab) -> None:
    assert episodes(lab, begin=1.5e9).read().stamp_ns[0] == 1_500_000_000 * 10**9


def test_episodes_and_further_signals_come_back_from_a_bag(lab: Lab, tmp_path: Path) -> None:
    made = episodes(lab, also=NEXT).read()
    write_bag(tmp_path / "bag", made)
    read = read_bag(tmp_path / "bag", known=["/pam/pressure_2", "/nowhere"])
    assert "/pam/pressure_2" in read.signals and "/nowhere" not in read.signals
    read = read_bag(tmp_path / "bag", also=["/pam/pressure_2"])
    assert [part.stop - part.start for part in read.episodes] == [12, 20, 15]
    for begin, before in zip(read.episodes[1:], read.episodes, strict=False):
        assert read.stamp_ns[begin.start] - read.stamp_ns[before.stop - 1] == PAUSE_NS
        assert np.ptp(np.diff(read.stamp_ns[begin])) <= 1
    assert read.signals["next_p"].unit == "Pa"
    assert read.signals["next_p"].values[read.episodes[1]] == pytest.approx(1e3 * (400.0 + np.arange(20)))
    assert np.degrees(read.signals["next_angle"].values[read.episodes[2]]) == pytest.approx(np.full(15, 20.0))
    assert np.array_equal(read.signals["/pam/pressure_2"].values, read.pressure[:, 1])
    assert not [issue for issue in read.issues if "no samples for" in issue]
    with pytest.raises(BadInput, match=r"no signal 'elbow'; expected one of next_angle, next_p"):
        read_bag(tmp_path / "bag", also=["elbow"])
    part = made.slice(0.1, 3.0)
    assert [p.stop - p.start for p in part.episodes] == [7, 20]
    assert len(part.signals["next_p"].values) == 27


def test_short_episodes_are_left_out_and_counted(lab: Lab) -> None:
    recording = episodes(lab, (12, 3, 15)).read()
    assert len(recording.episodes) == 2
    assert f"1 of 3 episodes have fewer than {LEAST_ROWS} rows, the first in line 14: left out" in recording.issues


def test_commands_come_back_as_absolute_pressures(lab: Lab, tmp_path: Path) -> None:
    made = episodes(lab, (12, 12), atmosphere=AIR, **ASKED).read()
    write_bag(tmp_path / "bag", made)
    read = read_bag(tmp_path / "bag")
    assert read.drive == made.drive == "regulator"
    assert read.voltage[:12, 0] == pytest.approx(100e3 + 1e5 * (2.0 + 0.1 * np.arange(12)))
    assert np.array_equal(read.voltage, made.voltage)
    later = {name: {**entry, "holds": "from_row"} for name, entry in ASKED.items()}
    onward = episodes(lab, (12, 12), atmosphere=AIR, **later).read().voltage
    for begin in (0, 12):
        assert np.array_equal(onward[begin], made.voltage[begin]), "an episode begins with its own command"
        assert np.array_equal(onward[begin + 1 : begin + 12], made.voltage[begin : begin + 11])


BAR = {"column": "q", "unit": "kPa"}


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"episode": None}, "runs backwards"),
        ({"episode": None}, "episode: COLUMN"),
        ({"episode": "row"}, "is it the column that counts the rows?"),
        ({"drive": "valve"}, "valve_1 is missing; for a joint with pressure regulators in place of valves, give drive"),
        ({"valve_1": {"column": "q", "unit": "V"}}, "expected no valves"),
        ({"also": {"q": BAR}}, "also.q.reference: expected gauge or absolute"),
        ({"also": {"q": {**BAR, "unit": "kN"}}}, "also.q.unit: unknown unit 'kN'"),
        ({"also": {"q": {**BAR, "reference": "gauge"}}}, "atmosphere is missing: also.q is gauge pressure"),
        ({**ASKED}, "atmosphere is missing: command_1 is gauge pressure"),
        ({**ASKED, "atmosphere": AIR, "command_2": None}, "command_1 and command_2: expected both, or neither"),
        ({"atmosphere": AIR, **{n: {**e, "unit": "kPa"} for n, e in ASKED.items()}}, "command_1 (column 's1')"),
        ({"atmosphere": AIR, **{n: {**e, "unit": "kPa"} for n, e in ASKED.items()}}, "looks like bar"),
    ],
)
def test_what_a_map_of_episodes_and_regulators_has_to_say(lab: Lab, changes: dict[str, object], says: str) -> None:
    assert says in episodes(lab, **changes).refusal()


def test_commands_of_valves_are_refused(lab: Lab) -> None:
    assert "command_1 is given, but the joint has valves" in lab.entries(atmosphere=AIR, **ASKED).refusal()
