"""Where a rig comes from: a name, a path, another rig."""

from __future__ import annotations

import os

import pytest

from pam_antagonist.errors import BadInput
from pam_antagonist.rig import load_rig, rig_names


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


def test_by_relative_path(edited, monkeypatch):
    path = edited()
    monkeypatch.chdir(path.parent)
    assert load_rig("rig.yaml").name == "shin2022"


def test_unknown_name_gets_a_suggestion():
    with pytest.raises(BadInput) as error:
        load_rig("shin2021")
    assert str(error.value) == (
        f"unknown rig 'shin2021': expected a .yaml file or one of {', '.join(rig_names())}. Did you mean 'shin2022'?"
    )


def test_name_like_nothing_gets_the_list_only():
    with pytest.raises(BadInput) as error:
        load_rig("robot")
    assert str(error.value).endswith(f"one of {', '.join(rig_names())}.")


def test_missing_file(tmp_path, refusal):
    assert refusal(tmp_path / "none.yaml") == "no such rig file"


def test_folder_is_no_file(tmp_path, refusal):
    (tmp_path / "folder.yaml").mkdir()
    assert "cannot be read" in refusal(tmp_path / "folder.yaml")


@pytest.mark.skipif(os.geteuid() == 0, reason="root reads every file")
def test_unreadable_file(edited, refusal):
    path = edited()
    path.chmod(0)
    assert "cannot be read" in refusal(path)


def test_based_on_takes_the_rest_from_another_rig(tmp_path):
    path = tmp_path / "heavy.yaml"
    path.write_text("based_on: shin2022\nname: heavy\njoint: {inertia: 1.0e-3}\n")
    rig, base = load_rig(path), load_rig("shin2022")
    assert (rig.name, rig.joint.inertia) == ("heavy", 1e-3)
    assert rig.joint.mass == base.joint.mass
    assert rig.muscle_1 == base.muscle_1


def test_based_on_a_file_beside_it(edited, tmp_path):
    edited(("radius: 0.0365", "radius: 0.0300"))
    (tmp_path / "two.yaml").write_text("based_on: rig.yaml\nname: two\n")
    assert load_rig(tmp_path / "two.yaml").geometry.radius == 0.03


def test_mistake_in_an_overlay_names_the_overlay(tmp_path, refusal):
    path = tmp_path / "mine.yaml"
    path.write_text("based_on: shin2022\njoint: {intertia: 1.0e-3}\n")
    assert "unknown key 'joint.intertia'" in refusal(path)


@pytest.mark.parametrize("base", ["mine.yaml", "[shin2022]", "{a: b}", "5"])
def test_bad_base(tmp_path, refusal, base):
    path = tmp_path / "mine.yaml"
    path.write_text(f"based_on: {base}\n")
    assert "based_on: expected the name or file of another rig" in refusal(path)


def test_unknown_base_is_named(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("based_on: shin2023\n")
    with pytest.raises(BadInput, match="unknown rig 'shin2023'"):
        load_rig(path)
