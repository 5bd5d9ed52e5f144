"""Plant, estimator, controller and recorder as processes, through a stall or with pushes; what the bag says then."""

from __future__ import annotations

import math
import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from pam_antagonist.estimation import ESTIMATE_DTYPE, Estimator
from pam_antagonist.nodes.processes import Processes, ros_arguments
from pam_antagonist.recording import Recording, read_bag
from pam_antagonist.replays import replay
from pam_antagonist.replays.accounting import Accounting, account
from pam_antagonist.rig import RigIdentity, fingerprint, load_rig

pytestmark = [pytest.mark.ros, pytest.mark.realtime]

PERIOD_NS = 1_000_000
STALL = 0.3
LATE = 64
NAMED = {"joint_name": "left_elbow"}


@dataclass(frozen=True)
class Run:
    recording: Recording
    account: Accounting
    statuses: dict[str, int]
    said: str
    topics_read_by_estimator: set[str]
    rigs_heard_late: list[str]
    joint_names: dict[str, set[str]]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory, module_domain: None) -> Run:
    """About 5 s at 1 kHz with two references; the whole pipeline, then the estimator alone, stopped for 0.3 s."""
    from probe import Probe
    from std_msgs.msg import String

    from pam_antagonist.nodes import qos
    from pam_antagonist.nodes.wire import take

    folder = tmp_path_factory.mktemp("pipeline")
    with Processes(folder) as processes, Probe("valve_command") as probe:
        processes.start("record", ["--out", str(folder / "bag")])
        processes.start("estimator", ros_arguments(NAMED, {}))
        # Stall and catching up take about as long as the usual ``resume_time``: after one that counts as longer the
        # voltages begin anew from the safe ones, and the joint has hardly moved at the end.
        processes.start("controller", ros_arguments({"resume_time": 10.0}, {}))
        given = {**NAMED, "mismatch": 0.01, "seed": 3, "wait_for_subscribers": 2}
        processes.start("plant", ros_arguments(given, {}))
        probe.until(lambda: probe.matched("reference", 2) and len(probe.seen["valve_command"]) > 200, 60.0, "a start")
        processes.check()
        probe.refer(0, 0.0)
        probe.wait(0.7)
        probe.refer(0, math.radians(10.0))
        probe.wait(1.5)
        for names in (tuple(processes.running), ("estimator",)):
            for number in (signal.SIGSTOP, signal.SIGCONT):
                for name in names:
                    processes.running[name].popen.send_signal(number)
                time.sleep(STALL if number == signal.SIGSTOP else 0.0)
            probe.wait(1.0)
        late: list[str] = []
        listener = probe.node.create_subscription(String, "rig", lambda message: None, qos.LATCHED)

        def heard() -> bool:
            late.extend(message.data for message, _ in take(listener))
            return len(late) >= 3

        probe.until(heard, 10.0, "what was said before")
        topics = {name for name, _ in probe.node.get_subscriber_names_and_types_by_node("estimator", "/pam")}
        processes.check()
        statuses = processes.stop("plant")
        time.sleep(0.3)
        statuses |= processes.stop("controller", "estimator", "record")
    recording = read_bag(folder / "bag")
    accounting = account(recording, 1e-3)
    assert accounting is not None
    said = (folder / "record.log").read_text()
    return Run(recording, accounting, statuses, said, topics, late, joint_names(folder / "bag"))


def joint_names(bag: Path) -> dict[str, set[str]]:
    """Names of the joints in each topic of type JointState."""
    types = get_typestore(Stores.ROS2_JAZZY)
    names: dict[str, set[str]] = {}
    with Reader(bag) as reader:
        ours = [connection for connection in reader.connections if connection.msgtype == "sensor_msgs/msg/JointState"]
        for connection, _, data in reader.messages(connections=ours):
            names.setdefault(connection.topic, set()).update(types.deserialize_cdr(data, connection.msgtype).name)
    return names


def test_every_process_ends_with_status_0_and_the_recording_needs_no_repair(run: Run) -> None:
    assert run.statuses == {"plant": 0, "controller": 0, "estimator": 0, "record": 0}
    assert run.recording.issues == () and os.listdir(run.recording.path)
    assert run.joint_names == {"/pam/joint_states": {"left_elbow"}, "/pam/measured/joint_states": {"left_elbow"}}


def test_every_sample_is_estimated_and_commanded_in_order_also_through_stalls(run: Run) -> None:
    """Fast DDS as it comes loses some of them: see config/fastdds.xml."""
    assert run.account.expected == run.account.latency.samples > 4000
    assert set(run.account.lost.values()) == set(run.account.out_of_order.values()) == {0}
    assert set(np.diff(run.recording.stamp_ns)) == {PERIOD_NS}
    assert 0.0 < run.account.latency.median < 20.0
    assert run.recording.estimate is not None
    assert set(run.recording.estimate.flags & 7) == {0}, "nothing is taken for missing that comes late"


def test_what_the_stall_held_up_is_flagged_late(run: Run) -> None:
    assert run.recording.estimate is not None
    late = run.recording.estimate.stamp_ns[run.recording.estimate.flags & LATE != 0]
    assert 100 <= len(late)
    # A machine that is busy elsewhere makes more of them; those of the stall are one stretch of samples.
    longest = max(np.diff(np.flatnonzero(np.diff(late) != PERIOD_NS), prepend=-1, append=len(late) - 1))
    assert longest >= 200


