"""Arguments that cannot be used: one line says what and what was expected, the status is 2, and nothing is written.

Of commands that are refused before they read a recording; those of the others stand with the commands.
"""

from __future__ import annotations

import pytest

from pam_antagonist.__main__ import COMMANDS, main
from validation.__main__ import COMMANDS as MEASUREMENTS

ALL = {**COMMANDS, **MEASUREMENTS}
# What each command is given beside the arguments that are tried.
USUAL = {
    "simulate": "--rig shin2022 --out {out}",
    "reachable": "--rig shin2022",
    "commission": "--rig shin2022 --out {out}",
    "device_emulator": "--rig shin2022",
    "demo": "--out {out}",
    "battery": "--out {out}",
    "paper": "--out {out}",
    "benchmark": "",
}
REFUSED = {
    "simulate": [
        ("--profile sinus", "sinus"),
        ("--profile none.csv", "none.csv"),
        ("--duration 0", "--duration 0"),
        ("--duration nan", "--duration nan"),
        ("--seed -1", "--seed: '-1': expected"),
        ("--mismatch 3", "mismatch 3"),
        ("--lock-angle 5", "--joint locked"),
    ],
    "reachable": [
        ("--lowest-pressure 700e3", "lowest_pressure 700000 Pa, supply_margin 20000 Pa: expected pressures from"),
        ("--least-force much", "expected a number, 0 or more"),
    ],
    "commission": [
        ("--unattended --source bridge", "only for a simulated joint"),
        ("--duration 1", "expected 30 to 3600 s"),
        ("--max-angle 80", "expected above 0, to 25.0 deg"),
    ],
    "device_emulator": [
        ("--rig shin2023", "unknown rig 'shin2023'"),
        ("--hardware none.yaml", "no such hardware file"),
        ("--drift 2000", "--drift"),
        ("--drift nan", "--drift"),
        ("--first-us -1", "--first-us"),
        ("--seed -1", "--seed"),
        ("--fault melt", "expected one of flip, drop"),
        ("--flip 2", "a share from 0 to 1"),
        ("--freeze-sensor 3@1", "muscle 1 or 2"),
    ],
    "demo": [
        ("--rig no_such", "unknown rig 'no_such'"),
        ("--tuning no_such", "tuning 'no_such'"),
        ("--duration 0", "--duration"),
        ("--duration inf", "--duration"),
        ("--mode position", "--mode"),
        ("--mode impedance --rig shin2022", "does not have the state external_torque"),
        ("--mismatch 1", "--mismatch"),
        ("--gains quick", "--gains quick: expected fast, published, model, or a YAML file"),
        ("--gains no_such.yaml", "no_such.yaml: no such parameter file"),
        ("--seed -1", "--seed"),
        ("bag", "bag"),
    ],
    "battery": [
        ("--shard 3/2", "I/K"),
        ("--shard one", "I/K"),
        ("--count 0", "one case or more"),
        ("--nothing -1", "whole number from 0"),
        ("--seed -1", "whole number from 0"),
        ("--duration 1", "more than 20 s"),
        ("--jobs 0", "whole number from 1"),
    ],
    "paper": [
        ("--only offlien", "offline"),
        ("--only static --seeds 0", "--seeds: '0': expected"),
        ("--only static --seed -1", "--seed: '-1': expected"),
        ("--only static --jobs 0", "--jobs: '0': expected"),
    ],
    "benchmark": [("--only soak", "invalid choice: 'soak'"), ("--rig no_such.yaml", "no_such.yaml")],
}
NEED_ROS = {"demo": "rclpy"}


@pytest.mark.parametrize(
    ("name", "tried", "words"), [(name, tried, words) for name, cases in REFUSED.items() for tried, words in cases]
)
def test_what_cannot_be_used_is_refused_in_one_line(name, tried, words, tmp_path, capsys):
    if name in NEED_ROS:
        pytest.importorskip(NEED_ROS[name])
    usual = USUAL[name].format(out=tmp_path / "out").split()
    assert main([name, *usual, *tried.split()], ALL) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ") and words in error and error.count("\n") == 1, error
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", ["simulate", "replay", "identify", "close_loop", "import_csv", "demo", "paper"])
def test_an_output_that_exists_is_left_alone(name, bag, tmp_path, capsys):
    if name in NEED_ROS:
        pytest.importorskip(NEED_ROS[name])
    (tmp_path / "precious").write_text("data")
    others = {"simulate": "--rig shin2022", "import_csv": f"{bag} --map sealed_joint", "paper": "--only static"}
    given = {**others, "demo": ""}.get(name, f"{bag} --rig shin2022").split()
    assert main([name, *given, "--out", str(tmp_path)], ALL) == 2
    error = capsys.readouterr().err
    assert str(tmp_path) in error and error.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["precious"]
    assert (tmp_path / "precious").read_text() == "data"


@pytest.mark.parametrize("place", ["file/out", f"{'x' * 300}", "/proc/out", "a/../file/out"])
@pytest.mark.parametrize(
    "words",
    [
        "replay bag --rig shin2022", "identify bag --rig shin2022", "close_loop bag --rig shin2022",
        "simulate --rig shin2022", "static --rig shin2022 --volume v.csv", "reachable --rig shin2022",
        "import_csv f.csv --map sealed_joint", "history rig.yaml", "excite --rig shin2022 --source rehearsal",
        "commission --rig shin2022 --source rehearsal --unattended", "demo",
    ],
)  # fmt: skip
def test_a_folder_that_cannot_be_made_is_refused_before_anything_else(refused, tmp_path, monkeypatch, words, place):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("x")
    refused(main, [*words.split(), "--out", place], f"{place}: cannot be made")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_other_outputs_are_tried_before_any_work_as_well(refused, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    refused(main, ["replay", "bag", "--rig", "shin2022", "--out", "out", "--json", "none/x.json"], "--json none/x.json")
    refused(main, ["check", "bag", "--rig", "shin2022", "--json", "/proc/x.json"], "--json /proc/x.json")
