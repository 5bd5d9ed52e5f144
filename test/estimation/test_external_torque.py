"""The torque from outside: what the filter claims to know of it, and what an encoder adds."""

from __future__ import annotations

import dataclasses
import math
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from pam_antagonist.api.simulate import simulate
from pam_antagonist.errors import BadInput
from pam_antagonist.estimation import EstimateRun, Estimator
from pam_antagonist.recording import Recording
from pam_antagonist.rig import Rig, load_rig
from pam_antagonist.simulation.plant import Plant

RIG = load_rig("shin2022_external_torque")
PLAIN = load_rig("shin2022")
PRIOR = RIG.effects["external_torque"]["prior"]


@cache
def driven(kind: str, seconds: float = 6.0, pushed: float = 0.0) -> Recording:
    """A joint 1 % off its rig whose valves are still, or swing by 2.5 V against each other; pushed in the middle."""
    count = round(seconds * 1000)
    swing = 2.5 * np.sin(2.0 * math.pi * 0.4 * np.arange(count) / 1000.0) if kind == "moving" else np.zeros(count)
    voltage = 5.5 + np.column_stack([swing, -swing])
    external = np.zeros(count)
    external[count // 2 : count // 2 + 700] = pushed
    plant = Plant(RIG, seed=4, mismatch=0.01)
    samples = [plant.step(u, d) for u, d in zip(voltage, external, strict=True)]
    made = simulate(RIG, voltage[:2], seed=4)
    return dataclasses.replace(
        made, stamp_ns=made.stamp_ns[0] + 1_000_000 * np.arange(count),
        pressure=np.array([one.pressure for one in samples]), voltage=voltage,
        angle=np.array([one.truth[0] for one in samples]), torque=None,
        angle_sensor=np.array([one.encoder for one in samples]), external_torque=external,
    )  # fmt: skip


def run(rig: Rig, recording: Recording, angle_sensor: str = "none", joint: str = "free") -> EstimateRun:
    estimator = Estimator(rig, joint=joint, angle_sensor=angle_sensor)
    return estimator.run(recording.stamp_ns, recording.pressure, recording.voltage, recording.angle_sensor)


def std(done: EstimateRun) -> np.ndarray:
    return np.sqrt(done.rows["external_torque_covariance"][:, 3])


def test_what_is_not_observable_grows_to_its_prior_and_stays_there() -> None:
    """A locked joint shows nothing of it at all: from any start to the prior, and never beyond."""
    quick = RIG.effects["external_torque"] | {"noise": 3.0}  # T = 0.11 s
    prior = quick["prior"]
    for known in (0.1 * prior, 3.0 * prior):
        rig = RIG.replaced(effects={"external_torque": quick})
        q = prior**2 * -math.expm1(-((quick["noise"] / prior) ** 2) * rig.sample_period)
        tuning = rig.tunings["default"].replaced(states={"external_torque": (known**2, q)})
        done = std(run(rig.replaced(tunings={"default": tuning}), driven("still"), joint="locked"))
        assert done[0] == pytest.approx(known)
        assert np.all(np.diff(done) * np.sign(prior - known) >= -1e-12)
        np.testing.assert_allclose(done[2000:], prior, rtol=1e-3)


def test_pressures_tell_it_while_the_joint_moves_and_not_at_rest() -> None:
    """Proposition 1: with both valves open, steady pressures do not depend on the joint."""
    at_rest, moving = std(run(RIG, driven("still")))[-1], std(run(RIG, driven("moving")))[-1]
    assert 0.9 * PRIOR < at_rest < 1.001 * PRIOR
    assert moving < 0.4 * PRIOR


def test_sealed_chambers_tell_it_at_rest() -> None:
    rig = load_rig("sealed_joint")
    noise = rig.effects["external_torque"]["noise"]
    effects = rig.effects | {"external_torque": {"noise": noise, "prior": 2.0}}
    charge = np.array([rig.valves.charge_1, rig.valves.charge_2])
    stamps = 1_000_000 * np.arange(1, 3001)
    done = Estimator(rig.replaced(effects=effects)).run(stamps, np.tile(charge, (3000, 1)), np.full((3000, 2), 5.0))
    assert std(done)[-1] < 0.3


def test_without_a_prior_it_is_the_random_walk_of_before() -> None:
    rig = PLAIN.replaced(effects={"external_torque": {"noise": 0.3}})
    locked = std(run(rig, driven("still"), joint="locked"))
    t = 1e-3 * np.arange(len(locked))
    np.testing.assert_allclose(locked**2, 0.2**2 + 0.3**2 * t, rtol=1e-9)


def test_a_push_that_sets_in_is_found_within_milliseconds_and_nobody_is_no_push() -> None:
    """By pressures alone. Without an onset, a random walk as quick as that takes the joint's own motion for a push."""
    rig = RIG.replaced(effects={"external_torque": {"noise": 1.0, "prior": PRIOR}})
    quiet, pushed = driven("moving"), driven("moving", pushed=0.8)
    assert pushed.external_torque is not None
    worst = {}
    for name, one in (("onset", RIG), ("walk", rig)):
        alone = run(one, quiet).rows["external_torque"][1000:]
        worst[name] = float(np.abs(alone).max())
    assert worst["onset"] < 0.25 < worst["walk"], worst
    done = run(RIG, pushed)
    edges = np.flatnonzero(np.diff(pushed.external_torque)) + 1
    for edge in edges:
        found = done.rows["external_torque"][edge + 30 : edge + 300]
        np.testing.assert_allclose(found, pushed.external_torque[edge], atol=0.2)
    locked = run(RIG, pushed, joint="locked")
    np.testing.assert_array_equal(locked.rows["covariance"][:, 1, 1], 0.0)


@pytest.mark.thorough(18)
def test_an_encoder_tells_a_push_and_the_angle() -> None:
    recording = driven("moving", pushed=0.8)
    assert recording.external_torque is not None and recording.angle is not None
    blind, seeing = run(RIG, recording), run(RIG, recording, "encoder")
    for done, angle, torque in ((blind, 1.5, 0.25), (seeing, 0.05, 0.12)):
        error = done.rows["external_torque"] - recording.external_torque[done.index]
        late = np.flatnonzero(done.rows["external_torque"][3000:] > 0.4)[0]
        assert late < 50, "samples until half of the push is seen"
        assert np.sqrt(np.mean(error[500:] ** 2)) < torque
        assert np.mean(np.abs(error[500:]) < 1.96 * std(done)[500:]) > 0.9
        assert math.degrees(np.sqrt(np.mean((done.rows["angle"] - recording.angle) ** 2))) < angle
    assert seeing.counts.angles_used > 0.99 * len(recording)


def test_without_the_sensor_a_reading_changes_no_bit() -> None:
    recording = driven("moving", pushed=0.8)
    without = Estimator(RIG).run(recording.stamp_ns, recording.pressure, recording.voltage)
    assert run(RIG, recording).rows.tobytes() == without.rows.tobytes()


def test_missing_readings_are_flagged_and_predicted_over() -> None:
    recording = driven("moving")
    angle = recording.angle_sensor.copy()
    angle[2000:2200] = np.nan
    done = run(RIG, dataclasses.replace(recording, angle_sensor=angle), "encoder")
    flagged = (done.rows["flags"].astype(int) & 128) != 0
    assert np.array_equal(np.flatnonzero(flagged), np.arange(2000, 2200))
    whole = run(RIG, recording, "encoder")
    variance = done.rows["covariance"][:, 0, 0]
    assert variance[2199] > 5.0 * whole.rows["covariance"][2199, 0, 0]
    assert variance[2300] == pytest.approx(whole.rows["covariance"][2300, 0, 0], rel=0.2)


def faulty(kind: str, recording: Recording) -> np.ndarray:
    angle = recording.angle_sensor.copy()
    if kind == "spike":
        angle[2000:2005] += 0.2
    elif kind == "jump":
        angle[2000:] += 0.2
    elif kind == "frozen":
        angle[2000:] = angle[2000]
    elif kind == "frozen with a step":
        angle = np.round(angle / 1e-3) * 1e-3
        angle[2000:] = angle[2000]
    elif kind == "wrong sign":
        angle = -angle
    return angle


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("none", ""), ("spike", ""), ("jump", "jumped by +11.5°"), ("frozen", "frozen"),
        ("frozen with a step", "frozen"), ("wrong sign", "publish the negative angle"),
    ],
)  # fmt: skip
def test_a_faulty_encoder_is_refused_and_the_estimate_goes_on(kind: str, words: str) -> None:
    recording = driven("moving", 8.0)
    rig = RIG
    if kind == "frozen with a step":
        rig = RIG.replaced(encoder=RIG.encoder.replaced(step=1e-3))
    estimator = Estimator(rig, angle_sensor="encoder")
    done = estimator.run(recording.stamp_ns, recording.pressure, recording.voltage, faulty(kind, recording))
    assert words in estimator.encoder_complaint and bool(words) == bool(estimator.encoder_complaint)
    error = np.degrees(done.rows["angle"] - recording.angle)[6500:]
    assert np.sqrt(np.mean(error**2)) < (1.5 if words else 0.05)
    if words:
        estimator.reset()
        assert estimator.encoder_complaint == ""


