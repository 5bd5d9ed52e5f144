"""Accounting for samples, on recordings whose losses are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pam_antagonist.recording import Arrival, Recording
from pam_antagonist.replays.accounting import STAGES, Accounting, account

MS = 1_000_000
START = 10**18


def recording(count: int = 1000, took_ms: float = 2.0, **changes: np.ndarray) -> Recording:
    """A recording of ``count`` samples; ``changes``: stage -> the numbers of the samples that it has."""
    stamp = START + np.arange(count) * MS
    received = {}
    for number, stage in enumerate(STAGES):
        which = changes.get(stage, np.arange(count))
        delay = took_ms * MS if stage == "valve_command" else number * MS / 10
        received[stage] = Arrival((stamp[which] + delay).astype(np.int64), stamp[which])
    return Recording("bag", stamp, np.full((count, 2), 4e5), np.full((count, 2), 5.0), received_ns=received)


def with_messages(whole: Recording, stage: str, log: np.ndarray, stamp: np.ndarray) -> Recording:
    return replace(whole, received_ns={**whole.received_ns, stage: Arrival(log, stamp)})


def accounted(whole: Recording) -> Accounting:
    result = account(whole, 1e-3)
    assert result is not None
    return result


def test_nothing_is_lost() -> None:
    result = accounted(recording())
    assert result.expected == 1000
    assert set(result.lost.values()) == {0} and set(result.out_of_order.values()) == {0}
    assert result.latency.median == result.latency.p99 == result.latency.largest == 2.0


def test_discovery_and_end_are_not_counted_as_losses() -> None:
    """The estimator found its topics 100 samples later than the recorder, the command's last 20 did not come out."""
    result = accounted(recording(joint_estimate=np.arange(100, 1000), valve_command=np.arange(120, 980)))
    assert result.expected == 860
    assert set(result.lost.values()) == {0}


@pytest.mark.parametrize("stage", STAGES)
def test_what_is_missing_in_between_is_lost(stage: str) -> None:
    kept = np.delete(np.arange(1000), [300, 301, 500])
    result = accounted(recording(**{stage: kept}))
    assert result.lost[stage] == 3
    assert sum(result.lost.values()) == 3


def test_samples_that_no_topic_has_are_lost_as_well() -> None:
    whole = recording()
    keep = np.delete(np.arange(1000), slice(400, 410))
    received = {stage: Arrival(log[keep], stamp[keep]) for stage, (log, stamp) in whole.received_ns.items()}
    assert set(accounted(replace(whole.take(keep), received_ns=received)).lost.values()) == {10}


def test_commands_without_a_sample_are_not_counted() -> None:
    """Safe voltages for lack of estimates are stamped between two samples."""
    whole = recording()
    log, stamp = whole.received_ns["valve_command"]
    log, stamp = np.append(log, log[500] + 5), np.append(stamp, stamp[500] + 1)
    result = accounted(with_messages(whole, "valve_command", log, stamp))
    assert result.latency.samples == 1000
    assert set(result.lost.values()) == {0} and set(result.out_of_order.values()) == {0}


def test_disorder_is_counted() -> None:
    whole = recording()
    log, stamp = whole.received_ns["joint_estimate"]
    swapped = log.copy()
    swapped[[200, 201]] = swapped[[201, 200]]
    assert accounted(with_messages(whole, "joint_estimate", swapped, stamp)).out_of_order["joint_estimate"] == 1


def test_no_account_without_a_stage() -> None:
    whole = recording()
    part = {stage: arrival for stage, arrival in whole.received_ns.items() if stage != "joint_estimate"}
    assert account(replace(whole, received_ns=part), 1e-3) is None
