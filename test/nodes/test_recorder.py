"""The recorder as a process: split files, a full disk, a kill; nobody else notices."""

from __future__ import annotations

import resource
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from pam_antagonist.nodes.processes import Process, Processes
from pam_antagonist.paths import config_dir
from pam_antagonist.recording.topics import TOPICS

pytestmark = pytest.mark.ros
NAMES = ("pressure_1", "pressure_2", "valve_state")
BAG = "pam/recorder: bag"


@pytest.fixture
def recording(tmp_path: Path, domain: None, request: pytest.FixtureRequest) -> Iterator[tuple[Any, Process]]:
    """A recorder, and the publishers of a rig that it listens to."""
    from probe import Probe

    with Processes(tmp_path) as processes, Probe("diagnostics") as probe:
        arguments = getattr(request, "param", [])
        process = processes.start("record", ["--out", str(tmp_path / "bag"), *arguments])
        probe.until(lambda: min(map(probe.matched, NAMES)), 60.0, "a recorder")
        probe.wait(0.3)
        yield probe, process


def publish(probe: Any, first: int, count: int) -> None:
    """Samples at 1 kHz, like a rig's."""
    from sensor_msgs.msg import FluidPressure

    from pam_antagonist.nodes.wire import set_stamp

    begin = time.monotonic()
    for k in range(first, first + count):
        for name in NAMES:
            message = probe.publisher(name).msg_type()
            set_stamp(message.header.stamp, 10**18 + k * 1_000_000)
            if isinstance(message, FluidPressure):
                message.fluid_pressure = 4e5 + k
            else:
                message.voltage = [5.0, 6.0]
            probe.publisher(name).publish(message)
        time.sleep(max(0.0, begin + (k - first + 1) * 1e-3 - time.monotonic()))


@pytest.mark.slow(4)
def test_a_full_disk_ends_the_recording_and_nothing_else(recording: tuple[Any, Process], tmp_path: Path) -> None:
    from pam_antagonist.recording import read_bag

    probe, process = recording
    resource.prlimit(process.popen.pid, resource.RLIMIT_FSIZE, (200_000, 200_000))
    for first in range(0, 20_000, 500):
        publish(probe, first, 500)
        if process.popen.poll() is not None:
            break
    assert process.popen.wait(5.0) == 2
    publish(probe, 20_000, 100)  # nobody waits for it
    said = process.last_words()
    assert "bag: cannot be written: File too large; " in said and "messages are kept and can be read" in said
    assert "Traceback" not in process.log.read_text()
    probe.until(lambda: probe.statuses(BAG)[-1].level == b"\2", 5.0, "an error on /diagnostics")
    assert "the recording has ended: File too large" in probe.statuses(BAG)[-1].message
    kept = read_bag(tmp_path / "bag")
    assert len(kept) > 300
    assert list(kept.pressure[:300, 0]) == [4e5 + k for k in range(300)]


@pytest.mark.slow(4)
@pytest.mark.parametrize("recording", [["--max-duration", "0.5"]], indirect=True)
def test_a_killed_recorder_leaves_its_files(recording: tuple[Any, Process], tmp_path: Path) -> None:
    from pam_antagonist.recording import read_bag

    probe, process = recording
    publish(probe, 0, 3000)
    process.popen.kill()
    process.popen.wait(5.0)
    assert len(list((tmp_path / "bag").glob("bag_*.mcap"))) >= 4
    kept = read_bag(tmp_path / "bag")
    assert len(kept) > 1500  # all but the last second, and what a busy machine was late with
    assert any("not closed" in issue for issue in kept.issues)
    assert list(kept.pressure[: len(kept) - 1, 0]) == [4e5 + k for k in range(len(kept) - 1)]


def test_a_recorder_that_is_shut_down_by_its_service_ends_with_a_whole_bag(
    recording: tuple[Any, Process], tmp_path: Path
) -> None:
    from pam_antagonist.recording import read_bag

    probe, process = recording
    publish(probe, 0, 300)
    probe.wait(0.3)
    assert probe.transition("recorder", "shutdown")
    assert process.popen.wait(10.0) == 0
    kept = read_bag(tmp_path / "bag")
    assert len(kept) >= 299 and not any("not closed" in issue for issue in kept.issues)


def test_what_never_came_is_counted(recording: tuple[Any, Process], tmp_path: Path) -> None:
    """While the recorder is stopped for longer than its queues are deep, it cannot but lose messages.

    The socket's queue is one of them. Its 8 MB are ten thousand small messages, but less than four thousand of 2 kB.
    """
    import signal

    from pam_antagonist.nodes import qos

    probe, process = recording
    publisher = probe.publisher("pressure_1")
    publish(probe, 0, 200)
    probe.until(lambda: bool(probe.statuses(BAG)), 5.0, "diagnostics")
    process.popen.send_signal(signal.SIGSTOP)
    message = publisher.msg_type()
    message.header.frame_id = "f" * 1500
    sent = qos.RECORD.depth + qos.STREAM.depth + 4000
    for k in range(sent):
        message.header.stamp.sec, message.header.stamp.nanosec = 1_000_000_001 + k // 1000, k % 1000 * 1_000_000
        publisher.publish(message)
    process.popen.send_signal(signal.SIGCONT)
    probe.wait(0.5)
    publish(probe, 20_000, 100)

    def last() -> dict[str, str]:
        return {value.key: value.value for value in probe.statuses(BAG)[-1].values}

    def counted() -> bool:
        lost, kept = int(last()["never came"]), int(last()["/pam/pressure_1"])
        return lost > 0 and lost + kept == 200 + sent + 100

    try:
        probe.until(counted, 20.0, "a count of what was lost")
    except AssertionError as error:
        log = process.log.read_text()
        raise AssertionError(f"{error}: {len(probe.statuses(BAG))} reports, the last {last()}, log {log}") from None
    process.popen.send_signal(signal.SIGINT)
    assert process.popen.wait(10.0) == 0
    line = next(line for line in process.log.read_text().splitlines() if "/pam/pressure_1" in line)
    recorded, missing = (int(word) for word in line.split() if word.isdigit())
    assert recorded + missing == 200 + sent + 100
    assert "more were not received" in line


def test_rosbag2_subscribes_as_record_does() -> None:
    from pam_antagonist.nodes import qos

    profiles = yaml.safe_load((config_dir() / "record_qos.yaml").read_text())
    assert set(profiles) == {topic.resolve("/pam") for topic in TOPICS.values()}
    ours = qos.RECORD
    expected = {
        "history": ours.history.name.lower(),
        "depth": ours.depth,
        "reliability": ours.reliability.name.lower(),
        "durability": ours.durability.name.lower(),
    }
    latched = {**expected, "depth": qos.LATCHED.depth, "durability": qos.LATCHED.durability.name.lower()}
    assert all(profiles.pop(f"/pam/{name}") == latched for name in ("rig", "filter_checkpoint", "health"))
    assert all(profile == expected for profile in profiles.values())


def test_the_documented_command_names_every_topic() -> None:
    text = (config_dir().parent / "docs" / "how-to" / "recording.md").read_text()
    command = text.partition("ros2 bag record --storage")[2].partition("\n\n")[0]
    assert {word for word in command.split() if word.startswith(("/pam/", "/diag"))} == {
        topic.resolve("/pam") for topic in TOPICS.values()
    }
