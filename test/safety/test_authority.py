"""One commander and one owner of references at a time, told by the numbers that publishers give to their messages."""

from __future__ import annotations

import pytest

from pam_antagonist.safety import Authority, ReferenceOwner
from pam_antagonist.safety.authority import Verdict

MS = 1_000_000
S = 1000 * MS
TIMEOUT = 0.02


def hold(authority: Authority, first: int = 5000, count: int = 50, publishers: int = 1) -> tuple[int, int]:
    """A commander at 1 kHz; the number of its last message, and the time [ns]."""
    for k in range(count):
        authority.admit(first + k, publishers, k * MS)
    return first + count - 1, (count - 1) * MS


def test_a_single_publisher_is_obeyed_whatever_its_numbers() -> None:
    authority = Authority(TIMEOUT)
    for k, number in enumerate([7, 8, 900, 3, None, 4]):
        assert authority.admit(number, 1, k * MS) is Verdict.ACCEPTED
    assert authority.refused == 0


def test_a_second_commander_is_refused_and_the_first_one_goes_on() -> None:
    authority = Authority(TIMEOUT)
    last, now = hold(authority)
    for k in range(1, 1000):
        assert authority.admit(k, 2, now + k * MS) is Verdict.REFUSED
        assert authority.admit(last + k, 2, now + k * MS + 1) is Verdict.ACCEPTED
    assert authority.refused == 999


@pytest.mark.parametrize("lost", [1, 20, 99])
def test_lost_messages_do_not_cost_the_valves(lost: int) -> None:
    authority = Authority(TIMEOUT)
    last, now = hold(authority)
    assert authority.admit(last + 1 + lost, 2, now + 10 * MS) is Verdict.ACCEPTED


def test_who_was_refused_does_not_inherit_the_valves() -> None:
    authority = Authority(TIMEOUT)
    _, now = hold(authority)
    verdicts = [authority.admit(10 + k, 2, now + k * MS) for k in range(1, 40)]
    assert verdicts[:20] == [Verdict.REFUSED] * 20
    assert verdicts[20] is Verdict.UNCLEAR


def test_a_commander_that_was_started_again_is_obeyed_while_the_dead_one_is_still_counted() -> None:
    authority = Authority(TIMEOUT)
    _, now = hold(authority)
    verdicts = [authority.admit(1 + k, 2, now + 500 * MS + k * MS) for k in range(30)]
    assert verdicts == [Verdict.LISTENING] * 21 + [Verdict.ACCEPTED] * 9


def test_a_commander_that_stalled_goes_on() -> None:
    authority = Authority(TIMEOUT)
    last, now = hold(authority)
    assert authority.admit(last + 1, 2, now + 300 * MS) is Verdict.ACCEPTED


def test_two_from_the_start_are_unclear() -> None:
    authority = Authority(TIMEOUT)
    assert authority.admit(100, 2, 0) is Verdict.LISTENING
    assert authority.admit(9000, 2, MS) is Verdict.UNCLEAR


@pytest.mark.parametrize("behind", [0, 1, 100])
def test_two_whose_numbers_are_alike_are_unclear(behind: int) -> None:
    """The second one's number was taken for the first one's; the first one's own gives that away."""
    authority = Authority(TIMEOUT)
    last, now = hold(authority)
    assert authority.admit(last - behind, 2, now + MS) is Verdict.UNCLEAR


def test_without_numbers_two_are_unclear() -> None:
    authority = Authority(TIMEOUT)
    assert authority.admit(None, 1, 0) is Verdict.ACCEPTED
    assert authority.admit(None, 2, MS) is Verdict.UNCLEAR
    assert authority.admit(None, 1, 2 * MS) is Verdict.ACCEPTED


def test_after_a_release_everybody_may_try_again() -> None:
    authority = Authority(TIMEOUT)
    last, now = hold(authority)
    assert authority.admit(1, 2, now) is Verdict.REFUSED
    authority.release()
    assert authority.admit(2, 1, now + MS) is Verdict.ACCEPTED
    assert authority.admit(last + 1, 2, now + 2 * MS) is Verdict.REFUSED


# ------------------------------------------------------------------------------------------------ references


def test_a_single_publisher_is_obeyed_at_once_also_a_new_one() -> None:
    owner = ReferenceOwner()
    for sequence in (1, 2, 9, 1):  # the last one was started anew
        assert owner.admit(sequence, 1, 0)


def test_while_the_first_is_heard_another_is_refused() -> None:
    owner = ReferenceOwner(1.0)
    assert owner.admit(5000, 2, 0)
    for k in range(1, 50):
        assert owner.admit(5000 + k, 2, k * S // 10)
        assert not owner.admit(k, 2, k * S // 10)
    assert owner.refused == 49
    # A publisher's own number does not come twice.
    assert not owner.admit(5049, 2, 5 * S)


def test_silence_frees_the_joint() -> None:
    owner = ReferenceOwner(1.0)
    owner.admit(5000, 2, 0)
    assert not owner.admit(1, 2, S)
    assert owner.admit(2, 2, S + 1)
    assert not owner.admit(5001, 2, S + 2)


def test_without_numbers_no_owner_of_references_can_be_told_apart() -> None:
    owner = ReferenceOwner()
    assert owner.admit(None, 2, 0) and owner.admit(None, 2, 1)
