"""Real processes over a middleware of their own: nobody else on the machine hears them."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from pam_antagonist.nodes.processes import free_domain

# pytest's importlib mode puts no folder on the path: probe.py stands beside the tests.
sys.path.insert(0, str(Path(__file__).parent))


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip what needs ROS where there is none."""
    try:
        import rclpy  # noqa: F401
    except ImportError:
        for item in items:
            if item.get_closest_marker("ros"):
                item.add_marker(pytest.mark.skip(reason="rclpy is not installed: ./run test brings it"))


def _isolated(patch: pytest.MonkeyPatch) -> None:
    patch.setenv("ROS_DOMAIN_ID", str(free_domain()))
    patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")


@pytest.fixture
def domain(monkeypatch: pytest.MonkeyPatch) -> None:
    """A ROS domain for one test."""
    _isolated(monkeypatch)


@pytest.fixture(scope="module")
def module_domain() -> Iterator[None]:
    """A ROS domain for the tests of one module."""
    with pytest.MonkeyPatch.context() as patch:
        _isolated(patch)
        yield


@pytest.fixture
def ros(domain: None) -> Iterator[None]:
    """A ROS context in the process of the tests."""
    import rclpy

    rclpy.init(args=[])
    yield
    rclpy.try_shutdown()
