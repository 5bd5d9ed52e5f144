"""Common arguments of the API: a rig or its name, a recording or its bag."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TypeAlias

from pam_antagonist.recording import Recording, read_bag
from pam_antagonist.recording.corrections import Corrections
from pam_antagonist.recording.recording import Recording as _Recording
from pam_antagonist.rig import Rig, load_rig

RigGiven: TypeAlias = Rig | str | Path
"""A rig, the name of a rig of the package, or the path of a rig file."""
Bag: TypeAlias = _Recording | str | Path
"""A recording, or the path of a rosbag2."""


def as_rig(rig: RigGiven, regulators: bool = False) -> Rig:
    """The rig itself.

    Args:
        rig: a rig, its name, or its file.
        regulators: as for :func:`load_rig`.
    """
    return rig if isinstance(rig, Rig) else load_rig(rig, regulators)


def calibration(rig: Rig) -> Corrections:
    """Corrections of recordings, from the calibration in a rig file.

    Args:
        rig: the rig.
    """
    return Corrections(**dict(rig.calibration))


def as_recording(bag: Bag, rig: Rig, also: Sequence[str] = ()) -> Recording:
    """The recording itself; a bag is read with the calibration of its rig.

    Args:
        bag: a recording or its bag.
        rig: of the recording.
        also: required further signals.
    """
    return bag if isinstance(bag, _Recording) else read_bag(bag, corrections=calibration(rig), also=also)


def as_recordings(bags: Bag | Sequence[Bag], rig: Rig, also: Sequence[str] = ()) -> list[Recording]:
    """A list of recordings; bags are read with the calibration of their rig.

    Args:
        bags: one or several.
        rig: of the recordings.
        also: required further signals of each.
    """
    return [as_recording(bag, rig, also) for bag in _several(bags)]


def corrections(bags: Bag | Sequence[Bag], rig: Rig) -> Corrections:
    """Corrections with which bags are read here; none for recordings that the caller has read.

    Args:
        bags: one or several.
        rig: of the recordings.
    """
    return Corrections() if any(isinstance(bag, _Recording) for bag in _several(bags)) else calibration(rig)


def _several(bags: Bag | Sequence[Bag]) -> Sequence[Bag]:
    return [bags] if isinstance(bags, (_Recording, str, Path)) else bags
