"""References have one owner."""

from __future__ import annotations

from pam_antagonist.safety import ReferenceOwner

S = 1_000_000_000


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


def test_without_numbers_nobody_can_be_told_apart() -> None:
    owner = ReferenceOwner()
    assert owner.admit(None, 2, 0) and owner.admit(None, 2, 1)
