"""The monitor node: whether a running joint still is its rig file."""

from __future__ import annotations

import datetime
import json
import os
import subprocess
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from typing_extensions import override

from pam_antagonist.diagnosis.monitor import Alarms, Conclusion, Monitor, limits, searches
from pam_antagonist.diagnosis.monitor_blocks import WINDOW, MonitorFinding
from pam_antagonist.errors import BadInput
from pam_antagonist.nodes import qos, wire
from pam_antagonist.nodes.health import Health, Level, Rate, judged
from pam_antagonist.nodes.node import PamNode
from pam_antagonist.nodes.pairing import Feed
from pam_antagonist.nodes.parameters import ANGLE_SENSORS, SAMPLES, SIMULATED_JOINT, Parameter
from pam_antagonist.nodes.sources import SampleSources
from pam_antagonist.nodes.spin import run_node
from pam_antagonist.program import started
from pam_antagonist.recording.topics import TOPICS
from pam_antagonist_msgs.msg import Health as HealthMessage

DESCRIPTION = """
Whether a running joint still is its rig file: tests all the time whether an effect of the catalogue, or a wrong zero of
the encoder, explains the pressures better, and since when. What it finds, the search of close_loop has to find in the
last two minutes too, in a process of its own at low priority. It commands nothing (controller: stop_on).
--explain RIG prints what can be found, and needs no ROS.

subscribes:  pressure_1, pressure_2 (sensor_msgs/FluidPressure), valve_state (pam_antagonist_msgs/ValveCommand) or
             pressure_state (pam_antagonist_msgs/PressureCommand); angle_sensor (sensor_msgs/JointState, with
             angle_sensor: encoder); with samples: one joint_sample (pam_antagonist_msgs/JointSample) alone
publishes:   health (pam_antagonist_msgs/Health), rig (std_msgs/String)
services:    those of a lifecycle node
"""

PARAMETERS = (
    *SIMULATED_JOINT,
    SAMPLES,
    Parameter("angle_sensor", "none", choices=ANGLE_SENSORS).about("encoder: topic angle_sensor is read as well"),
    Parameter("folder", "monitor").about(
        "where the last two minutes before a finding go as a bag, and the report; each in a folder of its own"
    ),
    Parameter("log_book", True).about("whether a search writes into the rig's log book"),
    Parameter("search_time", 900.0, 1.0, 36000.0).about("longest time of a search; then it is given up [s]"),
)

_POLL = 0.2  # [s] between two reads of the samples


class Search:
    """A search in a process of its own, one at a time."""

    def __init__(self, order: Mapping[str, Any], stamps: Any, rows: Any, limit: float) -> None:
        self._files = tempfile.TemporaryDirectory(prefix="pam_monitor_")
        folder = Path(self._files.name)
        try:
            np.savez(folder / "buffer.npz", stamps=stamps, rows=rows)
            text = json.dumps({**order, "buffer": str(folder / "buffer.npz")})
            (folder / "order.json").write_text(text, encoding="utf-8")
        except OSError:
            self._files.cleanup()
            raise
        command = started("pam_antagonist", "monitor", "--search", str(folder / "order.json"))
        with (folder / "out").open("w") as out, (folder / "err").open("w") as err:
            self._process = subprocess.Popen(command, stdout=out, stderr=err, start_new_session=True)
        # Neither the estimator's time nor the controller's: this process gets what is left over.
        os.sched_setscheduler(self._process.pid, os.SCHED_IDLE, os.sched_param(0))
        os.setpriority(os.PRIO_PROCESS, self._process.pid, 19)
        self._until = time.monotonic() + limit

    def poll(self) -> tuple[dict[str, Any] | None, str] | None:
        """None while it runs; then what it found (None: nothing could be searched), and what it complained about."""
        code = self._process.poll()
        if code is None and time.monotonic() < self._until:
            return None
        text = "it took too long"
        found = None
        if code is not None:
            folder = Path(self._files.name)
            text = (folder / "err").read_text(errors="replace").strip()
            lines = (folder / "out").read_text(errors="replace").splitlines()
            found = json.loads(lines[-1]) if code == 0 and lines else None
        self.end()
        return found, text

    def end(self) -> None:
        """Stop it."""
        if self._process.poll() is None:
            self._process.kill()
            self._process.wait()
        self._files.cleanup()


