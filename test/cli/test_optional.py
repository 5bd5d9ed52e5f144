"""What is not installed is told in one line, with what to type."""

from __future__ import annotations

import sys

import pytest

from pam_antagonist.__main__ import COMMANDS, main
from pam_antagonist.errors import BadInput
from pam_antagonist.hardware.transport import SerialTransport
from validation.__main__ import COMMANDS as MEASUREMENTS


@pytest.mark.parametrize(
    "arguments",
    [["demo"], ["plant"], ["record", "--out", "bag"], ["faults"], ["benchmark", "--only", "pipeline"]],
    ids=lambda words: words[0],
)
@pytest.mark.parametrize("absent", ["rclpy", "pam_antagonist_msgs"])
def test_without_ros_what_needs_it_says_so(
    arguments,
    absent,
    tmp_path,
    monkeypatch,
    capsys,
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, absent, None)
    assert main(arguments, {**COMMANDS, **MEASUREMENTS}) == 2
    said = capsys.readouterr().err
    assert f"needs ROS 2 ({absent} is not installed)" in said and said.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_without_plotly_a_report_has_no_figures(bag, tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "plotly", None)
    assert main(["replay", str(bag), "--rig", "shin2022", "--out", str(tmp_path / "out")]) == 0
    (said,) = [line for line in capsys.readouterr().err.splitlines() if "plotly" in line]
    assert "pip install 'pam_antagonist[reports]'" in said
    assert "figures.js" not in (page := (tmp_path / "out" / "report.html").read_text(encoding="utf-8"))
    assert "<table" in page


def test_without_pyserial_a_port_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "serial", None)
    with pytest.raises(BadInput, match=r"/dev/ttyACM0: serial is not installed.*'pam_antagonist\[hardware\]'"):
        SerialTransport("/dev/ttyACM0")


def test_without_shtab_completion_says_what_to_install(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "shtab", None)
    assert main(["--completion", "bash"]) == 2
    assert "'pam_antagonist[completion]'" in capsys.readouterr().err
