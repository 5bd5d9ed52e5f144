"""Peers: each does what it is meant to on signals that are known, and the command continues and shows its tables."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from pam_antagonist import load_rig
from pam_antagonist.optional import available
from validation.battery.plants import Case
from validation.peers import command, joints, soft_sensors, with_model

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"


def course(seed: int, late: int = 0) -> joints.Course:
    """Pressures that move at random; the angle is a map of those of some samples ago, with noise."""
    rng = np.random.default_rng(seed)
    inputs = np.cumsum(rng.normal(size=(1500, 4)), axis=0) * 0.05 + 4.0
    before = inputs[np.maximum(np.arange(1500) - late, 0)]
    angle = 0.1 * (before[:, 0] - before[:, 1]) + 1e-3 * rng.normal(size=1500)
    return joints.Course(inputs, angle, np.ones(1500, bool), np.zeros(1500, int), 0.01)


def test_soft_sensors_learn_what_there_is() -> None:
    fit, held = [course(1, 8)], [course(2, 8)]
    errors = {}
    for name in ("linear", "lagged"):
        found = getattr(soft_sensors, name)(fit, held)
        errors[name] = float(np.std(found.angle[0] - held[0].angle)), found.numbers
    assert errors["linear"][1] == 3 and errors["lagged"][1] == 53
    assert errors["lagged"][0] < 1.3e-3 and 3.0 * errors["lagged"][0] < errors["linear"][0], errors


@pytest.mark.skipif(not available("sklearn"), reason="scikit-learn is not installed")
def test_a_gaussian_process_knows_its_error() -> None:
    found = soft_sensors.gaussian_process([course(1)], [course(1)])
    assert found.std is not None
    inside = np.abs(found.angle[0] - course(1).angle) < 1.96 * found.std[0]
    assert 0.85 < inside.mean() <= 1.0
    process = soft_sensors.Process(course(1).inputs, course(1).angle, 100)
    assert process.mean(course(2).inputs) == pytest.approx(process(course(2).inputs)[0], abs=1e-9)


@pytest.fixture(scope="module")
def free() -> joints.Joint:
    """A joint of the battery with nothing wrong."""
    recording = Case("nothing", "none", (), (), 5, ()).recording("free", 12.0)
    return joints.Joint("nothing", load_rig("shin2022"), (recording,), ((recording.slice(0.0, 2.0), 0.5),))


@pytest.mark.thorough(7)
def test_other_filters_are_near_ours(free: joints.Joint) -> None:
    ours = with_model.ours(free, free.rig)
    for how in (with_model.extended_kalman, with_model.filterpy_ukf):
        found = with_model.filtered(free, free.rig, how)
        assert found["rmse_deg"] == pytest.approx(ours["rmse_deg"], rel=0.3)
        assert found["coverage"] <= ours["coverage"]  # ours knows that the parameters are uncertain


def test_a_law_of_the_residual_equations_is_added_to_the_model(free: joints.Joint) -> None:
    seen = []

    def fitted(x: joints.Floats, y: joints.Floats) -> tuple[with_model.Law, int]:
        seen.append((x.shape, y.shape))
        return (lambda z: np.zeros((len(z), 3))), 0

    found, numbers = with_model.free_run(free, free.rig, fitted)
    assert seen == [((1199, 6), (1199, 3))] and numbers == 0
    alone = with_model.ours(free, free.rig)["alone_deg"]
    assert found["rmse_deg"] == pytest.approx(alone, abs=0.15)
    pushed, _ = with_model.free_run(free, free.rig, lambda x, y: (lambda z: np.tile([0.0, 0.2, 0.0], (len(z), 1)), 1))
    assert pushed["rmse_deg"] > found["rmse_deg"] + 0.1


@pytest.mark.skipif(not (DATA / "strangers").is_dir(), reason="the recordings at hand are not beside the project")
def test_the_command_continues_and_shows_its_tables(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--data", str(DATA), "--out", str(tmp_path / "out"), "--only", "wrist linear"]
    assert command.main(words) == 0
    entries = [json.loads(line) for line in (tmp_path / "out" / "peers.jsonl").read_text().splitlines()]
    assert [entry["part"] for entry in entries] == [None, 10.0, 20.0, 40.0, 80.0]
    assert all(0.5 < entry["rmse_deg"] < 20.0 and entry["numbers"] == 3 for entry in entries)
    assert "linear map of the two pressures" in capsys.readouterr().out
    assert command.main([*words, "--docs", str(tmp_path / "peers.md")]) == 0
    assert len((tmp_path / "out" / "peers.jsonl").read_text().splitlines()) == 5
    text = (tmp_path / "peers.md").read_text()
    assert "| the wrist |" in text and (tmp_path / "peers" / "curves.png").is_file()
    figure = command.curves_figure(entries)
    assert figure is not None and len(figure.axes) == 1


@pytest.mark.skipif(available("torch"), reason="torch is installed")
def test_networks_of_the_arm_need_torch_and_say_so(capsys: pytest.CaptureFixture[str]) -> None:
    from pam_antagonist.__main__ import main
    from validation.__main__ import COMMANDS

    assert main(["arm_networks", "none.csv"], COMMANDS) == 2
    assert "torch is not installed: pip install 'pam_antagonist[peers]'" in capsys.readouterr().err
