"""Common arguments of the API: a rig or its name, a recording or its bag."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TypeAlias

import numpy as np

from pam_antagonist.errors import BadInput
from pam_antagonist.recording import Recording, bag_name, plausible, read_bag
from pam_antagonist.recording.corrections import Corrections
from pam_antagonist.recording.joint import JointCondition, joint_condition, with_stops
from pam_antagonist.rig import Rig

RigGiven: TypeAlias = Rig | str | Path
"""A rig, the name of a rig of the package, or the path of a rig file."""
Bag: TypeAlias = Recording | str | Path
"""A recording, or the path of a rosbag2."""


def calibration(rig: Rig) -> Corrections:
    """Corrections of recordings, from the calibration in a rig file, and the atmosphere of gauge pressures."""
    return Corrections(**dict(rig.calibration), atmosphere=rig.atmosphere.pressure)


def as_recording(bag: Bag, rig: Rig, also: Sequence[str] = ()) -> Recording:
    """A recording as its rig's file calibrates it, whether it was read before or is a bag.

    One that was read with corrections of the caller's own is taken as it is.
    """
    if isinstance(bag, Recording):
        return bag if bag.corrected else calibration(rig).applied(bag)
    if isinstance(bag, (str, Path)):
        return read_bag(bag, corrections=calibration(rig), also=also, known=tuple(rig.signals))
    raise BadInput(
        f"recording: found a value of type {type(bag).__name__}, expected a recording or the path of its bag"
    )


def as_recordings(bags: Bag | Sequence[Bag], rig: Rig, also: Sequence[str] = ()) -> list[Recording]:
    """A list of recordings; bags are read with the calibration of their rig."""
    recordings = [as_recording(bag, rig, also) for bag in _several(bags)]
    for recording in recordings:
        _judge(recording)
    return recordings


def named(
    recordings: Sequence[Recording], rig: Rig, joint: str, lock_angle: float | None
) -> list[tuple[Recording, JointCondition, str]]:
    """Recordings with their joints' conditions and their names."""
    states = with_stops(recordings, [joint_condition(one, joint, lock_angle, rig.joint.stop) for one in recordings])
    return [(one, state, bag_name(one.path)) for one, state in zip(recordings, states, strict=True)]


def corrections(bags: Bag | Sequence[Bag], rig: Rig) -> Corrections:
    """Corrections that are made here; none where the caller has corrected a recording."""
    own = any(isinstance(bag, Recording) and bag.corrected for bag in _several(bags))
    return Corrections() if own else calibration(rig)


def _several(bags: Bag | Sequence[Bag]) -> Sequence[Bag]:
    return bags if isinstance(bags, Sequence) and not isinstance(bags, str) else [bags]


def _judge(recording: Recording) -> None:
    """Refuse values in other units; a bag's were judged while it was read."""
    commands = ("voltage", "V") if recording.drive == "valve" else ("pressure", "Pa")
    channels = (
        ("pressure", recording.pressure, "pressure", "Pa"), ("commands", recording.voltage, *commands),
        ("angle", recording.angle, "angle", "rad"), ("torque", recording.torque, "torque", "N m"),
    )  # fmt: skip
    for name, values, quantity, unit in channels:
        if values is not None and np.isfinite(values).any():
            plausible.judge(str(recording.path), plausible.Signal(name, quantity, values, unit), [])
