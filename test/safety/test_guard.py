"""What reaches the valves is within the limits, safe when it has to be, and of one commander at a time."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pam_antagonist.control.command import VoltageLimits
from pam_antagonist.errors import BadInput
from pam_antagonist.safety import Authority, ReferenceOwner, SafeAction, ValveGuard
from pam_antagonist.safety.guard import Ruling, State, safe_action

MS = 1_000_000
S = 1000 * MS
TIMEOUT = 0.02
SAFE = (5.0, 5.2)


def make(action: SafeAction | None = None, slew: float = 1e6, timeout: float = 0.02) -> ValveGuard:
    return ValveGuard(VoltageLimits(), action or SafeAction(SAFE), slew, timeout)


def test_waits_in_the_safe_voltages_then_obeys() -> None:
    guard = make()
    assert guard.output(0) == (SAFE, State.WAITING, "")
    assert guard.command((7.0, 3.0), MS) is Ruling.ACCEPTED
    assert guard.output(MS) == ((7.0, 3.0), State.OBEYING, "")


def test_watchdog_ends_by_itself_with_the_next_command() -> None:
    guard = make()
    guard.command((7.0, 3.0), 0)
    states = [guard.output(k * MS).state for k in range(1, 31)]
    assert states == [State.OBEYING] * 20 + [State.SILENT] * 10
    guard.command((6.0, 3.0), 31 * MS)
    assert guard.output(31 * MS) == ((6.0, 3.0), State.OBEYING, "")


def test_a_clock_that_is_set_back_does_not_keep_a_dead_commander_alive() -> None:
    guard = make()
    guard.command((7.0, 3.0), 10**15)
    guard.output(10**15)
    states = [guard.output(k * MS).state for k in range(50)]
    assert states.index(State.SILENT) <= 41  # at most the time-out twice
    assert states[-1] is State.SILENT


@pytest.mark.parametrize("wrong", [(math.nan, 5.0), (5.0, math.inf), (-math.inf, 1.0)])
def test_what_is_no_number_counts_as_not_come(wrong: tuple[float, float]) -> None:
    guard = make()
    guard.command((7.0, 3.0), 0)
    for k in range(1, 30):
        guard.command(wrong, k * MS)
        expected = (7.0, 3.0) if k <= 20 else SAFE
        assert guard.output(k * MS).voltage == expected
    assert guard.counts.not_finite == 29


def test_commands_that_are_too_old_keep_the_right_of_their_publisher_and_nothing_else() -> None:
    guard = make()
    guard.command((7.0, 3.0), 0)
    voltages = []
    for k in range(1, 30):
        assert guard.command((8.0, 2.0), k * MS, late=True) is Ruling.ACCEPTED
        voltages.append(guard.output(k * MS).voltage)
    assert voltages == [(7.0, 3.0)] * 20 + [SAFE] * 9
    assert (guard.counts.late, guard.counts.commands) == (29, 1)


def test_clamps() -> None:
    guard = make()
    guard.command((12.0, -3.0), 0)
    assert guard.output(0).voltage == (10.0, 0.0)
    assert guard.counts.clamped == 1


def test_slew_is_limited_each_way_and_for_each_valve() -> None:
    guard = make(slew=1000.0)
    guard.output(0)
    guard.command((8.0, 4.9), 0)
    seen = [guard.output(k * MS).voltage for k in range(1, 6)]
    assert [first for first, _ in seen] == pytest.approx([6.0, 7.0, 8.0, 8.0, 8.0])
    assert [second for _, second in seen] == [4.9] * 5
    guard.command((7.5, 9.9), 5 * MS)
    assert guard.output(6 * MS).voltage == pytest.approx((7.5, 5.9))
    assert guard.counts.slewed == 3


def test_going_to_the_safe_voltages_is_not_slew_limited_but_coming_back_is() -> None:
    guard = make(slew=100.0)
    guard.output(0)
    for k in range(40):
        guard.command((9.0, 1.0), k * MS)
        guard.output(k * MS)
    assert guard.output(100 * MS).voltage == SAFE
    guard.command((9.0, 1.0), 100 * MS)
    first, second = guard.output(101 * MS).voltage
    assert (first, second) == pytest.approx((SAFE[0] + 0.1, SAFE[1] - 0.1))


def test_a_stop_latches_and_keeps_its_first_reason() -> None:
    guard = make()
    guard.command((7.0, 3.0), 0)
    guard.output(0)
    assert guard.stop("pressure 1 is too high")
    assert not guard.stop("something else")
    for k in range(1, 200):
        guard.command((7.0, 3.0), k * MS)
        assert guard.output(k * MS) == (SAFE, State.STOPPED, "pressure 1 is too high")
    assert guard.clear() == "pressure 1 is too high"
    assert guard.output(200 * MS).voltage == SAFE  # the commands until then are forgotten
    guard.command((7.0, 3.0), 201 * MS)
    assert guard.output(201 * MS).state is State.OBEYING
    assert guard.clear() == ""


def test_two_commanders_that_cannot_be_told_apart_stop_it() -> None:
    guard = make()
    guard.command((7.0, 3.0), 0, sequence=10, publishers=1)
    assert guard.command((1.0, 1.0), MS, sequence=10, publishers=2) is Ruling.UNCLEAR
    assert guard.output(MS).state is State.STOPPED


def test_a_second_commander_never_reaches_the_valves() -> None:
    guard = make()
    for k in range(1, 500):
        guard.command((6.0, 5.0), k * MS, sequence=4000 + k, publishers=1 if k < 100 else 2)
        if k >= 100:
            assert guard.command((10.0, 0.0), k * MS + 1, sequence=k - 99, publishers=2) is Ruling.REFUSED
        assert guard.output(k * MS + 2).voltage == (6.0, 5.0)


def test_not_active_is_safe_and_a_stop_survives_it() -> None:
    guard = make()
    guard.command((7.0, 3.0), 0)
    guard.set_active(False)
    guard.command((7.0, 3.0), MS)
    assert guard.output(MS) == (SAFE, State.INACTIVE, "")
    guard.stop("why")
    guard.set_active(True)
    guard.command((7.0, 3.0), 2 * MS)
    assert guard.output(2 * MS).state is State.STOPPED


def test_hold_stays_and_vent_goes_down_slowly_and_together() -> None:
    hold, vent = SafeAction(SAFE), SafeAction((5.0, 5.0), (0.0, 0.0), rate=2.0)
    assert {hold.voltage(k * 1000 * MS) for k in range(10)} == {SAFE}
    assert vent.voltage(0) == (5.0, 5.0)
    assert vent.voltage(1000 * MS) == pytest.approx((3.0, 3.0))
    assert vent.voltage(60_000 * MS) == (0.0, 0.0)


def test_vent_begins_anew_with_each_time_that_the_guard_is_safe() -> None:
    guard = make(SafeAction((5.0, 5.0), (0.0, 0.0), rate=1.0))
    assert guard.output(0).voltage == (5.0, 5.0)
    assert guard.output(1000 * MS).voltage == pytest.approx((4.0, 4.0))
    guard.stop("a stop on the way does not start it again")
    assert guard.output(2000 * MS).voltage == pytest.approx((3.0, 3.0))
    guard.clear()
    guard.command((5.0, 5.0), 2001 * MS)
    guard.output(2001 * MS)
    assert guard.output(2500 * MS).voltage == (5.0, 5.0)
    assert guard.output(3500 * MS).voltage == pytest.approx((4.0, 4.0))


def test_parameters_that_make_no_sense_are_refused() -> None:
    limits = VoltageLimits()
    assert safe_action("hold", limits, (5.5, 5.5), (0.0, 0.0), 1.0).vent is None
    assert safe_action("vent", limits, (5.5, 5.5), (0.0, 0.0), 1.0).vent == (0.0, 0.0)
    with pytest.raises(BadInput, match="hold, vent"):
        safe_action("stop", limits, (5.5, 5.5), (0.0, 0.0), 1.0)
    with pytest.raises(BadInput, match="safe_voltage"):
        safe_action("hold", limits, (5.5, 11.0), (0.0, 0.0), 1.0)
    with pytest.raises(BadInput, match="vent_voltage"):
        safe_action("hold", limits, (5.5, 5.5), (math.nan, 0.0), 1.0)
    for slew, timeout in ((0.0, 0.02), (math.nan, 0.02), (1.0, 0.0)):
        with pytest.raises(BadInput):
            make(slew=slew, timeout=timeout)


number = st.floats(allow_nan=True, allow_infinity=True)


@settings(max_examples=200)
@given(st.lists(st.tuples(number, number, st.integers(-5 * MS, 40 * MS), st.booleans()), max_size=40))
def test_whatever_comes_the_valves_get_numbers_within_limits_and_slew(
    events: list[tuple[float, float, int, bool]],
) -> None:
    guard = make(slew=1000.0)
    now, last = 10**9, guard.output(10**9).voltage
    for first, second, step, stop in events:
        guard.command((first, second), now)
        if stop:
            guard.stop("now") and guard.clear()
        now += step
        decision = guard.output(now)
        assert all(0.0 <= voltage <= 10.0 for voltage in decision.voltage)
        if not decision.state.safe:
            largest = 1000.0 * max(step, 0) * 1e-9 + 1e-6
            assert all(abs(new - old) <= largest for new, old in zip(decision.voltage, last, strict=True))
        last = decision.voltage


# ------------------------------------------------------------------------------------------------ one commander


def ruled(*messages: tuple[int | None, int, int], held: bool = True) -> list[Ruling]:
    """What is said to (number, publishers, time [ms]), after a commander that had number 5049 at 49 ms."""
    authority = Authority(TIMEOUT)
    before = [(5000 + k, 1, k) for k in range(50)] if held else []
    said = [authority.admit(number, count, ms * MS) for number, count, ms in (*before, *messages)]
    assert authority.refused == said.count(Ruling.REFUSED)
    return said[len(before) :]


ACCEPTED, REFUSED, UNCLEAR, LISTENING = Ruling.ACCEPTED, Ruling.REFUSED, Ruling.UNCLEAR, Ruling.LISTENING


def test_a_single_publisher_is_obeyed_whatever_its_numbers() -> None:
    numbers = enumerate([7, 8, 900, 3, None, 4])
    assert set(ruled(*((number, 1, k) for k, number in numbers), held=False)) == {ACCEPTED}


def test_a_second_commander_is_refused_and_the_first_one_goes_on() -> None:
    both = [message for k in range(1, 1000) for message in ((k, 2, 49 + k), (5049 + k, 2, 49 + k))]
    assert ruled(*both) == [REFUSED, ACCEPTED] * 999


@pytest.mark.parametrize(("lost", "later_ms"), [(1, 10), (20, 10), (99, 10), (0, 300)])
def test_lost_messages_and_a_stall_do_not_cost_the_valves(lost: int, later_ms: int) -> None:
    assert ruled((5050 + lost, 2, 49 + later_ms)) == [ACCEPTED]


def test_who_was_refused_does_not_inherit_the_valves() -> None:
    said = ruled(*((10 + k, 2, 49 + k) for k in range(1, 40)))
    assert said[:21] == [REFUSED] * 20 + [UNCLEAR]


def test_a_commander_that_was_started_again_is_obeyed_while_the_dead_one_is_still_counted() -> None:
    assert ruled(*((1 + k, 2, 549 + k) for k in range(30))) == [LISTENING] * 21 + [ACCEPTED] * 9


@pytest.mark.parametrize("behind", [0, 1, 100])
def test_two_whose_numbers_are_alike_are_unclear(behind: int) -> None:
    """The second one's number was taken for the first one's; the first one's own gives that away."""
    assert ruled((5049 - behind, 2, 50)) == [UNCLEAR]


