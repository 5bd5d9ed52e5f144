"""Several joints in one process, with a common health report and stop."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from rclpy.parameter import Parameter as Override
from std_srvs.srv import Trigger
from typing_extensions import override

from pam_antagonist.errors import BadInput
from pam_antagonist.nodes import bridge, estimator, laws, plant
from pam_antagonist.nodes.controller import ControllerNode
from pam_antagonist.nodes.estimator import EstimatorNode
from pam_antagonist.nodes.health import Health, Level, judged
from pam_antagonist.nodes.node import PamNode
from pam_antagonist.nodes.parameters import Parameter
from pam_antagonist.nodes.plant import PlantNode
from pam_antagonist.nodes.spin import run_node
from pam_antagonist.nodes.valve_port import ValvePort
from pam_antagonist.recording.topics import normalize_namespace

DESCRIPTION = """
Several joints in one process. Each joint has a namespace, and in it a plant or a bridge, an estimator and a controller
with their topics, services and parameters, as in processes of their own. Samples of a plant, estimates and commands to
a plant go from node to node without the middleware, and are published beside that. So the valves of a plant here obey
the controller of the same joint alone.

A parameter file has a section for each joint, such as /left/elbow/** (config/robot.yaml). Each joint has a joint_name
of its own.

subscribes:  what the nodes of each joint subscribe to
publishes:   what they publish; /diagnostics
services:    ~/stop_all (std_srvs/Trigger: stops the valves of every joint until each is cleared by its own clear_stop),
             those of a lifecycle node, and those of the nodes of each joint
"""

PARAMETERS = (
    Parameter("joints", ["pam"]).about("namespaces of the joints, such as [left/elbow, left/wrist]"),
    Parameter("source", "plant", choices=("plant", "bridge", "none")).about(
        "what each joint has: plant, the simulated joint; bridge, a way to hardware; none: it is started elsewhere"
    ),
)

_RENAMES = re.compile(r"__(ns|node|name):=")


def refuse_renames(arguments: Sequence[str]) -> None:
    """Refuse a remapped namespace or name, which would apply to all nodes of the process."""
    for word in arguments:
        if _RENAMES.match(word):
            raise BadInput(
                f"joints: {word} would rename all nodes of the process; give the namespaces of the joints as "
                f"parameter joints, or write joints:{word} to rename the node joints alone"
            )


_TYPES = "start_type_description_service"
_TABLES = (bridge.PARAMETERS, laws.PARAMETERS, estimator.PARAMETERS, plant.PARAMETERS, PARAMETERS)
_KNOWN = tuple({parameter.name for table in _TABLES for parameter in table})


@dataclass(eq=False)
class TimerEntry:
    """One timer."""

    period_ns: int  # time between two calls [ns]
    callback: Callable[[], object]
    next_ns: int  # steady time of the next call [ns]


class SharedTimers:
    """Calls each timer when its period has passed. Missed periods are skipped, as in ROS.

    `clock`: steady time [ns].

    Example:
        >>> now, calls = [0], []
        >>> timers = SharedTimers(lambda: now[0])
        >>> entry = timers.add(0.002, lambda: calls.append(now[0]))
        >>> for now[0] in range(0, 9_000_000, 1_000_000):
        ...     timers.run()
        >>> calls
        [2000000, 4000000, 6000000, 8000000]
        >>> timers.until_next(0.1), timers.until_next(0.001)
        (0.002, 0.001)
    """

    def __init__(self, clock: Callable[[], int] = time.monotonic_ns) -> None:
        self._clock = clock
        self._entries: list[TimerEntry] = []

    def add(self, period: float, callback: Callable[[], object]) -> TimerEntry:
        """Add a timer. `period`: time between two calls [s]."""
        period_ns = round(period * 1e9)
        entry = TimerEntry(period_ns, callback, self._clock() + period_ns)
        self._entries = [*self._entries, entry]
        return entry

    def remove(self, entry: TimerEntry) -> None:
        """Remove a timer."""
        self._entries = [other for other in self._entries if other is not entry]

    def until_next(self, most: float) -> float:
        """Time until a timer is due [s], at most that."""
        due = min((entry.next_ns for entry in self._entries), default=math.inf)
        return min(max(1e-9 * (due - self._clock()), 0.0), most)

    def run(self) -> None:
        """Call all due timers; called by the loop of the process, between messages."""
        now = self._clock()
        for entry in self._entries:  # the present list; a callback may replace it
            if now >= entry.next_ns:
                entry.next_ns += entry.period_ns * (1 + (now - entry.next_ns) // entry.period_ns)
                entry.callback()


class JointNodes(NamedTuple):
    """The nodes of one joint."""

    namespace: str  # absolute, such as ``/left/elbow``
    source: PlantNode | bridge.BridgeNode | None  # the node that owns the valves; None if it runs elsewhere
    estimator: EstimatorNode
    controller: ControllerNode

    @property
    def nodes(self) -> tuple[PamNode, ...]:
        """All nodes; subscribers before publishers."""
        here = (self.controller, self.estimator)
        return here if self.source is None else (*here, self.source)

    @property
    def port(self) -> ValvePort | None:
        """The valves' port; None where they are owned elsewhere, or before their node is configured."""
        return getattr(self.source, "port", None)


def make_joint(namespace: str, source: str = "plant", **options: Any) -> JointNodes:
    """Make plant or bridge, estimator and controller of one joint, linked by direct calls.

    Add all of them to one single-threaded executor: each node calls the next one in its own callback.

    `source`: ``plant``, ``bridge`` or ``none``. `options`: as :class:`PamNode`, for each of the nodes.
    """
    # The service that describes message types takes 0.2 MB in each node, and the node ``joints`` has it already.
    overrides = [Override(_TYPES, value=False), *options.pop("parameter_overrides", ())]
    options = {"also_known": _KNOWN, **options, "namespace": namespace, "parameter_overrides": overrides}
    estimator_node = EstimatorNode(linked=source == "plant", **options)
    controller_node = ControllerNode(linked=True, **options)
    estimator_node.deliver = controller_node.estimate
    owner: PlantNode | bridge.BridgeNode | None = None
    if source == "plant":
        owner = PlantNode(linked=True, **options)
        owner.deliver = estimator_node.sample
        controller_node.deliver = owner.command
    elif source == "bridge":
        # A bridge has a thread of its own, so commands and samples go through the middleware, which is thread-safe.
        owner = bridge.BridgeNode(**options)
    return JointNodes(namespace, owner, estimator_node, controller_node)


class JointsNode(PamNode):
    """Makes the joints, reports their health, and can stop all of them.

    `options`: as :class:`PamNode`, for this node and for those of the joints.
    """

    NAME, TABLE = "joints", PARAMETERS

    def __init__(self, **options: Any) -> None:
        self.joints: list[JointNodes] = []
        super().__init__(also_known=_KNOWN, **{"namespace": "/", **options})
        # Not the executor's: each of those costs more than a sample.
        self.loop_timers = timers = SharedTimers()
        # Made in every state of this node: its joints have life cycles of their own, and can be stopped at any time.
        self._make({**{name: value for name, value in options.items() if name != "namespace"}, "timers": timers})
        self.members = [node for joint in self.joints for node in joint.nodes]
        self.joint_namespaces = [joint.namespace for joint in self.joints]
        self.serve(Trigger, "~/stop_all", self._stop_all)

    @override
    def configure(self) -> None:
        self.start_diagnostics("robot")

    def _make(self, options: Mapping[str, Any]) -> None:
        namespaces = [normalize_namespace(name) for name in self.values["joints"]]
        if not namespaces:
            raise BadInput("joints: no joint; expected namespaces such as [left/elbow, left/wrist]")
        for namespace in namespaces:
            if not namespace or namespaces.count(namespace) > 1:
                raise BadInput(
                    f"joints: {namespace or '/'} is given twice or is the root: expected another namespace for each "
                    "joint"
                )
        for namespace in namespaces:
            self.joints.append(make_joint(namespace, self.values["source"], **options))
        names: dict[str, str] = {}
        for joint in self.joints:
            name = joint.controller.values["joint_name"]
            if name in names:
                raise BadInput(
                    f"{names[name]} and {joint.namespace} have one joint_name, {name!r}: give each its own in the "
                    f"parameter file, under {joint.namespace}/**"
                )
            names[name] = joint.namespace
            for node in joint.nodes:
                if node.values["joint_name"] != name:
                    raise BadInput(f"{joint.namespace}: {node.get_name()} and controller have different joint_names")

    def _stop_all(self, _request: Any) -> str:
        """Stop the valves of every joint; where another process owns them, stop the controller."""
        by_controller = []
        for joint in self.joints:
            port = joint.port
            (joint.controller if port is None else port).stop("stop_all")
            by_controller += [joint.namespace] if port is None else []
        words = f"stopped: {', '.join(joint.namespace for joint in self.joints)}"
        if by_controller:
            words += f"; of {', '.join(by_controller)} the controller, since the valves are not owned here"
        self.get_logger().error(words)
        return words

    @override
    def health(self, steady_ns: int) -> Mapping[str, Health]:
        states = {joint.namespace: _state(joint) for joint in self.joints}
        stopped = [name for name, words in states.items() if words.startswith("stopped")]
        waiting = [name for name, words in states.items() if words != "active"]
        health = judged(
            states,
            f"{len(states)} joints are active",
            (stopped, Level.ERROR, f"stopped: {', '.join(stopped)}"),
            (waiting, Level.WARN, f"not active: {', '.join(waiting)}"),
        )
        return {"joints": health}


def _state(joint: JointNodes) -> str:
    stopped = "" if joint.port is None else joint.port.guard.stopped
    if stopped or joint.controller.stopped:
        return f"stopped: {stopped or joint.controller.stopped}"
    idle = [node.get_name() for node in joint.nodes if not node.active]
    return f"not active: {', '.join(idle)}" if idle else "active"


def main(argv: list[str] | None = None) -> int:
    """Run the nodes; see ``joints --help``."""
    return run_node(JointsNode, argv, name="joints", description=DESCRIPTION, table=PARAMETERS, check=refuse_renames)
