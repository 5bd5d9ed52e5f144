"""Where a rig comes from: a name, a path, another rig; and what is written can be read again, by people too."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from pam_antagonist.errors import BadInput
from pam_antagonist.rig import load_rig, rig_names
from pam_antagonist.rig.file import write_rig


def test_by_name():
    assert {"shin2022", "shin2022_as_printed"} <= set(rig_names())
    assert rig_names() == sorted(rig_names())
    for name in rig_names():
        assert load_rig(name, regulators=True).name == name


def test_by_path(edited):
    path = edited(("name: shin2022\n", "name: mine\n"))
    for given in (path, str(path)):
        rig = load_rig(given)
        assert rig.name == "mine"
        assert rig.parameters().tolist() == load_rig("shin2022").parameters().tolist()


def test_unknown_names_get_the_list_and_a_suggestion(tmp_path):
    names = ", ".join(rig_names())
    (tmp_path / "mine.yaml").write_text("based_on: shin2023\n")
    for given, end in (
        ("shin2021", f"a .yaml file or one of {names}. Did you mean 'shin2022'?"),
        ("robot", f"one of {names}."),
        (tmp_path / "mine.yaml", "Did you mean 'shin2022'?"),
    ):
        with pytest.raises(BadInput, match="unknown rig") as error:
            load_rig(given)
        assert str(error.value).endswith(end)


def test_missing_file(tmp_path, refusal):
    assert refusal(tmp_path / "none.yaml") == "no such rig file"


def test_folder_is_no_file(tmp_path, refusal):
    (tmp_path / "folder.yaml").mkdir()
    assert refusal(tmp_path / "folder.yaml") == "a folder, expected a rig file, and there is none in it"


def test_a_folder_offers_the_rig_file_in_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "identified").mkdir()
    (tmp_path / "identified" / "rig.yaml").write_text("based_on: shin2022\n")
    (tmp_path / "identified" / "map.yaml").write_text("time: {rate: 5}\n")
    for given in ("identified", "identified/", tmp_path / "identified"):
        with pytest.raises(
            BadInput, match=r"identified: a folder, expected a rig file such as \S*identified/rig.yaml$"
        ):
            load_rig(given)


@pytest.mark.skipif(os.geteuid() == 0, reason="root reads every file")
def test_unreadable_file(edited, refusal):
    path = edited()
    path.chmod(0)
    assert "cannot be read" in refusal(path)


def test_based_on_takes_the_rest_from_another_rig(tmp_path, refusal):
    path = tmp_path / "heavy.yaml"
    path.write_text("based_on: shin2022\njoint: {intertia: 1.0e-3}\n")
    assert "unknown key 'joint.intertia'" in refusal(path)
    path.write_text("based_on: shin2022\nname: heavy\njoint: {inertia: 1.0e-3}\n")
    rig, base = load_rig(path), load_rig("shin2022")
    assert (rig.name, rig.joint.inertia) == ("heavy", 1e-3)
    assert rig.joint.mass == base.joint.mass
    assert rig.muscle_1 == base.muscle_1


def test_based_on_a_file_beside_it(edited, tmp_path):
    edited(("radius: 0.0365", "radius: 0.0300"))
    (tmp_path / "two.yaml").write_text("based_on: rig.yaml\nname: two\n")
    assert load_rig(tmp_path / "two.yaml").geometry.radius == 0.03


@pytest.mark.parametrize("base", ["mine.yaml", "[shin2022]", "{a: b}", "5"])
def test_bad_base(tmp_path, refusal, base):
    path = tmp_path / "mine.yaml"
    path.write_text(f"based_on: {base}\n")
    assert "based_on: expected the name or file of another rig" in refusal(path)


@pytest.mark.parametrize("name", rig_names())
def test_what_is_written_is_what_was_there(name: str, tmp_path: Path) -> None:
    rig = load_rig(name, regulators=True)
    write_rig(rig, tmp_path / "rig.yaml", ["Made by a test.", ""])
    assert load_rig(tmp_path / "rig.yaml", regulators=True) == rig


def test_small_and_odd_numbers_survive(tmp_path: Path) -> None:
    rig = load_rig("shin2022")
    odd = rig.replaced(
        name="a: b # c",
        valve_1=rig.valve_1.replaced(inflow_area=5.000000000000001e-08),
        friction=rig.friction.replaced(muscle=1e16 / 3e4),
        joint=rig.joint.replaced(stop=None),
        priors={"friction.shaft": 1e-5},
    )
    write_rig(odd, tmp_path / "rig.yaml")
    again = load_rig(tmp_path / "rig.yaml")
    assert again == odd
    assert again.valve_1.inflow_area == 5.000000000000001e-08


def test_every_number_has_its_unit_beside_it(tmp_path: Path) -> None:
    write_rig(load_rig("shin2022"), tmp_path / "rig.yaml")
    lines = (tmp_path / "rig.yaml").read_text(encoding="utf-8").splitlines()
    section = ""
    for line in lines:
        if line and not line.startswith((" ", "#")):
            section = line.partition(":")[0]
        value = line.partition(": ")[2].partition("#")[0].strip()
        numeric = value.lstrip("[-").replace(".", "", 1)[:1].isdigit()
        if numeric and section not in ("uncertainty", "priors"):
            assert "#" in line, line


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    (tmp_path / "rig.yaml").write_text("mine", encoding="utf-8")
    with pytest.raises(FileExistsError):
        write_rig(load_rig("shin2022"), tmp_path / "rig.yaml")
    assert (tmp_path / "rig.yaml").read_text(encoding="utf-8") == "mine"
