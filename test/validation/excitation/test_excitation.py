"""``excitation``: the comparison is made on joints that differ from the rig file, and its figures can be read again."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from validation.excitation.command import main


def test_a_joint_is_compared_and_the_figures_are_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    figures = tmp_path / "figures.json"
    assert main(["--joints", "1", "--seed", "4", "--duration", "9", "--json", str(figures)]) == 0
    said = capsys.readouterr().out
    assert "limits kept by 1 of 1 joints" in said
    (found,) = json.loads(figures.read_text())
    assert found["seed"] == 4
    assert set(found["ratio"]) == set(found["steps"]) and "friction.shaft" in found["ratio"]
    assert all(0.0 < share <= 1.0 for share in (*found["designed"].values(), *found["steps"].values()))
    assert found["ratio"]["joint.inertia"] < 1.0
