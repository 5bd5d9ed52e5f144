"""Recordings of rig A stop nothing, and a sensor that fails in one of them does, in time."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from pam_antagonist.estimation import EstimateRun, Estimator
from pam_antagonist.nodes.controller import PARAMETERS as CONTROLLER
from pam_antagonist.nodes.parameters import VALVE_OWNER, by_rig
from pam_antagonist.recording import Recording, read_bag
from pam_antagonist.rig import load_rig
from pam_antagonist.safety import EstimateSupervision, PressureSupervision
from pam_antagonist.safety.supervision import frozen_time

DATA = Path(__file__).resolve().parents[2].parent / "shared/data/rig_a"
CASES = sorted(path.parent.name + "/" + path.name for path in DATA.glob("*/*") if path.is_dir())
CHOSEN = [case for case in CASES if case in ("nominal/locked", "case_leak/free")]
OTHERS = [pytest.param(case, marks=pytest.mark.thorough(2)) for case in CASES if case not in CHOSEN]
DEFAULT = by_rig({parameter.name: parameter.default for parameter in (*VALVE_OWNER, *CONTROLLER)}, load_rig("shin2022"))

pytestmark = pytest.mark.skipif(not CASES, reason=f"the recordings of rig A are not at {DATA}")


@lru_cache(maxsize=1)
def recording(case: str) -> Recording:
    return read_bag(DATA / case)


def pressures() -> PressureSupervision:
    """With the nodes' defaults."""
    rig = load_rig("shin2022")
    limit = 1.1 * rig.supply.pressure
    frozen = frozen_time(rig.sensors.pressure_std, rig.sensors.pressure_step, rig.sample_period)
    return PressureSupervision((limit, limit), DEFAULT["over_pressure_time"], DEFAULT["missing_time"], frozen)


def estimates() -> EstimateSupervision:
    names = ("stop_angle", "stop_angle_time", "nis_limit", "nis_time", "blind_time")
    return EstimateSupervision(*(DEFAULT[name] for name in names))


def estimated(case: str, pressure: np.ndarray) -> EstimateRun:
    given = recording(case)
    return Estimator(load_rig("shin2022"), "default", case.split("/")[1]).run(given.stamp_ns, pressure, given.voltage)


def first_of_estimates(run: EstimateRun) -> tuple[int, str]:
    supervision = estimates()
    columns = (run.rows["angle"], run.rows["nis"], run.rows["flags"])
    for k, (angle, nis, flags) in enumerate(zip(*columns, strict=True)):
        if words := supervision.check(int(run.stamp_ns[k]), float(angle), float(nis), int(flags)):
            return int(run.index[k]), words
    return -1, ""


@pytest.mark.parametrize("case", [*CHOSEN, *OTHERS])
def test_a_recording_of_a_sound_joint_or_one_with_an_effect_stops_nothing(case: str) -> None:
    given = recording(case)
    supervision = pressures()
    for stamp, (first, second) in zip(given.stamp_ns.tolist(), given.pressure.tolist(), strict=True):
        assert not supervision.check(stamp, first, second)
    assert first_of_estimates(estimated(case, given.pressure)) == (-1, "")


@pytest.mark.parametrize(("fault", "after"), [("stuck", (29, 31)), ("gone", (20, 21))])
def test_a_sensor_that_fails_in_such_a_recording_stops_the_valves(fault: str, after: tuple[int, int]) -> None:
    given, at = recording(CHOSEN[0]), 20_000
    pressure = given.pressure.copy()
    if fault == "stuck":
        pressure[at:, 0] = pressure[at, 0]
    else:
        pressure[at:, 1] = np.nan
    supervision = pressures()
    said = (supervision.check(int(given.stamp_ns[k]), *pressure[k].tolist()) for k in range(at - 1000, at + 1000))
    assert after[0] <= next(k for k, words in enumerate(said) if words) - 1000 <= after[1]


@pytest.mark.parametrize("step", [10e3, -60e3])
def test_a_sensor_that_jumps_disagrees_with_the_estimate_before_the_filter_gives_in(step: float) -> None:
    """As from a loose contact; a sensor's own readings do not show it."""
    case, at = CHOSEN[0], 20_000
    pressure = recording(case).pressure.copy()
    pressure[at:, 1] += step
    when, words = first_of_estimates(estimated(case, pressure))
    assert at < when <= at + 20 and "disagree" in words
