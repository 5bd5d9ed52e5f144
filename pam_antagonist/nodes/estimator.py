"""The estimator node."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from typing import Any

from std_srvs.srv import Trigger
from typing_extensions import override

from pam_antagonist.errors import BadInput
from pam_antagonist.estimation import Estimator
from pam_antagonist.estimation.memory import Checkpoint
from pam_antagonist.nodes import qos, wire
from pam_antagonist.nodes.further import SignalTopics, SignalValues
from pam_antagonist.nodes.health import Health, Level, Rate, Rises, Window, judged, too_slow
from pam_antagonist.nodes.node import PamNode
from pam_antagonist.nodes.pairing import PRESSURE_1, PRESSURE_2, VOLTAGES, WHOLE, Sample, SamplePairing
from pam_antagonist.nodes.parameters import (
    ANGLE_SENSORS,
    PRESSURE_SENSORS,
    SAMPLES,
    SIMULATED_JOINT,
    TOPIC_RATE,
    Parameter,
)
from pam_antagonist.nodes.sources import SampleSources, SourceFinding, several
from pam_antagonist.nodes.spin import run_node
from pam_antagonist.recording.topics import STATE_TOPICS, TOPICS
from pam_antagonist.shown import listed
from pam_antagonist_msgs.msg import FilterCheckpoint, JointEstimate
from pam_antagonist_msgs.srv import SetState

DESCRIPTION = """
Angle and torque of the joint, with their covariance, from the two muscle pressures and the valve voltages: the
unscented Kalman filter of the rig, one estimate for each sample, in the order of the stamps. It reads a measured angle
only where it is told to (angle_sensor: encoder), and never what is measured for validation.

subscribes:  pressure_1, pressure_2 (sensor_msgs/FluidPressure), valve_state (pam_antagonist_msgs/ValveCommand); with
             samples: one joint_sample (pam_antagonist_msgs/JointSample) in the place of all of these;
             angle_sensor (sensor_msgs/JointState, with angle_sensor: encoder); of a rig with drive: regulator
             pressure_state (pam_antagonist_msgs/PressureCommand) in the place of valve_state, and with
             pressure_sensors: none nothing else; of a rig with signals also/NAME (sensor_msgs/FluidPressure, JointState
             or Temperature)
publishes:   joint_estimate (pam_antagonist_msgs/JointEstimate), joint_states (sensor_msgs/JointState),
             external_torque (geometry_msgs/WrenchStamped, of a rig with that state), rig (std_msgs/String),
             filter_checkpoint (pam_antagonist_msgs/FilterCheckpoint, once a second)
