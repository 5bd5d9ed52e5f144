"""The estimator node."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from geometry_msgs.msg import WrenchStamped
from rcl_interfaces.msg import SetParametersResult
from sensor_msgs.msg import FluidPressure, JointState
from std_srvs.srv import Trigger
from typing_extensions import override

from pam_antagonist._jit import COMPILING
from pam_antagonist.errors import BadInput
from pam_antagonist.estimation import Counts, Estimator
from pam_antagonist.estimation.checkpoint import Checkpoint
from pam_antagonist.nodes import qos, wire
from pam_antagonist.nodes.health import Health, Level, Rate, Window
from pam_antagonist.nodes.node import PamNode
from pam_antagonist.nodes.pairing import ANGLE, PRESSURE_1, PRESSURE_2, VALVES, Sample, SamplePairing
from pam_antagonist.nodes.parameters import (
    ANGLE_SENSORS,
    FRAME,
    JOINT,
    JOINT_NAME,
    LOCK_ANGLE,
    PRESSURE_SENSORS,
    RIG,
    Parameter,
    check_pressure_sensors,
)
from pam_antagonist.nodes.rigs import announce
from pam_antagonist.nodes.spin import run_node
from pam_antagonist.nodes.valve_port import topics_of
from pam_antagonist.recording.topics import TOPICS
from pam_antagonist.rig import load_rig
from pam_antagonist_msgs.msg import FilterCheckpoint, JointEstimate
from pam_antagonist_msgs.srv import SetState

DESCRIPTION = """
Angle and torque of the joint, with their covariance, from the two muscle pressures and the valve voltages: the
unscented Kalman filter of the rig, one estimate for each sample, in the order of the stamps. It reads a measured angle
only where it is told to (angle_sensor: encoder), and never what is measured for validation.

subscribes:  pressure_1, pressure_2 (sensor_msgs/FluidPressure), valve_state (pam_antagonist_msgs/ValveCommand);
             angle_sensor (sensor_msgs/JointState, with angle_sensor: encoder); of a rig with drive: regulator
             pressure_state (pam_antagonist_msgs/PressureCommand) in the place of valve_state, and with
             pressure_sensors: none nothing else
publishes:   joint_estimate (pam_antagonist_msgs/JointEstimate), joint_states (sensor_msgs/JointState),
             external_torque (geometry_msgs/WrenchStamped, of a rig with that state), rig (std_msgs/String),
             filter_checkpoint (pam_antagonist_msgs/FilterCheckpoint, once a second)
