"""Running a node: from the command line to a clean end.

``EventsExecutor`` wakes for events rather than polling all entities, which is what makes 1 kHz possible in Python.
Calls of it without a time-out hang and ignore signals in rclpy 7.1, hence the loop around ``spin_once``.
"""

from __future__ import annotations

import contextlib
import gc
import os
import re
import signal
import sys
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from pam_antagonist.errors import BadInput
from pam_antagonist.nodes.command_line import own_parameters
from pam_antagonist.nodes.network import RANGE, local_only, secured, stay_on_this_machine
from pam_antagonist.nodes.parameters import AUTOSTART, DIAGNOSTICS_PERIOD, Parameter, help_text
from pam_antagonist.optional import needs_ros
from pam_antagonist.paths import config_dir
from pam_antagonist.program import typed

if TYPE_CHECKING:
    from pam_antagonist.nodes.node import PamNode

PARENT_VARIABLE = "PAM_ANTAGONIST_PARENT"
"""Environment variable with the process that a node is to end with, even if that one is killed."""

PRIORITY_VARIABLE = "PAM_ANTAGONIST_PRIORITY"
"""Environment variable with the priority (1 to 99) that a node asks the real-time scheduler for."""

_PROFILES_VARIABLE = "FASTRTPS_DEFAULT_PROFILES_FILE"
_WAIT = 0.1  # longest time until a signal is noticed [s]
_FAREWELL = 0.15  # from the last message to the end of its publisher: three heartbeats of config/fastdds.xml [s]
_MOMENT = 0.05  # in which a signal that reached another thread of the process comes to the one that looks [s]


class _Interrupted(BaseException):
    """A signal came before the node was there."""


class _Stop:
    """Set by the first signal.

    Attributes:
        signal: its number; None: none has come.
        waits: whether somebody looks at that soon. While a node is made, which may have to compile for a minute,
            nobody does: then the signal ends that at once.
    """

    def __init__(self) -> None:
        self.signal: int | None = None
        self.waits = True

    def __call__(self, number: int, _frame: Any) -> None:
        first, self.signal = self.signal is None, number
        if first and not self.waits:
            raise _Interrupted