class MonitorNode(PamNode):
    """Feeds a :class:`Monitor`, starts searches, and publishes what they find."""

    NAME, TABLE = "monitor", PARAMETERS
    _search: Search | None = None
    _found = _suspicion = ""

    @override
    def configure(self) -> None:
        self._rig = rig = self.load_rig()
        values = self.values
        self._encoder = encoder = values["angle_sensor"] == "encoder"
        if rig.valves.sealed:
            raise BadInput(f"rig {rig.name} is sealed: expected a joint that valves or regulators drive")
        self._monitor = Monitor(rig, values["joint"], values["lock_angle"], encoder)
        one = values["samples"] == "one"
        self._inputs = wire.sample_inputs(rig.drive, values["joint_name"], encoder=encoder, one=one)
        self._feed = Feed(tuple(self._inputs), float(WINDOW))
        names = {place: TOPICS[name].relative for place, (name, _) in self._inputs.items()}
        self._sources = SampleSources(self, names, self._feed.pairing, rig.sample_period)
        self._samples, self._rate, self._suspect, self._complaint = 0, Rate(), list[MonitorFinding](), ""
        self._health = self.create_publisher(HealthMessage, TOPICS["health"].relative, qos.LATCHED)
        self.announce(rig)

    @override
    def activate(self) -> None:
        self._feed.reset()
        self._monitor.reset()
        self._alarms, self._found, self._suspicion = Alarms(self._encoder), "", ""
        self._topics = {
            place: self.collect(wire.message_class(name), TOPICS[name].relative, qos.RECORD)
            for place, (name, _) in self._inputs.items()
        }
        self.steady_timer(_POLL, self._poll)
        if words := limits(self._rig, self._encoder):
            self.get_logger().warning(words)

    @override
    def deactivate(self) -> None:
        """End the search."""
        if self._search is not None:
            self._search.end()
            self._search = None

    @override
    def close(self) -> None:
        self.deactivate()

    def _poll(self) -> None:
        batches = {
            place: [self._inputs[place][1](data) for data, _ in wire.take(subscription)]
            for place, subscription in self._topics.items()
        }
        stamps, rows, back = self._feed.add(batches)
        if back:
            self.get_logger().warning("the stamps jumped backwards: all before is forgotten")
            self._monitor.reset()
            self.deactivate()
        if len(stamps):
            self._samples += len(stamps)
            self._monitor.add(stamps, rows[:, :2], rows[:, 2:4], rows[:, 4] if self._encoder else None)
        if self._search is None:
            self._look()
        elif (done := self._search.poll()) is not None:
            self._search = None
            self._conclude(*done)

    def _look(self) -> None:
        """Start a search where one is due."""
        findings = self._monitor.findings
        if not findings or not self._alarms.due(findings, self._feed.newest_ns, time.monotonic()):
            return
        self._suspect, first = findings, findings[0]
        if not searches(self._rig, self._encoder):
            self._conclude(None, "")
            return
        values = self.values
        began = datetime.datetime.now().strftime("%Y-%m-%d_%H-%M-%S")
        folder = Path(values["folder"]).expanduser().absolute() / self.get_namespace().strip("/") / began
        order = {
            "rig": values["rig"], "begin_ns": first.onset_ns, "folder": str(folder) if values["folder"] else "",
            "namespace": self.get_namespace(), "joint": values["joint"], "lock_angle": values["lock_angle"],
            "log": values["log_book"],
        }  # fmt: skip
        try:
            self._search = Search(order, *self._feed.kept, values["search_time"])
        except OSError as error:  # no space for the buffer, or no process
            self._conclude(None, f"no search: {error}")

    def _conclude(self, found: Mapping[str, Any] | None, complaint: str) -> None:
        """Publish what a search found, or what it could not search for."""
        self._complaint = complaint
        if complaint:
            self.get_logger().warning(f"search: {complaint.splitlines()[-1]}")
        said = self._alarms.concluded(self._suspect, found, time.monotonic())
        self._suspicion = "" if said is None or said.confirmed else said.sentence
        if said is None:
            self.get_logger().debug(f"not confirmed: {self._suspect[0].watched.label}")
            return
        if said.confirmed:
            self.get_logger().warning(said.sentence)
            self._found = said.sentence
            self._monitor.blocks.accept(said.finding)
            self._publish(said)
        else:
            self.get_logger().info(said.sentence)

    def _publish(self, said: Conclusion) -> None:
        item = said.finding.watched
        message = HealthMessage(
            name=item.name, muscle=item.muscle or 0, onset_std=said.finding.onset_std, parameter=item.parameter,
            unit=item.unit, size=said.size, std=said.std, evidence=said.finding.full,
            ambiguous_with=list(said.ambiguous_with), sentence=said.sentence,
        )  # fmt: skip
        wire.set_stamp(message.header.stamp, self._feed.newest_ns or said.finding.onset_ns)
        wire.set_stamp(message.since, said.finding.onset_ns)
        message.header.frame_id = self.values["frame_id"]
        self._health.publish(message)

    @override
    def health(self, steady_ns: int) -> Mapping[str, Health]:
        findings, rate = self._monitor.findings, self._rate.take(self._samples, steady_ns)
        values: dict[str, object] = {
            "rate [Hz]": f"{rate:.1f}", "blocks": self._monitor.blocks.count, "jumps backwards": self._feed.jumps,
            "searching": self._search is not None, "last search": self._complaint or "no complaint",
            "cannot": limits(self._rig, self._encoder) or "nothing", "suspicion": self._suspicion or "none",
        }  # fmt: skip
        if findings:
            values |= {"nearest": findings[0].watched.name, "its evidence": f"{findings[0].evidence:.1f}"}
        finding = self._sources.report(steady_ns)
        joint = judged(
            values,
            "as its rig file" if self._monitor.blocks.count else "not known yet",
            (finding.level is Level.ERROR, Level.ERROR, finding.words),
            (self._found, Level.WARN, self._found),
            (rate == 0.0 or not self._samples, Level.WARN, finding.words or "no samples"),
            (self._suspicion, Level.OK, self._suspicion),
        )
        return {"joint": joint}


def main(argv: list[str] | None = None) -> int:
    """Run the node; see ``monitor --help``."""
    return run_node(MonitorNode, argv, name="monitor", description=DESCRIPTION, table=PARAMETERS)
