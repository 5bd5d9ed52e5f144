"""Figures of the diagnostics."""

from __future__ import annotations

import contextlib
import math
import socket

import pytest

from pam_antagonist.nodes import processes
from pam_antagonist.nodes.health import Rate, Window
from pam_antagonist.nodes.processes import ros_arguments


def test_window_gives_order_statistics_and_starts_anew() -> None:
    window = Window()
    for value in range(1, 1001):
        window.add(float(value))
    spread = window.take()
    assert (spread.count, spread.median, spread.largest) == (1000, 500.0, 1000.0)
    assert 990.0 <= spread.p99 <= 991.0
    empty = window.take()
    assert empty.count == 0 and math.isnan(empty.median) and math.isnan(empty.largest)


def test_window_does_not_grow_without_end() -> None:
    window = Window(limit=10)
    for _ in range(100):
        window.add(1.0)
    assert window.take().count == 10


def test_rate_is_per_second() -> None:
    rate = Rate()
    assert math.isnan(rate.take(5, 10**9))
    assert rate.take(505, 10**9 + 500_000_000) == pytest.approx(1000.0)
    assert rate.take(505, 3 * 10**9) == 0.0


def test_ros_arguments_keep_the_types_of_values() -> None:
    values = {"a": True, "b": 2, "c": 2.0, "d": 'x "y"', "e": [1, 2.5], "f": 1e-05}
    assert ros_arguments(values, {"__ns": "/two"}) == [
        "--ros-args", "-p", "a:=true", "-p", "b:=2", "-p", "c:=2.0", "-p", 'd:="x \\"y\\""', "-p", "e:=[1.0, 2.5]",
        "-p", "f:=1e-05", "-r", "__ns:=/two",
    ]  # fmt: skip


def test_a_domain_in_use_is_not_chosen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(processes, "_DOMAINS", 3)
    with contextlib.ExitStack() as taken:
        for domain in (1, 3):
            one = taken.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            try:
                one.bind(("", 7410 + 250 * domain))
            except OSError:
                pytest.skip(f"somebody uses ROS domain {domain} right now")
        assert {processes.free_domain() for _ in range(20)} <= {2}