services:    ~/reset (std_srvs/Trigger), ~/set_state (pam_antagonist_msgs/SetState), and those of a lifecycle node
"""

PARAMETERS = (
    *SIMULATED_JOINT,
    Parameter("tuning", "default", read_only=False).about(
        "name of one of the rig's filter tunings; a change starts the filter anew"
    ),
    Parameter("angle_sensor", "none", choices=ANGLE_SENSORS).about(
        "encoder: topic angle_sensor is an input as well, with noise and offset of the rig file's encoder"
    ),
    Parameter("pressure_sensors", "measured", choices=PRESSURE_SENSORS).about(
        "none: the filter uses the commanded pressures of the regulators and subscribes to no pressure topic; for a "
        "rig with drive: regulator"
    ),
    Parameter("pairing_timeout", 0.02, 0.001, 1.0).about("longest time that a sample waits for its other topics [s]"),
    SAMPLES,
    TOPIC_RATE,
    Parameter("max_age", 0.0, 0.001, 10.0, left=0.0).about(
        "age beyond which an estimate is flagged LATE, as is one of unknown age [s]; 0: three samples of the rig, at "
        "least 0.02"
    ),
)


_CHECKPOINT_PERIOD = 1.0  # [s]; at most this much at the start of a recording cannot be replayed bit for bit
_LONGEST_QUEUE = 2.0  # [s] that samples may have waited on a computer that is too slow
_CHECKS = 2  # checks for incomplete samples, within ``pairing_timeout``


class EstimatorNode(PamNode):
    """Pairs the messages of a sample, steps the filter and publishes one estimate for each sample, in order.

    Linked with the plant, which calls :meth:`sample`, it does not subscribe to the samples' topics. ``deliver`` is
    called with each estimate: stamp [ns], and the values of ``wire.ESTIMATE_FOR_CONTROL``.
    """

    NAME, TABLE = "estimator", PARAMETERS

    @override
    def configure(self) -> None:
        self._rig = rig = self.load_rig()
        values = self.values
        # Loads or compiles the filter, so that the first sample does not wait for it.
        self._estimator = self._make(values["tuning"])
        self._encoder = values["angle_sensor"] == "encoder"
        measured = values["pressure_sensors"] == "measured"
        self._one = values["samples"] == "one"
        self._inputs = wire.sample_inputs(
            rig.drive, values["joint_name"], encoder=self._encoder, pressures=measured, one=self._one
        )
        self._beside = wire.Thinned(values["topic_rate"] if self._one else 0.0)
        self._decode = {place: decode for place, (_, decode) in self._inputs.items()}
        signals = SignalValues(len(rig.signals)) if rig.signals else None
        self._pairing = SamplePairing(values["pairing_timeout"], topics=tuple(self._inputs), signals=signals)
        self._signals = SignalTopics(self, tuple(rig.signals), self._take_signal)
        names = {place: TOPICS[name].relative for place, (name, _) in self._inputs.items()}
        self._sources = None if self.linked else SampleSources(self, names, self._pairing, rig.sample_period)
        self._max_age = round(values["max_age"] * 1e9)
        self._published = self._late = 0
        self._latency, self._nis, self._rate = Window(), Window(), Rate()
        self._rises, self._filter_rises = Rises(), Rises()
        self._last: Sample | None = None
        self._unused: Sample | None = None  # the last one that the filter could not start with
        frame = values["frame_id"]
        self._estimates = wire.Outgoing(self, "joint_estimate", frame, wire.ESTIMATE)
        body, self._state_values = wire.joint_state(values["joint_name"], "position", "velocity", "effort")
        self._states = wire.Outgoing(self, "joint_states", frame, body)
        self._external: wire.Outgoing | None = None
        if self._estimator.estimates_external_torque:
            self._external = wire.Outgoing(self, "external_torque", frame, wire.WRENCH)
        self._complaint, self._mixed = "", False
        topic = TOPICS["filter_checkpoint"].relative
        self._checkpoints = self.create_publisher(FilterCheckpoint, topic, qos.LAST_ONE)
        self._remembered: tuple[int, int] | None = None
        self.serve(Trigger, "~/reset", self._reset)
        self.serve(SetState, "~/set_state", self._set_state)
        self.announce(rig)

    @override
    def activate(self) -> None:
        self._estimator.reset()
        self._pairing.reset()
        self._last = self._unused = None
        self.steady_timer(_CHECKPOINT_PERIOD, self._remember)
        self._signals.listen()
        if self.linked:
            return
        for place, (name, _) in self._inputs.items():
            kind, callback = wire.message_class(name), partial(self.take_message, place)
            self.create_subscription(kind, TOPICS[name].relative, callback, qos.STREAM, raw=True)
        self.steady_timer(self.values["pairing_timeout"] / _CHECKS, lambda: self._take(self._pairing.expire()))

    @override
    def deactivate(self) -> None:
        self._signals.close()

    def _remember(self) -> None:
        checkpoint = self._estimator.checkpoint()
        if checkpoint is None or (checkpoint.started_ns, checkpoint.stamp_ns) == self._remembered:
            return
        self._remembered = checkpoint.started_ns, checkpoint.stamp_ns
        self._checkpoints.publish(checkpoint_message(checkpoint, self.values["frame_id"]))

    def _make(self, tuning: str) -> Estimator:
        values = self.values
        return Estimator(self._rig, tuning, values["joint"], values["lock_angle"], values["angle_sensor"])

    def _reset(self, _request: Any) -> str:
        self._estimator.reset()
        words = "the filter starts with the next complete sample"
        self.get_logger().info(f"reset: {words}")
        return words

    def _set_state(self, request: Any) -> str:
        last = self._last
        if last is None:
            state = TOPICS[STATE_TOPICS[self._rig.drive]].relative
            raise BadInput(f"no sample has come that the state could belong to: expected pressures and {state}")
        first, second = map(float, request.pressure)
        voltage = (last.voltage_1, last.voltage_2)
        self._estimator.set_state(last.stamp_ns, request.angle, request.velocity, (first, second), voltage)
        self._remember()  # so that a replay knows the state
        words = (
            f"angle {request.angle:.4f} rad, velocity {request.velocity:.4f} rad/s, "
            f"pressures {first:.0f} and {second:.0f} Pa"
        )
        self.get_logger().info(f"state set: {words}")
        return words

    @override
    def change(self, changed: Mapping[str, Any]) -> None:
        if "tuning" in changed:  # the filter restarts at the next sample
            self._estimator = self._make(changed["tuning"])
            self.values["tuning"] = changed["tuning"]
            self._filter_rises = Rises()

    def sample(self, stamp_ns: int, p1: float, p2: float, u1: float, u2: float, angle: float = math.nan) -> None:
        """Take a sample of the plant in the same process: the values of a :class:`Sample`."""
        if self.active:
            self._take(self._pairing.whole(Sample(stamp_ns, p1, p2, u1, u2, angle)))

    def take_message(self, place: int, data: bytes) -> None:
        """Take a serialised message. `place`: of the topic in a :class:`Sample`."""
        self._take(self._pairing.add(place, *self._decode[place](data)))

    def _take_signal(self, signal: int, stamp_ns: int, value: float) -> None:
        self._take(self._pairing.add_signal(signal, stamp_ns, value))

    def _take(self, samples: list[Sample]) -> None:
        for sample in samples:
            if not math.isnan(sample.voltage_1 + sample.voltage_2):
                self._last = sample
            row = self._estimator.step_in_place(*sample)
            if row is None:
                self._unused = sample
                continue
            started = self._estimator.started_ns
            assert started is not None  # there is no row before the start
            age = self.ages.of(sample.stamp_ns)
            flags = int(row["flags"])
            if age > self._max_age or self._mixed:
                flags |= JointEstimate.LATE
                self._late += 1
            data = row.tobytes()
            numbers, external = data[: 8 * wire.ESTIMATE_VALUES], data[-8 * wire.EXTERNAL_VALUES :]
            subsystem = int(row["subsystem"])
            self._estimates.send(sample.stamp_ns, *divmod(started, 10**9), numbers, subsystem, flags, external)
            if self._beside.is_due(sample.stamp_ns):
                state = self._state_values(row["angle"], row["velocity"], row["torque"])
                self._states.send(sample.stamp_ns, *state)
            if self._external is not None:
                self._external.send(sample.stamp_ns, 0.0, 0.0, 0.0, 0.0, 0.0, row["external_torque"])
            self._published += 1
            if age < math.inf:
                self._latency.add(age)
            if not math.isnan(row["nis"]):
                self._nis.add(row["nis"])
            if self.deliver is not None:
                self.deliver(sample.stamp_ns, *wire.for_control(data, flags))

    @override
    def health(self, steady_ns: int) -> Mapping[str, Health]:
        pairing, counts, nis = self._pairing.counts, self._estimator.counts, self._nis.take()
        rate, age = self._rate.take(self._published, steady_ns), self._latency.take()
        risen = self._rises.take(late=self._late, incomplete=pairing.incomplete, jumps=pairing.restarts)
        late, incomplete = risen["late"], risen["incomplete"]
        filtered = self._filter_rises.take(**vars(counts))
        outliers = filtered["outliers"]
        samples = {
            "rate [Hz]": f"{rate:.1f}",
            "estimates": self._published,
            "late": self._late,
            "incomplete": pairing.incomplete,
            "messages too late for their sample": pairing.late,
            "duplicate messages": pairing.duplicates,
            "jumps backwards": pairing.restarts,
            **age.as_values("age", "ms", 1e6),
        }
        consistency = {
            "NIS median (expected 1.4)": f"{nis.median:.3f}",
            "NIS 99th percentile (expected 9.2)": f"{nis.p99:.3f}",
            **{name.replace("_", " "): value for name, value in vars(counts).items()},
        }
        complaint, many = self._estimator.complaint, nis.size and outliers > 0.05 * nis.size
        finding = self._sources.report(steady_ns) if self._sources else SourceFinding(Level.OK, "")
        self._mixed = finding.is_mixed
        second, waits, lacks = several(self, [TOPICS["joint_estimate"].relative]), self._waits_for(), finding.words
        counted = f"{late} late and {incomplete} incomplete samples"
        some = counted + (f": {lacks}" if incomplete and lacks else "")
        # A publisher that is not gone yet must not hide what else is wrong.
        found = f"{lacks}; {counted}" if late or incomplete else lacks
        return {
            **(self._encoder_health(filtered["angles_used"], filtered["angles_refused"]) if self._encoder else {}),
            **({"signals": self._signals.health(values.missing)} if (values := self._pairing.signals) else {}),
            "samples": judged(
                samples,
                "running",
                (second, Level.ERROR, second),
                (self._mixed, Level.ERROR, f"every estimate is flagged LATE: {finding.words}"),
                (finding.level is Level.ERROR, Level.ERROR, found),
                (risen["jumps"], Level.WARN, "the stamps jumped backwards: the filter started again"),
                (waits, Level.ERROR, f"the filter has not started: {waits}"),
                (rate == 0.0 or self._published == 0, Level.WARN, finding.words or "no samples"),
                (self.ages.trouble, Level.ERROR, f"every estimate is flagged LATE: {self.ages.trouble}"),
                (age.median > self._max_age, Level.WARN, self._old(age.median * 1e-9)),
                (late or incomplete, Level.WARN, some),
            ),
            "filter": judged(
                consistency,
                "plausible",
                (complaint, Level.ERROR, f"{complaint}: taken for missing"),
                (many, Level.WARN, f"{outliers} pressures were too far from the expected ones"),
            ),
        }

    def _old(self, age: float) -> str:
        """Why the samples are old, in words. `age`: of half of them, at least [s]."""
        period = self._rig.sample_period
        if age > max(_LONGEST_QUEUE, qos.STREAM.depth * period):
            return f"the samples are {age:.3g} s old: they are of a recording, or stamped by another clock"
        return too_slow(1.0 / period, f"half of them are {age * 1e3:.0f} ms old or more")

    def _waits_for(self) -> str:
        """What the filter needs to start, in words; empty where it runs, or where no sample has come."""
        if self._unused is None or self._estimator.started_ns is not None:
            return ""
        sample = self._unused
        values = {PRESSURE_1: sample.pressure_1, PRESSURE_2: sample.pressure_2}
        values[VOLTAGES] = sample.voltage_1 + sample.voltage_2
        values[WHOLE] = sum(values.values())
        lacks = [
            TOPICS[name].relative
            for place, (name, _) in self._inputs.items()
            if not math.isfinite(values.get(place, 0.0))
        ]
        return self._estimator.complaint or (f"the last sample has no number of {listed(lacks)}" if lacks else "")

    def _encoder_health(self, used: float, refused: float) -> dict[str, Health]:
        """Part ``encoder``: whether its angles are used or refused."""
        complaint, counts = self._estimator.encoder_complaint, self._estimator.counts
        if complaint and complaint != self._complaint:
            self.get_logger().error(f"{complaint}; the estimate goes on without it")
        self._complaint = complaint
        health = judged(
            {"used": counts.angles_used, "refused": counts.angles_refused},
            "used",
            (complaint, Level.ERROR, f"refused: {complaint}"),
            (not used, Level.WARN, "no angle was used"),
            (refused > 0.05 * used, Level.WARN, f"{refused} angles were too far from the expected ones"),
        )
        return {"encoder": health}


def checkpoint_message(checkpoint: Checkpoint, frame_id: str) -> FilterCheckpoint:
    """A checkpoint as a message, without what :mod:`pam_antagonist.recording` loads at its first message (0.1 s)."""
    out = FilterCheckpoint()
    wire.set_stamp(out.header.stamp, checkpoint.stamp_ns)
    wire.set_stamp(out.started, checkpoint.started_ns)
    out.header.frame_id = frame_id
    for name, value in vars(checkpoint.identity).items():
        setattr(out, name, list(value) if name == "added" else value)
    for name in ("state", "covariance", "cross", "angle_sensor"):
        setattr(out, name, getattr(checkpoint, name).ravel().tolist())
    out.voltage, out.distances, out.rejected = checkpoint.voltage, checkpoint.distances, checkpoint.rejected
    return out


def main(argv: list[str] | None = None) -> int:
    """Run the node; see ``estimator --help``."""
    return run_node(EstimatorNode, argv, name="estimator", description=DESCRIPTION, table=PARAMETERS)
