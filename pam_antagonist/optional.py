"""Optional libraries: a missing one is reported in one line that tells how to install it."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from contextlib import contextmanager

from pam_antagonist.errors import BadInput

_ROS = ("rclpy", "pam_antagonist_msgs")


def install(extra: str) -> str:
    """Command that installs an extra of ``setup.py``."""
    return f"pip install 'pam_antagonist[{extra}]'"


def available(module: str) -> bool:
    """Whether a module can be imported, without importing it. A folder without ``__init__.py`` does not count."""
    try:
        found = importlib.util.find_spec(module)
    except (ImportError, ValueError):
        return False
    return found is not None and found.origin is not None


@contextmanager
def needs(extra: str, what: str) -> Iterator[None]:
    """Context manager for imports of an extra's libraries.

    Args:
        extra: of ``setup.py``, such as ``reports``.
        what: the feature that needs them, such as "figures".

    Raises:
        BadInput: a library cannot be imported.
    """
    try:
        yield
    except ImportError as error:
        missing = (error.name or str(error)).split(".")[0]
        raise BadInput(f"{what}: {missing} is not installed; to get it: {install(extra)}") from None


def needs_ros(what: str) -> None:
    """Refuse to start a command or node without ROS 2.

    Args:
        what: the command or node.

    Raises:
        BadInput: ROS 2 or this package's messages cannot be imported.
    """
    for module in _ROS:
        if not available(module):
            raise BadInput(
                f"{what} needs ROS 2 ({module} is not installed): start it with ./run in a clone, or source ROS 2 "
                "Jazzy and a workspace that was built with `colcon build --base-paths src src/*/pam_antagonist_msgs`"
            )
