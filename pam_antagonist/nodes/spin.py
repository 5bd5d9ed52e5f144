"""Run a node from the command line to a clean end.

``EventsExecutor`` waits for events instead of polling all entities, which makes 1 kHz possible in Python. In rclpy 7.1
calls without a time-out hang and ignore signals, so there is a loop around ``spin_once``.
"""

from __future__ import annotations

import contextlib
import gc
import os
import re
import signal
import sys
import time
from collections.abc import Callable, Mapping, MutableMapping, Sequence
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from pam_antagonist.errors import BadInput
from pam_antagonist.nodes.parameters import AUTOSTART, DIAGNOSTICS_PERIOD, Parameter, help_text, refuse_base_8
from pam_antagonist.nodes.processes import PARENT_VARIABLE, PRIORITY_VARIABLE
from pam_antagonist.nodes.sections import parameter_files, unused
from pam_antagonist.optional import needs_ros
from pam_antagonist.paths import config_dir
from pam_antagonist.program import SIGNALS, Interrupts, alone, piped, typed

if TYPE_CHECKING:
    from rclpy.node import Node

    from pam_antagonist.nodes.node import PamNode

RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"

_ASKED = (RANGE, "ROS_STATIC_PEERS", "ROS_LOCALHOST_ONLY", "ROS_DISCOVERY_SERVER")
"""Environment variables of ROS 2 that set the range of discovery."""


def stay_on_this_machine(environment: MutableMapping[str, str] = os.environ) -> bool:
    """Limit discovery of this process's nodes to this machine; call before ROS is initialised.

    By default ROS 2 discovers the whole subnet, where anybody could publish commands to the valves. If the user has set
    any of the variables of discovery, nothing is changed.
    """
    if any(environment.get(name) for name in _ASKED):
        return False
    environment[RANGE] = "LOCALHOST"
    return True


def local_only() -> bool:
    """Whether discovery is limited to this machine."""
    return os.environ.get(RANGE) == "LOCALHOST" and not os.environ.get("ROS_STATIC_PEERS")


def nothing_there(
    namespace: str, elsewhere: Sequence[str], busy: Sequence[int], environment: Mapping[str, str] = os.environ
) -> str:
    """What to try where no node publishes a joint's topics, in words."""
    domain = int(environment.get("ROS_DOMAIN_ID") or 0)
    others = [other for other in busy if other != domain]
    tries = [f"--namespace {other or '/'} (a joint is there)" for other in elsewhere]
    tries += [f"ROS_DOMAIN_ID={other} {typed('watch')} (nodes of this machine seem to be there)" for other in others]
    if not tries:
        tries = [
            "start the joint's nodes",
            "the line that demo, excite or commission prints (they have a ROS domain of their own)",
            f"for a joint on another machine, {RANGE}=SUBNET on both",
        ]
    return f"no joint in namespace {namespace or '/'} of ROS domain {domain}. Try: {'; or '.join(tries)}"


def own_parameters(arguments: Sequence[str]) -> list[str]:
    """The arguments of a node (``cli_args``) that repeat the parameters of its command line.

    Example:
        >>> own_parameters(["--out", "bag", "--ros-args", "-p", "seed:=3", "--params-file", "a.yaml"])
        ['--ros-args', '-p', 'seed:=3']
    """
    rules: list[str] = []
    inside = False
    for before, word in pairwise(("", *arguments)):
        inside = word == "--ros-args" or (inside and word != "--")
        if inside and before in ("-p", "--param"):
            rules += ["-p", word]
    return ["--ros-args", *rules] if rules else []


_PROFILES_VARIABLE = "FASTRTPS_DEFAULT_PROFILES_FILE"
_WAIT = 0.1  # [s] longest time until a signal is noticed
_FAREWELL = 0.15  # [s] from the last message to the end of its publisher: three heartbeats of config/fastdds.xml


class _Stop:
    """Handler of signals for a loop that looks for one: it only stores the signal."""

    signal: int | None = None

    def __call__(self, number: int, _frame: Any) -> None:
        self.signal = number