def no_options(arguments: list[str]) -> None:
    """Refuse what is no ROS argument.

    Raises:
        BadInput: there is something.
    """
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
    """Run a node until SIGINT, SIGTERM, or until it says that it has finished.

    Args:
        create: makes the node from its options, and from keyword arguments for rclpy's node; everything slow (reading
            the rig, loading compiled code) happens there, before the first sample.
        argv: arguments; None: those of the process.
        name: of the executable.
        description: first part of ``--help``.
        table: the node's parameters, for ``--help``.
        options: reads the arguments that are not ROS's.
        check: looks at all arguments first; may raise ``BadInput``.

    Returns:
        Exit status: 0, or 2 after bad input or where ROS is missing, which is said in one line.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    if "--help" in arguments or "-h" in arguments:
        print(usage(name, description, table))
        return 0
    try:
        check(arguments)
        return _run(create, arguments, name, options)
    except BadInput as error:
        print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
        return 2


def usage(name: str, description: str, table: Sequence[Parameter]) -> str:
    """What ``--help`` prints.

    Args:
        name: of the executable.
        description: what it does.
        table: its parameters.
    """
    parameters = help_text((*table, AUTOSTART, DIAGNOSTICS_PERIOD))
    return (
        f"usage: {typed(name)} [OPTIONS] [--ros-args [-p PARAMETER:=VALUE]... [--params-file FILE] "
        f"[-r __ns:=/NAMESPACE] [-r TOPIC:=OTHER]...]\n\n{description.strip()}\n\nparameters:\n{parameters}\n\n"
        "The namespace is /pam unless it is remapped. SIGINT (Ctrl-C) or SIGTERM ends the node with status 0."
    )


def _run(create: Callable[..., PamNode], arguments: list[str], name: str, options: Callable[[list[str]], Any]) -> int:
    stop = _Stop()
    handlers = {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)}
    needs_ros(name)
    import rclpy

    try:
        stay_on_this_machine()
        alone = local_only()
        tune_middleware()
        given = _initialise(arguments, name, options)
        try:
            stop.waits = False
            node = create(given, cli_args=own_parameters(arguments))
            stop.waits = True
        except _Interrupted:
            return 0  # nothing has been published, and nothing was subscribed to
        except Exception as error:
            stop.waits = True
            time.sleep(_MOMENT)
            if stop.signal is not None:
                return 0  # the compiler was calling back: it swallows what the signal raises, and fails a moment later
            if secured() and "secur" in str(error).lower():
                raise BadInput(f"{name}: ROS_SECURITY_ENABLE is true, but {_first_sentence(error)}") from None
            raise
        if alone:
            node.get_logger().info("discovery is limited to this machine (ROS_AUTOMATIC_DISCOVERY_RANGE)")
        try:
            spin(node, stop)
        finally:
            for one in (node, *reversed(node.members)):
                one.close()
            # Whoever is behind by a moment asks the publisher again for what it missed.
            time.sleep(_FAREWELL)
            for one in (*node.members, node):
                one.destroy_node()
    finally:
        stop.waits = True
        rclpy.try_shutdown()
        for number, handler in handlers.items():
            signal.signal(number, handler)
    return 0


def _initialise(arguments: list[str], name: str, options: Callable[[list[str]], Any]) -> Any:
    """Give ROS its arguments, and the others to ``options``."""
    import rclpy
    from rclpy.signals import SignalHandlerOptions
    from rclpy.utilities import remove_ros_args

    try:
        left = remove_ros_args(args=arguments)
        rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:
        raise BadInput(f"{name}: {_first_sentence(error)}") from None
    return options(left)


def _first_sentence(error: BaseException) -> str:
    """What ROS says; rcl adds the places in its own source code, which help nobody here."""
    return re.sub(r",? at /\S+:\d+", "", one_line(error))


def tune_middleware() -> None:
    """Have Fast DDS, before it starts in this process, take config/fastdds.xml unless there is another profile.

    Where nodes are to stay on this machine, that is config/fastdds_local.xml, which then says so in place of ROS 2's
    variable: with that, rmw_fastrtps adds shared memory, where the lock of a node that was killed may outlive it. Other
    middlewares ignore the file, and are told by the variable.
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


def spin(node: PamNode, stop: _Stop) -> None:
    """Serve a node, and its members, until a signal comes, it has finished, or the parent process is gone."""
    import rclpy

    executor = make_executor(node)
    # asio, inside of the executor, has put its own handlers in place.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop)
    parent = int(os.environ.get(PARENT_VARIABLE, "0"))
    # Whatever exists by now lives as long as the node; nothing of it is looked at again by the collector.
    gc.collect()
    gc.freeze()
    gc.disable()
    hurry()
    try:
        for one in (*node.members, node):
            one.start()
        while stop.signal is None and not node.finished and rclpy.ok():
            executor.spin_once(timeout_sec=_WAIT)
            if parent and os.getppid() != parent:
                break
    finally:
        gc.enable()
        gc.unfreeze()
        for one in (node, *node.members):
            executor.remove_node(one)
        executor.shutdown()


def hurry() -> None:
    """Ask the real-time scheduler for a priority, if there is one to ask for.

    A node that has a millisecond must not queue behind what else the machine is busy with. Only root gets it, or who
    was given the right (ulimit -r); everybody else goes on with what there is. Not before now: starting, and compiling,
    may wait for others.
    """
    priority = int(os.environ.get(PRIORITY_VARIABLE, "0"))
    if priority > 0 and hasattr(os, "sched_setscheduler"):
        for thread in os.listdir("/proc/self/task"):  # those of the middleware, too
            with contextlib.suppress(OSError):
                os.sched_setscheduler(int(thread), os.SCHED_RR, os.sched_param(priority))


def make_executor(node: PamNode) -> Any:
    """An executor with the node and its members in it."""
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


def one_line(error: BaseException) -> str:
    """An error of a library in one line."""
    return " ".join(str(error).split())[:300]
