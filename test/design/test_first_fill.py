"""Each fault of a wiring is recognised at low pressure, on joints that are not quite the declared one."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pam_antagonist.design.first_fill import faults, first_fill
from pam_antagonist.hardware.line_faults import FaultPlan, parse_fault
from pam_antagonist.hardware.miswired import Miswired
from pam_antagonist.rig import load_rig
from pam_antagonist.simulation.plant import Plant

Floats = NDArray[np.float64]
RIG = load_rig("shin2022")
PLAN = first_fill(RIG)


def recorded(seed: int, *texts: str) -> tuple[Floats, Floats]:
    """Pressures (N, 2) [Pa] and angle (N,) [rad] of the experiment on a joint with faults, 3 % off the rig file."""
    plan = FaultPlan([parse_fault(text) for text in texts], seed)
    plant = Plant(RIG, substeps=1, seed=seed, mismatch=0.03, initial_pressure=(PLAN.pressure, PLAN.pressure))
    joint = Miswired(plant, plan)
    samples = []
    for k, (first, second) in enumerate(PLAN.voltage):
        plan.at(k * PLAN.period)
        samples.append(joint.step((float(first), float(second))))
    return np.array([sample.pressure for sample in samples]), np.array([sample.angle for sample in samples])


@pytest.mark.parametrize(
    ("fault", "name", "words"),
    [
        ("", "", ""),
        ("swap_valves", "swapped_valves", "the valves (or their cables) are exchanged"),
        ("swap_sensors", "swapped_sensors", "the pressure sensors are exchanged"),
        ("flip_encoder", "flipped_encoder", "exchange its two tracks"),
        ("no_supply", "no_supply", "check the supply and its shut-off valve"),
        ("leak=1", "leak_1", "check its fittings"),
        ("leak=2", "leak_2", "check its fittings"),
        ("stuck=1", "stuck_valve_1", "valve 1 is stuck"),
        ("stuck=2", "stuck_valve_2", "valve 2 is stuck"),
    ],
)
def test_the_fault_is_named_with_what_to_check(fault: str, name: str, words: str) -> None:
    for seed in (1, 2):
        pressure, angle = recorded(seed, *([fault] if fault else []))
        assert pressure.max() < 0.5 * (RIG.supply.pressure + RIG.atmosphere.pressure)
        found = faults(RIG, pressure, angle)
        assert [one.name for one in found] == ([name] if name else [])
        assert not found or words in found[0].sentence


def test_sensors_that_are_dead_or_off_are_named() -> None:
    pressure, angle = recorded(3)
    frozen, silent, shut, off = (pressure.copy() for _ in range(4))
    frozen[:, 0], silent[:, 1], shut[:, 1], off[:, 0] = 191e3, np.nan, 0.0, off[:, 0] + 20e3
    for values, name, words in (
        (frozen, "dead_sensor_1", "without noise"),
        (silent, "dead_sensor_2", "shows nothing in 100%"),
        (shut, "dead_sensor_2", "which no muscle has"),
        (off, "zero_1", "its zero is wrong"),
    ):
        (found,) = faults(RIG, values, angle)
        assert found.name == name and words in found.sentence
    leaking, still = recorded(3, "leak=2")[0], np.zeros_like(angle)
    assert [one.name for one in faults(RIG, leaking, still)] == ["leak_2"]
    (stopped,) = faults(RIG, pressure, np.zeros_like(angle))
    assert stopped.name == "still"


def test_without_an_encoder_exchanged_lines_are_not_told_from_exchanged_valves() -> None:
    pressure, _ = recorded(4, "swap_valves")
    (found,) = faults(RIG, pressure, None)
    assert found.name == "crossed" and "which hose goes where" in found.sentence
