"""Which way recordings go with a rig, and which options are refused on it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pam_antagonist import Rig, load_rig
from pam_antagonist.api.ways import COURSE, DATA_SHEET, EPISODES, SEALED, TRIALS, Way, way
from pam_antagonist.cli import new_rig
from pam_antagonist.errors import BadInput
from pam_antagonist.recording import Recording

KNOWN, REGULATED, PUSHED = (load_rig(n, regulators=True) for n in ("shin2022", "regulator_joint", "sealed_joint"))
BRAIDED = KNOWN.unchecked(model=KNOWN.model.replaced(force="braided"))


@pytest.fixture(scope="module")
def typed(tmp_path_factory: pytest.TempPathFactory) -> Rig:
    out = tmp_path_factory.mktemp("ruler") / "rig.yaml"
    words = (
        "--kind pulley --radius 29mm --muscle DMSP-20 --nominal-length 300mm --length 272mm --supply 6bar --stop 24deg"
    )
    more = "--inertia 0.022 --mass 2.5kg --drive valve --valve MPYE-5-M5"
    assert new_rig.main(["--out", str(out), *words.split(), *more.split()]) == 0
    return load_rig(out)


def recorded(seconds: float, drive: str = "valve", in_episodes: bool = False) -> Recording:
    stamps = 10**18 + 10_000_000 * np.arange(round(100 * seconds) + 1, dtype=np.int64)
    pressure, command = np.full((len(stamps), 2), 3e5), np.full((len(stamps), 2), 5.0 if drive == "valve" else 3e5)
    made = Recording(Path("bag"), stamps, pressure, command, np.zeros(len(stamps)))
    return replace(made, drive=drive, episode_ns=stamps[::100] if in_episodes else None)


@pytest.mark.parametrize(
    ("rig", "recordings", "expected"),
    [
        (KNOWN, [recorded(30.0)], COURSE),
        (KNOWN, [recorded(15.0)], COURSE),
        (KNOWN, [recorded(6.0)] * 4, TRIALS),
        (KNOWN, [recorded(30.0), recorded(6.0)], TRIALS),
        (KNOWN, [recorded(30.0, in_episodes=True)], TRIALS),
        (BRAIDED, [recorded(30.0)], COURSE),
        (REGULATED, [recorded(30.0, "regulator")], COURSE),
        (REGULATED, [recorded(6.0, "regulator")] * 4, TRIALS),
        (REGULATED, [recorded(30.0, "regulator", in_episodes=True)], EPISODES),
        (REGULATED, [recorded(30.0, in_episodes=True)], EPISODES),
        (PUSHED, [recorded(15.0)], SEALED),
    ],
)
def test_recordings_and_rig_decide(rig: Rig, recordings: list[Recording], expected: Way) -> None:
    assert way(recordings, rig) is expected


def test_a_rig_of_data_sheets_goes_its_way_whatever_was_recorded(typed: Rig) -> None:
    for recordings in ([recorded(30.0)], [recorded(6.0)] * 4, [recorded(30.0, in_episodes=True)]):
        assert way(recordings, typed) is DATA_SHEET


@pytest.mark.parametrize(("rig", "drive"), [(KNOWN, "regulator"), (REGULATED, "valve")])
def test_recordings_of_the_other_drive_are_refused(rig: Rig, drive: str) -> None:
    with pytest.raises(BadInput, match=r"drive: regulator"):
        way([recorded(30.0, drive)], rig)


def test_an_option_that_a_way_does_not_know_is_refused_and_a_default_never() -> None:
    usual = {"joint": "auto", "lock_angle": None, "seed": 0, "starts": 1, "free": (), "also": [], "resume": False}
    for kind in (COURSE, TRIALS, DATA_SHEET, EPISODES, SEALED):
        for command in ("identify", "diagnose"):
            kind.refuse(command, usual, "--")
    with pytest.raises(BadInput, match="--lock-angle: not for many episodes of a joint with pressure regulators"):
        EPISODES.refuse("diagnose", {"lock_angle": 0.2}, "--")
    with pytest.raises(BadInput, match="--also: not for short trials"):
        TRIALS.refuse("diagnose", {"also": ["other"]}, "--")
    with pytest.raises(BadInput, match="^free: not for a joint whose muscles are sealed; leave it out"):
        SEALED.refuse("identify", {"free": ["joint"]})
    for kind in (COURSE, TRIALS, DATA_SHEET, SEALED):
        kind.refuse("diagnose", {"resume": True, "seed": 3, "lock_angle": 0.2}, "--")