services:    ~/reset (std_srvs/Trigger), ~/set_state (pam_antagonist_msgs/SetState), and those of a lifecycle node
"""

PARAMETERS = (
    RIG,
    JOINT,
    LOCK_ANGLE,
    JOINT_NAME,
    FRAME,
    Parameter(
        "tuning",
        "default",
        "name of one of the rig's filter tunings; a change starts the filter anew",
        read_only=False,
    ),
    Parameter(
        "angle_sensor",
        "none",
        "encoder: topic angle_sensor is an input as well, with noise and offset of the rig file's encoder",
        choices=ANGLE_SENSORS,
    ),
    Parameter(
        "pressure_sensors",
        "measured",
        "none: the filter uses the commanded pressures of the regulators and subscribes to no pressure topic; for a "
        "rig with drive: regulator",
        choices=PRESSURE_SENSORS,
    ),
    Parameter("pairing_timeout", 0.02, "longest time that a sample waits for its other topics [s]", 0.001, 1.0),
    Parameter(
        "max_age",
        0.0,
        "age beyond which an estimate is flagged LATE [s]; 0: three samples of the rig, at least 0.02",
        0.001,
        10.0,
        left=0.0,
    ),
)


_CHECKPOINT_PERIOD = 1.0  # [s]; at most this much at the start of a recording cannot be replayed bit for bit
_CHECKS = 2  # checks for incomplete samples, within ``pairing_timeout``

_TUNING = next(parameter for parameter in PARAMETERS if parameter.name == "tuning")


class EstimatorNode(PamNode):
    """Pairs the messages of a sample, steps the filter and publishes one estimate for each sample, in order.

    `linked`: whether the plant is in the same process and calls :meth:`sample`; then the node does not subscribe to the
    samples' topics. `options`: as :class:`PamNode`.
    """

    # called with each estimate: stamp [ns], and the values of ``wire.ESTIMATE_FOR_CONTROL``; None: not called.
    deliver: Callable[..., None] | None = None

    def __init__(self, *, linked: bool = False, **options: Any) -> None:
        self._linked = linked
        super().__init__("estimator", PARAMETERS, **options)

    @override
    def configure(self) -> None:
        values = self.values
        COMPILING.tell = self.get_logger().info
        self._rig = rig = load_rig(values["rig"], regulators=True)
        values = self.with_rig(rig)
        # Loads or compiles the filter, so that the first sample does not wait for it.
        self._estimator = self._make(values["tuning"])
        self._encoder = values["angle_sensor"] == "encoder"
        check_pressure_sensors(values["pressure_sensors"], rig)
        self._measured = values["pressure_sensors"] == "measured"
        pressures = (PRESSURE_1, PRESSURE_2) if self._measured else ()
        topics = (*pressures, VALVES, *((ANGLE,) if self._encoder else ()))
        self._pairing = SamplePairing(values["pairing_timeout"], self.now_ns, topics=topics)
        self._max_age = round(values["max_age"] * 1e9)
        self._published = self._late = self._late_before = 0
        self._latency, self._nis, self._rate = Window(), Window(), Rate()
        self._last: Sample | None = None
        self._before = (self._estimator.counts, self._pairing.counts.incomplete, 0)
        frame = values["frame_id"]
        name = TOPICS["joint_estimate"].relative
        self._estimates = wire.Outgoing(self, JointEstimate, name, frame, wire.ESTIMATE)
        body, self._state_values = wire.joint_state(values["joint_name"], velocity=True)
        self._states = wire.Outgoing(self, JointState, TOPICS["joint_states"].relative, frame, body)
        self._external: wire.Outgoing | None = None
        if self._estimator.estimates_external_torque:
            name = TOPICS["external_torque"].relative
            self._external = wire.Outgoing(self, WrenchStamped, name, frame, wire.WRENCH)
        self._complaint = ""
        topic = TOPICS["filter_checkpoint"].relative
        self._checkpoints = self.create_publisher(FilterCheckpoint, topic, qos.LAST_ONE)
        self._remembered: tuple[int, int] | None = None
        self._pressure, self._valves = wire.Incoming(wire.PRESSURE), wire.Incoming(wire.VALVES)
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_service(SetState, "~/set_state", self._on_set_state)
        self.add_on_set_parameters_callback(self._on_parameters)
        announce(self, rig)
        self.start_diagnostics(values["joint_name"])

    @override
    def cleanup(self) -> None:
        self.remove_on_set_parameters_callback(self._on_parameters)

    @override
    def activate(self) -> None:
        self._estimator.reset()
        self._pairing.reset()
        self._last = None
        self.steady_timer(_CHECKPOINT_PERIOD, self._remember)
        if self._linked:
            return
        driven = topics_of(self._rig)
        if self._measured:
            for name, callback in (("pressure_1", self._on_pressure_1), ("pressure_2", self._on_pressure_2)):
                self.create_subscription(FluidPressure, TOPICS[name].relative, callback, qos.STREAM, raw=True)
        self.create_subscription(driven.message, driven.state, self._on_valves, qos.STREAM, raw=True)
        if self._encoder:
            name = TOPICS["angle_sensor"].relative
            self.create_subscription(JointState, name, self._on_angle, qos.STREAM, raw=True)
        self.steady_timer(self.values["pairing_timeout"] / _CHECKS, lambda: self._take(self._pairing.expire()))

    def _remember(self) -> None:
        checkpoint = self._estimator.checkpoint()
        if checkpoint is None or (checkpoint.started_ns, checkpoint.stamp_ns) == self._remembered:
            return
        self._remembered = checkpoint.started_ns, checkpoint.stamp_ns
        self._checkpoints.publish(checkpoint_message(checkpoint, self.values["frame_id"]))

    def _make(self, tuning: str) -> Estimator:
        values = self.values
        return Estimator(self._rig, tuning, values["joint"], values["lock_angle"], values["angle_sensor"])

    def _on_reset(self, _request: Any, response: Any) -> Any:
        self._estimator.reset()
        response.success, response.message = True, "the filter starts with the next complete sample"
        self.get_logger().info(f"reset: {response.message}")
        return response

    def _on_set_state(self, request: Any, response: Any) -> Any:
        last = self._last
        try:
            if last is None:
                state = topics_of(self._rig).state
                raise BadInput(f"no sample has come that the state could belong to: expected pressures and {state}")
            pressure = (float(request.pressure[0]), float(request.pressure[1]))
            voltage = (last.voltage_1, last.voltage_2)
            self._estimator.set_state(last.stamp_ns, request.angle, request.velocity, pressure, voltage)
        except BadInput as error:
            response.success, response.message = False, str(error)
        else:
            self._remember()  # so that a replay knows the state
            response.success = True
            response.message = (
                f"angle {request.angle:.4f} rad, velocity {request.velocity:.4f} rad/s, "
                f"pressures {pressure[0]:.0f} and {pressure[1]:.0f} Pa"
            )
            self.get_logger().info(f"state set: {response.message}")
        return response

    def _on_parameters(self, changed: list[Any]) -> SetParametersResult:
        """Change the tuning; the filter restarts at the next sample."""
        for parameter in changed:
            if parameter.name == "tuning":
                try:
                    tuning = _TUNING.check(parameter.value)
                    self._estimator = self._make(str(tuning))
                except BadInput as error:
                    return SetParametersResult(successful=False, reason=str(error))
                self.given["tuning"] = self.values["tuning"] = tuning
                self._before = (self._estimator.counts, *self._before[1:])
        return SetParametersResult(successful=True)

    def sample(
        self, stamp_ns: int, pressure_1: float, pressure_2: float, voltage_1: float, voltage_2: float, angle: float
    ) -> None:
        """Take a sample of the plant in the same process.

        Args:
            stamp_ns: its stamp [ns].
            pressure_1: absolute, NaN where missing [Pa].
            voltage_1: on valve 1 over the sample that ends at the stamp [V].
            voltage_2: on valve 2 [V].
            angle: as the encoder reads it, NaN where missing [rad].
        """
        if not self.active:
            return
        self._take(self._pairing.whole(Sample(stamp_ns, pressure_1, pressure_2, voltage_1, voltage_2, angle)))

    def _on_pressure_1(self, data: bytes) -> None:
        stamp_ns, pressure, _ = self._pressure(data)
        self._take(self._pairing.add(PRESSURE_1, stamp_ns, pressure))

    def _on_pressure_2(self, data: bytes) -> None:
        stamp_ns, pressure, _ = self._pressure(data)
        self._take(self._pairing.add(PRESSURE_2, stamp_ns, pressure))

    def _on_valves(self, data: bytes) -> None:
        stamp_ns, first, second = self._valves(data)
        self._take(self._pairing.add(VALVES, stamp_ns, first, second))

    def _on_angle(self, data: bytes) -> None:
        stamp_ns, angle = wire.position_in(data, self.values["joint_name"])
        self._take(self._pairing.add(ANGLE, stamp_ns, angle))

    def _take(self, samples: list[Sample]) -> None:
        for sample in samples:
            if not math.isnan(sample.voltage_1 + sample.voltage_2):
                self._last = sample
            row = self._estimator.step_in_place(*sample)
            if row is None:
                continue
            started = self._estimator.started_ns
            assert started is not None  # there is no row before the start
            age = self.now_ns() - sample.stamp_ns
            flags = int(row["flags"])
            if age > self._max_age:
                flags |= JointEstimate.LATE
                self._late += 1
            data = row.tobytes()
            numbers, external = data[: 8 * wire.ESTIMATE_VALUES], data[-8 * wire.EXTERNAL_VALUES :]
            subsystem = int(row["subsystem"])
            self._estimates.send(sample.stamp_ns, *divmod(started, 10**9), numbers, subsystem, flags, external)
            state = self._state_values(row["angle"], row["velocity"], row["torque"])
            self._states.send(sample.stamp_ns, *state)
            if self._external is not None:
                self._external.send(sample.stamp_ns, 0.0, 0.0, 0.0, 0.0, 0.0, row["external_torque"])
            self._published += 1
            self._latency.add(age)
            if not math.isnan(row["nis"]):
                self._nis.add(row["nis"])
            if self.deliver is not None:
                self.deliver(sample.stamp_ns, *wire.for_control(data, flags))

    def _encoder_health(self, now: Counts, before: Counts) -> dict[str, Health]:
        """Part ``encoder`` where one is used: whether its angles are used or refused."""
        if not self._encoder:
            return {}
        complaint = self._estimator.encoder_complaint
        if complaint and complaint != self._complaint:
            self.get_logger().error(f"{complaint}; the estimate goes on without it")
        self._complaint = complaint
        used, refused = (getattr(now, name) - getattr(before, name) for name in ("angles_used", "angles_refused"))
        if complaint:
            state = Health(Level.ERROR, f"refused: {complaint}")
        elif not used:
            state = Health(Level.WARN, "no angle was used")
        elif refused > 0.05 * used:
            state = Health(Level.WARN, f"{refused} angles were too far from the expected ones")
        else:
            state = Health(Level.OK, "used")
        values = {"used": now.angles_used, "refused": now.angles_refused}
        return {"encoder": Health(state.level, state.message, values)}

    @override
    def health(self, steady_ns: int) -> Mapping[str, Health]:
        rate = self._rate.take(self._published, steady_ns)
        pairing, counts = self._pairing.counts, self._estimator.counts
        counts_before, incomplete_before, jumps_before = self._before
        self._before = (counts, pairing.incomplete, pairing.restarts)
        late, self._late_before = self._late - self._late_before, self._late
        incomplete = pairing.incomplete - incomplete_before
        nis = self._nis.take()
        if pairing.restarts > jumps_before:
            filtering = Health(Level.WARN, "the stamps jumped backwards: the filter started again")
        elif rate == 0.0 or self._published == 0:
            filtering = Health(Level.WARN, "no samples")
        elif late or incomplete:
            filtering = Health(Level.WARN, f"{late} late and {incomplete} incomplete samples")
        else:
            filtering = Health(Level.OK, "running")
        rejected = counts.outliers - counts_before.outliers
        consistency = Health(Level.OK, "plausible")
        if nis.count and rejected > 0.05 * nis.count:
            consistency = Health(Level.WARN, f"{rejected} pressures were too far from the expected ones")
        if self._estimator.complaint:
            consistency = Health(Level.ERROR, f"{self._estimator.complaint}: taken for missing")
        return {
            **self._encoder_health(counts, counts_before),
            "samples": Health(
                filtering.level,
                filtering.message,
                {
                    "rate [Hz]": f"{rate:.1f}",
                    "estimates": self._published,
                    "late": self._late,
                    "incomplete": pairing.incomplete,
                    "messages too late for their sample": pairing.late,
                    "duplicate messages": pairing.duplicates,
                    "jumps backwards": pairing.restarts,
                    **self._latency.take().as_values("age", "ms", 1e6),
                },
            ),
            "filter": Health(
                consistency.level,
                consistency.message,
                {
                    "NIS median (expected 1.4)": f"{nis.median:.3f}",
                    "NIS 99th percentile (expected 9.2)": f"{nis.p99:.3f}",
                    **{name.replace("_", " "): value for name, value in vars(counts).items()},
                },
            ),
        }


def checkpoint_message(checkpoint: Checkpoint, frame_id: str) -> FilterCheckpoint:
    """A checkpoint as a message."""
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
