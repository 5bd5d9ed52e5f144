"""The angle of the stops is an unknown where a recording reaches them, and nowhere else."""

from __future__ import annotations

import math

import numpy as np
import pytest

from pam_antagonist import Recording, Rig, identify, load_rig, simulate
from pam_antagonist.diagnosis.agreement import common_rig
from pam_antagonist.diagnosis.models import recalibrated
from pam_antagonist.diagnosis.preparation import valve_driven_experiments
from pam_antagonist.inference.trial import make_trial

TRUE = math.radians(10.0)
KEPT = ("muscle_1", "muscle_2", "valve_1", "valve_2", "gas", "supply", "joint.inertia")


def with_stop(degrees: float) -> Rig:
    return load_rig("shin2022").with_value("joint.stop", math.radians(degrees))


def recorded(middle: float, swing: float, joint: str = "free") -> Recording:
    """12 s of steps of the voltages about a middle [V]."""
    steps = np.random.default_rng(3).uniform(-1.0, 1.0, 24)
    voltage = middle + swing * np.column_stack([steps, -steps])
    rig = with_stop(10.0)
    return simulate(rig, np.repeat(voltage, round(0.5 / rig.sample_period), axis=0), joint=joint, seed=1)


@pytest.fixture(scope="module")
def against() -> Recording:
    return recorded(5.0, 4.0)


@pytest.mark.slow(6)
@pytest.mark.parametrize("declared", [9.0, 11.5])
def test_identify_finds_the_angle_of_the_stops(against: Recording, declared: float) -> None:
    found = identify(against, with_stop(declared), freeze=KEPT)
    stop = next(item for item in found.parameters if item.name == "joint.stop")
    assert stop.determined
    assert stop.value == pytest.approx(TRUE, abs=4.0 * stop.std)
    assert stop.std < math.radians(0.1)
    assert found.rig.joint.stop == stop.value


def test_a_joint_that_stays_away_from_its_stops_says_nothing_of_them() -> None:
    found = identify(recorded(5.0, 0.8), with_stop(10.0), freeze=(*KEPT, "friction"))
    assert "joint.stop" not in {item.name for item in found.parameters}
    assert found.rig.joint.stop == TRUE


def test_a_stop_that_is_frozen_stays(against: Recording) -> None:
    found = identify(against, with_stop(11.0), freeze=(*KEPT, "friction", "joint.stop"))
    assert found.rig.joint.stop == math.radians(11.0)


def test_the_base_of_a_diagnosis_has_it_too(against: Recording) -> None:
    rig, locked = with_stop(11.0), recorded(5.0, 4.0, "locked")
    trials = [make_trial(one, rig, joint, 0.0, joint) for one, joint in ((against, "free"), (locked, "locked"))]
    experiments, _ = valve_driven_experiments(trials, [], rig, 1.0 / 3.0, 0)
    base = recalibrated(experiments)
    assert common_rig(base, {}).joint.stop == pytest.approx(TRUE, abs=math.radians(0.05))
