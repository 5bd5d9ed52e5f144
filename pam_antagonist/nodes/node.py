"""Base class of the nodes."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from typing import TYPE_CHECKING, Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.exceptions import InvalidParameterTypeException
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.subscription import Subscription
from std_msgs.msg import String

from pam_antagonist._jit import COMPILING
from pam_antagonist.errors import BadInput
from pam_antagonist.nodes import qos
from pam_antagonist.nodes.ages import LOOK, Ages
from pam_antagonist.nodes.health import DiagnosticsPublisher, Health, Level, connections
from pam_antagonist.nodes.parameters import AUTOSTART, DIAGNOSTICS_PERIOD, Parameter, by_rig, declare
from pam_antagonist.recording.topics import DEFAULT_NAMESPACE, TOPICS
from pam_antagonist.rig import Rig, RigIdentity, load_rig

if TYPE_CHECKING:
    from pam_antagonist.nodes.joints import SharedTimers

_ANSWER = 0.5  # [s] from a shutdown request to the end of the process, so that the answer can be sent

SHARED_PARAMETERS = (
    *("rig", "joint", "joint_name", "lock_angle", "frame_id", "tuning", "max_age"),
    *("safe_voltage", "safe_action", "vent_voltage", "vent_rate", "command_timeout", "max_command_age"),
    *("max_slew", "max_pressure", "samples", "topic_rate"),
)
"""Parameters that a parameter file may set for all nodes of a pipeline, also for nodes that do not have them."""

RIG_TOPIC = TOPICS["rig"].relative

JOINTS_PARAMETERS = ("joints", "source")
"""Parameters of the executable ``joints``; on its command line they reach every node of the process."""


class _Gate:
    """Passes calls on until it is closed, because an executor may still have a timer or a message in its queue."""

    __slots__ = ("callback", "open")

    def __init__(self, callback: Callable[..., object]) -> None:
        self.callback = callback
        self.open = True

    def __call__(self, *message: Any) -> None:
        if self.open:
            self.callback(*message)

    def close(self) -> None:
        """Pass nothing on from now on."""
        self.open = False


class PamNode(LifecycleNode):  # type: ignore[misc]
    """A managed node with checked parameters and diagnostics.

    A node overrides :meth:`configure`, :meth:`activate`, :meth:`deactivate`, :meth:`cleanup` as needed. Each may raise
    ``BadInput``; the transition then fails, and the log gives the reason. With ``autostart`` (the default) the node
    configures itself when it is made, and activates itself right before spinning. Timers, publishers, subscriptions and
    services that a transition makes by this class's methods are destroyed in the opposite transition.

    Timers run on the steady clock, so that a jump of the system clock cannot stop them. Times that are compared with
    stamps come from the node's clock, which follows ``use_sim_time``; :attr:`ages` judges whether that clock runs.

    Publishers are plain ones, and the callers make sure that an inactive node is silent. A ``LifecyclePublisher`` would
    check its state again for each of 4000 messages a second.

    Args:
        linked: whether the node that this one listens to is in the same process and calls it, in place of a topic.
        timers: gets the node's steady timers; None: they belong to the executor.
        also_known: names of other nodes' parameters, which are accepted and ignored.
        options: of ``rclpy.node.Node``, such as ``namespace``, ``context``, ``cli_args`` or ``parameter_overrides``.
    """

    NAME: str  # of the node, unless it is remapped
    TABLE: Sequence[Parameter]  # its own parameters
    finished = False  # set when the node has finished, or was shut down by its lifecycle service
    active = configured = False
    members: Sequence[PamNode] = ()  # nodes in the same executor that start and end with this one
    loop_timers: SharedTimers | None = None  # of these nodes, called by the loop around the executor
    joint_namespaces: Sequence[str] = ()  # of the joints that this node has started
    deliver: Callable[..., None] | None = None  # the next node of the same process is called with each result

    def __init__(
        self,
        *,
        linked: bool = False,
        timers: SharedTimers | None = None,
        also_known: Sequence[str] = (),
        **options: Any,
    ) -> None:
        self.linked = linked
        self._timers_shared = timers
        self._collected: dict[str, Subscription] = getattr(self, "_collected", {})
        # What was made in a transition is destroyed in the opposite one.
        self._owned = {"configured": ExitStack(), "active": ExitStack()}
        self._reaching: str | None = None  # which transition is under way
        self._transition_error: BaseException | None = None
        self.about_rig: dict[str, str] = {}  # name and fingerprint of the rig for ``/diagnostics``
        self._rig_in_use: tuple[str, ...] = ()  # the same for the log
        try:
            super().__init__(self.NAME, **{"namespace": DEFAULT_NAMESPACE, **options})
        except InvalidParameterTypeException as error:  # a parameter of ROS itself: use_sim_time
            raise BadInput(f"node {self.NAME}: {error}") from None
        known = (*SHARED_PARAMETERS, *JOINTS_PARAMETERS, *also_known)
        self._table = {parameter.name: parameter for parameter in (*self.TABLE, AUTOSTART, DIAGNOSTICS_PERIOD)}
        self.given: dict[str, Any] = declare(self, tuple(self._table.values()), known)
        self.values = dict(self.given)  # the same, and filled in what is left to the rig file
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._ros_clock = self.get_clock()
        self.ages = Ages(self)
        self._clock_failed = self._told_ahead = False
        self.steady_timer(LOOK, self._look_at_clock)
        self.add_on_set_parameters_callback(self._on_parameters)
        if self.values["autostart"]:
            self._require(self.trigger_configure)

    # ---------------------------------------------------------------- for the nodes

    def configure(self) -> None:
        """Read files, compile, make publishers and services. Slow work belongs here."""

    def activate(self) -> None:
        """Make subscriptions and timers. Called after all slow work is done.

        Messages of earlier subscriptions would pile up and come late.
        """

    def deactivate(self) -> None:
        """Send last messages, before subscriptions and timers are destroyed."""

    def cleanup(self) -> None:
        """Undo :meth:`configure`, except for entities of ROS, which are destroyed automatically."""

    def close(self) -> None:
        """Send last messages while the context still exists. Called once, before the node is destroyed."""

    def change(self, changed: Mapping[str, Any]) -> None:
        """Apply parameters that were changed while the node is configured, all or none."""

    @property
    def simulated(self) -> bool:
        """Whether the node's clock is ``/clock`` now."""
        return bool(self._ros_clock.ros_time_is_active)

    def check_time(self, simulated: bool) -> None:
        """Whether the node can follow ``/clock``, if it is to; ``BadInput`` where it cannot."""

    def health(self, steady_ns: int) -> Mapping[str, Health]:
        """Health of each part; called every ``diagnostics_period`` after :meth:`start_diagnostics`.

        `steady_ns`: steady time [ns].
        """
        raise NotImplementedError

    def load_rig(self) -> Rig:
        """The rig of the parameters; what they leave to it is filled in in :attr:`values`."""
        COMPILING.tell = self.get_logger().info
        rig = load_rig(self.given["rig"], regulators=True)
        self.values = by_rig(self.given, rig)
        return rig

    def announce(self, rig: Rig) -> RigIdentity:
        """Publish the node's rig on the topic ``rig``, also for late subscribers, and its health from now on."""
        identity = RigIdentity.of(rig, self.get_name())
        self.create_publisher(String, RIG_TOPIC, qos.LATCHED).publish(String(data=identity.text()))
        self._rig_in_use = (str(identity),)
        self.about_rig = {"rig": identity.name, "fingerprint of the rig": identity.fingerprint}
        self.start_diagnostics(self.values["joint_name"])
        return identity

    def start_diagnostics(self, hardware_id: str) -> None:
        """Publish :meth:`health` periodically from now on."""
        self._diagnostics = DiagnosticsPublisher(self, hardware_id)
        self.steady_timer(self.values["diagnostics_period"], self._diagnose)

    def steady_timer(self, period: float, callback: Any) -> Any:
        """Make a timer on the steady clock, with a period [s]."""
        if self._timers_shared is not None:
            gate = _Gate(callback)
            return self._own(self._timers_shared.remove, self._timers_shared.add(period, gate), gate)
        return self.create_timer(period, callback, clock=self._steady)

    def collect(self, kind: Any, topic: str, profile: Any) -> Subscription:
        """Make a subscription that does not wake the executor; :func:`wire.take` returns its serialised messages.

        This costs less than a callback, and is the only way to get the middleware's information about a message: with a
        callback for it, the ``EventsExecutor`` of rclpy 7.1 fails with "SystemError: null argument".
        """
        subscription = self.create_subscription(kind, topic, _never, profile, raw=True)
        self._collected[f"{self._reaching} {topic}"] = subscription
        return subscription

    def now_ns(self) -> int:
        """Time of the node's clock [ns]."""
        return int(self._ros_clock.handle.get_now().nanoseconds)  # without rclpy's Time, which takes four times as long

    @property
    def subscriptions(self) -> Iterator[Subscription]:
        """Subscriptions that wake the executor, without those of :meth:`collect`."""
        collected = set(map(id, self._collected.values()))
        return (item for item in super().subscriptions if id(item) not in collected)

    def create_publisher(self, kind: Any, topic: str, profile: Any, **options: Any) -> Any:
        """As rclpy; the opposite transition destroys the publisher. Supports ``qos_overrides``."""
        make = partial(super().create_publisher, kind, topic)
        return self._own(self.destroy_publisher, qos.overridable(make, topic, profile, options))

    def create_subscription(self, kind: Any, topic: str, callback: Any, profile: Any, **options: Any) -> Any:
        """As rclpy; the opposite transition destroys the subscription. Supports ``qos_overrides``."""
        gate = _Gate(callback)
        make = partial(super().create_subscription, kind, topic, gate)
        return self._own(self._unsubscribe, qos.overridable(make, topic, profile, options), gate)

    def create_timer(self, period: float, callback: Any, *args: Any, **options: Any) -> Any:
        """As rclpy; the opposite transition destroys the timer."""
        gate = _Gate(callback)
        return self._own(self.destroy_timer, super().create_timer(period, gate, *args, **options), gate)

    def create_service(self, *args: Any, **options: Any) -> Any:
        """As rclpy; the opposite transition destroys the service."""
        return self._own(self.destroy_service, super().create_service(*args, **options))

    def serve(self, kind: Any, name: str, answer: Callable[[Any], str]) -> None:
        """Make a service whose answer is a message in words; ``BadInput`` means that it was not done."""

        def callback(request: Any, response: Any) -> Any:
            try:
                response.message, response.success = answer(request), True
            except BadInput as error:
                response.message, response.success = str(error), False
            return response

        self.create_service(kind, name, callback)

    # ---------------------------------------------------------------- transitions

    def start(self) -> None:
        """Activate with ``autostart``. Called right before spinning, after all slow work is done."""
        self.ages = Ages(self)  # until now no tick of /clock could be heard
        if self.values["autostart"]:
            self._require(self.trigger_activate)

    def _require(self, transition: Callable[[], Any]) -> None:
        """Make a transition, and raise its error if it fails."""
        self._transition_error = None
        if transition() is not TransitionCallbackReturn.SUCCESS:
            raise self._transition_error or RuntimeError(f"{self.get_name()} could not be started")

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Reach ``inactive`` by :meth:`configure`."""
        outcome = self._reach("configured", self.configure, super().on_configure, state)
        self.configured = outcome is TransitionCallbackReturn.SUCCESS
        return outcome

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Reach ``active`` by :meth:`activate`."""
        self.active = True
        outcome = self._reach("active", self.activate, super().on_activate, state)
        self.active = outcome is TransitionCallbackReturn.SUCCESS
        if self.active:
            self.get_logger().info(" with rig ".join(("active", *self._rig_in_use)))
        return outcome

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Leave ``active``; the entities of :meth:`activate` are destroyed."""
        self._leave_active()
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Leave ``inactive``; the entities of :meth:`configure` are destroyed."""
        if self.configured:
            self.cleanup()
            self.configured = False
        self._owned["configured"].close()
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Shut down from any state; the process ends."""
        self._leave_active()
        # Delayed, so that the caller gets an answer, and subscribers get the last messages.
        self.create_timer(_ANSWER, partial(setattr, self, "finished", True), clock=self._steady)
        return super().on_shutdown(state)

    def _reach(
        self, stage: str, ours: Callable[[], None], base: Callable[[Any], Any], state: LifecycleState
    ) -> TransitionCallbackReturn:
        self._reaching = stage
        try:
            ours()
        except BadInput as error:
            self._transition_error = error
            if not self.values["autostart"]:
                self.get_logger().error(f"cannot become {stage}: {error}")
            self._owned[stage].close()
            return TransitionCallbackReturn.FAILURE
        except Exception as error:
            self._transition_error = error
            self.get_logger().error(f"cannot become {stage}: {type(error).__name__}: {error}")  # rclpy swallows it
            self._owned[stage].close()
            raise
        finally:
            self._reaching = None
        return base(state)

    def _leave_active(self) -> None:
        if self.active:
            self.deactivate()
            self.active = False
        self._owned["active"].close()

    def _own(self, destroy: Callable[[Any], object], entity: Any, gate: _Gate | None = None) -> Any:
        if self._reaching is not None:
            owned = self._owned[self._reaching]
            owned.callback(destroy, entity)
            if gate is not None:
                owned.callback(gate.close)  # before that
        return entity

    def _unsubscribe(self, subscription: Subscription) -> None:
        self._collected = {name: item for name, item in self._collected.items() if item is not subscription}
        self.destroy_subscription(subscription)

    def _on_parameters(self, changed: Sequence[Any]) -> SetParametersResult:
        """Check and apply parameters, either all or none; without a range rclpy does not check them."""
        try:
            for item in changed:
                if item.name == "use_sim_time":
                    self.check_time(bool(item.value))
            known = {
                item.name: self._table[item.name].check(item.value) for item in changed if item.name in self._table
            }
            if known and self.configured:
                self.change(known)
        except BadInput as error:
            return SetParametersResult(successful=False, reason=str(error))
        self.given |= known
        return SetParametersResult(successful=True)

    def _diagnose(self) -> None:
        parts = dict(self.health(time.monotonic_ns()))
        level, state = (Level.OK, "active") if self.active else (Level.WARN, "not active")
        parts["time"] = self.ages.health()
        parts["connections"] = self.connections()
        parts["lifecycle"] = Health(level, state, self.about_rig)
        self._diagnostics.publish(parts)
        # Automatic collection is off, and objects from before the first sample are frozen (see spin.py), so this takes
        # only microseconds.
        gc.collect()

    def _look_at_clock(self) -> None:
        """Log once what keeps the node from judging ages."""
        self.ages.look()
        fails, failed = self.ages.clock_fails, self._clock_failed
        self._clock_failed = bool(fails)
        if fails and not failed:
            self.get_logger().error(fails)
        elif failed and not fails:
            self.get_logger().info("the clock runs again")
        elif self.ages.trouble and not fails and not self._told_ahead:
            self._told_ahead = True
            self.get_logger().error(self.ages.trouble)

    def connections(self) -> Health:
        """Part ``connections``: which nodes quality of service keeps from this one's topics."""
        return connections(self, (*self.publishers, *super().subscriptions))


def _never(_message: bytes) -> None:
    raise AssertionError("the executor does not see this subscription")
