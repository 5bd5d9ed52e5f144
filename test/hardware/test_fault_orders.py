"""Faults that are ordered while the device runs."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from pam_antagonist.errors import BadInput
from pam_antagonist.hardware.line_faults import FaultOrders, FaultPlan, parse_fault


def send(path: Path, text: str) -> None:
    pipe = os.open(path, os.O_WRONLY | os.O_NONBLOCK)
    os.write(pipe, text.encode())
    os.close(pipe)


def test_orders_begin_and_end_faults_beside_the_planned_ones(tmp_path: Path) -> None:
    path = tmp_path / "orders"
    orders = FaultOrders(path)
    plan = FaultPlan([parse_fault("nan=1@5-6")], 0, orders.take)
    assert plan.at(0.0) == ([], [])
    send(path, "+freeze=2\n+fl")
    assert plan.at(1.0) == (["freeze"], [])
    assert plan.hits("freeze", 2) and not plan.hits("freeze", 1)
    send(path, "ip=0.5\n")
    assert plan.at(2.0) == (["flip"], [])
    send(path, "-freeze\n")
    assert plan.at(5.5) == (["nan"], ["freeze"])
    send(path, "-flip\n")
    begun, ended = plan.at(6.5)
    assert begun == [] and sorted(ended) == ["flip", "nan"]
    assert not plan.has("flip") and not plan.has("nan")
    orders.close()
    assert not path.exists()


@pytest.mark.parametrize("order", ["freeze=1", "+freeze=3", "-thaw", "+", "-"])
def test_other_orders_are_refused(tmp_path: Path, order: str) -> None:
    with pytest.raises(BadInput, match="expected"):
        FaultPlan([], 0, lambda: [order]).at(0.0)


def test_a_pipe_takes_nobodys_place(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("precious")
    with pytest.raises(BadInput, match="a named pipe cannot be made"):
        FaultOrders(tmp_path / "file")
    assert (tmp_path / "file").read_text() == "precious"
