"""Optional libraries: a missing one is reported in one line that tells how to install it."""

from __future__ import annotations

import difflib
import importlib.util
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from pam_antagonist.errors import BadInput

_ROS = ("rclpy", "pam_antagonist_msgs")
_LAST_DOMAIN = 232  # the ports of higher ones do not exist
_WORDS = {
    "ROS_AUTOMATIC_DISCOVERY_RANGE": ("SUBNET", "LOCALHOST", "OFF", "SYSTEM_DEFAULT"),
    "ROS_LOCALHOST_ONLY": ("0", "1"),
    "ROS_SECURITY_ENABLE": ("true", "false"),
    "ROS_SECURITY_STRATEGY": ("Enforce", "Permissive"),
}
"""Environment variables of ROS 2 and their values."""


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
    """Context manager for imports of an extra's libraries. `extra`: of ``setup.py``, such as ``reports``."""
    try:
        yield
    except ImportError as error:
        missing = (error.name or str(error)).split(".")[0]
        raise BadInput(f"{what}: {missing} is not installed; to get it: {install(extra)}") from None


def check_ros_variables(environment: Mapping[str, str] = os.environ) -> None:
    """Refuse values of ROS 2's environment variables that ROS 2 would fail with, or replace without an error."""
    domain = environment.get("ROS_DOMAIN_ID", "")
    if domain and not (domain.isascii() and domain.isdigit() and int(domain) <= _LAST_DOMAIN):
        raise BadInput(
            f"environment variable ROS_DOMAIN_ID is {domain!r}: expected a whole number from 0 to {_LAST_DOMAIN}; "
            "type unset ROS_DOMAIN_ID for the default, 0"
        )
    middleware, prefixes = environment.get("RMW_IMPLEMENTATION", ""), environment.get("AMENT_PREFIX_PATH", "")
    if middleware and prefixes and not any(Path(one, "share", middleware).is_dir() for one in prefixes.split(":")):
        raise BadInput(
            f"environment variable RMW_IMPLEMENTATION is {middleware!r}, which is not installed; type unset "
            "RMW_IMPLEMENTATION for the default, rmw_fastrtps_cpp"
        )
    for name, words in _WORDS.items():
        if (given := environment.get(name, "")) and given not in words:
            close = difflib.get_close_matches(given.upper(), words, 1)
            hint = f"; did you mean {close[0]}?" if close else ""
            raise BadInput(f"environment variable {name} is {given!r}: expected one of {', '.join(words)}{hint}")


def needs_ros(what: str) -> None:
    """Refuse to start a command or node without ROS 2."""
    check_ros_variables()
    for module in _ROS:
        if not available(module):
            raise BadInput(
                f"{what} needs ROS 2 ({module} is not installed): start it with ./run in a clone, or source ROS 2 "
                "Jazzy and a workspace that was built with `colcon build --base-paths src src/*/pam_antagonist_msgs`"
            )
