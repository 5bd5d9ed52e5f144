"""What is asked for at a sample: limits, time-outs, slew and trajectories."""

from __future__ import annotations

import math

import pytest

from pam_antagonist.control.command import PI_MODES, Mode
from pam_antagonist.control.reference import References, Rules, Trajectory
from pam_antagonist.errors import BadInput

MS = 1_000_000
S = 1_000_000_000


def references(
    slew: tuple[float, float] = (0.0, 0.0), timeout: tuple[float, float] = (0.0, 0.5), lost: str = "safe"
) -> References:
    def both(pair: tuple[float, float]) -> dict[Mode, float]:
        return dict(zip(PI_MODES, pair, strict=True))

    return References(Rules(both((0.35, 3.0)), both(slew), both(timeout), lost))


def test_a_torque_is_lost_when_nobody_repeats_it_and_an_angle_is_not() -> None:
    kept = references()
    kept.set(Mode.ANGLE, 0.1, 0)
    assert not kept.at(S, 3600 * S, 0.0, 0.0).lost
    kept.set(Mode.TORQUE, 1.0, 0)
    assert not kept.at(S, S // 2, 0.0, 0.0).lost
    wanted = kept.at(S, S // 2 + 1, 0.0, 0.0)
    assert wanted.lost and math.isnan(wanted.value) and kept.lost_count == 1
    assert kept.at(S, S, 0.0, 0.0).lost and kept.lost_count == 1
    kept.set(Mode.TORQUE, 1.0, S)
    assert kept.at(S, S, 0.0, 0.0)[:4] == (Mode.TORQUE, 1.0, 0.0, False)


def test_holding_means_the_angle_that_was_estimated_when_it_was_lost() -> None:
    kept = references(lost="hold")
    kept.set(Mode.TORQUE, 1.0, 0)
    assert kept.at(S, S // 2, 0.12, 1.0)[:4] == (Mode.TORQUE, 1.0, 0.0, False)
    # A sample without an estimate gives nothing to hold: safe voltages, and the next one decides.
    assert kept.at(S, S, math.nan, 1.0).lost
    assert kept.at(S, S, 0.13, 1.0)[:4] == (Mode.ANGLE, 0.13, 0.0, False)
    assert kept.at(S, 9 * S, 0.20, 1.0)[:4] == (Mode.ANGLE, 0.13, 0.0, False)
    assert kept.lost and kept.lost_count == 1
    kept.set(Mode.TORQUE, 0.5, 10 * S)
    assert kept.at(S, 10 * S, 0.2, 1.0).mode is Mode.TORQUE and not kept.lost


def test_a_held_angle_is_within_the_limits() -> None:
    kept = references(lost="hold")
    kept.set(Mode.TORQUE, 1.0, 0)
    assert kept.at(S, S, 0.44, 1.0).value == 0.35


def test_the_slew_begins_at_the_estimate_and_never_exceeds_its_limit() -> None:
    kept = references(slew=(0.5, 0.0))
    kept.set(Mode.ANGLE, 0.3, 0)
    values = [kept.at(S + k * MS, 0, -0.1, 0.0).value for k in range(900)]
    assert values[0] == -0.1
    steps = [b - a for a, b in zip(values, values[1:], strict=False)]
    assert max(steps) <= 0.5e-3 + 1e-12 and min(steps) >= 0.0
    assert values[799] == pytest.approx(0.2995) and values[-1] == 0.3
    # Behind a gap it moves on by 20 ms of slew at most.
    kept.set(Mode.ANGLE, -0.3, 0)
    assert kept.at(9 * S, 0, 0.0, 0.0).value == pytest.approx(0.3 - 0.5 * 0.02)
    # After safe voltages it begins where the joint is.
    kept.not_tracking()
    assert kept.at(10 * S, 0, 0.05, 0.0).value == 0.05


def test_a_change_of_the_mode_begins_at_its_estimate() -> None:
    kept = references(slew=(0.5, 1.0))
    kept.set(Mode.ANGLE, 0.3, 0)
    kept.at(S, 0, 0.3, 0.7)
    kept.set(Mode.TORQUE, 2.0, 0)
    assert kept.at(S + MS, 0, 0.3, 0.7).value == 0.7
    assert kept.at(S + 2 * MS, 0, 0.3, 0.7).value == pytest.approx(0.701)


def test_a_trajectory_is_linear_without_velocities_and_begins_where_the_joint_was_asked_to_be() -> None:
    kept = references()
    kept.set(Mode.ANGLE, 0.1, 0)
    kept.at(S, 0, 0.0, 0.0)
    kept.follow(Trajectory(Mode.ANGLE, 2 * S, [1.0, 3.0], [0.2, -0.2]), 0)
    found = [kept.at(2 * S + round(t * S), 0, 0.0, 0.0) for t in (-0.5, 0.0, 0.5, 1.0, 2.0, 3.0, 9.0)]
    assert [item.value for item in found] == pytest.approx([0.1, 0.1, 0.15, 0.2, 0.0, -0.2, -0.2])
    assert [item.velocity for item in found] == pytest.approx([0.0, 0.1, 0.1, -0.2, -0.2, 0.0, 0.0])


def test_with_velocities_it_is_the_cubic_that_has_them() -> None:
    course = Trajectory(Mode.ANGLE, 0, [0.0, 2.0], [0.0, 0.2], [0.1, 0.3])
    exact = lambda t: 0.1 * t - 0.1 * t**2 + 0.05 * t**3  # noqa: E731  # x(0)=0, x'(0)=0.1, x(2)=0.2, x'(2)=0.3
    for t in (0.0, 0.4, 1.0, 1.7):
        value, velocity = course.at(round(t * S), 0.0)
        assert value == pytest.approx(exact(t))
        assert velocity == pytest.approx(0.1 - 0.2 * t + 0.15 * t**2)
    assert course.at(2 * S, 0.0) == (0.2, 0.0)


def test_a_trajectory_under_way_is_not_lost_and_is_limited() -> None:
    kept = references(timeout=(0.5, 0.5))
    kept.follow(Trajectory(Mode.ANGLE, 0, [0.0, 4.0], [0.0, 0.4]), 0)
    assert not kept.at(3 * S, 3 * S, 0.0, 0.0).lost
    assert kept.at(4 * S - MS, 4 * S, 0.0, 0.0)[:4] == (Mode.ANGLE, 0.35, 0.0, False) and kept.limited
    assert not kept.at(5 * S, 4 * S + S // 2, 0.0, 0.0).lost
    assert kept.at(5 * S, 4 * S + S // 2 + 1, 0.0, 0.0).lost


def test_a_trajectory_that_is_called_off_stays_where_it_was() -> None:
    kept = references()
    kept.follow(Trajectory(Mode.ANGLE, 0, [0.0, 4.0], [0.0, 0.2]), 0)
    before = kept.at(S, 0, 0.0, 0.0).value
    kept.cancel()
    assert kept.at(3 * S, 0, 0.0, 0.0)[:4] == (Mode.ANGLE, before, 0.0, False)


@pytest.mark.parametrize(
    ("seconds", "values", "velocities"),
    [
        ([], [], []), ([1.0, 1.0], [0.0, 0.0], []), ([-1.0], [0.0], []), ([0.0, math.nan], [0.0, 0.0], []),
        ([0.0], [math.inf], []), ([0.0, 1.0], [0.0], []), ([0.0, 1.0], [0.0, 0.0], [0.0]),
    ],
)  # fmt: skip
def test_trajectories_that_make_no_sense_are_refused(
    seconds: list[float], values: list[float], velocities: list[float]
) -> None:
    with pytest.raises(BadInput, match="trajectory"):
        Trajectory(Mode.ANGLE, 0, seconds, values, velocities)


def stiff(kept: References, stiffness: float, damping: float = math.nan, mode: Mode = Mode.ANGLE_STIFFNESS) -> None:
    kept.set(mode, 0.1, 0, stiffness=stiffness, damping=damping)


def test_stiffness_and_damping_are_handed_on_where_the_mode_has_them() -> None:
    kept = references()
    stiff(kept, 6.0, 0.5)
    assert kept.at(S, 0, 0.0, 0.0).stiffness == 6.0 and math.isnan(kept.at(S, 0, 0.0, 0.0).damping)
    stiff(kept, 5.0, 0.5, Mode.IMPEDANCE)
    assert kept.at(S, 0, 0.0, 0.0)[4:] == (5.0, 0.5)
    stiff(kept, 5.0, mode=Mode.IMPEDANCE)
    assert kept.at(S, 0, 0.0, 0.0).damping == 0.0
    kept.set(Mode.ANGLE, 0.1, 0)
    assert math.isnan(kept.at(S, 0, 0.0, 0.0).stiffness)


@pytest.mark.parametrize("stiffness", [math.nan, 0.0, -1.0, math.inf])
def test_a_stiffness_that_is_no_number_above_zero_is_refused(stiffness: float) -> None:
    kept = references()
    stiff(kept, stiffness)
    assert "stiffness" in kept.complaint and "expected a number above 0" in kept.complaint
    assert math.isnan(kept.at(S, 0, 0.0, 0.0).value)


def test_a_negative_damping_is_refused() -> None:
    kept = references()
    stiff(kept, 6.0, -0.1, Mode.IMPEDANCE)
    assert "damping -0.1" in kept.complaint


def test_modes_with_a_stiffness_keep_to_the_rules_of_their_quantity() -> None:
    kept = references(slew=(0.1, 1.0))
    kept.set(Mode.TORQUE_STIFFNESS, 9.0, 0, stiffness=6.0)
    assert kept.at(S, 0, 0.0, 2.9).value == 2.9 and "±3 N m" in kept.limited
    assert kept.at(2 * S, S, 0.0, 2.9).lost
    kept = references(slew=(0.1, 1.0))
    kept.set(Mode.ANGLE, 0.1, 0)
    kept.at(S, 0, 0.1, 0.0)
    stiff(kept, 6.0)  # the same quantity: the reference goes on where it was
    assert kept.at(S + MS, 0, 0.0, 0.0).value == 0.1
