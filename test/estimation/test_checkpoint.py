"""A filter that goes on from a checkpoint gives the bits of the one that it was taken of; any other refuses it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from recordings import trial

from pam_antagonist.errors import BadInput
from pam_antagonist.estimation import Estimator
from pam_antagonist.estimation.memory import Checkpoint
from pam_antagonist.rig import Rig, load_rig

CLEAN = trial(4.0, seed=7)
HALF = 1500


def samples(first: int, end: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    part = slice(first, end)
    return CLEAN.stamp_ns[part], CLEAN.pressure[part], CLEAN.voltage[part]


@pytest.fixture(scope="module")
def rig() -> Rig:
    return load_rig("shin2022")


@pytest.fixture(scope="module")
def checkpoint(rig: Rig) -> Checkpoint:
    estimator = Estimator(rig)
    estimator.run(*samples(0, HALF))
    taken = estimator.checkpoint()
    assert taken is not None
    return taken


def test_later_samples_give_the_same_bits(rig: Rig, checkpoint: Checkpoint) -> None:
    whole = Estimator(rig).run(*samples(0, 2 * HALF))
    other = Estimator(rig)
    other.run(*samples(700, 900))  # whatever it knew before
    other.restore(checkpoint)
    rest = other.run(*samples(HALF, 2 * HALF))
    assert rest.rows.tobytes() == whole.rows[HALF:].tobytes()
    assert np.array_equal(rest.started_ns, whole.started_ns[HALF:])


def test_a_checkpoint_is_a_copy(rig: Rig) -> None:
    estimator = Estimator(rig)
    assert estimator.checkpoint() is None
    estimator.run(*samples(0, 100))
    taken = estimator.checkpoint()
    assert taken is not None and taken.stamp_ns == CLEAN.stamp_ns[99]
    before = taken.state.copy(), taken.covariance.copy(), taken.distances.copy()
    estimator.run(*samples(100, 200))
    for kept, now in zip(before, (taken.state, taken.covariance, taken.distances), strict=True):
        assert np.array_equal(kept, now)


def test_another_filter_refuses_it_and_says_why(rig: Rig, checkpoint: Checkpoint) -> None:
    heavier = rig.replaced(supply=rig.supply.replaced(pressure=1.001 * rig.supply.pressure))
    for estimator, why in (
        (Estimator(load_rig("sealed_joint")), r"rig shin2022 \(\w{16}\) rather than sealed_joint \(\w{16}\)"),
        (Estimator(heavier), r"rig shin2022 \(\w{16}\) rather than shin2022 \(\w{16}\)"),
        (Estimator(rig, tuning="published"), "tuning default rather than published"),
        (Estimator(rig, joint="locked", lock_angle=0.1), "a free joint rather than a joint locked at 0.1 rad"),
    ):
        with pytest.raises(BadInput, match=f"^the checkpoint was made with {why}$"):
            estimator.restore(checkpoint)
        assert estimator.started_ns is None


def test_added_states_have_to_be_the_same(rig: Rig, checkpoint: Checkpoint) -> None:
    other = replace(checkpoint, identity=replace(checkpoint.identity, added=("external_torque",)))
    with pytest.raises(
        BadInput, match="^the checkpoint was made with the added states external_torque rather than none$"
    ):
        Estimator(rig).restore(other)


def test_other_numbers_of_the_same_tuning_are_noticed(rig: Rig, checkpoint: Checkpoint) -> None:
    other = replace(checkpoint, identity=replace(checkpoint.identity, settings="0" * 16))
    with pytest.raises(BadInput, match="other values of tuning default or of the rig's uncertainty"):
        Estimator(rig).restore(other)


@pytest.mark.parametrize(
    ("name", "value", "why"),
    [
        ("state", np.array([np.nan, 0.0, 4e5, 4e5]), "state holds a value that is not finite"),
        ("covariance", np.full((4, 4), np.inf), "covariance holds a value that is not finite"),
        ("covariance", -np.eye(4), "covariance has a negative variance"),
        ("state", np.zeros(3), r"state has the shape \(3,\), expected \(4,\)"),
        ("rejected", -1, "stamps and counts"),
        ("distances", np.full(10, -1), "stamps and counts"),
        ("distances", np.array([9, 1, 1, 1, 1, 1, 1, 1, 1, 0]), "stamps and counts"),
        ("distances", np.ones(9, dtype=np.int64), "stamps and counts"),
        ("started_ns", 2**62, "stamps and counts"),
    ],
)
def test_a_damaged_one_is_refused_in_one_line_and_changes_nothing(
    rig: Rig, checkpoint: Checkpoint, name: str, value: object, why: str
) -> None:
    estimator = Estimator(rig)
    with pytest.raises(BadInput, match=f"^the checkpoint is damaged: .*{why}[^\n]*$"):
        estimator.restore(replace(checkpoint, **{name: value}))
    whole = Estimator(rig).run(*samples(0, 200))
    assert estimator.run(*samples(0, 200)).rows.tobytes() == whole.rows.tobytes()
