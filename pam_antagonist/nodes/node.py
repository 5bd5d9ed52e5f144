"""What the nodes have in common."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.subscription import Subscription

from pam_antagonist.errors import BadInput
from pam_antagonist.nodes.connections import QOS_ERRORS, Connections, overridable, refused
from pam_antagonist.nodes.diagnostics import DiagnosticsPublisher
from pam_antagonist.nodes.health import Health, Level
from pam_antagonist.nodes.parameters import AUTOSTART, DIAGNOSTICS_PERIOD, Parameter, declare
from pam_antagonist.nodes.shared_timers import SharedTimers
from pam_antagonist.recording.topics import DEFAULT_NAMESPACE

_ANSWER = 0.5  # from a shutdown to the end of the process [s]

SHARED_PARAMETERS = (
    *("rig", "joint", "joint_name", "lock_angle", "frame_id", "tuning", "max_age"),
    *("safe_voltage", "safe_action", "vent_voltage", "vent_rate", "command_timeout", "max_command_age"),
    *("max_slew", "max_pressure"),
)
"""Parameters that a file for a whole pipeline may give to every node, whether it has them or not."""

JOINTS_PARAMETERS = ("joints", "source")
"""Those of executable ``joints``: on its command line they reach each node of the process."""


class _Gate:
    """Lets calls through until it is shut: an executor may have a timer or a message in its queue still."""

    __slots__ = ("callback", "open")

    def __init__(self, callback: Callable[..., object]) -> None:
        self.callback = callback
        self.open = True

    def message(self, message: Any) -> None:
        if self.open:
            self.callback(message)

    def tick(self) -> None:
        if self.open:
            self.callback()


class _Owned(NamedTuple):
    """Something that ends with the transition that is the opposite of the one that it was made in."""

    stage: str
    destroy: Callable[[Any], object]
    entity: Any
    gate: _Gate | None


class PamNode(LifecycleNode):  # type: ignore[misc]
    """A managed node with checked parameters and diagnostics.

    A node overrides :meth:`configure`, :meth:`activate`, :meth:`deactivate`, :meth:`cleanup` as far as it needs them;
    each may raise ``BadInput``, which makes the transition fail with the reason in the log. With ``autostart`` (the
    default) it configures itself when it is made, and activates itself right before spinning. Timers, publishers,
    subscriptions and services that are made in a transition by this class's methods end with the opposite one.

    Timers run on the steady clock, so that a jump of the system clock cannot stop them; whatever is compared with a
    stamp is read from the node's clock, which follows ``use_sim_time``.

    Messages go out by plain publishers: that an inactive node is silent is a matter of what calls them. A
    ``LifecyclePublisher`` would look at its state once more for each of 4000 messages a second.

    Args:
        name: of the node, unless it is remapped.
        table: its parameters.
        timers: where its steady timers go; None: each is the executor's.
        also_known: names of parameters that are not this node's and may be given to it all the same.
        options: of ``rclpy.node.Node``, such as ``namespace``, ``context``, ``cli_args`` or ``parameter_overrides``.

    Attributes:
        values: the parameters.
        active: whether it is in the state "active".
        about_rig: what ``/diagnostics`` says about its rig, where it has one.
        finished: set by a node that has nothing left to do, or was shut down by its lifecycle service.
        members: nodes that run in the same executor, and start and end with this one.

    Raises:
        BadInput: a parameter that cannot be used.
    """

    finished = False
    active = False
    members: Sequence[PamNode] = ()

    def __init__(
        self,
        name: str,
        table: Sequence[Parameter],
        *,
        timers: SharedTimers | None = None,
        also_known: Sequence[str] = (),
        **options: Any,
    ) -> None:
        self._timers_shared = timers
        self._collected: dict[str, Subscription] = getattr(self, "_collected", {})
        self._owned: list[_Owned] = []
        self._connections = Connections()
        self._reaching: str | None = None  # which transition is under way
        self._transition_error: BaseException | None = None
        self.about_rig: dict[str, str] = {}
        super().__init__(name, **{"namespace": DEFAULT_NAMESPACE, **options})
        known = (*SHARED_PARAMETERS, *JOINTS_PARAMETERS, *also_known)
        self.values: dict[str, Any] = declare(self, (*table, AUTOSTART, DIAGNOSTICS_PERIOD), known)
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._ros_clock = self.get_clock()
        if self.values["autostart"]:
            self._require(self.trigger_configure)

    # ---------------------------------------------------------------- for the nodes

    def configure(self) -> None:
        """Read what is needed, compile, make publishers and services. Slow things belong here."""

    def activate(self) -> None:
        """Begin: subscriptions and timers. Called when everything that takes time is done.

        What is subscribed to earlier piles up until then, and comes late.
        """

    def deactivate(self) -> None:
        """Before subscriptions and timers end: last messages."""

    def cleanup(self) -> None:
        """Forget what :meth:`configure` made, apart from entities of ROS, which end by themselves."""

    def close(self) -> None:
        """Last messages, while there still is a context to send them. Called once, before the node is destroyed."""

    def health(self, steady_ns: int) -> Mapping[str, Health]:
        """The state of each part; called once every ``diagnostics_period``, from :meth:`start_diagnostics` on.

        Args:
            steady_ns: steady time [ns].
        """
        raise NotImplementedError

    def start_diagnostics(self, hardware_id: str) -> None:
        """Send :meth:`health` from now on."""
        self._diagnostics = DiagnosticsPublisher(self, hardware_id)
        self.steady_timer(self.values["diagnostics_period"], self._diagnose)

    def steady_timer(self, period: float, callback: Any) -> Any:
        """A timer [s] on the steady clock."""
        if self._timers_shared is not None:
            gate = _Gate(callback)
            return self._own(self._timers_shared.remove, self._timers_shared.add(period, gate.tick), gate)
        return self.create_timer(period, callback, clock=self._steady)

    def collect(self, kind: Any, topic: str, profile: Any) -> Subscription:
        """A subscription that nobody is woken up for: its serialised messages are taken with :func:`take`.

        That costs less than being woken, and it is the only way to what the middleware knows about a message: with a
        callback that takes it as well, the ``EventsExecutor`` of rclpy 7.1 ends with "SystemError: null argument".

        Args:
            kind: type of the messages.
            topic: relative name.
            profile: quality of service.
        """
        subscription = self.create_subscription(kind, topic, _never, profile, raw=True)
        self._collected[f"{self._reaching} {topic}"] = subscription
        return subscription

    def now_ns(self) -> int:
        """Time of the node's clock [ns]."""
        return int(self._ros_clock.handle.get_now().nanoseconds)  # without rclpy's Time, which takes four times as long

    @property
    def subscriptions(self) -> Iterator[Subscription]:
        """Those that an executor is to wake up for: not the collected ones."""
        collected = set(map(id, self._collected.values()))
        return (item for item in super().subscriptions if id(item) not in collected)

    def create_publisher(self, kind: Any, topic: str, profile: Any, **options: Any) -> Any:
        """As rclpy; the publisher belongs to the state that is being reached. ``qos_overrides`` count."""
        profile, options = overridable(topic, profile, options)
        try:
            publisher = super().create_publisher(kind, topic, profile, **options)
        except QOS_ERRORS as error:
            raise refused(topic, error) from None
        self._connections.add(publisher.topic_name, publisher, profile, subscribes=False)
        return self._own(self._unpublish, publisher)

    def create_subscription(self, kind: Any, topic: str, callback: Any, profile: Any, **options: Any) -> Any:
        """As rclpy; the callback is called only in the state that made it. ``qos_overrides`` count."""
        gate = _Gate(callback)
        profile, options = overridable(topic, profile, options)
        try:
            entity = super().create_subscription(kind, topic, gate.message, profile, **options)
        except QOS_ERRORS as error:
            raise refused(topic, error) from None
        self._connections.add(entity.topic_name, entity, profile, subscribes=True)
        return self._own(self._unsubscribe, entity, gate)

    def create_timer(self, period: float, callback: Any, *args: Any, **options: Any) -> Any:
        """As rclpy; the callback is called only while the node is in the state that made it."""
        gate = _Gate(callback)
        return self._own(self.destroy_timer, super().create_timer(period, gate.tick, *args, **options), gate)

    def create_service(self, *args: Any, **options: Any) -> Any:
        """As rclpy; the service belongs to the state that is being reached."""
        return self._own(self.destroy_service, super().create_service(*args, **options))

    # ---------------------------------------------------------------- transitions

    def start(self) -> None:
        """Activate, where that is wanted. Called when everything that takes time is done, right before spinning."""
        if self.values["autostart"]:
            self._require(self.trigger_activate)

    def _require(self, transition: Callable[[], Any]) -> None:
        """A transition whose failure is the caller's to know.

        Raises:
            BadInput: what it failed of.
        """
        self._transition_error = None
        if transition() is not TransitionCallbackReturn.SUCCESS:
            raise self._transition_error or RuntimeError(f"{self.get_name()} could not be started")

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Reach ``inactive``: what :meth:`configure` makes."""
        return self._reach("configured", self.configure, super().on_configure, state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Reach ``active``: what :meth:`activate` makes."""
        self.active = True
        outcome = self._reach("active", self.activate, super().on_activate, state)
        self.active = outcome is TransitionCallbackReturn.SUCCESS
        if self.active:
            self.get_logger().info("active")
        return outcome

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Leave ``active``: what :meth:`activate` made is destroyed."""
        self._leave("active")
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Leave ``inactive``: what :meth:`configure` made is destroyed."""
        self._leave("configured")
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """From whatever state; the process ends, and with it everything else."""
        self._leave("active")
        # Not at once: whoever asked for it is to get an answer, and everybody else the last messages.
        self.create_timer(_ANSWER, self._finish, clock=self._steady)
        return super().on_shutdown(state)

    def _finish(self) -> None:
        self.finished = True

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
            self._dispose(stage)
            return TransitionCallbackReturn.FAILURE
        except Exception as error:
            self._transition_error = error
            self.get_logger().error(f"cannot become {stage}: {type(error).__name__}: {error}")  # rclpy swallows it
            self._dispose(stage)
            raise
        finally:
            self._reaching = None
        return base(state)

    def _leave(self, stage: str) -> None:
        """Undo what was done to reach a stage, if it was reached."""
        if stage == "active" and self.active:
            self.deactivate()
            self.active = False
        elif stage == "configured" and any(owned.stage == stage for owned in self._owned):
            self.cleanup()
        self._dispose(stage)

    def _dispose(self, stage: str) -> None:
        gone = [owned for owned in self._owned if owned.stage == stage]
        self._owned = [owned for owned in self._owned if owned.stage != stage]
        for owned in reversed(gone):
            if owned.gate is not None:
                owned.gate.open = False
            owned.destroy(owned.entity)

    def _own(self, destroy: Callable[[Any], object], entity: Any, gate: _Gate | None = None) -> Any:
        if self._reaching is not None:
            self._owned.append(_Owned(self._reaching, destroy, entity, gate))
        return entity

    def _unsubscribe(self, subscription: Subscription) -> None:
        self._collected = {name: item for name, item in self._collected.items() if item is not subscription}
        self._connections.remove(subscription)
        self.destroy_subscription(subscription)

    def _unpublish(self, publisher: Any) -> None:
        self._connections.remove(publisher)
        self.destroy_publisher(publisher)

    def _diagnose(self) -> None:
        parts = dict(self.health(time.monotonic_ns()))
        level, state = (Level.OK, "active") if self.active else (Level.WARN, "not active")
        parts["connections"] = self._connections.health(self)
        parts["lifecycle"] = Health(level, state, self.about_rig)
        self._diagnostics.publish(parts)
        # The automatic collection is off, and what existed before the first sample is out of its sight (see spin.py):
        # what is left to look through takes microseconds.
        gc.collect()


def take(subscription: Subscription) -> Iterator[tuple[bytes, Mapping[str, Any]]]:
    """What a collected subscription has: each message with what the middleware knows about it, oldest first."""
    handle = subscription.handle
    with handle:
        while (taken := handle.take_message(subscription.msg_type, True)) is not None:
            yield taken


def _never(_message: bytes) -> None:
    raise AssertionError("the executor does not see this subscription")
