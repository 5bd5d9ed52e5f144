"""Real processes over a middleware of their own: nobody else on the machine hears them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest
from sent import Loop, Sent

from pam_antagonist.nodes.processes import free_domain


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip what needs ROS where there is none."""
    try:
        import rclpy  # noqa: F401
    except ImportError:
        for item in items:
            if item.get_closest_marker("ros"):
                item.add_marker(pytest.mark.skip(reason="rclpy is not installed: ./run test brings it"))


def _isolated(patch: pytest.MonkeyPatch, node: pytest.Item | pytest.Collector) -> None:
    # Pipelines run beside other nodes: neither side takes a domain that the other one is about to use.
    side = node.get_closest_marker("realtime") is not None
    patch.setenv("ROS_DOMAIN_ID", str(next(domain for domain in iter(free_domain, None) if domain % 2 == side)))
    patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")


@pytest.fixture
def domain(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """A ROS domain for one test."""
    _isolated(monkeypatch, request.node)


@pytest.fixture(scope="module")
def module_domain(request: pytest.FixtureRequest) -> Iterator[None]:
    """A ROS domain for the tests of one module."""
    with pytest.MonkeyPatch.context() as patch:
        _isolated(patch, request.node)
        yield


@pytest.fixture
def ros(domain: None) -> Iterator[None]:
    """A ROS context in the process of the tests."""
    import rclpy

    rclpy.init(args=[])
    yield
    rclpy.try_shutdown()


@pytest.fixture
def new_node(ros: None) -> Iterator[Callable[..., Any]]:
    """Makes nodes in the process of the tests, which end with the test: ``new_node(PlantNode, seed=5)``.

    ``node.keep(name=output)`` collects in ``node.sent[name]`` what would go out as messages.
    """
    from rclpy.parameter import Parameter

    made: list[Any] = []

    def make(kind: Any, *arguments: Any, **parameters: Any) -> Any:
        given = [Parameter(name, value=value) for name, value in parameters.items()]
        node = kind(*arguments, parameter_overrides=given)
        made.append(node)
        node.sent = {}

        def keep(**outputs: Any) -> None:
            for name, output in outputs.items():
                node.sent[name] = output._publish = Sent(output.publisher.msg_type)

        node.keep = keep
        return node

    yield make
    for node in made:
        node.close()
        node.destroy_node()


@pytest.fixture
def controller(new_node: Callable[..., Any]) -> Callable[..., Loop]:
    """Makes a controller with parameters, and what feeds it."""
    from pam_antagonist.nodes.controller import ControllerNode

    return lambda **parameters: Loop(new_node(ControllerNode, **parameters))


@pytest.fixture
def loop(controller: Callable[..., Loop]) -> Loop:
    """A controller as it comes."""
    return controller()
