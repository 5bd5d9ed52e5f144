"""Fresh rigs judge identify: what is counted, and by which interval."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from pam_antagonist.identification.unknowns import Fit, Unknown
from validation.rigs import fresh, judge


def test_only_values_that_are_called_determined_are_compared_with_the_true_ones() -> None:
    unknown = tuple(Unknown(name, (name,), 2.0, 0.5, low=-1.0) for name in ("known", "wide", "bound", "untrue"))
    amounts = np.array([1.0, 0.5, -5.0, 1.0])
    fit = Fit(unknown, amounts, np.diag([0.01, 0.9, 0.01, 0.01]), 0.0)
    truth = {"known": 2.4, "wide": 2.0, "bound": -1.0}
    assert judge.compared(fit, truth) == {"known": pytest.approx(-2.0)}


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Laboratories that record a second only."""
    monkeypatch.setattr(fresh, "sets", lambda recorded, trials: ([recorded(1.0, 0)], []))


@pytest.mark.usefixtures("short")
def test_a_fresh_rig_has_true_values_that_its_file_does_not_know() -> None:
    lab = fresh.laboratory(202, declared=True)
    again = fresh.laboratory(202, declared=True)
    assert lab.truth == again.truth
    assert np.array_equal(lab.fit[0].pressure, again.fit[0].pressure)
    assert lab.truth["joint.inertia"] != lab.typed.joint.inertia
    assert all(math.isfinite(value) for value in lab.truth.values())
    assert "hysteresis" not in lab.name


@pytest.mark.usefixtures("short")
def test_the_command_counts_a_rig_that_is_refused(tmp_path: Path, monkeypatch, capsys) -> None:
    def refused(lab: fresh.Laboratory) -> dict[str, str]:
        return {"name": lab.name, "refused": "it moves too little"}

    monkeypatch.setattr(judge, "judged", refused)
    assert judge.main(["--out", str(tmp_path / "out.json"), "--first", "202", "--count", "1", "--declared"]) == 0
    assert json.loads((tmp_path / "out.json").read_text())[0]["refused"] == "it moves too little"
    assert "0 rigs of 1" in capsys.readouterr().out