def no_options(arguments: list[str]) -> None:
    """Refuse arguments other than those of ROS."""
    if arguments:
        raise BadInput(f"unknown argument {arguments[0]!r}: expected --help, or ROS arguments after --ros-args")


def run_node(
    create: Callable[..., PamNode],
    argv: Sequence[str] | None,
    *,
    name: str,
    description: str,
    table: Sequence[Parameter],
    options: Callable[[list[str]], Any] = no_options,
    check: Callable[[Sequence[str]], object] = lambda arguments: None,
) -> int:
    """Run a node until SIGINT, SIGTERM, or until it has finished.

    Args:
        create: makes the node from its options, where it has some, and from keyword arguments for rclpy's node; all
            slow work (reading the rig, loading compiled code) is done here, before the first sample.
        description: first part of ``--help``.
        table: the node's parameters, for ``--help``.
        check: checks all arguments first; may raise ``BadInput``.

    Returns:
        Exit status: 0, or 2 after bad input or without ROS, with an error message of one line.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)

    def work() -> int:
        if "--help" in arguments or "-h" in arguments:
            print(usage(name, description, table))
            return 0
        try:
            check(arguments)
            refuse_base_8(arguments)
            _run(create, arguments, name, options)
        except BadInput as error:
            print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
            return 2
        except KeyboardInterrupt:  # nothing has been published or subscribed
            pass
        return 0

    return piped(work) if argv is not None else alone(lambda: piped(work), 0)


def usage(name: str, description: str, table: Sequence[Parameter]) -> str:
    """Text of ``--help``."""
    parameters = help_text((*table, AUTOSTART, DIAGNOSTICS_PERIOD))
    return (
        f"usage: {typed(name)} [OPTIONS] [--ros-args [-p PARAMETER:=VALUE]... [--params-file FILE] "
        f"[-r __ns:=/NAMESPACE] [-r TOPIC:=OTHER]...]\n\n{description.strip()}\n\nparameters:\n{parameters}\n\n"
        "The namespace is /pam unless it is remapped. SIGINT (Ctrl-C) or SIGTERM ends the node with status 0."
    )


def _run(create: Callable[..., PamNode], arguments: list[str], name: str, options: Callable[[list[str]], Any]) -> None:
    handlers = {number: signal.getsignal(number) for number in SIGNALS}
    Interrupts(0, raises=True).install()
    needs_ros(name)
    import rclpy
    from rclpy.signals import SignalHandlerOptions
    from rclpy.utilities import remove_ros_args

    try:
        stay_on_this_machine()
        limited = local_only()
        tune_middleware()
        try:
            others = remove_ros_args(args=arguments)
            rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
        except Exception as error:
            raise BadInput(f"{name}: {_first_sentence(error)}") from None
        given = options(others)
        node = _made(partial(create, *(() if given is None else (given,)), cli_args=own_parameters(arguments)), name)
        every = [one.get_fully_qualified_name() for one in (node, *node.members)]
        for path in parameter_files(arguments):
            if words := unused(path, every, node.joint_namespaces):
                node.get_logger().warning(words)
        if limited:
            node.get_logger().info("discovery is limited to this machine (ROS_AUTOMATIC_DISCOVERY_RANGE)")
        try:
            spin(node)
        finally:
            for one in (node, *reversed(node.members)):
                one.close()
            # Late subscribers can still request messages that they missed.
            time.sleep(_FAREWELL)
            for one in (*node.members, node):
                one.destroy_node()
    finally:
        rclpy.try_shutdown()
        for number, handler in handlers.items():
            signal.signal(number, handler)


def _made(create: Callable[[], PamNode], name: str) -> PamNode:
    """The node; slow, since it may compile."""
    try:
        return create()
    except Exception as error:
        if os.environ.get("ROS_SECURITY_ENABLE", "").lower() == "true" and "secur" in str(error).lower():
            raise BadInput(f"{name}: ROS_SECURITY_ENABLE is true, but {_first_sentence(error)}") from None
        if type(error).__name__ == "RCLError":  # by the environment or the arguments: none of this package's
            raise BadInput(f"{name}: {_first_sentence(error)}") from None
        raise


def client_node(name: str, namespace: str) -> Node:
    """A node of a command, in a context of its own; signals are left to the command."""
    import rclpy
    from rclpy.node import Node
    from rclpy.signals import SignalHandlerOptions

    stay_on_this_machine()
    tune_middleware()
    context = rclpy.Context()
    try:
        rclpy.init(args=[], context=context, signal_handler_options=SignalHandlerOptions.NO)
        return Node(name, namespace=namespace, context=context, start_parameter_services=False)
    except Exception as error:
        raise BadInput(f"ROS 2 does not start: {_first_sentence(error)}") from None


def _first_sentence(error: BaseException) -> str:
    """Text of an error of ROS in one line, without the places in rcl's source code."""
    return re.sub(r",? at /\S+:\d+", "", " ".join(str(error).split())[:300])


