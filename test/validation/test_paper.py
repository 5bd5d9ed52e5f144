"""The paper's experiments: rigs whose right answer is known, and what the command writes and refuses."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest

from pam_antagonist.control.command import Mode
from pam_antagonist.control.tracking import tracking
from pam_antagonist.estimation import metrics
from pam_antagonist.model import parameters as par
from validation.paper import estimates, linear, live, model
from validation.paper.command import compared, main, write
from validation.paper.experiments import EXPERIMENTS
from validation.paper.virtual import EXACT, START, Mismatch, VirtualRig


@pytest.mark.parametrize("joint", ["free", "locked"])
def test_a_recording_is_what_the_plant_shows_step_by_step(joint):
    rig = VirtualRig(4)
    rig.actual = rig.actual.replaced(sensors=rig.actual.sensors.replaced(angle_std=0.0, torque_std=0.0))
    voltage = rig.voltage[3000:9000]  # two steps of the profile
    recording = rig.record(voltage, joint)
    plant = rig.plant(joint, noise=False)
    samples = [plant.step(row) for row in voltage]
    assert recording.angle == pytest.approx([sample.angle for sample in samples], abs=1e-9)
    assert recording.torque == pytest.approx([sample.torque for sample in samples], abs=1e-9)
    noise = recording.pressure - np.array([sample.pressure for sample in samples])
    sensors = rig.actual.sensors
    assert noise.std() == pytest.approx(np.hypot(sensors.pressure_std, sensors.pressure_step / 12**0.5), rel=0.05)
    if joint == "free":
        assert np.ptp(recording.angle) > 0.05, "the joint has to move for this to mean anything"


def test_only_the_plant_has_the_mismatches():
    rig = VirtualRig(0)
    assert rig.declared.effects == {}
    assert rig.actual.effects["hysteresis"]["amplitude_1"] > 0.0
    assert rig.declared.valve_1.curve != rig.actual.valve_1.curve != rig.actual.valve_2.curve
    true, declared = rig.plant().parameters, rig.declared.parameters()
    assert all(true[par.INDEX[name]] != declared[par.INDEX[name]] for name in ("friction.shaft", "supply.pressure"))


def test_without_mismatch_only_the_sensors_noise_is_left_and_a_mismatch_shows():
    exact, off = (estimates.offline(VirtualRig(3, size, seconds=20.0)) for size in (EXACT, None))
    sensors = VirtualRig(3).declared.sensors
    assert exact["angle, model alone, 𝕀"] == pytest.approx(math.degrees(sensors.angle_std), rel=0.5)
    assert exact["torque, model alone, 𝕀"] == pytest.approx(sensors.torque_std, rel=0.2)
    assert exact["torque, UKF, tuning default, 𝕀"] == pytest.approx(sensors.torque_std, rel=0.2)
    assert exact["angle, UKF, tuning default, NIS"] == pytest.approx(2.0, rel=0.15)
    # The published tuning takes the sensors for 17 times as noisy, and forgets that the joint sticks.
    assert exact["angle, UKF, tuning published, NIS"] < 0.02
    assert exact["angle, UKF, tuning published, 𝕀"] > 5.0 * exact["angle, UKF, tuning default, 𝕀"]
    for quantity in ("angle", "torque"):
        assert off[f"{quantity}, model alone, ℚ"] > 5.0 * exact[f"{quantity}, model alone, ℚ"]


@pytest.mark.parametrize(("amplitude", "allowed"), [(0.0, 1e-6), (3.0, 0.05)])
def test_the_static_test_gives_the_muscles_own_map_back(amplitude: float, allowed: float):
    rig = VirtualRig(5, Mismatch(amplitude=amplitude, spread=0.0))
    for which, fit in zip((1, 2), model.static_fits(rig, "linear", noise=0.0), strict=True):
        found = dict(zip(fit.names, fit.coefficients, strict=True))
        # Both ways are measured, so the loop cancels; what it leaves is seen in the residuals.
        assert found == pytest.approx(model.true_map(rig, which), rel=1e-6)
        assert fit.fitted_rmse == pytest.approx(amplitude, abs=allowed)


def test_three_steps_bring_back_a_curve_that_is_off():
    # With the curve alone off, the declared model's first step is right and the curve comes back.
    found = model.kappa(VirtualRig(2, Mismatch(parameters=0.0)))
    declared = found["error of the declared open rate, largest"]
    assert declared > 0.02 and found["error of the found open rate, largest"] < 0.1 * declared


def test_proposition_and_guideline_by_computation():
    found = model.influence(VirtualRig(0))
    assert found["steady pressures, largest change"] < 1.0
    assert found["transient parameters: steady angle, largest change"] < 1e-4
    # A joint that is thrown sticks elsewhere: what the proposition leaves out.
    assert found["transient parameters: angle after a pulse, largest change"] > 0.5
    assert found["μ_s up by half: size of the steady ψ"] < -0.2
    assert found["A_0 up by half: time of ψ to 90 %"] < -1.0


def test_the_loop_in_one_process_follows_torque():
    wanted, measured, estimated = live.closed_loop(VirtualRig(1, EXACT), Mode.TORQUE, "default")
    steps, seconds = live.references(Mode.TORQUE)
    assert len(wanted) == round(seconds * 1000)
    assert sorted(set(wanted)) == sorted({value for _, value in steps})
    stamps = np.arange(len(wanted), dtype=np.int64) * 1_000_000
    assert tracking(stamps, wanted, measured).performance > 0.98
    assert np.sqrt(np.mean((estimated - measured) ** 2)) < 0.015


def linear_joint(seconds: float, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Angle [°], pressures [Pa] and voltages [V] at 1 kHz of a linear joint: first-order muscles, a lagging angle."""
    rng = np.random.default_rng(seed)
    count = round(seconds * 1000)
    voltage = np.repeat(rng.uniform(4.5, 6.5, (count // 500, 2)), 500, axis=0)
    pressure, angle = np.full((count, 2), 450e3), np.zeros(count)
    lag = np.array([1.0 / 800.0, 1.0 / 500.0])
    for k in range(1, count):
        wanted = 450e3 + 1e5 * (voltage[k] - 5.5)
        pressure[k] = pressure[k - 1] + lag * (wanted - pressure[k - 1])
        toward = 1e-4 * (pressure[k, 0] - pressure[k, 1]) + 0.05 * rng.standard_normal() * 10.0
        angle[k] = angle[k - 1] + (toward - angle[k - 1]) / 100.0
    return angle, pressure + 600.0 * rng.standard_normal(pressure.shape), voltage


def test_a_linear_joint_is_found_and_estimated_from_pressures_alone():
    found = linear.identify(*linear_joint(60.0, 1))
    angle, pressure, voltage = linear_joint(30.0, 2)
    error = (linear.estimate(found, pressure, voltage) - angle)[3000:]
    assert metrics.rmse(error) < 0.02 * np.ptp(angle)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("paper") / "out"
    assert main(["--out", str(out), "--seeds", "3", "--seed", "7", "--jobs", "1", "--only", "static", "influence"]) == 0
    return out


def test_page_and_numbers_are_written(written: Path) -> None:
    assert sorted(path.name for path in written.iterdir()) == ["paper.md", "report.json"]
    report = json.loads((written / "report.json").read_text(encoding="utf-8"))
    assert list(report["experiments"]) == ["static", "influence"] and report["seeds"] == [7, 8, 9]
    static = report["experiments"]["static"]
    assert len({one["declared map"] for one in static["of_seed"].values()}) == 3, "one rig a seed"
    assert list(report["experiments"]["influence"]["of_seed"]) == ["7"]
    (row, *_) = static["beside_the_paper"]
    assert row["what"] == "fitted map" and row["min"] <= row["median"] <= row["max"] and row["paper"] is None
    text = (written / "paper.md").read_text(encoding="utf-8")
    assert "## Static characteristics" in text and "| fitted map |" in text and "## Proposition 1" in text


@pytest.mark.slow(4)
def test_every_row_of_the_table_is_a_number_that_its_experiment_gives(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import pandas as pd

    short = VirtualRig(0, seconds=70.0)
    for name in ("profile", "offline"):
        names = {value for row in EXPERIMENTS[name].rows for value in row.names}
        assert names <= set(EXPERIMENTS[name].of_seed(short))
    values = pd.DataFrame([EXPERIMENTS["offline"].of_seed(short)], index=[0])
    table = compared(values, EXPERIMENTS["offline"].rows)
    assert table.rows[0][0] == "angle, model alone, 𝕀, 𝕄, ℚ" and table.rows[0][2] == "1.053°, 3.5°, 8.87 %"
    assert len(EXPERIMENTS["offline"].said(values)) == 2
    monkeypatch.setattr("validation.paper.virtual.VirtualRig", lambda seed: short)
    write({"offline": values}, [0], {}, tmp_path, figures=True)
    shown = re.findall(r"^!\[.+\]\((.+)\)$", (tmp_path / "paper.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert len(shown) == 2 and all((tmp_path / place).read_bytes().startswith(b"\x89PNG") for place in shown)


@pytest.mark.thorough(11)
@pytest.mark.ros
@pytest.mark.realtime
def test_the_live_estimate_is_the_replayed_one(tmp_path: Path) -> None:
    pytest.importorskip("rclpy", reason="ROS 2 is not installed")
    rig, seconds = VirtualRig(0, seconds=6.0), 6.0
    recording = live.estimation(rig, tmp_path / "live", "free", seconds)
    assert recording.duration_s > seconds - 0.5
    # From its first command on the profile was on the valves: the same steps as in the virtual rig's own recording.
    profile = rig.voltage[:, 0]
    driven = recording.voltage[np.argmax(recording.voltage[:, 0] == profile[0]) :, 0]
    assert np.unique(driven) == pytest.approx(np.unique(profile))
    assert recording.pressure[0] == pytest.approx(START, abs=5e3)
    found = live.judge(recording, rig.declared, "angle", "free")
    assert found["estimates that a replay repeats bit by bit"] == 1.0 and found["samples"] > 1000 * (seconds - 1.0)
    assert 0.0 < found["time of a filter's step, mean"] < 1.0
    assert not any(tmp_path.iterdir()), "bags are removed"