@pytest.mark.parametrize("swing", [0.0, 1.5])
def test_a_joint_that_is_held_is_no_frozen_encoder(swing: float) -> None:
    """Its angle does not change while the muscles pull: the pressures show that it stands."""
    rig = RIG.replaced(encoder=RIG.encoder.replaced(std=0.0, step=1e-3))
    plant = Plant(rig, "locked", 0.05, seed=3, mismatch=0.02)
    u = 5.5 + swing * np.sign(np.sin(2.0 * math.pi * 0.5 * np.arange(6000) / 1000.0))[:, None] * np.array([1.0, -1.0])
    samples = [plant.step(voltage) for voltage in u]
    estimator = Estimator(rig, angle_sensor="encoder")
    stamps = 1_000_000 * np.arange(1, 6001)
    estimator.run(stamps, np.array([s.pressure for s in samples]), u, np.array([s.encoder for s in samples]))
    assert estimator.encoder_complaint == ""


def test_a_checkpoint_holds_what_is_known_of_the_encoder() -> None:
    recording = driven("moving", 8.0)
    angle = faulty("wrong sign", recording)
    inputs = (recording.stamp_ns, recording.pressure, recording.voltage, angle)
    whole = Estimator(RIG, angle_sensor="encoder")
    rows = whole.run(*inputs).rows
    for at in (700, 6000):  # before and after it is refused
        first, second = Estimator(RIG, angle_sensor="encoder"), Estimator(RIG, angle_sensor="encoder")
        first.run(*(part[:at] for part in inputs))
        checkpoint = first.checkpoint()
        assert checkpoint is not None
        second.restore(checkpoint)
        assert second.run(*(part[at:] for part in inputs)).rows.tobytes() == rows[at:].tobytes()
        with pytest.raises(BadInput, match="other values"):
            Estimator(RIG).restore(checkpoint)


def test_bad_input_is_refused_in_words(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="expected one of none, encoder"):
        Estimator(RIG, angle_sensor="imu")
    with pytest.raises(BadInput, match="shin2022 has no encoder in its file; write into it"):
        Estimator(PLAIN, angle_sensor="encoder")
    rig_file = tmp_path / "rig.yaml"
    rig_file.write_text("based_on: shin2022\nname: pushed\neffects: {external_torque: {noise: 0.1, onset: 5.5}}\n")
    with pytest.raises(BadInput, match="is given without a prior: expected prior as well"):
        load_rig(rig_file)
