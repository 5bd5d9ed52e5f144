"""One driver: what commands make a joint do is found again where pressures or the motion are given in their place."""

from __future__ import annotations

import numpy as np
import pytest

from pam_antagonist.model import dynamics, lanes
from pam_antagonist.model import parameters as par
from pam_antagonist.model.drive import IMBALANCE, NEEDED, TORQUE, Inputs
from pam_antagonist.model.equilibrium import initial_state
from pam_antagonist.rig.file import load_rig

SAMPLES, PERIOD = 4000, 1e-3
TIME = np.arange(SAMPLES) * PERIOD
EFFECTS = {
    "plain": {},
    "a memory in the air": {"effects.thermal.share_1": 0.4, "effects.supply_droop.stiffness": 1e7},
    "a memory in the joint": {"effects.creep.share_1": 0.1, "effects.hysteresis.amplitude_2": 3.0},
}


@pytest.fixture(autouse=True)
def _whatever_the_processor(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lanes are tried on every machine, also where they are no quicker."""
    monkeypatch.setattr("pam_antagonist.model.drive.FEWEST", 2)


@pytest.fixture(params=EFFECTS, scope="module")
def p(request: pytest.FixtureRequest) -> np.ndarray:
    return par.changed(load_rig("shin2022").parameters(), EFFECTS[request.param])


@pytest.fixture(scope="module")
def moved(p: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Commands, and the states and torques that they lead to."""
    steps = np.random.default_rng(4).normal(0.0, 0.8, (SAMPLES // 400, 2))
    slow = np.column_stack([np.interp(TIME, TIME[::400], column) for column in steps.T])
    command = 5.5 + slow
    x = initial_state(0.05, 4e5, 4e5, command[0], p)
    states, (torque, _) = Inputs.even(SAMPLES, PERIOD, command=command).driven(x[None], p, TORQUE)
    return command, states, torque


def test_measured_pressures_move_the_joint_as_the_commands_did(p, moved) -> None:
    _, states, _ = moved
    along = Inputs.even(SAMPLES, PERIOD, pressure=states[:, 2:4])
    found = along.driven(states[:1], p)[0]
    assert np.ptp(states[:, 0]) > 0.1
    assert np.abs(found[:, 0] - states[:, 0]).max() < 1e-4
    assert np.array_equal(found[:, 2:4], states[:, 2:4])


def test_commands_along_the_measured_motion_fill_the_chambers_as_they_did(p, moved) -> None:
    command, states, _ = moved
    along = Inputs.even(SAMPLES, PERIOD, command=command, motion=states[:, :1])
    found = along.driven(states[:1], p)[0]
    assert np.ptp(states[:, 2]) > 5e4
    assert np.abs(found[:, 2:4] - states[:, 2:4]).max() < 20.0


def test_readings_that_scatter_about_a_stop_pump_no_air(p) -> None:
    stopped = par.changed(p, {"joint.stop": 0.2})
    closed = np.full((SAMPLES, 2), 5.0)
    scatter = np.random.default_rng(1).normal(0.0, 5e-4, SAMPLES)

    def last(angle: np.ndarray) -> np.ndarray:
        along = Inputs.even(SAMPLES, PERIOD, command=closed, motion=angle[:, None])
        start = along.settled(angle[:1], np.array([[4e5, 3e5]]), stopped)
        return along.driven(start, stopped)[0][-100:, 2:4].mean(axis=0)

    for middle in (0.2, 0.21):
        still = last(np.full(SAMPLES, middle))
        assert np.abs(last(middle + scatter) - still).max() < 200.0


def test_pressures_and_motion_give_the_torque_and_no_torque_is_missing(p, moved) -> None:
    command, states, torque = moved
    acceleration = np.gradient(states[:, 1], PERIOD)
    motion = np.column_stack([states[:, :2], acceleration, np.sign(states[:, 1])])
    given = Inputs.even(SAMPLES, PERIOD, command=command, pressure=states[:, 2:4], motion=motion)
    shown = given.driven(states[:1], p, TORQUE | NEEDED)[1]
    assert np.abs(shown[0] - torque).max() < 2e-3 * np.ptp(torque)
    imbalance = given.driven(states[:1], p, IMBALANCE)[1][1]
    slides = np.abs(states[:, 1]) > 0.05
    assert slides.sum() > 500
    for left in (shown[1], imbalance):
        # Where the joint turns round, differences of the velocity do not tell its acceleration.
        assert np.quantile(np.abs(left[slides]), 0.9) < 0.01 * np.ptp(torque)
    # A torque from outside that nobody told is what is missing.
    pushed = np.column_stack([command, np.full(SAMPLES, 0.05)])
    states = Inputs.even(SAMPLES, PERIOD, command=pushed).driven(states[:1], p)[0]
    motion = np.column_stack([states[:, :2], np.gradient(states[:, 1], PERIOD), np.sign(states[:, 1])])
    along = Inputs.even(SAMPLES, PERIOD, command=command, motion=motion)
    needed = along.driven(states[:1], p, NEEDED)[1][1]
    assert np.median(needed[np.abs(states[:, 1]) > 0.05]) == pytest.approx(0.05, rel=0.02)


def test_parts_begin_anew_and_what_effects_remember_goes_on_where_it_is_told(p, moved) -> None:
    command, states, _ = moved
    first = np.array([0, 1500, SAMPLES])
    whole = Inputs.even(SAMPLES, PERIOD, command=command)
    parts = Inputs(whole.length, first, command=command, longest=PERIOD)
    begin = states[first[:-1]]
    alone = Inputs.even(SAMPLES - 1500, PERIOD, command=command[1500:]).driven(begin[1:], p)[0]
    found = parts.driven(begin, p)[0]
    assert np.array_equal(found[:1500], states[:1500]) and np.array_equal(found[1500:], alone)
    other = begin.copy()
    other[1, 4:] += 0.1
    kept, fresh = (parts.driven(other, p, keeps=np.array([False, keeps]))[0][1500] for keeps in (True, False))
    assert np.array_equal(kept[:4], begin[1, :4]) and np.array_equal(fresh, other[1])
    # as in one piece: 20 ms of a regulator's rate that were forgotten at each restart were up to 30 kPa
    assert np.array_equal(kept[4:], states[1500, 4:])


@pytest.mark.parametrize("given", [("command",), ("pressure",), ("command", "motion"), ("pressure", "motion")])
def test_many_models_side_by_side_have_the_bits_of_each_alone(p, moved, given) -> None:
    command, states, _ = moved
    motion = np.column_stack([states[:, :2], np.gradient(states[:, 1], PERIOD), np.round(states[:, 1], 1)])
    columns = {"command": command, "pressure": states[:, 2:4], "motion": motion}
    first = np.array([0, 700, 701, 3001, SAMPLES])
    along = Inputs(
        np.full(SAMPLES, PERIOD), first, longest=PERIOD / 2, signals=np.column_stack([np.sin(TIME)]),
        **{name: columns[name] for name in given},
    )  # fmt: skip
    vectors = [par.changed(p, {"joint.inertia": 4e-4 * (1 + 0.1 * k), "muscle_1.force.v1": 0.01 * k}) for k in range(5)]
    begin = first[:-1]
    starts = [along.settled(states[begin, 0] + 0.01 * k, states[begin, 2:4], q) for k, q in enumerate(vectors)]
    keeps = np.array([False, True, False, True])
    for wanted in (0, TORQUE, *([NEEDED, TORQUE | IMBALANCE] if "motion" in given else [])):
        for k, (found, shown) in enumerate(along.driven_each(starts, vectors, wanted, keeps)):
            alone, torques = along.driven(starts[k], vectors[k], wanted, keeps)
            assert np.array_equal(found, alone) and np.array_equal(shown, torques)
    assert lanes.possible()


def test_a_joint_without_commands_rests_as_under_commands_of_zero() -> None:
    """A regulator's states are those of its command: what is not given must not be read from anywhere."""
    p = load_rig("shin2022_regulators", regulators=True).parameters()
    pressure = np.full((3, 2), 4e5)
    alone = Inputs.even(3, PERIOD, pressure=pressure)
    beside = Inputs.even(3, PERIOD, pressure=pressure, command=np.zeros((3, 2)))
    rested = [one.settled(np.array([0.1]), pressure[:1], p) for one in (alone, beside)]
    assert rested[0].shape[1] > 4 and np.array_equal(*rested)


def test_a_recording_at_uneven_times_takes_steps_that_are_short_enough(p, moved) -> None:
    """Rows left out where a joint rests change nothing but the rounding."""
    command, states, _ = moved
    held = np.tile(command[0], (SAMPLES, 1))
    x = initial_state(0.05, 4e5, 4e5, held[0], p)
    every = np.flatnonzero((np.arange(SAMPLES) % 10 == 0) | (np.arange(SAMPLES) < 100))
    fine = Inputs.even(SAMPLES, PERIOD, command=held).driven(x[None], p)[0]
    coarse = Inputs.at(TIME[every], PERIOD, command=held[every]).driven(x[None], p)[0]
    assert coarse == pytest.approx(fine[every], rel=1e-6, abs=1e-9)
    assert dynamics.torque(coarse[-1], p) == pytest.approx(dynamics.torque(fine[every[-1]], p), rel=1e-6)
