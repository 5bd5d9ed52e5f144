"""Recordings that cannot tell: each is said plainly, and nothing is guessed."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from pam_antagonist.diagnosis import diagnose
from pam_antagonist.errors import BadInput
from pam_antagonist.inference.trial import Trial, check


def test_numbers_in_a_refusal_do_not_contradict_it_and_name_what_drives_the_joint() -> None:
    time = np.arange(2000) * 0.0024995
    moving = 4e5 + 5e4 * np.sin(time)[:, None] * np.ones(2)
    measured = np.column_stack([np.sin(time), np.zeros(2000), moving])
    short = Trial("short", "free", 0.0, 0.0024995, moving, measured)
    with pytest.raises(BadInput, match="4.999 s is too short to identify anything; expected at least 5 s"):
        check(short, "regulator")
    long = dataclasses.replace(short, dt=0.01)
    lacking = measured.copy()
    lacking[:401, 2:] = np.nan
    with pytest.raises(BadInput, match="20.1 % of the pressures are missing; expected at most 20 %"):
        check(dataclasses.replace(long, measured=lacking), "regulator")
    with pytest.raises(BadInput, match="the commanded pressures never changed"):
        check(dataclasses.replace(long, voltage=np.full((2000, 2), 4e5)), "regulator")


def test_nothing_is_said_across_a_hole(rig, recorded) -> None:
    """What was commanded in a hole is not known: a late angle was found, and nothing was late."""
    sound = recorded(seconds=24.0)

    def without(begin: float, end: float):
        kept = (sound.time_s <= begin) | (sound.time_s >= end)
        names = ("stamp_ns", "pressure", "voltage", "angle", "torque")
        return dataclasses.replace(sound, **{name: getattr(sound, name)[kept] for name in names})

    found = diagnose([without(1.0, 2.5)], rig, joint="locked", jobs=1, profiles=False, estimator=False)
    assert (found.verdict, found.calibrations) == ("none", ())
    assert "has a hole, the first from 1.0 to 2.5 s, so only the piece from 2.5 to 24.0 s is used" in found.warnings[0]
    assert len(found.experiments[0].trial) * rig.sample_period == pytest.approx(21.5, abs=0.01)
    with pytest.raises(BadInput, match=r"a hole, the first from 9.0 to 11.0 s; the longest piece .* has 13.0 s"):
        diagnose([without(9.0, 11.0)], rig, joint="locked", jobs=1)


def test_pressures_alone_name_what_cannot_be_seen(rig, recorded) -> None:
    """Nothing is found, and the report says of what that means nothing."""
    bare = dataclasses.replace(recorded(seconds=24.0), angle=None, torque=None)
    found = diagnose([bare], rig, joint="locked", jobs=1, profiles=False)
    assert found.verdict == "none" and not found.effects
    said = " ".join(found.unseen)
    assert "Pressures alone decide" in said and "innovations" in said
    blind = next(line for line in found.unseen if line.startswith("Not seen"))
    for name in ("friction", "load_torque", "hysteresis", "creep", "external_torque"):
        assert name in blind
    for name in ("leak", "valve_offset", "supply_droop"):
        assert name not in blind
    rows = {row.channel for row in found.by_recording[0].residuals["recalibrated"]}
    assert {"innovation 1", "innovation 2", "mass flow 1", "pressure_1"} <= rows
    assert not {"contraction torque", "joint motion", "angle", "torque"} & rows


@pytest.fixture(scope="module")
def one_leaks(rig, recorded):
    both = [recorded("leak", 1, "seeping", 15.0, seconds=21.0), recorded(seconds=21.0, take=1)]
    return diagnose(both, rig, joint="locked", jobs=1, profiles=False, estimator=False)


@pytest.mark.slow(15)
def test_one_recording_shows_what_the_other_rules_out(one_leaks) -> None:
    first, second = (part.recording for part in one_leaks.by_recording)
    assert one_leaks.effects[0].recordings == (first,)
    warning = next(line for line in one_leaks.warnings if "contradict" in line)
    assert f"{first} shows leak" in warning and f"{second} rules it out" in warning
    assert f"in {first}" in one_leaks.sentence


def test_one_joint_condition_says_what_the_other_would_tell(one_leaks) -> None:
    assert any(line.startswith("The joint was locked throughout") for line in one_leaks.unseen)
    assert any(line.startswith("Not seen") and "friction" in line for line in one_leaks.unseen)
