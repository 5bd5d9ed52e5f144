"""``external_torque``: its figures are those of known courses, and the command writes them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from validation.pushes import trial
from validation.pushes.command import main


def test_figures_are_those_of_a_known_estimate() -> None:
    applied = trial.pushes(20_000, 1e-3, np.random.default_rng(1))
    assert 0.1 <= np.abs(applied[applied != 0.0]).min() and np.abs(applied).max() <= 1.5
    late = np.concatenate([np.zeros(30), applied[:-30]])
    found = trial.errors([trial.Run(applied, late, np.full(len(applied), 0.1), 1e-3)])
    assert found["delay_s"] == pytest.approx(0.03)
    assert found["rmse_nm"] == pytest.approx(float(np.sqrt(np.mean((late - applied) ** 2))))
    assert found["coverage95"] == pytest.approx(np.mean(np.abs(late - applied) < 0.196))
    small = trial.small_pushes(20_000, 1e-3, np.random.default_rng(2))
    seen = trial.Run(small, np.concatenate([np.zeros(40), small[:-40]]), small, 1e-3)
    quiet = trial.largest(trial.Run(0.0 * small, np.full(len(small), 0.2), small, 1e-3))
    assert len(quiet) == 20
    found = trial.detection([seen], [quiet])
    assert found["threshold_nm"] == 0.2 and found["seen"] == 1.0 and found["median_s"] == pytest.approx(0.04)
    assert trial.detection([seen], [quiet + 0.2])["median_s"] == np.inf


def test_the_threshold_is_exceeded_once_an_hour() -> None:
    seconds = np.random.default_rng(3).permutation(np.linspace(0.0, 0.2, 2 * 3600 + 100))
    small = trial.small_pushes(5000, 1e-3, np.random.default_rng(2))
    found = trial.detection([trial.Run(small, small, small, 1e-3)], [seconds[:5000], seconds[5000:]])
    assert found["alarms"] == 2.0 == np.sum(seconds > found["threshold_nm"])


def test_the_command_writes_its_figures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "figures.json"
    assert main(["--seeds", "1", "--seconds", "5", "--jobs", "1", "--json", str(file)]) == 0
    assert "with an encoder" in capsys.readouterr().out
    figures = json.loads(file.read_text())["figures"]
    assert figures["encoder"]["rmse_nm"] < 0.25 and figures["encoder"]["coverage95"] > 0.8
    assert main(["--rig", "shin2022"]) == 2
    assert "does not have the state" in capsys.readouterr().err
