"""Angle or torque together with stiffness: the loop on the plant, and the law at the edges."""

from __future__ import annotations

import math

import numpy as np
import pytest

from pam_antagonist.control.command import Mode, Status
from pam_antagonist.control.model_law import ModelController, ModelGains, Seen
from pam_antagonist.control.stiffness import Box
from pam_antagonist.errors import BadInput
from pam_antagonist.model import dynamics
from pam_antagonist.rig import load_rig
from pam_antagonist.simulation.plant import Plant

RIG = load_rig("shin2022")
P = RIG.parameters()
BOX = Box(200e3, 690e3, 2.0)
SEEN = Seen(0.0, 0.0, 0.0, 450e3, 450e3)


def controller(**options) -> ModelController:
    return ModelController(P, BOX, **options)


def seen_of(sample, p) -> Seen:
    angle, velocity, first, second = sample.truth[:4]
    return Seen(angle, velocity, dynamics.torque(sample.truth, p), first, second)


def run(law: ModelController, plant: Plant, mode: Mode, value: float, stiffness: float, seconds: float):
    """States (N, 4) of the plant and the statuses, the law going by the true state."""
    states, statuses = [], set()
    voltage = law.valves
    for _ in range(round(seconds * 1e3)):
        sample = plant.step(voltage)
        voltage, status = law.step(mode, value, stiffness, seen_of(sample, plant.parameters))
        states.append(sample.truth)
        statuses.add(status)
    return np.array(states), statuses


def stiffness_of(state, plant: Plant) -> float:
    return -dynamics.torque_slope(state, plant.parameters)


@pytest.mark.parametrize("mismatch", [0.0, 0.02])
def test_angle_and_stiffness_arrive_together_without_overshoot(mismatch):
    plant, law = Plant(RIG, seed=1, mismatch=mismatch, noise=False), controller()
    run(law, plant, Mode.ANGLE_STIFFNESS, math.radians(-10.0), 6.0, 3.0)
    states, _ = run(law, plant, Mode.ANGLE_STIFFNESS, math.radians(10.0), 7.0, 4.0)
    degrees = np.degrees(states[:, 0])
    assert degrees[-1] == pytest.approx(10.0, abs=0.3) and degrees.max() < 10.5
    assert np.flatnonzero(np.abs(degrees - 10.0) > 1.0)[-1] < 2500
    assert stiffness_of(states[-1], plant) == pytest.approx(7.0, rel=0.05)
    states, _ = run(law, plant, Mode.ANGLE_STIFFNESS, math.radians(10.0), 5.0, 2.0)
    assert np.degrees(states[-1, 0]) == pytest.approx(10.0, abs=0.3)
    assert stiffness_of(states[-1], plant) == pytest.approx(5.0, rel=0.05)


def test_torque_and_stiffness_arrive_together_on_a_locked_joint():
    plant, law = Plant(RIG, "locked", noise=False), controller()
    states, _ = run(law, plant, Mode.TORQUE_STIFFNESS, 1.5, 6.0, 3.0)
    assert dynamics.torque(states[-1], P) == pytest.approx(1.5, abs=0.01)
    assert stiffness_of(states[-1], plant) == pytest.approx(6.0, rel=0.01)


def test_a_known_torque_from_outside_is_taken_into_the_balance():
    law = controller()
    law.step(Mode.ANGLE, 0.0, 6.0, SEEN)
    law.step(Mode.ANGLE, 0.0, 6.0, SEEN._replace(external_torque=0.5))
    x = np.array([0.0, 0.0, law.reached.pressure_1, law.reached.pressure_2])
    assert dynamics.torque(x, P) == pytest.approx(-0.5, abs=1e-4)


@pytest.mark.parametrize("valves", [(5.5, 5.5), (2.0, 9.0)])
def test_the_first_voltages_are_those_on_the_valves_and_the_rest_fades(valves):
    law, other = controller(), controller()
    law.stop(valves)
    assert law.step(Mode.ANGLE_STIFFNESS, 0.1, 6.0, SEEN).voltage == valves
    voltages = [law.step(Mode.ANGLE_STIFFNESS, 0.1, 6.0, SEEN).voltage for _ in range(1500)]
    for _ in range(1501):
        settled = other.step(Mode.ANGLE_STIFFNESS, 0.1, 6.0, SEEN).voltage
    assert voltages[-1] == pytest.approx(settled, abs=1e-3)
    assert np.abs(np.diff(np.vstack([valves, voltages]), axis=0)).max() < 0.12


def test_retuning_and_a_change_of_mode_while_it_runs_make_no_jump():
    law = controller()
    for _ in range(2000):
        before = law.step(Mode.ANGLE_STIFFNESS, 0.05, 6.0, SEEN).voltage
    assert law.step(Mode.TORQUE_STIFFNESS, 0.5, 6.0, SEEN).voltage == before
    for _ in range(2000):
        before = law.step(Mode.TORQUE_STIFFNESS, 0.5, 6.0, SEEN).voltage
    law.retune(ModelGains(bandwidth=60.0))
    assert law.step(Mode.TORQUE_STIFFNESS, 0.5, 6.0, SEEN).voltage == before


@pytest.mark.parametrize(
    ("seen", "value", "late", "status"),
    [
        *((SEEN._replace(**{name: math.nan}), 0.0, False, Status.NOT_FINITE) for name in Seen._fields[:5]),
        (SEEN, math.nan, False, Status.BAD_REFERENCE),
        (SEEN, 0.0, True, Status.LATE),
    ],
)
def test_whatever_is_not_usable_gives_the_safe_voltages(seen, value, late, status):
    law = controller(safe_voltage=(4.0, 4.5))
    law.step(Mode.ANGLE_STIFFNESS, 0.1, 6.0, SEEN)
    assert law.step(Mode.ANGLE_STIFFNESS, value, 6.0, seen, late=late) == ((4.0, 4.5), status)
    assert law.step(None, 0.0, 6.0, SEEN) == ((4.0, 4.5), Status.NO_REFERENCE)
    assert not law.running


def test_voltages_stay_within_the_limits_whatever_is_estimated():
    law, rng = controller(), np.random.default_rng(0)
    for _ in range(2000):
        seen = Seen(*rng.normal(0.0, (1.0, 20.0, 10.0)), *rng.uniform(0.0, 1e6, 2))
        command = law.step(Mode(int(rng.integers(4))), rng.normal(0.0, 2.0), abs(rng.normal(6.0, 9.0)), seen)
        assert all(0.0 <= voltage <= 10.0 for voltage in command.voltage)


def test_an_angle_out_of_reach_winds_nothing_up():
    plant, law = Plant(RIG, noise=False), controller()
    run(law, plant, Mode.ANGLE_STIFFNESS, math.radians(24.0), 6.0, 5.0)
    assert abs(law.integral) < 0.3
    states, _ = run(law, plant, Mode.ANGLE_STIFFNESS, 0.0, 6.0, 2.5)
    assert np.degrees(states[-1, 0]) == pytest.approx(0.0, abs=0.5)


@pytest.mark.parametrize("gains", [{"bandwidth": 0.0}, {"approach": math.nan}, {"integral": -1.0}])
def test_gains_out_of_range_are_refused(gains):
    with pytest.raises(BadInput, match=f"{next(iter(gains))} .* expected"):
        ModelGains(**gains)
