"""The PI law as printed and as corrected, at the edges and on the plant (no estimator)."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pam_antagonist.control.command import PI_MODES, Mode, Status, VoltageLimits
from pam_antagonist.control.pi import PUBLISHED_GAINS, Gains, PiController
from pam_antagonist.errors import BadInput
from pam_antagonist.rig import load_rig
from pam_antagonist.simulation.plant import Plant

PERIOD = 1e-3
errors = st.floats(-5.0, 5.0)
voltages = st.tuples(st.floats(0.0, 10.0), st.floats(0.0, 10.0))


def started(mode: Mode = Mode.ANGLE, **options) -> PiController:
    """A controller that has taken over from [5.5, 5.5] V with nothing to correct."""
    controller = PiController(**options)
    assert controller.step(mode, 0.0, 0.0).voltage == (5.5, 5.5)
    return controller


def test_published_gains_are_the_paper_s():
    assert PUBLISHED_GAINS[Mode.ANGLE] == Gains(proportional=5.45, integral=1.55, bias=5.5)
    assert PUBLISHED_GAINS[Mode.TORQUE] == Gains(proportional=7.45, integral=4.75, bias=5.5)


@pytest.mark.parametrize("mode", PI_MODES)
def test_law_is_the_paper_s_state_space_form(mode):
    """u(k) = C x(k) + D e(k) + beta with C = T_I * T_stp, x summed after use."""
    controller = started(mode)
    gains = PUBLISHED_GAINS[mode]
    x = 0.0
    for k in range(400):
        e = 0.1 * math.sin(0.05 * k)
        d = gains.integral * PERIOD * x + gains.proportional * e
        command = controller.step(mode, 0.3, 0.3 - e)
        assert command.voltage == pytest.approx((5.5 + d, 5.5 - d), abs=1e-12)
        assert command.status is Status.TRACKING
        x += e


@given(st.lists(errors, min_size=1, max_size=200), st.sampled_from(PI_MODES), voltages)
def test_voltages_never_leave_the_limits_and_the_integral_never_asks_for_it(sequence, mode, valves):
    limits = VoltageLimits(1.0, 9.5)
    # an integral that could run away within a few samples
    gains = {m: Gains(7.0, 900.0, 5.5) for m in PI_MODES}
    controller = PiController(gains, limits=limits)
    controller.stop(tuple(limits.clip(u) for u in valves))
    span = controller.span(mode)
    assert span == pytest.approx(4.0)
    for e in sequence:
        command = controller.step(mode, e, 0.0)
        assert all(1.0 <= u <= 9.5 for u in command.voltage)
        assert abs(controller.integral) <= span


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_saturation_is_left_in_the_sample_in_which_the_error_changes_sign(sign):
    controller = started(Mode.TORQUE)
    for _ in range(20_000):  # 20 s against a wall
        command = controller.step(Mode.TORQUE, sign * 2.0, 0.0)
    assert command.status is Status.SATURATED
    assert command.voltage == ((10.0, 0.0) if sign > 0 else (0.0, 10.0))
    assert abs(controller.integral) < 0.01, "a valve at its limit could not follow it"
    command = controller.step(Mode.TORQUE, sign * 2.0, sign * 2.05)
    assert command.status is Status.TRACKING
    assert abs(command.voltage[0] - 5.5) < controller.span(Mode.TORQUE)


def test_integral_still_works_while_one_valve_is_near_its_limit():
    """Anti-windup must not remove the integral action: the error of a plant with an offset goes to 0."""
    controller = started()
    angle = 0.0
    for _ in range(60_000):
        u = controller.step(Mode.ANGLE, 0.3, angle).voltage
        angle += PERIOD / 0.2 * (0.16 * (u[0] - u[1]) - 0.2 - angle)
    assert angle == pytest.approx(0.3, abs=1e-3)


@given(voltages, errors, st.sampled_from(PI_MODES))
def test_bumpless_start_gives_what_the_valves_have(valves, e, mode):
    controller = PiController()
    controller.stop(valves)
    first = controller.step(mode, e, 0.0)
    assert first.voltage == valves
    second = controller.step(mode, e, 0.0)
    span = controller.span(mode)
    # One sample moves a valve by the integral of one sample and by 0.2 % (1 ms of 500 ms) of what has to fade away.
    half = (valves[0] - valves[1]) / 2
    beyond = max(0.0, abs(half - PUBLISHED_GAINS[mode].proportional * e) - span) + abs(sum(valves) / 2 - 5.5)
    bound = 0.002 * beyond + PUBLISHED_GAINS[mode].integral * PERIOD * abs(e) + 1e-9
    assert all(abs(u - v) <= bound for u, v in zip(second.voltage, valves, strict=True))


@given(st.floats(-0.4, 0.4), st.floats(-2.0, 2.0), st.floats(-0.3, 0.3), st.floats(-1.0, 1.0))
def test_mode_switch_is_bumpless(angle_wanted, torque_wanted, angle, torque):
    controller = started()
    for _ in range(50):
        before = controller.step(Mode.ANGLE, angle_wanted, angle)
    after = controller.step(Mode.TORQUE, torque_wanted, torque)
    assert after.voltage == before.voltage
    back = controller.step(Mode.ANGLE, angle_wanted, angle)
    assert back.voltage == after.voltage


def test_mean_voltage_of_a_start_fades_to_the_bias():
    controller = PiController(blend_time=0.2)
    controller.stop((3.0, 3.0))
    means = [sum(controller.step(Mode.ANGLE, 0.0, 0.0).voltage) / 2 for _ in range(2000)]
    assert means[0] == 3.0
    assert means[200] == pytest.approx(5.5 - 2.5 * math.exp(-1.0), abs=1e-9)
    assert means[-1] == pytest.approx(5.5, abs=1e-3)


def test_retuning_is_bumpless_and_takes_effect():
    controller = started()
    before = controller.step(Mode.ANGLE, 0.1, 0.0)
    controller.retune(Mode.ANGLE, Gains(2.0, 1.0))
    assert controller.step(Mode.ANGLE, 0.1, 0.0).voltage == before.voltage
    step = controller.step(Mode.ANGLE, 0.2, 0.0).voltage[0] - before.voltage[0]
    assert step == pytest.approx(2.0 * 0.1, abs=2e-4)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_gives_safe_voltages_and_never_enters_the_integral(bad):
    controller = started(safe_voltage=(5.5, 5.5))
    for _ in range(100):
        before = controller.step(Mode.ANGLE, 0.1, 0.0)
    integral = controller.integral
    for wanted, value, status in ((0.1, bad, Status.NOT_FINITE), (bad, 0.0, Status.BAD_REFERENCE)):
        command = controller.step(Mode.ANGLE, wanted, value)
        assert (command.voltage, command.status) == ((5.5, 5.5), status)
        assert command.status.safe
        assert controller.integral == integral
    after = controller.step(Mode.ANGLE, 0.1, 0.0)
    assert after.voltage == pytest.approx(before.voltage, abs=1e-3)  # it goes on where it was


def test_late_estimate_and_missing_reference_give_safe_voltages():
    controller = PiController(safe_voltage=(4.0, 4.5))
    assert controller.step(None, math.nan, 0.1) == ((4.0, 4.5), Status.NO_REFERENCE)
    assert controller.step(Mode.ANGLE, 0.3, 0.1, late=True) == ((4.0, 4.5), Status.LATE)
    assert not controller.running


def test_after_a_long_interruption_the_start_is_bumpless_from_the_safe_voltages():
    controller = started(resume_time=0.1)
    for _ in range(5000):
        controller.step(Mode.ANGLE, 0.3, 0.1)
    for _ in range(100):
        controller.step(Mode.ANGLE, 0.3, 0.1, late=True)
    assert controller.running  # 0.1 s: not longer than resume_time
    controller.step(Mode.ANGLE, 0.3, 0.1, late=True)
    assert not controller.running
    assert controller.step(Mode.ANGLE, 0.3, 0.1).voltage == (5.5, 5.5)


@settings(max_examples=50)
@given(
    st.lists(
        st.tuples(
            st.sampled_from([None, *Mode]),
            st.sampled_from([0.0, 0.4, -2.0, math.nan, math.inf]),
            st.sampled_from([0.0, -0.4, 2.0, math.nan, -math.inf]),
            st.booleans(),
        ),
        max_size=300,
    )
)
def test_whatever_comes_the_voltages_are_finite_and_within_the_limits(calls):
    controller = PiController(safe_voltage=(4.0, 4.0))
    for mode, wanted, value, late in calls:
        command = controller.step(mode, wanted, value, late=late)
        assert all(0.0 <= u <= 10.0 for u in command.voltage)
        assert math.isfinite(controller.integral)
        usable = mode in PI_MODES and not late and math.isfinite(wanted) and math.isfinite(value)
        assert command.status.safe is not usable


@pytest.mark.parametrize(
    "make",
    [
        lambda: PiController(dict.fromkeys(PI_MODES, Gains(1.0, 1.0, bias=11.0))),
        lambda: VoltageLimits(5.0, 5.0),
        lambda: VoltageLimits(0.0, math.nan),
        lambda: PiController(safe_voltage=(5.5, 10.5)),
        lambda: PiController(safe_voltage=(5.5, math.nan)),
        lambda: PiController(limits=VoltageLimits(6.0, 10.0), safe_voltage=(7.0, 7.0)),
        lambda: PiController().stop((math.nan, 5.0)),
    ],
)
def test_values_out_of_range_are_refused_in_one_line(make):
    with pytest.raises(BadInput) as error:
        make()
    assert "\n" not in str(error.value)
    assert len(str(error.value)) > 20


# ------------------------------------------------------------------------------------------------ the closed loop

STEPS_DEG = (0.0, 10.0, -10.0)
STEP_SECONDS = 6.0
RIG = load_rig("shin2022")


class Printed(PiController):
    """The paper's law: the printed gains, and nothing against windup."""

    def _integrate(self, mode, gains, error, half):
        self.integral += gains.integral / self._period * error