def test_replay_gives_the_very_bits_that_were_published(run: Run) -> None:
    live, recording = run.recording.estimate, run.recording
    assert live is not None
    first = int(np.searchsorted(recording.stamp_ns, live.started_ns[0]))
    assert recording.stamp_ns[first] == live.started_ns[0]
    pressure = recording.pressure.copy()
    for muscle in (0, 1):  # what the machine held up for longer than a sample waits, the estimator did without
        pressure[np.isin(recording.stamp_ns, live.stamp_ns[live.flags & 1 << muscle != 0]), muscle] = np.nan
    again = Estimator(load_rig("shin2022")).run(recording.stamp_ns[first:], pressure[first:], recording.voltage[first:])
    _, at_live, at_replay = np.intersect1d(live.stamp_ns, again.stamp_ns, return_indices=True)
    assert len(at_live) == len(live) > 3000
    for name in ESTIMATE_DTYPE.names or ():
        published = np.asarray(getattr(live, name), dtype=np.float64)[at_live]
        replayed = np.asarray(again.rows[name], dtype=np.float64)[at_replay]
        if name == "flags":
            published = (published.astype(int) & ~LATE).astype(np.float64)
        assert np.array_equal(published, replayed, equal_nan=True), name
    assert set(live.started_ns) == {live.started_ns[0]}


def test_joint_moves_towards_the_reference(run: Run) -> None:
    angle, estimate, voltage = run.recording.angle, run.recording.estimate, run.recording.voltage
    assert angle is not None and estimate is not None
    assert abs(angle[:200].mean()) < math.radians(1.0)
    assert angle[-200:].mean() > math.radians(4.0)
    assert abs(estimate.angle[-200:].mean() - angle[-200:].mean()) < math.radians(1.0)
    assert np.all((voltage >= 0.0) & (voltage <= 10.0))
    assert np.ptp(voltage[:, 0]) > 0.5  # something was asked for
    assert np.allclose(voltage.sum(axis=1), 11.0, atol=1e-9)  # the PI moves both valves by the same


def test_estimator_reads_nothing_that_is_measured_for_validation(run: Run) -> None:
    topics = {topic for topic in run.topics_read_by_estimator if topic.startswith("/pam/")}
    assert topics == {"/pam/pressure_1", "/pam/pressure_2", "/pam/valve_state"}


def test_every_node_says_its_rig_once_and_to_whoever_comes_late(run: Run) -> None:
    """A plant with a mismatch is the rig that its file declares."""
    told = {identity.node: identity for identity in map(RigIdentity.read, run.recording.rigs)}
    assert set(told) == {"plant", "estimator", "controller"} and len(run.recording.rigs) == 3
    assert {identity.fingerprint for identity in told.values()} == {fingerprint(load_rig("shin2022"))}
    assert sorted(run.rigs_heard_late) == sorted(run.recording.rigs)


def test_recorder_says_what_it_recorded(run: Run) -> None:
    lines = {line.split()[0]: int(line.split()[1]) for line in run.said.splitlines() if line.startswith("  /")}
    assert lines["/pam/pressure_1"] == len(run.recording.received_ns["pressure_1"].stamp_ns)
    assert lines["/pam/reference"] == 2
    assert lines["/pam/rig"] == 3
    assert lines["/pam/measured/external_torque"] == 0
    assert lines["/diagnostics"] >= 10


@pytest.mark.thorough(9)
def test_live_and_replay_agree_bit_by_bit_with_an_encoder(tmp_path: Path, module_domain: None) -> None:
    from pam_antagonist.nodes.client import ReferenceClient

    given = {"rig": "shin2022_external_torque", "angle_sensor": "encoder"}
    with Processes(tmp_path) as processes, ReferenceClient() as client:
        processes.start("record", ["--out", str(tmp_path / "bag")])
        processes.start("estimator", ros_arguments(given, {}))
        # Commands never come: the valves keep their safe voltages, and only the pushes move the joint.
        plant = {**given, "mismatch": 0.01, "seed": 3, "wait_for_subscribers": 2}
        processes.start("plant", ros_arguments(plant, {}))
        heard = ("joint_estimate", "measured_joint_states")
        processes.wait(lambda: "" if all(map(client.latest, heard)) and client.may_push() else "nobody to push")
        for torque in (0.0, 0.8, 0.0):
            client.push(torque)
            time.sleep(0.8)
        processes.stop("plant")
        time.sleep(0.3)
        processes.stop("estimator", "record")
    recording = read_bag(tmp_path / "bag")
    assert recording.angle_sensor is not None and recording.external_torque is not None
    done = replay(recording, load_rig(given["rig"]))
    live, external = done.report.live_equal, done.report.ukf.external_torque
    assert live is not None and live.equal == live.compared > 2000
    assert done.report.estimator.counts.angles_used > 2000
    assert external is not None and external.rmse < 0.15 and external.delay_s is not None
    assert external.coverage95 is not None and external.coverage95 > 0.9
    assert 0.0 <= external.delay_s <= 0.05
