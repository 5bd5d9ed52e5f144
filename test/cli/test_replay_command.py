"""The command as users meet it."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from pam_antagonist.cli.replay import main


def strict(text: str) -> Any:
    return json.loads(text, parse_constant=pytest.fail)


def report(folder: Path) -> Any:
    return strict((folder / "report.json").read_text())


def test_a_bag_gives_report_and_table(bag, tmp_path, capsys):
    out = tmp_path / "out"
    assert main([str(bag), "--rig", "shin2022", "--out", str(out)]) == 0
    assert sorted(path.name for path in out.iterdir()) == ["report.html", "report.json"]
    assert report(out)["samples"] == 4000 and report(out)["live_equal"] is None
    text = capsys.readouterr().out
    assert "RMSE" in text and "model alone" in text
    assert "\x1b" not in text
    assert "Plotly" in (out / "report.html").read_text()


def test_several_bags_and_other_settings(bag, tmp_path):
    arguments = [str(bag), str(bag), "--rig", "shin2022", "--tuning", "published", "--joint", "locked"]
    assert main([*arguments, "--lock-angle", "2", "--out", str(tmp_path / "out"), "--no-figures"]) == 0
    found = report(tmp_path / "out")
    assert len(found["recordings"]) == 2
    assert found["settings"]["tuning"]["name"] == "published"
    assert found["recordings"][0]["joint"]["lock_angle_rad"] == pytest.approx(0.0349, abs=1e-4)


def test_topics_may_have_other_names(bag, tmp_path, capsys):
    # The bag's own names, given by hand, with the muscles exchanged: everything else is found as before.
    exchanged = ["--topic", "pressure_1=/pam/pressure_2", "--topic", "pressure_2=/pam/pressure_1"]
    arguments = [str(bag), "--rig", "shin2022", "--no-figures"]
    assert main([*arguments, "--out", str(tmp_path / "a")]) == 0
    assert main([*arguments, *exchanged, "--out", str(tmp_path / "b")]) == 0
    straight, crossed = (report(tmp_path / name) for name in "ab")
    assert crossed["recording"]["topics"]["pressure_1"] == "/pam/pressure_2"
    assert crossed["ukf"]["angle"]["rmse_deg"] > 3.0 * straight["ukf"]["angle"]["rmse_deg"]


def test_json_to_standard_output_and_the_estimate_beside_it(bag, tmp_path, capsys):
    arguments = [str(bag), "--rig", "shin2022", "--out", str(tmp_path / "out"), "--no-figures", "--json", "-"]
    assert main([*arguments, "--save", str(tmp_path / "estimate.csv")]) == 0
    printed = capsys.readouterr()
    assert strict(printed.out) == report(tmp_path / "out")
    assert "angle" in printed.err and "estimate.csv" in printed.err
    assert (tmp_path / "estimate.csv").read_text().startswith("stamp_ns,time_s,angle_rad,angle_std_rad,")


@pytest.fixture
def cut(bag: Path, tmp_path: Path) -> Path:
    """A copy of the bag that lacks its end."""
    shutil.copytree(bag, tmp_path / "cut")
    (file,) = (tmp_path / "cut").glob("*.mcap")
    file.write_bytes(file.read_bytes()[:-5000])
    return tmp_path / "cut"


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ("{bag} --rig shin2202", "unknown rig 'shin2202'"),
        ("{bag} --rig {tmp}/none.yaml", "none.yaml"),
        ("{tmp}/none --rig shin2022", "none"),
        ("{tmp}/empty --rig shin2022", "empty"),
        ("{tmp}/text.mcap --rig shin2022", "text.mcap"),
        ("{tmp}/cut --rig shin2022", "cut"),
        ("{bag} --rig shin2022 --tuning none", "tuning 'none'"),
        ("{bag} --rig shin2022 --topic pressure_3=/x", "pressure_3"),
        ("{bag} --rig shin2022 --topic pressure_1=/x", "/x"),
        ("{bag} --rig shin2022 --joint loose", "loose"),
        ("{bag} --rig shin2022 --lock-angle 3", "--joint locked"),
        # A lock angle is told in degrees, refused in the rig's radians.
        ("{bag} --rig shin2022 --joint locked --lock-angle 80", "1.39626"),
        ("{bag} --rig shin2022 --joint locked --lock-angle nan", "nan"),
        ("{bag} --rig shin2022 --save {tmp}/estimate.txt", ".csv or .mcap"),
        ("{bag} --rig shin2022 --save {tmp}/text.mcap", "exists"),
        ("{bag}", "--rig"),
        ("--rig shin2022", "BAG"),
        ("{bag} --rig shin2022 --no-such-thing", "--no-such-thing"),
    ],
)
def test_bad_input_is_one_line_that_names_it(bag, cut, tmp_path, refused, arguments, says):
    (tmp_path / "empty").mkdir()
    (tmp_path / "text.mcap").write_text("not a bag")
    refused(main, [*arguments.format(bag=bag, tmp=tmp_path).split(), "--out", str(tmp_path / "out")], says)
    assert not (tmp_path / "out").exists() and (tmp_path / "text.mcap").read_text() == "not a bag"


def test_a_damaged_bag_can_be_read_up_to_the_damage(cut, tmp_path):
    arguments = [str(cut), "--rig", "shin2022", "--recover", "--no-figures"]
    assert main([*arguments, "--out", str(tmp_path / "out")]) == 0
    assert report(tmp_path / "out")["recording"]["issues"]
