"""The study of the monitor: a joint under control, sizes in noises, and what is counted."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pam_antagonist.diagnosis.monitor_blocks import MonitorFinding
from pam_antagonist.diagnosis.monitor_responses import hypotheses
from validation import monitor_study as study
from validation.monitored import Joint, faults, size_of

RIG = study.rig_of("shin2022", Path())


def test_the_joint_follows_its_steps_and_a_size_is_counted_in_noises() -> None:
    joint = Joint(RIG, 0, True, 0.0)
    minute = joint.run(8)
    assert len(minute.stamps) == 8000 and np.all(np.diff(minute.stamps) == 1_000_000)
    assert abs(minute.angle[-1] - joint._goal) < np.radians(3.0) and np.ptp(minute.angle) > np.radians(3.0)
    by_label = {fault.label: fault for fault in faults(RIG)}
    offset = by_label["pressure sensor 1, offset"]
    size = size_of(offset, 4.0, RIG, minute)
    assert size is not None
    assert size * offset.change["effects.pressure_sensor.offset_1"] == pytest.approx(4.0 * RIG.sensors.pressure_std)
    assert size_of(by_label["encoder zero, angle"], 4.0, RIG, minute) == pytest.approx(4.0)
    assert size_of(by_label["slack, width"], 16.0, RIG, minute) is None  # no allowed size does
    # a fault that adds a state begins with the joint as it is
    before = joint.x.copy()
    joint.change(by_label["creep 1, share"].applied(joint.p, 10.0))
    assert len(joint.x) > len(before) and np.array_equal(joint.x[: len(before)], before)
    assert np.isfinite(joint.run(1).pressure).all()


def test_alarms_have_their_poisson_interval_and_the_tail_is_exponential() -> None:
    largest = np.random.default_rng(1).exponential(2.0, 6000).tolist()
    searches = [[5, "leak", "confirmed", "x"], [500, "leak", "nothing", ""]]
    hours = [{"moving": True, "minutes": 6000, "largest": [largest, largest], "alarms": [searches, []],
              "processor_s": [3600.0, 7200.0]}]  # fmt: skip
    first, second = study.alarms(hours).rows
    assert first[:6] == ("moving", "100.0", "2", "0", "1", "0.00025 to 0.056") and first[7] == "1.0%"
    assert second[2:6] == ("0", "0", "0", "0 to 0.037")
    assert float(first[6]) == pytest.approx(2.0 * np.log(6000.0), rel=0.1)


def test_a_fault_is_found_if_it_is_first_or_among_those_alike() -> None:
    leak, offset, lag = (
        next(item for item in hypotheses(RIG, False) if item.label == label)
        for label in ("leak 1, area", "valve offset 1, voltage", "valve lag 1, time")
    )
    found = [
        MonitorFinding(item, 60.0, full, 0, 1.0, 1.0, 0.1) for item, full in ((offset, 60.0), (leak, 58.0), (lag, 30.0))
    ]
    by_label = {fault.label: fault for fault in faults(RIG)}
    right = [study._named(by_label[item.label], found) for item in (offset, leak, lag)]
    assert right == [True, True, False]
    one = {"fault": "leak 1, area", "noises": 8.0, "moving": True, "encoder": False, "found": True, "delay_s": 7}
    (row,) = study.detection([one, {**one, "delay_s": None, "found": False}]).rows
    assert row == ("leak 1, area", "– · 1/2 (7 s) · –", "– · – · –", "– · – · –", "– · – · –")
    total, *_ = study.begun([one, {**one, "delay_s": None}, {**one, "delay_s": 9, "found": False}]).rows
    assert total == ("moving", "0/0 · 2/3 · 0/0", "– · 8 · –", "0 · 2 · 0")
