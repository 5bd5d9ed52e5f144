"""What is kept on disk of an interrupted diagnosis."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pam_antagonist.diagnosis.checkpoint import Checkpoint, Kept
from pam_antagonist.inference.point import Point


def test_a_finished_candidate_is_found_again(tmp_path: Path) -> None:
    checkpoint = Checkpoint(tmp_path / "kept")
    point = Point(np.array([0.1, -0.2]), {"effects.leak.area_1": 1e-9})
    checkpoint.save("a", Kept(point, 50.0, 12.5))
    found = checkpoint.load("a")
    assert found is not None
    assert found.point.theta.tolist() == [0.1, -0.2]
    assert found.point.effects == point.effects
    assert (found.blocks_per_error, found.gain) == (50.0, 12.5)
    assert checkpoint.load("b") is None


@pytest.mark.parametrize("text", ["", "{", "{}", "[1]", '{"theta": [1], "effects": {}, "blocks_per_error": 1}'])
def test_a_damaged_file_is_worked_out_anew(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.json").write_text(text)
    assert Checkpoint(tmp_path).load("a") is None


def test_nothing_is_kept_without_a_folder() -> None:
    Checkpoint().save("a", Kept(Point(np.zeros(1)), 1.0, 0.0))
    assert Checkpoint().load("a") is None
