"""Several joints in one process, with a common health report and stop."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

from rclpy.parameter import Parameter
from std_srvs.srv import Trigger
from typing_extensions import override

from pam_antagonist.errors import BadInput
from pam_antagonist.nodes import bridge, controller, estimator, joints, plant
from pam_antagonist.nodes.controller_node import ControllerNode
from pam_antagonist.nodes.estimator_node import EstimatorNode
from pam_antagonist.nodes.health import Health, Level
from pam_antagonist.nodes.node import PamNode
from pam_antagonist.nodes.plant_node import PlantNode
from pam_antagonist.nodes.shared_timers import SharedTimers
from pam_antagonist.recording.topics import normalize_namespace

_TYPES = "start_type_description_service"
_TICK = 0.001  # time between two checks of the nodes' timers [s]
if TYPE_CHECKING:
    from pam_antagonist.nodes.bridge_node import BridgeNode

_ALL = (bridge, controller, estimator, joints, plant)
_KNOWN = tuple({parameter.name for module in _ALL for parameter in module.PARAMETERS})


class Joint(NamedTuple):
    """The nodes of one joint.

    Attributes:
        namespace: absolute, such as ``/left/elbow``.
        source: the node that owns the valves; None if it runs elsewhere.
    """

    namespace: str
    source: PlantNode | BridgeNode | None
    estimator: EstimatorNode
    controller: ControllerNode

    @property
    def nodes(self) -> tuple[PamNode, ...]:
        """All nodes; subscribers before publishers."""
        here = (self.controller, self.estimator)
        return here if self.source is None else (*here, self.source)


def make_joint(namespace: str, source: str = "plant", **options: Any) -> Joint:
    """Make plant or bridge, estimator and controller of one joint, linked by direct calls.

    Add all of them to one single-threaded executor: each node calls the next one in its own callback.

    Args:
        source: ``plant``, ``bridge`` or ``none``.
        options: as :class:`PamNode`, for each of the nodes.
    """
    # The service that describes message types takes 0.2 MB in each node, and the node ``joints`` has it already.
    overrides = [Parameter(_TYPES, value=False), *options.pop("parameter_overrides", ())]
    options = {"also_known": _KNOWN, **options, "namespace": namespace, "parameter_overrides": overrides}
    estimator_node = EstimatorNode(linked=source == "plant", **options)
    controller_node = ControllerNode(linked=True, **options)
    estimator_node.deliver = controller_node.estimate
    if source == "plant":
        plant_node = PlantNode(linked=True, **options)
        plant_node.deliver = estimator_node.sample
        controller_node.deliver = plant_node.command
        return Joint(namespace, plant_node, estimator_node, controller_node)
    if source == "none":
        return Joint(namespace, None, estimator_node, controller_node)
    from pam_antagonist.nodes.bridge_node import BridgeNode  # its libraries are needed only for hardware

    # A bridge has a thread of its own, so commands and samples go through the middleware, which is thread-safe.
    return Joint(namespace, BridgeNode(**options), estimator_node, controller_node)


class JointsNode(PamNode):
    """Makes the joints, reports their health, and can stop all of them.

    Args:
        options: as :class:`PamNode`, for this node and for those of the joints.
    """

    def __init__(self, **options: Any) -> None:
        self.joints: list[Joint] = []
        super().__init__("joints", joints.PARAMETERS, also_known=_KNOWN, **{"namespace": "/", **options})
        timers = SharedTimers()
        self.create_timer(_TICK, timers.run, clock=self._steady)
        # Made in every state of this node: its joints have life cycles of their own, and can be stopped at any time.
        self._make({**{name: value for name, value in options.items() if name != "namespace"}, "timers": timers})
        self.members = [node for joint in self.joints for node in joint.nodes]
        self.create_service(Trigger, "~/stop_all", self._on_stop_all)

    @override
    def configure(self) -> None:
        """Start the report of the joints' health."""
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

    def _on_stop_all(self, _request: Any, response: Any) -> Any:
        """Stop the valves of every joint; where another process owns them, stop the controller."""
        by_controller = []
        for joint in self.joints:
            port = getattr(joint.source, "port", None)
            if port is not None:
                port.stop("stop_all")
            else:
                joint.controller.stop("stop_all")
                by_controller.append(joint.namespace)
        response.success = True
        response.message = f"stopped: {', '.join(joint.namespace for joint in self.joints)}"
        if by_controller:
            response.message += f"; of {', '.join(by_controller)} the controller, since the valves are not owned here"
        self.get_logger().error(response.message)
        return response

    @override
    def health(self, steady_ns: int) -> Mapping[str, Health]:
        """Part ``joints``: which joints are stopped or not active."""
        states = {joint.namespace: _state(joint) for joint in self.joints}
        stopped = [name for name, words in states.items() if words.startswith("stopped")]
        if stopped:
            return {"joints": Health(Level.ERROR, f"stopped: {', '.join(stopped)}", states)}
        waiting = [name for name, words in states.items() if words != "active"]
        if waiting:
            return {"joints": Health(Level.WARN, f"not active: {', '.join(waiting)}", states)}
        return {"joints": Health(Level.OK, f"{len(states)} joints are active", states)}


def _state(joint: Joint) -> str:
    port = getattr(joint.source, "port", None)
    stopped = port.guard.stopped if port is not None else ""
    if stopped or joint.controller.stopped:
        return f"stopped: {stopped or joint.controller.stopped}"
    idle = [node.get_name() for node in joint.nodes if not node.active]
    return f"not active: {', '.join(idle)}" if idle else "active"
