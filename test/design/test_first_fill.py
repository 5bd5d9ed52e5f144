"""Each fault of a wiring is recognised at low pressure, on joints that are not quite the declared one."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pam_antagonist.design import Plan
from pam_antagonist.design.first_fill import faults, first_fill, turns_visibly
from pam_antagonist.errors import BadInput
from pam_antagonist.rig import load_rig
from pam_antagonist.simulation.plant import Plant
from validation.device.line_faults import FaultPlan, Miswired, parse_fault

Floats = NDArray[np.float64]
RIG = load_rig("shin2022")
PLAN = first_fill(RIG)


def recorded(seed: int, *texts: str, driven: Plan = PLAN) -> tuple[Floats, Floats]:
    """Pressures (N, 2) [Pa] and angle (N,) [rad] of the experiment on a joint with faults, 3 % off the rig file."""
    plan = FaultPlan([parse_fault(text) for text in texts], seed)
    plant = Plant(RIG, substeps=1, seed=seed, mismatch=0.03, initial_pressure=(driven.pressure, driven.pressure))
    joint = Miswired(plant, plan)
    samples = []
    for k, (first, second) in enumerate(driven.voltage):
        plan.at(k * driven.period)
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


@pytest.mark.parametrize(
    ("highest", "fault", "name"),
    [
        (330e3, "flip_encoder", "flipped_encoder"),
        (280e3, "", ""),
        (280e3, "swap_valves", "crossed"),
        (280e3, "leak=2", "leak_2"),
    ],
)
def test_a_limit_of_the_pressures_holds_for_the_first_air_as_well(highest: float, fault: str, name: str) -> None:
    limited = first_fill(RIG, highest)
    pressure, angle = recorded(4, *([fault] if fault else []), driven=limited)
    assert PLAN.limits.pressure[1] > limited.limits.pressure[1] == highest > pressure.max()
    assert [one.name for one in faults(RIG, pressure, angle, limited)] == ([name] if name else [])
    # At the lowest pressures the joint hardly turns, and the encoder's sign does not show.
    assert turns_visibly(RIG, limited) == (highest > 300e3) and turns_visibly(RIG, PLAN)


def test_a_limit_at_which_no_pressure_could_rise_is_refused() -> None:
    with pytest.raises(BadInput, match="expected at least 253 kPa"):
        first_fill(RIG, 240e3)


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
