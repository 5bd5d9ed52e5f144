"""The scripts and commands of the first hour do what the pages say."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pages
import pytest

from pam_antagonist.__main__ import main
from pam_antagonist.recording import read_bag, write_bag

ROOT = pages.ROOT
_NUMBER = re.compile(r"-?\d+\.\d+(?:e-?\d+)?")
EXAMPLES = ROOT / "examples"
SCRIPTS = sorted(EXAMPLES.glob("*.py"))
Capture = pytest.CaptureFixture[str]


def command(words: list[str], folder: Path, capsys: Capture) -> str:
    """What a command prints in a folder; in this process, which has the compiled code already."""
    capsys.readouterr()
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert main(expanded(words, folder)) == 0, words
    return capsys.readouterr().out


def expanded(words: list[str], folder: Path) -> list[str]:
    """The words of a command with its patterns of files replaced, as a shell does."""
    return [
        found
        for word in words
        for found in (sorted(str(path.relative_to(folder)) for path in folder.glob(word)) if "*" in word else [word])
    ]


def test_the_arm_is_claimed_as_on_episodes_that_were_kept_aside() -> None:
    for name in ("README.md", "docs/evidence/measured.md", "docs/evidence/peers.md"):
        text = pages.read(ROOT / name)
        assert "2.72" in text and "2.16" in text and "less than the network" not in text, name
    assert "2.25°" not in pages.read(ROOT / "README.md")


def test_scripts_are_short() -> None:
    assert len(SCRIPTS) == 5
    assert all(len(path.read_text(encoding="utf-8").splitlines()) <= 30 for path in SCRIPTS)


def test_recordings_are_small() -> None:
    bags = [*(EXAMPLES / "recordings").rglob("*.mcap")]
    assert len(bags) == 2 and sum(path.stat().st_size for path in bags) < 8e6


def test_replay_script_draws_the_angle(tmp_path: Path, capsys: Capture) -> None:
    out = pages.printed(EXAMPLES / "replay_a_bag.py", tmp_path, capsys)
    error, share = re.match(r"angle RMSE ([\d.]+)°, ([\d.]+)% within", out).groups()
    assert float(error) < 0.2 and float(share) > 95.0
    assert (tmp_path / "angle.png").stat().st_size > 10_000


def test_step_script_tells_one_estimate_every_five_seconds(tmp_path: Path, capsys: Capture) -> None:
    lines = pages.printed(EXAMPLES / "step_by_step.py", tmp_path, capsys).splitlines()
    rows = [[float(word) for word in line.split()] for line in lines[1:-1]]
    assert [row[0] for row in rows] == [0.0, 5.0, 10.0, 15.0, 20.0, 25.0]
    assert lines[-1].startswith("Counts(processed=30000, predicted_only=0, missing=0")


def test_regulator_script_does_without_measured_pressures(tmp_path: Path, capsys: Capture) -> None:
    lines = pages.printed(EXAMPLES / "regulators.py", tmp_path, capsys).splitlines()
    assert [line.split(":")[0] for line in lines] == ["pressures measured", "pressures not measured"]
    measured, blind = (float(re.search(r"angle RMSE ([\d.]+)°", line).group(1)) for line in lines)
    assert blind < 1.2 * measured < 0.6


@pytest.mark.thorough(15)
def test_diagnosis_script_finds_the_leak_of_each_recording(tmp_path: Path, capsys: Capture) -> None:
    """In most of each recording: the whole ones are those of the first hour, below."""
    script = shutil.copy(EXAMPLES / "diagnose_a_leak.py", tmp_path)
    for name in ("leak_free", "leak_locked"):
        whole = read_bag(EXAMPLES / "recordings" / name)
        write_bag(tmp_path / "recordings" / name, whole.slice(0.0, 21.0))
    out = pages.printed(script, tmp_path, capsys)
    assert out.startswith("effect - ")
    assert re.findall(r"^(\w+), muscle (\d)", out, re.MULTILINE) == [("leak", "1"), ("leak", "2")]


@pytest.mark.parametrize("command", ["replay", "identify", "close_loop"])
def test_the_reference_has_every_key_of_a_report(command: str) -> None:
    """The kept reports have the keys of today: the tests of each command compare them."""
    reference = pages.read(ROOT / "docs" / "reference" / "report_json.md")
    named = reference.split("\n## ")[0] + reference.split(f"\n## {command}\n")[1].split("\n## ")[0]
    kept = json.loads((ROOT / "test" / "golden" / f"{command}.json").read_text(encoding="utf-8"))
    assert [key for key in kept if f"`{key}`" not in named] == []


@pytest.mark.thorough(55)
def test_commands_of_the_first_hour(tmp_path: Path, capsys: Capture) -> None:
    """Without the demo, which needs ROS 2; what the page shows of the output is what is printed."""
    (tmp_path / "examples").symlink_to(EXAMPLES)
    page = ROOT / "docs" / "tutorials" / "first_hour.md"
    printed = ""
    for block in pages.blocks(page):
        for words in pages.commands(block.text) if block.language == "bash" else ():
            if words[0] != "demo":
                printed += command(words, tmp_path, capsys)
    shown = [line for block in pages.blocks(page) if block.language == "text" for line in block.text.splitlines()]
    rows = [line for line in shown if re.match(r"  +\S.*\d( %)?( +–)?$", line)]
    assert len(rows) > 20
    for row in rows:
        rivals = [line for line in printed.splitlines() if _without_numbers(line) == _without_numbers(row)]
        assert any(_numbers(line) == pytest.approx(_numbers(row), rel=0.3, abs=0.01) for line in rivals), row


@pytest.mark.thorough(70)
def test_commands_of_your_own_rig(tmp_path: Path, capsys: Capture) -> None:
    """A guessed rig is commissioned in a rehearsal, and what the page shows of the output is what is printed."""
    page, printed = ROOT / "docs" / "tutorials" / "your_own_rig.md", ""
    for block in pages.blocks(page):
        for words in pages.commands(block.text) if block.language == "bash" else ():
            printed += command(words, tmp_path, capsys)
    steps = json.loads((tmp_path / "rehearsed" / "state.json").read_text(encoding="utf-8"))["steps"]
    assert list(steps) == ["wiring", "slow", "quick", "identify", "gains"]
    assert sum(step.get("rig_s", 0.0) for step in steps.values()) < 15 * 60
    shown = "\n".join(block.text for block in pages.blocks(page) if block.language == "text")
    (row,) = re.findall(r"^identify: .*", shown, re.MULTILINE)
    (now,) = re.findall(r"^identify: .*", printed, re.MULTILINE)
    error, before = (float(value) for value in re.search(r"errs by ([\d.]+) deg \(([\d.]+) deg", now).groups())
    assert error < 0.3 and before > 10.0 * error
    assert _without_digits(row) == _without_digits(now)
    assert "no effect is missing" in shown and "no effect is missing" in printed


def _without_digits(line: str) -> str:
    return re.sub(r"[\d.]+", "#", line)


def _without_numbers(line: str) -> str:
    return " ".join(_NUMBER.sub("#", line).split())


def _numbers(line: str) -> list[float]:
    return [float(number) for number in _NUMBER.findall(line)]
