"""The recorder node, which writes serialised messages without decoding them."""

from __future__ import annotations

import argparse
import math
import re
import shutil
import time
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

from rclpy.subscription import Subscription
from tqdm import tqdm
from typing_extensions import override

from pam_antagonist.errors import BadInput
from pam_antagonist.nodes import qos
from pam_antagonist.nodes.health import Health, Level, Rate, Rises, judged
from pam_antagonist.nodes.node import PamNode
from pam_antagonist.nodes.parameters import Parameter
from pam_antagonist.nodes.spin import run_node
from pam_antagonist.nodes.wire import Gaps, class_of, message_class, number_of, take
from pam_antagonist.program import typed
from pam_antagonist.recording.bag_files import FileLimits
from pam_antagonist.recording.signals import KINDS
from pam_antagonist.recording.topics import ALSO, TOPICS, Topic, normalize_namespace
from pam_antagonist.recording.writer import BagWriter

DESCRIPTION = """
Writes every topic of a pipeline, as it comes, into a rosbag2 bag (MCAP), with the time of reception.

It is a process of its own, and nothing waits for it: where the disk does not keep up, messages are dropped, counted and
reported. What is older than a second survives a kill or a power cut; such a bag has no metadata.yaml, and the commands
of this package read it as it is. A full disk ends the recording with status 2; what was written is kept.

options:
  --out DIR         folder of the bag; it must not exist
  --duration S      end after S seconds (default: on Ctrl-C)
  --max-size MB     begin a new file when the last one has so many megabytes (default: one file)
  --max-duration S  begin a new file after so many seconds (default: one file)
  --namespace /NS   record the joint in this namespace (default: that of this node); may be given several times

subscribes:  pressure_1, pressure_2, valve_state, valve_command, pressure_state, pressure_command, joint_estimate,
             joint_states, reference, angle_sensor, external_torque, measured/joint_states, measured/external_torque,
             rig, filter_checkpoint, health, /diagnostics; further signals of the joint, also/..., as they appear
"""

PARAMETERS: tuple[Parameter, ...] = ()  # beside those of every node

_MEGABYTE = 1_000_000
_NAMESPACE = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")


class _Parser(argparse.ArgumentParser):
    @override
    def error(self, message: str) -> NoReturn:
        raise BadInput(f"{message} (see {typed('record --help')})")


def read_options(arguments: list[str]) -> argparse.Namespace:
    """Read the arguments other than those of ROS; ``limits`` are those of a file of the bag."""
    parser = _Parser(prog="record", add_help=False, allow_abbrev=False)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--duration", type=float)
    parser.add_argument("--max-size", type=float)
    parser.add_argument("--max-duration", type=float)
    parser.add_argument("--namespace", action="append", default=[])
    given = parser.parse_args(arguments)
    _check("--duration", given.duration, 0.0, "seconds")
    _check("--max-duration", given.max_duration, 0.1, "seconds")
    _check("--max-size", given.max_size, 0.1, "megabytes")
    size = None if given.max_size is None else round(given.max_size * _MEGABYTE)
    given.namespace = list(map(normalize_namespace, given.namespace))
    for namespace in given.namespace:
        if not _NAMESPACE.fullmatch(namespace) or given.namespace.count(namespace) > 1:
            raise BadInput(f"--namespace {namespace or '/'}: expected a namespace such as /left/elbow, each once")
    given.limits = FileLimits(size, given.max_duration)
    return given


def _check(name: str, value: float | None, above: float, unit: str) -> None:
    if value is not None and not (math.isfinite(value) and value > above):
        raise BadInput(f"{name} {value}: expected a number of {unit} above {above:g}")


_KEPT = ("rig", "filter_checkpoint", "health")  # topics whose last messages are kept for late subscribers
_PERIOD = 0.02  # [s] time between two reads of the queues, which hold 250 times as much at 1 kHz
_LOOK = 0.5  # [s] time between two looks for further signals
_PROGRESS = 1.0  # [s] time between two updates of the progress line
_BACKLOG = 256 << 20  # [bytes] that may wait for a slow disk: five minutes of a pipeline at 1 kHz
_LITTLE_SPACE = 600.0  # [s] of recording that must fit on the disk; with less, there is a warning


