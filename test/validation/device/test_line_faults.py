"""Faults that the emulator can have: ordered while it runs, or in its wiring; each ends with its order or time."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from pam_antagonist.errors import BadInput
from pam_antagonist.rig import load_rig
from pam_antagonist.simulation.plant import Plant
from validation.device.line_faults import FaultOrders, FaultPlan, Miswired, parse_fault

RIG = load_rig("shin2022")
VOLTAGE = (6.6, 5.0)


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


def run(*faults: str, seconds: float = 3.0) -> NDArray[np.float64]:
    """Pressures and angle at the end (3,), of a joint whose first valve fills while the second one empties."""
    plan = FaultPlan([parse_fault(text) for text in faults], 0)
    joint = Miswired(Plant(RIG, substeps=1, noise=False), plan)
    for k in range(round(seconds / RIG.sample_period)):
        plan.at(k * RIG.sample_period)
        sample = joint.step((5.5, 5.5) if k < 10 else VOLTAGE)
    return np.array([*sample.pressure, sample.angle])


@pytest.fixture(scope="module")
def right() -> NDArray[np.float64]:
    return run()


def test_without_a_fault_it_is_the_joint_itself(right: NDArray[np.float64]) -> None:
    plant = Plant(RIG, substeps=1, noise=False)
    for k in range(round(3.0 / RIG.sample_period)):
        sample = plant.step((5.5, 5.5) if k < 10 else VOLTAGE)
    assert np.array_equal(right, [*sample.pressure, sample.angle])
    assert right[0] > right[1] + 100e3


def test_each_fault_shows(right: NDArray[np.float64]) -> None:
    assert np.array_equal(run("swap_sensors"), right[[1, 0, 2]])
    assert np.array_equal(run("flip_encoder"), right * [1, 1, -1])
    swapped = run("swap_valves")
    assert swapped[1] > swapped[0] + 100e3 and np.sign(swapped[2]) == -np.sign(right[2])
    assert run("leak=1")[0] < right[0] - 50e3
    assert run("stuck=1")[0] == pytest.approx(450e3, abs=20e3)
    off = run("no_supply")
    assert np.all(off[:2] < 430e3)