def run(kind=PiController):
    """Angle [rad], reference [rad] and whether a valve was at its limit, a sample (N,)."""
    plant = Plant(RIG, noise=False)
    controller = kind(sample_period=RIG.sample_period)
    angle, valves = 0.0, (5.5, 5.5)
    log = []
    for degrees in STEPS_DEG:
        for _ in range(round(STEP_SECONDS / RIG.sample_period)):
            sample = plant.step(valves)
            angle = float(sample.angle)
            valves, status = controller.step(Mode.ANGLE, math.radians(degrees), angle)
            log.append((angle, math.radians(degrees), status is Status.SATURATED))
    return np.array(log)


def test_as_printed_the_valves_sit_in_saturation():
    log = run(Printed)
    assert log[:, 2].mean() > 0.6
    moving = log[round(STEP_SECONDS / RIG.sample_period) :]
    assert np.degrees(np.abs(moving[:, 0] - moving[:, 1])).mean() > 5.0


def test_corrected_the_loop_settles_without_saturation():
    log = run()
    assert log[:, 2].mean() < 0.01
    n = round(STEP_SECONDS / RIG.sample_period)
    for end in (n, 2 * n, 3 * n):
        assert abs(np.degrees(log[end - 1, 0] - log[end - 1, 1])) < 2.0