def test_two_from_the_start_or_without_numbers_are_unclear() -> None:
    assert ruled((100, 2, 0), (9000, 2, 1), held=False) == [LISTENING, UNCLEAR]
    assert ruled((None, 1, 0), (None, 2, 1), (None, 1, 2), held=False) == [ACCEPTED, UNCLEAR, ACCEPTED]


def test_after_a_release_everybody_may_try_again() -> None:
    authority = Authority(TIMEOUT)
    for k in range(50):
        authority.admit(5000 + k, 1, k * MS)
    assert authority.admit(1, 2, 49 * MS) is REFUSED
    authority.release()
    assert authority.admit(2, 1, 50 * MS) is ACCEPTED
    assert authority.admit(5050, 2, 51 * MS) is REFUSED


# ------------------------------------------------------------------------------------------------ references


@pytest.mark.parametrize(
    ("messages", "admitted"),
    [
        ([(1, 1, 0), (2, 1, 0), (9, 1, 0), (1, 1, 0)], [True] * 4),  # the last one was started anew
        ([(5000, 2, 0), (1, 2, S), (2, 2, S + 1), (5001, 2, S + 2)], [True, False, True, False]),
        ([(None, 2, 0), (None, 2, 1)], [True, True]),
    ],
    ids=["a single publisher, also a new one", "silence frees the joint", "without numbers nobody is told apart"],
)
def test_who_owns_the_references(messages: list[tuple[int | None, int, int]], admitted: list[bool]) -> None:
    owner = ReferenceOwner()
    assert [owner.admit(*message) for message in messages] == admitted


def test_while_the_first_is_heard_another_is_refused() -> None:
    owner = ReferenceOwner()
    assert owner.admit(5000, 2, 0)
    for k in range(1, 50):
        assert owner.admit(5000 + k, 2, k * S // 10)
        assert not owner.admit(k, 2, k * S // 10)
    assert owner.refused == 49
    # A publisher's own number does not come twice.
    assert not owner.admit(5049, 2, 5 * S)
