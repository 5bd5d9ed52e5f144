"""Show a running joint in the browser, 30 times a second.

The page shows the estimate with its 95 % interval beside reference and encoder, pressures and valve voltages
within their limits, NIS, and what the nodes report: safety, faults, losses. It is for this machine alone unless
--host says otherwise, and it commands nothing without --allow-commands. It subscribes to topics only while a page is
open.

Status: 0 ended by Ctrl-C, 2 bad input (one line says what).

examples:
  {run} watch
  {run} watch --namespace /left/elbow --port 8766
  {run} watch --allow-commands
"""

from __future__ import annotations

import argparse
import asyncio
import ipaddress
import os
import signal
import sys
import webbrowser

from pam_antagonist.cli import common
from pam_antagonist.cli.common import whole
from pam_antagonist.optional import needs, needs_ros
from pam_antagonist.recording.topics import DEFAULT_NAMESPACE

_LOOK_S = 4.0
"""[s] Between two looks for the joint; discovery takes a second or two."""


def parser() -> common.Parser:
    """The arguments."""
    out = common.Parser("watch", __doc__)
    out.option("--namespace", "namespace of the joint (default: %(default)s)", None, DEFAULT_NAMESPACE, "/NS")
    out.option("--joint-name", "joint in measured/joint_states (default: the first)", metavar="NAME")
    out.option("--port", "port of the page; 0: any free one (default: %(default)s)", whole(0, 65535), 8765)
    host = "address to listen on (default: %(default)s, this machine alone)"
    out.option("--host", host, None, "127.0.0.1", "ADDRESS")
    out.flag(
        "--allow-commands", "let the page send references, enable and disable the controller, and clear stops; the "
        "page needs the key in the address that is printed",
    )  # fmt: skip
    out.flag("--open", "open the page in the browser")
    return out


def _main(arguments: argparse.Namespace) -> int:
    needs_ros("watch")
    with needs("watch", "the live page"):
        import tornado  # noqa: F401
    _serve(arguments)
    return common.DONE


def _serve(arguments: argparse.Namespace) -> None:
    """Serve until Ctrl-C."""
    from pam_antagonist.nodes.watch import PipelineWatch
    from pam_antagonist.nodes.watch_server import Server

    loop = asyncio.new_event_loop()
    asyncio.set_event_loop(loop)  # Tornado runs on the one that is set
    # Not as an exception: in the middle of a call into rclpy it would become another one.
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, loop.stop)
    watch = PipelineWatch(arguments.namespace, arguments.joint_name, arguments.allow_commands)
    looking: asyncio.TimerHandle | None = None

    def look(said: str) -> None:
        nonlocal looking
        absent = watch.look()
        if absent != said:
            print(absent or "the joint is there", flush=True)
        looking = loop.call_later(_LOOK_S, look, absent)

    try:
        server = Server(watch, arguments.host, arguments.port, arguments.allow_commands)
        try:
            where = f"{watch.namespace or '/'} in ROS domain {os.environ.get('ROS_DOMAIN_ID') or 0}"
            print(f"{where}: {server.address}  (Ctrl-C ends)", flush=True)
            looking = loop.call_later(_LOOK_S, look, "")
            if not _loopback(arguments.host):
                print("warning: everybody who can reach this machine on that port can see the joint", file=sys.stderr)
            if arguments.open:
                webbrowser.open(server.address)
            loop.run_forever()
        finally:
            if looking is not None:
                looking.cancel()
            server.stop()
    finally:
        watch.close()
        loop.close()


def _loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


main = common.command(parser, _main)