def tune_middleware() -> None:
    """Configure Fast DDS by config/fastdds.xml unless the user has set a profile; call before ROS is initialised.

    If discovery is limited to this machine, config/fastdds_local.xml is used, which contains the limit itself. ROS 2's
    variable would make rmw_fastrtps add shared memory, whose lock may outlive a killed node. Other middlewares ignore
    the file and use the variable.
    """
    local = local_only()
    profiles = config_dir() / ("fastdds_local.xml" if local else "fastdds.xml")
    if os.environ.setdefault(_PROFILES_VARIABLE, str(profiles)) != str(profiles):
        return
    if profiles.is_file():
        if local and os.environ.get("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp").startswith("rmw_fastrtps"):
            os.environ[RANGE] = "SYSTEM_DEFAULT"
    else:
        print(f"warning: {profiles} is missing: samples will be lost when a node stalls", file=sys.stderr)


def spin(node: PamNode) -> None:
    """Spin a node and its members until a signal comes, the node has finished, or the parent process is gone."""
    import rclpy

    executor = make_executor(node)
    stop = _Stop()
    # asio, inside the executor, has installed its own handlers.
    for number in SIGNALS:
        signal.signal(number, stop)
    parent = int(os.environ.get(PARENT_VARIABLE, "0"))
    # All present objects live as long as the node, so the garbage collector need not check them again.
    gc.collect()
    gc.freeze()
    gc.disable()
    hurry()
    try:
        for one in (*node.members, node):
            one.start()
        while stop.signal is None and not node.finished and rclpy.ok():
            executor.spin_once(timeout_sec=_WAIT if node.loop_timers is None else node.loop_timers.until_next(_WAIT))
            if node.loop_timers is not None:
                node.loop_timers.run()
            if parent and os.getppid() != parent:
                break
    finally:
        gc.enable()
        gc.unfreeze()
        for one in (node, *node.members):
            executor.remove_node(one)
        executor.shutdown()


def hurry() -> None:
    """Request a real-time priority, if one is set in the environment.

    A node with a period of a millisecond must not wait for other work of the machine. Only root, or a user with the
    right (ulimit -r), gets the priority; without it the node runs as before. Called after starting and compiling, which
    need no priority.
    """
    priority = int(os.environ.get(PRIORITY_VARIABLE, "0"))
    if priority > 0 and hasattr(os, "sched_setscheduler"):
        for thread in os.listdir("/proc/self/task"):  # including the middleware's
            with contextlib.suppress(OSError):
                os.sched_setscheduler(int(thread), os.SCHED_RR, os.sched_param(priority))


def make_executor(node: PamNode) -> Any:
    """An executor with the node and its members."""
    try:
        from rclpy.experimental import EventsExecutor
    except ImportError:
        from rclpy.executors import SingleThreadedExecutor

        node.get_logger().warning(
            "this rclpy has no EventsExecutor, without which samples are lost at 1 kHz: update ros-jazzy-rclpy"
        )
        executor: Any = SingleThreadedExecutor()
    else:
        executor = EventsExecutor()
    for one in (node, *node.members):
        executor.add_node(one)
    return executor