class RecorderNode(PamNode):
    """Collects serialised messages in bulk, and hands them to the bag's thread.

    The node empties the middleware's queues fifty times a second. A callback for each of 7000 messages a second would
    take twice the processor time. The times of reception come from the middleware and stay exact.

    `options`: from :func:`read_options`. `node_options`: as :class:`PamNode`.
    """

    NAME, TABLE = "recorder", PARAMETERS

    def __init__(self, options: argparse.Namespace, **node_options: Any) -> None:
        self._options = options
        self._path: Path = options.out
        self._topics: dict[str, Subscription] = {}
        self._signals: list[Subscription] = []  # of further signals, which are found while recording
        self._counts: dict[str, int] = {}
        self._gaps: dict[str, Gaps] = {}
        self._reason: str | None = None  # why nothing more can be written
        self._ended = False
        self._rate, self._bytes_rate = Rate(), Rate()
        self._rises = Rises()
        self._since = time.monotonic()
        self._until = math.inf
        # Shown only on a terminal; /diagnostics reports the progress as well.
        self._line = tqdm(bar_format="{desc}", leave=False, disable=None)
        super().__init__(**node_options)

    @override
    def configure(self) -> None:
        self._bag = BagWriter(self._path, limits=self._options.limits, durable=True, backlog=_BACKLOG)
        self._ended = False
        for name, topic in self._wanted():
            self._add(name, topic.type)
        self.start_diagnostics(self._path.name)

    def _add(self, name: str, kind: str) -> None:
        self._bag.add_topic(name, kind)
        self._counts[name] = 0
        self._gaps[name] = Gaps(partial(self.count_publishers, name))

    def _wanted(self) -> Iterator[tuple[str, Topic]]:
        """Full name and description of each topic to record."""
        names: set[str] = set()
        for namespace in self._options.namespace or (None,):
            for topic in TOPICS.values():
                name = self.resolve_topic_name(topic.relative if namespace is None else topic.resolve(namespace))
                if name not in names:  # /diagnostics is one for all
                    names.add(name)
                    yield name, topic

    @override
    def activate(self) -> None:
        for name, topic in self._wanted():
            profile = qos.LATCHED if topic.name in _KEPT else qos.RECORD
            self._topics[name] = self.collect(message_class(topic.name), name, profile)
        self._since = time.monotonic()
        if self._options.duration is not None:
            self._until = self._since + self._options.duration
        self.steady_timer(_PERIOD, self._collect)
        self.steady_timer(_PROGRESS, self._show)
        self._look_for_signals()
        self.steady_timer(_LOOK, self._look_for_signals)
        self.get_logger().info(f"recording into {self._path}")

    @override
    def deactivate(self) -> None:
        if self._reason is None:
            self._collect()
        self._topics = {}
        for subscription in self._signals:
            self._unsubscribe(subscription)
        self._signals = []

    @override
    def cleanup(self) -> None:
        self._end_bag()

    def _look_for_signals(self) -> None:
        """Record the topics below ``also/`` that have come since the last look."""
        further = ALSO.rstrip("/")
        below = [
            self.resolve_topic_name(further if namespace is None else f"{normalize_namespace(namespace)}/{further}")
            + "/"
            for namespace in self._options.namespace or (None,)
        ]
        for name, kinds in self.get_topic_names_and_types():
            kind = next((one for one in kinds if one in KINDS), None)
            if kind is None or name in self._topics or not name.startswith(tuple(below)):
                continue
            self._add(name, kind)
            self._topics[name] = self.collect(class_of(kind), name, qos.RECORD)
            self._signals.append(self._topics[name])

    @property
    def lost(self) -> int:
        """Number of messages that did not come, or were not written."""
        return sum(gaps.missing for gaps in self._gaps.values()) + self._bag.dropped

    def _collect(self) -> None:
        for name, subscription in self._topics.items():
            items = []
            gaps = self._gaps[name]
            for data, about in take(subscription):
                gaps.add(number_of(about))
                items.append((name, about["received_timestamp"] or time.time_ns(), data))
            try:
                self._counts[name] += self._bag.write_many(items)
            except OSError as error:
                raise self._failed(error) from None
        if time.monotonic() >= self._until:
            self.finished = True

    def _failed(self, error: OSError) -> BadInput:
        """Store the reason of a failed write, and return the error."""
        why = error.strerror or str(error)
        if self._bag.kept is not None:
            why += f"; {self._bag.kept} of {sum(self._counts.values())} messages are kept and can be read"
        self._reason = why
        return BadInput(f"{self._path}: cannot be written: {why}")

    def _show(self) -> None:
        """Update the progress line."""
        if self._line.disable:
            return
        taken = f"{time.monotonic() - self._since:8.1f} s  {sum(self._counts.values())} messages  {self.lost} lost"
        written = f"{self._bag.size / 1e6:.1f} MB in {self._bag.files} file{'s' if self._bag.files > 1 else ''}"
        self._line.set_description_str(f"{taken}  {written}  (Ctrl-C ends)")

    @override
    def close(self) -> None:
        self._line.close()
        if self._reason is not None:
            self._diagnose()  # the last message of this node
        elif self._topics:
            self._collect()
        self._end_bag()

    def _end_bag(self) -> None:
        if self._ended or not self._counts:
            return
        self._ended = True
        try:
            self._bag.close()
        except OSError as error:
            raise self._failed(error) from None
        if self._reason is not None:
            return
        files = f" ({self._bag.files} files)" if self._bag.files > 1 else ""
        print(f"recorded {sum(self._counts.values())} messages into {self._path}{files}")
        width = max(map(len, self._counts))
        for topic, count in self._counts.items():
            missing = self._gaps[topic].missing
            print(f"  {topic.ljust(width)}  {count:9d}" + (f"  {missing} more were not received" if missing else ""))
        if self._bag.dropped:
            print(f"  {self._bag.dropped} messages were dropped, because the disk did not keep up")

    def _free(self) -> float:
        """Free space on the disk [bytes]; NaN where the folder is gone."""
        try:
            return float(shutil.disk_usage(self._path).free)
        except OSError:
            return math.nan

    @override
    def health(self, steady_ns: int) -> Mapping[str, Health]:
        total, size, lost = sum(self._counts.values()), self._bag.size, self.lost
        rate, growth = self._rate.take(total, steady_ns), self._bytes_rate.take(size, steady_ns)
        risen, free = self._rises.take(lost=lost)["lost"], self._free()
        left = free / growth if growth > 0.0 else math.inf
        values = {
            "rate [Hz]": f"{rate:.1f}",
            "messages": total,
            "never came": lost - self._bag.dropped,
            "dropped, disk too slow": self._bag.dropped,
            "waiting for the disk [kB]": self._bag.backlog // 1000,
            "written [MB]": f"{size / 1e6:.1f}",
            "files": self._bag.files,
            "free on the disk [MB]": f"{free / 1e6:.0f}",
            **self._counts,
        }
        bag = judged(
            values,
            "recording",
            (self._reason is not None, Level.ERROR, f"the recording has ended: {self._reason}"),
            (risen, Level.WARN, f"{risen} messages lost"),
            (total == 0, Level.WARN, "no message has come yet"),
            (left < _LITTLE_SPACE, Level.WARN, f"the disk will be full in {left:.0f} s"),
        )
        return {"bag": bag}


def main(argv: list[str] | None = None) -> int:
    """Run the node; see ``record --help``."""
    return run_node(RecorderNode, argv, name="record", description=DESCRIPTION, table=PARAMETERS, options=read_options)
