"""A designed excitation tells more than steps, and keeps its limits on a joint that is not quite the declared one."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from pam_antagonist.cli import excite
from pam_antagonist.design import Limits, Plan, designed, standard_errors
from pam_antagonist.errors import BadInput
from pam_antagonist.rig import Rig, load_rig
from pam_antagonist.rig.physical import steady_voltage
from pam_antagonist.simulation import excitation
from pam_antagonist.simulation.plant import Plant

Floats = NDArray[np.float64]


@pytest.fixture(scope="module")
def rig() -> Rig:
    return load_rig("shin2022")


@pytest.fixture(scope="module")
def plan(rig: Rig) -> Plan:
    return designed(rig, Limits.of(rig), 12.0, seed=1)


def truth(rig: Rig, plan: Plan, seed: int) -> Floats:
    """Angle, rate and pressures (N, 4) of a joint a per cent off the declared one."""
    plant = Plant(
        rig, plan.joint, plan.lock_angle, seed, 1, mismatch=0.01, initial_pressure=(plan.pressure, plan.pressure)
    )
    return np.array([plant.step(voltage).truth[:4] for voltage in plan.voltage])


def test_standard_errors_are_well_below_those_of_steps_over_the_same_pressures(rig: Rig, plan: Plan) -> None:
    low, high = (steady_voltage(rig, pressure)[0] for pressure in plan.limits.pressure)
    steps = excitation.profile(
        "steps", plan.duration, plan.period, 1, excitation.DriveVoltages(low, plan.rest[0], high)
    )
    mine, theirs = (standard_errors(rig, voltage, plan.period) for voltage in (plan.voltage, steps))
    assert np.median([mine[name] / theirs[name] for name in mine]) < 0.7


def test_limits_are_kept_by_joints_that_differ(rig: Rig, plan: Plan) -> None:
    for seed in (1, 2):
        course = truth(rig, plan, seed)
        assert plan.limits.excess(course) == 0.0
        # It is no rest either: a good part of the range is used.
        assert np.ptp(course[:, 0]) > 0.5 * plan.limits.angle
        assert np.ptp(course[:, 2]) > 0.5 * np.ptp(plan.limits.pressure)


def test_narrow_limits_make_a_narrow_experiment(rig: Rig) -> None:
    limits = Limits.of(rig, pressure=(300e3, 600e3), angle=math.radians(8.0))
    narrow = designed(rig, limits, 8.0, seed=1)
    assert limits.excess(truth(rig, narrow, 1)) == 0.0


def test_a_locked_joint_has_a_plan_of_its_own(rig: Rig) -> None:
    locked = designed(rig, Limits.of(rig), 12.0, "locked", 0.1)
    course = truth(rig, locked, 1)
    assert np.allclose(course[:, 0], 0.1)
    assert np.ptp(course[:, 2]) > 0.5 * np.ptp(locked.limits.pressure)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"pressure": (50e3, 600e3)}, "expected absolute ones"),
        ({"pressure": (500e3, 400e3)}, "the lower first"),
        ({"angle": 1.0}, "expected above 0, to 25.0 deg"),
        ({"rate": 0.0}, "expected above 0"),
    ],
)
def test_limits_that_no_joint_has_are_refused(rig: Rig, changes: dict[str, float], words: str) -> None:
    with pytest.raises(BadInput, match=words):
        Limits.of(rig, **changes)  # type: ignore[arg-type]


def test_a_rig_file_that_leaves_all_open_is_refused_with_what_to_do(rig: Rig) -> None:
    unknown = rig.replaced(uncertainty={"muscle_1.force.w2": 60.0})
    with pytest.raises(BadInput, match="expected wider limits, or a rig file with smaller uncertainties"):
        designed(unknown, Limits.of(rig, angle=math.radians(5.0)), 6.0)


def test_what_the_directions_of_a_rig_file_do_not_name_is_as_uncertain_as_before(rig: Rig) -> None:
    """A direction of one valve says nothing about force maps: their priors still count."""
    open_maps = rig.replaced(uncertainty={})
    one = open_maps.replaced(directions={"valve": {"valve_1.inflow_area": 1e-10}})
    for unknown in (open_maps, one):
        with pytest.raises(BadInput, match="expected wider limits, or a rig file with smaller uncertainties"):
            designed(unknown, Limits.of(rig), 6.0)


def test_what_is_measured_beyond_a_limit_is_said(rig: Rig) -> None:
    limits = Limits.of(rig, pressure=(200e3, 600e3), angle=math.radians(10.0))
    assert limits.broken(np.array([599e3, 102e3]), math.radians(-9.9)) == ""
    assert "pressure 2 is 610 kPa, above the limit of 600 kPa" in limits.broken(np.array([300e3, 610e3]), 0.0)
    assert "+11.0 deg, beyond the limit of 10.0 deg" in limits.broken(np.array([300e3, 300e3]), math.radians(11.0))
    assert limits.broken(np.array([math.nan, 300e3]), math.nan) == ""


def test_the_plan_is_a_table_that_simulate_takes(tmp_path: Path) -> None:
    out = tmp_path / "excited"
    assert excite.main(["--rig", "shin2022", "--out", str(out), "--duration", "6", "--plan-only", "--seed", "4"]) == 0
    time, voltage = excitation.read_table(out / "voltages.csv")
    rig = load_rig("shin2022")
    plan = designed(rig, Limits.of(rig), 6.0, seed=4)
    assert np.allclose(excitation.held(time, voltage, 6.0, plan.period), plan.voltage, atol=1e-4)
    assert not (out / "bag").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--duration", "2"], "expected 6 to 3600 s"),
        (["--max-angle", "40"], "expected above 0, to 25.0 deg"),
        (["--max-pressure", "900"], "from 101 (the atmosphere) to 710 kPa (the supply)"),
        (["--source", "plant", "--port", "/dev/x"], "--port: only a bridge has one"),
    ],
)
def test_bad_arguments_are_refused_in_one_line(
    arguments: list[str], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert excite.main(["--rig", "shin2022", "--out", str(tmp_path / "out"), *arguments]) == 2
    said = capsys.readouterr().err
    assert words in said and said.count("\n") == 1
    assert not (tmp_path / "out").exists()
