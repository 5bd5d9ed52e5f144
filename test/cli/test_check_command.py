"""``check`` says what is wrong with a bag, and the other commands refuse such a bag or read it corrected."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from pam_antagonist.cli import check, identify, replay
from pam_antagonist.cli.recordings import next_on_bags
from pam_antagonist.recording import Recording, write_bag
from pam_antagonist.rig import load_rig
from pam_antagonist.rig.file import write_rig


@pytest.fixture(scope="session")
def exchanged(free: Recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag whose pressure lines were exchanged."""
    folder = tmp_path_factory.mktemp("exchanged") / "bag"
    write_bag(folder, replace(free, pressure=free.pressure[:, ::-1]))
    return folder


@pytest.fixture(scope="session")
def in_kilopascals(free: Recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag with gauge pressures in kPa."""
    folder = tmp_path_factory.mktemp("kilopascals") / "bag"
    write_bag(folder, replace(free, pressure=(free.pressure - 101_325.0) / 1e3))
    return folder


def test_a_good_bag_ends_with_status_0(free, tmp_path, capsys, golden):
    assert check.main([str(free.path), "--rig", "shin2022", "--json", str(tmp_path / "found")]) == 0
    golden("check", list(json.loads((tmp_path / "found").read_text()).values()))
    out = capsys.readouterr().out
    assert "✗" not in out
    # What the intervals of other commands rest on comes last.
    assert out.index("each pressure follows its own valve") < out.index("Assumption: rig shin2022") < out.index("next:")


def test_a_rig_that_was_never_identified_is_identified_next(free, tmp_path, capsys):
    assert check.main([str(free.path), "--rig", "shin2022"]) == 0
    assert f"identify {free.path} --rig shin2022 --out DIR" in capsys.readouterr().out
    write_rig(load_rig("shin2022").replaced(identified="an earlier bag"), tmp_path / "rig.yaml")
    assert check.main([str(free.path), "--rig", str(tmp_path / "rig.yaml")]) == 0
    assert f"replay {free.path} --rig" in capsys.readouterr().out


def test_what_is_wrong_is_said_with_the_option(exchanged, capsys):
    assert check.main([str(exchanged), "--rig", "shin2022"]) == 2
    out = capsys.readouterr().out
    assert "✗ the pressure lines are exchanged" in out
    assert "Type --swap-pressures" in out


def test_the_next_command_has_what_was_advised_and_what_was_typed(exchanged, in_kilopascals, free, capsys):
    arguments = [str(exchanged), "--rig", "shin2022"]
    assert check.main(arguments) == 2
    assert f"identify {exchanged} --rig shin2022 --out DIR --swap-pressures\n" in capsys.readouterr().out
    assert check.main([*arguments, "--swap-pressures", "--joint", "free"]) == 0
    line = capsys.readouterr().out.partition("next:\n")[2]
    assert line.endswith(f"identify {exchanged} --rig shin2022 --out DIR --swap-pressures --joint free\n")
    # No options correct two bags that need others.
    assert check.main([*arguments, str(in_kilopascals)]) == 2 and "next:" not in capsys.readouterr().out


def test_the_next_command_names_the_one_other_bag(tmp_path: Path) -> None:
    for name in ("free", "other"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "metadata.yaml").touch()
    typed = [str(tmp_path / "free"), "--rig", "r.yaml", "--out", "o", "--flip-angle", "--joint", "locked"]
    typed += ["--lock-angle", "5", "--topic", "pressure_1=/p 1", "--no-check"]
    arguments = identify.parser().parse_args(typed)
    own = next_on_bags(arguments, "close_loop", arguments.bags, "rig.yaml")
    options = "--rig rig.yaml --out DIR --flip-angle --joint locked --lock-angle 5 --topic 'pressure_1=/p 1' --no-check"
    assert own.endswith(f"close_loop {tmp_path / 'free'} {options}")
    assert f"replay {tmp_path / 'other'} --rig" in next_on_bags(arguments, "replay", None, "rig.yaml")
    (tmp_path / "third").mkdir()
    (tmp_path / "third" / "metadata.yaml").touch()
    assert "replay ANOTHER_BAG --rig" in next_on_bags(arguments, "replay", None, "rig.yaml")


def test_no_fit_of_everything_follows_a_short_recording_or_an_identified_rig(free, tmp_path, capsys):
    assert replay.main([str(free.path), "--rig", "shin2022", "--out", str(tmp_path / "out"), "--no-figures"]) == 0
    assert "next:" not in capsys.readouterr().out, "six seconds"


def test_findings_as_json_on_standard_output(in_kilopascals, capsys):
    assert check.main([str(in_kilopascals), "--rig", "shin2022", "--json", "-"]) == 2
    (found,) = json.loads(capsys.readouterr().out).values()
    assert found["options"] == ["--pressure-unit kPa", "--gauge"]
    assert {finding["status"] for finding in found["findings"]} >= {"wrong", "good"}


def test_with_what_was_typed_nothing_is_wrong(in_kilopascals, exchanged, capsys):
    assert check.main([str(in_kilopascals), "--rig", "shin2022", "--pressure-unit", "kPa", "--gauge"]) == 0
    assert capsys.readouterr().out.rstrip().endswith("--out DIR --pressure-unit kPa --gauge")
    assert check.main([str(exchanged), "--rig", "shin2022", "--swap-pressures"]) == 0


def test_replay_refuses_a_wrong_bag_in_one_line(exchanged, tmp_path, refused):
    arguments = [str(exchanged), "--rig", "shin2022", "--out", str(tmp_path / "out"), "--no-figures"]
    refused(replay.main, arguments, "--swap-pressures", "--no-check")
    assert not (tmp_path / "out").exists()


def test_replay_of_a_corrected_bag_is_that_of_the_good_one(free, exchanged, tmp_path):
    reports = []
    for name, arguments in (("good", [str(free.path)]), ("corrected", [str(exchanged), "--swap-pressures"])):
        assert replay.main([*arguments, "--rig", "shin2022", "--out", str(tmp_path / name), "--no-figures"]) == 0
        reports.append(json.loads((tmp_path / name / "report.json").read_text())["ukf"])
    assert reports[0] == reports[1]
