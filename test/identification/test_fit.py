"""Which recordings may be fitted, what may move, and how recordings with gaps are taken."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from pam_antagonist import identify
from pam_antagonist.errors import BadInput
from pam_antagonist.identification.result import FromPressures
from pam_antagonist.inference.free_parameters import moved
from pam_antagonist.inference.free_run import StartedModel, predict, start_of
from pam_antagonist.inference.trial import check, make_trial
from pam_antagonist.recording import Recording
from pam_antagonist.rig import load_rig
from pam_antagonist.simulation.excitation import profile
from pam_antagonist.simulation.plant import Plant

RIG = load_rig("shin2022")
TRUE = {
    "valve_1.inflow_area": 5.3e-8, "valve_2.outflow_area": 7.5e-8, "muscle_2.force.w2": 16.4, "friction.shaft": 0.207,
}  # fmt: skip
SECONDS = 15.0


@lru_cache(maxsize=8)
def record(joint: str, seed: int, area: float = 1.0) -> Recording:
    """The plant with the true parameters, exact otherwise, behind its sensors; one area may be another rig's."""
    true = {**TRUE, "valve_1.inflow_area": area * TRUE["valve_1.inflow_area"]}
    plant = Plant(moved(RIG, true), joint=joint, seed=seed, substeps=1)
    voltage = profile("steps", SECONDS, RIG.sample_period, seed=seed)
    samples = [plant.step(row) for row in voltage]
    return Recording(
        path=Path(f"{joint}_{seed}"), stamp_ns=np.arange(1, len(samples) + 1, dtype=np.int64) * 1_000_000,
        pressure=np.array([sample.pressure for sample in samples]), voltage=voltage,
        angle=np.array([sample.angle for sample in samples]), torque=np.array([sample.torque for sample in samples]),
    )  # fmt: skip


@pytest.mark.slow(4)
def test_true_values_come_back_within_their_errors() -> None:
    result = identify([record("free", 1), record("locked", 1)], RIG)
    found = result.found
    assert isinstance(found, FromPressures) and not result.rejected
    # In memory the rig says of itself what its file does: a replay by it is one of an identified rig.
    assert result.rig.identified.count("_1") == 2 and result.rig.name == "shin2022_identified" and result.rig.fitted
    stds = {**found.joint.stds, **found.air.stds}  # type: ignore[union-attr]
    for name in ("valve_1.inflow_area", "valve_2.outflow_area", "friction.shaft"):
        assert abs(found.rig.value(name) - TRUE[name]) < 3.0 * stds[name], name
        assert abs(found.rig.value(name) - TRUE[name]) < 0.5 * abs(RIG.value(name) - TRUE[name]), name
    assert found.pooled("identified") < 0.7 * found.pooled("as_configured")
    assert len(result.own) == 2, "each recording may deviate a little"


@pytest.mark.slow(8)
def test_of_recordings_of_two_rigs_it_is_said_what_differs() -> None:
    """The doubt comes after minutes of work, so that it is a sentence beside the result, and no error in its place."""
    frozen = ["muscle_1", "muscle_2", "joint", "friction"]
    result = identify([record("free", 1), record("locked", 1, 1.5)], RIG, freeze=frozen)
    assert re.search(
        r"locked_1 and .*free_1 do not fit together: valve_1.inflow_area would differ",
        " ".join(result.summary().split()),
    )
    assert "do not fit together" not in identify([record("free", 1), record("locked", 1)], RIG, freeze=frozen).summary()


def test_a_torque_meter_at_its_end_is_refused() -> None:
    recording = replace(record("locked", 1), torque=np.minimum(record("locked", 1).torque, 0.1))  # type: ignore[type-var]
    with pytest.raises(
        BadInput, match=r"bag: measured torque reads exactly 0.1 N m in .* % of the samples: the sensor is saturated"
    ):
        check(make_trial(recording, RIG, "locked", 0.0, "bag"))


def test_a_torque_from_outside_reaches_the_model() -> None:
    quiet = make_trial(record("free", 1), RIG, "free", 0.0, "bag")
    external = 0.5 * np.sin(np.arange(len(quiet)) * 1e-3)
    pushed = make_trial(replace(record("free", 1), external_torque=external), RIG, "free", 0.0, "bag")
    p = RIG.parameters()
    angles = [predict(trial, StartedModel(p), start_of(trial))[:, 0] for trial in (quiet, pushed)]
    assert np.abs(angles[1] - angles[0]).max() > np.radians(1.0)


def test_an_angle_that_begins_late_tells_the_start_all_the_same() -> None:
    whole = record("free", 1)
    late = np.where(np.arange(len(whole)) < 25, np.nan, whole.angle)  # type: ignore[call-overload]
    starts = [start_of(make_trial(one, RIG, "free", 0.0, "bag")) for one in (whole, replace(whole, angle=late))]
    assert starts[1].angle == pytest.approx(starts[0].angle, abs=3e-4)
    never = replace(whole, angle=np.full(len(whole), np.nan))
    assert start_of(make_trial(never, RIG, "free", 0.0, "bag")).angle is None


def test_missing_samples_are_bridged_and_not_counted(changed: Callable[..., Recording]) -> None:
    whole = record("free", 1)
    keep = np.ones(len(whole), dtype=bool)
    keep[3000:3040] = False
    trial = make_trial(changed(whole, keep=keep), RIG, "free", 0.0, "gappy")
    assert len(trial) == len(whole)
    assert np.isnan(trial.measured[3000:3040]).all() and np.isfinite(trial.voltage).all()
    assert (
        np.isnan(trial.blocks(trial.measured)[150:152]).all() and np.isfinite(trial.blocks(trial.measured)[152:]).all()
    )
