"""``commission``: what it refuses."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from pam_antagonist.cli import commission


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--unattended", "--source", "bridge"], "only for a simulated joint"),
        (["--duration", "1"], "expected 30 to 3600 s"),
        (["--max-angle", "80"], "expected above 0, to 25.0 deg"),
    ],
)
def test_arguments_that_do_not_go_together_are_refused(
    arguments: list[str], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert commission.main(["--rig", "shin2022", "--out", str(tmp_path / "new"), *arguments]) == 2
    assert words in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


def test_a_folder_of_something_else_stays_as_it_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert commission.main(["--rig", "shin2022", "--out", str(tmp_path), "--unattended"]) == 2
    assert "but commission did not write it" in capsys.readouterr().err
    (tmp_path / "state.json").write_text(json.dumps({"rig": "another", "steps": {}}))
    assert commission.main(["--rig", "shin2022", "--out", str(tmp_path), "--unattended"]) == 2
    assert "was begun with --rig another" in capsys.readouterr().err
    (tmp_path / "state.json").write_text("no json")
    assert commission.main(["--rig", "shin2022", "--out", str(tmp_path), "--unattended"]) == 2
    assert "state.json" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["state.json"]
