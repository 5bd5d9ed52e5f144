"""Reports the progress of a command on ``/diagnostics``, for the live page and other listeners."""

from __future__ import annotations

import threading
import time
from types import TracebackType

import rclpy

from pam_antagonist.nodes.diagnostics import DiagnosticsPublisher
from pam_antagonist.nodes.health import Health, Level
from pam_antagonist.nodes.spin import client_node
from pam_antagonist.recording.topics import DEFAULT_NAMESPACE

STATUS = "step"
"""Name of the only part that a command reports."""
_PERIOD = 0.5


class Announcer:
    """A node that reports every half second what a command does, and its progress. Use it as a context manager.

    The node commands nothing and has no subscriptions.
    """

    def __init__(self, name: str, namespace: str = DEFAULT_NAMESPACE) -> None:
        self._node = client_node(name, namespace)
        self._publisher = DiagnosticsPublisher(self._node, namespace)
        self._said: tuple[str, float, float | None] | None = None
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._go_on, daemon=True)

    def __enter__(self) -> Announcer:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ended.set()
        self._thread.join()
        self._node.destroy_node()
        rclpy.shutdown(context=self._node.context)

    def say(self, text: str, seconds: float | None = None) -> None:
        """Begin a step of the command.

        Args:
            seconds: its duration [s]; None: not known.
        """
        self._said = text, time.monotonic(), seconds

    def _go_on(self) -> None:
        while not self._ended.wait(_PERIOD):
            if self._said is not None:
                self._publisher.publish({STATUS: _health(*self._said, time.monotonic())})


def _health(text: str, begun: float, seconds: float | None, now: float) -> Health:
    for_long = now - begun
    so_far = f"{for_long:.0f} s" if seconds is None else f"{min(for_long, seconds):.0f} of {seconds:.0f} s"
    return Health(Level.OK, f"{text}, {so_far}", {})
